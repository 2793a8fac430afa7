"""Repeated measures: does the error depend on a parameter of the protocol, which of its values differ?

A difference d of two mean errors is judged against a margin M by the three-sided test (Goeman, Solari and Stijnen, 2010): better
where d <= M is rejected, worse where d >= -M is, equivalent where d <= -M and d >= M both are (two one-sided tests, TOST), else not
decidable. One of the three is true, so that any wrong verdict has at most the level of the test, over m differences at level / m.

Subjects meet every condition, one value of the parameter each: F = MS_condition / MS_error, degrees of freedom times an epsilon of
sphericity, Huynh-Feldt where Greenhouse-Geisser's exceeds 0.75, else Greenhouse-Geisser (Girden, 1992).
"""

from dataclasses import dataclass
from itertools import combinations
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from undrift.arrays import FloatArray, frozen
from undrift.errors import InputError

# ---- sphericity


@dataclass(frozen=True, slots=True, kw_only=True)
class Sphericity:
    """How far repeated measures are from spherical."""

    greenhouse_geisser: float  # Epsilon of each correction, 1 for spherical
    huynh_feldt: float  # As above
    lower_bound: float  # As above, 1 / (k - 1)
    mauchly_w: float  # Mauchly's W, 1 for spherical; NaN where it cannot be had
    chi_squared: float  # Of Mauchly's test
    dof: int  # Its degrees of freedom
    p_value: float  # Of Mauchly's test; NaN with fewer subjects than conditions, or two conditions


def sphericity(y: FloatArray) -> Sphericity:
    """Find how far repeated measures (n, k) are from spherical: Greenhouse and Geisser 1959, Huynh and Feldt 1976."""
    from scipy.linalg import helmert

    n, k = y.shape
    p = k - 1
    a = np.atleast_2d(np.cov(y @ helmert(k).T, rowvar=False))
    trace, squared = float(np.trace(a)), float(np.sum(a * a))
    gg = trace**2 / (p * squared) if squared > 0.0 else 1.0
    room = p * (n - 1 - p * gg)
    hf = min(1.0, (n * p * gg - 2.0) / room) if room > 0.0 else 1.0
    w, chi, dof, p_value = _mauchly(a, n)
    return Sphericity(
        greenhouse_geisser=min(1.0, gg),
        huynh_feldt=max(hf, min(1.0, gg)),
        lower_bound=1.0 / p,
        mauchly_w=w,
        chi_squared=chi,
        dof=dof,
        p_value=p_value,
    )


def _mauchly(a: FloatArray, n: int) -> tuple[float, float, int, float]:
    from scipy.stats import chi2

    p = len(a)
    dof = p * (p + 1) // 2 - 1
    if p < 2 or n - 1 < p:
        return np.nan, np.nan, dof, np.nan
    sign, log_det = np.linalg.slogdet(a)
    if sign <= 0.0:
        return 0.0, np.inf, dof, 0.0
    log_w = float(log_det) - p * float(np.log(np.trace(a) / p))
    room = n - 1 - (2.0 * p * p + p + 2.0) / (6.0 * p)
    statistic = -room * log_w
    second = (p + 2.0) * (p - 1.0) * (p - 2.0) * (2.0 * p**3 + 6.0 * p * p + 3.0 * p + 2.0) / (288.0 * (p * room) ** 2)
    first = float(chi2.sf(statistic, dof))
    # the second-order term of Anderson, An introduction to multivariate statistical analysis, 1958, 10.7.4
    p_value = first + second * (float(chi2.sf(statistic, dof + 4)) - first)
    return float(np.exp(log_w)), statistic, dof, min(max(p_value, 0.0), 1.0)


# ---- pairs of conditions


@dataclass(frozen=True, slots=True)
class Pair:
    """Two conditions compared."""

    first: int  # Column
    second: int
    difference: float  # Mean of first minus second, unit of the data
    uncertainty: float  # Its standard uncertainty
    interval: tuple[float, float]  # Its 95 % interval, not corrected for the number of pairs
    t: float  # Paired t, n - 1 degrees of freedom
    p_value: float  # Two-sided
    p_holm: float  # After Holm
    cohen_dz: float  # Difference over the standard deviation of the differences
    dz_interval: tuple[float, float]  # Its 95 % interval, from that of the noncentrality of t


def compare_pairs(y: ArrayLike) -> tuple[Pair, ...]:
    """Compare every pair of conditions: y (n, k)."""
    table = frozen(y, (None, None), "pairs")
    n, k = table.shape
    if n < 3 or k < 2:
        raise InputError(f"pairs: wanted three subjects or more in two conditions or more, got {n} in {k}; add some")
    pairs = list(combinations(range(k), 2))
    apart = np.array([table[:, i] - table[:, j] for i, j in pairs])
    sd = apart.std(axis=1, ddof=1)
    return _judged(pairs, apart.mean(axis=1), sd / np.sqrt(n), sd, n - 1)


