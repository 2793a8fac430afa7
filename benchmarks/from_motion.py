"""Calibration and offset from motion only: BROAD at each step, pitch of simulated tasks for each offset, and run times.

``python -m benchmarks.from_motion`` prints four tables, or only the named tables: broad, heading, tasks, times.

broad: end error, total / inclination, deg, of eight trials, each calibrated on the *other* trials of its device, by
strapdown and by VQF (offline, as in ``orient --method vqf``) with the same readings. The expected error is also given.
heading: error of the heading over the movement, rms, deg, by VQF with a magnetometer (9D), for raw readings and for
readings calibrated from the motion of the other trials. The mean error in the five seconds before the movement is
subtracted, or nothing. tasks: pitch error, rms over the motion, deg, of three simulated devices, each calibrated by a
bench session, on another day. ``sim`` has no walking. Ten minutes consist of ten ``free`` tasks in a recording, and a
walk of sinusoids defined here. times: 30 recordings of two minutes with the fit of both triads, 30 units of a recording
with their magnetometer, and the offset of a recording.
"""

import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from benchmarks.broad import DEVICES, pairs, trial
from undrift.arrays import FloatArray
from undrift.calibration.calibrate import calibrate, calibrate_from_motion
from undrift.calibration.codes import device_adc
from undrift.calibration.in_motion import fit_in_motion
from undrift.calibration.reference import leave_one_out
from undrift.correction.correct import correct
from undrift.correction.motion import fit_motion
from undrift.correction.rest import find_rest_offset
from undrift.frames import quaternion_conjugate, quaternion_product
from undrift.model import Calibration
from undrift.orientation import OrientSettings, heading_of, orient
from undrift.record import Record, Reference
from undrift.sim.device.presets import random_device
from undrift.sim.device.simulate import simulate_device
from undrift.sim.motion.motion import Course, Step, Sway
from undrift.sim.motion.tasks import Task, draw_task
from undrift.sim.sessions import simulate_session
from undrift.sync import seen_poses
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY
from undrift.validation.agreement import validate_leave_one_out
from undrift.validation.trial import (
    END_S,
    LEAD_S,
    REST_S,
    OffsetChoice,
    Trial,
    TrialSettings,
    compare_orientations,
    orientation_at,
    validate_trial,
)

# ---- BROAD


@dataclass(frozen=True, slots=True, kw_only=True)
class Ended:
    """End errors of a trial after a step, deg."""

    number: str
    strapdown: tuple[float, float]  # total, inclination
    filtered: tuple[float, float]  # by VQF
    expected: float = float("nan")  # of strapdown, total
    interval: tuple[float, float] = (float("nan"), float("nan"))  # 95 %


def steps(numbers: Sequence[str]) -> Iterator[tuple[str, list[Ended]]]:
    """Yield the trials of a device after each step."""
    every = pairs(numbers)
    records, references = [p[0] for p in every], [p[1] for p in every]
    adc = device_adc(records)
    fits = [
        Calibration(
            device="", reference_temp_c=np.nan, gravity_m_s2=STANDARD_GRAVITY, gyro=single.model, adc=adc,
            verdict=single.fit.triad.verdict,
        )
        for single in leave_one_out(records, references, adc=adc)
    ]  # fmt: skip
    from_others = [calibrate_from_motion([other for other in records if other is not record]) for record in records]
    with_field = [
        calibrate_from_motion([other for other in records if other is not record], magnetometer=True)
        for record in records
    ]
    without: list[Calibration | None] = [None] * len(records)
    rows: tuple[tuple[str, Sequence[Calibration | None], OffsetChoice], ...] = (
        ("raw", without, "none"),
        ("rest", without, "rest"),
        ("reference fit", fits, "none"),
        ("reference fit, offset from motion", fits, "motion"),
        ("motion of the others, rest", from_others, "rest"),
        ("motion of the others, offset from motion", from_others, "motion"),
        ("and the magnetometer, rest", with_field, "rest"),
        ("and the magnetometer, offset from motion", with_field, "motion"),
    )
    for name, calibrations, offset in rows:
        settings = TrialSettings(offset=offset)
        if calibrations is fits:  # the same, with the errors to expect of trials that were held out
            trials = validate_leave_one_out(every, settings=settings, names=numbers).trials
        else:
            trials = tuple(
                validate_trial(*pair, calibration=calibration, settings=settings)
                for pair, calibration in zip(every, calibrations, strict=True)
            )
        yield (
            name,
            [
                _ended(number, single, by_vqf(single, *pair, calibration, offset))
                for number, single, pair, calibration in zip(numbers, trials, every, calibrations, strict=True)
            ],
        )


