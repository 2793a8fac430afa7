"""Outcome: what a procedure made of one triad, or why it made nothing."""

from dataclasses import dataclass, replace

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.fit.result import TriadFit
from undrift.calibration.model import Verdict


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Outcome:
    """One triad's fit, the method that gave it, and what to say beside it.

    Parameters
    ----------
    fit : TriadFit or None
        None where the triad was not observable.
    method : str
        Name of the method; "none" without a fit.
    reasons : tuple of str
        Sentences for the verdict.
    """

    fit: TriadFit | None = None
    method: str = "none"
    reasons: tuple[str, ...] = ()

    def after(self, *reasons: str) -> "Outcome":
        """Return the same outcome with sentences put before its own.

        Parameters
        ----------
        *reasons : str
            Sentences.

        Returns
        -------
        Outcome
            With all of them.
        """
        return replace(self, reasons=(*reasons, *self.reasons))


def with_offset(fit: TriadFit, offset: FloatArray, variance: FloatArray) -> TriadFit:
    """Give a fit made on readings without their offset that offset back.

    Parameters
    ----------
    fit : TriadFit
        Of readings less ``offset``.
    offset : array, shape (3,)
        What was taken off, unit of the readings.
    variance : array, shape (3,)
        Of the offset.

    Returns
    -------
    TriadFit
        Model that takes the offset off itself.
    """
    covariance = np.array(fit.model.covariance)
    covariance[9:12, 9:12] = np.diag(variance)
    told = "mode paper: the offset was taken off the readings first, as the mean of opposite inputs or of the rests"
    return TriadFit(
        model=replace(fit.model, offset=offset, covariance=covariance),
        residuals=fit.residuals,
        verdict=fit.verdict.also(Verdict(reasons=(told,))),
    )
