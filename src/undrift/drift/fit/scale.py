"""Matrix over temperature: thermal scale factor and cross-axis, from rate steps at several soaks.

At one soak, after the offset table is taken off, each sensor i reads ::

    u_i - offset_i(T) = sum_j K_ij w_j + d_im + noise        j the axes that were turned, m the mounting

d is what the soak and the mounting leave of the offset (hysteresis, warm-up, g-sensitivity); it is fitted along where a mounting
has two rates or more. An axis that no soak turned keeps its column of K from the calibration and has no uncertainty: nothing is
known of it. Each K_ij(T) goes through a smoothing spline (``spline.py``), and ``M(T) = K(T)^-1`` with dM = -M dK M.

K is the best straight line over the rates that were imposed. What bends beside it is the dynamic table's; so the noise is told by
what a line, a parabola and a cubic leave.
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray
from undrift.calibration.fit.excess import excess_variance
from undrift.calibration.fit.result import inverse_jacobian
from undrift.calibration.model import AXES, Calibration, ScaleDrift, StaticDrift, Verdict
from undrift.drift.fit.spline import fit_smooth
from undrift.drift.fit.static import near_data
from undrift.drift.fit.steps import Steps, gyro_model, offset_at, steps_of
from undrift.drift.observe.observations import RateSteps
from undrift.errors import NotObservable
from undrift.units import si_factor

_BENT = 8  # rows of a mounting from which a parabola and a cubic can be told from noise


@dataclass(frozen=True, slots=True, kw_only=True)
class NodeSettings:
    """Which nodes count as extrapolated.

    Parameters
    ----------
    edge_c : float
        Further than this beyond the first and last soak, degC.
    gap_c : float
        Between soaks and further than this from both, degC. Matrices change more evenly than offsets.
    """

    edge_c: float = 0.5
    gap_c: float = 10.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SoakMatrices:
    """The forward matrix at each of S soaks.

    Parameters
    ----------
    temp_c : array, shape (S,)
        Mean temperature of the soak's steps, degC, increasing.
    forward : array, shape (S, 3, 3)
        K, raw unit per rad/s: sensor, axis; NaN for an axis that the soak did not turn.
    variance : array, shape (S, 3, 3)
        Of each element, that unit squared.
    offset_left : array, shape (S, 3)
        d, mean over the mountings, raw unit: what the offset table left.
    rms : array, shape (S, 3)
        Residual of each sensor about its line, raw unit.
    """

    temp_c: FloatArray
    forward: FloatArray
    variance: FloatArray
    offset_left: FloatArray
    rms: FloatArray

    @property
    def seen(self) -> BoolArray:
        """Which axes each soak turned, shape (S, 3)."""
        return np.asarray(np.isfinite(self.forward[:, 0, :]))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ScaleFit:
    """The matrix over temperature.

    Parameters
    ----------
    drift : ScaleDrift
        Gyroscope matrices at the nodes.
    soaks : SoakMatrices
        What they were drawn through.
    percent_per_k : array, shape (3,)
        Thermal sensitivity of each axis' scale factor, %/K of its value at the reference temperature; NaN where not seen.
    percent_per_k_uncertainty : array, shape (3,)
        Standard uncertainty of that.
    verdict : Verdict
        In words.
    """

    drift: ScaleDrift
    soaks: SoakMatrices
    percent_per_k: FloatArray
    percent_per_k_uncertainty: FloatArray
    verdict: Verdict


def fit_scale(
    steps: RateSteps | Steps,
    calibration: Calibration,
    *,
    static: StaticDrift | None,
    temp_c: FloatArray,
    settings: NodeSettings = NodeSettings(),
) -> ScaleFit:
    """Fit the gyroscopes' matrix over temperature.

    Parameters
    ----------
    steps : RateSteps or Steps
        Dwells at steady rates at two temperatures or more; three for more than a line.
    calibration : Calibration
        Gives the offset where there is no table, and the columns of axes that were not turned.
    static : StaticDrift or None
        Offset table, raw unit.
    temp_c : array, shape (n,)
        Nodes, degC, increasing.
    settings : NodeSettings
        Marks of extrapolation.

    Returns
    -------
    ScaleFit
        With uncertainty and marks.

    Raises
    ------
    InputError
        Steps without a usable row, or a calibration without gyroscopes.
    NotObservable
        One temperature only, or turns that do not tell the axes apart.
    """
    clean = steps_of(steps)
    soaks = soak_matrices(clean, calibration, static=static)
    forward, variance = _over_temperature(soaks, calibration, temp_c)
    model = gyro_model(calibration)
    matrix = np.linalg.inv(forward)
    jacobian = np.stack([inverse_jacobian(m) for m in matrix])
    unknown = np.isnan(variance)
    spread = np.sqrt(np.einsum("nij,nj->ni", jacobian**2, np.where(unknown, 0.0, variance).reshape(-1, 9)))
    uncertainty = np.where(unknown, np.nan, spread.reshape(-1, 3, 3))  # column j of M leans on column j of K
    to_out = 1.0 / si_factor(model.unit_out, "rate")
    slope, doubt = _sensitivity(soaks, calibration.reference_temp_c)
    drift = ScaleDrift(
        temp_c=temp_c,
        gyro_matrix=matrix * to_out,
        gyro_uncertainty=uncertainty * to_out,
        gyro_extrapolated=~near_data(temp_c, soaks.temp_c, edge_c=settings.edge_c, gap_c=settings.gap_c),
    )
    return ScaleFit(
        drift=drift,
        soaks=soaks,
        percent_per_k=slope,
        percent_per_k_uncertainty=doubt,
        verdict=_verdict(soaks, slope, doubt).also(clean.verdict),
    )


def soak_matrices(steps: Steps, calibration: Calibration, *, static: StaticDrift | None) -> SoakMatrices:
    """Fit the forward matrix at each soak.

    Parameters
    ----------
    steps : Steps
        Usable rows.
    calibration : Calibration
        The device's constant model.
    static : StaticDrift or None
        Offset table, raw unit.

    Returns
    -------
    SoakMatrices
        In the order of temperature.

    Raises
    ------
    NotObservable
        Turns that do not tell the axes apart.
    """
    kept = gyro_model(calibration).forward_matrix / si_factor(gyro_model(calibration).unit_out, "rate")
    own = steps.gyro - offset_at(steps.temp_c, calibration, static)
    parts = [_one_soak(steps, own, np.flatnonzero(steps.soak == s), kept) for s in np.unique(steps.soak)]
    parts.sort(key=lambda part: part[0])
    return SoakMatrices(
        temp_c=np.array([part[0] for part in parts]),
        forward=np.array([part[1] for part in parts]),
        variance=np.array([part[2] for part in parts]),
        offset_left=np.array([part[3] for part in parts]),
        rms=np.array([part[4] for part in parts]),
    )


def _one_soak(
    steps: Steps, own: FloatArray, rows: IntArray, kept: FloatArray
) -> tuple[float, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return temperature, K, its variance, mean offset left, and residual of one soak."""
    rate, reading, variance = steps.rate_b[rows], own[rows], steps.variance[rows]
    main = np.abs(rate).max()
    turned = np.flatnonzero((np.abs(rate) > 0.5 * np.linalg.norm(rate, axis=1, keepdims=True)).any(axis=0))
    still = np.setdiff1d(np.arange(3), turned)
    reading = reading - rate[:, still] @ kept[:, still].T
    offsets, bends = _mountings(steps, rows)
    design = np.column_stack((rate[:, turned] / main, offsets))
    if np.linalg.matrix_rank(design, tol=1e-3) < design.shape[1]:
        raise NotObservable(
            f"scale over temperature: wanted turns that tell the axes apart at {steps.temp_c[rows].mean():.1f} degC, got "
            f"{len(rows)} that do not; turn about each axis at two rates or more"
        )
    forward, spread = np.full((3, 3), np.nan), np.full((3, 3), np.nan)
    left, rms = np.full(3, np.nan), np.full(3, np.nan)
    full = np.column_stack((design, bends))
    for i in range(3):
        noise = reading[:, i] - full @ np.linalg.lstsq(full, reading[:, i], rcond=None)[0]
        v = variance[:, i] + excess_variance(noise, variance[:, i], len(rows) - full.shape[1])
        inverse = np.linalg.inv(design.T @ (design / v[:, None]))
        theta = inverse @ (design.T @ (reading[:, i] / v))
        forward[i, turned] = theta[: len(turned)] / main
        spread[i, turned] = np.diag(inverse)[: len(turned)] / main**2
        left[i] = theta[len(turned) :].mean() if offsets.shape[1] else np.nan
        rms[i] = np.sqrt(np.mean((reading[:, i] - design @ theta) ** 2))
    return float(steps.temp_c[rows].mean()), forward, spread, left, rms


