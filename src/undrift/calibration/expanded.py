"""Expanded uncertainty of the parameters of a calibration, combined from the shares of its budget (JCGM 100).

    u^2 = sum_i u_i^2        shares u_i of the fit, which sum to the variance in the calibration's covariance
    U   = 2 u                about 95 %: the share of an excess variance already includes Student's factor (fit/gls.py)

Values are in units of the triad.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.norm import QUADRATIC_SD
from undrift.model import Calibration, TriadModel
from undrift.units import INHABITED_GRAVITY, STANDARD_GRAVITY

COVERAGE = 2.0  # U / u


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ParameterTable:
    """Parameters of a triad with their uncertainty, in units of the triad. Arrays are (P,)."""

    names: tuple[str, ...]
    value: FloatArray
    shares: Mapping[str, FloatArray]  # (P,), standard uncertainty by source
    standard: FloatArray  # combined standard uncertainty
    expanded: FloatArray  # U

    def of_block(self, block: str) -> list[int]:
        """Return the indices of a block's parameters."""
        return [n for n, name in enumerate(self.names) if block_of(name) == block]


def block_of(name: str) -> str:
    """Return the block to which a parameter belongs."""
    head, _, end = name.partition("_")
    return head if head != "m" else "scale" if end[0] == end[1] else "cross"


def gravity_uncertainty(calibration: Calibration, triad: str = "accel") -> float:
    """Return the relative standard uncertainty of local gravity, 0 if it was given or computed from a place."""
    local = triad == "gyro" or dict(calibration.provenance.settings).get("gravity") in ("stated", "latitude and height")
    return 0.0 if local else float(np.ptp(INHABITED_GRAVITY)) / math.sqrt(12.0) / calibration.gravity_m_s2


def expand(triad: TriadModel, gravity: float = 0.0) -> ParameterTable:
    """Combine the shares of a triad's budget with the uncertainty of gravity and quadratic terms, and expand them."""
    sigma = triad.standard_uncertainty
    budget = triad.budget
    shares = {"fit": sigma} if budget is None else dict(zip(budget.sources, budget.uncertainty, strict=True))
    if gravity > 0.0:
        matrix_terms = np.array([block_of(name) in ("scale", "cross") for name in triad.parameters])
        shares["gravity"] = np.where(matrix_terms, gravity * np.abs(np.resize(triad.matrix.ravel(), len(sigma))), 0.0)
    if triad.method.startswith("six-face"):  # opposite faces read q g^2 as offset
        offset_terms = np.where([block_of(name) == "offset" for name in triad.parameters], STANDARD_GRAVITY**2, 0.0)
        shares["nonlinearity"] = QUADRATIC_SD * offset_terms * np.resize(triad.scale_factor, len(sigma))
    combined = np.sqrt(np.sum([share**2 for share in shares.values()], axis=0))
    return ParameterTable(
        names=triad.parameters, value=triad.values, shares=shares, standard=combined, expanded=COVERAGE * combined
    )
