"""Which tables a device needs: none, scale over temperature, dynamic drift, or both, by cross-validation.

Each of the four is fitted without a soak (those between the first and the last) and without some of the rates, and predicts the
steps that were held out: ``M(T) (u - offset(T)) - e`` less the imposed rate, all three axes, about the offset of their mounting;
with one rate one way round, about the rest of the same soak (drift/scale.py).
The one with the least mean square is best; the simplest whose mean square lies within one standard error of it is taken [1]_; so
is one whose rms is within 5 %, which no table is worth. Where nothing can be held out the matrix that was fitted is kept.

Tables are cut to the temperatures asked for only after they were fitted and selected over all that was seen: a table holds its ends
beyond them, and the selection would depend on the range. They are linear between nodes, so that cutting changes no value inside.

References
----------
.. [1] L. Breiman, J. H. Friedman, R. A. Olshen, C. J. Stone, "Classification and Regression Trees", 1984, section 3.4.3.
"""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, Literal, TypeVar

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray
from undrift.drift.dynamic import DEFAULT_STEP_C, DynamicFit, fit_dynamic
from undrift.drift.observe import RateSteps, RestBlocks
from undrift.drift.scale import ScaleFit, Steps, fit_scale, measured_rate, of_one_rate, steps_of, with_rest_as_zero
from undrift.drift.static import StaticFit, TriadDrift, far_from_data
from undrift.errors import CalibrationError, NotObservable
from undrift.findings import Finding, finding
from undrift.model import Calibration, DynamicDrift, ScaleDrift, StaticDrift, Verdict
from undrift.units import RADIAN_PER_DEGREE

Alternative = Literal["none", "scale", "dynamic", "scale + dynamic"]
ALTERNATIVES: tuple[Alternative, ...] = ("none", "scale", "dynamic", "scale + dynamic")  # simplest first
T = TypeVar("T", StaticDrift, ScaleDrift, DynamicDrift, TriadDrift)
# Fields of one row a node
_BY_NODE = ("temp_c", "offset", "matrix", "error", "uncertainty", "extrapolated", "unknown_scale")
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
    left_out_rms_dps: FloatArray  # (4,), of both together: the choice is made by it; NaN where none could be
    standard_error_dps: FloatArray  # (4,), standard error of ``left_out_rms_dps``
    chosen: Alternative
    why: Finding

    @property
    def reason(self) -> str:
        """Why, as a text."""
        return self.why.text


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fits:
    """The fits of all alternatives to one set of steps, whether taken or not; None where not observable."""

    scale: ScaleFit | None
    dynamic: DynamicFit | None  # with the constant matrix
    both: DynamicFit | None  # on top of ``scale``

    def taken(self, which: Alternative) -> tuple[ScaleFit | None, DynamicFit | None]:
        """Return the fits that an alternative takes."""
        dynamic = {"dynamic": self.dynamic, "scale + dynamic": self.both}.get(which)
        return self.scale if "scale" in which else None, dynamic

    def verdict_of(self, which: Alternative, why: Finding) -> Verdict:
        """Return why an alternative was taken, and what its fits are worth."""
        verdict = Verdict.of(why)
        for fit in self.taken(which):
            verdict = verdict if fit is None else verdict.also(fit.verdict)
        return verdict


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Choice(Fits):
    """The tables that were taken, and those that were not."""

    alternatives: Alternatives
    verdict: Verdict  # of what was taken

    @property
    def scale_drift(self) -> ScaleDrift | None:
        """The matrix table to use."""
        scale = self.taken(self.alternatives.chosen)[0]
        return None if scale is None else scale.drift

    @property
    def dynamic_drift(self) -> DynamicDrift | None:
        """The dynamic table to use."""
        dynamic = self.taken(self.alternatives.chosen)[1]
        return None if dynamic is None else dynamic.drift


