"""Spaces: parameters that are listed in addition to the note's four are tried."""

import json
from dataclasses import replace
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from testkit.data import show
from testkit.pages import faults_of
from undrift.base.codec import slots_of
from undrift.cli.common import show as show_summary
from undrift.commands.study import Studied, study_json
from undrift.errors import FileFormatError, InputError
from undrift.programme import Protocol
from undrift.report.page import write_page
from undrift.sim.bench_errors import BenchErrors
from undrift.sim.device.effects import Nonlinearity
from undrift.sim.device.model import device_json
from undrift.sim.device.presets import preset
from undrift.study.case import make_case, run_unit, units_of
from undrift.study.judge import find_optimum
from undrift.study.outcome import judge_study
from undrift.study.plan import BESIDE, TABLE_1, Aim, SpaceEntry, Study, StudyTask, ends_of, note_study, read_study
from undrift.study.run import InProcess, count_runs, run_study
from undrift.study.space import HEADINGS, OF_NOTE, Setting, Space

DPS = np.pi / 180.0
BASE = Protocol(grid="paper", dwell_s=1.0, bracket_s=3.0, temperatures_c=(18.0, 36.0, 54.0, 75.0))
RATES = {"turn_rate_step": (10.0 * DPS,), "turn_rate_min": (10.0 * DPS,), "turn_rate_max": (50.0 * DPS, 90.0 * DPS)}
OWN = (
    ("gain", (20.0,)),
    ("quality", (2.0**-0.5,)),  # not the sampling rate: a list of it is simulated on a finer grid
    ("bits", (12.0,)),
    ("dwell_s", (1.0,)),
    ("bracket_s", (3.0,)),
    ("face_s", (6.0,)),
    ("faces", (6.0,)),
    ("poses", (1.0,)),
    ("set_points", (4.0,)),
    ("warmest_c", (BASE.temperatures_c[-1],)),
    ("soak_c_per_min", (0.1,)),
    ("order", (1.0,)),
    ("static_step_c", (0.5,)),
    ("dynamic_step_c", (3.0,)),
)


SET_POINTS_C = ((18.0, 54.0), (18.0, 36.0, 75.0))


def task_of(name: str = "sit_to_stand", base: Protocol = BASE, **space: Any) -> StudyTask:
    held = Space(**({"cutoff_hz": (11.1,)} | RATES | space))
    return StudyTask(name=name, space=held, base=base, places=SET_POINTS_C if "places" in held.names else ())


def study_of(task: StudyTask, **given: Any) -> Study:
    return Study(**({"name": "wide", "device": "enc03j_3031", "tasks": (task,), "subjects": 3} | given))


TWO = {  # values of each parameter that can be searched, two each
    "cutoff_hz": (5.0, 11.4),
    "turn_rate_step_dps": (10.0, 20.0),
    "turn_rate_min_dps": (10.0, 30.0),
    "turn_rate_max_dps": (50.0, 90.0),
    "gain": (10.0, 20.0),
    "quality": (0.6, 2.0),
    "sample_rate_hz": (50.0, 100.0),
    "bits": (10.0, 12.0),
    "dwell_s": (0.5, 1.0),
    "bracket_s": (2.0, 3.0),
    "face_s": (2.0, 6.0),
    "faces": (5.0, 6.0),
    "poses": (1.0, 5.0),
    "places": (1.0, 2.0),
    "set_points": (1.0, 4.0),
    "warmest_c": (45.0, 75.0),
    "soak_c_per_min": (0.1, 0.3),
    "order": (1.0, 2.0),
    "static_step_c": (0.5, 8.0),
    "dynamic_step_c": (3.0, 9.0),
}


