"""Model of a triad from its fit: matrix, offset and g-sensitivity with covariance and budget, and the note's closed form.

M s - c - G a = f        as fitted by ``gls.solve_inverse``
f = M (s - o) - G a      the model: o = M^-1 c,   do = M^-1 dc - M^-1 dM o
C = L S' (S S')^-1       the note's matrix without an offset (eqs. 3 and 6), for imposed L and measured S, (3, N)
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import NotObservable
from undrift.findings import Finding
from undrift.fit.gls import GlsFit, carried
from undrift.model import G_NAMES, MATRIX_NAMES, OFFSET_NAMES, Budget, TriadModel, Verdict
from undrift.units import SI_UNIT, Quantity, si_factor


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TriadFit:
    """A fitted triad, its residuals, and findings about it."""

    model: TriadModel
    residuals: FloatArray  # (E,) or (E, 3), residuals, unit_out
    findings: tuple[Finding, ...] = ()

    @property
    def verdict(self) -> Verdict:
        """Verdict of the findings."""
        return Verdict.of(*self.findings)

    def also(self, *findings: Finding) -> "TriadFit":
        """Return the fit with further findings."""
        return replace(self, findings=(*self.findings, *findings))


def triad_fit(residuals: FloatArray, *findings: Finding, **of_model: Any) -> TriadFit:
    """Return a fit from its residuals, findings about it, and the remaining fields of its TriadModel."""
    rms = float(np.sqrt((residuals**2).mean()))
    model = TriadModel(rms_residual=rms, count=residuals.size, **of_model)
    return TriadFit(model=model, residuals=residuals, findings=findings)


def nominal_triad(
    unit: str, quantity: Quantity, *, turn: FloatArray | None = None, covariance: FloatArray | None = None
) -> TriadModel:
    """Return a model with the nominal scale of a unit, turned by ``turn`` (3, 3), without an offset."""
    return TriadModel(
        method="nominal",
        unit_in=unit,
        unit_out=SI_UNIT[quantity],
        matrix=si_factor(unit, quantity) * (np.eye(3) if turn is None else turn),
        offset=np.zeros(3),
        covariance=np.zeros((12, 12)) if covariance is None else covariance,
        rms_residual=0.0,
        count=0,
        rank=0,
        condition=1.0,
        valid_range=(-np.inf, np.inf),
    )


# ---- from a fit of the inverse model to the model


class TriadParameters(NamedTuple):
    """Parameters in the order of a model: M row by row, o, and G row by row if it was fitted."""

    theta: FloatArray  # (P,)
    covariance: FloatArray  # (P, P)
    parts: Mapping[str, FloatArray]  # covariance by source

    @property
    def matrix(self) -> FloatArray:
        """M (3, 3)."""
        return self.theta[:9].reshape(3, 3)

    @property
    def g_sensitivity(self) -> FloatArray | None:
        """G (3, 3), or None."""
        return self.theta[12:].reshape(3, 3) if len(self.theta) > 12 else None


def parameters_of(fit: GlsFit, *, with_g: bool = True) -> TriadParameters:
    """Return M, o and G of a fit of M, c and G, or M and o only."""
    offset, jacobian = offset_of(fit.theta[:9].reshape(3, 3), fit.theta[9:12], len(fit.theta))
    jacobian = jacobian if with_g else jacobian[:12]
    return TriadParameters(
        np.concatenate((fit.theta[:9], offset, fit.theta[12:]))[: len(jacobian)],
        carried(jacobian, fit.covariance),
        {name: carried(jacobian, share) for name, share in fit.budget.items()},
    )


def fit_of(
    parameters: TriadParameters,
    inputs: FloatArray,
    residuals: FloatArray,
    *findings: Finding,
    remainder: str = "noise",
    **names: Any,
) -> TriadFit:
    """Return fitted parameters as a fit to inputs (E, 3). ``names`` contains method, unit_in and unit_out.

    ``remainder`` names the source of the covariance that no other source explains.
    """
    rank, condition = scaled_condition(np.column_stack((inputs, np.ones(len(inputs)))))
    finite = bool(np.isfinite(parameters.covariance).all())
    variances = {name: np.diag(share) for name, share in parameters.parts.items()}
    g = parameters.g_sensitivity
    return triad_fit(
        residuals,
        *findings,
        matrix=parameters.matrix,
        offset=parameters.theta[9:12],
        g_sensitivity=g,
        parameters=(*MATRIX_NAMES, *OFFSET_NAMES, *(() if g is None else G_NAMES)),
        covariance=parameters.covariance,
        budget=Budget.of(parameters.covariance, variances, remainder) if finite else None,
        rank=3 * rank + (0 if g is None else 9),
        condition=condition,
        valid_range=(float(inputs.min()), float(inputs.max())),
        **names,
    )


def first_matrix(inputs: FloatArray, reading: FloatArray, regressors: FloatArray | None = None) -> FloatArray:
    """Return an initial M by least squares from readings (E, 3) over inputs (E, 3), an offset, and other columns (E, C)."""
    design = np.column_stack((inputs, np.ones(len(inputs)), *([] if regressors is None else [regressors])))
    return np.asarray(np.linalg.inv(np.linalg.lstsq(design, reading, rcond=None)[0][:3].T))


def offset_of(matrix: FloatArray, constant: FloatArray, count: int) -> tuple[FloatArray, FloatArray]:
    """Return o of M (u - o) = M u - c, and d (M, o, ..) / d (M, c, ..), (P, P), from do = M^-1 dc - M^-1 dM o."""
    inverse, jacobian = np.linalg.inv(matrix), np.eye(count)
    offset = inverse @ constant
    jacobian[9:12, 9:12], jacobian[9:12, :9] = inverse, -np.kron(inverse, offset)
    return offset, jacobian


def inverse_jacobian(matrix: FloatArray) -> FloatArray:
    """Return d vec(M) / d vec(K) (9, 9) for M = K^-1, both stacked row by row: dM = -M dK M."""
    return -np.kron(matrix, matrix.T)


def scaled_condition(design: FloatArray) -> tuple[int, float]:
    """Return rank and condition number of a design (E, P) with columns scaled to one."""
    length = np.linalg.norm(design, axis=0)
    length[length == 0.0] = 1.0
    singular = np.linalg.svd(design / length, compute_uv=False)
    rank = int((singular > singular[0] * max(design.shape) * np.finfo(float).eps * 10.0).sum())
    return rank, float(singular[0] / singular[-1]) if rank == design.shape[1] else float("inf")


def weakest_parameters(
    design: FloatArray, rows: int, least: float, names: Sequence[str]
) -> tuple[float, tuple[str, ...]]:
    """Return the smallest rms effect of a combination of parameters on ``rows`` rows, and the parameters of weak combinations.

    Combinations with an effect below ``least`` are weak. A parameter belongs to one if its share is 0.3 or more.
    """
    _, singular, right = np.linalg.svd(design, full_matrices=False)
    effect = singular / np.sqrt(rows)
    weak = np.append(np.flatnonzero(effect < least), len(effect) - 1)
    share = np.linalg.norm(right[weak], axis=0)
    weakest = float(effect[-1]) if len(design) >= len(names) else 0.0
    return weakest, tuple(name for name, s in zip(names, share, strict=True) if s > 0.3 * share.max())


# ---- the note's matrix


def fit_paper(inputs: FloatArray, readings: FloatArray, fit: GlsFit, **names: Any) -> TriadFit:
    """Fit the note's calibration matrix, which has no offset column, to inputs and readings (N, 3).

    C = L S' (S S')^-1 (note, eqs. 3 and 6). Errors e of the rows, (N, 3) in the unit of the inputs, change it by -e' S' (S S')^-1.
    ``fit`` is the fit of M, c and G to the same rows, and provides their covariances and the offset c.
    """
    rank, condition = scaled_condition(readings)
    if rank < 3:
        raise NotObservable(
            f"fit: expected readings that span three axes, got rank {rank} from {len(readings)} columns. "
            "Record the missing axes.",
            rank=rank,
        )
    solver = readings @ np.linalg.inv(readings.T @ readings)
    matrix = inputs.T @ solver  # eq. 3, eq. 6
    gains = np.zeros((12, inputs.size))
    gains[:9] = np.einsum("ik,nj->ijnk", np.eye(3), solver).reshape(9, -1)
    parts = {name: carried(gains, share[: inputs.size, : inputs.size]) for name, share in fit.sources.items()}
    theta = np.concatenate((matrix.ravel(), np.zeros(3)))
    parameters = TriadParameters(theta, np.sum([*parts.values()], axis=0), parts)
    fitted = fit_of(parameters, inputs, readings @ matrix.T - inputs, **names)
    return replace(fitted, model=replace(fitted.model, rank=9, condition=condition))


# ---- names of parameters: m_xx is the scale of x, m_xy a cross-axis term, offset_y the offset of y


def parameter_names(names: Sequence[str]) -> str:
    """Return names of parameters in words, grouped by kind."""
    ends = [(name.partition("_")[0], name.rpartition("_")[2]) for name in names]
    scales = [end[0] for head, end in ends if head == "m" and end[0] == end[-1]]
    crossed = [end for head, end in ends if head == "m" and end[0] != end[-1]]
    offsets = [end for head, end in ends if head == "offset"]
    kinds = (("scale of", scales), (f"cross-axis term{'s' * (len(crossed) > 1)}", crossed), ("offset of", offsets))
    return ", ".join(
        f"{kind} {' and '.join((', '.join(of[:-1]), of[-1])).removeprefix(' and ')}" for kind, of in kinds if of
    )
