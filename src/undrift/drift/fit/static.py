"""Static drift: absolute offsets over temperature, from blocks of rest.

::

    gyroscopes       y = u - K (G a + Earth rate)                           u mean reading, K = M^-1: ``offsets.py``
    accelerometers   y = u in one pose; offset(T) = offset(T_ref) + y(T) - y(T_ref)
    both             y = f(T) + h c + A exp(-t / tau) + d_s + e             ``curve.py``

T_ref and offset(T_ref) are those of the calibration. One pose cannot tell a change of scale along gravity from one of offset:
0.02 %/K * |T - T_ref| of what gravity reads counts as uncertainty, a capacitive accelerometer's usual sensitivity shift
(+-1 % in 50 K). The uncertainty of a node holds the noise, what wanders in a run, the curve
between and beyond the temperatures seen, half the loop of hysteresis where one was found, and the scatter between sessions
where there are several. It is of the offset at a reading of this thermometer, whose trim and self-heating belong to the table.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from undrift.arrays import BoolArray, FloatArray
from undrift.calibration.model import AXES, Calibration, StaticDrift, TriadModel, Verdict
from undrift.drift.fit.curve import CurveSettings, OffsetCurve, fit_curve
from undrift.drift.fit.offsets import Offsets, accel_offsets, gyro_offsets
from undrift.drift.fit.spline import NodeValues
from undrift.drift.observe.observations import RestBlocks
from undrift.errors import NotObservable

_SLOPE_POINTS = 60
UNKNOWN_SCALE_PER_K = 2e-4  # of an accelerometer that was seen in one pose


@dataclass(frozen=True, slots=True, kw_only=True)
class StaticSettings:
    """How offset over temperature is fitted.

    Parameters
    ----------
    not_a_knot : bool
        True for the note's spline through the set-point means, False for the smoothing spline.
    edge_c : float
        A node this far outside the temperatures seen is extrapolated, degC.
    gap_c : float
        A node between temperatures seen, this far from both, is extrapolated, degC.
    latitude_deg : float or None
        Where the device lay, deg: the Earth rate along the vertical is taken off; None leaves it in.
    accel_unit : str
        Unit of the accelerometer's readings where no calibration states it: count where it is not known.
    curve : CurveSettings
        Effects beside temperature.
    """

    not_a_knot: bool = False
    edge_c: float = 0.5
    gap_c: float = 5.0
    latitude_deg: float | None = None
    accel_unit: str = "count"
    curve: CurveSettings = field(default_factory=CurveSettings)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TriadDrift:
    """Offset over temperature of one triad, n nodes.

    Parameters
    ----------
    offset : array, shape (n, 3), or None
        Absolute, raw unit; None where only the change is known.
    uncertainty : array, shape (n, 3)
        Standard uncertainty of each node, raw unit.
    extrapolated : array of bool, shape (n,)
        True where no data were near.
    slope, slope_uncertainty : array, shape (3,)
        Mean slope over the temperatures of the blocks, raw unit per K.
    span_c : tuple of float
        Least and greatest temperature seen, degC.
    leave_out_rms : array, shape (3,)
        Root-mean-square error of cells that their neighbours tell, raw unit; NaN where there are too few.
    scatter : array, shape (3,)
        What wanders in a run, standard deviation, raw unit.
    curve : OffsetCurve
        The fit and its effects.
    unknown_scale : array, shape (n, 3), or None
        The part of ``uncertainty`` that stands for a change of scale, raw unit; None where gravity is not in the readings.
    """

    offset: FloatArray | None
    uncertainty: FloatArray
    extrapolated: BoolArray
    slope: FloatArray
    slope_uncertainty: FloatArray
    span_c: tuple[float, float]
    leave_out_rms: FloatArray
    scatter: FloatArray
    curve: OffsetCurve
    unknown_scale: FloatArray | None = None

    @property
    def mostly_unknown_scale(self) -> bool:
        """Whether a change of scale that nobody saw is most of the variance, at half the nodes near data or more."""
        if self.unknown_scale is None:
            return False
        near = ~self.extrapolated if not self.extrapolated.all() else self.extrapolated
        share = (self.unknown_scale[near] ** 2).sum(axis=1) / np.maximum(
            (self.uncertainty[near] ** 2).sum(axis=1), 1e-300
        )
        return bool(np.median(share) > 0.5)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StaticFit:
    """A static tuning table and what it is worth.

    Parameters
    ----------
    table : StaticDrift
        At the nodes asked for.
    gyro, accel : TriadDrift or None
        None where a triad was not observed.
    gyro_slope : array, shape (3,), or None
        rad/s per K in b; None without a matrix.
    verdict : Verdict
        In words.
    """

    table: StaticDrift
    gyro: TriadDrift | None
    accel: TriadDrift | None
    gyro_slope: FloatArray | None
    verdict: Verdict


def fit_static(
    blocks: RestBlocks,
    *,
    nodes: FloatArray,
    calibration: Calibration | None = None,
    settings: StaticSettings = StaticSettings(),
) -> StaticFit:
    """Fit offset over temperature of both triads.

    Parameters
    ----------
    blocks : RestBlocks
        Of one session or several.
    nodes : array, shape (n,)
        Temperatures of the table, degC, increasing.
    calibration : Calibration or None
        Of the same device: g-sensitivity, matrix, and the accelerometers' offset at its reference temperature.
    settings : StaticSettings
        Kind of curve and effects.

    Returns
    -------
    StaticFit
        Table with uncertainty and marks, figures, verdict.

    Raises
    ------
    NotObservable
        No triad that the blocks tell anything about, or one temperature only.
    InputError
        Earth rate asked for without a calibration of both triads.
    """
    reasons: list[str] = []
    gyro, accel, accel_table = None, None, None
    rates = gyro_offsets(blocks, calibration, settings.latitude_deg)
    if rates is not None:
        gyro = _triad(rates, nodes, settings)
        reasons += [*rates.reasons, *gyro.curve.reasons, *_told("gyroscope", gyro)]
    forces = accel_offsets(blocks, calibration, settings.accel_unit)
    if isinstance(forces, str):
        reasons.append(forces)
    else:
        accel, said = _accel(forces, nodes, calibration, settings)
        reasons += [*forces.reasons, *said] if accel else said
        accel_table = None if accel is None or accel.offset is None else accel
    if gyro is None and accel is None:
        raise NotObservable(
            "static drift: wanted readings at two temperatures or more, got none; " + "; ".join(reasons)
        )
    table = StaticDrift(
        temp_c=nodes,
        gyro_offset=None if gyro is None else gyro.offset,
        gyro_uncertainty=None if gyro is None else gyro.uncertainty,
        gyro_extrapolated=None if gyro is None else gyro.extrapolated,
        accel_offset=None if accel_table is None else accel_table.offset,
        accel_uncertainty=None if accel_table is None else accel_table.uncertainty,
        accel_extrapolated=None if accel_table is None else accel_table.extrapolated,
        gyro_hysteresis=gyro.curve.loop.half if gyro and gyro.curve.kept_loop and gyro.curve.loop else None,
        warm_up=None if gyro is None else gyro.curve.warm_up,
    )
    model = None if calibration is None else calibration.gyro
    return StaticFit(
        table=table,
        gyro=gyro,
        accel=accel,
        gyro_slope=None if model is None or gyro is None else model.matrix @ gyro.slope,
        verdict=Verdict(
            status="marginal" if isinstance(forces, str) and "left out" in forces else "good",
            reasons=tuple(dict.fromkeys(reasons)),
        ),
    )


def near_data(nodes: FloatArray, temp_c: FloatArray, *, edge_c: float, gap_c: float) -> BoolArray:
    """Tell which nodes have data near them.

    Parameters
    ----------
    nodes : array, shape (n,)
        degC.
    temp_c : array, shape (k,)
        Temperatures seen, degC.
    edge_c : float
        How far outside the span seen counts as near, degC.
    gap_c : float
        How far from both neighbours inside it, degC.

    Returns
    -------
    array of bool, shape (n,)
        False where a node is extrapolated.
    """
    nearest = np.abs(nodes[:, None] - temp_c[None, :]).min(axis=1)
    outside = (nodes < temp_c.min()) | (nodes > temp_c.max())
    near: BoolArray = np.where(outside, nearest <= edge_c, nearest <= gap_c)
    return near


def far_from_data(name: str, found: TriadDrift) -> list[str]:
    """Return what is to be said of nodes that no data were near.

    Parameters
    ----------
    name : str
        gyroscope or accelerometer.
    found : TriadDrift
        With its marks.

    Returns
    -------
    list of str
        One sentence, or none.
    """
    count = int(found.extrapolated.sum())
    if not count:
        return []
    return [
        f"{name}: {count} of {len(found.extrapolated)} nodes have no data near them (seen: {found.span_c[0]:.1f} to "
        f"{found.span_c[1]:.1f} degC) and are marked extrapolated"
    ]


def _triad(
    offsets: Offsets, nodes: FloatArray, settings: StaticSettings, reference: tuple[float, TriadModel] | None = None
) -> TriadDrift:
    """Fit one triad; with a reference the table is its offset plus the change since its temperature."""
    curve = fit_curve(offsets, settings.curve)
    temp_c = offsets.blocks.temp_c
    span = float(temp_c.min()), float(temp_c.max())
    inside = np.quantile(temp_c, np.linspace(0.0, 1.0, _SLOPE_POINTS))
    at = np.concatenate((nodes, inside, [nodes[0] if reference is None else reference[0]]))
    found = curve.through_set_points(at) if settings.not_a_knot else curve.spline.at(at)
    variance = offsets.common_variance + curve.extra_variance
    n = len(nodes)
    value, own = found.value[:n], np.diagonal(found.covariance, axis1=1, axis2=2).T[:n]
    if reference is not None:
        value, own = _since(found, n, reference[1])
    slope, slope_uncertainty = _slope(found, slice(n, n + _SLOPE_POINTS))
    return TriadDrift(
        offset=value,
        uncertainty=np.sqrt(np.maximum(own, 0.0) + variance),
        extrapolated=~near_data(nodes, temp_c, edge_c=settings.edge_c, gap_c=settings.gap_c),
        slope=slope,
        slope_uncertainty=slope_uncertainty,
        span_c=span,
        leave_out_rms=curve.spline.leave_out_rms,
        scatter=curve.spline.scatter_deviation,
        curve=curve,
    )


def _since(found: NodeValues, count: int, model: TriadModel) -> tuple[FloatArray, FloatArray]:
    # The last point is the reference temperature: its error is shared by both ends of the difference.
    value = model.offset + found.value[:count] - found.value[-1]
    variance = np.diagonal(found.covariance, axis1=1, axis2=2).T
    shared = found.covariance[:, :count, -1].T
    names = [model.parameters.index(f"offset_{axis}") for axis in AXES]
    return value, variance[:count] + variance[-1] - 2.0 * shared + np.diag(model.covariance)[names]


def _slope(found: NodeValues, inside: slice) -> tuple[FloatArray, FloatArray]:
    x = found.temp_c[inside] - found.temp_c[inside].mean()
    weight = x / (x @ x)
    variance = np.einsum("i,kij,j->k", weight, found.covariance[:, inside, inside], weight)
    return np.asarray(weight @ found.value[inside]), np.sqrt(np.maximum(variance, 0.0))


def _accel(
    offsets: Offsets, nodes: FloatArray, calibration: Calibration | None, settings: StaticSettings
) -> tuple[TriadDrift | None, list[str]]:
    model = None if calibration is None else calibration.accel
    reference = calibration.reference_temp_c if calibration is not None else float("nan")
    told = ""
    if model is None:
        told = (
            "no accelerometer calibration in physical units: the change over temperature is known, the offset is not; "
        )
        told += "calibrate six faces"
    elif not np.isfinite(reference):
        told = "the calibration names no reference temperature: the change of the accelerometers is known, their offset is not"
    known = None if model is None or told else (reference, model)
    try:
        found = _triad(offsets, nodes, settings, known)
    except NotObservable as error:
        return None, [f"accelerometer offset over temperature: {error}"]
    if told:
        return replace(found, offset=None), [f"accelerometer: {told}"]
    if known is not None:
        found = _with_unknown_scale(found, nodes, known)
    return found, _told("accelerometer", found)


def _with_unknown_scale(found: TriadDrift, nodes: FloatArray, known: tuple[float, TriadModel]) -> TriadDrift:
    reference, model = known
    gravity = found.curve.spline.at(np.array([reference])).value[0] - model.offset
    unknown = UNKNOWN_SCALE_PER_K * np.abs(nodes - reference)[:, None] * np.abs(gravity)
    return replace(found, uncertainty=np.hypot(found.uncertainty, unknown), unknown_scale=unknown)


def _told(name: str, found: TriadDrift) -> list[str]:
    said = far_from_data(name, found)
    loop = found.curve.loop
    if loop is not None:
        size = ", ".join(f"{h:.3g} +- {u:.2g}" for h, u in zip(loop.half, loop.uncertainty, strict=True))
        what = "modelled, and half of it counts as uncertainty" if found.curve.kept_loop else "not significant"
        said.append(f"{name}: half the loop between cooling and warming is {size} raw units on x, y, z: {what}")
    return said
