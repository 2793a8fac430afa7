"""Named calibration sessions, recorded on a bench with errors and fitted with the functions of undrift.

    session        recording                                                             fitted by
    hand           six faces, three turns of 360 deg by hand                             calibrate
    free poses     24 poses by hand, with the moves between them                         calibrate
    motion         two minutes of motion by hand                                         calibrate_from_motion
    table          six faces, steady rates in both directions about three axes                    calibrate
    chamber        as table, then a rest and rates at each set-point                        calibrate, fit_drift

A session is simulated sample by sample, and fitted in the same way as ``undrift calibrate`` and ``undrift drift`` fit a recorded
session. The fit receives only readings and the notes of an operator. The many sessions in which the note's numbers are
varied are simulated as means of dwells.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.calibrate import calibrate, calibrate_from_motion
from undrift.calibration.rate_table import fit_rate_table
from undrift.calibration.six_face import FaceMeans, fit_six_face
from undrift.calibration.table import DwellMeans, imposed_rates
from undrift.drift.fit import DriftSettings, fit_drift
from undrift.drift.offset import StaticSettings
from undrift.model import Calibration, Sensor, TriadModel
from undrift.programme import (
    FacesTable,
    Protocol,
    ProtocolTable,
    RatesTable,
    TemperaturesTable,
    programme_of,
    rate_grid,
)
from undrift.record import FACES, Record
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.simulate import simulate_device
from undrift.sim.motion.bench import BenchErrors, BenchKind, BenchSettings, bench_motion
from undrift.sim.motion.tasks import Task, draw_task, with_six_rests
from undrift.sim.sessions import simulate_session
from undrift.sim.table_sessions import (
    FACE,
    RATE,
    REST,
    BenchDraws,
    impose_faces,
    impose_turns,
    lay_out,
    mean_readings,
    numbers_of_dwell,
)
from undrift.sim.thermal import ThermalSettings, simulate_thermal_session
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, is_physical

ROOM_TEMP_C = 25.0
WARM_C = 12.5  # temperature rise of a worn device above room temperature, K: between the note's 10 and 15
SETTLED_S = 3600.0  # time since power-on: an hour
SAMPLE_RATE_HZ = 50.0  # sample rate of a session, sufficient because the fits average over seconds
HAND_AXIS = 2.0 * RADIAN_PER_DEGREE  # [assumed] tilt of the axis of a turn by hand, about each perpendicular axis
HAND_FACE = 0.5 * RADIAN_PER_DEGREE  # [assumed] tilt of the face of a case on a table
MOTION_RECORDINGS = 4  # number of recordings, half a minute each
MOTION_RATE_HZ = 100.0
KEY_STEP = 1e-9  # rad/s: rates closer than this are equal

Kind = Literal["hand", "poses", "motion", "table"]
Fit = Literal["product", "paper"]


@dataclass(frozen=True, kw_only=True)
class CalibrationSession:
    """A named calibration session."""

    name: str
    kind: Kind
    warm: bool = False  # True if recorded at the temperature of a worn device instead of room temperature
    protocol: Protocol | None = None  # protocol of a rate table
    by_means: bool = False  # True if simulated as means of dwells, which is faster

    @cached_property
    def length_min(self) -> float:
        """Length of the session with its mountings and soaks, min."""
        if self.kind == "motion":
            return 0.5 * MOTION_RECORDINGS
        warming = WARMING_MIN if self.warm else 0.0
        if self.protocol is not None:
            return programme_of(self.protocol.with_faces_at_room()).duration_s / 60.0 + warming
        kind: BenchKind = "ferraris" if self.kind == "hand" else "multi_position"
        return float(bench_motion(kind, rng=np.random.default_rng(0)).time[-1]) / 60.0 + warming

    @property
    def at_one_temperature(self) -> "CalibrationSession":
        """Part of the session before its soaks, which sessions with the same rates share."""
        if self.protocol is None:
            return self
        return replace(self, name="", protocol=self.protocol.named("").but(temperatures=None))

    def suits(self, device: DeviceModel) -> bool:
        """Return False for a session of motion only with readings in counts or volts, as motion cannot determine a gain."""
        return self.kind != "motion" or (is_physical(device.gyro.unit) and is_physical(device.accel.unit))

    @property
    def instruments(self) -> str:
        """Instruments that the session needs."""
        needs = [] if self.protocol is None else ["rate table"]
        if self.protocol is not None and self.protocol.temperatures_c:
            needs.append("chamber")
        elif self.warm:
            needs.append("rate table at the worn temperature" if self.protocol else "the wearer's warmth")
        return ", ".join(needs[-1:] if self.warm else needs) or "none"

    def commands(self, stem: str) -> tuple[str, ...]:
        """Return the commands that record and fit the session. File names start with ``stem``."""
        if self.protocol is not None:
            chamber = bool(self.protocol.temperatures_c)
            run = (
                f"undrift rig run {stem}.toml --rig ADDRESS --device ADDRESS{' --chamber ADDRESS' * chamber} -o {stem}"
            )
            fits = [f"undrift calibrate {stem} -o {stem}.json"]
            fits += [f"undrift drift {stem} --calibration {stem}.json -o {stem}.json"] * chamber
            return run, *fits
        files, how = {"motion": ("-*.csv", " --from motion"), "hand": (".csv", " --turn-deg 360")}.get(
            self.kind, (".csv", "")
        )
        return (f"undrift calibrate {stem}{files}{how} --gravity-m-s2 GRAVITY -o {stem}.json",)


WARMING_MIN = 30.0  # time for a device to warm up on a person, min


def table_protocol(name: str, step_dps: float, min_dps: float, max_dps: float) -> Protocol:
    """Return a rate-table protocol from the note's numbers, deg/s. Its grid omits omega_m, as in the note's count."""
    rate_grid(min_dps, max_dps, step_dps)  # an InputError instead of a pydantic error
    rates = RatesTable(
        turn_rate_min_dps=min_dps, turn_rate_max_dps=max_dps, turn_rate_step_dps=step_dps, grid="paper", seconds=2.0
    )
    return Protocol(protocol=ProtocolTable(name=name), faces=FacesTable(), rates=rates)


def _heated(protocol: Protocol, name: str, *set_points_c: float) -> Protocol:
    return protocol.named(name).but(temperatures=TemperaturesTable(set_points_c=set_points_c))


NOTE_SET_POINTS_C = (18.0, 30.0, 45.0, 60.0, 75.0)
_THREE = table_protocol("three rates", 37.5, 15.0, 90.0)
_THREE = _THREE.but(rates=_THREE.rates and _THREE.rates.but(grid="inclusive"))
_NOTE = table_protocol("note rates", 5.0, 5.0, 90.0)
SESSIONS: dict[str, CalibrationSession] = {
    session.name: session
    for session in (
        CalibrationSession(name="hand", kind="hand"),
        CalibrationSession(name="hand, warm", kind="hand", warm=True),
        CalibrationSession(name="free poses", kind="poses"),
        CalibrationSession(name="motion", kind="motion"),
        CalibrationSession(name="three rates", kind="table", protocol=_THREE),
        CalibrationSession(name="three rates, warm", kind="table", protocol=_THREE, warm=True),
        CalibrationSession(name="note rates", kind="table", protocol=_NOTE),
        CalibrationSession(name="two set-points", kind="table", protocol=_heated(_THREE, "two set-points", 25.0, 40.0)),
        CalibrationSession(name="note", kind="table", protocol=_heated(_NOTE, "note", *NOTE_SET_POINTS_C)),
    )
}

Streams = Callable[[str], np.random.Generator]


def calibrate_by(
    session: CalibrationSession,
    device: DeviceModel,
    *,
    errors: BenchErrors,
    streams: Streams,
    fit: Fit = "product",
    before_soaks: Calibration | None = None,
) -> Calibration:
    """Record a session with a simulated device and fit it. A session without soaks has no tables over temperature.

    ``streams`` returns the generator for a name. ``before_soaks`` is the fit of the part at one temperature, if it already exists.
    Raises CalibrationError if the session cannot calibrate the device.
    """
    calibration = before_soaks or calibrate_before_soaks(session, device, errors=errors, streams=streams, fit=fit)
    protocol = session.protocol
    if protocol is None or not protocol.temperatures_c:
        return calibration
    thermal = ThermalSettings(bench=_bench(session, errors), set_points_c=protocol.temperatures_c)
    soaks = simulate_thermal_session("soak", device, rng=streams("chamber"), settings=thermal)
    choices = DriftSettings()
    if fit == "paper":
        choices = replace(choices, static=StaticSettings(not_a_knot=True))
    return fit_drift((soaks,), calibration, settings=choices).calibration


def calibrate_before_soaks(
    session: CalibrationSession, device: DeviceModel, *, errors: BenchErrors, streams: Streams, fit: Fit = "product"
) -> Calibration:
    """Record the part of a session at one temperature, and fit it."""
    temp_c = ROOM_TEMP_C + WARM_C * session.warm
    if session.kind == "motion":
        return calibrate_from_motion(
            [free_motion(device, streams, f"motion {k}", temp_c)[1] for k in range(MOTION_RECORDINGS)]
        )
    mode: Literal["paper"] | None = "paper" if fit == "paper" and session.kind == "table" else None
    kinds: dict[Kind, BenchKind] = {"hand": "ferraris", "poses": "multi_position", "table": "bench", "motion": "bench"}
    recorded = simulate_session(
        kinds[session.kind], device, rng=streams("bench"), settings=_bench(session, errors), temp_c=temp_c,
        power_on_s=SETTLED_S,
    )  # fmt: skip
    return calibrate(recorded, mode=mode)


def _bench(session: CalibrationSession, errors: BenchErrors) -> BenchSettings:
    protocol = session.protocol
    if protocol is None:
        hand_errors = replace(errors, face_tilt=HAND_FACE, hand_axis=HAND_AXIS)
        return BenchSettings(sample_rate_hz=SAMPLE_RATE_HZ, errors=hand_errors)
    rates, usual = protocol.turn_rates(), BenchSettings()
    return BenchSettings(
        sample_rate_hz=SAMPLE_RATE_HZ,
        errors=errors,
        turn_rates=tuple(rates[rates > 0.0].tolist()),
        dwell_s=2.0 if protocol.rates is None else protocol.rates.seconds,
        still_s=usual.still_s if protocol.faces is None else protocol.faces.seconds,
    )


# ---- a rate table, simulated as means of its dwells: many sessions at once


def calibrate_by_means(
    protocol: Protocol, device: DeviceModel, *, errors: BenchErrors, streams: Streams, fit: Fit = "product"
) -> Calibration:
    """Fit a session at room temperature with dwells simulated as means (sim/table_sessions.py). Dwells share their errors."""
    layout = lay_out(protocol)
    faces, turns = layout[layout.kind == FACE], layout[layout.kind != FACE]
    size = np.round(np.abs(turns.rate) / KEY_STEP)
    keys = np.unique(size[size > 0.0])
    second = turns.rate < 0.0
    second[1:] |= (turns.kind[1:] == REST) & (turns.kind[:-1] == RATE)  # the rest after the rates
    block = np.where(size > 0.0, np.searchsorted(keys, size) + 1, 0)
    row = 6 * block + 2 * turns.axis + second
    every, width = (0, *keys.astype(int).tolist()), numbers_of_dwell(device.gyro)
    draws = BenchDraws(streams("bench"), [streams(f"turn {key}") for key in every])
    normals = np.concatenate([streams(f"noise {key}").standard_normal((6, 3, width)) for key in every])
    dwells, read_rate = impose_turns(turns, errors, draws, row)
    reading = mean_readings(device, "gyro", dwells, normals, row)
    turning = turns.kind == RATE
    offset = reading[~turning].mean(axis=0)
    means = DwellMeans(
        reading=reading[turning] - offset,
        turn_rate=read_rate[turning],
        axis=tuple("xyz"[axis] for axis in turns.axis[turning]),  # type: ignore[misc]
        unit=device.gyro.unit,
    )
    gyro = paper_model(means) if fit == "paper" else fit_rate_table(means).model
    face_normals = streams("faces").standard_normal((6, 3, numbers_of_dwell(device.accel)))
    rest_mask = mean_readings(device, "accel", impose_faces(faces, errors, draws), face_normals, faces.face)
    face_means = FaceMeans(reading=rest_mask, faces=tuple(FACES[face] for face in faces.face), unit=device.accel.unit)
    return Calibration(
        device=device.serial,
        reference_temp_c=ROOM_TEMP_C,
        gravity_m_s2=STANDARD_GRAVITY,
        gyro=replace(gyro, offset=gyro.offset + offset),
        accel=fit_six_face(face_means, gravity=STANDARD_GRAVITY, mode="affine").model,
    )


def paper_model(means: DwellMeans) -> TriadModel:
    """Return the note's matrix L S' (S S')^-1 of dwells, without the covariance that a study does not use."""
    solver = means.reading @ np.linalg.inv(means.reading.T @ means.reading)
    return bare_model("gyro", means.unit, imposed_rates(means, None).T @ solver, np.zeros(3))


def bare_model(sensor: Sensor, unit: str, matrix: FloatArray, offset: FloatArray) -> TriadModel:
    """Return a model that contains only values, without uncertainties."""
    return TriadModel(
        method="study", unit_in=unit, unit_out="rad/s" if sensor == "gyro" else "m/s2", matrix=matrix, offset=offset,
        covariance=np.zeros((12, 12)), rms_residual=np.nan, count=0, rank=12, condition=np.nan, valid_range=(np.nan, np.nan),
    )  # fmt: skip


PACES = (1.0, 0.7, 0.5, 0.35, 0.25)


def free_motion(
    device: DeviceModel, streams: Streams, name: str, temp_c: float = ROOM_TEMP_C, *, six_rests: bool = False
) -> tuple[Task, Record]:
    """Return a minute of turns about all axes and its readings, at the first of ``PACES`` for which the readings stay within range.

    Then the device rests on each of its six sides if ``six_rests`` is set.
    """
    for pace in PACES:
        rng = streams(name)
        performed = draw_task("free", rng=rng, pace=pace)
        performed = with_six_rests(performed) if six_rests else performed
        time = np.arange(round(performed.duration_s * MOTION_RATE_HZ)) / MOTION_RATE_HZ
        motion = performed.at(time, STANDARD_GRAVITY)
        simulated = simulate_device(device, motion, rng=rng, temp_c=temp_c, power_on_s=SETTLED_S)
        if not (simulated.gyro.saturated.any() or simulated.accel.saturated.any()):
            break
    return performed, simulated.record
