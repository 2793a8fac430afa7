"""Outcome and page of a study: the note's row judged by what was computed, the other cohort, and every table and picture."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from testkit.surfaces import errors
from undrift.commands.study import Studied
from undrift.findings import finding
from undrift.report.page import write_page
from undrift.study.case import device_of
from undrift.study.judge import compare_with_note, find_optimum, other_study
from undrift.study.outcome import TOO_LONG, StudyOutcome, _too_long, judge_study
from undrift.study.plan import TABLE_1, Space, ends_of, note_study
from undrift.study.run import InProcess, TaskSurface

pytestmark = pytest.mark.usefixtures("computed_once")

ROW = TABLE_1["sit_to_stand"]


@pytest.fixture(scope="module")
def outcome(tmp_path_factory: pytest.TempPathFactory) -> StudyOutcome:
    study = note_study(quick=True, subjects=12)
    return judge_study(replace(study, tasks=study.tasks[:2]), InProcess(), tmp_path_factory.mktemp("study"))


def surface(error: np.ndarray) -> TaskSurface:
    """Four protocols: the note's, and three of which one parameter differs."""
    return TaskSurface(
        task="sit_to_stand",
        cutoff_hz=np.array([11.1, 5.0, 11.1, 5.0]),
        turn_rate_step_dps=np.full(4, 5.0),
        turn_rate_min_dps=np.full(4, 5.0),
        turn_rate_max_dps=np.array([90.0, 90.0, 60.0, 60.0]),
        rig_minutes=np.array([200.0, 200.0, 190.0, 190.0]),
        **errors(error),
    )


def noisy(means: list[float], sd: float = 0.02) -> np.ndarray:
    rng = np.random.default_rng(1)
    return np.array(means) + rng.normal(0.0, sd, (30, 4)) + rng.normal(0.0, 0.1, (30, 1))


def test_the_note_is_as_good_where_its_protocol_is_shown_to_be_and_agrees_where_its_values_are() -> None:
    held = surface(noisy([0.3, 0.3, 0.3, 0.3]))
    optimum = find_optimum(held)
    found = compare_with_note(held, optimum, ROW)
    assert (found.finding.code, found.finding.values["subjects"]) == ("study.note_as_good", 30)
    assert found.verdict == "not decidable"  # nothing above its cut-off was tried
    assert optimum.equivalent.all()
    assert optimum.deciding == ()
    held = surface(noisy([0.301, 0.3, 0.6, 0.6]))
    optimum = find_optimum(held)
    assert (optimum.deciding, optimum.flat) == (("turn_rate_max_dps",), False)  # half of the protocols are as good
    held = surface(noisy([0.3, 0.6, 0.6, 0.6]))
    found = compare_with_note(held, find_optimum(held), ROW)
    assert (found.finding.code, found.place) == ("study.note_is_optimum", 0)


def test_the_note_is_contradicted_for_the_parameter_that_makes_the_difference() -> None:
    held = surface(noisy([0.5, 0.48, 0.3, 0.28]))
    found = compare_with_note(held, find_optimum(held), ROW)
    assert found.verdict == "contradicted"
    assert found.difference_deg == pytest.approx(0.22, abs=0.02)  # 0.02 / sqrt(30) of each mean, a few sigma
    assert (found.finding.code, found.finding.level) == ("study.note_worse_by_one", "warn")
    assert re.search(r"omega_M 60 in place of 90 deg/s alone removes 0\.\d+ deg", found.finding.text)
    assert found.finding.values["gain_deg"] == pytest.approx(0.2, abs=0.02)


def test_a_row_that_was_not_tried_is_not_judged() -> None:
    held = surface(noisy([0.3, 0.3, 0.3, 0.3]))
    found = compare_with_note(held, find_optimum(held), TABLE_1["step"])
    assert (found.verdict, found.place, found.finding.code) == ("not tried", None, "study.note_not_tried")
    failed = noisy([0.3, 0.3, 0.3, 0.3])
    failed[3, 0] = np.nan
    found = compare_with_note(surface(failed), find_optimum(surface(failed)), ROW)
    assert (found.verdict, found.finding.code) == ("not tried", "study.note_uncalibrated")


