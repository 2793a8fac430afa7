"""A run of a study: calibration sessions on a bench that errs, their fits, and a trial of one subject with each of them.

Everything is drawn from (seed, subject), the motion and its noise from the task too: the unit of the device, the bench, the
performance, the temperature. A dwell has the same draws in every protocol that has it, and the cut-off frequency changes the filter
alone, so that runs of one subject differ by what is tried and by nothing else. For all protocols of a unit at once::

    lay out the sessions -> simulate -> fit -> tables -> correct the trial -> orient -> compare with the true pitch

The session has the steps of ``undrift rig run``: faces at room temperature; then, for each axis mounted once, all set-points in
it: a rest, the rates both ways, a rest. The fit has the order of the note's Figure 2: static drift (not-a-knot splines over the
set-points' rests), the matrix (eq. 6) at the set-point nearest to room temperature, what is left over rate and temperature.
Faces come first, in every session alike, so the accelerometers are calibrated once.

A device and a bench may be without one kind of error, with the draws of all the others. What is switched off is zeroed and
not removed, so that it takes as many random numbers as before::

    noise                  white noise of both triads and of the thermometer; with it the converter's steps, which nothing would
                           dither any more
    gyroscope offset       zero-rate output with its drift over temperature and time (warm-up, hysteresis, flicker, random walk)
                           and under force (g-sensitivity)
    accelerometer offset   the same of the accelerometers
    scale                  sensitivity and its change with temperature, gains of the chain; rate and servo of the table
    cross-axis             axes and crosstalk; faces, mounting, level and wobble of the bench
    dynamic drift          what grows with the rate: non-linearity, asymmetry, rate drift
    delay                  how late the readings are: nothing of the device, the truth is taken as late (``delay_of_pitch``)
    quantisation           steps of converter, thermometer and encoder
"""

import json
import zlib
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Literal, cast, get_args

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray
from undrift.calibration.six_face import FaceMeans, fit_six_face
from undrift.correction.correct import correct_whole
from undrift.correction.rest import LEAST_IN_MOTION_S, rest_offset
from undrift.errors import AlignmentError, CalibrationError, InputError
from undrift.fit.least_squares import fit_forward, triad_from_forward
from undrift.model import Calibration, TriadModel
from undrift.orientation import IN_PLANE, initial_tilt, orient_unchecked, sagittal_pitch, shortest_rotation_up
from undrift.programme import DAMPING, Protocol
from undrift.record import FACES, Record, Reference, Still
from undrift.sim.bench_errors import BenchDraws, BenchErrors, draw_bench
from undrift.sim.device.effects import BUTTERWORTH, LowPass, SensorChain
from undrift.sim.device.model import DeviceModel, device_from_json
from undrift.sim.device.presets import preset, preset_grade, random_device_of
from undrift.sim.device.simulate import filtered, simulate_device
from undrift.sim.motion.motion import Motion, unit_vector
from undrift.sim.motion.tasks import DEFAULT, Subject, Task, TaskName, cohort, draw_task
from undrift.sim.table_sessions import (
    FACE,
    QUICKEST_HZ,
    RATE,
    REST,
    ROOM_TEMP_C,
    Sessions,
    board_readings,
    impose,
    impose_faces,
    joined,
    lay_out,
    mean_readings,
    numbers_of_dwell,
    turned,
    turned_about,
)
from undrift.study.plan import (
    ERRORS,
    SAMPLE_RATE_HZ,
    OffsetRule,
    OwnMotion,
    RecordedTask,
    Study,
    StudyTask,
    read_motion,
)
from undrift.study.space import TURN_RATES, Setting
from undrift.sync import lag_of, pose_rates
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY
from undrift.validation.trial import LAG_SETTINGS

# ---- effects switched off

EffectName = Literal[
    "noise", "gyroscope offset", "accelerometer offset", "scale", "cross-axis", "dynamic drift", "delay", "quantisation",
]  # fmt: skip
EFFECTS: tuple[EffectName, ...] = get_args(EffectName)

