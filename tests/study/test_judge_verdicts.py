"""Better, equivalent or not decidable: planted tables come out as planted, and wrong verdicts keep to the level."""

from typing import Any

import numpy as np
import pytest

from testkit.data import show
from testkit.surfaces import errors
from undrift.study.judge import NoteComparison, Optimum, ParameterVerdict, compare_with_note, find_optimum
from undrift.study.plan import Aim, NoteRow
from undrift.study.run import TaskSurface
from undrift.study.statistics import (
    Decision,
    compare_conditions,
    compare_pairs,
    decide,
    eta_squared_interval,
    three_sided,
)

DRAWS = 2000
SIGMA = (0.05 * 0.95 / DRAWS) ** 0.5
MOST_WRONG = 0.05 + 3.0 * SIGMA  # the level and three sigma of so many draws
WHOLE_STUDIES = pytest.mark.parametrize("draws", [500, pytest.param(DRAWS, marks=pytest.mark.slow)])
COVERED = 0.95 - 3.0 * SIGMA, 0.95 + 3.0 * SIGMA
M = 0.15
NAMES = ("cutoff_hz", "turn_rate_step_dps", "turn_rate_min_dps", "turn_rate_max_dps")
ROW = NoteRow(11.1, 5.0, 5.0, 60.0, 0.048)


def surface(error: np.ndarray, **columns: Any) -> TaskSurface:
    """One protocol a column of the errors, the note's values where none are given; each session shorter than that before."""
    count = error.shape[1]
    given = {name: getattr(ROW, name) for name in NAMES} | columns
    return TaskSurface(
        task="sit_to_stand",
        **{name: np.broadcast_to(np.asarray(values, float), count) for name, values in given.items()},
        rig_minutes=np.arange(count, 0.0, -1.0),
        **errors(error),
    )


def table(means: object, *, subjects: int = 30, sd: float = 0.1, seed: int = 0) -> np.ndarray:
    """Errors of subjects with levels of their own; sd of one response."""
    rng, true = np.random.default_rng(seed), np.asarray(means, float)
    return true + rng.normal(0.0, sd, (subjects, len(true))) + rng.normal(0.0, 0.5, (subjects, 1))


def optimum_of(held: TaskSurface, margin_deg: float = M) -> Optimum:
    return find_optimum(held, Aim(margin_deg=margin_deg))


def judged_of(held: TaskSurface, name: str, margin_deg: float = M) -> ParameterVerdict:
    effect = next(effect for effect in optimum_of(held, margin_deg).effects if effect.name == name)
    assert effect.judged is not None
    return effect.judged


def decided(y: np.ndarray, **words: Any) -> Decision:
    """The first of two columns against the second."""
    return decide(compare_pairs(y)[0], len(y), of=0, margin=M, **words)


# ---- one difference


@pytest.mark.parametrize("apart", [0.0, 0.1, -0.1, 0.2, -0.5])
def test_p_of_equivalent_is_that_of_the_two_one_sided_tests_of_statsmodels(apart: float) -> None:
    from scipy.stats import ttest_1samp
    from statsmodels.stats.weightstats import ttost_paired

    y = table([0.0, apart])
    found = decided(y)
    assert found.p_equivalent == pytest.approx(float(ttost_paired(y[:, 1], y[:, 0], -M, M)[0]), rel=1e-9)
    difference = y[:, 1] - y[:, 0]
    better = float(ttest_1samp(difference, M, alternative="greater").pvalue)
    assert found.p_better == pytest.approx(min(2.0 * better, 1.0), rel=1e-9)
    worse = float(ttest_1samp(difference, -M, alternative="less").pvalue)
    assert found.p_worse == pytest.approx(min(2.0 * worse, 1.0), rel=1e-9)


def test_the_three_verdicts_and_the_direction_of_each() -> None:
    assert [decided(table([1.0, 1.0 + apart], seed=1)).verdict for apart in (0.4, 0.0, -0.4, M)] == [
        "better",
        "equivalent",
        "worse",
        "not decidable",
    ]
    y = table([1.0, 1.4])
    (pair,) = compare_pairs(y)
    other = decide(pair, 30, of=1, margin=M)
    assert (other.verdict, other.other) == ("worse", 0)
    assert other.difference == -decided(y).difference < 0.0
    assert other.interval == tuple(-end for end in reversed(decided(y).interval))
    # a difference that is significant and smaller than the margin is equivalent
    small = decided(table([1.0, 1.06], sd=0.03))
    assert small.interval[0] > 0.0
    assert small.verdict == "equivalent"


def test_responses_that_do_not_spread_are_exact() -> None:
    for apart, verdict in ((0.0, "equivalent"), (0.1, "equivalent"), (0.2, "better")):
        found = decided(np.array([0.3, 0.3 + apart]) + np.arange(5.0)[:, None])
        assert found.verdict == verdict