def _ended(number: str, judged: Trial, filtered: tuple[float, float]) -> Ended:
    ends = judged.figures.end_total_deg, judged.figures.end_inclination_deg
    if judged.expected is None:
        return Ended(number=number, strapdown=ends, filtered=filtered)
    expected = judged.expected
    return Ended(
        number=number,
        strapdown=ends,
        filtered=filtered,
        expected=expected.end_total_deg,
        interval=expected.end_interval_deg,
    )


def by_vqf(
    judged: Trial, record: Record, reference: Reference, calibration: Calibration | None, offset: OffsetChoice
) -> tuple[float, float]:
    """Return the end error of VQF, total and inclination, deg, at the same time as in ``validate``. Headings are equal
    before the motion.

    The magnetometer is used if the calibration has one.
    """
    done = record.in_si() if calibration is None else correct(record, calibration)
    model = None if calibration is None else calibration.gyro
    field = calibration is not None and calibration.magnetometer is not None
    track = orient(done, None, OrientSettings(method="vqf", offset=offset, magnetometer=field), gyro_model=model)
    return end_errors(judged, done, reference, track.time, track.q_nb)


def end_errors(
    judged: Trial, record: Record, reference: Reference, time: FloatArray, q_nb: FloatArray
) -> tuple[float, float]:
    """Return the end error of a program's orientations of a record, as `by_vqf` has it."""
    poses = seen_poses(record, reference, judged.lag)
    lag_s = judged.lag.seconds * judged.lag_undone
    shift_s = (judged.lag.seconds - 0.5 / record.sample_rate_hz) * judged.lag_undone
    q = orientation_at(time, q_nb, poses.time + shift_s)
    start_s, stop_s = judged.motion.start_s - lag_s, judged.motion.stop_s - lag_s
    valid = poses.valid & np.isfinite(q).all(axis=1)
    before = valid & (poses.time >= start_s - REST_S) & (poses.time < start_s - LEAD_S)
    off = heading_of(quaternion_product(q, quaternion_conjugate(poses.q_nb)))[before]
    turn = -0.5 * float(np.angle(np.exp(1j * off).mean()))
    q = quaternion_product(np.array([np.cos(turn), 0.0, 0.0, np.sin(turn)]), q)
    after = valid & (poses.time >= stop_s) & (poses.time < stop_s + END_S)
    error = compare_orientations(q[after], poses.q_nb[after])
    return float(np.degrees(np.median(error.total))), float(np.degrees(np.median(error.inclination)))


def print_broad() -> None:
    """Print the trials of each device and their means."""
    every: dict[str, list[Ended]] = {}
    for device, numbers in DEVICES.items():
        for name, ended in steps(numbers):
            every.setdefault(name, []).extend(ended)
            print(f"{device}, {name}: {'; '.join(map(_words, ended))}", flush=True)
    print(f"\n{'mean of eight, deg':50} {'strapdown':13} {'VQF':13} observed / expected (rms), inside 95 %")
    for name, ended in every.items():
        means = [
            f"{np.mean([e[k] for e in errors]):5.2f}"
            for errors in zip(*map(_pairs, ended), strict=True)
            for k in (0, 1)
        ]
        with_expected = [e for e in ended if np.isfinite(e.expected)]
        text = ""
        if with_expected:
            ratio = np.sqrt(np.mean([(e.strapdown[0] / e.expected) ** 2 for e in with_expected]))
            inside = sum(e.interval[0] <= e.strapdown[0] <= e.interval[1] for e in with_expected)
            below = sum(e.strapdown[0] < e.interval[0] for e in with_expected)
            text = f"{ratio:.2f}, {inside} of {len(with_expected)}" + f" ({below} below)" * (below > 0)
        print(f"{name:50} {means[0]} ({means[1]}) {means[2]} ({means[3]}) {text}")


def _pairs(ended: Ended) -> tuple[tuple[float, float], tuple[float, float]]:
    return ended.strapdown, ended.filtered