def _mountings(steps: Steps, rows: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return a column of ones for each mounting with two rates or more, and its parabola and cubic where they can be told."""
    offsets, bends = [], []
    for m in np.unique(steps.mounting[rows]):
        inside = steps.mounting[rows] == m
        along = np.where(inside, steps.along[rows], 0.0)
        if len(np.unique(steps.along[rows][inside])) < 2:
            continue
        offsets.append(inside.astype(float))
        if len(np.unique(np.abs(steps.along[rows][inside]))) > 3 and inside.sum() >= _BENT:
            z = along / np.abs(along).max()
            bends += [z**2, z**3]
    n = len(rows)
    return np.array(offsets).reshape(-1, n).T, np.array(bends).reshape(-1, n).T


def _over_temperature(
    soaks: SoakMatrices, calibration: Calibration, nodes: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return K at the nodes and the variance of each element; NaN variance for axes that were not turned."""
    model = gyro_model(calibration)
    kept = model.forward_matrix / si_factor(model.unit_out, "rate")
    forward, variance = np.tile(kept, (len(nodes), 1, 1)), np.full((len(nodes), 3, 3), np.nan)
    temperatures = [soaks.temp_c[soaks.seen[:, j]] for j in range(3)]
    most = max(len(t) for t in temperatures)
    if most < 2 or max(float(np.ptp(t)) for t in temperatures if len(t)) <= 0.0:
        raise NotObservable(
            f"scale over temperature: wanted rate steps at two soaks or more, got {most}; repeat the steps at another "
            "temperature, ten degrees or more away",
            soaks=most,
        )
    for j in range(3):
        have = soaks.seen[:, j]
        if len(temperatures[j]) < 2:  # one temperature, or none: nothing over temperature
            continue
        at = fit_smooth(soaks.temp_c[have], soaks.forward[have, :, j], soaks.variance[have, :, j]).at(nodes)
        forward[:, :, j], variance[:, :, j] = at.value, at.uncertainty**2
    return forward, variance


def _sensitivity(soaks: SoakMatrices, reference_temp_c: float) -> tuple[FloatArray, FloatArray]:
    """Return the slope of each own scale factor over its value at the reference, %/K, with its standard uncertainty."""
    slope, doubt = np.full(3, np.nan), np.full(3, np.nan)
    for j in range(3):
        have = soaks.seen[:, j]
        t, k, v = soaks.temp_c[have], soaks.forward[have, j, j], soaks.variance[have, j, j]
        if len(t) < 2 or np.ptp(t) == 0.0:
            continue
        zero = reference_temp_c if np.isfinite(reference_temp_c) else float(t.mean())
        x = np.column_stack((np.ones(len(t)), t - zero))
        left = k - x @ np.linalg.lstsq(x, k, rcond=None)[0]
        v = v + excess_variance(left, v, len(t) - 2)
        inverse = np.linalg.inv(x.T @ (x / v[:, None]))
        value, change = inverse @ (x.T @ (k / v))
        slope[j], doubt[j] = 100.0 * change / value, abs(100.0 / value) * np.sqrt(inverse[1, 1])
    return slope, doubt


def _verdict(soaks: SoakMatrices, slope: FloatArray, doubt: FloatArray) -> Verdict:
    reasons, status = [], Verdict()
    for j, axis in enumerate(AXES):
        at = soaks.temp_c[soaks.seen[:, j]]
        if len(at) < 2:
            got = "never" if not len(at) else f"at {at[0]:.0f} degC only"
            reasons.append(
                f"scale and cross-axis of turns about {axis} over temperature were not observable: it was turned {got}, and the "
                f"calibration's constant column stands in; turn about {axis} at three temperatures or more"
            )
            continue
        reasons.append(f"scale factor {axis}: {slope[j]:+.4f} +- {2.0 * doubt[j]:.2g} %/K (95 %)")
        if len(at) == 2:
            reasons.append(
                f"scale factor {axis}: two temperatures draw a line and cannot show whether it bends; add a soak between them"
            )
    short = any(int(soaks.seen[:, j].sum()) < 3 for j in range(3))
    return Verdict(status="marginal" if short else "good", reasons=tuple(reasons)).also(status)
