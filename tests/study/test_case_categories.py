"""Categories of subjects in a study: tasks by category, one store, and each category's optimum worn by the others."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from testkit.surfaces import errors
from undrift.cli.app import run
from undrift.errors import FileFormatError, InputError
from undrift.sim.motion.tasks import CategoryName
from undrift.study import judge
from undrift.study.case import subject_of, units_of
from undrift.study.plan import Study, note_study, read_study, with_categories
from undrift.study.run import RunStore, TaskSurface

TEXT = """
[study]
subjects = 3
categories = ["level_2", "young"]
[[task]]
name = "step"
[task.space]
cutoff_hz = [11.4]
turn_rate_step_dps = [15.0]
turn_rate_min_dps = [15.0]
turn_rate_max_dps = [30.0, 45.0]
[task.protocol]
set_points_c = [18.0, 36.0, 54.0, 75.0]
"""


def written(folder: Path, text: str = TEXT) -> Path:
    path = folder / "study.toml"
    path.write_text(text)
    return path


def test_each_task_is_performed_by_each_category(tmp_path: Path) -> None:
    study = read_study(written(tmp_path))
    assert [(task.name, task.key) for task in study.tasks] == [("step", "step"), ("step", "step-young")]
    assert (study.categories, study.names) == (("level_2", "young"), ("step",))
    assert len({unit.key for unit in units_of(study)}) == 2 * study.subjects
    assert subject_of(study, 0, "young").age_years < 41.0 < subject_of(study, 0).age_years
    again = with_categories(study, ["impaired"])  # the command line overrules the plan
    assert [task.key for task in again.tasks] == ["step-impaired"]


def test_a_study_of_the_notes_category_is_the_study_that_it_was(tmp_path: Path) -> None:
    assert with_categories(note_study(), ["level_2"]) == note_study()
    RunStore(tmp_path, note_study())
    with pytest.raises(InputError, match="another's runs"):
        RunStore(tmp_path, with_categories(note_study(), ["young"]))


@pytest.mark.parametrize("names", [["frail"], [], ["young", "young"]])
def test_categories_that_are_none_are_refused(tmp_path: Path, names: list[str]) -> None:
    with pytest.raises(
        InputError,
        match="wanted some of level_1, level_2, level_3, level_4, young, elderly, impaired, parkinson, each once",
    ):
        with_categories(note_study(), names)
    text = TEXT.replace('["level_2", "young"]', json.dumps(names))
    with pytest.raises(FileFormatError, match="categories: wanted some of"):
        read_study(written(tmp_path, text))


# ---- planted: what another category's optimum costs


def planted(monkeypatch: pytest.MonkeyPatch, folder: Path, cost_deg: float, spread_deg: float) -> Any:
    """The comparison where every other category's optimum adds an error, by subjects that differ in it."""
    study = replace(with_categories(note_study(subjects=12, quick=True), ["young", "impaired"]))
    study = replace(study, tasks=tuple(task for task in study.tasks if task.name == "step"))
    rng = np.random.default_rng(4)

    def surface(task: Any, error: Any) -> TaskSurface:
        columns = {name: np.array([float(k)]) for k, name in enumerate((*judge.PARAMETERS, "rig_minutes"))}
        return TaskSurface(task=task.key, **columns, **errors(error[:, None]))

    def ran(other: Study, executor: Any, where: Path) -> tuple[TaskSurface, ...]:
        found = []
        for task in other.tasks:
            error = 0.5 + 0.2 * np.random.default_rng(9).standard_normal(
                12
            )  # people differ much, alike for all protocols
            if not where.name.endswith(task.category):
                error = error + cost_deg + spread_deg * rng.standard_normal(12)
            found.append(surface(task, error))
        return tuple(found)

    monkeypatch.setattr(judge, "run_study", ran)
    chosen = tuple(surface(task, np.ones(12)) for task in study.tasks)
    optima = tuple(judge.find_optimum(each) for each in chosen)
    (found,) = judge.compare_categories(study, chosen, optima, folder)
    return found


@pytest.mark.parametrize(
    ("cost_deg", "spread_deg", "verdict", "code"),
    [
        (0.3, 0.05, "better", "study.categories_differ"),
        (0.01, 0.02, "equivalent", "study.categories_alike"),
        (0.0, 0.0, "equivalent", "study.categories_alike"),
        (0.08, 0.3, "not decidable", "study.categories_undecided"),
    ],
)
def test_a_planted_cost_of_another_categorys_optimum_is_found(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, cost_deg: float, spread_deg: float, verdict: str, code: str
) -> None:
    found = planted(monkeypatch, tmp_path, cost_deg, spread_deg)
    assert [(cell.chosen, cell.worn) for cell in found.crossed] == [("young", "impaired"), ("impaired", "young")]
    for cell in found.crossed:
        assert cell.decision.verdict == verdict
        assert cell.decision.tests == 2
        # four standard errors
        reach = 4.0 * spread_deg / np.sqrt(12.0) + 1e-12
        assert cell.error_deg - cell.own_deg == pytest.approx(cost_deg, abs=reach)
    assert found.finding.code == code
    if code == "study.categories_differ":
        assert "healthy young with the optimum of Tinetti <= 18" in found.finding.text


@pytest.mark.slow
def test_the_command_line_names_categories_and_prints_who_can_wear_whose(tmp_path: Path, capsys: Any) -> None:
    plan = written(tmp_path, TEXT.replace('categories = ["level_2", "young"]\n', ""))
    out = tmp_path / "out"
    words = [
        "study",
        str(plan),
        "-o",
        str(out),
        "--no-rivals",
        "--workers",
        "1",
        "--categories",
        "level_2, young",
        "--json",
    ]
    assert run(words) == 0
    capsys.readouterr()
    summary = json.loads((out / "summary.json").read_text())
    assert [task["task"] for task in summary["tasks"]] == ["step", "step-young"]
    assert [task["note"] is None for task in summary["tasks"]] == [False, True]  # the note's row is for its category
    kinds: list[CategoryName] = [cohort["category"] for cohort in summary["cohorts"]]
    assert kinds == ["level_2", "level_2", "young", "young"]
    (compared,) = summary["categories"]
    assert compared["task"] == "step"
    for cell in compared["crossed"]:
        assert cell["chosen"] != cell["worn"]
        own = next(t for t in summary["tasks"] if t["task"].endswith("young") == (cell["worn"] == "young"))
        assert cell["own_deg"] == pytest.approx(own["tested"]["optimum"]["error_rms_deg"], rel=1e-9)  # the same runs
    page = (out / "report.html").read_text()
    assert "step, healthy young" in page
    assert "the optimum of each category, worn by the others" in page
