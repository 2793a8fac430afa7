"""A run of a study: a calibration session, the fit, and a trial of one subject, all with one simulated device.

Everything is drawn from (seed, task, subject): the unit of the device, the performance, the temperature, the noise. The cut-off
frequency changes the filter alone, so that cases of one subject differ by it and by nothing else. For each protocol::

    simulate the session -> fit -> tables -> correct the trial -> orient -> compare with the true pitch

Nothing but the readings passes from the simulated device to the fit. The session has the steps of ``undrift rig run``: faces at
room temperature; then, for each axis mounted once, all set-points in it: a rest, the rates both ways, a rest. Between dwells
the chamber soaks, the table accelerates and the filter settles, while the offset drifts.

The fit has the order of the note's Figure 2: static drift (not-a-knot splines over the set-points' rests), the matrix (eq. 6)
at the set-point nearest to room temperature, what is left over rate and temperature (bicubic spline).

A recorded motion must begin at rest. Three figures of its first ``rest_s`` seconds, rates and accelerations as means over 0.25 s::

    w    |mean of w_b|                          how fast the body turns
    a    |mean of p''|                          how fast its velocity changes
    e    angle(mean of f_b, R_nb^T z)           tilt error of a device without errors at the end of that time
"""

import hashlib
import json
import zlib
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import cast

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.calibration.six_face import FaceMeans, SixFaceSettings, fit_six_face
from undrift.correction.correct import correct_checked
from undrift.drift.observe import RateSteps, RestBlocks
from undrift.errors import CalibrationError, InputError, NotObservable
from undrift.fit.least_squares import fit_paper
from undrift.fit.smooth import not_a_knot
from undrift.frames import quaternion_conjugate, rotate
from undrift.io.formats import read_markers, read_reference
from undrift.io.mocap import Up
from undrift.io.reference import L5_OFFSET, BodyName, device_on, find_body
from undrift.model import Calibration, DriftTables, DynamicDrift, StaticDrift, TriadModel
from undrift.orientation import orient, sagittal_pitch
from undrift.record import FACES, Face, Record, Reference, Still
from undrift.rig.programme import Dwell, Protocol, Purpose, programme_of
from undrift.sim.device.effects import LowPass
from undrift.sim.device.model import DeviceModel, device_from_json
from undrift.sim.device.presets import random_device_of
from undrift.sim.device.simulate import DwellReadings, Dwells, simulate_device, simulate_dwells
from undrift.sim.motion.motion import Motion
from undrift.sim.motion.poses import PoseSettings, PoseSpline, fit_pose_spline
from undrift.sim.motion.tasks import Subject, Task, TaskName, cohort, draw_task
from undrift.study.plan import OwnMotion, Study, StudyTask
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

# ---- calibration session

WARMED_UP_S = 1800.0  # the bench waits half an hour after power-on
ROOM_TEMP_C = 25.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Imposed:
    """What a session imposes, N dwells."""

    dwells: Dwells  # Times, rates, forces, temperatures
    kind: IntArray  # (N,), 0 a face, 1 a rest at zero rate, 2 a steady rate
    soak: IntArray  # (N,), which set-point
    faces: tuple[Face, ...]  # Axis that points up, for each dwell
    duration_s: float  # Of the whole session on the rig, s


FACE, REST, RATE = 0, 1, 2
KINDS: dict[Purpose, int] = {"face": FACE, "bracket": REST, "rate": RATE}


