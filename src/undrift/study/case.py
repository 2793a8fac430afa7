"""A run of a study: a calibration session, the fit, and a trial of one subject, all with one simulated device.

Everything is drawn from (seed, task, subject): the unit of the device, the performance, the temperature, the noise. The cut-off
frequency changes the filter alone, so that cases of one subject differ by it and by nothing else. For each protocol::

    simulate the session -> fit -> tables -> correct the trial -> orient -> compare with the true pitch

The session has the steps of ``undrift rig run``: faces at room temperature; then, for each axis mounted once, all set-points in
it: a rest, the rates both ways, a rest. The fit has the order of the note's Figure 2: static drift (not-a-knot splines over the
set-points' rests), the matrix (eq. 6) at the set-point nearest to room temperature, what is left over rate and temperature.
"""

import json
import zlib
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from undrift.arrays import FloatArray, IntArray
from undrift.calibration.six_face import FaceMeans, fit_six_face
from undrift.correction.correct import correct_checked
from undrift.errors import CalibrationError, InputError, NotObservable
from undrift.fit.least_squares import fit_paper
from undrift.fit.smooth import not_a_knot
from undrift.model import Calibration, DriftTables, DynamicDrift, StaticDrift, TriadModel
from undrift.orientation import orient, sagittal_pitch
from undrift.record import Face, Record, Still
from undrift.rig.programme import Dwell, Protocol, programme_of
from undrift.sim.device.effects import LowPass
from undrift.sim.device.model import DeviceModel, device_from_json
from undrift.sim.device.presets import preset, random_device_of
from undrift.sim.device.simulate import DwellReadings, Dwells, simulate_device, simulate_dwells
from undrift.sim.motion.tasks import Subject, Task, TaskName, cohort, draw_task
from undrift.study.plan import SAMPLE_RATE_HZ, TURN_RATES, RecordedTask, Study, StudyTask, read_motion
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

# ---- calibration session

WARMED_UP_S = 1800.0  # the bench waits half an hour after power-on
ROOM_TEMP_C = 25.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Imposed:
    """What a session imposes, N dwells."""

    dwells: Dwells  # Times, rates, forces, temperatures
    kind: NDArray[np.str_]  # (N,), face, bracket (a rest) or rate
    soak: IntArray  # (N,), which set-point
    faces: tuple[Face, ...]  # Axis that points up, for each dwell
    duration_s: float  # Of the whole session on the rig, s


def impose(protocol: Protocol) -> Imposed:
    """Lay out the dwells of a protocol."""
    if protocol.turn_rate_step <= 0.0:
        raise InputError("study: wanted a protocol with rates, got none; state turn_rate_step and the two ends")
    steps = [*programme_of(replace(protocol, faces=())).steps]
    if protocol.faces:
        steps = [*programme_of(replace(protocol, turn_rate_step=0.0, temperatures_c=())).steps, *steps]
    temperatures = protocol.temperatures_c or (ROOM_TEMP_C,)
    dwells: list[Dwell] = []
    starts, clock = [], WARMED_UP_S
    for step in steps:
        if isinstance(step, Dwell):
            dwells.append(step)
            starts.append(clock + step.ramp_s + step.settle_s)
        clock += step.duration_s
    rate, force = np.zeros((2, len(dwells), 3))
    for k, dwell in enumerate(dwells):
        if dwell.axis is not None:
            rate[k, "xyz".index(dwell.axis)] = dwell.turn_rate
        force[k, "xyz".index(dwell.up[1])] = STANDARD_GRAVITY if dwell.up[0] == "+" else -STANDARD_GRAVITY
    temp_c = [ROOM_TEMP_C if dwell.temp_c is None else dwell.temp_c for dwell in dwells]
    soaks = [0 if dwell.purpose == "face" else temperatures.index(t) for dwell, t in zip(dwells, temp_c, strict=True)]
    return Imposed(
        dwells=Dwells(
            start_s=np.array(starts),
            duration_s=np.array([dwell.dwell_s for dwell in dwells]),
            rate_b=rate,
            force_b=force,
            temp_c=np.array(temp_c),
        ),
        kind=np.array([dwell.purpose for dwell in dwells]),
        soak=np.array(soaks),
        faces=tuple(dwell.up for dwell in dwells),
        duration_s=clock - WARMED_UP_S,
    )


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


def device_of(study: Study, number: int) -> DeviceModel:
    """Return the device that a subject wears."""
    if study.worn:
        return device_from_json(json.loads(study.worn))
    return random_device_of(study.device, seeded(study, "device", number))


def typical_unit(study: Study) -> DeviceModel:
    """Return the one device of the study, or the typical unit of its kind."""
    return device_of(study, 0) if study.worn else preset(study.device)