@pytest.mark.parametrize("subjects", [5, 30])
@pytest.mark.parametrize("sd", [0.02, 0.1, 0.5])
def test_wrong_verdicts_keep_to_the_level_whatever_is_true(subjects: int, sd: float) -> None:
    rng = np.random.default_rng(1)
    for true in (0.0, 0.5 * M, M, 2.0 * M, -M):
        y = rng.normal(true, sd, (DRAWS, subjects))
        p = three_sided(y.mean(axis=1), y.std(axis=1, ddof=1) / subjects**0.5, subjects - 1, margin=M)
        better, equivalent, worse = (each <= 0.05 for each in p)
        assert (better.astype(int) + equivalent + worse).max() == 1  # never two
        if abs(true) <= M:
            assert (better | worse).mean() <= MOST_WRONG
        if abs(true) >= M:
            assert equivalent.mean() <= MOST_WRONG
            assert (better if true < 0.0 else worse).mean() <= MOST_WRONG
        show(f"{true:+.3f} deg, sd {sd}, {subjects} subjects: better", float(better.mean()), "equivalent, worse:")
        show("", float(equivalent.mean()), f"{worse.mean():.3f}")


# ---- effect sizes


@pytest.mark.slow
@pytest.mark.parametrize("dz", [0.0, 0.5, 2.0])
def test_intervals_of_dz_cover(dz: float) -> None:
    rng = np.random.default_rng(3)
    inside = 0
    for y in rng.normal(0.0, 1.0, (DRAWS, 12, 2)):
        low, high = compare_pairs(y + np.array([dz * 2.0**0.5, 0.0]))[0].dz_interval
        inside += low <= dz <= high
    show(f"95 % intervals of dz = {dz:g} that hold it", inside / DRAWS, f"{COVERED[0]:.3f} to {COVERED[1]:.3f}")
    assert COVERED[0] <= inside / DRAWS <= COVERED[1]


def test_intervals_of_dz_scale_where_t_is_beyond_the_tables() -> None:
    y = np.random.default_rng(4).normal(0.0, 1.0, (12, 2))
    y[:, 0] -= y[:, 0].mean() - y[:, 1].mean()  # no difference but the one that is put in
    near, far = (compare_pairs(y + np.array([apart, 0.0]))[0] for apart in (200.0, 2e6))
    assert 100.0 < near.t < 1e3 < far.t
    for a, b in zip(near.dz_interval, far.dz_interval, strict=True):
        assert b / a == pytest.approx(1e4, rel=1e-3)


@pytest.mark.slow
def test_intervals_of_partial_eta_squared_cover() -> None:
    rng, means, n = np.random.default_rng(5), np.array([0.0, 0.3, 0.8]), 20
    noncentrality = n * float(((means - means.mean()) ** 2).sum())
    true = noncentrality / (noncentrality + n * 2.0)
    inside = 0
    for y in rng.normal(0.0, 1.0, (DRAWS, n, 3)) + means:
        found = compare_conditions(y)
        low, high = eta_squared_interval(found.f, found.dof)
        inside += low <= true <= high
    show("95 % intervals of partial eta squared that hold it", inside / DRAWS, f"{COVERED[0]:.3f} to {COVERED[1]:.3f}")
    assert COVERED[0] <= inside / DRAWS <= COVERED[1]


def test_eta_squared_has_an_interval_about_it_whatever_f_is() -> None:
    assert eta_squared_interval(0.1, (3.0, 87.0))[0] == 0.0
    for f in (1.0, 30.0, 1e4, 1e7):
        low, high = eta_squared_interval(f, (3.0, 87.0))
        assert low <= 3.0 * f / (3.0 * f + 87.0) <= high <= 1.0
    y = table([0.0, 0.2, 0.5])
    balanced = compare_conditions(y)
    low, high = balanced.partial_eta_squared_interval
    assert 0.0 < low < balanced.partial_eta_squared < high < 1.0


# ---- parameters


@pytest.mark.parametrize(
    ("name", "values", "means"),
    [
        ("turn_rate_step_dps", [3.0, 5.0, 10.0, 15.0], [0.2, 0.3, 0.6, 0.9]),  # more rates average a mounting error
        ("turn_rate_max_dps", [30.0, 60.0, 90.0, 120.0], [1.2, 0.8, 0.4, 0.1]),  # a bend that only fast turns show
        ("cutoff_hz", [5.0, 11.1, 20.0, 40.0], [1.0, 0.4, 0.1, 0.5]),  # a filter between delay and noise
    ],
)
def test_a_value_that_must_win_wins_in_the_right_direction(name: str, values: list[float], means: list[float]) -> None:
    held = surface(table(means), **{name: values})
    found = optimum_of(held)
    judged, best = judged_of(held, name), int(np.argmin(means))
    assert (judged.verdict, found.best, found.deciding) == ("better", best, (name,))
    show(f"{name}: p of better, margin {M} deg", judged.p_better, "< 0.05")
    assert judged.p_better < 1e-6
    assert all(each.difference > 0.0 for each in judged.decisions)
    far = max(judged.decisions, key=lambda each: each.difference)
    assert (far.verdict, far.margin) == ("better", M)
    assert far.difference == pytest.approx(max(means) - min(means), abs=0.1)  # sd 0.14 / sqrt(30), four of them
    assert not found.flat
    apart = np.array(means) - min(means)
    assert not (found.equivalent & (apart > M)).any()
    assert not (found.worse & (apart < M)).any()
    assert found.worse[int(np.argmax(means))]


