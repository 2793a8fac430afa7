"""Which tables a device needs: none, scale over temperature, dynamic drift, or both, by cross-validation.

Each of the four is fitted without a soak (those between the first and the last) and without some of the rates, and predicts the
steps that were held out: ``M(T) (u - offset(T)) - e`` less the imposed rate, all three axes, about the offset of their mounting.
The one with the least mean square is best; the simplest whose mean square lies within one standard error of it is taken [1]_; so
is one whose rms is within 5 %, which no table is worth.

Tables are cut to the temperatures asked for only after they were fitted and selected over all that was seen: a table holds its ends
beyond them, and the selection would depend on the range. They are linear between nodes, so that cutting changes no value inside.

References
----------
.. [1] L. Breiman, J. H. Friedman, R. A. Olshen, C. J. Stone, "Classification and Regression Trees", 1984, section 3.4.3.
"""

from dataclasses import dataclass, replace
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from undrift.arrays import BoolArray, FloatArray, IntArray
from undrift.drift.dynamic import DEFAULT_STEP_C, DynamicFit, DynamicSettings, fit_dynamic, softness_of
from undrift.drift.observe import RateSteps, RestBlocks
from undrift.drift.scale import ScaleFit, Steps, fit_scale, measured_rate, steps_of
from undrift.drift.static import StaticFit, TriadDrift, far_from_data
from undrift.errors import CalibrationError, NotObservable
from undrift.findings import Finding, finding
from undrift.model import Calibration, DynamicDrift, ScaleDrift, StaticDrift, Verdict
from undrift.units import RADIAN_PER_DEGREE

Alternative = Literal["none", "scale", "dynamic", "scale + dynamic"]
ALTERNATIVES: tuple[Alternative, ...] = ("none", "scale", "dynamic", "scale + dynamic")  # simplest first
T = TypeVar("T", bound=np.generic)
_RATE_FOLDS = 4
_SAME_C = 1.0  # between soaks, in the order of their temperature: further apart is another set-point
_WORTH = 1.05  # a table more has to reduce the rms by this factor at least


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Alternatives:
    """Cross-validated error of each choice of tables, and which was taken."""

    name: tuple[Alternative, ...]
    fitted_rms_dps: FloatArray  # (4,), residual of the fit to all steps, deg/s; NaN where it could not be fitted
    soak_rms_dps: FloatArray  # (4,), of the soaks that were held out; NaN with fewer than three set-points
    rate_rms_dps: FloatArray  # (4,), of the rates that were held out; NaN with fewer than three rates
    left_out_rms_dps: FloatArray  # (4,), of both together: the choice is made by it
    standard_error_dps: FloatArray  # (4,), standard error of ``left_out_rms_dps``
    chosen: Alternative
    why: Finding

    @property
    def reason(self) -> str:
        """Why, as a text."""
        return self.why.text


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Choice:
    """The tables that were taken, and those that were not."""

    alternatives: Alternatives
    scale: ScaleFit | None  # fitted to all steps, whether taken or not; None where not observable
    dynamic: DynamicFit | None  # with the constant matrix, likewise
    both: DynamicFit | None  # on top of ``scale``, likewise
    verdict: Verdict  # of what was taken

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


def choose_tables(
    steps: RateSteps,
    calibration: Calibration,
    *,
    static: StaticDrift | None,
    temp_c: FloatArray,
    rests: RestBlocks | None = None,
    settings: DynamicSettings = DynamicSettings(),
) -> Choice:
    """Fit all alternatives, select one by cross-validation; nodes temp_c (n,), degC."""
    if settings.temp_c is None:  # multiples of 5 degC inside the span, and its ends
        low, high = float(temp_c[0]), float(temp_c[-1])
        between = DEFAULT_STEP_C * np.arange(np.ceil(low / DEFAULT_STEP_C), np.floor(high / DEFAULT_STEP_C) + 1.0)
        inside = between[(between > low + 1e-9) & (between < high - 1e-9)]
        settings = replace(settings, temp_c=np.concatenate(([low], inside, [high])))
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
    table = _cross_validated(data, fits)
    return Choice(
        alternatives=table,
        scale=fits.scale,
        dynamic=fits.dynamic,
        both=fits.both,
        verdict=_verdict(table, fits, int(_set_points(data.steps)[1].max()) + 1).also(data.steps.verdict),
    )


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