def impose(protocol: Protocol, *, gravity_m_s2: float = STANDARD_GRAVITY) -> Imposed:
    """Lay out the dwells of a protocol."""
    if protocol.turn_rate_step <= 0.0:
        raise InputError("study: wanted a protocol with rates, got none; state turn_rate_step and the two ends")
    steps = [*programme_of(replace(protocol, faces=())).steps]
    if protocol.faces:
        steps = [*programme_of(replace(protocol, turn_rate_step=0.0, temperatures_c=())).steps, *steps]
    temperatures = protocol.temperatures_c or (ROOM_TEMP_C,)
    rows: list[tuple[float, Dwell]] = []
    clock = WARMED_UP_S
    for step in steps:
        if isinstance(step, Dwell):
            rows.append((clock + step.ramp_s + step.settle_s, step))
        clock += step.duration_s
    dwells = [dwell for _, dwell in rows]
    warm = [ROOM_TEMP_C if dwell.temp_c is None else dwell.temp_c for dwell in dwells]
    return Imposed(
        dwells=Dwells(
            start_s=np.array([start for start, _ in rows]),
            duration_s=np.array([dwell.dwell_s for dwell in dwells]),
            rate_b=np.array([_rate(dwell) for dwell in dwells]),
            force_b=np.array([_force(dwell.up, gravity_m_s2) for dwell in dwells]),
            temp_c=np.array(warm),
        ),
        kind=np.array([KINDS[dwell.purpose] for dwell in dwells]),
        soak=np.array(
            [0 if dwell.purpose == "face" else temperatures.index(t) for dwell, t in zip(dwells, warm, strict=True)]
        ),
        faces=tuple(dwell.up for dwell in dwells),
        duration_s=clock - WARMED_UP_S,
    )


def rest_blocks(imposed: Imposed, readings: DwellReadings) -> RestBlocks:
    """Return the rests at zero rate as the drift fits take them."""
    at = np.flatnonzero(imposed.kind == REST)
    count = readings.samples[at, None]
    middle = imposed.dwells.start_s[at] + 0.5 * imposed.dwells.duration_s[at]
    return RestBlocks(
        session=np.zeros(len(at), dtype=np.int64),
        pose=np.array([FACES.index(imposed.faces[i]) for i in at], dtype=np.int64),
        time=middle,
        power_on_s=middle,
        temp_c=readings.temp_c[at],
        ramp_c_per_min=np.zeros(len(at)),
        gyro=readings.gyro[at],
        accel=readings.accel[at],
        gyro_variance=readings.gyro_variance[at] / count,
        accel_variance=readings.accel_variance[at] / count,
    )


def rate_steps(imposed: Imposed, readings: DwellReadings) -> RateSteps:
    """Return the dwells at a steady rate as the drift fits take them."""
    at = np.flatnonzero(imposed.kind == RATE)
    return RateSteps(
        session=np.zeros(len(at), dtype=np.int64),
        soak=imposed.soak[at],
        time=imposed.dwells.start_s[at] + 0.5 * imposed.dwells.duration_s[at],
        temp_c=readings.temp_c[at],
        rate_b=imposed.dwells.rate_b[at],
        gyro=readings.gyro[at],
        accel=readings.accel[at],
        gyro_variance=readings.gyro_variance[at] / readings.samples[at, None],
    )


def read_session(imposed: Imposed, device: DeviceModel, *, rng: np.random.Generator) -> DwellReadings:
    """Return the readings of a device in a session, one row a dwell."""
    return simulate_dwells(device, imposed.dwells, rng=rng, felt=imposed.kind == FACE)


def _rate(dwell: Dwell) -> FloatArray:
    rate = np.zeros(3)
    if dwell.axis is not None:
        rate["xyz".index(dwell.axis)] = dwell.turn_rate
    return rate


def _force(face: Face, gravity_m_s2: float) -> FloatArray:
    force = np.zeros(3)
    force["xyz".index(face[1])] = gravity_m_s2 if face[0] == "+" else -gravity_m_s2
    return force


# ---- rest at the beginning of a recorded motion

SAMPLE_RATE_HZ = 100.0
WINDOW_S = 0.25
LEAST_REST_S = 0.5  # the tilt at the start is a mean over the rest
# People who stand quietly keep to 1.4 deg/s, 0.03 m/s2 and 0.6 deg over 5 s at the pelvis; who has begun to rise is at 10 deg/s.
MOST_TURN_RATE = 5.0 * RADIAN_PER_DEGREE  # rad/s
MOST_ACCELERATION = 0.3  # m/s2
MOST_TILT_ERROR = 1.0 * RADIAN_PER_DEGREE  # rad


@dataclass(frozen=True, slots=True, kw_only=True)
class Rest:
    """How still a body is for a time from the first pose on, and how long it is."""

    turn_rate: float  # Largest, rad/s
    acceleration: float  # Largest, m/s2
    tilt_error: float  # Of a device without errors, at the end of the time, rad
    still_s: float  # How long the body truly is still, s


