"""Which tables a device needs: none, scale over temperature, dynamic drift, or both, judged on what was left out.

Each of the four is fitted without a soak (those between the first and the last) and without some of the rates, and foretells the
steps that were left out: ``M(T) (u - offset(T)) - e`` less the imposed rate, all three axes, about the offset that the mounting
was left with. The one with the least mean square is best; the simplest whose mean square lies within one standard error of
it, over what was left out in turn, is taken [1]_; so is one whose rms is within 5 %, which no table is worth.

References
----------
.. [1] L. Breiman, J. H. Friedman, R. A. Olshen, C. J. Stone, "Classification and Regression Trees", 1984, section 3.4.3.

Tables cut to the temperatures asked for, after they were fitted and judged over all that was seen.

A table holds its ends beyond them. Were it fitted to the range asked for, the soaks outside would be judged by held ends, and the
choice of tables would hang on the range. Tables are linear between nodes, so that cutting changes no value inside.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray
from undrift.drift.dynamic import DEFAULT_STEP_C, DynamicFit, DynamicSettings, fit_dynamic, softness_of
from undrift.drift.observe import RateSteps, RestBlocks
from undrift.drift.scale import ScaleFit, Steps, fit_scale, measured_rate, steps_of
from undrift.drift.static import StaticFit, TriadDrift, far_from_data
from undrift.errors import CalibrationError, NotObservable
from undrift.model import Calibration, DynamicDrift, ScaleDrift, StaticDrift, Verdict
from undrift.units import RADIAN_PER_DEGREE

Alternative = Literal["none", "scale", "dynamic", "scale + dynamic"]
ALTERNATIVES: tuple[Alternative, ...] = ("none", "scale", "dynamic", "scale + dynamic")  # simplest first
_RATE_FOLDS = 4
_SAME_C = 1.0  # between soaks, in the order of their temperature: further apart is another set-point
_WORTH = 1.05  # a table more has to earn this factor of rms at least, however well it is known


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Alternatives:
    """What each choice of tables foretells, and which was taken."""

    name: tuple[Alternative, ...]  # none, scale, dynamic, scale + dynamic
    # (4,), root-mean-square residual of the fit to all steps, deg/s; NaN where it could not be fitted
    fitted_rms_dps: FloatArray
    soak_rms_dps: FloatArray  # (4,), of the soaks that were left out; NaN with fewer than three set-points
    rate_rms_dps: FloatArray  # (4,), of the rates that were left out; NaN with fewer than three rates
    left_out_rms_dps: FloatArray  # (4,), of both together: what the choice rests on
    standard_error_dps: FloatArray  # (4,), standard error of ``left_out_rms_dps``
    chosen: Alternative  # One of the names
    reason: str  # Why, in words


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Choice:
    """The tables that were taken, and those that were not."""

    alternatives: Alternatives  # The table of figures
    # Matrix over temperature fitted to all steps, whether taken or not; None where not observable
    scale: ScaleFit | None
    dynamic: DynamicFit | None  # Dynamic drift with the constant matrix, likewise
    both: DynamicFit | None  # Dynamic drift on top of ``scale``, likewise
    verdict: Verdict  # Of what was taken

    @property
    def scale_drift(self) -> ScaleDrift | None:
        """The matrix table to use."""
        taken = self.alternatives.chosen in ("scale", "scale + dynamic")
        return self.scale.drift if taken and self.scale is not None else None

    @property
    def dynamic_drift(self) -> DynamicDrift | None:
        """The dynamic table to use."""
        fit = {"dynamic": self.dynamic, "scale + dynamic": self.both}.get(self.alternatives.chosen)
        return None if fit is None else fit.drift


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Data:
    """What every fit takes."""

    steps: Steps
    calibration: Calibration
    static: StaticDrift | None
    rests: RestBlocks | None
    temp_c: FloatArray
    settings: DynamicSettings


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Fits:
    """The fits of all alternatives to one part of the data."""

    scale: ScaleFit | None
    dynamic: DynamicFit | None
    both: DynamicFit | None

    def residuals(self, data: _Data, which: Alternative) -> FloatArray:
        """What an alternative leaves of all steps, rad/s, shape (n, 3); NaN where it has no fit."""
        scale = self.scale if which in ("scale", "scale + dynamic") else None
        dynamic = self.dynamic if which == "dynamic" else self.both if which == "scale + dynamic" else None
        if ("scale" in which and scale is None) or ("dynamic" in which and dynamic is None):
            return np.full((len(data.steps), 3), np.nan)
        steps = data.steps
        w = measured_rate(
            steps.gyro, steps.temp_c, data.calibration, static=data.static, scale=scale.drift if scale else None
        )
        for axis, surface in enumerate(dynamic.surfaces if dynamic else ()):
            if surface is not None:
                w[:, axis] -= surface.at(w[:, axis], steps.temp_c)
        return np.asarray(w - steps.rate_b)


def choose_tables(
    steps: RateSteps,
    calibration: Calibration,
    *,
    static: StaticDrift | None,
    temp_c: FloatArray,
    rests: RestBlocks | None = None,
    settings: DynamicSettings = DynamicSettings(),
) -> Choice:
    """Fit all alternatives, judge them by what they foretell, and take one.

    Arrays: temp_c (n,) degC.
    """
    settings = settings if settings.temp_c is not None else replace(settings, temp_c=_spanning(temp_c))
    data = _Data(
        steps=steps_of(steps), calibration=calibration, static=static, rests=rests, temp_c=temp_c, settings=settings
    )
    soaks = len(np.unique(data.steps.soak))
    if soaks < 2:
        raise NotObservable(
            f"scale and dynamic drift: wanted rate steps at two soaks or more, got one at {data.steps.temp_c.mean():.1f} degC; "
            "repeat the steps at another temperature, or keep the constant matrix",
            soaks=soaks,
        )
    fits = _fit_all(data, data.steps)
    if fits.scale is None and fits.dynamic is None:
        raise NotObservable(
            f"scale and dynamic drift: wanted an axis turned at two rates at two soaks, got {len(data.steps)} steps at {soaks} "
            "soaks without; repeat the same turns at another temperature",
            soaks=soaks,
        )
    table = _judged(data, fits)
    return Choice(
        alternatives=table,
        scale=fits.scale,
        dynamic=fits.dynamic,
        both=fits.both,
        verdict=_verdict(table, fits, int(_set_points(data.steps)[1].max()) + 1).also(data.steps.verdict),
    )


def _spanning(temp_c: FloatArray) -> FloatArray:
    """Return the multiples of 5 degC inside a span, and its ends."""
    low, high = float(temp_c[0]), float(temp_c[-1])
    between = DEFAULT_STEP_C * np.arange(np.ceil(low / DEFAULT_STEP_C), np.floor(high / DEFAULT_STEP_C) + 1.0)
    inside = between[(between > low + 1e-9) & (between < high - 1e-9)]
    return np.concatenate(([low], inside, [high]))


def _fit_all(data: _Data, steps: Steps, like: _Fits | None = None) -> _Fits:
    """Fit every alternative to some steps; as soft as earlier fits where these are given."""
    scale = dynamic = both = None
    try:
        scale = fit_scale(steps, data.calibration, static=data.static, temp_c=data.temp_c)
    except CalibrationError:
        scale = None  # the others may still be had
    alone = data.settings if like is None or like.dynamic is None else _as_soft(data.settings, like.dynamic)
    on_top = data.settings if like is None or like.both is None else _as_soft(data.settings, like.both)
    try:
        dynamic = _dynamic(data, steps, None, alone)
        both = None if scale is None else _dynamic(data, steps, scale.drift, on_top)
    except CalibrationError:
        dynamic = both = None
    return _Fits(scale=scale, dynamic=dynamic, both=both)


def _dynamic(data: _Data, steps: Steps, scale: ScaleDrift | None, settings: DynamicSettings) -> DynamicFit:
    return fit_dynamic(steps, data.calibration, static=data.static, scale=scale, rests=data.rests, settings=settings)


def _as_soft(settings: DynamicSettings, fit: DynamicFit) -> DynamicSettings:
    return replace(settings, softness=softness_of(fit))


def _judged(data: _Data, fits: _Fits) -> Alternatives:
    steps = data.steps
    by_soak, by_rate = _soak_folds(steps), _rate_folds(steps)
    squares = np.full((len(by_soak) + len(by_rate), len(ALTERNATIVES)), np.nan)
    for k, fold in enumerate((*by_soak, *by_rate)):
        part = _fit_all(data, steps.taken(~fold), fits)
        for a, which in enumerate(ALTERNATIVES):
            squares[k, a] = _mean_square(part.residuals(data, which), steps.mounting, fold, whole=k < len(by_soak))
    fitted = np.array(
        [
            _mean_square(fits.residuals(data, which), steps.mounting, np.ones(len(steps), bool), whole=True)
            for which in ALTERNATIVES
        ]
    )
    missing = np.isnan(fitted)
    soak, rate = squares[: len(by_soak)], squares[len(by_soak) :]
    judged = np.where(missing, np.nan, _mean(squares) if len(squares) else fitted)
    error = _standard_error(squares)
    chosen, reason = _one_standard_error(judged, error, _left_out(steps))
    rms = np.sqrt(judged)
    return Alternatives(
        name=ALTERNATIVES,
        fitted_rms_dps=np.sqrt(fitted) / RADIAN_PER_DEGREE,
        soak_rms_dps=np.sqrt(_mean(soak)) / RADIAN_PER_DEGREE,
        rate_rms_dps=np.sqrt(_mean(rate)) / RADIAN_PER_DEGREE,
        left_out_rms_dps=rms / RADIAN_PER_DEGREE,
        standard_error_dps=0.5 * error / rms / RADIAN_PER_DEGREE,
        chosen=chosen,
        reason=reason,
    )


def _soak_folds(steps: Steps) -> list[BoolArray]:
    """Return the rows of each soak but those at the coldest and hottest set-point: what lies beyond nobody can foretell."""
    numbers, point = _set_points(steps)
    return [steps.soak == s for s in numbers[(point > 0) & (point < point.max())]]


def _set_points(steps: Steps) -> tuple[IntArray, IntArray]:
    """Return the soaks and which set-point each was at, from the coldest: soaks of one may be many, of each axis or each way."""
    numbers = np.unique(steps.soak)
    middle = np.array([steps.temp_c[steps.soak == s].mean() for s in numbers])
    order = np.argsort(middle, kind="stable")
    point = np.zeros(len(numbers), np.int64)
    point[order[1:]] = np.cumsum(np.diff(middle[order]) > _SAME_C)
    return numbers, point


def _left_out(steps: Steps) -> str:
    """Return what was left out in turn, with how many soaks and set-points there were."""
    soaks = len(_soak_folds(steps))
    numbers, point = _set_points(steps)
    points = int(point.max()) + 1
    there = f"{len(numbers)} soaks" if points == len(numbers) else f"{len(numbers)} soaks at {points} set-points"
    if not soaks:
        return f"the rates left out in turn ({there}, none between others)"
    return f"{soaks} of {there} (not the coldest and hottest) and the rates, left out in turn,"


def _rate_folds(steps: Steps) -> list[BoolArray]:
    """Return the rows of every fourth rate in turn, but for the greatest."""
    size = np.abs(steps.along)
    level = np.unique(np.round(size / (0.01 * size.max())), return_inverse=True)[1].reshape(-1)
    most = int(level.max())
    return [(level % _RATE_FOLDS == k) & (level < most) for k in range(min(_RATE_FOLDS, most))] if most > 1 else []


def _mean_square(residuals: FloatArray, mounting: IntArray, fold: BoolArray, *, whole: bool) -> float:
    """Return the mean square of the fold's residuals about its mountings' own offsets, (rad/s)^2."""
    about = fold if whole else ~fold
    left = residuals[fold].copy()
    for m in np.unique(mounting[fold]):
        inside = about & (mounting == m)
        if inside.any():
            left[mounting[fold] == m] -= residuals[inside].mean(axis=0)
    return float(np.mean(left**2))


def _mean(squares: FloatArray) -> FloatArray:
    if not len(squares):
        return np.full(len(ALTERNATIVES), np.nan)
    return np.asarray(squares.mean(axis=0))


def _standard_error(squares: FloatArray) -> FloatArray:
    if len(squares) < 2:
        return np.full(len(ALTERNATIVES), 0.0)
    return np.asarray(squares.std(axis=0, ddof=1) / np.sqrt(len(squares)))


def _one_standard_error(judged: FloatArray, error: FloatArray, told: str) -> tuple[Alternative, str]:
    best = int(np.nanargmin(judged))
    limit = max(judged[best] + error[best], judged[best] * _WORTH**2)
    chosen = int(np.flatnonzero(judged <= limit)[0])
    dps = np.sqrt(judged) / RADIAN_PER_DEGREE
    if chosen == best:
        return ALTERNATIVES[chosen], (
            f"{ALTERNATIVES[chosen]}: it foretells {told} best, to {dps[best]:.4f} deg/s rms, and nothing simpler comes within one "
            "standard error or 5 %"
        )
    return ALTERNATIVES[chosen], (
        f"{ALTERNATIVES[chosen]}: it foretells {told} to {dps[chosen]:.4f} deg/s rms, within one standard error or 5 % of the best "
        f"({ALTERNATIVES[best]}, {dps[best]:.4f} deg/s), and is simpler"
    )


def _verdict(table: Alternatives, fits: _Fits, points: int) -> Verdict:
    verdict = Verdict(remarks=(table.reason,))
    if table.chosen in ("scale", "scale + dynamic") and fits.scale is not None:
        verdict = verdict.also(fits.scale.verdict)
    dynamic = {"dynamic": fits.dynamic, "scale + dynamic": fits.both}.get(table.chosen)
    if dynamic is not None:
        verdict = verdict.also(dynamic.verdict)
    if points < 3:
        reason = (
            "soaks at two set-points: none between others could be left out, and the choice rests on the rates alone; add a soak "
            "at a third"
        )
        verdict = verdict.also(Verdict(status="marginal", remarks=(reason,)))
    return verdict


# ---- Tables cut to the temperatures asked for, after they were fitted and judged over all that was seen.


def widened(nodes: FloatArray, span_c: tuple[float, float]) -> FloatArray:
    """Return nodes that go on at the same step until they span a range.

    Arrays: nodes (n,) degC -> (m,) degC.
    """
    step = float(nodes[-1] - nodes[0]) / (len(nodes) - 1)
    below = max(int(np.ceil((nodes[0] - span_c[0]) / step - 1e-9)), 0)
    above = max(int(np.ceil((span_c[1] - nodes[-1]) / step - 1e-9)), 0)
    return np.concatenate(
        (nodes[0] - step * np.arange(below, 0, -1), nodes, nodes[-1] + step * np.arange(1, above + 1))
    )


def cropped_static(fit: StaticFit, nodes: FloatArray) -> StaticFit:
    """Return the offsets at some of their nodes.

    Arrays: nodes (n,) degC.
    """
    keep = _rows(fit.table.temp_c, nodes)
    gyro, accel = _triad(fit.gyro, keep), _triad(fit.accel, keep)
    table = replace(
        fit.table,
        temp_c=fit.table.temp_c[keep],
        gyro_offset=_some(fit.table.gyro_offset, keep),
        gyro_uncertainty=_some(fit.table.gyro_uncertainty, keep),
        gyro_extrapolated=_marks(fit.table.gyro_extrapolated, keep),
        accel_offset=_some(fit.table.accel_offset, keep),
        accel_uncertainty=_some(fit.table.accel_uncertainty, keep),
        accel_extrapolated=_marks(fit.table.accel_extrapolated, keep),
    )
    reasons = [reason for reason in fit.verdict.reasons if "are marked extrapolated" not in reason]
    reasons += [] if gyro is None else far_from_data("gyroscope", gyro)
    reasons += [] if accel is None or accel.offset is None else far_from_data("accelerometer", accel)
    return replace(fit, table=table, gyro=gyro, accel=accel, verdict=replace(fit.verdict, remarks=tuple(reasons)))


def cropped_choice(choice: Choice, nodes: FloatArray) -> Choice:
    """Return what was chosen with all its tables cut.

    Arrays: nodes (n,) degC.
    """
    scale = choice.scale
    return replace(
        choice,
        scale=None if scale is None else replace(scale, drift=_scale(scale.drift, nodes)),
        dynamic=_dynamic_crop(choice.dynamic, nodes),
        both=_dynamic_crop(choice.both, nodes),
    )


def _rows(temp_c: FloatArray, nodes: FloatArray) -> slice:
    first = int(np.argmin(np.abs(temp_c - nodes[0])))
    return slice(first, first + len(nodes))


def _some(values: FloatArray | None, keep: slice) -> FloatArray | None:
    return None if values is None else values[keep]


def _marks(values: BoolArray | None, keep: slice) -> BoolArray | None:
    return None if values is None else values[keep]


def _triad(found: TriadDrift | None, keep: slice) -> TriadDrift | None:
    if found is None:
        return None
    return replace(
        found,
        offset=_some(found.offset, keep),
        uncertainty=found.uncertainty[keep],
        extrapolated=found.extrapolated[keep],
        unknown_scale=_some(found.unknown_scale, keep),
    )


def _scale(drift: ScaleDrift, nodes: FloatArray) -> ScaleDrift:
    keep = _rows(drift.temp_c, nodes)
    return replace(
        drift,
        temp_c=drift.temp_c[keep],
        gyro_matrix=_some(drift.gyro_matrix, keep),
        gyro_uncertainty=_some(drift.gyro_uncertainty, keep),
        gyro_extrapolated=_marks(drift.gyro_extrapolated, keep),
    )


def _dynamic_crop(fit: DynamicFit | None, nodes: FloatArray) -> DynamicFit | None:
    """Its nodes lie further apart: the ends asked for become nodes, linear between their neighbours."""
    if fit is None:
        return None
    old, low, high = fit.drift.temp_c, nodes[0], nodes[-1]
    at = np.concatenate(([low], old[(old > low + 1e-9) & (old < high - 1e-9)], [high]))
    right = np.clip(np.searchsorted(old, at - 1e-9), 1, len(old) - 1)
    share = np.clip((at - old[right - 1]) / (old[right] - old[right - 1]), 0.0, 1.0)[:, None]

    def between(values: FloatArray) -> FloatArray:
        weight = share.reshape(-1, *[1] * (values.ndim - 1))
        return np.where(
            weight == 0.0,
            values[right - 1],
            np.where(weight == 1.0, values[right], (1.0 - weight) * values[right - 1] + weight * values[right]),
        )

    drift: DynamicDrift = fit.drift
    marks = None if drift.extrapolated is None else between(drift.extrapolated.astype(float)) > 0.0
    cut = replace(
        drift,
        temp_c=at,
        error=between(drift.error),
        uncertainty=None if drift.uncertainty is None else between(drift.uncertainty),
        extrapolated=marks,
    )
    return replace(fit, drift=cut)