def _judged(
    pairs: list[tuple[int, int]], mean: FloatArray, uncertainty: FloatArray, sd: FloatArray, dof: int
) -> tuple[Pair, ...]:
    from scipy.special import nctdtrinc
    from scipy.stats import t as t_distribution

    t, dz = _ratio_of(mean, uncertainty), _ratio_of(mean, sd)
    p = 2.0 * t_distribution.sf(np.abs(t), dof)
    reach = float(t_distribution.ppf(0.975, dof)) * uncertainty
    spread = sd > 0.0
    beyond = np.where(spread, np.maximum(np.abs(t) / MOST_T, 1.0), 1.0)
    moderate, share = np.clip(t, -MOST_T, MOST_T), beyond * np.where(spread, _ratio_of(uncertainty, sd), 0.0)
    low, high = (np.where(spread, nctdtrinc(dof, at, moderate) * share, dz) for at in (0.975, 0.025))
    columns = (mean, uncertainty, mean - reach, mean + reach, t, p, adjust_holm(p), dz, low, high)
    rows = zip(pairs, np.stack(columns, axis=1).tolist(), strict=True)
    return tuple(
        Pair(i, j, apart, u, (least, most), t_value, p_value, p_holm, size, (size_low, size_high))
        for (i, j), (apart, u, least, most, t_value, p_value, p_holm, size, size_low, size_high) in rows
    )


def _ratio_of(mean: FloatArray, spread: FloatArray) -> FloatArray:
    """Return mean over spread; infinite, or 0 where the mean is, where there is no spread at all."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(spread > 0.0, mean / spread, np.where(mean == 0.0, 0.0, np.sign(mean) * np.inf))


def adjust_holm(p: ArrayLike) -> FloatArray:
    """Adjust p values (m,) after Holm (Scandinavian Journal of Statistics 6, 1979)."""
    values = np.asarray(p, dtype=float)
    order = np.argsort(values, kind="stable")
    stepped = np.maximum.accumulate((len(values) - np.arange(len(values))) * values[order])
    adjusted = np.empty(len(values))
    adjusted[order] = np.minimum(stepped, 1.0)
    return adjusted


def mean_limits(values: FloatArray, confidence: float) -> tuple[float, float]:
    """Return the lower and the upper limit of a mean, each alone at a confidence: mean +- t s / sqrt(n); NaN of too few."""
    from scipy.stats import t as t_distribution

    if len(values) < 2:
        return float("nan"), float("nan")
    reach = float(t_distribution.ppf(confidence, len(values) - 1) * values.std(ddof=1) / np.sqrt(len(values)))
    return float(values.mean()) - reach, float(values.mean()) + reach


# ---- verdicts against a margin

Verdict = Literal["better", "equivalent", "worse", "not decidable"]
MOST_T = 1e3  # from here on the noncentrality is proportional to t


@dataclass(frozen=True, slots=True, kw_only=True)
class Decision:
    """One mean error compared with another, against a margin."""

    other: int  # Place of what it is compared with
    difference: float  # The other's mean error less this one's: positive where this one is better, unit of the data
    interval: tuple[float, float]  # Its 95 % interval, not corrected
    cohen_dz: float  # Difference over the standard deviation of the differences
    dz_interval: tuple[float, float]  # Its 95 % interval
    margin: float  # Smallest difference that matters
    tests: int  # Differences that are judged together; the three p are after Bonferroni over them
    p_better: float  # Of a difference of the margin at most
    p_equivalent: float  # Of one of the margin at least, either way
    p_worse: float  # Of one of minus the margin at least
    verdict: Verdict  # What is shown


def three_sided(
    difference: FloatArray, uncertainty: FloatArray, dof: float, *, margin: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return p of better, equivalent (two one-sided tests: Schuirmann 1987) and worse: difference, uncertainty (m,)."""
    from scipy.special import stdtr

    above, below = (_ratio_of(sign * difference - margin, uncertainty) for sign in (1.0, -1.0))
    # better or worse is one two-sided test of a difference within the margin, so its tails are doubled
    better, worse = (np.minimum(2.0 * stdtr(dof, -t), 1.0) for t in (above, below))
    return better, np.maximum(stdtr(dof, above), stdtr(dof, below)), worse


def decide(pair: Pair, subjects: int, *, of: int, margin: float, level: float = 0.05, tests: int = 1) -> Decision:
    """Judge whether one of a pair is better than the other by more than a margin, equivalent or worse."""
    sign = -1.0 if of == pair.first else 1.0
    difference = sign * pair.difference
    found = three_sided(np.array([difference]), np.array([pair.uncertainty]), subjects - 1, margin=margin)
    better, equivalent, worse = (min(tests * float(each[0]), 1.0) for each in found)
    shown: dict[Verdict, float] = {"better": better, "equivalent": equivalent, "worse": worse}
    low, high = sorted(sign * end for end in pair.interval)
    dz_low, dz_high = sorted(sign * end for end in pair.dz_interval)
    return Decision(
        other=pair.second if of == pair.first else pair.first,
        difference=difference,
        interval=(low, high),
        cohen_dz=sign * pair.cohen_dz,
        dz_interval=(dz_low, dz_high),
        margin=margin,
        tests=tests,
        p_better=better,
        p_equivalent=equivalent,
        p_worse=worse,
        verdict=next((name for name, p in shown.items() if p <= level), "not decidable"),
    )