def _fit_all(data: _Data, steps: Steps, like: _Fits | None = None) -> _Fits:
    """Fit every alternative to some steps; as soft as earlier fits where these are given."""
    scale = dynamic = both = None
    try:
        scale = fit_scale(steps, data.calibration, static=data.static, temp_c=data.temp_c)
    except CalibrationError:
        scale = None  # the others may still be had

    def fitted(matrix: ScaleDrift | None, earlier: DynamicFit | None) -> DynamicFit:
        settings = data.settings if earlier is None else replace(data.settings, softness=softness_of(earlier))
        return fit_dynamic(
            steps, data.calibration, static=data.static, scale=matrix, rests=data.rests, settings=settings
        )

    try:
        dynamic = fitted(None, like.dynamic if like else None)
        both = None if scale is None else fitted(scale.drift, like.both if like else None)
    except CalibrationError:
        dynamic = both = None
    return _Fits(scale=scale, dynamic=dynamic, both=both)


def _cross_validated(data: _Data, fits: _Fits) -> Alternatives:
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
    square = np.where(missing, np.nan, _mean(squares) if len(squares) else fitted)
    error = np.zeros(len(ALTERNATIVES))
    if len(squares) > 1:
        error = squares.std(axis=0, ddof=1) / np.sqrt(len(squares))
    rms = np.sqrt(square)
    why = _selected(square, error, steps, len(by_soak))
    return Alternatives(
        name=ALTERNATIVES,
        fitted_rms_dps=np.sqrt(fitted) / RADIAN_PER_DEGREE,
        soak_rms_dps=np.sqrt(_mean(soak)) / RADIAN_PER_DEGREE,
        rate_rms_dps=np.sqrt(_mean(rate)) / RADIAN_PER_DEGREE,
        left_out_rms_dps=rms / RADIAN_PER_DEGREE,
        standard_error_dps=0.5 * error / rms / RADIAN_PER_DEGREE,
        chosen=why.values["tables"],  # type: ignore[arg-type]
        why=why,
    )


def _selected(square: FloatArray, error: FloatArray, steps: Steps, held_out: int) -> Finding:
    """Take the simplest within one standard error, or 5 % of rms, of the best."""
    best = int(np.nanargmin(square))
    limit = max(square[best] + error[best], square[best] * _WORTH**2)
    chosen = int(np.flatnonzero(square <= limit)[0])
    dps = np.sqrt(square) / RADIAN_PER_DEGREE
    numbers, point = _set_points(steps)
    soaks, points = len(numbers), int(point.max()) + 1
    if chosen == best:
        return finding(
            "drift.tables_best",
            "info",
            tables=ALTERNATIVES[chosen],
            error_dps=dps[chosen],
            held_out=held_out,
            soaks=soaks,
            set_points=points,
        )
    return finding(
        "drift.tables_simplest",
        "info",
        tables=ALTERNATIVES[chosen],
        error_dps=dps[chosen],
        held_out=held_out,
        soaks=soaks,
        set_points=points,
        best=ALTERNATIVES[best],
        best_dps=dps[best],
    )


def _soak_folds(steps: Steps) -> list[BoolArray]:
    """Return the rows of each soak but those at the coldest and hottest set-point: nothing predicts beyond them."""
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


def _verdict(table: Alternatives, fits: _Fits, points: int) -> Verdict:
    verdict = Verdict(findings=(table.why,))
    if table.chosen in ("scale", "scale + dynamic") and fits.scale is not None:
        verdict = verdict.also(fits.scale.verdict)
    dynamic = {"dynamic": fits.dynamic, "scale + dynamic": fits.both}.get(table.chosen)
    if dynamic is not None:
        verdict = verdict.also(dynamic.verdict)
    if points < 3:
        alone = finding("drift.tables_by_rates", "warn", set_points=points)
        verdict = verdict.also(Verdict(status="marginal", findings=(alone,)))
    return verdict