def measure_rest(spline: PoseSpline, rest_s: float) -> Rest:
    """Measure how still a body is at the beginning of its poses."""
    start, stop = spline.span_s
    count = int((stop - start) * SAMPLE_RATE_HZ)
    motion = spline.at(start + np.arange(count) / SAMPLE_RATE_HZ, STANDARD_GRAVITY)
    swing = rotate(motion.q_nb, motion.force_b) - np.array([0.0, 0.0, STANDARD_GRAVITY])
    # by the number of samples since the first pose: what the time up to there shows
    rate, acceleration = (np.maximum.accumulate(_windowed(x)) for x in (motion.rate_b, swing))
    up = rotate(quaternion_conjugate(motion.q_nb), np.array([0.0, 0.0, 1.0]))
    mean = np.cumsum(motion.force_b, axis=0)
    apart = np.linalg.norm(np.cross(mean, up), axis=1)
    tilt = np.arctan2(apart, (mean * up).sum(axis=1))
    kept = (rate <= MOST_TURN_RATE) & (acceleration <= MOST_ACCELERATION) & (tilt <= MOST_TILT_ERROR)
    last = min(round(rest_s * SAMPLE_RATE_HZ), count) - 1
    return Rest(
        turn_rate=float(rate[last]),
        acceleration=float(acceleration[last]),
        tilt_error=float(tilt[last]),
        still_s=(int(np.flatnonzero(kept)[-1]) + 1) / SAMPLE_RATE_HZ if kept.any() else 0.0,
    )


def check_rest(spline: PoseSpline, rest_s: float, path: Path) -> None:
    """Refuse a motion that does not begin with the rest that is stated."""
    found = measure_rest(spline, rest_s)
    figures = np.array([found.turn_rate, found.acceleration, found.tilt_error])
    if (figures <= (MOST_TURN_RATE, MOST_ACCELERATION, MOST_TILT_ERROR)).all():
        return
    still_s = np.floor(10.0 * found.still_s) / 10.0
    todo = (
        f"set rest_s = {still_s:g}"
        if still_s >= LEAST_REST_S
        else f"take a recording that begins with {LEAST_REST_S:g} s at rest or more, or set hold = true and rest_s = 6"
    )
    raise InputError(
        f"{path}: wanted a body at rest for its first rest_s = {rest_s:g} s, got one that turns at up to "
        f"{found.turn_rate / RADIAN_PER_DEGREE:.3g} deg/s and accelerates by up to {found.acceleration:.2g} m/s2 (at rest: "
        f"{MOST_TURN_RATE / RADIAN_PER_DEGREE:g} and {MOST_ACCELERATION:g}), for which the first tilt alone would be wrong by "
        f"{found.tilt_error / RADIAN_PER_DEGREE:.1f} deg; it is still for {still_s:g} s: {todo}",
        turn_rate=found.turn_rate,
        acceleration=found.acceleration,
        tilt_error=found.tilt_error,
        still_s=found.still_s,
    )


def _windowed(values: FloatArray) -> FloatArray:
    """Return the size of the mean over the window that ends at each sample; over what there is before the first whole one."""
    n, width = len(values), max(round(WINDOW_S * SAMPLE_RATE_HZ), 1)
    total = np.concatenate((np.zeros((1, 3)), np.cumsum(values, axis=0)))
    ends = np.arange(1, n + 1)
    first = np.maximum(ends - width, 0)
    size: FloatArray = np.linalg.norm((total[ends] - total[first]) / (ends - first)[:, None], axis=1)
    size[: min(width, n) - 1] = 0.0  # a shorter mean would let the noise of cameras count
    return size


# ---- recorded motion as a task