def choose_tables(
    steps: RateSteps,
    calibration: Calibration,
    *,
    static: StaticDrift | None,
    temp_c: FloatArray,
    rests: RestBlocks | None = None,
) -> Choice:
    """Fit all alternatives, select one by cross-validation; nodes temp_c (n,), degC."""
    low, high = float(temp_c[0]), float(temp_c[-1])  # the dynamic table's: multiples of 5 degC inside, and the ends
    between = DEFAULT_STEP_C * np.arange(np.ceil(low / DEFAULT_STEP_C), np.floor(high / DEFAULT_STEP_C) + 1.0)
    nodes = np.concatenate(([low], between[(between > low + 1e-9) & (between < high - 1e-9)], [high]))
    clean = with_rest_as_zero(steps_of(steps), rests, calibration, static)
    numbers, point = _set_points(clean)
    if len(numbers) < 2:
        raise NotObservable(
            f"scale and dynamic drift: wanted rate steps at two soaks or more, got one at {clean.temp_c.mean():.1f} degC; "
            "repeat the steps at another temperature, or keep the constant matrix",
            soaks=len(numbers),
        )

    def fitted(rows: Steps, like: Fits | None = None) -> Fits:
        """Fit every alternative to some steps; as soft as earlier fits where these are given."""
        scale = dynamic = both = None
        with suppress(CalibrationError):  # the others may still be had
            scale = fit_scale(rows, calibration, static=static, temp_c=temp_c)

        def bent(matrix: ScaleDrift | None, earlier: DynamicFit | None) -> DynamicFit:
            return fit_dynamic(rows, calibration, static=static, scale=matrix, rests=rests, temp_c=nodes, like=earlier)

        with suppress(CalibrationError):
            dynamic = bent(None, like.dynamic if like else None)
            both = None if scale is None else bent(scale.drift, like.both if like else None)
        return Fits(scale=scale, dynamic=dynamic, both=both)

    fits = fitted(clean)
    if fits.scale is None and fits.dynamic is None:
        raise NotObservable(
            f"scale and dynamic drift: wanted an axis turned at two rates at two soaks, got {len(clean)} steps at {len(numbers)} "
            "soaks without; repeat the same turns at another temperature",
            soaks=len(numbers),
        )
    table = _cross_validated(
        clean, fits, fitted, lambda of, which: _residuals(clean, of, which, calibration, static=static)
    )
    verdict, points = fits.verdict_of(table.chosen, table.why), int(point.max()) + 1
    if points < 3 and table.why.code != "drift.tables_unjudged":
        verdict = verdict.also(Verdict.of(finding("drift.tables_by_rates", "warn", set_points=points)))
    return Choice(
        scale=fits.scale, dynamic=fits.dynamic, both=fits.both, alternatives=table, verdict=verdict.also(clean.verdict)
    )


def _residuals(
    steps: Steps, fits: Fits, which: Alternative, calibration: Calibration, *, static: StaticDrift | None
) -> FloatArray:
    """What an alternative leaves of all steps, rad/s, shape (n, 3); NaN where it has no fit."""
    scale, dynamic = fits.taken(which)
    if ("scale" in which and scale is None) or ("dynamic" in which and dynamic is None):
        return np.full((len(steps), 3), np.nan)
    matrix = None if scale is None else scale.drift
    w = measured_rate(steps.gyro, steps.temp_c, calibration, static=static, scale=matrix)
    for axis, surface in enumerate(dynamic.surfaces if dynamic else ()):
        if surface is not None:
            w[:, axis] -= surface.at(w[:, axis], steps.temp_c)
    return np.asarray(w - steps.rate_b)


def _cross_validated(
    steps: Steps,
    fits: Fits,
    fitted: Callable[[Steps, Fits], Fits],
    residuals: Callable[[Fits, Alternative], FloatArray],
) -> Alternatives:
    by_soak, by_rate, everything = _soak_folds(steps), _rate_folds(steps), np.ones(len(steps), bool)
    own_zero = np.where(of_one_rate(steps), -1, steps.mounting)

    def squares(fold: BoolArray, of: Fits, *, whole: bool) -> list[float]:
        return [_mean_square(residuals(of, which), own_zero, fold, whole=whole) for which in ALTERNATIVES]

    in_fit = np.array(squares(everything, fits, whole=True))
    soak, rate = (
        np.array([squares(fold, fitted(steps.taken(~fold), fits), whole=whole) for fold in folds]).reshape(-1, 4)
        for folds, whole in ((by_soak, True), (by_rate, False))
    )
    every = np.concatenate((soak, rate))
    square = np.where(np.isnan(in_fit), np.nan, every.mean(axis=0) if len(every) else in_fit)
    error = every.std(axis=0, ddof=1) / np.sqrt(len(every)) if len(every) > 1 else np.zeros(len(ALTERNATIVES))
    rms, nothing = np.sqrt(square), np.full((1, len(ALTERNATIVES)), np.nan)
    why = _selected(square, error, steps, (len(by_soak), len(by_rate))) if len(every) else _unjudged(square, steps)
    return Alternatives(
        name=ALTERNATIVES,
        fitted_rms_dps=np.sqrt(in_fit) / RADIAN_PER_DEGREE,
        soak_rms_dps=np.sqrt((soak if len(soak) else nothing).mean(axis=0)) / RADIAN_PER_DEGREE,
        rate_rms_dps=np.sqrt((rate if len(rate) else nothing).mean(axis=0)) / RADIAN_PER_DEGREE,
        left_out_rms_dps=rms / RADIAN_PER_DEGREE if len(every) else nothing[0],
        standard_error_dps=0.5 * error / np.where(rms > 0.0, rms, np.inf) / RADIAN_PER_DEGREE,
        chosen=why.values["tables"],  # type: ignore[arg-type]
        why=why,
    )


