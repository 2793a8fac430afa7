"""What each parameter of the protocol does to the error, the others at the optimum.

All subjects with a value at all levels: analysis of variance with its corrections (study/anova.py), paired tests of the levels. A
run missing, because its protocol could not calibrate that subject's device: the mixed model (study/mixed.py), contrasts of the
levels. p is after Holm over the parameters; levels are compared where it is below the level of the test, p after Holm over all
pairs of them. A level that calibrates fewer than half of the devices is left out.
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import BoolArray, FloatArray
from undrift.errors import InputError
from undrift.study.anova import Anova, compare_conditions
from undrift.study.mixed import MixedModel, compare_unbalanced
from undrift.study.posthoc import Pair, adjust_holm, compare_pairs, compare_pairs_of
from undrift.study.run import TaskSurface

PARAMETERS = ("cutoff_hz", "turn_rate_step_dps", "turn_rate_min_dps", "turn_rate_max_dps")
FEWEST_SHARE = 0.5  # of the subjects whose device a level has to calibrate


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ParameterEffect:
    """Whether one parameter of the protocol matters, the others at the optimum.

    Parameters
    ----------
    name : str
        Of the parameter.
    values : array, shape (k,)
        Its values, Hz or deg/s.
    best : int
        Place of the optimum among them.
    means_deg : array, shape (k,)
        Mean error at each, deg; the mixed model's where runs are missing.
    missing : int
        Runs that are missing among them.
    dropped : array
        Values left out, since they calibrate fewer than half of the devices.
    anova : Anova or None
        Where no run is missing.
    mixed : MixedModel or None
        Where some are.
    untested : str
        Why neither could be; empty where one was.
    p_holm : float
        p after Holm over the parameters; NaN without a test.
    pairs : tuple of Pair
        All pairs of values, by their places; empty unless that p is below the level.
    """

    name: str
    values: FloatArray
    best: int
    means_deg: FloatArray
    missing: int
    dropped: FloatArray
    anova: Anova | None
    mixed: MixedModel | None
    untested: str
    p_holm: float
    pairs: tuple[Pair, ...]

    @property
    def test(self) -> Anova | MixedModel | None:
        """The test that was made: both have f, dof, p_value, partial_eta_squared, means and subjects."""
        return self.mixed if self.anova is None else self.anova

    @property
    def span_deg(self) -> float:
        """Greatest less least mean error, deg: what the parameter is worth."""
        return float(np.ptp(self.means_deg))

    @property
    def error_variance(self) -> float:
        """Variance of a response about the subject's own mean and the value's, deg squared; NaN without a test."""
        if self.anova is not None:
            return self.anova.mean_square_error
        return float("nan") if self.mixed is None else self.mixed.residual_sd**2

    @property
    def epsilon(self) -> float:
        """Of the sphericity, after Greenhouse and Geisser; the mixed model takes it as 1."""
        return 1.0 if self.anova is None else self.anova.sphericity.greenhouse_geisser


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Levels:
    """Values of one parameter and the errors with each, shape (S, k)."""

    name: str
    values: FloatArray
    best: int
    dropped: FloatArray
    error: FloatArray


def effects_at(
    surface: TaskSurface, best: int, *, error: FloatArray, allowed: BoolArray, level: float = 0.05
) -> tuple[ParameterEffect, ...]:
    """Say what each parameter does about a protocol.

    Parameters
    ----------
    surface : TaskSurface
        All protocols.
    best : int
        Place of the protocol that keeps the other parameters.
    error : array, shape (S, P)
        What is compared, deg; NaN where a run is missing.
    allowed : array of bool, shape (P,)
        Protocols that may be compared.
    level : float
        Of the tests.

    Returns
    -------
    tuple of ParameterEffect
        One for each of ``PARAMETERS``.
    """
    held = [_levels(surface, name, best, error, allowed) for name in PARAMETERS]
    tests = [_tested(each) for each in held]
    p = np.array([np.nan if isinstance(test, str) else test.p_value for test in tests])
    told = np.flatnonzero(~np.isnan(p))
    holm = np.full(len(p), np.nan)
    holm[told] = adjust_holm(p[told])
    return tuple(
        ParameterEffect(
            name=each.name,
            values=each.values,
            best=each.best,
            means_deg=test.means if isinstance(test, MixedModel) else np.nanmean(each.error, axis=0),
            missing=int(np.isnan(each.error).sum()),
            dropped=each.dropped,
            anova=test if isinstance(test, Anova) else None,
            mixed=test if isinstance(test, MixedModel) else None,
            untested=test if isinstance(test, str) else "",
            p_holm=float(p_holm),
            pairs=() if isinstance(test, str) or not p_holm < level else _pairs(each, test),
        )
        for each, test, p_holm in zip(held, tests, holm, strict=True)
    )


def _levels(surface: TaskSurface, name: str, best: int, error: FloatArray, allowed: BoolArray) -> _Levels:
    columns = {known: np.asarray(getattr(surface, known)) for known in PARAMETERS}
    same = np.all([np.isclose(c, c[best]) for known, c in columns.items() if known != name], axis=0)
    places = np.flatnonzero(same & allowed)
    places = places[np.argsort(columns[name][places])]
    enough = np.isfinite(error[:, places]).mean(axis=0) >= FEWEST_SHARE
    kept = places[enough]
    return _Levels(
        name=name,
        values=columns[name][kept],
        best=int(np.flatnonzero(kept == best)[0]),
        dropped=columns[name][places[~enough]],
        error=error[:, kept],
    )


def _tested(held: _Levels) -> Anova | MixedModel | str:
    """Return the test that suits, or why there is none."""
    if len(held.values) < 2:
        return "one value only"
    there = np.isfinite(held.error)
    try:
        if there.all():
            return compare_conditions(held.error)
        # by value first, so that the model's conditions come in the order of the values
        condition, subject = np.nonzero(there.T)
        return compare_unbalanced(
            held.error[subject, condition], [str(s) for s in subject], [str(c) for c in condition]
        )
    except InputError:  # nothing to test against
        return "all subjects respond alike"


def _pairs(held: _Levels, test: Anova | MixedModel) -> tuple[Pair, ...]:
    return compare_pairs_of(test) if isinstance(test, MixedModel) else compare_pairs(held.error)