SKIN = PoseSettings(cutoff_hz=10.0, position_cutoff_hz=6.0)  # markers on skin: what is above is not the bone


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RecordedTask:
    """A recorded motion as a task."""

    spline: PoseSpline  # The poses
    moving_s: tuple[float, float]  # First and last instant of motion, s from the beginning
    held_s: float = 0.0  # How long the first pose is held before the recording begins, s

    @property
    def duration_s(self) -> float:
        """Length, s."""
        start, stop = self.spline.span_s
        return self.held_s + stop - start

    def at(self, time: FloatArray, gravity_m_s2: float) -> Motion:
        """Return the motion at given instants: time (N,)."""
        start = self.spline.span_s[0]
        motion = replace(self.spline.at(time - self.held_s + start, gravity_m_s2), time=time)
        if self.held_s == 0.0:
            return motion
        first = self.spline.at(np.array([start]), gravity_m_s2).q_nb
        up = rotate(quaternion_conjugate(first), np.array([0.0, 0.0, gravity_m_s2]))
        rows, swing = (time < self.held_s)[:, None], motion.angular_acceleration_b
        return replace(
            motion,
            q_nb=np.where(rows, first, motion.q_nb),
            rate_b=np.where(rows, 0.0, motion.rate_b),
            mean_rate_b=np.where(rows, 0.0, motion.mean_rate_b),
            force_b=np.where(rows, up, motion.force_b),
            moving=np.where(rows[:, 0], 0.0, motion.moving),
            angular_acceleration_b=None if swing is None else np.where(rows, 0.0, swing),
            valid=np.where(rows[:, 0], 1.0, motion.valid),
        )


@lru_cache(maxsize=4)
def read_motion(own: OwnMotion) -> RecordedTask:
    """Read a recorded motion, and refuse one that does not begin with the rest that is stated."""
    if sha256_of(Path(own.path)) != own.sha256:
        raise InputError(
            f"{own.path}: wanted the file that the study began with, got another content; start a new study"
        )
    reference = read_poses(Path(own.path), body=own.body, markers=own.markers, up=own.up)
    spline = fit_pose_spline(reference, SKIN if own.body else PoseSettings())
    if reference.position is None:
        raise InputError(
            f"{own.path}: wanted poses with positions, got none; accelerometers cannot be simulated without them"
        )
    if len(spline.pieces) > 1:
        raise InputError(
            f"{own.path}: wanted poses without long gaps, got {len(spline.pieces) - 1}; cut the recording between gaps"
        )
    length = spline.span_s[1] - spline.span_s[0]
    if own.hold:
        if own.rest_s < LEAST_REST_S:
            raise InputError(
                f"{own.path}: wanted a rest_s of {LEAST_REST_S:g} s or more to hold the first pose for, got {own.rest_s:g}; "
                "6 is the note's"
            )
        return RecordedTask(spline=spline, moving_s=(own.rest_s, own.rest_s + length), held_s=own.rest_s)
    if not LEAST_REST_S <= own.rest_s < length - 1.0:
        raise InputError(
            f"{own.path}: wanted a rest_s of {LEAST_REST_S:g} s to {length - 1.0:.1f} s, got {own.rest_s:g}; state how long the "
            "body is at rest at the beginning"
        )
    check_rest(spline, own.rest_s, Path(own.path))
    return RecordedTask(spline=spline, moving_s=(own.rest_s, length))


def read_poses(path: Path, *, body: BodyName | None, markers: tuple[str, ...], up: Up | None) -> Reference:
    """Read the poses of a cluster or file, or of a device on a segment: at L5 on a pelvis, at the origin of another."""
    if body is None:
        return read_reference(path, labels=markers or None, up=up)
    if markers or up is None:
        raise InputError(f"{path}: wanted a body and up, got {'markers too' if markers else 'no up'}; name the two")
    offset = L5_OFFSET if body == "pelvis" else (0.0, 0.0, 0.0)
    return device_on(find_body(read_markers(path, up=up), body), offset_b=offset)