def _words(ended: Ended) -> str:
    expected = f", expected {ended.expected:.2f} [{ended.interval[0]:.2f}, {ended.interval[1]:.2f}]"
    return (
        f"{ended.number} {ended.strapdown[0]:.2f} / {ended.strapdown[1]:.2f}{expected * bool(np.isfinite(ended.expected))}, "
        f"VQF {ended.filtered[0]:.2f} / {ended.filtered[1]:.2f}"
    )


# ---- heading

UNDISTURBED = ("02", "05", "07", "09", "03")


def heading_errors(record: Record, reference: Reference, calibration: Calibration | None) -> tuple[float, float]:
    """Return the error of VQF's heading (9D), rms over the movement, deg: equal before it, and as it is."""
    done = record.in_si() if calibration is None else correct(record, calibration)
    model, offset = (None, "none") if calibration is None else (calibration.gyro, "motion")
    track = orient(done, None, OrientSettings(method="vqf", offset=offset, magnetometer=True), gyro_model=model)
    q = reference.q_nb[reference.time.searchsorted(track.time)]  # BROAD: one clock
    off, moving = heading_of(quaternion_product(track.q_nb, quaternion_conjugate(q))), reference.moving > 0.0
    begins = float(reference.time[moving][0])
    before = np.isfinite(off) & (track.time < begins) & (track.time > begins - 5.0)
    rms_errors = []
    for angle in (np.angle(np.exp(1j * off[before]).mean()), 0.0):
        residual = np.angle(np.exp(1j * (off - angle)))[moving & np.isfinite(off)]
        rms_errors.append(float(np.degrees(np.sqrt((residual**2).mean()))))
    return rms_errors[0], rms_errors[1]


def print_heading() -> None:
    """Print the heading error of each trial, and means over the undisturbed trials and over all."""
    rows = {}
    for numbers in DEVICES.values():
        for n in numbers:
            other_records = [trial(o)[0] for o in numbers if o != n]
            calibration = calibrate_from_motion(other_records, magnetometer=True)
            rows[n] = (*heading_errors(*trial(n), None), *heading_errors(*trial(n), calibration))
            print(
                f"{n}: raw {rows[n][0]:.2f} ({rows[n][1]:.2f}), corrected {rows[n][2]:.2f} ({rows[n][3]:.2f})",
                flush=True,
            )
    for name, chosen in (("five undisturbed trials", UNDISTURBED), ("eight trials", tuple(rows))):
        means = np.mean([rows[n] for n in chosen], axis=0)
        print(f"{name}: raw {means[0]:.2f} ({means[1]:.2f}), corrected {means[2]:.2f} ({means[3]:.2f})")


# ---- tasks

# Rests of 10 s, because the offset from motion refuses recordings below 20 s, and a sit-to-stand task lasts 3 s
RATE_HZ, PAUSE_S, MINUTES, SEEDS = 100.0, 10.0, 10, (1, 2, 3)
TURN_ON = 0.05 * RADIAN_PER_DEGREE  # rad/s, change of the offset from the bench session to another day [assumed]
CADENCE_HZ, COURSE_S = 1.8, 15.0  # steps of a walk, and time between two turns [assumed]
# A walk [assumed]: amplitude, deg or m, and frequency relative to the steps
WALK = {
    "roll": ((2.5, 0.5), (0.5, 1.5)),
    "pitch": ((1.5, 1.0), (0.5, 0.5)),
    "yaw": ((4.0, 0.5), (0.8, 1.5)),
    "forward": ((0.015, 1.0), (0.004, 2.0)),
    "left": ((0.02, 0.5), (0.003, 1.5)),
    "up": ((0.02, 1.0), (0.003, 2.0)),
}


def ten_free(rng: np.random.Generator) -> Task:
    """Return ten free tasks in one recording, one after another."""
    tasks = [draw_task("free", rng=rng, rest_s=PAUSE_S + 60.0 * k) for k in range(MINUTES)]
    courses = {name: tuple(term for task in tasks for term in getattr(task, name)) for name in WALK}
    stop = tasks[-1].moving_s[1]
    return Task(name="free, 10 min", duration_s=stop + PAUSE_S, moving_s=(PAUSE_S, stop), **courses)