# ---- what is tried


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    list(HEADINGS),
)
def test_a_study_of_any_parameter_comes_to_its_page_its_summary_and_its_lines(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    space: dict[str, Any] = {"turn_rate_max": (50.0 * DPS,)}
    if name.endswith("_dps"):
        space[name.removesuffix("_dps")] = tuple(value * DPS for value in TWO[name])
    else:
        space |= {name: TWO[name]} if name in OF_NOTE else {"further": ((name, TWO[name]),)}
    outcome = judge_study(study_of(task_of("step", **space)), InProcess(), tmp_path)
    write_page(tmp_path / "report.html", Studied(outcome=outcome, output=tmp_path).summary())
    text = (tmp_path / "report.html").read_text()
    assert faults_of(text) == ["provenance"]  # no command made it
    assert HEADINGS[name] in unescape(text)
    assert ("Poses of the accelerometers, 5: +z, +z 45 +x, +z 45 -x" in unescape(text)) == (name == "poses")
    assert [split.parameter for split in outcome.tasks[0].splits] == [name]
    (task,) = study_json(outcome)["tasks"]
    assert name in task["optimum"]
    assert [row["parameter"] for row in task["made_of"]] == [name]
    show_summary(Studied(outcome=outcome, output=tmp_path).summary(), details=True)
    assert HEADINGS[name].split(" (")[0] in capsys.readouterr().out


def test_every_list_of_a_plan_has_a_heading() -> None:
    assert list(HEADINGS) == [slot.name for slot in slots_of(SpaceEntry)] == list(TWO)


def test_a_list_of_the_own_value_changes_nothing_and_one_of_others_does() -> None:
    plain, listed = study_of(task_of()), study_of(task_of(further=OWN))
    (one, *_), (two, *_) = units_of(plain), units_of(listed)
    assert two.key.startswith(f"{one.key}-gain20-quality0.7")
    bare, same = run_unit(one), run_unit(two)
    for name, values in bare.items():
        np.testing.assert_array_equal(same[name], values)
    others = {"quality": 2.0, "dwell_s": 2.0, "bracket_s": 6.0, "face_s": 2.0, "faces": 5.0, "set_points": 3.0}
    others |= {"warmest_c": 60.0, "soak_c_per_min": 0.3, "order": 2.0, "sample_rate_hz": 200.0, "bits": 10.0}
    for name, value in ({"gain": 10.0} | others | {"static_step_c": 8.0, "dynamic_step_c": 30.0}).items():
        unit = units_of(study_of(task_of(further=((name, (value,)),))))[0]
        other = run_unit(unit)
        assert (other[name] == value).all()
        assert (other["error_rms_deg"] != bare["error_rms_deg"]).all(), name
        assert np.abs(other["error_rms_deg"] - bare["error_rms_deg"]).max() < 1.0, (
            name
        )  # deg: of the same unit and motion
        session = name in {
            "quality",
            "dwell_s",
            "bracket_s",
            "face_s",
            "faces",
            "set_points",
            "warmest_c",
            "soak_c_per_min",
        }
        assert (other["rig_minutes"] != bare["rig_minutes"]).all() == session


def test_candidates_of_one_unit_are_those_of_units_of_their_own() -> None:
    further = (
        ("dwell_s", (1.0, 2.0)),
        ("faces", (5.0, 6.0)),
        ("set_points", (1.0, 4.0)),
        ("dynamic_step_c", (3.0, 9.0)),
    )
    whole = units_of(study_of(task_of(further=further)))[0]
    runs, points = run_unit(whole), whole.task.space.points()
    assert len(points) == whole.task.space.count == 32
    for place in (0, 9, 31):
        only = replace(whole.task, space=whole.task.space.narrowed(points[place : place + 1]))
        alone = run_unit(replace(whole, task=only))
        assert {name: values[0] for name, values in alone.items()} == {name: v[place] for name, v in runs.items()}


def test_what_cannot_be_varied_is_refused() -> None:
    for further, wanted in (
        ((("faces", (7.0,)),), "wanted faces as whole numbers from 5 to 6, got 7"),
        ((("set_points", (2.5,)),), "wanted set_points as whole numbers from 1 to inf, got 2.5"),
        ((("quality", (0.4,)),), "wanted quality as numbers from 0.5 to 10, got 0.4"),
        ((("gain", ()),), "got none"),
        ((("faces", (6.0,)), ("gain", (20.0,))), "in this order"),
    ):
        with pytest.raises(InputError, match=wanted):
            task_of(further=further)
    with pytest.raises(InputError, match="wanted a device with an amplifier to vary its gain, got mpu6050"):
        study_of(task_of(further=(("gain", (20.0,)),)), device="mpu6050")
    with pytest.raises(InputError, match="wanted set_points_c whose number varies, got none"):
        study_of(task_of(base=replace(BASE, temperatures_c=()), further=(("set_points", (1.0, 3.0)),)))


def test_lists_of_a_file_arrive(tmp_path: Path) -> None:
    path = tmp_path / "study.toml"
    lists = "gain = [10.0, 20.0]\nquality = [0.58]\nfaces = [5, 6]\nset_points = [1, 5]\nstatic_step_c = [1.0]"
    rates = "turn_rate_step_dps = [10.0]\nturn_rate_min_dps = [10.0]\nturn_rate_max_dps = [50.0]"
    text = f'[[task]]\nname = "step"\n[task.space]\ncutoff_hz = [11.4]\n{rates}\n'
    path.write_text(text + lists)
    study = read_study(path)
    (task,) = study.tasks
    assert task.space.count == 8
    assert dict(task.space.further) == {
        "gain": (10.0, 20.0), "quality": (0.58,), "faces": (5.0, 6.0), "set_points": (1.0, 5.0), "static_step_c": (1.0,)
    }  # fmt: skip
    first, last = (task.protocol_of(task.space.points()[place]) for place in (0, -1))
    assert (len(first.faces), first.temperatures_c) == (5, ())
    assert (len(last.faces), last.temperatures_c) == (6, (18.0, 30.0, 45.0, 60.0, 75.0))
    assert [setting.gain for setting in task.space.settings()] == [10.0, 20.0]
    (ends,) = ends_of(study).tasks
    assert ends.space.further == task.space.further
    path.write_text(text)
    assert read_study(path).tasks[0].space.further == ()
    path.write_text(text + "faces = [4]")
    with pytest.raises(FileFormatError, match="wanted faces as whole numbers from 5 to 6, got 4"):
        read_study(path)


def test_the_presets_grids_reach_beyond_the_notes_values_on_both_sides() -> None:
    study = note_study()
    assert count_runs(study) == 58_320
    for task in study.tasks:
        row, space = TABLE_1[task.name], task.space
        note = (row.turn_rate_step_dps, row.turn_rate_min_dps, row.turn_rate_max_dps)
        grids = {tuple(round(v / DPS, 9) for v in grid) for grid in space.grids()}
        assert note in grids
        assert space.untried() == ()
        tried = np.array(space.rows())[:, 3:]
        assert all(set(tried[:, k]) == set(values) for k, values in enumerate(BESIDE.values()))
        assert min(space.cutoff_hz) < row.cutoff_hz < max(space.cutoff_hz)
        for place, values in enumerate((space.turn_rate_step, space.turn_rate_min, space.turn_rate_max)):
            dps = [round(v / DPS, 9) for v in values]
            own = dps.index(note[place])
            assert 0 < own < len(dps) - 1
            for other in (dps[own - 1], dps[own + 1]):
                alone = (*note[:place], other, *note[place + 1 :])
                below = place == 1 and other < note[1]  # the note's omega_m is its step: a lower one needs another step
                assert (alone in grids) != below, alone
        assert max(space.turn_rate_max) < preset("enc03j_3031").gyro.full_scale < 300.0 * DPS


# ---- planted in the device: the whole flow has to find it


@pytest.mark.slow
def test_a_gain_that_clips_and_one_with_few_codes_lose() -> None:
    # 20 takes 186 deg/s, 150 takes 25, which a sit-to-stand exceeds; a code of gain 1 is 1.8 deg/s, below which no noise dithers
    space = {"turn_rate_min": (5.0 * DPS,), "turn_rate_step": (5.0 * DPS,), "turn_rate_max": (20.0 * DPS,)}
    task = task_of(further=(("gain", (1.0, 20.0, 150.0)),), cutoff_hz=(20.0,), **space)
    study = study_of(task, subjects=6, bench=BenchErrors())
    gains = [make_case(study, task, 0, Setting(20.0, gain)).device.gyro for gain in (1.0, 150.0)]
    assert gains[0].full_scale > 1000.0 * DPS
    assert gains[1].full_scale < 60.0 * DPS
    errors = np.array([run_unit(unit)["error_rms_deg"][0] for unit in units_of(study)]).reshape(6, 3)
    few, middle, clipped = errors.mean(axis=0)
    show("gain 1, 20, 150: deg rms", few, f"{middle:.3f}, {clipped:.3f}")
    assert few > middle + 0.087  # the margin of the note's Figure 3
    assert clipped > middle + 0.087


@pytest.mark.slow
def test_a_bend_needs_fast_turns(tmp_path: Path) -> None:
    made = preset("enc03j_3031")
    quiet = dict.fromkeys(("white_noise", "instability", "random_walk", "warm_up", "hysteresis", "g_sensitivity"))
    bent = replace(made.gyro, nonlinearity=Nonlinearity(cubic=np.full(3, 0.05 / (150.0 * DPS) ** 2)), **quiet)
    accel = replace(made.accel, **quiet)
    worn = json.dumps(device_json(replace(made, gyro=bent, accel=accel)))
    task = task_of(turn_rate_max=(20.0 * DPS, 50.0 * DPS, 110.0 * DPS), cutoff_hz=(20.0,))
    study = study_of(task, subjects=20, worn=worn, bench=BenchErrors(), excursion_k=(0.0, 0.1), offset="none")
    (surface,) = run_study(study, InProcess(), tmp_path)
    found = find_optimum(surface, Aim(timing="offline", margin_deg=0.01))  # the delay at 20 Hz is alike in all
    effect = next(each for each in found.effects if each.name == "turn_rate_max_dps")
    show("omega_M 20, 50, 110: deg rms", effect.means_deg[0], f"{effect.means_deg[1:]}")
    assert surface.turn_rate_max_dps[found.best] == pytest.approx(110.0)
    assert effect.means_deg[0] > effect.means_deg[2] + 0.01
    assert effect.judged is not None
    assert effect.judged.verdict == "better"
    assert effect.judged.p_better < 0.05
