"""Observations of thermal sessions: blocks of rest and dwells at a steady rate, one row each, with their temperatures.

Blocks of rest are means over about ten seconds. A mean excludes samples more than six robust standard deviations from the median of
their block. Its variance comes from the differences of neighbouring half-second means, pooled over the rest::

    var of a block's mean = mean((m_(k+1) - m_k)^2) / 2 / number of half seconds

so that a ramp does not count as noise. The fit accounts for bias instability from block to block.

Sessions are prepared first, in the calibration's units and with restored codes. If the clock of a session with several recordings
starts again, the device was switched on again.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.calibration.codes import code_steps, code_variance, restored
from undrift.calibration.table import dwell_means
from undrift.errors import InputError, NotObservable
from undrift.findings import Finding, Level, finding
from undrift.fit.gls import block_size
from undrift.fit.triad import nominal_triad
from undrift.model import AXES, Calibration, Verdict
from undrift.record import Record, Session, Still
from undrift.segments import find_still
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, is_physical

if TYPE_CHECKING:
    import pandas as pd

Temperatures = Sequence[Sequence[FloatArray]]  # per session, per recording: (N,), degC, lag subtracted

BLOCK_S = 10.0  # length of a block of rest: shorter blocks follow fast ramps better, longer blocks average more noise
RAMP_S = 60.0  # stretch over which the slope of the temperature is computed
SETTLE_S = 0.3  # part at the start of each dwell that is discarded
SOAK_C = 1.5  # a dwell that differs by more than this from the first dwell of its soak begins another soak
# largest angle between mean specific forces in a mounting (drift tilts them by 1-2 deg)
SAME_POSE = 3.0 * RADIAN_PER_DEGREE
OUTLIER = 6.0 * 1.4826  # median absolute deviations of a block: six standard deviations of normal noise
LEAST_SHARE = 0.5  # smallest share of valid samples in a block
SET_POINT_S = 600.0  # time between means over set-points without a column time_s [assumed]
NO_REST = (
    "rests: no stretch at rest with a known temperature was found. Leave the device still while its temperature changes, and "
    "record the temperature or set temp_c."
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StretchMeans:
    """Means over stretches of thermal sessions, n rows."""

    session: IntArray  # (n,), index of the session, from 0
    temp_c: FloatArray  # (n,), mean temperature, degC, lag subtracted
    gyro: FloatArray  # (n, 3), mean reading, raw unit, or NaN if the session has no such sensors
    gyro_variance: FloatArray  # (n, 3), variance of the mean, from the scatter within, or NaN if unknown

    def __len__(self) -> int:
        return len(self.temp_c)

    def taken(self, which: Any) -> Self:
        """Return selected rows. Their indices of sessions do not change."""
        columns: Any = ((name, getattr(self, name)) for name in self.__dataclass_fields__)
        return replace(self, **{name: values[which] for name, values in columns if isinstance(values, np.ndarray)})

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """Return all rows of several parts in sequence."""
        return cls(
            **{name: np.concatenate([getattr(rows, name) for rows in parts]) for name in cls.__dataclass_fields__}
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RestBlocks(StretchMeans):
    """Means over blocks of rest, n rows in the order of session and time."""

    time: FloatArray  # (n,), middle of the block, s, on a clock with the recordings of a session in sequence
    accel: FloatArray  # (n, 3), mean reading, raw unit, or NaN if the session has no such sensors
    pose: IntArray  # (n,), number of the orientation (sessions have different numbers)
    power_on_s: FloatArray  # (n,), time since the first recording of the same power-on began, s
    ramp_c_per_min: FloatArray  # (n,), slope of the temperature, degC/min (positive while warming)
    accel_variance: FloatArray  # (n, 3), likewise
    # (n, 3), standard deviation of the mean due to the converter's steps, raw unit (constant while the input is constant)
    gyro_step_error: FloatArray
    accel_step_error: FloatArray  # (n, 3), likewise


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RateSteps(StretchMeans):
    """Means over dwells at a steady rate, n rows in the order of session and time."""

    soak: IntArray  # (n,), dwells with the same number were at the same temperature
    rate_b: FloatArray  # (n, 3), imposed rate in case axes, rad/s


def observe_rests(sessions: Sequence[Session], *, temperatures: Temperatures) -> RestBlocks:
    """Gather the rests of thermal sessions into blocks."""
    parts, poses = list[RestBlocks](), 0
    for number, (session, temps) in enumerate(zip(sessions, temperatures, strict=True)):
        blocks = session_rests(session, temps)
        parts += [replace(rests, session=rests.session + number, pose=rests.pose + poses) for rests in blocks]
        poses = 1 + max((int(np.max(rests.pose, initial=-1)) for rests in parts), default=-1)
    if not any(len(rests) for rests in parts):
        raise NotObservable(NO_REST)
    return RestBlocks.joined(parts)


def observe_steps(sessions: Sequence[Session], *, temperatures: Temperatures) -> RateSteps:
    """Gather the dwells at known rates from thermal sessions."""
    numbers, rows3 = np.zeros(0, np.int64), np.zeros((0, 3))
    parts = [
        RateSteps(session=numbers, soak=numbers, temp_c=np.zeros(0), rate_b=rows3, gyro=rows3, gyro_variance=rows3)
    ]
    for number, (session, temps) in enumerate(zip(sessions, temperatures, strict=True)):
        for rows in session_steps(session, temps):
            soaks = 1 + max(int(other.soak.max(initial=-1)) for other in parts)
            parts.append(replace(rows, session=rows.session + number, soak=rows.soak + soaks))
    return RateSteps.joined(parts)


# ---- rests and their poses


def find_rests(session: Session) -> tuple[Still, ...]:
    """Return the given rests of a session, or the detected rests if none are given, in order of time."""
    if session.stills:
        return tuple(sorted(session.stills, key=lambda s: (s.recording, s.start)))
    rests = list[Still]()
    for number, record in enumerate(session.records):
        turns = [turn for turn in session.turns if turn.recording == number]
        stills = find_still(record, recording=number).stills
        rests += [s for s in stills if all(s.stop <= turn.start or s.start >= turn.stop for turn in turns)]
    return tuple(rests)


def session_rests(session: Session, temps: Sequence[FloatArray]) -> list[RestBlocks]:
    """Return the blocks of each rest of a session."""
    stills, begins_s, ages_s = find_rests(session), session.begins_s, _ages(session.records)
    steps = [code_steps(session.records, rate=rate) for rate in (True, False)]
    poses, parts = _poses(session, stills), list[RestBlocks]()
    for still, pose in zip(stills, poses, strict=True):
        record, rows = session.records[still.recording], slice(still.start, still.stop)
        time, temp_c = record.time[rows], temps[still.recording][rows]
        edges, size = _edges(time), block_size(record.sample_rate_hz)
        gyro, gyro_variance, gyro_step_error = _block_means(record.gyro, rows, edges, size, steps[0])
        accel, accel_variance, accel_step_error = _block_means(record.accel, rows, edges, size, steps[1])
        middle = np.array([0.5 * (time[a] + time[b - 1]) for a, b in pairwise(edges)])
        since_begin = middle - record.time[0]
        number = np.zeros(len(middle), np.int64)
        blocks = RestBlocks(
            session=number,
            pose=number + pose,
            time=since_begin + begins_s[still.recording],
            power_on_s=since_begin + ages_s[still.recording],
            temp_c=np.array([_mean_temperature(temp_c[a:b]) for a, b in pairwise(edges)]),
            ramp_c_per_min=np.array([_slope(record.time, temps[still.recording], moment) for moment in middle]),
            gyro=gyro,
            accel=accel,
            gyro_variance=gyro_variance,
            accel_variance=accel_variance,
            gyro_step_error=gyro_step_error,
            accel_step_error=accel_step_error,
        )
        read = np.isfinite(gyro).all(axis=1) | np.isfinite(accel).all(axis=1)
        parts.append(blocks.taken(np.isfinite(blocks.temp_c) & read))
    return parts


def _poses(session: Session, stills: tuple[Still, ...]) -> IntArray:
    """Return the pose of each still, from 0: its face, or without a face the previous pose if their directions agree."""
    poses, faces, forces = list[int](), dict[str, int](), list[FloatArray | None]()
    for k, still in enumerate(stills):
        accel, following = session.records[still.recording].accel, max(poses, default=-1) + 1
        forces.append(None if accel is None else np.nanmedian(accel[still.start : still.stop], axis=0))
        if still.face is not None:
            poses.append(faces.setdefault(still.face, following))
        elif k and stills[k - 1].recording == still.recording and _is_same_pose(forces[k - 1], forces[k]):
            poses.append(poses[-1])
        else:
            poses.append(following)
    return np.array(poses, np.int64)


def _is_same_pose(force: FloatArray | None, other: FloatArray | None) -> bool:
    if force is None or other is None:
        return force is other
    return bool(np.arctan2(np.linalg.norm(np.cross(force, other)), force @ other) < SAME_POSE)


def _edges(time: FloatArray) -> IntArray:
    """Return the first samples of as many blocks as fit, and the end. A still shorter than two blocks becomes one block."""
    count = max(1, int((time[-1] - time[0]) / BLOCK_S + 0.05))
    inner = np.searchsorted(time, np.linspace(time[0], time[-1], count + 1)[1:-1])
    return np.unique([0, *inner, len(time)])


def _block_means(
    readings: FloatArray | None, rows: slice, edges: IntArray, size: int, step: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the mean, its variance and its step error of each block, shape (B, 3), or NaN if too many samples are missing."""
    mean, variance, step_error = np.full((3, len(edges) - 1, 3), np.nan)
    if readings is None:
        return mean, variance, step_error
    squares, scatter, counts = list[FloatArray](), list[FloatArray](), np.zeros((len(mean), 1))
    for k, (start, stop) in enumerate(pairwise(edges)):
        block = _drop_outliers(readings[rows][start:stop], step)
        if len(block) >= LEAST_SHARE * (stop - start):
            mean[k], counts[k] = block.mean(axis=0), len(block)
            width = min(size, max(1, len(block) // 2))
            halves = block[: len(block) // width * width].reshape(-1, width, 3).mean(axis=1)
            squares.append(np.diff(halves, axis=0) ** 2 * width)
            scatter.append(block.var(axis=0))
    read = counts[:, 0] > 0.0
    differences = np.concatenate(squares) if squares else np.zeros((0, 3))
    if len(differences):  # noise of a sample, from the noise of half-second means
        variance[read] = differences.mean(axis=0) / 2.0 / counts[read]
    if read.any():
        step_error[read] = np.sqrt(code_variance(step, np.mean(scatter, axis=0)))
    return mean, variance, step_error


def _drop_outliers(block: FloatArray, step: FloatArray) -> FloatArray:
    """Return the valid samples of a block, (n, 3), without outliers. Noise below a code has no median deviation."""
    block = block[np.isfinite(block).all(axis=1)]
    if not len(block):
        return block
    deviation = np.abs(block - np.median(block, axis=0))
    limit = OUTLIER * np.maximum(np.median(deviation, axis=0), np.nan_to_num(step))
    return np.asarray(block[(deviation <= limit).all(axis=1)])


def _mean_temperature(temp_c: FloatArray) -> float:
    finite = temp_c[np.isfinite(temp_c)]
    return float(finite.mean()) if len(finite) >= LEAST_SHARE * len(temp_c) else np.nan


def _slope(time: FloatArray, temp_c: FloatArray, middle: float) -> float:
    """Return the slope of the temperature around a given time, degC/min."""
    window = slice(*np.searchsorted(time, (middle - 0.5 * RAMP_S, middle + 0.5 * RAMP_S)))
    finite = np.isfinite(temp_c[window])
    if finite.sum() < 2:
        return 0.0
    about = time[window][finite] - time[window][finite].mean()
    return float(60.0 * (about @ temp_c[window][finite]) / (about @ about))


def _ages(records: Sequence[Record]) -> FloatArray:
    """Return the time from switch-on to the start of each record, s."""
    ages, first = np.zeros(len(records)), records[0].time[0]
    for k in range(1, len(records)):
        if records[k].time[0] <= records[k - 1].time[-1]:
            first = records[k].time[0]
        ages[k] = records[k].time[0] - first
    return ages


# ---- dwells at a steady rate


def session_steps(session: Session, temps: Sequence[FloatArray]) -> list[RateSteps]:
    """Return the dwells of a session, or an empty list without turns at known rates."""
    turns = [
        t for t in session.turns if t.axis and t.turn_rate is not None and session.records[t.recording].gyro is not None
    ]
    if not turns:
        return []
    turns.sort(key=lambda turn: (turn.recording, turn.start))
    dwells = dwell_means(session.records, turns, settle_s=SETTLE_S)
    temp_c = np.zeros(len(turns))
    for k, turn in enumerate(turns):
        dwell_temps = temps[turn.recording][turn.start : turn.stop]
        if not np.isfinite(dwell_temps).any():
            raise InputError(
                f"dwell [{turn.start}, {turn.stop}) of recording {turn.recording} has no temperature. Map its column or set "
                "temp_c."
            )
        temp_c[k] = np.nanmean(dwell_temps)
    return [
        RateSteps(
            session=np.zeros(len(turns), np.int64),
            soak=_soaks(temp_c),
            temp_c=temp_c,
            rate_b=dwells.axis_b * dwells.turn_rate[:, None],
            gyro=dwells.reading,
            gyro_variance=np.full(dwells.reading.shape, np.nan) if dwells.noise is None else dwells.noise**2,
        )
    ]


def _soaks(temp_c: FloatArray) -> IntArray:
    """Return the soak of each dwell. A soak ends when the temperature differs from the temperature of its first dwell."""
    numbers, first = np.zeros(len(temp_c), np.int64), 0
    for k in range(1, len(temp_c)):
        another = bool(abs(temp_c[k] - temp_c[first]) > SOAK_C)
        first = k if another else first
        numbers[k] = numbers[k - 1] + another
    return numbers


# ---- means over set-points, one row each


def means_session(frame: "pd.DataFrame") -> tuple[Session, FloatArray]:
    """Return means over set-points as a session with one record, and the imposed rate of each row, (N, 3), rad/s."""
    names = [f"turn_rate_{axis}_dps" for axis in AXES]
    readings = frame.drop(columns=names, errors="ignore")
    rate_hz = None if "time_s" in readings else 1.0 / SET_POINT_S
    record = Record.from_frame(readings, sample_rate_hz=rate_hz, gaps="keep")
    rate_b = frame.reindex(columns=names, fill_value=0.0).to_numpy(dtype=np.float64) * RADIAN_PER_DEGREE
    return Session(kind="thermal", serial=record.device, gravity_m_s2=STANDARD_GRAVITY, records=(record,)), rate_b


def observe_means(record: Record, rate_b: FloatArray, temp_c: FloatArray) -> tuple[RestBlocks, RateSteps]:
    """Return the rows at rest as blocks of rest, and the rows with an imposed rate (N, 3), rad/s, as dwells."""
    rows, time = np.isfinite(temp_c), record.time - record.time[0]
    unknown = np.full((len(record), 3), np.nan)
    accel = unknown if record.accel is None else record.accel
    up = np.nan_to_num(accel)
    axis = np.abs(up).argmax(axis=1)
    means: dict[str, Any] = {
        "session": np.zeros(len(record), np.int64),
        "temp_c": temp_c,
        "gyro": unknown if record.gyro is None else record.gyro,
        "gyro_variance": unknown,
    }
    rests = RestBlocks(
        **means,
        time=time,
        power_on_s=time,
        accel=accel,
        pose=2 * axis + (up[np.arange(len(record)), axis] < 0.0),
        ramp_c_per_min=np.zeros(len(record)),
        accel_variance=unknown,
        gyro_step_error=np.zeros_like(unknown),
        accel_step_error=np.zeros_like(unknown),
    )
    soak = np.zeros(len(record), np.int64)
    soak[rows] = _soaks(temp_c[rows])
    turning = rate_b.any(axis=1)
    if not (rows & ~turning).any():
        raise NotObservable(NO_REST)
    return rests.taken(rows & ~turning), RateSteps(**means, soak=soak, rate_b=rate_b).taken(rows & turning)


# ---- preparation of sessions


def in_units_of(session: Session, calibration: Calibration) -> Session:
    """Return a session in the units of a calibration's input, with the half steps of truncated codes restored."""
    records = tuple(_prepare_record(record, k, calibration) for k, record in enumerate(session.records))
    return replace(session, records=records)


def _prepare_record(record: Record, number: int, calibration: Calibration) -> Record:
    if record.state == "corrected":
        raise InputError(
            f"recording {number} is already corrected. Give the raw readings: tables are subtracted from raw readings."
        )
    units = list[str]()
    for triad, values, unit in zip(
        calibration.triads, (record.gyro, record.accel), (record.gyro_unit, record.accel_unit), strict=True
    ):
        wanted = unit if values is None or triad.model is None else triad.model.unit_in
        if wanted != unit and not (is_physical(unit) and is_physical(wanted)):
            raise InputError(
                f"recording {number}: the {triad.sensor} readings are in {unit}, but the calibration is for {wanted}. Record in "
                "this unit, or calibrate in the unit of the recording."
            )
        units.append(wanted)
    if units != [record.gyro_unit, record.accel_unit]:
        record = replace(record.in_units(*units), gyro_unit=units[0], accel_unit=units[1])
    return restored(record, calibration.adc, None if calibration.gyro is None else calibration.gyro.code_offset)


def nominal_models(sessions: Sequence[Session]) -> Calibration:
    """Return a calibration with the nominal scale of the readings' units and unknown offsets."""
    first = sessions[0]
    unit = next((r.gyro_unit for s in sessions for r in s.records if r.gyro is not None), None)
    if unit is None:
        raise NotObservable(
            "drift: without a calibration, rests determine only changes of the accelerometer offset. Calibrate six faces, and give "
            "the calibration."
        )
    if not is_physical(unit):
        raise NotObservable(
            f"drift: gyroscope readings in {unit} have no known scale. Give `calibration`, or enter unit and gain in the map. "
            'Example for 16 bits over +-250 deg/s: gyro = "dps" in units, and scale = { gyro = { gain = 0.00763 } }.'
        )
    return Calibration(
        device=first.serial or first.records[0].device,
        reference_temp_c=float("nan"),
        gravity_m_s2=first.gravity_m_s2,
        gyro=nominal_triad(unit, "rate"),
        verdict=Verdict.of(
            finding(
                "calibration.nominal",
                "warn",
                "No calibration was given, so gyroscope scale and axes are nominal: rests cannot determine them.",
                "Calibrate with turns at known rates or angles.",
            )
        ),
        file_map=first.file_map,
    )


def not_observable(level: Level, what: str, problem: str, action: str = "") -> Finding:
    """Return a finding about a quantity that the sessions do not determine. A problem may already end in an action."""
    sentence = f"{what} is not observable: {problem}"
    return finding("drift.not_observable", level, sentence, action)