def walk(rng: np.random.Generator) -> Task:
    """Return ten minutes of walking to and fro: waves of the step's and the stride's frequency, turns about of 2 s."""
    start, stop = PAUSE_S, PAUSE_S + 60.0 * MINUTES
    cadence = CADENCE_HZ * rng.uniform(0.9, 1.1)
    courses: dict[str, Course] = {
        name: tuple(
            Sway(
                (size * rng.uniform(0.8, 1.2) * (RADIAN_PER_DEGREE if name in ("roll", "pitch", "yaw") else 1.0),),
                (share * cadence,), (rng.uniform(0.0, 2.0 * np.pi),), start, stop, 1.0,
            )
            for size, share in WALK[name]
        )
        for name in WALK
    }  # fmt: skip
    about = np.arange(start + COURSE_S, stop - 3.0, COURSE_S)
    courses["yaw"] = (*courses["yaw"], *(Step(float(at), 2.0, (-1.0) ** k * np.pi) for k, at in enumerate(about)))
    return Task(
        name="walk, 10 min", duration_s=stop + PAUSE_S, moving_s=(start, stop), arm_b=(0.1, 0.0, 0.0), **courses
    )


TASKS: dict[str, Callable[[np.random.Generator], Task]] = {
    "sit_to_stand": lambda rng: draw_task("sit_to_stand", rng=rng, rest_s=PAUSE_S),
    "step": lambda rng: draw_task("step", rng=rng, rest_s=PAUSE_S),
    "posturography, 50 s": lambda rng: draw_task("posturography", rng=rng, rest_s=PAUSE_S),
    "free, 10 min": ten_free,
    "walk, 10 min": walk,
}


def pitch_errors(name: str, seed: int) -> list[float]:
    """Return the pitch error of a device in a task, rms, deg, for the offsets none, rest and motion."""
    rng = np.random.default_rng(seed)
    device = random_device(rng)
    calibration = calibrate(simulate_session("bench", device, rng=rng))
    today = replace(device, gyro=device.gyro.shifted(TURN_ON * rng.standard_normal(3)))
    task = TASKS[name](rng)
    motion = task.at(np.arange(round(task.duration_s * RATE_HZ)) / RATE_HZ, STANDARD_GRAVITY)
    record = simulate_device(today, motion, rng=rng).record
    truth = Reference(time=motion.time, q_nb=motion.q_nb, moving=motion.moving, name=name)
    return [
        validate_trial(
            record, truth, calibration=calibration, settings=TrialSettings(offset=offset)
        ).figures.rmse_pitch_deg
        for offset in ("none", "rest", "motion")
    ]


def print_tasks() -> None:
    """Print the pitch error of each task."""
    print(f"{'pitch error, rms, deg':21} {'none':24} {'rest':24} motion")
    for name in TASKS:
        errors: FloatArray = np.array([pitch_errors(name, seed) for seed in SEEDS]).T
        cells = [f"{np.sqrt((row**2).mean()):.3f} ({' '.join(f'{e:.3f}' for e in row)})" for row in errors]
        print(f"{name:21} " + " ".join(f"{cell:27}" for cell in cells), flush=True)


# ---- times


def print_times() -> None:
    """Print how long a fit of 30 recordings of two minutes takes, 30 units with a magnetometer, and the offset of a recording."""
    records = [trial(n)[0].between(0.0, 120.0) for numbers in DEVICES.values() for n in numbers] * 4
    fit_in_motion(records[:1])  # the compiler's time is not the estimator's
    start = perf_counter()
    fit_in_motion(records[:30])
    took = perf_counter() - start
    print(
        f"fit_in_motion, 30 recordings of {records[0].duration_s:.0f} s at {records[0].sample_rate_hz:.0f} Hz: {took:.1f} s"
    )
    calibrate_from_motion(records[:1], magnetometer=True)
    start = perf_counter()
    for record in records[:30]:
        calibrate_from_motion([record], magnetometer=True)
    print(f"calibrate_from_motion with a magnetometer, 30 units of one such recording: {perf_counter() - start:.1f} s")
    rest = find_rest_offset(records[0])
    for name, rest_or_none in (("with its rest", rest), ("without", None)):
        fit_motion(records[0], rest_or_none)
        start = perf_counter()
        fit_motion(records[0], rest_or_none)
        print(f"fit_motion, {records[0].duration_s:.0f} s, {name}: {perf_counter() - start:.2f} s")


def main() -> None:
    """Print the tables."""
    for table_name in sys.argv[1:] or ("broad", "heading", "tasks", "times"):
        {"broad": print_broad, "heading": print_heading, "tasks": print_tasks, "times": print_times}[table_name]()


if __name__ == "__main__":
    main()
