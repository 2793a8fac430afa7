"""Categories of subjects in a study: tasks by category, one store, and each category's optimum worn by the others."""

import json
from pathlib import Path

import pytest

from undrift.errors import FileFormatError, InputError
from undrift.study.case import subject_of, units_of
from undrift.study.plan import note_study, read_study, with_categories
from undrift.study.run import RunStore

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
