"""Coverage on an imperfect bench: the share of 95 % intervals of each fit that contain the truth of drawn devices.

``python -m benchmarks.erring_bench`` prints one table. Every row draws devices and benches (mounting, level, wobble,
rate ripple, temperature creep, coloured noise, 10-16 bit, jitter) with the simulator's own forward model. The fit
receives only readings.
"""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from undrift.arrays import FloatArray
from undrift.model import TriadModel, Verdict
from undrift.sim.device.effects import Adc, BiasInstability, SensorChain, ThermalScale

NORMAL_95 = 1.959963984540054
LOW, HIGH = 90.0, 98.0  # percent of intervals that may hold
ACROSS = ~np.eye(3, dtype=bool)
SCALE_PER_K = 2e-4  # standard deviation of the drawn slopes
TRIPLED = "all sources, three times: "  # starts the name of a case with one source at three times its stated size


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One line of the table: a fit on a bench, and one group of its parameters."""

    fit: str
    case: str
    group: str  # scale, cross-axis, offset
    devices: int
    inside_percent: float
    rmse: float  # of the estimates
    stated: float  # root mean square of the reported standard deviations, in the unit of ``rmse``
    good_percent: float  # share of verdicts that read "good"
    named: bool  # True if every verdict warns, or names the source at three times its size
    reasons: str  # codes of these findings, most frequent first

    @property
    def holds(self) -> bool:
        """Return whether 90-98 % of the intervals hold, or every verdict names a source."""
        return LOW <= self.inside_percent <= HIGH or self.named


def chain_that_errs(
    chain: SensorChain, *, bits: int | None, span: float, flicker: float | None, **others: Any
) -> SensorChain:
    """Return a chain with a converter over +-span and flicker, both in SI units. None omits an effect."""
    adc = None if bits is None else Adc(bits=bits, reference=span * chain.gain, codes=False)
    instability = None if flicker is None else BiasInstability(instability=np.full(3, flicker))
    return replace(chain, adc=adc, instability=instability, **others)


def tripled(case: Any, sources: Sequence[str]) -> dict[str, Any]:
    """Return the case once for each source, with that source at three times its stated size."""
    return {TRIPLED + source: replace(case, tripled=source) for source in sources}


def times(case: Any, source: str) -> float:
    """Return the size of a source of a case, in stated sizes."""
    return 3.0 if case.tripled == source else 1.0


def drawn_slope(rng: np.random.Generator) -> ThermalScale:
    """Draw how the scale of each axis follows temperature."""
    return ThermalScale(per_k=rng.normal(0.0, SCALE_PER_K, (1, 3)))


def even_rise(rise_c: float, samples: int) -> FloatArray:
    """Return temperatures that rise evenly about 25 degC."""
    return np.linspace(25.0 - 0.5 * rise_c, 25.0 + 0.5 * rise_c, samples)


class Tally:
    """Errors and reported standard deviations of a fit on a bench, for each device."""

    def __init__(self, fit: str, case: str) -> None:
        self.fit, self.case = fit, case
        self._error: dict[str, list[FloatArray]] = {}
        self._sigma: dict[str, list[FloatArray]] = {}
        self._verdicts: list[Verdict] = []

    def add(self, verdict: Verdict, **groups: tuple[FloatArray, FloatArray]) -> None:
        """Add a device. Each group has errors and their reported standard deviations, of equal shape."""
        self._verdicts.append(verdict)
        for group, (error, sigma) in groups.items():
            self._error.setdefault(group, []).append(np.ravel(error))
            self._sigma.setdefault(group, []).append(np.ravel(sigma))

    def add_model(
        self,
        verdict: Verdict,
        model: TriadModel,
        matrix: FloatArray,
        offset: FloatArray,
        observable: FloatArray = ACROSS,
    ) -> None:
        """Add a fitted model and the true matrix (3, 3) and offset (3,), in its units. Only cross-axis terms in
        ``seen`` count.
        """
        away, sigma, size = model.matrix - matrix, model.standard_uncertainty, float(np.diag(matrix).mean())
        reported, diagonal = sigma[:9].reshape(3, 3), np.eye(3, dtype=bool)
        self.add(
            verdict,
            scale=(away[diagonal] / size, reported[diagonal] / size),
            cross_axis=(away[observable] / size, reported[observable] / size),
            offset=((model.offset - offset) * size, sigma[9:12] * size),
        )

    def rows(self) -> Iterator[Row]:
        """Yield one row a group."""
        good = 100.0 * float(np.mean([v.status == "good" for v in self._verdicts])) if self._verdicts else 0.0
        codes = [_codes(verdict, self.case) for verdict in self._verdicts]
        for group, errors in self._error.items():
            error, sigma = np.concatenate(errors), np.concatenate(self._sigma[group])
            yield Row(
                fit=self.fit, case=self.case, group=group, devices=len(errors), good_percent=good,
                inside_percent=100.0 * float(np.mean(np.abs(error) <= NORMAL_95 * sigma)),
                rmse=float(np.sqrt(np.mean(error**2))), stated=float(np.sqrt(np.mean(sigma**2))),
                named=all(codes), reasons=", ".join(_frequent(codes)),
            )  # fmt: skip


def _codes(verdict: Verdict, case: str) -> list[str]:
    """Return the codes of findings that warn, or that name the source which a case has at three times its stated size."""
    names = case.removeprefix(TRIPLED).split("_") if case.startswith(TRIPLED) else []  # "mount_tilt" for "mounting"
    return [f.code for f in verdict.findings if f.level != "info" or str(f.values.get("source", "none"))[:5] in names]


def _frequent(codes: Sequence[Sequence[str]]) -> list[str]:
    every = list(itertools.chain.from_iterable(codes))
    return sorted(set(every), key=lambda code: -every.count(code))
