"""A target in place of an optimum: which session is chosen, what the other cohort says of it, and how often that is wrong."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.data import show
from testkit.surfaces import errors
from undrift.study import judge
from undrift.study.case import EFFECTS
from undrift.study.judge import find_optimum
from undrift.study.plan import Aim, StudyTask, note_study
from undrift.study.run import TaskSurface
from undrift.study.statistics import mean_limits
from undrift.study.target import REMEDIES, CheapestSession, choose, judge_target

AIM = Aim(target_deg=1.0, margin_deg=0.1)
TASK: StudyTask = note_study(quick=True).tasks[0]


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(18)


def surface(error: np.ndarray, minutes: list[float], **columns: list[float]) -> TaskSurface:
    """Protocols that differ in omega_M, or as stated."""
    count = error.shape[1]
    named = {
        "cutoff_hz": np.full(count, 20.0),
        "turn_rate_step_dps": np.full(count, 5.0),
        "turn_rate_min_dps": np.full(count, 5.0),
        "turn_rate_max_dps": np.linspace(50.0, 110.0, count),
    }
    further = {name: np.array(values) for name, values in columns.items() if name not in named}
    named |= {name: np.array(values) for name, values in columns.items() if name in named}
    return TaskSurface(task="sit_to_stand", rig_minutes=np.array(minutes), further=further, **named, **errors(error))


def skewed(means: list[float], rng: np.random.Generator, subjects: int = 30) -> np.ndarray:
    """Errors of subjects as errors are: never below zero, a few large; subjects differ more than protocols do."""
    person = rng.lognormal(-0.08, 0.4, (subjects, 1))  # of mean exp(-0.08 + 0.4^2 / 2) = 1
    return np.array(means) * person * rng.lognormal(-0.005, 0.1, (subjects, len(means)))


def judged(
    error: np.ndarray, other: np.ndarray, minutes: list[float], aim: Aim = AIM, **columns: list[float]
) -> CheapestSession:
    held = surface(error, minutes, **columns)
    optimum = find_optimum(held, aim)
    place = choose(TASK, held, optimum, aim)
    own = other[:, optimum.best if place is None else place]
    done = own[np.isfinite(own)]
    nan = float("nan")
    tested = judge.Tested(
        subjects=len(own),
        failed=len(own) - len(done),
        error_rms_deg=float(done.mean()),
        error_max_deg=nan,
        interval_rms_deg=(nan, nan),
        interval_max_deg=(nan, nan),
        limits_deg=mean_limits(done, aim.confidence),
    )
    found = judge_target(TASK, held, optimum, place, tested, ("accelerometer offset", 0.6), aim)
    assert found is not None
    return found


def test_the_shortest_session_below_the_target_is_chosen_and_not_the_best(rng: np.random.Generator) -> None:
    means, minutes = [0.2, 0.3, 0.6, 1.5], [400.0, 200.0, 6.0, 2.0]
    found = judged(skewed(means, rng), skewed(means, rng), minutes)
    assert (found.place, found.minutes, found.verdict) == (2, 6.0, "enough")
    text = found.finding.text
    assert text.startswith("Enough for 1 deg: 6 min; faces fixture, rate table, chamber: mean error below 0.")
    assert "95 % confidence, on 30 people and devices that had no part in the choice" in text


def test_of_sessions_as_long_the_one_without_a_chamber_then_the_one_with_less_error_is_chosen(
    rng: np.random.Generator,
) -> None:
    error = skewed([0.5, 0.6, 0.55], rng)
    found = judged(error, error, [10.1, 10.3, 9.8], set_points=[2.0, 1.0, 1.0])
    assert (found.place, found.needs) == (2, ("faces fixture", "rate table"))


def test_what_no_protocol_reaches_names_what_stands_in_the_way_and_what_removes_it(rng: np.random.Generator) -> None:
    found = judged(skewed([2.0, 2.5], rng), skewed([2.0, 2.5], rng), [10.0, 5.0])
    assert (found.place, found.chosen, found.verdict) == (0, False, "not reached")
    text = found.finding.text
    assert "No protocol that was tried reaches 1 deg" in text
    assert "accelerometer offset makes 60 % of its mean square" in text
    assert text.endswith(REMEDIES["accelerometer offset"])
    assert list(REMEDIES) == [*EFFECTS]


def test_a_device_that_the_session_cannot_calibrate_is_not_enough(rng: np.random.Generator) -> None:
    other = skewed([0.5], rng)
    other[3] = np.nan
    assert judged(skewed([0.5], rng), other, [10.0]).verdict == "not enough"


def test_a_chosen_session_above_the_target_on_the_other_cohort_is_not_enough(rng: np.random.Generator) -> None:
    found = judged(skewed([0.5], rng), skewed([2.0], rng), [10.0])
    assert (found.verdict, found.finding.code) == ("not enough", "study.target_missed")


def test_near_the_target_more_subjects_are_asked_for(rng: np.random.Generator) -> None:
    found = judged(skewed([0.97], rng), skewed([0.97], rng), [10.0])
    assert found.verdict == "not decidable"
    assert "Not decidable whether 1 deg is reached" in found.finding.text


def test_a_session_at_the_edge_of_what_decides_is_never_enough(rng: np.random.Generator) -> None:
    # the error still falls at the greatest omega_M that was tried, and only there is the target reached
    falling = [2.0, 1.4, 0.5]
    found = judged(skewed(falling, rng), skewed(falling, rng), [10.0, 10.0, 10.0])
    assert (found.place, found.verdict, found.edges) == (2, "at the edge", ("turn_rate_max_dps",))
    assert "omega_M" in found.finding.text
    flat = [2.0, 0.5, 0.5]  # it does not fall any more
    assert judged(skewed(flat, rng), skewed(flat, rng), [10.0, 10.0, 10.0]).verdict == "enough"
    cutoffs = {"cutoff_hz": [20.0, 30.0, 45.0], "turn_rate_max_dps": [90.0] * 3}  # of 100 Hz: no cut-off is above
    assert judged(skewed(falling, rng), skewed(falling, rng), [10.0] * 3, **cutoffs).verdict == "enough"


@pytest.mark.slow
@pytest.mark.parametrize("repeats", [200, 2000])
def test_a_session_that_is_not_enough_is_called_enough_as_seldom_as_stated(
    rng: np.random.Generator, repeats: int
) -> None:
    from scipy.stats import binom

    subjects, means = 30, [0.3, 0.6, 1.0, 1.02]  # the true mean of the third is the target itself, of the fourth above
    minutes = [400.0, 200.0, 6.0, 5.0]
    wrong = enough = alone = 0
    for _ in range(repeats):
        poor = judged(skewed(means[2:], rng, subjects), skewed(means[2:], rng, subjects), minutes[2:])
        wrong += poor.verdict in ("enough", "at the edge")
        one = skewed([1.0], rng, subjects)[:, 0]  # the limit alone, without the choice before it
        alone += mean_limits(one, AIM.confidence)[1] <= 1.0
        good = judged(skewed(means, rng, subjects), skewed(means, rng, subjects), minutes)
        enough += good.verdict == "enough" and good.place <= 1
    limit = int(binom.ppf(0.999, repeats, 1.0 - AIM.confidence))
    show("called enough of 200 that are not", wrong, limit)
    show("of them by the limit alone", alone, "8 % expected of skewed errors")
    show("called enough of 200 that are", enough, f"{repeats}")
    assert wrong <= limit
    assert 0 < alone <= int(binom.ppf(0.999, repeats, 0.084))
    assert enough >= 0.9 * repeats


def test_a_target_asks_for_a_confidence_that_is_one() -> None:
    from undrift.errors import InputError

    with pytest.raises(InputError, match=r"target_deg above 0 and a confidence from 0\.5"):
        replace(note_study(quick=True), target_deg=1.0, confidence=95.0)