def decide_between(
    one: FloatArray, other: FloatArray, *, margin: float, level: float = 0.05, tests: int = 1
) -> Decision:
    """Judge the errors of one against those of another that the same subjects met: (n,) each."""
    (pair,) = compare_pairs(np.stack((one, other), axis=1))
    return decide(pair, len(one), of=0, margin=margin, level=level, tests=tests)


# ---- analysis of variance

TURN_TO_HUYNH_FELDT = 0.75


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Anova:
    """Outcome of a one-way repeated-measures analysis of variance."""

    subjects: int  # n
    conditions: int  # k
    f: float  # F of the conditions
    dof: tuple[float, float]  # Degrees of freedom of the conditions and of the error, not corrected
    p_uncorrected: float
    p_greenhouse_geisser: float
    p_huynh_feldt: float
    p_value: float  # The one to quote
    correction: str  # Which that is
    sphericity: Sphericity  # Epsilons and Mauchly's test
    partial_eta_squared: float  # SS_condition / (SS_condition + SS_error)
    partial_eta_squared_interval: tuple[float, float]  # Its 95 % interval, with the epsilon of the quoted p
    generalized_eta_squared: float  # SS_condition / SS_total, subjects being a measured factor
    means: FloatArray  # (k,), of the conditions
    mean_square_error: float  # SS_error over its degrees of freedom, squared unit of the data


def compare_conditions(y: ArrayLike) -> Anova:
    """Compare conditions that every subject met: y (n, k)."""
    from scipy.stats import f as f_distribution

    table = frozen(y, (None, None), "anova")
    n, k = table.shape
    if k < 2 or n < 3:
        raise InputError(
            f"anova: wanted three subjects or more in two conditions or more, got {n} subjects in {k}; add some"
        )
    if gaps := int(np.isnan(table).any(axis=1).sum()):
        raise InputError(
            f"anova: wanted every subject in every condition, got {gaps} of {n} subjects with gaps; leave them out"
        )
    total = float(((table - table.mean()) ** 2).sum())
    between, error = map(float, _sums_of_squares(table))
    d1, d2 = float(k - 1), float((n - 1) * (k - 1))
    if error <= 1e-24 * max(total, 1e-300):
        raise InputError(
            "anova: wanted subjects that differ in how they respond, got none that do; the conditions' differences are exact"
        )
    f = (between / d1) / (error / d2)
    form = sphericity(table)
    p, p_gg, p_hf = (
        float(f_distribution.sf(f, e * d1, e * d2)) for e in (1.0, form.greenhouse_geisser, form.huynh_feldt)
    )
    lenient = form.greenhouse_geisser > TURN_TO_HUYNH_FELDT
    epsilon = form.huynh_feldt if lenient else form.greenhouse_geisser
    return Anova(
        subjects=n,
        conditions=k,
        f=f,
        dof=(d1, d2),
        p_uncorrected=p,
        p_greenhouse_geisser=p_gg,
        p_huynh_feldt=p_hf,
        p_value=p_hf if lenient else p_gg,
        correction="huynh-feldt" if lenient else "greenhouse-geisser",
        sphericity=form,
        partial_eta_squared=between / (between + error),
        partial_eta_squared_interval=eta_squared_interval(f, (d1, d2), epsilon=epsilon),
        generalized_eta_squared=between / total,
        means=table.mean(axis=0),
        mean_square_error=error / d2,
    )


def eta_squared_interval(f: float, dof: tuple[float, float], *, epsilon: float = 1.0) -> tuple[float, float]:
    """Return the 95 % interval of partial eta squared, from that of the noncentrality of F (Steiger 2004)."""
    from scipy.optimize import brentq
    from scipy.special import ncfdtr

    d1, d2 = epsilon * dof[0], epsilon * dof[1]

    def share(p: float) -> float:
        if ncfdtr(d1, d2, 0.0, f) <= p:
            return 0.0
        high = 2.0 * d1 * f + 20.0
        while ncfdtr(d1, d2, high, f) > p:
            high *= 2.0
        noncentrality = float(brentq(lambda x: ncfdtr(d1, d2, x, f) - p, 0.0, high)) / epsilon
        return noncentrality / (noncentrality + sum(dof))  # the limit of the estimate with many subjects

    return share(0.975), share(0.025)


def _sums_of_squares(y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the sums of squares of the conditions and of the error: y (..., n, k)."""
    by_condition, by_subject, grand = (y.mean(axis=axis, keepdims=True) for axis in (-2, -1, (-2, -1)))
    error = ((y - by_condition - by_subject + grand) ** 2).sum(axis=(-2, -1))
    return y.shape[-2] * ((by_condition - grand) ** 2).sum(axis=(-2, -1)), error