def perform(study: Study, task: StudyTask, number: int) -> Task | RecordedTask:
    """Return what a subject does."""
    if task.motion is not None:
        return read_motion(task.motion)
    name, rng = cast("TaskName", task.name), seeded(study, "task", task.name, number)
    return draw_task(name, rng=rng, subject=subject_of(study, number), rest_s=REST_S)


def make_case(study: Study, task: StudyTask, number: int, cutoff_hz: float) -> Case:
    """Simulate a subject's trial with a device whose filters were built for a cut-off frequency, out of the same parts."""
    device = device_of(study, number)
    chains: dict[str, Any] = {}
    for name, chain in (("gyro", device.gyro), ("accel", device.accel)):
        low_pass = LowPass(cutoff_hz=np.full(3, cutoff_hz))
        if (held := chain.low_pass) is not None:
            error = held.cutoff_hz / float(np.median(held.cutoff_hz))
            low_pass = LowPass(cutoff_hz=cutoff_hz * error, quality=held.quality)
        chains[name] = replace(chain, low_pass=low_pass)
    temp_c = ROOM_TEMP_C + float(seeded(study, "temperature", number).uniform(*study.excursion_k))
    rng = seeded(study, "noise", task.name, number)
    return wear(replace(device, **chains), perform(study, task, number), rng=rng, temp_c=temp_c, power_on_s=WORN_S)


def wear(
    device: DeviceModel, performed: Task | RecordedTask, *, rng: np.random.Generator, temp_c: float, power_on_s: float
) -> Case:
    """Simulate a trial."""
    time = np.arange(round(performed.duration_s * SAMPLE_RATE_HZ)) / SAMPLE_RATE_HZ
    motion = performed.at(time, STANDARD_GRAVITY)
    record = simulate_device(device, motion, rng=rng, temp_c=temp_c, power_on_s=power_on_s).record
    start, stop = (round(moment * SAMPLE_RATE_HZ) for moment in performed.moving_s)
    return Case(
        device=device,
        record=record,
        pitch=sagittal_pitch(performed.at(time - delay_s(device), STANDARD_GRAVITY).q_nb),
        still=(0, max(start - round(0.2 * SAMPLE_RATE_HZ), 2)),
        moving=(start, min(stop + 1, len(time))),
    )


def delay_s(device: DeviceModel) -> float:
    """Return how late the pitch of a device is: strapdown holds an instant reading over the step before its stamp."""
    low_pass = device.gyro.low_pass
    held_s = 0.5 / SAMPLE_RATE_HZ if device.sampling.gyro_averaging == "instant" else 0.0
    return (0.0 if low_pass is None else float(np.median(low_pass.group_delay_s))) - held_s


def pitch_error(case: Case, calibration: Calibration) -> FloatArray:
    """Return the error of the pitch that a calibrated device gives, (M,) rad."""
    corrected = correct_checked(case.record, calibration, policy="hold", threads=1).record
    found = orient(corrected, Still(start=case.still[0], stop=case.still[1]))
    error = found.pitch - case.pitch
    error = (error + np.pi) % (2.0 * np.pi) - np.pi
    return error[case.moving[0] : case.moving[1]]


# ---- the note's calibration

NODES_C = np.linspace(18.0, 75.0, 115)  # the note's tuning table: every 0.5 degC


def calibrate_as_the_note(imposed: Imposed, readings: DwellReadings, device: DeviceModel) -> Calibration:
    """Calibrate a device from the dwells of a session."""
    faces, rests, turns = (np.flatnonzero(imposed.kind == kind) for kind in ("face", "bracket", "rate"))
    if not len(rests):
        raise NotObservable("study: wanted rests at zero rate, got none; set bracket_s")
    variance = readings.gyro_variance / readings.samples[:, None]  # of a mean
    soaks = np.unique(imposed.soak)
    at_rest = [rests[imposed.soak[rests] == soak] for soak in soaks]
    temps = np.array([readings.temp_c[rows].mean() for rows in at_rest])
    offsets = np.array([readings.gyro[rows].mean(axis=0) for rows in at_rest])
    variances = np.array([variance[rows].sum(axis=0) / len(rows) ** 2 for rows in at_rest])
    turning = [turns[imposed.soak[turns] == soak] for soak in soaks]
    home = int(np.argmin(np.abs(temps - ROOM_TEMP_C)))
    own = turning[home]
    fit = fit_paper(
        imposed.dwells.rate_b[own],
        readings.gyro[own] - offsets[home],
        np.sqrt(variance[own]),
        method="rate-table/paper",
        unit_in=device.gyro.unit,
        unit_out="rad/s",
    )
    covariance = fit.model.covariance.copy()
    covariance[9:12, 9:12] = np.diag(variances[home])
    gyro = replace(fit.model, offset=offsets[home], covariance=covariance)
    drift = None
    if len(soaks) > 1:
        static = StaticDrift(
            temp_c=NODES_C,
            gyro_offset=not_a_knot(temps, offsets, variances, NODES_C).value,
            gyro_extrapolated=np.abs(NODES_C - np.clip(NODES_C, temps[0], temps[-1])) > 0.5,
        )
        drift = DriftTables(static=static, dynamic=_dynamic(imposed, readings, turning, temps, offsets, gyro))
    return Calibration(
        device="",
        reference_temp_c=float(temps[home]),
        gravity_m_s2=STANDARD_GRAVITY,
        gyro=gyro,
        accel=_accel(imposed, readings, faces, device.accel.unit) if len(faces) else None,
        drift=drift,
    )


