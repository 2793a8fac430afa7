"""Claims of the note judged on planted outcomes: each verdict where it was planted, and what is lacking is named."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast, get_args

import numpy as np
import pytest

from testkit.surfaces import errors
from undrift.arrays import FloatArray
from undrift.study.claims import CLAIMS, ClaimRow, claims_of, claims_section, rival_sections
from undrift.study.figure3 import COMPARED, DrawnRow
from undrift.study.judge import cohort_of, find_optimum, other_study
from undrift.study.outcome import StudyOutcome
from undrift.study.plan import Timing, note_study
from undrift.study.rivals import Method, RivalRow, Spread, TriadName, TriadRow, Worth
from undrift.study.run import TaskSurface
from undrift.study.statistics import compare_pairs, decide

SUBJECTS, MARGIN = 12, 0.15
STUDY = note_study(quick=True, subjects=SUBJECTS)
NONE = Spread(0.0, 0.0, 0.0)
EMPTY = StudyOutcome(
    study=STUDY,
    runs=0,
    tasks=(),
    cohorts=(cohort_of(STUDY), cohort_of(other_study(STUDY))),
    figure3=None,
    figure3_missing=None,
)


def judged(outcome: StudyOutcome) -> dict[str, ClaimRow]:
    return {row.claim: row for row in claims_of(outcome)}


def scattered(mean: float, sd: float, seed: int) -> FloatArray:
    """Return values of exactly this mean and standard deviation."""
    drawn = np.random.default_rng(seed).normal(size=SUBJECTS)
    return mean + sd * (drawn - drawn.mean()) / drawn.std(ddof=1)


def triad_row(triad: TriadName, method: Method, figure: str, apart: FloatArray) -> TriadRow:
    """Return a method that errs by ``apart`` more than the rate table."""
    (pair,) = compare_pairs(np.stack([1.0 + apart, np.ones(SUBJECTS)], axis=1))
    decision = decide(pair, SUBJECTS, of=0, margin=MARGIN, tests=7)
    return TriadRow(
        triad=triad,
        method=method,
        minutes=8.0,
        calibrated=SUBJECTS,
        units=SUBJECTS,
        scale_percent=NONE,
        cross_axis_percent=NONE,
        offset=NONE,
        worth=(Worth(figure=figure, error_deg=NONE, decision=decision),),
    )


def of_rivals(*rows: TriadRow) -> dict[str, ClaimRow]:
    return judged(replace(EMPTY, rival_triads=rows))


@pytest.mark.parametrize(
    ("apart", "trolley", "piston", "plane"),
    [
        (scattered(1.0, 0.1, 1), "holds", "does not hold", "holds"),  # worse than six faces
        (scattered(0.02, 0.02, 2), "does not hold", "holds", "holds"),  # equivalent
        (scattered(-1.0, 0.1, 3), "does not hold", "does not hold", "does not hold"),  # better
        (scattered(0.15, 0.5, 4), "not decidable", "not decidable", "not decidable"),
    ],
)
def test_claims_on_accelerometers_follow_the_verdict_against_six_faces(
    apart: FloatArray, trolley: str, piston: str, plane: str
) -> None:
    rows = of_rivals(
        *(
            triad_row("accel", name, "tilt", apart)
            for name in cast("tuple[Method, ...]", ("trolley", "piston", "inclined_plane"))
        )
    )
    assert rows["A trolley is not accurate"].verdict == trolley
    assert rows["A piston calibrates accelerometers as six faces do"].verdict == piston
    held = rows["An inclined plane calibrates accelerometers no better than six faces"]
    assert held.verdict == plane
    (evidence,) = held.evidence
    assert evidence.value_deg == pytest.approx(apart.mean())
    assert evidence.interval_deg[0] < apart.mean() < evidence.interval_deg[1]
    assert "margin 0.15 deg" in evidence.test
    assert "12 units" in evidence.test


def test_a_method_is_unsuitable_by_one_task_and_sufficient_by_all() -> None:
    worse, alike, open_ = scattered(1.0, 0.1, 1), scattered(0.02, 0.02, 2), scattered(0.15, 0.5, 4)
    plane = "An inclined plane does not suit a device with gyroscopes"
    arm = "A robot arm is sufficiently accurate"

    def both(first: FloatArray, second: FloatArray) -> tuple[str, str]:
        rows = of_rivals(
            triad_row("gyro", "inclined_plane", "sit_to_stand", first),
            triad_row("gyro", "inclined_plane", "posturography", second),
            triad_row("gyro", "robot_arm", "sit_to_stand", first),
            triad_row("accel", "robot_arm", "tilt", second),
        )
        return rows[plane].verdict, rows[arm].verdict

    assert both(worse, alike) == ("holds", "does not hold")
    assert both(alike, alike) == ("does not hold", "holds")
    assert both(alike, open_) == ("not decidable", "not decidable")
    assert both(worse, open_) == ("holds", "does not hold")


def drawn(within: int = SUBJECTS, correlation: float = 1.0, **largest: FloatArray) -> dict[str, ClaimRow]:
    rows = tuple(
        DrawnRow(
            correction=name,
            units=SUBJECTS,
            lower_deg=0.0,
            median_deg=0.0,
            upper_deg=0.0,
            simulated_deg=(0.0, 0.0, 0.0),
            apart_deg=(0.0, 0.0, 0.0),
            within=within,
            correlation=correlation,
            correlation_interval=(correlation - 0.05, min(correlation + 0.05, 1.0)),
            largest_correlation=1.0,
            largest_interval=(1.0, 1.0),
            largest_deg=tuple(largest.get(name, np.zeros(SUBJECTS))),
        )
        for name in COMPARED
    )
    return judged(replace(EMPTY, figure3_drawn=rows))


def test_what_the_tables_take_off_is_judged_over_the_drawn_units() -> None:
    improves, decrease = (
        "Compensation of the drift significantly improves the accuracy",
        "It decreases the error by more than 3.2 deg",
    )
    much = drawn(none=scattered(5.0, 0.5, 1), static=scattered(0.5, 0.3, 2), full=scattered(0.1, 0.02, 3))
    assert (much[improves].verdict, much[decrease].verdict) == ("holds", "holds")
    assert much[decrease].evidence[0].value_deg == pytest.approx(4.9)
    little = drawn(none=scattered(0.12, 0.02, 1), static=scattered(0.11, 0.02, 2), full=scattered(0.1, 0.02, 3))
    assert (little[improves].verdict, little[decrease].verdict) == ("does not hold", "does not hold")
    unsure = drawn(none=scattered(3.4, 2.0, 1), full=scattered(0.1, 0.02, 3))
    assert (unsure[improves].verdict, unsure[decrease].verdict) == ("holds", "not decidable")
    assert much["The dynamic tables take off more than the static ones"].verdict == "holds"


@pytest.mark.parametrize(
    ("within", "correlation", "verdict"),
    [(SUBJECTS, 0.9, "holds"), (SUBJECTS // 2, 0.72, "not decidable"), (0, 0.3, "does not hold")],
)
def test_simulated_and_actual_are_judged_over_the_drawn_units(within: int, correlation: float, verdict: str) -> None:
    rows = drawn(within, correlation)
    assert rows["The errors of simulated and actual device differ by 0.15 deg at most"].verdict == verdict
    assert rows["Simulated and actual observations are highly correlated"].verdict == verdict
    assert "drawn units" in str(judged(EMPTY)["Simulated and actual observations are highly correlated"].lacks)


def task_of(name: str, error: FloatArray, cutoff_hz: tuple[float, ...] = (5.0, 10.0, 20.0)) -> Any:
    """Return what the claims read of a task: errors (S, P) of protocols with one set of rates."""
    count = len(cutoff_hz)
    surface = TaskSurface(
        task=name,
        cutoff_hz=np.array(cutoff_hz),
        turn_rate_step_dps=np.full(count, 5.0),
        turn_rate_min_dps=np.full(count, 5.0),
        turn_rate_max_dps=np.full(count, 90.0),
        rig_minutes=np.full(count, 60.0),
        **errors(error),
    )
    return SimpleNamespace(surface=surface, optimum=find_optimum(surface), note=None)


def errors_of(*means: float, sd: float = 0.02) -> FloatArray:
    return np.stack([scattered(mean, sd, 10 + k) for k, mean in enumerate(means)], axis=1)


@pytest.mark.parametrize(
    ("sit", "stance", "verdict"),
    [(1.0, 0.1, "holds"), (0.1, 1.0, "does not hold"), (0.1, 0.11, "does not hold"), (0.3, 0.2, "not decidable")],
)
def test_the_task_with_the_largest_errors_is_asked_subject_by_subject(sit: float, stance: float, verdict: str) -> None:
    sd = 0.3 if verdict == "not decidable" else 0.02
    first = task_of("sit_to_stand", errors_of(5.0, sit, 5.0, sd=sd))
    second = task_of("posturography", errors_of(5.0, stance, 5.0))
    row = judged(replace(EMPTY, tasks=(first, second)))["The largest errors are those of the sit-to-stand"]
    assert row.verdict == verdict
    (evidence,) = row.evidence
    assert evidence.value_deg == pytest.approx(2.0 * (sit - stance))  # of the largest errors, at the optimum


def test_the_parameter_with_the_greatest_effect_is_shown_whichever_way_it_goes() -> None:
    error = errors_of(2.0, 2.01, 0.5, 0.52)
    surface = TaskSurface(
        task="step",
        cutoff_hz=np.array([5.0, 5.0, 20.0, 20.0]),
        turn_rate_step_dps=np.full(4, 5.0),
        turn_rate_min_dps=np.full(4, 5.0),
        turn_rate_max_dps=np.array([90.0, 60.0, 90.0, 60.0]),
        rig_minutes=np.full(4, 60.0),
        **errors(error),
    )
    task = cast("Any", SimpleNamespace(surface=surface, optimum=find_optimum(surface), note=None))
    row = judged(replace(EMPTY, tasks=(task,)))["The parameters of the calibration change the error in each task"]
    (evidence,) = row.evidence
    assert row.verdict == "holds"
    assert "cut-off" in evidence.what
    assert evidence.value_deg == pytest.approx(1.5)


def test_the_largest_errors_are_those_of_the_studys_timing() -> None:
    late, early = task_of("sit_to_stand", errors_of(1.0, 1.1, 1.2)), task_of("step", errors_of(0.1, 0.2, 0.3))
    none = 0.0 * late.surface.error_rms_deg
    late.surface = replace(late.surface, error_offline_max_deg=none)
    claim = "The largest errors are those of the sit-to-stand"
    both = [
        replace(EMPTY, study=replace(EMPTY.study, timing=timing), tasks=(late, early)) for timing in get_args(Timing)
    ]
    assert [judged(each)[claim].verdict for each in both] == ["holds", "does not hold"]


def test_an_optimum_depends_on_the_task_where_another_task_s_cut_off_is_worse() -> None:
    claim, matter = "The optimum depends on the task", "The parameters of the calibration change the error in each task"
    quick = task_of("sit_to_stand", errors_of(2.0, 1.0, 0.1))
    slow = task_of("posturography", errors_of(0.1, 1.0, 2.0))
    either = judged(replace(EMPTY, tasks=(quick, slow)))
    assert either[claim].verdict == "holds"
    assert either[matter].verdict == "holds"
    assert [each.value_deg for each in either[claim].evidence] == pytest.approx([1.9, 1.9])
    flat = task_of("posturography", errors_of(0.10, 0.105, 0.11))
    even = task_of("sit_to_stand", errors_of(0.11, 0.105, 0.10))
    neither = judged(replace(EMPTY, tasks=(even, flat)))
    assert (neither[claim].verdict, neither[matter].verdict) == ("does not hold", "does not hold")
    same = judged(replace(EMPTY, tasks=(quick, task_of("step", errors_of(2.0, 1.0, 0.1)))))[claim]
    assert same.lacks is not None
    assert "different cut-offs" in same.lacks.text


def test_what_a_study_does_not_have_is_named_and_decides_nothing() -> None:
    rows = claims_of(EMPTY)
    assert len(rows) == len(CLAIMS) == len({row.claim for row in rows})
    for row in rows:
        assert row.verdict == "not decidable"
        assert row.lacks is not None
        assert row.lacks.text


def test_the_page_has_both_tables_and_a_row_for_each_comparison_of_a_claim() -> None:
    triads = (
        triad_row("accel", "trolley", "tilt", scattered(1.0, 0.1, 1)),
        triad_row("gyro", "robot_arm", "sit_to_stand", scattered(0.02, 0.02, 2)),
    )
    rival = RivalRow(
        method="trolley",
        task="sit_to_stand",
        minutes=8.0,
        observable=("accel",),
        error_rms_deg=NONE,
        error_max_deg=NONE,
        change_max_deg=NONE,
        units=SUBJECTS,
        refused=0,
        notes=(),
    )
    outcome = replace(EMPTY, rivals=(rival,), rival_triads=triads)
    _, accel, gyro, _ = rival_sections(outcome)
    assert (accel.title, gyro.title) == ("Accelerometers alone", "Gyroscopes alone")
    assert accel.rows[0][-1].startswith("worse: -1.000 [")
    assert gyro.columns[-1] == "change of pitch, sit to stand: verdict"
    assert gyro.rows[0][-1].startswith("equivalent: -0.020 [")
    section = claims_section(outcome)
    (trolley,) = (row for row in section.rows if row[0] == "A trolley is not accurate")
    assert trolley[3] == "holds"
    assert trolley[5].startswith("1.000 [0.9")
    assert len(section.rows) == len(CLAIMS)
