"""Dwells: the steady stretches of a rate table, filtered and averaged.

The note filters each gyroscope signal with a cubic spline and averages it. A cubic smoothing spline f minimises
sum (y - f)^2 + lambda * integral f''^2: a low-pass of fourth order that halves the signal at the frequency with
lambda dt w^4 = 1. It leaves straight lines alone, so the mean over its samples is the mean of the readings, to rounding: the plain
mean is taken unless the filter is asked for.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.fit.noise import block_size, noise_of_means
from undrift.calibration.model import AXES
from undrift.calibration.plausibility import check_saturation
from undrift.errors import InputError
from undrift.record import Record
from undrift.session import Axis, Still, Turn

_LEAST_SAMPLES = 8


@dataclass(frozen=True, slots=True, kw_only=True)
class DwellSettings:
    """How a dwell is turned into a mean.

    Parameters
    ----------
    settle_s : float
        Start of each dwell that is thrown away, s; a second-order filter at 11 Hz settles to 0.1 % in 0.15 s.
    cutoff_hz : float or None
        Where the note's smoothing spline halves the signal, Hz; None leaves it out, which changes no mean.
    """

    settle_s: float = 0.3
    cutoff_hz: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DwellMeans:
    """Mean readings at steady rates.

    Parameters
    ----------
    reading : array, shape (N, 3)
        Mean of each dwell, ``unit``.
    turn_rate : array, shape (N,)
        Achieved rate about +axis, rad/s.
    axis : tuple of str
        Axis of each dwell.
    noise : array, shape (N, 3), or None
        Standard deviation of each mean; None when it is not known.
    up : array, shape (N,)
        1 where +axis points up, -1 where it points down, 0 where it is not vertical; all 1 by default.
    unit : str
        Unit of the readings.
    time : array, shape (N,), or None
        Middle of each dwell on one clock, s: recordings follow each other. None when it is not known.
    """

    reading: FloatArray
    turn_rate: FloatArray
    axis: tuple[Axis, ...]
    noise: FloatArray | None = None
    up: FloatArray = field(default_factory=lambda: np.ones(1))
    unit: str = "rad/s"
    time: FloatArray | None = None

    def __post_init__(self) -> None:
        n = len(self.axis)
        if self.reading.shape != (n, 3) or self.turn_rate.shape != (n,):
            raise InputError(
                f"dwells: wanted readings (N, 3) and rates (N,) for {n} axes, got {self.reading.shape} and {self.turn_rate.shape}"
            )

    def less(self, offset: FloatArray) -> "DwellMeans":
        """Return the same dwells with an offset taken off the readings.

        Parameters
        ----------
        offset : array, shape (3,)
            Unit of the readings.

        Returns
        -------
        DwellMeans
            Readings less offset.
        """
        return replace(self, reading=self.reading - offset)


def dwell_means(
    records: Sequence[Record], turns: Sequence[Turn], settings: DwellSettings = DwellSettings()
) -> DwellMeans:
    """Filter and average the steady turns of a session.

    Parameters
    ----------
    records : sequence of Record
        Recordings of the session, one gyroscope unit.
    turns : sequence of Turn
        Those without axis or turn_rate are left out.
    settings : DwellSettings
        Settling time and filter.

    Returns
    -------
    DwellMeans
        Means with their noise, pooled over all dwells of an axis.

    Raises
    ------
    InputError
        No gyroscope, units that differ, or a dwell shorter than its settling time.
    Implausible
        Saturated samples.
    """
    used = [t for t in turns if t.axis is not None and t.turn_rate is not None]
    unit = records[used[0].recording].gyro_unit if used else "rad/s"
    blocks = {k: block_size(records[k].sample_rate_hz) for k in {t.recording for t in used}}
    means, windows, sizes, up = [], [], [], []
    for turn in used:
        record = records[turn.recording]
        if record.gyro is None or record.gyro_unit != unit:
            raise InputError(
                f"rate table: wanted gyroscope readings in {unit} in every recording, got "
                f"{'none' if record.gyro is None else record.gyro_unit} in recording {turn.recording}; map the columns alike"
            )
        part = _settled(record, turn, settings.settle_s)
        values = part.gyro if part.gyro is not None else np.empty((0, 3))
        check_saturation(values, f"gyroscope at {turn.turn_rate:.4g} rad/s about {turn.axis}")
        cutoff = settings.cutoff_hz
        means.append((values if cutoff is None else spline_filter(part.time, values, cutoff)).mean(axis=0))
        windows.append(values)
        sizes.append(blocks[turn.recording])
        up.append(_points_up(part, AXES.index(turn.axis or "x")))
    return DwellMeans(
        reading=np.array(means).reshape(-1, 3),
        turn_rate=np.array([t.turn_rate for t in used], float),
        axis=tuple(t.axis for t in used if t.axis is not None),
        noise=noise_of_means(windows, sizes),
        up=np.array(up),
        unit=unit,
        time=middles(records, used),
    )


def middles(records: Sequence[Record], pieces: Sequence[Still | Turn]) -> FloatArray:
    """Return the middle of each stretch on one clock on which the recordings follow each other.

    Parameters
    ----------
    records : sequence of Record
        Recordings of the session, in order.
    pieces : sequence of Still or Turn
        Stretches in them.

    Returns
    -------
    array, shape (P,)
        s.
    """
    begins = np.concatenate(([0.0], np.cumsum([record.duration_s for record in records])))
    clocks = [record.time - record.time[0] for record in records]
    return np.array(
        [begins[p.recording] + 0.5 * (clocks[p.recording][p.start] + clocks[p.recording][p.stop - 1]) for p in pieces]
    )


def spline_filter(time: FloatArray, values: FloatArray, cutoff_hz: float) -> FloatArray:
    """Smooth each column with a cubic spline.

    Parameters
    ----------
    time : array, shape (N,)
        s, strictly increasing.
    values : array, shape (N, 3)
        Readings without gaps.
    cutoff_hz : float
        Where the signal is halved, Hz.

    Returns
    -------
    array, shape (N, 3)
        The spline at each sample.
    """
    from scipy.interpolate import make_smoothing_spline

    step = float(np.median(np.diff(time)))
    stiffness = 1.0 / (step * (2.0 * np.pi * cutoff_hz) ** 4)
    own = time - time[0]
    return np.column_stack([make_smoothing_spline(own, column, lam=stiffness)(own) for column in values.T])


def _settled(record: Record, turn: Turn, settle_s: float) -> Record:
    part = record.part(turn.start, turn.stop)
    start = int(np.searchsorted(part.time, part.time[0] + settle_s))
    if len(part) - start < _LEAST_SAMPLES:
        raise InputError(
            f"dwell [{turn.start}, {turn.stop}): wanted {_LEAST_SAMPLES} samples or more after {settle_s:g} s of settling, got "
            f"{len(part) - start}; dwell longer"
        )
    part = part.part(start, len(part))
    gap = np.isnan(part.gyro).any(axis=1) if part.gyro is not None else np.zeros(len(part), bool)
    if gap.any():
        raise InputError(
            f"dwell [{turn.start}, {turn.stop}): wanted readings without gaps, got {int(gap.sum())}; shorten it"
        )
    return part


def _points_up(part: Record, axis: int) -> float:
    if part.accel is None or part.accel_unit in ("count", "v"):
        return 1.0
    mean = np.nanmean(part.accel, axis=0)
    share = float(mean[axis] / np.linalg.norm(mean)) if np.linalg.norm(mean) > 0.0 else 0.0
    return float(np.sign(share)) if abs(share) > 0.9 else 0.0