FINER_BITS = 16  # a converter of so many bits more has no steps to speak of
_OFFSET: dict[str, tuple[str, ...]] = {
    "offset": ("constant", "per_k"),
    "g_sensitivity": ("matrix",),
    "warm_up": ("amplitude",),
    "hysteresis": ("amplitude",),
    "instability": ("instability",),
    "random_walk": ("bias_walk",),
}
_OF_TRIAD: dict[str, EffectName] = {"gyro": "gyroscope offset", "accel": "accelerometer offset"}
# Fields of each of a chain's effects
_ZEROED: dict[EffectName, dict[str, tuple[str, ...]]] = {
    "noise": {"white_noise": ("random_walk",)},
    "scale": {"scale": ("error",), "thermal_scale": ("per_k",)},
    "dynamic drift": {"nonlinearity": ("quadratic", "cubic", "asymmetry"), "rate_drift": ("coefficients",)},
}
_BENCH: dict[EffectName, tuple[str, ...]] = {
    "scale": ("table_rate", "servo"),
    "cross-axis": ("face_tilt", "inclination", "mount_tilt", "level", "wobble"),
    "quantisation": ("encoder_lines",),
}


def device_without(device: DeviceModel, effect: EffectName) -> DeviceModel:
    """Return a device without one kind of error."""
    off: dict[str, Any] = {name: _chain_without(getattr(device, name), name, effect) for name in ("gyro", "accel")}
    thermometer = device.thermometer
    if effect == "noise":
        thermometer = replace(thermometer, noise_c=0.0)
    if effect == "quantisation":
        thermometer = replace(thermometer, step_c=0.0)
    return replace(device, **off, thermometer=thermometer)


def bench_without(errors: BenchErrors, effect: EffectName) -> BenchErrors:
    """Return a bench without one kind of error."""
    return replace(errors, **dict.fromkeys(_BENCH.get(effect, ()), 0))


def delay_of_pitch(device: DeviceModel, sample_rate_hz: float) -> float:
    """Return how late strapdown with a device's readings truly is about the axis of the pitch, s."""
    low_pass, sampling = device.gyro.low_pass, device.sampling
    late_s = 0.0 if low_pass is None else float(low_pass.group_delay_s[1])
    held_s = 0.5 / sample_rate_hz if sampling.gyro_averaging == "instant" else 0.0  # over the step before its stamp
    return late_s + float(sampling.gyro_delay_s[1]) - held_s


def _chain_without(chain: SensorChain, triad: str, effect: EffectName) -> SensorChain:
    off: dict[str, Any] = {}
    for name, fields in (_OFFSET if effect == _OF_TRIAD[triad] else _ZEROED.get(effect, {})).items():
        if (held := getattr(chain, name)) is not None:
            off[name] = replace(held, **{field: np.zeros_like(getattr(held, field)) for field in fields})
    if effect == "cross-axis":
        off["scale"] = replace(chain.scale, axes=np.eye(3), cross_axis=np.zeros((3, 3)))
    if effect in ("noise", "quantisation") and chain.adc is not None:
        off["adc"] = replace(chain.adc, bits=chain.adc.bits + FINER_BITS)
    return replace(chain, **off)


# ---- trial

WORN_S = 1800.0  # the device has been on for half an hour
REST_S = 6.0  # the note's initial rest
FINE_HZ = 800.0  # samples of a simulated motion that is sampled at another rate
LAG_STEP_S = 0.05  # between the poses that the delay is found by: what ``validate`` averages over


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Case:
    """A trial ready to be corrected and judged."""

    device: DeviceModel  # The subject's unit, with the filter of the case
    record: Record  # What it read in the trial
    pitch_now: FloatArray  # (N,), true sagittal pitch, rad
    pitch: FloatArray  # (N,), the same, as late as the readings are found to be
    delay_s: float  # How late that is, s
    still: tuple[int, int]  # Samples of the rest before
    moving: tuple[int, int]  # Samples of the motion
    sample_rate_hz: float = SAMPLE_RATE_HZ  # Hz


def seeded(study: Study, *words: str | int) -> np.random.Generator:
    """Return the generator of one part of a study."""
    keys = tuple(w if isinstance(w, int) else zlib.crc32(w.encode()) for w in words)
    return np.random.default_rng(np.random.SeedSequence(study.seed, spawn_key=keys))