def _selected(square: FloatArray, error: FloatArray, steps: Steps, held_out: tuple[int, int]) -> Finding:
    """Take the simplest within one standard error, or 5 % of rms, of the best; held_out counts folds by soak and by rate."""
    best = int(np.nanargmin(square))
    chosen = int(np.flatnonzero(square <= max(square[best] + error[best], square[best] * _WORTH**2))[0])
    dps = np.sqrt(square) / RADIAN_PER_DEGREE
    numbers, point = _set_points(steps)
    of_soaks = f"{held_out[0]} of {len(numbers)} soaks at {int(point.max()) + 1} set-points"
    values = {
        "tables": ALTERNATIVES[chosen],
        "error_dps": dps[chosen],
        "held": "rates" if not held_out[0] else f"{of_soaks}, and rates," if held_out[1] else of_soaks,
        "held_out": held_out[0],
        "soaks": len(numbers),
        "set_points": int(point.max()) + 1,
    }
    if chosen == best:
        return finding("drift.tables_best", "info", **values)
    return finding("drift.tables_simplest", "info", **values, best=ALTERNATIVES[best], best_dps=dps[best])


def _unjudged(square: FloatArray, steps: Steps) -> Finding:
    """Keep the matrix that was fitted: neither soaks nor rates can be held out."""
    chosen = 1 if np.isfinite(square[1]) else int(np.nanargmin(square))
    points = int(_set_points(steps)[1].max()) + 1
    left = np.sqrt(square[[chosen, 0]]) / RADIAN_PER_DEGREE
    values = {"tables": ALTERNATIVES[chosen], "set_points": points, "error_dps": left[0], "constant_dps": left[1]}
    return finding("drift.tables_unjudged", "warn", **values)


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
    """Return the mean square of the fold's residuals about its mountings' own offsets, (rad/s)^2; mounting -1: about zero."""
    about = fold if whole else ~fold
    left = residuals[fold].copy()
    for m in np.unique(mounting[fold & (mounting >= 0)]):
        inside = about & (mounting == m)
        if inside.any():
            left[mounting[fold] == m] -= residuals[inside].mean(axis=0)
    return float(np.mean(left**2))


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
    old = fit.table.temp_c
    gyro, accel = (found and _cropped(found, old, nodes) for found in (fit.gyro, fit.accel))
    kept = [item for item in fit.verdict.findings if item.code != "drift.nodes_extrapolated"]
    kept += [] if gyro is None else far_from_data("gyroscope", gyro)
    kept += [] if accel is None or accel.offset is None else far_from_data("accelerometer", accel)
    verdict = replace(fit.verdict, findings=tuple(kept))
    return StaticFit(table=_cropped(fit.table, old, nodes), gyro=gyro, accel=accel, verdict=verdict)


def cropped_choice(choice: Choice, nodes: FloatArray) -> Choice:
    """Return what was chosen with all its tables cut to nodes (n,), degC; those of the dynamic tables lie further apart."""
    scale = choice.scale
    if scale is not None:
        scale = replace(scale, drift=_cropped(scale.drift, scale.drift.temp_c, nodes))

    def cropped(fit: DynamicFit) -> DynamicFit:
        old, low, high = fit.drift.temp_c, nodes[0], nodes[-1]
        at = np.concatenate(([low], old[(old > low + 1e-9) & (old < high - 1e-9)], [high]))
        return replace(fit, drift=replace(_cropped(fit.drift, old, at), temp_c=at))

    dynamic, both = (fit and cropped(fit) for fit in (choice.dynamic, choice.both))
    return replace(choice, scale=scale, dynamic=dynamic, both=both)


def _cropped(table: T, old: FloatArray, at: FloatArray) -> T:
    """Return a table at temperatures within its own: linear between two nodes, marked where one of them is."""
    right = np.clip(np.searchsorted(old, at - 1e-9), 1, len(old) - 1)
    share = np.clip((at - old[right - 1]) / (old[right] - old[right - 1]), 0.0, 1.0)
    kept: dict[str, Any] = {}
    for name in table.__dataclass_fields__:
        values = getattr(table, name)
        if values is not None and name.removeprefix("gyro_").removeprefix("accel_") in _BY_NODE:
            w, left, over = share.reshape(-1, *[1] * (values.ndim - 1)), values[right - 1], values[right]
            made = np.where(w == 0.0, left, np.where(w == 1.0, over, (1.0 - w) * left + w * over))  # NaN times 0 is NaN
            kept[name] = made > 0.0 if values.dtype == bool else made
    return replace(table, **kept)