def test_a_planted_equivalence_is_said_to_be_one() -> None:
    held = surface(table([0.5, 0.51, 0.49, 0.5]), cutoff_hz=[5.0, 8.0, 11.1, 20.0])
    found, judged = optimum_of(held), judged_of(held, "cutoff_hz")
    show(f"p of equivalent, margin {M} deg", judged.p_equivalent, "< 0.05")
    assert (judged.verdict, found.deciding, found.flat) == ("equivalent", (), True)
    assert found.equivalent.all()
    assert not found.worse.any()
    assert not found.undecided.any()
    assert found.cheapest == 3
    # the same table against a margin that it cannot show
    assert judged_of(held, "cutoff_hz", margin_deg=0.02).verdict == "not decidable"


def test_what_is_exact_is_equivalent_or_better_without_a_test() -> None:
    own = np.random.default_rng(6).normal(0.5, 0.1, (8, 1))
    held = surface(own + np.array([0.0, 0.0, 0.3]), cutoff_hz=[5.0, 11.1, 20.0])
    effect = optimum_of(held).effects[0]
    assert effect.untested is not None
    assert effect.judged is not None
    assert [each.verdict for each in effect.judged.decisions] == ["equivalent", "better"]


def test_a_planted_study_that_is_too_small_says_so() -> None:
    few = surface(table([0.5, 0.55, 0.6], subjects=6, sd=0.3, seed=8), cutoff_hz=[5.0, 11.1, 20.0])
    judged = judged_of(few, "cutoff_hz")
    assert judged.verdict == "not decidable"
    assert judged.p_better > 0.05 < judged.p_equivalent
    found = optimum_of(few)
    assert (found.deciding, found.flat) == ((), False)
    assert found.undecided.sum() == 2
    assert found.cheapest == found.best  # nothing shorter is shown to be equivalent


@pytest.mark.slow
@WHOLE_STUDIES
@pytest.mark.parametrize(
    ("apart", "margin", "wrong"),
    [
        ([0.0, 0.0, 0.0, 0.0, 0.0], 0.005, "better"),  # alike, and a margin far below the noise
        ([0.0, M, M, M, M], M, "better"),  # just not better by more
        ([0.0, 0.0, 0.0, 0.0, M], M, "equivalent"),  # just not within
    ],
)
def test_wrong_verdicts_of_a_parameter_keep_to_the_level(
    apart: list[float], margin: float, wrong: str, draws: int
) -> None:
    count, most = 0, 0.05 + 3.0 * (0.05 * 0.95 / draws) ** 0.5
    for seed in range(draws):
        held = surface(table(apart, subjects=12, sd=0.05, seed=seed), cutoff_hz=[5.0, 8.0, 11.1, 20.0, 40.0])
        count += judged_of(held, "cutoff_hz", margin_deg=margin).verdict == wrong
    show(f"studies whose parameter is wrongly {wrong}, margin {margin:g}", count / draws, f"at most {most:.3f}")
    assert count / draws <= most


@pytest.mark.slow
@WHOLE_STUDIES
@pytest.mark.parametrize(
    ("apart", "margin"),
    [
        (np.zeros(20), 0.01),  # all alike, and a margin below the noise: the optimum is chosen by chance
        (M * (np.arange(20) % 2), M),  # half of them just not equivalent
        (M * (np.arange(20) > 0), M),  # all but one
    ],
    ids=["alike", "half", "all"],
)
def test_wrong_verdicts_of_protocols_keep_to_the_level_though_the_optimum_is_chosen(
    apart: np.ndarray, margin: float, draws: int
) -> None:
    count, most = 0, 0.05 + 3.0 * (0.05 * 0.95 / draws) ** 0.5
    for seed in range(draws):
        # two parameters at once, so that no protocol differs from the optimum in one alone: only protocols are judged
        y = table(0.5 + apart, subjects=12, sd=0.05, seed=seed)
        held = surface(y, cutoff_hz=5.0 + np.arange(20), turn_rate_max_dps=60.0 + np.arange(20))
        found = optimum_of(held, margin_deg=margin)
        more = apart - apart[found.best]
        count += bool((found.equivalent & (more >= margin)).any() or (found.worse & (more <= margin)).any())
    show(f"studies with a wrong protocol, margin {margin:g} deg", count / draws, f"at most {most:.3f}")
    assert count / draws <= most


