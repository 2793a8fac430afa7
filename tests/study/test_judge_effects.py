"""What each parameter does: analysis of variance, Holm's pairs, the mixed model where runs are missing; as statsmodels has it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from testkit.surfaces import errors
from undrift.commands.study import Studied
from undrift.findings import finding
from undrift.programme import Protocol
from undrift.report.page import write_page
from undrift.study.case import units_of
from undrift.study.judge import ParameterEffect
from undrift.study.outcome import TaskOutcome, judge_study
from undrift.study.plan import Space, Study, StudyTask
from undrift.study.run import InProcess, RunStore, TaskSurface, read_surfaces, run_study, without_lost

DPS = np.pi / 180.0
TASK = StudyTask(
    name="step",
    space=Space(
        cutoff_hz=(5.0, 11.4, 20.0),
        turn_rate_step=(10.0 * DPS,),
        turn_rate_min=(10.0 * DPS,),
        turn_rate_max=(30.0 * DPS, 40.0 * DPS, 50.0 * DPS),
    ),
    base=Protocol(grid="paper", dwell_s=1.0, bracket_s=3.0, temperatures_c=(18.0, 36.0, 54.0, 75.0)),
)
STUDY = Study(name="planted", device="enc03j_3031", tasks=(TASK,), subjects=12, margin_deg=0.01)
OPTIMUM = 40.0  # deg/s, of omega_M; the cut-off makes no difference


def plant(folder: Path, missing: tuple[tuple[int, float], ...] = (), lost: int | None = None) -> None:
    """Fill a study's folder with runs of known errors; the missing ones as a unit leaves them whose device was not calibrated."""
    store, rng = RunStore(folder, STUDY), np.random.default_rng(11)
    own = rng.normal(0.5, 0.1, STUDY.subjects)
    for unit in units_of(STUDY):
        greatest = np.array([30.0, 40.0, 50.0])
        error = own[unit.subject] + 0.004 * np.abs(greatest - OPTIMUM) + rng.normal(0.0, 0.02, 3)
        if (unit.subject, unit.setting.cutoff_hz) in missing or unit.subject == lost:
            error = np.full(3, np.nan)
        store.write(
            unit,
            {
                "cutoff_hz": np.full(3, unit.setting.cutoff_hz),
                "turn_rate_step_dps": np.full(3, 10.0),
                "turn_rate_min_dps": np.full(3, 10.0),
                "turn_rate_max_dps": greatest,
                "rig_minutes": greatest,
            }
            | errors(error),
        )


def judged(folder: Path) -> TaskOutcome:
    (task,) = judge_study(STUDY, InProcess(), folder).tasks
    return task


def effect_of(task: TaskOutcome, name: str) -> ParameterEffect:
    return next(effect for effect in task.optimum.effects if effect.name == name)


def long_table(folder: Path, task: TaskOutcome, name: str) -> pd.DataFrame:
    """The runs that an effect is judged by, from the file that a user has."""
    runs = pd.read_parquet(folder / "surface.parquet")
    for other in ("cutoff_hz", "turn_rate_max_dps"):
        if other != name:
            runs = runs[np.isclose(runs[other], getattr(task.surface, other)[task.optimum.best])]
    return runs.dropna()


@pytest.mark.slow
def test_a_whole_study_is_judged_by_analysis_of_variance_and_holms_pairs_as_statsmodels_does(tmp_path: Path) -> None:
    from scipy.stats import ttest_rel
    from statsmodels.stats.anova import AnovaRM
    from statsmodels.stats.multitest import multipletests

    plant(tmp_path)
    task = judged(tmp_path)
    effect = effect_of(task, "turn_rate_max_dps")
    runs = long_table(tmp_path, task, "turn_rate_max_dps")
    theirs = AnovaRM(runs, "error_rms_deg", "subject", within=["turn_rate_max_dps"]).fit().anova_table
    assert effect.anova is not None
    assert effect.anova.f == pytest.approx(float(theirs["F Value"].iloc[0]), rel=1e-9)
    assert effect.values[effect.best] == OPTIMUM
    means = runs.groupby("turn_rate_max_dps")["error_rms_deg"].mean()
    assert effect.span_deg == pytest.approx(float(means.max() - means.min()), rel=1e-9)
    table = runs.pivot_table(index="subject", columns="turn_rate_max_dps", values="error_rms_deg").to_numpy()
    p = [float(ttest_rel(table[:, pair.first], table[:, pair.second]).pvalue) for pair in effect.pairs]
    assert [(pair.first, pair.second) for pair in effect.pairs] == [(0, 1), (0, 2), (1, 2)]
    np.testing.assert_allclose([pair.p_holm for pair in effect.pairs], multipletests(p, method="holm")[1], rtol=1e-9)
    assert effect_of(task, "cutoff_hz").pairs == ()  # it does not matter, so its values are not compared
    assert effect_of(task, "turn_rate_step_dps").untested == finding("study.one_value", "info")


