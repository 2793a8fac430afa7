"""Coverage on a bench that errs: how many of the stated 95 % intervals of each fit hold the truth of drawn devices.

``python -m benchmarks.erring_bench`` prints one table. Every row draws devices and benches (mounting, level, wobble, rate ripple,
temperature creep, coloured noise, 10-16 bit, jitter) with the simulator's own forward model; the fit sees readings alone.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray
from undrift.model import Verdict

NORMAL_95 = 1.959963984540054
LOW, HIGH = 90.0, 98.0  # percent of intervals that may hold


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One line of the table: a fit on a bench, and one group of its parameters."""

    fit: str
    case: str
    group: str  # scale, cross-axis, offset
    devices: int
    inside_percent: float
    rmse: float  # of the estimates
    stated: float  # root mean square of the stated standard deviations, in the unit of ``rmse``
    good_percent: float  # share of verdicts that read "good"
    reasons: str  # codes of the findings that lowered the others, most frequent first

    @property
    def holds(self) -> bool:
        """Return whether 90-98 % of the intervals hold, or the verdict was never good."""
        return LOW <= self.inside_percent <= HIGH or (self.good_percent == 0.0 and bool(self.reasons))


class Tally:
    """Errors and stated standard deviations of one fit on one bench, device by device."""

    def __init__(self, fit: str, case: str) -> None:
        self.fit, self.case = fit, case
        self._error: dict[str, list[FloatArray]] = {}
        self._sigma: dict[str, list[FloatArray]] = {}
        self._verdicts: list[Verdict] = []

    def add(self, verdict: Verdict, **groups: tuple[FloatArray, FloatArray]) -> None:
        """Add one device: for each group its errors and their stated standard deviations, of equal shape."""
        self._verdicts.append(verdict)
        for group, (error, sigma) in groups.items():
            self._error.setdefault(group, []).append(np.ravel(error))
            self._sigma.setdefault(group, []).append(np.ravel(sigma))

    def rows(self) -> Iterator[Row]:
        """Yield one row a group."""
        good = 100.0 * float(np.mean([v.status == "good" for v in self._verdicts])) if self._verdicts else 0.0
        for group, errors in self._error.items():
            error, sigma = np.concatenate(errors), np.concatenate(self._sigma[group])
            yield Row(
                fit=self.fit, case=self.case, group=group, devices=len(errors), good_percent=good,
                inside_percent=100.0 * float(np.mean(np.abs(error) <= NORMAL_95 * sigma)),
                rmse=float(np.sqrt(np.mean(error**2))), stated=float(np.sqrt(np.mean(sigma**2))),
                reasons=", ".join(_frequent(self._verdicts)),
            )  # fmt: skip


def _frequent(verdicts: Sequence[Verdict]) -> list[str]:
    codes = [f.code for v in verdicts for f in v.findings if f.level != "info"]
    return sorted(set(codes), key=lambda code: -codes.count(code))