def subject_of(study: Study, number: int, category: str = DEFAULT) -> Subject:
    """Return one subject of the study's cohort of a category; numbers beyond its end start again."""
    rng = seeded(study, "cohort", study.group, number // 30)
    people = cohort(study.group, rng=rng, category=study.kind(category))
    return people[number % len(people)]


@lru_cache(maxsize=2)
def device_of(study: Study, number: int) -> DeviceModel:
    """Return the device that a subject wears."""
    own = json.loads(study.worn or "null")
    return device_from_json(own) if own else random_device_of(study.device, seeded(study, "device", number))


def typical_unit(study: Study) -> DeviceModel:
    """Return the one device of the study, or the typical unit of its kind."""
    return device_of(study, 0) if study.worn else preset(study.device)


def perform(study: Study, task: StudyTask, number: int, trial: int = 0) -> tuple[Task | RecordedTask, Motion]:
    """Return what a subject does in a trial, and its motion at the samples of a record."""
    return _perform(study, task.name, task.category, task.motion and task.motion.of(number)[trial], number)


@lru_cache(maxsize=64)  # a cohort in two tasks: each stage has the same again
def _perform(
    study: Study, name: str, category: str, motion: OwnMotion | None, number: int
) -> tuple[Task | RecordedTask, Motion]:
    performed: Task | RecordedTask
    if motion is not None:
        performed = read_motion(motion)
    else:
        rng, person = seeded(study, "task", name, number), subject_of(study, number, category)
        performed = draw_task(cast("TaskName", name), rng=rng, subject=person, rest_s=REST_S)
    return performed, performed.at(_samples(performed), STANDARD_GRAVITY)


def _samples(performed: Task | RecordedTask) -> FloatArray:
    return np.arange(round(performed.duration_s * SAMPLE_RATE_HZ)) / SAMPLE_RATE_HZ


def make_case(
    study: Study, task: StudyTask, number: int, setting: Setting, without: EffectName | None = None, trial: int = 0
) -> Case:
    """Simulate a subject's trial with a device built for a setting out of the same parts.

    One of its effects may be switched off; in real time its delay is then not looked for.
    """
    device, rate_hz = unit_of(study, number, setting, without), setting.sample_rate_hz or SAMPLE_RATE_HZ
    performed, motion = perform(study, task, number, trial)
    name = f"{task.name} {trial + 1}" if trial else task.name
    if setting.sample_rate_hz is not None:
        device = replace(device, sampling=replace(device.sampling, sample_rate_hz=rate_hz))
        record = _record_of(study, name, number, device, _fine(performed))
        motion = performed.at(record.time, STANDARD_GRAVITY)
    elif device.sampling.on_grid:
        record = filtered(_unfiltered(study, name, motion, number, setting.gain, without), device)
    else:
        record = _record_of(study, name, number, device, motion)
    if without == "delay":
        late_s = delay_of_pitch(device, rate_hz)
    else:
        late_s = 0.0 if without and study.timing == "real time" else delay_of(record, motion.q_nb, rate_hz)
    case = _case_of(device, record, performed, motion, late_s, rate_hz)
    return replace(case, pitch_now=case.pitch) if without == "delay" else case


def _fine(performed: Task | RecordedTask) -> Motion:
    """Return the motion of a trial at ``FINE_HZ``, for a device that samples at another rate than the motion."""
    return performed.at(np.arange(round(performed.duration_s * FINE_HZ)) / FINE_HZ, STANDARD_GRAVITY)


def unit_of(study: Study, number: int, setting: Setting, without: EffectName | None = None) -> DeviceModel:
    """Return the device that a subject wears, of parts of its own and as it is set."""
    cutoff_hz, gain, quality, bits = setting.cutoff_hz, setting.gain, setting.quality, setting.bits
    device = device_of(study, number)
    grade, parts = None if study.worn else preset_grade(study.device), seeded(study, "chain", number)
    spread, chains = 0.0 if without == "scale" else study.chain_sd, dict[str, Any]()
    for name, chain in (("gyro", device.gyro), ("accel", device.accel)):
        if name == "gyro" and gain is not None and chain.amplifier is not None:
            chain = replace(chain, amplifier=replace(chain.amplifier, gain=gain))
        if bits is not None and chain.adc is not None:
            chain = replace(chain, adc=replace(chain.adc, bits=int(bits)))
        if not study.worn:
            of_gain, of_null, of_reference = 1.0 + spread * parts.standard_normal(3)
            if (held := chain.amplifier) is not None:  # without one the chain is one part
                adc = chain.adc and replace(chain.adc, reference=chain.adc.reference * of_reference)
                amplifier = replace(held, gain=held.gain * of_gain, null=held.null * of_null)
                chain = replace(chain, amplifier=amplifier, adc=adc)
        built = 1.0 if quality is None else quality / BUTTERWORTH
        low_pass = LowPass(cutoff_hz=np.full(3, cutoff_hz), quality=np.full(3, BUTTERWORTH * built))
        if (own := chain.low_pass) is not None:
            designed = float(np.median(own.cutoff_hz)) if grade is None else getattr(grade, name).cutoff_hz
            low_pass = LowPass(cutoff_hz=cutoff_hz * own.cutoff_hz / designed, quality=own.quality * built)
        chains[name] = replace(chain, low_pass=low_pass)
    device = replace(device, **chains)
    return device if without is None else device_without(device, without)


def _record_of(study: Study, task: str, number: int, device: DeviceModel, motion: Motion) -> Record:
    temp_c = ROOM_TEMP_C + float(seeded(study, "temperature", number).uniform(*study.excursion_k))
    rng = seeded(study, "noise", task, number)
    return simulate_device(device, motion, rng=rng, temp_c=temp_c, power_on_s=WORN_S).record


@lru_cache(maxsize=1)  # the cut-off frequencies of a subject follow each other
def _unfiltered(
    study: Study, task: str, motion: Motion, number: int, gain: float | None, without: EffectName | None
) -> Record:
    device = unit_of(study, number, Setting(1.0, gain), without)
    chains: Any = {name: replace(getattr(device, name), low_pass=None, adc=None) for name in ("gyro", "accel")}
    return _record_of(study, task, number, replace(device, **chains), motion)


def wear(
    device: DeviceModel, performed: Task | RecordedTask, *, rng: np.random.Generator, temp_c: float, power_on_s: float
) -> tuple[Case, float]:
    """Simulate a trial; return the share of samples in which a gyroscope was at the end of its range too."""
    motion = performed.at(_samples(performed), STANDARD_GRAVITY)
    made = simulate_device(device, motion, rng=rng, temp_c=temp_c, power_on_s=power_on_s)
    case = _case_of(device, made.record, performed, motion, delay_of(made.record, motion.q_nb))
    return case, float(made.gyro.saturated.any(axis=1).mean())


def _case_of(
    device: DeviceModel,
    record: Record,
    performed: Task | RecordedTask,
    motion: Motion,
    late_s: float,
    rate_hz: float = SAMPLE_RATE_HZ,
) -> Case:
    """Return the case of a record that is late by a time."""
    start, stop = (round(moment * rate_hz) for moment in performed.moving_s)
    pitch = sagittal_pitch(motion.q_nb)
    return Case(
        device=device,
        record=record,
        delay_s=late_s,
        pitch_now=pitch,
        pitch=_delayed(pitch, late_s * rate_hz),
        still=(0, max(start - round(0.2 * rate_hz), 2)),
        moving=(start, min(stop + 1, len(motion))),
        sample_rate_hz=rate_hz,
    )


def _delayed(pitch: FloatArray, samples: float) -> FloatArray:
    """Return a pitch (N,) as it was a time before each sample, rad; NaN near gaps."""
    from scipy.interpolate import CubicSpline

    known, place = np.isfinite(pitch), np.arange(len(pitch))
    if known.sum() < 2 or samples == 0.0:
        return pitch
    at = np.clip(place - samples, 0, len(pitch) - 1)
    found = np.asarray(CubicSpline(place[known], np.unwrap(pitch[known]))(at))
    found[~(known[np.floor(at).astype(int)] & known[np.ceil(at).astype(int)])] = np.nan
    return found


def delay_of(record: Record, q_nb: FloatArray, rate_hz: float = SAMPLE_RATE_HZ) -> float:
    """Return how late a record's pitch is against true poses (N, 4), as ``validate`` finds it; 0 where it cannot."""
    if record.gyro is None:
        return 0.0
    step = max(round(LAG_STEP_S * rate_hz), 1)
    poses = pose_rates(Reference(time=record.time[::step], q_nb=q_nb[::step]))
    try:
        lag_s = lag_of(record.time, record.gyro, poses, LAG_SETTINGS).seconds
    except AlignmentError:  # it moves too little for a delay to matter
        return 0.0
    return lag_s - 0.5 / rate_hz  # strapdown holds each reading over the step before its stamp


def pitch_error(case: Case, calibration: Calibration) -> FloatArray:
    """Return the error of the pitch that a calibrated device gives, (M,) rad."""
    corrected = correct_whole(case.record, calibration, policy="hold", threads=1).record
    found = orient_unchecked(corrected, Still(start=case.still[0], stop=case.still[1]))
    error = found.pitch - case.pitch
    error = (error + np.pi) % (2.0 * np.pi) - np.pi
    return error[case.moving[0] : case.moving[1]]


# ---- bench of a subject: the same draws for every protocol

KEY_STEP = 1e-9  # rad/s: rates nearer than this are one


def faces_of(
    study: Study, device: DeviceModel, number: int, sessions: Sessions, poses: Sequence[str] = ()
) -> TriadModel | None:
    """Return the accelerometers as the faces of a session, or stated poses, calibrate them; None without any."""
    if not len(sessions.kind):
        return None
    poses = tuple(poses or [FACES[face] for face in sessions.face])
    row, up, normals = _laid(study, number, numbers_of_dwell(device.accel), tuple(sessions.face.tolist()), poses)
    reading, unit = mean_readings(device, "accel", impose_faces(sessions, up), normals, row), device.accel.unit
    if set(poses) <= set(FACES):
        means = FaceMeans(reading=reading, faces=tuple(FACES[face] for face in row), unit=unit)
        return fit_six_face(means, gravity=STANDARD_GRAVITY, mode="affine").model
    forward = fit_forward(STANDARD_GRAVITY * np.array([unit_vector(pose) for pose in poses]), reading, None)
    limits, names = (-STANDARD_GRAVITY, STANDARD_GRAVITY), {"method": "poses", "unit_in": unit, "unit_out": "m/s2"}
    return triad_from_forward(forward, valid_range=limits, **names).model


@lru_cache(maxsize=64)  # the settings of a subject follow each other
def _laid(
    study: Study, number: int, width: int, faces: tuple[int, ...], poses: tuple[str, ...]
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Return the poses of a session as they are laid: the rows of their draws (N,), what truly points up (N, 3), and the draws."""
    tilt, normals = bench_of(study, number, 1, (0,)).face, seeded(study, "faces", number).standard_normal((6, 3, width))
    row, up = np.array(faces), np.array([unit_vector(pose) for pose in poses])
    for k, pose in enumerate(poses):
        if pose not in FACES:  # draws of its own, the same in every set that has it
            rng = seeded(study, f"pose {pose}", number)
            row[k], up[k] = len(tilt), unit_vector(pose, study.bench.inclination * rng.standard_normal())
            tilt = np.concatenate((tilt, rng.standard_normal((1, 3))))
            normals = np.concatenate((normals, rng.standard_normal((1, *normals.shape[1:]))))
    return row, turned(up, study.bench.face_tilt * tilt[row]), normals


def bench_of(study: Study, number: int, soaks: int, keys: Sequence[int]) -> BenchDraws:
    """Return the draws of the bench that calibrates a subject's device, for rests (key 0) and for rates of given keys."""
    turns = [seeded(study, "turns", number, key) for key in keys]
    return draw_bench(seeded(study, "bench", number), turns, soaks=soaks)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BenchReadings:
    """What a bench reads of N rests and rates."""

    gyro: FloatArray  # (N, 3), mean, raw unit
    rate: FloatArray  # (N,), of the table's encoder about the axis, rad/s
    temp_c: FloatArray  # (N,), of the board's thermometer, degC


def simulate_turns(
    study: Study, base: Protocol, device: DeviceModel, number: int, laid: Sessions, sessions: Sessions | None = None
) -> BenchReadings:
    """Simulate the rests and rates of sessions, variants of one protocol, on the bench that calibrates a subject's device.

    ``sessions`` are those that are laid, as they are with a low-pass.
    """
    sessions, width = sessions or laid, numbers_of_dwell(device.gyro)
    bench = study.bench if base.temperatures_c else replace(study.bench, soak_k=0.0, board_lag_s=0.0)  # no chamber
    row, normals, draws, about = _drawn(study, bench, number, width, laid)
    dwells = impose(sessions, bench, draws, about, soak_c_per_min=base.soak_c_per_min)
    return BenchReadings(
        gyro=mean_readings(device, "gyro", dwells, normals[:, :, :width], row),
        rate=about[2],
        temp_c=board_readings(device, dwells.temp_c, normals[row, 0, width]),
    )


@lru_cache(maxsize=16)  # the settings of a subject follow each other
def _drawn(
    study: Study, bench: BenchErrors, number: int, width: int, laid: Sessions
) -> tuple[IntArray, FloatArray, BenchDraws, tuple[FloatArray, FloatArray, FloatArray]]:
    """Return the row of each dwell among its normal numbers, those, the draws of the bench, and what it turns about."""
    soaks = int(laid.soak.max()) + 1
    size = np.round(np.abs(laid.rate) / KEY_STEP)
    keys = np.unique(size[size > 0.0])
    second = laid.rate < 0.0
    second[1:] |= (laid.kind[1:] == REST) & (laid.kind[:-1] == RATE)  # the rest after the rates
    block = np.where(size > 0.0, np.searchsorted(keys, size) + 1, 0)
    row = 6 * soaks * block + 2 * (soaks * laid.axis + laid.soak) + second
    every, shape = (0, *keys.astype(int).tolist()), (6 * soaks, 3, width + 1)  # rests have key 0
    normals = np.concatenate([seeded(study, "dwells", number, key).standard_normal(shape) for key in every])
    draws = bench_of(study, number, soaks, every)
    return row, normals, draws, turned_about(laid, bench, draws, row)


# ---- the note's calibration of many sessions, and the trial with each

STATIC_STEP_C, DYNAMIC_STEP_C = 0.5, 3.0  # the note's tuning table has a row every 0.5 degC


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NoteFits:
    """Calibrations of the gyroscopes from S sessions, as the kernels take them (kernels/note.py)."""

    static_c: FloatArray  # Nodes of the tables, degC; empty with one soak
    dynamic_c: FloatArray
    top: FloatArray  # (S,), greatest rate of the tables, rad/s
    half: IntArray  # (S,), their nodes above zero
    plane_first: IntArray  # (S + 1,)
    matrix: FloatArray  # (S, 9), rad/s per raw unit
    offset: FloatArray  # (S, 3), raw unit
    line: FloatArray  # (S, 6 cells)
    plane: FloatArray  # Flat
    good: BoolArray  # (S,), False where a session could not calibrate


def fit_as_the_note(
    sessions: Sessions,
    readings: BenchReadings,
    grids: FloatArray,
    table_steps_c: tuple[float, float] = (STATIC_STEP_C, DYNAMIC_STEP_C),
) -> NoteFits:
    """Fit the gyroscopes from S sessions whose rates go up to omega_M by a step, grids (S, 2) rad/s, to tables of two steps."""
    from undrift.kernels.note import fit_sessions

    count, soaks = len(grids), int(sessions.soak.max()) + 1
    ends = float(sessions.set_c.min()), float(sessions.set_c.max())
    static_c, dynamic_c = (
        np.linspace(*ends, max(round((ends[1] - ends[0]) / step), 1) + 1) if soaks > 1 else np.empty(0)
        for step in table_steps_c
    )
    half = np.ceil(grids[:, 0] / grids[:, 1] - 1e-9).astype(np.int64)
    sizes = 24 * half * max(len(dynamic_c) - 1, 0)
    fits = NoteFits(
        static_c=static_c,
        dynamic_c=dynamic_c,
        top=np.ascontiguousarray(grids[:, 0]),
        half=half,
        plane_first=np.concatenate(([0], np.cumsum(sizes))),
        matrix=np.zeros((count, 9)),
        offset=np.zeros((count, 3)),
        line=np.zeros((count, 6 * max(len(static_c) - 1, 0))),
        plane=np.zeros(sizes.sum()),
        good=np.zeros(count, dtype=bool),
    )
    turning = sessions.kind == RATE
    fit_sessions(
        readings.gyro, readings.rate, readings.temp_c, sessions.axis, sessions.soak, turning, sessions.first, ROOM_TEMP_C,
        soaks, static_c, dynamic_c, fits.top, half, fits.plane_first, fits.matrix, fits.offset, fits.line, fits.plane,
        fits.good,
    )  # fmt: skip
    return fits


END_S = 0.5  # before the motion's end, whose median error is that of the end


@lru_cache(maxsize=32)  # sessions with the same faces follow each other
def _levelled(case: Case, accel: TriadModel | None) -> Record:
    """Return what calibrated accelerometers make of a trial."""
    constant = Calibration(
        device="", reference_temp_c=ROOM_TEMP_C, gravity_m_s2=STANDARD_GRAVITY, gyro=None, accel=accel
    )
    return correct_whole(replace(case.record, gyro=None), constant, policy="hold", threads=1).record


@lru_cache(maxsize=32)  # as above
def _tilt_at_rest(case: Case, accel: TriadModel | None) -> FloatArray:
    """Return the tilt (4,) that calibrated accelerometers show at the rest of a trial."""
    if accel is None or case.record.accel is None:
        return initial_tilt(case.record, Still(start=case.still[0], stop=case.still[1])).q_nb
    mean = case.record.accel[slice(*case.still)].mean(axis=0)
    return shortest_rotation_up(accel.matrix @ (mean - accel.offset))


def trial_errors(case: Case, accels: Sequence[TriadModel | None], fits: NoteFits, offset: OffsetRule) -> FloatArray:
    """Return the pitch errors with each calibration in the order of ``ERRORS``, (S, 6) rad; NaN without one.

    The mean corrected rate of the rest before the motion is taken off; or what the motion shows from that rest on, by the estimator
    of ``orient``: it wants a trial of 20 s, a shorter one keeps the offset of the rest.
    """
    from undrift.kernels.note import corrected, pitch_errors

    gyro, temp_c, out = case.record.gyro, case.record.temp_c, np.full((len(fits.good), len(ERRORS)), np.nan)
    if gyro is None or temp_c is None:
        raise InputError("study: wanted rates and temperatures of the trial, got none")

    def rates_of(u: FloatArray, at_c: FloatArray) -> FloatArray:
        rates = np.empty((len(fits.good), u.size))
        corrected(
            u.reshape(-1), at_c, fits.static_c, fits.dynamic_c, fits.top, fits.half, fits.plane_first, fits.matrix,
            fits.offset, fits.line, fits.plane, rates,
        )  # fmt: skip
        return rates.reshape(len(rates), -1, 3)

    still = Still(start=case.still[0], stop=case.still[1])
    rest, moving = slice(*case.still), slice(case.still[1] - 1, case.moving[1])
    shown = offset == "motion" and case.record.duration_s >= LEAST_IN_MOTION_S
    rates = rates_of(gyro[moving], temp_c[moving])
    if shown:
        from undrift.correction.motion import find_motion_offset  # scipy and a kernel, for this alone

        for accel, each, whole in zip(accels, rates, rates_of(gyro, temp_c), strict=True):
            if np.isfinite(whole).all():
                record = replace(_levelled(case, accel), gyro=whole, gyro_unit="rad/s")
                each -= find_motion_offset(record, rest_offset(record, still)).at(record.time[moving])
    elif offset != "none":
        rates -= rates_of(gyro[rest].mean(axis=0), temp_c[rest].mean(keepdims=True))
    pitch, last = np.stack((case.pitch_now[moving], case.pitch[moving])), round(END_S * case.sample_rate_hz)
    pitch_errors(
        rates.reshape(len(rates), -1), case.record.time[moving], np.array([_tilt_at_rest(case, accel) for accel in accels]), pitch,
        case.moving[0] - moving.start, last, IN_PLANE, fits.good, out,
    )  # fmt: skip
    return out


# ---- unit of work

COLUMNS = ("cutoff_hz", *(f"{name}_dps" for name in TURN_RATES), *ERRORS, "rig_minutes")


@dataclass(frozen=True, slots=True, kw_only=True)
class Unit:
    """A subject in a task with a setting of the device."""

    study: Study  # Seed, device, temperatures
    task: StudyTask  # With its protocols
    subject: int  # From 0
    setting: Setting  # What is varied of the device
    without: EffectName | None = None  # Effect that is switched off

    @property
    def key(self) -> str:
        """Name of the unit, good for a file."""
        return f"{self.task.key}-{self.subject:04d}-{self.setting.words}"


def units_of(study: Study) -> tuple[Unit, ...]:
    """Return the units of a study."""
    return tuple(
        Unit(study=study, task=task, subject=subject, setting=setting)
        for task in study.tasks
        for subject in range(study.subjects)
        for setting in task.space.settings()
    )


def run_units(units: Sequence[Unit]) -> list[dict[str, FloatArray]]:
    """Run units that follow each other: what those of one subject share is made once."""
    return [run_unit(unit) for unit in units]


def run_unit(unit: Unit) -> dict[str, FloatArray]:
    """Run all candidates of a unit: an array (P,) for each column, errors NaN where the device was left uncalibrated."""
    task, setting = unit.task, unit.setting
    points, trials = task.space.points_at(setting), len(task.motion.of(unit.subject)) if task.motion else 1
    cases = [make_case(unit.study, task, unit.subject, setting, unit.without, trial) for trial in range(trials)]
    runs = columns_of(task, points) | {name: np.full(len(points), np.nan) for name in COLUMNS[4:]}
    models = dict[object, TriadModel | None]()
    for group in alike(task, setting._replace(cutoff_hz=QUICKEST_HZ)):
        runs["rig_minutes"][group.places], errors = errors_with(unit, cases, group, models)
        for name, column in zip(ERRORS, errors.T / RADIAN_PER_DEGREE, strict=True):
            runs[name][group.places] = column
    return runs


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Alike:
    """Candidates that are simulated and fitted at once: alike in set-points and tables."""

    places: IntArray  # (P,), of the task's
    base: Protocol  # One of them
    laid: Sessions  # Their rests and rates, with the shortest settling
    faces: dict[object, tuple[Sessions, tuple[str, ...]]]  # Their sets of faces, and the poses of each, by a key
    keys: list[object]  # (P,), which set each has
    grids: FloatArray  # (P, 2), omega_M and step of each, rad/s
    table_steps_c: tuple[float, float]  # Of the static and the dynamic table, K


@lru_cache(maxsize=64)  # of the tasks of a study, and of what is run again of each: the same for every subject
def alike(task: StudyTask, setting: Setting) -> tuple[Alike, ...]:
    """Return the candidates with a setting of the device, by what is simulated and fitted at once."""
    points, groups = task.space.points_at(setting), list[Alike]()
    names = ("places", "set_points", "warmest_c", "soak_c_per_min", "static_step_c", "dynamic_step_c")
    columns = [k for k, name in enumerate(task.space.names) if name in names]
    group = np.unique(points[:, columns], axis=0, return_inverse=True)[1].ravel() if columns else np.zeros(len(points))
    for each in np.unique(group):
        places = np.flatnonzero(group == each)
        protocols = [task.protocol_of(point) for point in points[places]]
        sessions = [lay_out(protocol) for protocol in protocols]
        keys: list[object] = [(each.faces, each.face_s) for each in protocols]
        sets = zip(keys, sessions, protocols, strict=True)
        stated = dict(zip(task.space.names, map(float, points[places[0]]), strict=True))
        one = Alike(
            places=places,
            base=protocols[0],
            laid=joined(sessions).chosen(REST, RATE),
            faces={key: (session.chosen(FACE), protocol.faces) for key, session, protocol in sets},
            keys=keys,
            grids=np.array([(p.turn_rate_max, p.turn_rate_step) for p in protocols]),
            table_steps_c=(stated.get("static_step_c", STATIC_STEP_C), stated.get("dynamic_step_c", DYNAMIC_STEP_C)),
        )
        groups.append(one)
    return tuple(groups)


def errors_with(
    unit: Unit, cases: Sequence[Case], group: Alike, models: dict[object, TriadModel | None]
) -> tuple[FloatArray, FloatArray]:
    """Calibrate a device by candidates that are alike; return minutes (P,) and pitch errors, means over its trials, (P, 6) rad.

    The accelerometers of the unit, by their faces, are kept in ``models``.
    """
    study, device, keys, settled = unit.study, cases[0].device, group.keys, settling_of(unit.setting)
    if unit.without is not None:
        study = replace(study, bench=bench_without(study.bench, unit.without))
    for key, (faces, poses) in group.faces.items():
        if key not in models:
            with suppress(CalibrationError):  # it cannot calibrate this device: no error to report, and not a zero
                models[key] = faces_of(study, device, unit.subject, faces.settling(*settled), poses)
    sessions = group.laid.settling(*settled)
    if not models:
        return sessions.length_s / 60.0, np.full((len(keys), len(ERRORS)), np.nan)
    accels = [models.get(key, next(iter(models.values()))) for key in keys]
    readings = simulate_turns(study, group.base, device, unit.subject, group.laid, sessions)
    fits = fit_as_the_note(sessions, readings, group.grids, group.table_steps_c)
    fits.good[[key not in models for key in keys]] = False
    return sessions.length_s / 60.0, np.mean([trial_errors(case, accels, fits, study.offset) for case in cases], axis=0)


def settling_of(setting: Setting) -> tuple[float, float]:
    """Return the cut-off frequency that a session settles with, Hz, and its damping."""
    return setting.cutoff_hz, DAMPING if setting.quality is None else 0.5 / setting.quality


def session_of(protocol: Protocol, quality: float | None = None) -> Sessions:
    """Return the session of a protocol, laid out once whatever its filter."""
    laid = lay_out(replace(protocol, cutoff_hz=QUICKEST_HZ))
    return laid.settling(*settling_of(Setting(protocol.cutoff_hz, quality=quality)))


def columns_of(task: StudyTask, points: FloatArray) -> dict[str, FloatArray]:
    """Return what is varied, an array (P,) for each name of the surface's columns."""
    columns = dict(zip(task.space.names, points.T.copy(), strict=True))
    return {
        f"{n}_dps" if n in TURN_RATES else n: v / RADIAN_PER_DEGREE if n in TURN_RATES else v
        for n, v in columns.items()
    }
