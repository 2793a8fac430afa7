"""Dwells: the steady stretches on a rate table, filtered and averaged; their rates; linearity of one axis."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.adc import code_steps, code_variance
from undrift.calibration.checks import axis_vectors, check_saturation
from undrift.calibration.observe import middles
from undrift.calibration.table_axis import TableAxes, table_term
from undrift.calibration.table_rate import SHOWS
from undrift.errors import InputError, NotObservable
from undrift.fit.least_squares import block_size, noise_of_means
from undrift.model import AXES, TriadModel
from undrift.record import Axis, Record, Turn
from undrift.units import EARTH_RATE, RADIAN_PER_DEGREE

_LEAST_SAMPLES = 8


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DwellMeans:
    """Mean readings at steady rates."""

    reading: FloatArray  # (N, 3), mean of each dwell, ``unit``
    turn_rate: FloatArray  # (N,), achieved rate about +axis, rad/s
    axis: tuple[Axis, ...]  # Axis of each dwell
    noise: FloatArray | None = None  # (N, 3), standard deviation of each mean; None when it is not known
    # (N,), 1 where +axis points up, -1 where it points down, 0 where it is not vertical; all 1 by default
    up: FloatArray = field(default_factory=lambda: np.ones(1))
    unit: str = "rad/s"  # Unit of the readings
    # (N,), middle of each dwell on one clock, s: recordings follow each other. None when it is not known
    time: FloatArray | None = None
    # (3,), step of the codes, 0 or NaN for none, and the variance that they leave in a mean, which is in ``noise`` too
    step: FloatArray = field(default_factory=lambda: np.zeros(3))
    codes: FloatArray = field(default_factory=lambda: np.zeros(3))
    axes: TableAxes | None = None  # About which axes the table turned the case; None takes ``axis`` as true
    mount_tilt: float = 0.0  # Standard uncertainty of the mounting, rad; used with ``axes`` alone

    def __post_init__(self) -> None:
        n = len(self.axis)
        if self.reading.shape != (n, 3) or self.turn_rate.shape != (n,):
            raise InputError(
                f"dwells: wanted readings (N, 3) and rates (N,) for {n} axes, got {self.reading.shape} and {self.turn_rate.shape}"
            )


def dwell_means(
    records: Sequence[Record], turns: Sequence[Turn], *, settle_s: float = 0.3, cutoff_hz: float | None = None
) -> DwellMeans:
    """Average the steady turns of a session.

    The first ``settle_s`` of each dwell are discarded: a second-order filter at 11 Hz settles to 0.1 % in 0.15 s. The note's
    smoothing spline halves the signal at ``cutoff_hz``; None leaves it out, which changes no mean.
    """
    used = [t for t in turns if t.axis is not None and t.turn_rate is not None]
    unit = records[used[0].recording].gyro_unit if used else "rad/s"
    blocks = {k: block_size(records[k].sample_rate_hz) for k in {t.recording for t in used}}
    parts = [_settled(records[t.recording], t, unit, settle_s) for t in used]
    windows = [np.asarray(part.gyro) for part in parts]
    smooth = [
        w if cutoff_hz is None else spline_filter(part.time, w, cutoff_hz)
        for part, w in zip(parts, windows, strict=True)
    ]
    noise = _noise(windows, [blocks[t.recording] for t in used], [AXES.index(t.axis or "x") for t in used])
    step = code_steps([records[k] for k in blocks], rate=True)
    codes = code_variance(step, np.median([w.var(axis=0) for w in windows], axis=0)) if used else np.zeros(3)
    return DwellMeans(
        reading=np.array([w.mean(axis=0) for w in smooth]).reshape(-1, 3),
        turn_rate=np.array([t.turn_rate for t in used], float),
        axis=tuple(t.axis for t in used if t.axis is not None),
        noise=None if noise is None else np.hypot(noise, np.sqrt(codes)),
        up=np.array([_points_up(part, AXES.index(t.axis or "x")) for part, t in zip(parts, used, strict=True)]),
        unit=unit,
        time=middles(records, used),
        step=step,
        codes=codes,
    )


def _noise(windows: list[FloatArray], sizes: list[int], own: list[int]) -> FloatArray | None:
    """Return the noise of each mean; a sensor whose own dwells scatter more, since the rate ripples, by its other dwells."""
    noise = noise_of_means(windows, sizes)
    for k in range(3):
        rows = [n for n, axis in enumerate(own) if axis != k]
        others = noise_of_means([windows[n] for n in rows], [sizes[n] for n in rows])
        if noise is None or others is None:
            continue
        spare = sum(len(windows[n]) // sizes[n] - 1 for n in rows)
        ratio = float((others[:, k] ** 2).sum() / max(float((noise[rows, k] ** 2).sum()), 1e-300))
        if ratio * (1.0 + SHOWS * (2.0 / spare) ** 0.5) < 1.0:
            noise[:, k] *= ratio**0.5
    return noise


def spline_filter(time: FloatArray, values: FloatArray, cutoff_hz: float) -> FloatArray:
    """Smooth each column of values (N, 3) with the note's cubic smoothing spline.

    It minimises sum (y - f)^2 + lambda integral f''^2: a low-pass of fourth order that halves the signal at the frequency w with
    lambda dt w^4 = 1. It keeps straight lines, so the mean over its samples is the mean of the readings, to rounding.
    """
    from scipy.interpolate import make_smoothing_spline

    stiffness = 1.0 / (float(np.median(np.diff(time))) * (2.0 * np.pi * cutoff_hz) ** 4)
    own = time - time[0]
    return np.column_stack([make_smoothing_spline(own, column, lam=stiffness)(own) for column in values.T])


def _settled(record: Record, turn: Turn, unit: str, settle_s: float) -> Record:
    if record.gyro is None or record.gyro_unit != unit:
        raise InputError(
            f"rate table: wanted gyroscope readings in {unit} in every recording, got "
            f"{'none' if record.gyro is None else record.gyro_unit} in recording {turn.recording}; map the columns alike"
        )
    part = record.part(turn.start, turn.stop)
    part = part.part(int(np.searchsorted(part.time, part.time[0] + settle_s)), len(part))
    if len(part) < _LEAST_SAMPLES:
        raise InputError(
            f"dwell [{turn.start}, {turn.stop}): wanted {_LEAST_SAMPLES} samples or more after {settle_s:g} s of settling, got "
            f"{len(part)}; dwell longer"
        )
    values = np.asarray(part.gyro)
    gaps = int(np.isnan(values).any(axis=1).sum())
    if gaps:
        raise InputError(f"dwell [{turn.start}, {turn.stop}): wanted readings without gaps, got {gaps}; shorten it")
    check_saturation(values, f"gyroscope at {turn.turn_rate:.4g} rad/s about {turn.axis}")
    return part


def _points_up(part: Record, axis: int) -> float:
    if part.accel is None or part.accel_unit in ("count", "v"):
        return 1.0
    mean = np.nanmean(part.accel, axis=0)
    share = float(mean[axis] / np.linalg.norm(mean)) if np.linalg.norm(mean) > 0.0 else 0.0
    return float(np.sign(share)) if abs(share) > 0.9 else 0.0


def imposed_rates(dwells: DwellMeans, latitude_deg: float | None) -> FloatArray:
    """Return the true rate of each dwell in b (N, 3), rad/s: L of eq. 4, transposed."""
    earth = 0.0 if latitude_deg is None else EARTH_RATE * np.sin(latitude_deg * RADIAN_PER_DEGREE)
    axis_b = axis_vectors(dwells.axis) if dwells.axes is None else dwells.axes.axis_b
    return np.asarray(axis_b * (dwells.turn_rate + earth * dwells.up)[:, None])


def with_table_errors(model: TriadModel, dwells: DwellMeans, sigma: FloatArray | None = None) -> TriadModel:
    """Return a model whose covariance also holds what the scatter of the readings does not show: table, mounting, creep.

    sigma (N, 3) are the standard deviations that weighed the dwells, with the errors that each has on its own; None without.
    """
    if dwells.axes is None:
        return model
    weight = np.ones((len(dwells.axis), 3)) if sigma is None else sigma**-2
    own = np.array([AXES.index(axis) for axis in dwells.axis])
    of_rates = dwells.axes.of_rates(own, weight * dwells.turn_rate[:, None] ** 2, alone=sigma is None)
    return replace(model, covariance=model.covariance + table_term(model, of_rates))


# ---- linearity of one axis (IEEE Std 1431, clause 12 terms)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Linearity:
    """Table of one axis: imposed rate, and how far the reading is from the line."""

    axis: Axis  # x, y or z
    turn_rate: FloatArray  # (N,), imposed, rad/s, increasing
    error: FloatArray  # (N,), reading less line, in rad/s of input
    scale_factor: float  # Slope of the line, reading per rad/s
    offset: float  # Reading of the line at zero rate
    scale_factor_nonlinearity: float  # Largest departure from the line, rad/s
    scale_factor_nonlinearity_percent: float  # The same in per cent of the largest imposed rate
    scale_factor_asymmetry: (
        float  # 2 (S+ - S-) / (S+ + S-) of reading = o + S+ max(w, 0) + S- min(w, 0); NaN for one sign
    )


def linearity(reading: FloatArray, turn_rate: FloatArray, axis: Axis) -> Linearity:
    """Compare readings (N,) of one axis at rates (N,) with their least-squares line, reading = o + S w."""
    if len(np.unique(turn_rate)) < 2:
        raise NotObservable(
            f"rate axis {axis}: wanted dwells at two different rates or more, got {len(np.unique(turn_rate))}; "
            "record both signs of several rates"
        )
    order = np.argsort(turn_rate)
    rate, value = turn_rate[order], reading[order]
    offset, slope = np.linalg.lstsq(np.column_stack((np.ones_like(rate), rate)), value, rcond=None)[0]
    error = (value - offset - slope * rate) / slope
    worst, asymmetry = float(np.abs(error).max()), float("nan")
    if len(np.unique(rate)) > 2 and rate[0] < 0.0 < rate[-1]:
        bent = np.column_stack((np.ones_like(rate), np.maximum(rate, 0.0), np.minimum(rate, 0.0)))
        _, plus, minus = np.linalg.lstsq(bent, value, rcond=None)[0]
        asymmetry = float(2.0 * (plus - minus) / (plus + minus))
    return Linearity(
        axis=axis,
        turn_rate=rate,
        error=error,
        scale_factor=float(slope),
        offset=float(offset),
        scale_factor_nonlinearity=worst,
        scale_factor_nonlinearity_percent=100.0 * worst / float(np.abs(rate).max()),
        scale_factor_asymmetry=asymmetry,
    )
