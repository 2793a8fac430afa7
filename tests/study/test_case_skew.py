"""A skew mounting in a study: its minutes, its accuracy beside the plain session, what it needs, the file for the rate table."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.data import show
from undrift.rig.programme import Protocol, programme_of
from undrift.sim.bench_errors import BenchErrors
from undrift.sim.table_sessions import RATE, ROOM_TEMP_C, SKEW
from undrift.study.case import Unit, run_unit, session_of
from undrift.study.plan import Study, StudyTask, note_study
from undrift.study.space import Setting, Space

DPS = np.pi / 180.0
SPACE = Space(
    cutoff_hz=(45.0,),
    turn_rate_step=(10.0 * DPS,),
    turn_rate_min=(10.0 * DPS,),
    turn_rate_max=(90.0 * DPS,),
    further=(("set_points", (1.0, 3.0)), ("mounting", (1.0, 2.0))),
)
TASK = StudyTask(
    name="sit_to_stand", space=SPACE, base=Protocol(grid="paper", dwell_s=1.0, temperatures_c=(18.0, 40.0, 60.0))
)
STUDY = Study(name="skew", device="enc03j_3031", tasks=(TASK,), subjects=12)
ROOM, PLAIN, SKEWED = 0, 2, 3  # places of the protocols; of the room's the mounting does not matter


def test_the_session_turns_each_axis_at_room_temperature_and_one_skew_axis_at_the_set_points() -> None:
    protocol = TASK.protocol_of(SPACE.points()[SKEWED])
    assert (protocol.heated_axis, protocol.faces_at) == ("xyz", "room")
    assert TASK.protocol_of(SPACE.points()[1]).heated_axis is None
    sessions = session_of(protocol)
    turning = sessions.kind == RATE
    assert set(sessions.set_c[turning & (sessions.axis < SKEW)]) == {ROOM_TEMP_C}
    assert set(sessions.set_c[turning & (sessions.axis == SKEW)]) == {ROOM_TEMP_C, 18.0, 40.0, 60.0}
    assert sessions.length_s[0] == pytest.approx(programme_of(protocol).duration_s, abs=1e-6)


@pytest.mark.slow
def test_it_costs_a_third_of_the_minutes_and_errs_as_little() -> None:
    runs = [run_unit(Unit(study=STUDY, task=TASK, subject=k, setting=Setting(45.0))) for k in range(STUDY.subjects)]
    minutes, error = runs[0]["rig_minutes"], np.array([run["error_rms_deg"] for run in runs])
    more = error[:, SKEWED] - error[:, PLAIN]
    sem = more.std(ddof=1) / np.sqrt(len(more))
    show("min, skew and plain", minutes[SKEWED], minutes[PLAIN])
    show("error, deg rms, skew and plain", error[:, SKEWED].mean(), error[:, PLAIN].mean())
    show("skew less plain, deg, and its standard error", more.mean(), sem)
    assert minutes[SKEWED] < 0.4 * minutes[PLAIN]
    assert more.mean() + 2.0 * sem < 0.03
    assert error[:, PLAIN].mean() < error[:, ROOM].mean() - 0.1  # the set-points matter
    np.testing.assert_array_equal(error[:, 0], error[:, 1])


def test_without_errors_of_the_bench_the_skew_axis_shows_the_scale_at_the_set_points() -> None:
    ideal = replace(STUDY, bench=BenchErrors(), chain_sd=0.0)
    for without in ("noise", "quantisation"):
        errors = [
            run_unit(Unit(study=ideal, task=TASK, subject=k, setting=Setting(45.0), without=without))["error_rms_deg"]  # type: ignore[arg-type]
            for k in range(6)
        ]
        room, _, plain, skew = np.mean(errors, axis=0)
        show(f"error without {without}, deg: skew, plain", skew, plain)
        assert abs(skew - plain) < 0.02
        assert room > 3.0 * skew


def test_the_preset_offers_it_and_a_target_counts_its_wedge() -> None:
    from testkit.surfaces import errors
    from undrift.study.judge import PARAMETERS
    from undrift.study.run import TaskSurface
    from undrift.study.target import needs_of

    assert all(dict(task.space.further)["mounting"] == (1.0, 2.0) for task in note_study().tasks)
    further = {"set_points": np.array([1.0, 1.0, 3.0, 3.0]), "mounting": np.array([1.0, 2.0, 1.0, 2.0])}
    ones = {name: np.ones(4) for name in (*PARAMETERS, "rig_minutes")}
    surface = TaskSurface(task="sit_to_stand", **ones, **errors(np.ones((3, 4))), further=further)
    plain = ("faces fixture", "rate table")
    assert [needs_of(TASK, surface, place) for place in range(3)] == [plain, plain, (*plain, "chamber")]
    assert needs_of(TASK, surface, 3) == ("faces fixture", "wedge", "rate table", "chamber")
