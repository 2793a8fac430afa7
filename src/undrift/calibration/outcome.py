"""Outcome: what a procedure made of one triad, or why it made nothing."""

from dataclasses import dataclass, replace

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.fit.result import TriadFit
from undrift.calibration.model import Verdict

_SHORT = 40  # characters: shorter sentences may well be alike


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


def said_once(reasons: tuple[str, ...]) -> tuple[str, ...]:
    """Return sentences without doubled heads, and without telling twice what ails both triads.

    A sentence whose body, past its heads ("gyroscope by multi-position: "), an earlier one holds already is cut to its head
    and a reference to that.

    Parameters
    ----------
    reasons : tuple of str
        Sentences, accelerometer first.

    Returns
    -------
    tuple of str
        One for each, less those that are the same throughout.
    """
    said: list[str] = []
    for reason in reasons:
        parts = reason.split(": ")
        parts = [part for k, part in enumerate(parts) if k == 0 or part != parts[k - 1]]
        head, body = parts[0], ": ".join(parts[1:])
        whole = ": ".join(parts)
        if whole in said:
            continue
        repeated = len(parts) > 1 and len(body) > _SHORT and any(body in earlier for earlier in said)
        said.append(f"{head}: not observable, for the reason said of the accelerometer" if repeated else whole)
    return tuple(said)


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