@pytest.mark.slow
def test_the_other_cohort_shares_nothing_with_the_one_that_chose(outcome: StudyOutcome) -> None:
    other = other_study(outcome.study)
    assert other.group == "testing"
    one, two = device_of(outcome.study, 0), device_of(other, 0)
    assert (one.gyro.offset.constant != two.gyro.offset.constant).all()
    assert other_study(other).group == "simulation"
    for task in outcome.tasks:
        for tested in task.tested:
            assert tested.subjects == 12
            assert tested.failed == 0
            assert tested.interval_rms_deg[0] < tested.error_rms_deg < tested.interval_rms_deg[1]
            assert tested.error_rms_deg < tested.error_max_deg


@pytest.mark.slow
def test_the_page_holds_every_table_and_picture(outcome: StudyOutcome, tmp_path: Path) -> None:
    write_page(tmp_path / "report.html", Studied(outcome=outcome, output=tmp_path).summary())
    text = (tmp_path / "report.html").read_text()
    for wanted in (
        "Table 1: optimised parameters",
        "Against the note&#39;s Table 1",
        "The note&#39;s values beside the next ones",
        "sit to stand: the optimum&#39;s values against the others",
        "On the other cohort",
        "Table 2: cohorts",
        "sit to stand: error surface",
        "step: what each parameter does",
        "sit to stand: what the error is made of",
        "real time: rms, largest, end (deg)",
        "offline: rms, largest, end (deg)",
        "Above offline, below real time.",
        "the root-mean-square error of the sagittal pitch is minimised, offline",
        "<strong>What the error is made of</strong>: ",
        "printed 111.4 Hz; lies between 11.1 and 11.5",
        "p of Mauchly",
        "Figure 3: sit-to-stand, simulated and actual device",
        "<strong>Other ways to calibrate</strong>: not asked for",
    ):
        assert wanted in text, wanted
    assert (
        text.count("<svg") == 4 * len(outcome.tasks) + 4
    )  # the surface in both timings; Figures 1 to 3; a front opens the page
    assert ">nan<" not in text
    assert text.count("EMBC 2007") == 1  # what "the note" is
    assert "0.048, its own" in text
    without = replace(outcome, figure3=None, figure3_missing=finding("study.no_sit_to_stand", "info"))
    write_page(tmp_path / "b.html", Studied(outcome=without, output=tmp_path).summary())
    assert "no sit-to-stand" not in (tmp_path / "b.html").read_text()  # nor does such a study speak of it


def test_the_ends_of_a_study_are_a_first_look() -> None:
    whole = note_study()
    ends = ends_of(whole)
    for task in ends.tasks:
        count = task.space.count
        assert 2 <= count <= 16
        assert len(task.space.cutoff_hz) == 2


def test_values_without_a_protocol_are_named_and_so_are_those_whose_sessions_are_too_long() -> None:
    space = Space(
        cutoff_hz=(5.0,),
        turn_rate_step=(0.1, 0.3),
        turn_rate_min=(0.1, 0.25, 0.9),
        turn_rate_max=(0.5, 0.6),
    )
    told = [(row.parameter, row.value, row.reason) for row in space.untried()]
    assert told == [
        ("turn_rate_step", 0.3, "divides no span from an omega_m to an omega_M"),
        ("turn_rate_min", 0.25, "no step divides a span that it ends"),
        ("turn_rate_min", 0.9, "not below any omega_M"),
    ]
    assert replace(space, only=((0.1, 0.1, 0.5),)).untried() == ()
    held = surface(noisy([0.5, 0.5, 0.5, 0.5]))
    assert _too_long(note_study(), held) == ()
    (row,) = _too_long(replace(note_study(), rig_minutes_max=195.0), held)
    assert (row.parameter, row.value, row.reason) == ("turn_rate_max", pytest.approx(np.pi / 2.0), TOO_LONG)
