"""Whose motions a study has: recorded people named in a table, and categories with a lab's own means and deviations."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from testkit.data import show
from undrift.errors import FileFormatError, InputError
from undrift.io.reference import write_reference
from undrift.record import Reference
from undrift.sim.motion.tasks import CATEGORIES, Category, Performance, cohort, draw_task
from undrift.sim.table_sessions import QUICKEST_HZ
from undrift.study import judge
from undrift.study.case import Unit, alike, errors_with, make_case, run_unit, subject_of
from undrift.study.plan import ERRORS, read_study, with_categories
from undrift.study.run import InProcess, run_study
from undrift.study.space import Setting

TEXT = """
[study]
subjects = 30
seed = 5
[[task]]
name = "{name}"
{more}
[task.space]
cutoff_hz = [11.1]
turn_rate_step_dps = [10.0]
turn_rate_min_dps = [10.0]
turn_rate_max_dps = [50.0]
[task.protocol]
dwell_s = 1.0
bracket_s = 3.0
set_points_c = [18.0, 36.0, 54.0, 75.0]
"""


def plan(folder: Path, name: str = "sit_to_stand", more: str = "", end: str = "") -> Path:
    path = folder / "study.toml"
    path.write_text(TEXT.format(name=name, more=more) + end)
    return path


# ---- a table of files and people


def captured(folder: Path, name: str, seed: int) -> None:
    """A sit-to-stand as a camera system would store it, 100 Hz."""
    task = draw_task("sit_to_stand", rng=np.random.default_rng(seed), rest_s=2.0)
    time = np.arange(round(task.duration_s * 100.0)) / 100.0
    poses = Reference(time=time, q_nb=task.at(time, 9.81).q_nb, position=task.position(time))
    folder.mkdir(exist_ok=True)
    write_reference(poses, folder / f"{name}.parquet")


ROWS = ("a1,anna,frail", "b1,ben,frail", "a2,anna,frail", "c1,carl,frail", "a3,anna,fit", "d1,dora,fit")


def with_table(folder: Path, rows: tuple[str, ...] = ROWS, more: str = "", head: str = "file,person,label") -> Path:
    """Captures beside a table that names them, and a plan with the table."""
    for k, row in enumerate(ROWS):
        captured(folder / "captures", row[:2], 20 + k)
    lines = [head, *(row.replace(",", ".parquet,", 1) for row in rows)]
    (folder / "captures" / "people.csv").write_text("\n".join(lines) + "\n")
    return plan(folder, "rising", end=f'[task.motion]\ntable = "captures/people.csv"\n{more}')


@pytest.mark.slow
def test_trials_of_one_person_in_a_table_are_one_subject_with_their_mean_error(tmp_path: Path) -> None:
    study = read_study(with_table(tmp_path))
    (task,) = study.tasks
    assert task.motion is not None
    assert (study.subjects, task.motion.people) == (4, 4)
    names = [[Path(trial.path).stem for trial in task.motion.of(k)] for k in range(4)]
    assert names == [["a1", "a2", "a3"], ["b1"], ["c1"], ["d1"]]
    unit = Unit(study=study, task=task, subject=0, setting=Setting(11.1))
    cases = [make_case(study, task, 0, Setting(11.1), trial=trial) for trial in range(3)]
    (group,) = alike(task, Setting(QUICKEST_HZ))
    each = [errors_with(unit, [case], group, {})[1] for case in cases]
    whole = run_unit(unit)
    show(
        "rms of a person's trials, and of the person, deg",
        ([np.degrees(one[0, 0]) for one in each], whole["error_rms_deg"]),
    )
    assert np.ptp([one[0, 0] for one in each]) > 0.0
    for column, name in enumerate(ERRORS):
        assert whole[name] == pytest.approx(np.degrees(np.mean([one[:, column] for one in each], axis=0)), rel=1e-12)
    first, second = (np.asarray(case.record.gyro)[:50] for case in cases[:2])
    assert np.abs(first - second).max() > 0.0  # noise of its own
    (surface,) = run_study(study, InProcess(), tmp_path / "runs")
    assert surface.error_rms_deg.shape == (4, 1)  # no person counts twice, neither here nor where one is left out
    assert surface.error_rms_deg[0, 0] == whole["error_rms_deg"][0]


@pytest.mark.parametrize(
    ("rows", "more", "head", "text"),
    [
        (ROWS, 'label = "old"\n', "file,person,label", r"people\.csv: wanted one of its labels frail, fit, got old"),
        (ROWS, 'label = "fit"\n', "file,person,label", r"wanted three people or more, got 2; record more"),
        (ROWS, "", "file,who,label", r"wanted file, person in each row, got no person in line 2; add it"),
        ((*ROWS, "e1,,fit"), "", "file,person,label", r"got no person in line 8; add it"),
        ((*ROWS, "a1,ben,fit"), "", "file,person,label", r"wanted each file once, got a1\.parquet again in line 8"),
        (
            (*ROWS, "e1,eve,fit"),
            "",
            "file,person,label",
            r"e1\.parquet: wanted a file of poses or markers, got No such",
        ),
        (
            ROWS,
            'file = "x.c3d"\n',
            "file,person,label",
            r"task\.motion: wanted a file, .* got file and table; name one",
        ),
        ((), "", "file,person", r"wanted three people or more, got 0"),
    ],
)
def test_tables_that_do_not_serve_are_refused(
    tmp_path: Path, rows: tuple[str, ...], more: str, head: str, text: str
) -> None:
    with pytest.raises(FileFormatError, match=text) as told:
        read_study(with_table(tmp_path, rows, more, head))
    assert "\n" not in str(told.value)


def test_a_label_without_a_table_and_a_table_that_is_not_there_are_refused(tmp_path: Path) -> None:
    alone = '[task.motion]\nfile = "a.c3d"\nlabel = "frail"\n'
    with pytest.raises(FileFormatError, match="got file and label; name one"):
        read_study(plan(tmp_path, "rising", end=alone))
    with pytest.raises(FileFormatError, match=r"none\.csv: wanted a table of recorded people, got .*No such file"):
        read_study(plan(tmp_path, "rising", end='[task.motion]\ntable = "none.csv"\n'))


# ---- categories of a lab's own

KNEE = """
[category.knee]
like = "elderly"
age_years = [50.0, 68.0, 85.0]
height_m = [1.5, 1.65, 1.8]
rise_s = [2.6, 0.5]
flexion_deg = [25.0, 6.0, 10.0, 40.0]
sway_deg = [[1.0, 0.2], [0.6, 0.1], [0.4, 0.1]]
"""


def test_a_task_is_performed_by_a_category_of_ones_own(tmp_path: Path) -> None:
    study = read_study(plan(tmp_path, more='category = "knee"', end=KNEE))
    (task,) = study.tasks
    assert (task.key, study.categories, study.known[-1]) == ("sit_to_stand-knee", ("knee",), "knee")
    person = subject_of(study, 0, "knee")
    assert isinstance(person.category, Category)
    assert person.category.label == "knee"
    assert person.category.rise_s == pytest.approx((2.6, 0.5, 1.35, 3.85))  # 2.5 standard deviations either way
    assert person.category.flexion_deg == (25.0, 6.0, 10.0, 40.0)
    assert person.category.typical_age_years == 68.0
    assert person.category.step_s == CATEGORIES["elderly"].step_s
    found = judge.cohort_of(study, "knee")
    assert (found.label, found.printed.age_years) == ("knee", (50.0, 68.0, 85.0))
    case = make_case(study, task, 0, Setting(11.1))
    known = make_case(study, replace(task, category="elderly"), 0, Setting(11.1))
    assert len(case.pitch) != len(known.pitch)
    again = with_categories(study, ["knee", "level_4"])  # as the command line names them
    assert [each.key for each in again.tasks] == ["sit_to_stand-knee", "sit_to_stand-level_4"]


def test_people_have_the_means_and_deviations_that_a_lab_states(tmp_path: Path) -> None:
    kind = read_study(plan(tmp_path, end=KNEE)).kind("knee")
    assert isinstance(kind, Category)
    people = [one for seed in range(40) for one in cohort("testing", rng=np.random.default_rng(seed), category=kind)]
    rng = np.random.default_rng(1)
    drawn = np.array([Performance(rng, one).number("sit_to_stand duration", *kind.rise_s) for one in people])
    show("durations of 1200 people, mean and standard deviation, s", (drawn.mean(), drawn.std()))
    # 3 standard errors; bounds at 2.5 deviations, and habits within 2, cut 8 % of the deviation
    assert drawn.mean() == pytest.approx(2.6, abs=3.0 * 0.5 / np.sqrt(1200.0))
    assert drawn.std() == pytest.approx(0.92 * 0.5, rel=0.06)


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("[2.6, 0.5]", "[2.6, -0.5]", r"rise_s: wanted least, mean and greatest that rise, above 0, got \[2\.6, -0\.5"),
        ("[2.6, 0.5]", "[2.6, 0.5, 3.0, 4.0]", r"rise_s: wanted least, mean and greatest that rise"),
        ("[2.6, 0.5]", "[1.0, 0.5]", r"rise_s: wanted .* got \[1\.0, 0\.5, -0\.25, 2\.25\]; state mean"),
        ("[2.6, 0.5]", "2.6", r"line 22: \[category\], knee, rise_s: wanted a valid array, got 2\.6"),
        ("rise_s", "rise", r"rise: wanted a known key.*nearest known key: rise_s"),
        ("[50.0, 68.0, 85.0]", "[68.0, 50.0, 85.0]", r"age_years: wanted least, mean and greatest that rise"),
        ('"elderly"', '"old"', r"category\.knee: wanted a name .* got knee like old; rename it"),
        ("category.knee", "category.young", r"category\.young: wanted a name .* other than level_1"),
    ],
)
def test_a_category_that_cannot_be_is_refused(tmp_path: Path, old: str, new: str, text: str) -> None:
    with pytest.raises(FileFormatError, match=text) as told:
        read_study(plan(tmp_path, end=KNEE.replace(old, new)))
    assert "\n" not in str(told.value)


def test_categories_of_tasks_that_do_not_serve_are_refused(tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match=r"wanted some of level_1, .*, knee, each once, got hip"):
        read_study(plan(tmp_path, more='category = "hip"', end=KNEE))
    both = '[task.motion]\nfile = "a.c3d"\n'
    with pytest.raises(FileFormatError, match="rising: wanted a category or a recorded motion, got both"):
        read_study(plan(tmp_path, "rising", more='category = "young"', end=both))


@pytest.mark.slow
def test_angles_that_no_duration_allows_end_with_the_bound(tmp_path: Path) -> None:
    study = read_study(plan(tmp_path, end=KNEE.replace("[2.6, 0.5]", "[0.2, 0.01]")))
    person = subject_of(study, 0, "knee")
    with pytest.raises(InputError, match="sit_to_stand, knee: wanted motions of 140 deg/s or less, got none in 1000"):
        draw_task("sit_to_stand", rng=np.random.default_rng(0), subject=person)


def test_the_notes_levels_grow_from_no_unbalance_to_major_unbalance() -> None:
    levels = [CATEGORIES[name] for name in ("level_1", "level_2", "level_3", "level_4")]
    assert all(one.age_years is None and one.height is None for one in levels)  # the note's Table 2
    for name in ("rise_s", "step_s"):
        assert np.all(np.diff([getattr(one, name)[0] for one in levels]) > 0.0)
    assert np.all(np.diff([one.flexion_deg[0] for one in levels]) < 0.0)
    assert np.all(np.diff([[row[0] for row in one.sway_deg] for one in levels], axis=0) > 0.0)
    middle = [0.5 * (a + b) for a, b in zip(levels[1].rise_s, levels[3].rise_s, strict=True)]
    assert levels[2].rise_s == pytest.approx(middle)
