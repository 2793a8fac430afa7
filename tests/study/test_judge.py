"""Answers of a study from planted errors, and the analysis of variance against published examples."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.data import show
from undrift.errors import InputError
from undrift.study.judge import adjust_holm, errors_of, judge, judge_parameters, repeated_measures_anova, with_test
from undrift.study.plan import Study, StudyTask, TryEntry
from undrift.study.run import Run
from undrift.study.sessions import SESSIONS

# A. Field, Discovering statistics: eight people, seconds until they retch at four foods.
FOODS = np.array(
    [[8, 9, 6, 5, 8, 7, 10, 12], [7, 5, 2, 3, 4, 5, 2, 6], [1, 2, 3, 1, 5, 6, 7, 8], [6, 5, 8, 9, 8, 7, 2, 1]], float
).T


def test_the_example_of_the_foods_comes_out_as_printed():
    found = repeated_measures_anova(FOODS)
    for name, value, printed in (("F", found.f, 3.79), ("epsilon", found.epsilon, 0.533), ("p", found.p_value, 0.063)):
        show(f"foods: {name}", value, printed)
        assert value == pytest.approx(printed, abs=0.0051 if printed > 1 else 0.00051)  # as many digits as printed


def test_f_is_the_one_of_statsmodels():
    import pandas as pd
    from statsmodels.stats.anova import AnovaRM

    y = np.random.default_rng(1).normal(size=(9, 5)) + np.arange(5)
    long = pd.DataFrame({"y": y.ravel(), "s": np.repeat(np.arange(9), 5), "c": list("abcde") * 9})
    theirs = AnovaRM(long, "y", "s", within=["c"]).fit().anova_table
    assert repeated_measures_anova(y).f == pytest.approx(float(theirs["F Value"].iloc[0]), rel=1e-10)


def test_exact_differences_and_two_subjects_are_refused():
    for table in (np.ones((2, 3)), np.arange(4.0)[:, None] + np.arange(3.0)):
        with pytest.raises(InputError):
            repeated_measures_anova(table)


def test_holm_by_hand():
    np.testing.assert_allclose(adjust_holm([0.01, 0.04, 0.03]), [0.03, 0.06, 0.06])


TRIED = TryEntry(turn_rate_step_dps=(5.0, 17.0), turn_rate_max_dps=(90.0, 50.0))
TASKS = (StudyTask(name="sit_to_stand"), StudyTask(name="step"))
CHOSEN = ("hand", "three rates", "note")
STUDY = Study(tasks=TASKS, sessions=tuple(SESSIONS[name] for name in CHOSEN), target_deg=(0.1, 0.5, 1.0))


def run(task, subject, session, rms, role="session", **more):
    about = {"cutoff_hz": float("nan"), "excursion_k": 12.5, "offset": "rest"} | more
    errors = {"rms_deg": rms, "real_time_deg": 2.0 * rms, "largest_deg": 3.0 * rms}
    return Run(task=task, subject=subject, session=session, role=role, **errors, **about)


def planted(means, count=40, role="session"):
    rng = np.random.default_rng(4)
    return [
        run(task, k, session, mean * (1.0 + 0.1 * rng.normal()), role)
        for (task, session), mean in means.items()
        for k in range(count)
    ]


MEANS = {
    ("sit_to_stand", "hand"): 0.6, ("sit_to_stand", "three rates"): 0.3, ("sit_to_stand", "note"): 0.29,
    ("step", "hand"): 0.2, ("step", "three rates"): 0.8, ("step", "note"): 0.1,
}  # fmt: skip


def test_the_cheapest_session_below_the_target_is_the_answer():
    outcome = judge(STUDY, planted(MEANS))
    by_task = {task.task.key: [answer.session for answer in task.answers] for task in outcome.tasks}
    assert by_task == {"sit_to_stand": ["", "three rates", "hand"], "step": ["", "hand", "hand"]}
    assert [answer.session for answer in outcome.for_all] == ["", "note", "hand"]


def test_the_quantile_decides_and_not_the_mean():
    """Mean 0.45 deg, but a tenth of the devices is at 0.9 deg."""
    runs = [run("step", k, "hand", 0.9 if k % 10 == 0 else 0.4) for k in range(40)]
    study = replace(STUDY, tasks=TASKS[1:], sessions=(SESSIONS["hand"],))
    (row,) = judge(study, runs).tasks[0].sessions
    assert row.mean_deg == pytest.approx(0.45)
    assert row.quantile_deg > 0.5
    assert [answer.session for answer in judge(study, runs).tasks[0].answers] == ["", "", "hand"]


def test_an_answer_is_tested_on_the_other_group():
    outcome = judge(STUDY, planted(MEANS))
    good = with_test(outcome, planted(MEANS, role="testing"), [])
    assert all(answer.confirmed for task in good.tasks for answer in task.answers if answer.session)
    twice = {key: 2.0 * mean for key, mean in MEANS.items()}
    bad = with_test(outcome, planted(twice, role="testing"), [])
    assert not bad.tasks[0].answers[1].confirmed
    assert bad.tasks[0].answers[1].tested == 40


def test_real_time_is_judged_if_it_is_asked_for():
    runs = planted(MEANS)
    aligned, now = (errors_of(runs, "step", "hand", timing) for timing in ("aligned", "real time"))
    np.testing.assert_allclose(now, 2.0 * aligned)
    assert judge(replace(STUDY, timing="real time"), runs).tasks[1].sessions[0].mean_deg == pytest.approx(now.mean())


def test_a_number_that_does_not_matter_is_indifferent_however_small_p_is():
    """A step changes all errors by 0.01 deg: p is tiny, the difference far below the margin."""
    task = StudyTask(name="step", tried=TRIED)
    rng, runs = np.random.default_rng(7), []
    for parameter, value, numbers in task.variations():
        effect = {("turn_rate_step_dps", 17.0): 0.01, ("turn_rate_max_dps", 50.0): -0.3}.get((parameter, value), 0.0)
        runs += [
            run(
                "step",
                k,
                numbers.session().name,
                0.5 + effect + 0.001 * rng.normal(),
                "try",
                cutoff_hz=numbers.cutoff_hz,
            )
            for k in range(20)
        ]
    step, highest = judge_parameters(STUDY, runs, task)
    assert step.anova.p_value < 1e-6
    assert step.verdict == "indifferent"
    assert highest.verdict == "another value is better"
    assert step.p_holm >= step.anova.p_value