# ---- tables cut to the temperatures asked for


def widened(nodes: FloatArray, span_c: tuple[float, float]) -> FloatArray:
    """Return nodes continued at the same step until they span a range, degC."""
    step = float(nodes[-1] - nodes[0]) / (len(nodes) - 1)
    below = max(int(np.ceil((nodes[0] - span_c[0]) / step - 1e-9)), 0)
    above = max(int(np.ceil((span_c[1] - nodes[-1]) / step - 1e-9)), 0)
    return np.concatenate(
        (nodes[0] - step * np.arange(below, 0, -1), nodes, nodes[-1] + step * np.arange(1, above + 1))
    )


def cropped_static(fit: StaticFit, nodes: FloatArray) -> StaticFit:
    """Return the offsets at some of their nodes (n,), degC."""
    keep = _nodes_of(fit.table.temp_c, nodes)
    gyro, accel = (found and _cropped_triad(found, keep) for found in (fit.gyro, fit.accel))
    table = replace(
        fit.table,
        temp_c=fit.table.temp_c[keep],
        gyro_offset=_rows_of(fit.table.gyro_offset, keep),
        gyro_uncertainty=_rows_of(fit.table.gyro_uncertainty, keep),
        gyro_extrapolated=_rows_of(fit.table.gyro_extrapolated, keep),
        accel_offset=_rows_of(fit.table.accel_offset, keep),
        accel_uncertainty=_rows_of(fit.table.accel_uncertainty, keep),
        accel_extrapolated=_rows_of(fit.table.accel_extrapolated, keep),
    )
    kept = [item for item in fit.verdict.findings if item.code != "drift.nodes_extrapolated"]
    kept += [] if gyro is None else far_from_data("gyroscope", gyro)
    kept += [] if accel is None or accel.offset is None else far_from_data("accelerometer", accel)
    return replace(fit, table=table, gyro=gyro, accel=accel, verdict=replace(fit.verdict, findings=tuple(kept)))


def cropped_choice(choice: Choice, nodes: FloatArray) -> Choice:
    """Return what was chosen with all its tables cut to nodes (n,), degC."""
    scale = choice.scale
    return replace(
        choice,
        scale=None if scale is None else replace(scale, drift=_cropped_scale(scale.drift, nodes)),
        dynamic=choice.dynamic and _cropped_dynamic(choice.dynamic, nodes),
        both=choice.both and _cropped_dynamic(choice.both, nodes),
    )


def _nodes_of(temp_c: FloatArray, nodes: FloatArray) -> slice:
    first = int(np.argmin(np.abs(temp_c - nodes[0])))
    return slice(first, first + len(nodes))


def _rows_of(values: NDArray[T] | None, keep: slice) -> NDArray[T] | None:
    return None if values is None else values[keep]


def _cropped_triad(found: TriadDrift, keep: slice) -> TriadDrift:
    return replace(
        found,
        offset=_rows_of(found.offset, keep),
        uncertainty=found.uncertainty[keep],
        extrapolated=found.extrapolated[keep],
        unknown_scale=_rows_of(found.unknown_scale, keep),
    )


def _cropped_scale(drift: ScaleDrift, nodes: FloatArray) -> ScaleDrift:
    keep = _nodes_of(drift.temp_c, nodes)
    return replace(
        drift,
        temp_c=drift.temp_c[keep],
        gyro_matrix=_rows_of(drift.gyro_matrix, keep),
        gyro_uncertainty=_rows_of(drift.gyro_uncertainty, keep),
        gyro_extrapolated=_rows_of(drift.gyro_extrapolated, keep),
    )


def _cropped_dynamic(fit: DynamicFit, nodes: FloatArray) -> DynamicFit:
    """Its nodes lie further apart: the ends asked for become nodes, linear between their neighbours."""
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
