"""Successive halving: a planted optimum is found with a third of the runs; the same unit machinery, kept and gone on with."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from testkit.data import show
from testkit.surfaces import candidates, errors
from undrift.errors import NotObservable
from undrift.rig.programme import Protocol
from undrift.study import search
from undrift.study.case import Unit
from undrift.study.plan import Space, Study, StudyTask
from undrift.study.run import InProcess
from undrift.study.search import TaskSearch

DPS = np.pi / 180.0
TASK = StudyTask(
    name="step",
    space=Space(
        cutoff_hz=(5.0, 7.0, 9.0, 11.4, 20.0),
        turn_rate_step=(3.0 * DPS, 6.0 * DPS),
        turn_rate_min=(3.0 * DPS, 9.0 * DPS),
        turn_rate_max=(15.0 * DPS, 21.0 * DPS, 27.0 * DPS, 33.0 * DPS),
    ),
    base=Protocol(grid="paper", dwell_s=1.0, bracket_s=3.0, temperatures_c=(18.0, 36.0, 54.0, 75.0)),
)
STUDY = Study(name="wide", device="enc03j_3031", tasks=(TASK,), subjects=24)
BEST = (9.0, 6.0, 9.0, 27.0)


def planted(unit: Unit) -> dict[str, np.ndarray]:
    """Errors with a known best protocol, and noise that would fool a look at one subject."""
    table = (
        np.array(
            [
                (p.turn_rate_step, p.turn_rate_min, p.turn_rate_max)
                for p in candidates(unit.task, unit.setting.cutoff_hz)
            ]
        )
        / DPS
    )
    rng = np.random.default_rng([unit.subject, round(10 * unit.setting.cutoff_hz)])
    cost = abs(unit.setting.cutoff_hz - BEST[0]) / 5.0 + np.abs(table - BEST[1:]).sum(axis=1) / 15.0
    error = (
        0.2 + 0.2 * cost + rng.normal(0.0, 0.08, len(table)) + np.random.default_rng(unit.subject).normal(0.0, 0.3) ** 2
    )
    return {
        "cutoff_hz": np.full(len(table), unit.setting.cutoff_hz),
        "turn_rate_step_dps": table[:, 0],
        "turn_rate_min_dps": table[:, 1],
        "turn_rate_max_dps": table[:, 2],
        "rig_minutes": np.full(len(table), 100.0),
    } | errors(error)


class Planted(InProcess):
    """Runs the planted errors in place of simulations, and counts."""

    done = 0

    def run(self, work: Any, units: Sequence[Any]) -> Iterator[tuple[int, Any]]:
        for place, of_subject in enumerate(units):
            Planted.done += len(of_subject)
            yield place, [planted(unit) for unit in of_subject]


class Fails(InProcess):
    """Every device is left uncalibrated."""

    def run(self, work: Any, units: Sequence[Any]) -> Iterator[tuple[int, Any]]:
        for place, of_subject in enumerate(units):
            runs = [planted(unit) for unit in of_subject]
            for each in runs:
                each["error_rms_deg"][:] = np.nan
            yield place, runs


def test_a_planted_optimum_is_found_with_a_third_of_the_runs(tmp_path: Path) -> None:
    found = TaskSearch(STUDY, TASK, Planted(), tmp_path).halve()
    best = TASK.protocol_of(found.points[found.best])
    assert best.cutoff_hz == BEST[0]
    assert np.array([best.turn_rate_step, best.turn_rate_min, best.turn_rate_max]) / DPS == pytest.approx(BEST[1:])
    show("runs over those of the full grid", found.runs / found.runs_of_grid, "1/3")
    assert found.runs <= found.runs_of_grid / 3
    sizes = [len(each.candidates) for each in found.rounds]
    assert sizes[0] == len(found.points)
    assert sizes == sorted(sizes, reverse=True)
    assert [each.subjects for each in found.rounds][-1] == STUDY.subjects


def test_what_is_finished_is_not_done_again(tmp_path: Path) -> None:
    one = TaskSearch(STUDY, TASK, Planted(), tmp_path).halve()
    before = Planted.done
    two = TaskSearch(STUDY, TASK, Planted(), tmp_path).halve()
    assert Planted.done == before
    assert two.best == one.best


def test_real_runs_halve_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    study = Study(name="few", device="enc03j_3031", tasks=(TASK,), subjects=3)
    narrow = StudyTask(
        name="step",
        space=Space(
            cutoff_hz=(11.4,),
            turn_rate_step=(6.0 * DPS,),
            turn_rate_min=(3.0 * DPS,),
            turn_rate_max=(21.0 * DPS, 27.0 * DPS, 33.0 * DPS),
        ),
        base=TASK.base,
    )
    monkeypatch.setattr(search, "FIRST_SUBJECTS", 1)
    monkeypatch.setattr(search, "LEAST", 1)
    found = TaskSearch(study, narrow, InProcess(), tmp_path).halve()
    assert [len(each.candidates) for each in found.rounds] == [3, 2, 1]
    assert found.runs == 3 + 2 + 1
    assert np.isfinite(found.rounds[-1].mean_deg).all()


def test_nothing_that_calibrates_is_said(tmp_path: Path) -> None:
    with pytest.raises(NotObservable, match="wanted a protocol of step that calibrates every device, got none"):
        TaskSearch(STUDY, TASK, Fails(), tmp_path).halve()