def test_a_subject_whose_device_nothing_calibrates_is_left_out_and_named(tmp_path: Path) -> None:
    plant(tmp_path, lost=4)
    outcome = judge_study(STUDY, InProcess(), tmp_path)
    (task,) = outcome.tasks
    assert task.surface.left_out == (4,)
    assert task.surface.error_rms_deg.shape == (11, 9)
    effect = effect_of(task, "turn_rate_max_dps")
    assert effect.anova is not None  # eleven subjects, none with a gap
    assert effect.anova.subjects == 11
    write_page(tmp_path / "report.html", Studied(outcome=outcome, output=tmp_path).summary())
    page = (tmp_path / "report.html").read_text()
    assert (
        "<strong>Subjects left out</strong>: no protocol calibrated the device of subject 4 of surface.parquet" in page
    )


def test_too_few_subjects_are_not_made_fewer(tmp_path: Path) -> None:
    three = replace(STUDY, subjects=3)
    plant(tmp_path / "all")
    surface = read_surfaces(RunStore(tmp_path / "all", STUDY).join(units_of(STUDY)), STUDY)[0]
    lost = surface.error_rms_deg[: three.subjects].copy()
    lost[0] = np.nan
    small = replace(surface, **errors(lost))
    assert without_lost(small) is small


@pytest.mark.slow
def test_a_level_that_leaves_a_device_uncalibrated_is_not_tested(tmp_path: Path) -> None:
    plant(tmp_path, missing=((3, 20.0),))
    effect = effect_of(judged(tmp_path), "cutoff_hz")
    assert effect.values.tolist() == [5.0, 11.4]
    assert effect.dropped.tolist() == [20.0]
    assert effect.anova is not None


@pytest.mark.slow
def test_the_page_says_what_decides_and_which_values_differ(tmp_path: Path) -> None:
    plant(tmp_path, missing=((3, 11.4),))
    outcome = judge_study(STUDY, InProcess(), tmp_path)
    write_page(tmp_path / "report.html", Studied(outcome=outcome, output=tmp_path).summary())
    page = (tmp_path / "report.html").read_text()
    assert page.index("Answer: the protocol to use") < page.index("Table 1: optimised parameters")
    for wanted in (
        "10 to 40 by 10",
        "<strong>Parameters that decide the error</strong>: omega_M (best to worst 0.0",
        "<strong>Runs missing</strong>: 3 of 108",
        "left out, a device was not calibrated: 11.4",
        "step: the optimum&#39;s values against the others",
        "deg; p 0.0",
        "of a difference within 0.01 deg, 12 subjects)",
        "The tests in full",
        "generalised eta²",
        "none: one value only",
    ):
        assert wanted in page, wanted
    assert ">nan<" not in page


def test_a_surface_is_as_it_was_where_nothing_is_lost() -> None:
    values = np.ones((3, 2))
    held = TaskSurface(
        task="step",
        cutoff_hz=np.ones(2),
        turn_rate_step_dps=np.ones(2),
        turn_rate_min_dps=np.ones(2),
        turn_rate_max_dps=np.ones(2),
        rig_minutes=np.ones(2),
        **errors(values),
    )
    assert without_lost(held) is held


def test_a_study_with_a_run_removed_is_the_study_run_to_its_end(tmp_path: Path) -> None:
    small = replace(STUDY, subjects=3, tasks=(replace(TASK, space=replace(TASK.space, cutoff_hz=(5.0,))),))
    (whole,) = run_study(small, InProcess(), tmp_path)
    (tmp_path / "runs" / f"{units_of(small)[1].key}.parquet").unlink()
    (again,) = run_study(small, InProcess(), tmp_path)
    assert (again.error_rms_deg == whole.error_rms_deg).all()
