"""Sections on real recordings and rivals: agreement told, what is not there named, no figure that is not one."""

from dataclasses import fields

import numpy as np

from undrift.commands.study_figures import real_sections
from undrift.commands.study_sections import design_sections
from undrift.findings import finding
from undrift.study.claims import rival_sections
from undrift.study.judge import cohort_of, other_study
from undrift.study.outcome import StudyOutcome
from undrift.study.plan import note_study
from undrift.study.real import CohortComparison, RealData, RealErrors, RealOutcome, Worn, agreement_of, judge_real
from undrift.study.rivals import RivalRow, Spread
from undrift.validation.trial import Figures

NAMES = [field.name for field in fields(Figures)]
NONE = Spread(median=np.nan, least=np.nan, greatest=np.nan)


def test_agreement_of_real_trials_is_told_with_limits_and_icc() -> None:
    pairwise = agreement_of("largest lean, deg", np.array([30.0, 40.0, 50.0, 60.0]), np.array([30.5, 40.0, 50.5, 60.0]))
    assert pairwise is not None
    level = RealErrors(
        level="rest",
        rounding="undone",
        trials=(),
        median=Figures(**dict.fromkeys(NAMES, np.nan) | {"rmse_total_deg": 1.25, "rmse_inclination_deg": 0.5}),
        agreement=pairwise,
    )
    row = CohortComparison(
        trial="a", task="squat", measure="lean", unit="deg", real=np.nan, low=1.0, median=2.0, high=3.0, note="no squat"
    )
    real = RealOutcome(
        errors=(level,),
        motions=(row,),
        sways=(),
        worn=Worn(rows=(), agreement=(("full", pairwise),)),
        lacks=(finding("study.part_failed", "info", part="x", reason="none"),),
    )
    trials, captured, worn, lacks = (one for one in real_sections(real) if one.text or one.findings)
    # by hand: differences -0.5, 0, -0.5, 0: bias -0.25, standard deviation 0.2887, limits -0.82 and 0.32
    told = "largest lean, deg: bias -0.25, limits of agreement -0.82 to 0.32 (4 trials); ICC(2,1) 0.9"
    assert any(told in text for text in trials.text)
    assert any(text.startswith("full: ") and told in text for text in worn.text)
    assert trials.rows == (("median", "rest", "undone", "1.25", "0.50", "–", "–"),)
    assert captured.rows[0][3:] == ("–", "2.00", "1.00 to 3.00", "")
    assert "a: no squat." in captured.text
    assert [item.text for item in lacks.findings] == ["x: none"]


def test_nothing_given_is_told_as_not_there() -> None:
    found = judge_real(RealData(devices=(), captures=(), stances=()), note_study(quick=True, subjects=3))
    assert found.worn is None
    assert "stances: none was given" in [lack.text for lack in found.lacks]
    assert real_sections(None) == ()
    assert design_sections(()) == ()


def test_a_method_whose_units_were_all_refused_has_no_figure() -> None:
    row = RivalRow(
        method="data_sheet",
        task="sit_to_stand",
        minutes=0.0,
        observable=(),
        error_rms_deg=NONE,
        error_max_deg=NONE,
        change_max_deg=NONE,
        units=5,
        refused=5,
        notes=("nothing was recorded",),
    )
    study = note_study(quick=True, subjects=3)
    outcome = StudyOutcome(
        study=study,
        runs=0,
        tasks=(),
        cohorts=(cohort_of(study), cohort_of(other_study(study))),
        figure3=None,
        figure3_missing=None,
        rivals=(row,),
    )
    table, *_, words = rival_sections(outcome)
    assert table.rows == (("sit to stand", "data sheet", "nothing", "0.0", "no unit", "no unit", "no unit", "5 of 5"),)
    assert words.rows == (("data sheet", "nothing was recorded"),)