def sha256_of(path: Path) -> str:
    """Return the mark of a file's content."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise InputError(f"{path}: wanted a file of poses or markers, got {error.strerror}; check the path") from error


# ---- trial

WORN_S = 1800.0  # the device has been on for half an hour
REST_S = 6.0  # the note's initial rest


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Case:
    """A trial ready to be corrected and judged."""

    device: DeviceModel  # The subject's unit, with the filter of the case
    record: Record  # What it read in the trial
    pitch: FloatArray  # (N,), true sagittal pitch, delayed by the filter as a reference is before it is compared, rad
    still: tuple[int, int]  # Samples of the rest before
    moving: tuple[int, int]  # Samples of the motion


def seeded(study: Study, *words: str | int) -> np.random.Generator:
    """Return the generator of one part of a study."""
    keys = tuple(w if isinstance(w, int) else zlib.crc32(w.encode()) for w in words)
    return np.random.default_rng(np.random.SeedSequence(study.seed, spawn_key=keys))


def subject_of(study: Study, number: int) -> Subject:
    """Return one subject of the study's cohort; numbers beyond its end start again."""
    people = cohort(study.group, rng=seeded(study, "cohort", study.group, number // 30))
    return people[number % len(people)]


def with_cutoff(device: DeviceModel, cutoff_hz: float) -> DeviceModel:
    """Return a device whose filters were built for another cut-off frequency, out of the same parts."""
    made = []
    for chain in (device.gyro, device.accel):
        held = chain.low_pass
        if held is None:
            low_pass = LowPass(cutoff_hz=np.full(3, cutoff_hz))
        else:
            error = held.cutoff_hz / float(np.median(held.cutoff_hz))
            low_pass = LowPass(cutoff_hz=cutoff_hz * error, quality=held.quality)
        made.append(replace(chain, low_pass=low_pass))
    return replace(device, gyro=made[0], accel=made[1])


def device_of(study: Study, number: int) -> DeviceModel:
    """Return the device that a subject wears."""
    if study.worn:
        return device_from_json(json.loads(study.worn))
    return random_device_of(study.device, seeded(study, "device", number))


def perform(study: Study, task: StudyTask, number: int) -> Task | RecordedTask:
    """Return what a subject does."""
    if task.motion is not None:
        return read_motion(task.motion)
    return draw_task(
        cast("TaskName", task.name),
        rng=seeded(study, "task", task.name, number),
        subject=subject_of(study, number),
        rest_s=REST_S,
    )


def make_case(study: Study, task: StudyTask, number: int, cutoff_hz: float) -> Case:
    """Simulate a subject's trial."""
    device = with_cutoff(device_of(study, number), cutoff_hz)
    performed = perform(study, task, number)
    time = np.arange(round(performed.duration_s * SAMPLE_RATE_HZ)) / SAMPLE_RATE_HZ
    warmer = float(seeded(study, "temperature", number).uniform(*study.excursion_k))
    record = simulate_device(
        device,
        performed.at(time, STANDARD_GRAVITY),
        rng=seeded(study, "noise", task.name, number),
        temp_c=ROOM_TEMP_C + warmer,
        power_on_s=WORN_S,
    ).record
    start, stop = (round(moment * SAMPLE_RATE_HZ) for moment in performed.moving_s)
    return Case(
        device=device,
        record=record,
        pitch=_delayed_pitch(performed, time, device),
        still=(0, max(start - round(0.2 * SAMPLE_RATE_HZ), 2)),
        moving=(start, min(stop + 1, len(time))),
    )


def pitch_error(case: Case, calibration: Calibration) -> FloatArray:
    """Return the error of the pitch that a calibrated device gives, (M,) rad."""
    corrected = correct_checked(case.record, calibration, policy="hold", threads=1).record
    found = orient(corrected, Still(start=case.still[0], stop=case.still[1]))
    error = found.pitch - case.pitch
    error = (error + np.pi) % (2.0 * np.pi) - np.pi
    return error[case.moving[0] : case.moving[1]]


def _delayed_pitch(performed: Task | RecordedTask, time: FloatArray, device: DeviceModel) -> FloatArray:
    low_pass = device.gyro.low_pass
    delay = 0.0 if low_pass is None else float(np.median(low_pass.group_delay_s))
    if device.sampling.gyro_averaging == "instant":  # strapdown holds a reading over the step before its stamp
        delay -= 0.5 / SAMPLE_RATE_HZ
    return sagittal_pitch(performed.at(time - delay, STANDARD_GRAVITY).q_nb)


# ---- the note's calibration

NODES_C = np.linspace(18.0, 75.0, 115)  # the note's tuning table: every 0.5 degC


@dataclass(frozen=True, slots=True, kw_only=True)
class NoteSettings:
    """Which of the note's corrections are made."""

    static: bool = True  # Table of offsets over temperature
    dynamic: bool = True  # Table of rate errors over rate and temperature


def calibrate_as_the_note(
    imposed: Imposed,
    readings: DwellReadings,
    *,
    unit_gyro: str,
    unit_accel: str,
    settings: NoteSettings = NoteSettings(),
) -> Calibration:
    """Calibrate a device from the dwells of a session."""
    rests, steps = rest_blocks(imposed, readings), rate_steps(imposed, readings)
    if not len(rests):
        raise NotObservable("study: wanted rests at zero rate, got none; set bracket_s")
    soaks = np.unique(imposed.soak)
    temps, offsets, variances = _offsets(imposed, rests, soaks)
    home = int(np.argmin(np.abs(temps - ROOM_TEMP_C)))
    gyro = _matrix(steps, soaks[home], offsets[home], variances[home], unit_gyro)
    drift = None
    if len(soaks) > 1 and settings.static:
        curve = not_a_knot(temps, offsets, variances, NODES_C)
        static = StaticDrift(
            temp_c=NODES_C,
            gyro_offset=curve.value,
            gyro_extrapolated=np.abs(NODES_C - np.clip(NODES_C, temps[0], temps[-1])) > 0.5,
        )
        dynamic = _dynamic(steps, soaks, temps, offsets, gyro) if settings.dynamic else None
        drift = DriftTables(static=static, dynamic=dynamic)
    return Calibration(
        device="",
        reference_temp_c=float(temps[home]),
        gravity_m_s2=STANDARD_GRAVITY,
        gyro=gyro,
        accel=_accel(imposed, readings, unit_accel),
        drift=drift,
    )


def _offsets(imposed: Imposed, rests: RestBlocks, soaks: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    soak = imposed.soak[imposed.kind == REST]
    temps = np.array([rests.temp_c[soak == s].mean() for s in soaks])
    means = np.array([rests.gyro[soak == s].mean(axis=0) for s in soaks])
    variances = np.array([rests.gyro_variance[soak == s].sum(axis=0) / (soak == s).sum() ** 2 for s in soaks])
    return temps, means, variances


def _matrix(steps: RateSteps, soak: int, offset: FloatArray, variance: FloatArray, unit: str) -> TriadModel:
    rows = steps.soak == soak
    fit = fit_paper(
        steps.rate_b[rows],
        steps.gyro[rows] - offset,
        np.sqrt(steps.gyro_variance[rows]),
        method="rate-table/paper",
        unit_in=unit,
        unit_out="rad/s",
    )
    covariance = fit.model.covariance.copy()
    covariance[9:12, 9:12] = np.diag(variance)
    return replace(fit.model, offset=offset, covariance=covariance)


def _dynamic(
    steps: RateSteps, soaks: IntArray, temps: FloatArray, offsets: FloatArray, gyro: TriadModel
) -> DynamicDrift:
    """Bicubic: at each set-point a spline over the measured rate, then one over temperature at each node."""
    from scipy.interpolate import CubicSpline

    imposed = np.unique(np.round(np.abs(steps.rate_b).max(axis=1), 12))
    nodes = np.concatenate((-imposed[::-1], [0.0], imposed))
    error = np.zeros((len(soaks), len(nodes), 3))
    for k, soak in enumerate(soaks):
        rows = steps.soak == soak
        measured = (steps.gyro[rows] - offsets[k]) @ gyro.matrix.T
        for axis in range(3):
            own = np.abs(steps.rate_b[rows, axis]) > 0.0
            rate = np.concatenate((measured[own, axis], [0.0]))
            left = np.concatenate((measured[own, axis] - steps.rate_b[rows, axis][own], [0.0]))
            order = np.argsort(rate)
            curve = CubicSpline(rate[order], left[order], bc_type="not-a-knot")
            error[k, :, axis] = curve(np.clip(nodes, rate[order[0]], rate[order[-1]]))
    table_temps = np.unique(np.concatenate((temps, NODES_C[::10])))
    table_temps = table_temps[(table_temps >= temps[0]) & (table_temps <= temps[-1])]
    over_temp = CubicSpline(temps, error, axis=0, bc_type="not-a-knot") if len(temps) > 1 else None
    return DynamicDrift(
        temp_c=table_temps,
        turn_rate=nodes,
        error=np.repeat(error, 2, axis=0) if over_temp is None else over_temp(table_temps),
    )


def _accel(imposed: Imposed, readings: DwellReadings, unit: str) -> TriadModel | None:
    at = np.flatnonzero(imposed.kind == FACE)
    if not len(at):
        return None
    poses = FaceMeans(
        reading=readings.accel[at],
        faces=tuple(imposed.faces[i] for i in at),
        noise=np.sqrt(readings.accel_variance[at] / readings.samples[at, None]),
        unit=unit,
    )
    return fit_six_face(poses, gravity=STANDARD_GRAVITY, settings=SixFaceSettings(mode="affine")).model


# ---- unit of work

COLUMNS = (
    "cutoff_hz",
    "turn_rate_step_dps",
    "turn_rate_min_dps",
    "turn_rate_max_dps",
    "error_rms_deg",
    "error_max_deg",
    "rig_minutes",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Unit:
    """A subject in a task with a cut-off frequency."""

    study: Study  # Seed, device, temperatures
    task: StudyTask  # With its protocols
    subject: int  # From 0
    cutoff_hz: float  # Hz

    @property
    def key(self) -> str:
        """Name of the unit, good for a file."""
        return f"{self.task.name}-{self.subject:04d}-{self.cutoff_hz:g}"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class UnitRuns:
    """Runs of a unit, one for each protocol."""

    cutoff_hz: FloatArray  # (P,)
    turn_rate_step_dps: FloatArray  # (P,)
    turn_rate_min_dps: FloatArray  # (P,)
    turn_rate_max_dps: FloatArray  # (P,)
    error_rms_deg: FloatArray  # (P,), of the pitch over the motion; NaN where the device was left uncalibrated
    error_max_deg: FloatArray  # (P,), as above
    rig_minutes: FloatArray  # (P,), length of the session


def units_of(study: Study) -> tuple[Unit, ...]:
    """Return the units of a study."""
    return tuple(
        Unit(study=study, task=task, subject=subject, cutoff_hz=cutoff)
        for task in study.tasks
        for subject in range(study.subjects)
        for cutoff in task.space.cutoff_hz
    )


def run_unit(unit: Unit) -> UnitRuns:
    """Run all protocols of a unit."""
    study, protocols = unit.study, unit.task.candidates(unit.cutoff_hz)
    numbers = [number for number, _ in unit.task.space.numbered_grids()]  # a protocol has one noise in every search
    case = make_case(study, unit.task, unit.subject, unit.cutoff_hz)
    rms, worst, minutes = (np.full(len(protocols), np.nan) for _ in range(3))
    for k, protocol in enumerate(protocols):
        rng = seeded(study, "session", unit.task.name, unit.subject, numbers[k])
        imposed = impose(protocol)
        minutes[k] = imposed.duration_s / 60.0
        readings = read_session(imposed, case.device, rng=rng)
        try:
            calibration = calibrate_as_the_note(
                imposed, readings, unit_gyro=case.device.gyro.unit, unit_accel=case.device.accel.unit
            )
        except CalibrationError:  # this protocol cannot calibrate this device: no error to report, and not a zero
            continue
        error = pitch_error(case, calibration) / RADIAN_PER_DEGREE
        rms[k], worst[k] = np.sqrt(np.nanmean(error**2)), np.nanmax(np.abs(error))
    names = ("turn_rate_step", "turn_rate_min", "turn_rate_max")
    dps = [np.array([getattr(p, name) for p in protocols]) / RADIAN_PER_DEGREE for name in names]
    return UnitRuns(
        cutoff_hz=np.full(len(protocols), unit.cutoff_hz),
        turn_rate_step_dps=dps[0],
        turn_rate_min_dps=dps[1],
        turn_rate_max_dps=dps[2],
        error_rms_deg=rms,
        error_max_deg=worst,
        rig_minutes=minutes,
    )