# ---- the note's row


def compared(means: dict[float, float], name: str = "cutoff_hz", beside: float = 0.0, **words: Any) -> NoteComparison:
    """The note's row among the neighbours of all its values: one parameter's means, the others' worse by ``beside``."""
    rows, errors = [], []
    for other in NAMES:
        own = float(getattr(ROW, other))
        values = means if other == name else dict.fromkeys((own * 0.5, own * 2.0), means[own_of(name)] + beside)
        for value, mean in values.items():
            if value != own:
                rows.append(tuple(value if each == other else getattr(ROW, each) for each in NAMES))
                errors.append(mean)
    rows.append(tuple(getattr(ROW, each) for each in NAMES))
    errors.append(means[own_of(name)])
    columns = dict(zip(NAMES, np.array(rows).T, strict=True))
    held = surface(table(errors, **words), **columns)
    return compare_with_note(held, optimum_of(held), ROW)


def own_of(name: str) -> float:
    return float(getattr(ROW, name))


def test_the_note_is_confirmed_where_a_value_is_better_than_its_neighbours_and_indifferent_where_all_are_equivalent() -> (
    None
):
    found = compared({5.0: 1.0, 11.1: 0.5, 20.0: 0.9})
    assert found.verdict == "confirmed"
    assert [value.verdict for value in found.values] == ["confirmed", *["indifferent"] * 3]
    first = found.values[0]
    assert first.lower is not None
    assert first.upper is not None
    assert (first.lower.verdict, first.upper.verdict, first.finding.code) == (
        "better",
        "better",
        "study.note_value_confirmed",
    )
    assert first.finding.text.startswith(
        "The note's cut-off is confirmed: 11.1 Hz against 5, 20: better, better (by +0."
    )
    assert "margin 0.15 deg" in first.finding.text
    assert found.values[1].finding.values["verdicts"] == ("equivalent", "equivalent")
    assert compared({5.0: 0.5, 11.1: 0.5, 20.0: 0.5}, sd=0.05).verdict == "indifferent"


def test_the_note_is_contradicted_where_a_neighbour_is_better_by_the_margin() -> None:
    found = compared({5.0: 1.0, 11.1: 0.5, 20.0: 0.1})
    assert found.verdict == "contradicted"
    assert [value.verdict for value in found.values] == ["contradicted", *["indifferent"] * 3]
    assert found.values[0].finding.values["verdicts"] == ("better", "worse")
    assert found.finding.code == "study.note_worse_by_one"


def test_an_optimum_at_the_edge_of_what_was_tried_is_not_confirmed() -> None:
    found = compared({20.0: 4.0, 30.0: 3.0, 60.0: 0.5}, "turn_rate_max_dps", beside=1.0)
    assert found.finding.code == "study.note_is_optimum"
    assert found.verdict == "not decidable"
    assert [value.verdict for value in found.values] == ["confirmed", "confirmed", "confirmed", "not decidable"]
    text = found.values[3].finding.text
    assert "60 deg/s is the greatest value with a protocol" in text
    assert text.endswith("try values on both sides")
    alone = surface(table([0.5, 0.5]), cutoff_hz=[11.1, 20.0])
    ends = [value.finding.values["end"] for value in compare_with_note(alone, optimum_of(alone), ROW).values]
    assert ends == ["least", "only", "only", "only"]


def test_neighbours_that_cannot_be_told_apart_are_not_decidable() -> None:
    found = compared({5.0: 0.5, 11.1: 0.5, 20.0: 0.52}, subjects=6, sd=0.3)
    assert found.verdict == "not decidable"
    assert {value.finding.code for value in found.values} == {"study.note_value_undecided"}
    assert "simulate more people" in found.values[0].finding.text
    assert found.finding.code in ("study.note_undecided", "study.note_is_optimum")


def test_the_neighbour_of_a_value_is_the_protocol_that_is_nearest_in_the_others() -> None:
    cutoffs, steps, highs = [11.1, 20.0, 20.0, 40.0], [5.0, 5.0, 10.0, 5.0], [60.0, 90.0, 60.0, 60.0]
    held = surface(table([0.5, 0.9, 0.2, 0.5]), cutoff_hz=cutoffs, turn_rate_step_dps=steps, turn_rate_max_dps=highs)
    first = compare_with_note(held, optimum_of(held), ROW).values[0]
    assert first.lower is None
    assert first.upper is not None
    assert first.upper.other == 1  # 20 Hz with omega_M 90, not with twice the step, and not 40 Hz
    assert first.upper.verdict == "better"