def _dynamic(
    imposed: Imposed,
    readings: DwellReadings,
    turning: list[IntArray],
    temps: FloatArray,
    offsets: FloatArray,
    gyro: TriadModel,
) -> DynamicDrift:
    """Bicubic: at each set-point a spline over the measured rate, then one over temperature at each node."""
    from scipy.interpolate import CubicSpline

    rates = np.unique(np.round(np.abs(imposed.dwells.rate_b[np.concatenate(turning)]).max(axis=1), 12))
    nodes = np.concatenate((-rates[::-1], [0.0], rates))
    error = np.zeros((len(temps), len(nodes), 3))
    for k, rows in enumerate(turning):
        true, measured = imposed.dwells.rate_b[rows], (readings.gyro[rows] - offsets[k]) @ gyro.matrix.T
        for axis in range(3):
            own = np.abs(true[:, axis]) > 0.0
            rate = np.concatenate((measured[own, axis], [0.0]))
            left = np.concatenate((measured[own, axis] - true[own, axis], [0.0]))
            order = np.argsort(rate)
            curve = CubicSpline(rate[order], left[order], bc_type="not-a-knot")
            error[k, :, axis] = curve(np.clip(nodes, rate[order[0]], rate[order[-1]]))
    table_c = np.unique(np.concatenate((temps, NODES_C[::10])))
    table_c = table_c[(table_c >= temps[0]) & (table_c <= temps[-1])]
    over_temp = CubicSpline(temps, error, axis=0, bc_type="not-a-knot")
    return DynamicDrift(temp_c=table_c, turn_rate=nodes, error=over_temp(table_c))


def _accel(imposed: Imposed, readings: DwellReadings, at: IntArray, unit: str) -> TriadModel:
    poses = FaceMeans(
        reading=readings.accel[at],
        faces=tuple(imposed.faces[i] for i in at),
        noise=np.sqrt(readings.accel_variance[at] / readings.samples[at, None]),
        unit=unit,
    )
    return fit_six_face(poses, gravity=STANDARD_GRAVITY, mode="affine").model


# ---- unit of work

COLUMNS = ("cutoff_hz", *(f"{name}_dps" for name in TURN_RATES), "error_rms_deg", "error_max_deg", "rig_minutes")


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


def units_of(study: Study) -> tuple[Unit, ...]:
    """Return the units of a study."""
    return tuple(
        Unit(study=study, task=task, subject=subject, cutoff_hz=cutoff)
        for task in study.tasks
        for subject in range(study.subjects)
        for cutoff in task.space.cutoff_hz
    )


def run_unit(unit: Unit) -> dict[str, FloatArray]:
    """Run all protocols of a unit: an array (P,) for each of ``COLUMNS``, errors NaN where the device was left uncalibrated."""
    study, protocols = unit.study, unit.task.candidates(unit.cutoff_hz)
    numbers = [number for number, _ in unit.task.space.numbered_grids()]  # a protocol has one noise in every search
    case = make_case(study, unit.task, unit.subject, unit.cutoff_hz)
    runs = rates_of(protocols) | {name: np.full(len(protocols), np.nan) for name in COLUMNS[4:]}
    for k, protocol in enumerate(protocols):
        rng = seeded(study, "session", unit.task.name, unit.subject, numbers[k])
        imposed = impose(protocol)
        runs["rig_minutes"][k] = imposed.duration_s / 60.0
        readings = simulate_dwells(case.device, imposed.dwells, rng=rng, felt=imposed.kind == "face")
        try:
            calibration = calibrate_as_the_note(imposed, readings, case.device)
        except CalibrationError:  # this protocol cannot calibrate this device: no error to report, and not a zero
            continue
        error = pitch_error(case, calibration) / RADIAN_PER_DEGREE
        runs["error_rms_deg"][k] = np.sqrt(np.nanmean(error**2))
        runs["error_max_deg"][k] = np.nanmax(np.abs(error))
    return runs


def rates_of(protocols: tuple[Protocol, ...]) -> dict[str, FloatArray]:
    """Return what is varied of protocols, an array (P,) for each of the first four of ``COLUMNS``."""
    dps = {f"{name}_dps": np.array([getattr(p, name) for p in protocols]) / RADIAN_PER_DEGREE for name in TURN_RATES}
    return {"cutoff_hz": np.array([p.cutoff_hz for p in protocols])} | dps
