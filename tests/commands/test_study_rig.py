"""From a study to the rate table: the file says what the study simulated, and takes as long; the commands can be called."""

import shlex

import pytest

from undrift.cli.app import command_line
from undrift.commands.rig import forecast
from undrift.commands.study import study
from undrift.commands.study_rig import rig_sections, write_protocol
from undrift.programme import Protocol, read_protocol
from undrift.study.outcome import points_of

pytestmark = pytest.mark.usefixtures("computed_once")
RIG = "galil:tcp://127.0.0.1:9"  # nothing is opened

TEXT = """
[study]
name = "rig"
subjects = 3
[[task]]
name = "step"
[task.space]
cutoff_hz = [2.0, 11.4]
turn_rate_step_dps = [15.0]
turn_rate_min_dps = [15.0]
turn_rate_max_dps = [45.0]
quality = [0.58, 0.71]
faces = [5, 6]
set_points = [1, 2]
[task.protocol]
dwell_s = 1.0
set_points_c = [18.0, 45.0]
"""


@pytest.fixture(scope="module")
def studied(tmp_path_factory):
    folder = tmp_path_factory.mktemp("rig study")  # a space: the commands have to quote it
    plan = folder / "study.toml"
    plan.write_text(TEXT)
    return study(plan, output=folder / "out", workers=1, no_rivals=True)


@pytest.mark.slow
def test_the_file_of_a_task_is_its_cheapest_equal_and_the_commands_name_it(studied):
    (task,) = studied.outcome.tasks
    path = studied.output / "protocol-step.toml"
    assert path in studied.summary().written
    written, place = read_protocol(path), task.optimum.cheapest
    assert forecast(path, RIG).total_s / 60.0 == pytest.approx(task.surface.rig_minutes[place], rel=1e-9)
    point = points_of(studied.outcome.study.tasks[0], task.surface)[place]
    assert written.turn_rate_max == pytest.approx(point[3])
    assert (len(written.faces), written.faces_at) == (
        int(dict(zip(task.surface.names, point, strict=True))["faces"]),
        "room",
    )
    commands, plan = rig_sections(studied.outcome, studied.output)
    words = [shlex.split(line) for line in commands.text[1:]]
    chamber = ["--chamber", "ADDRESS"] * bool(written.temperatures_c)
    run = ["undrift", "rig", "run", str(path), "--rig", "ADDRESS", "--device", "ADDRESS", *chamber]
    assert words[0] == [*run, "-o", "session-step"] == ["undrift", *map(str, studied.summary().next)]
    command, *_ = command_line().parse_args(words[0][1:], exit_on_error=False, print_error=False)
    assert command.__name__ == "run"
    assert [line[1] for line in words[1:]] == ["calibrate", "drift"][: 1 + bool(written.temperatures_c)]
    assert len(plan.rows) == len(written.faces) + 3
    minutes = sum(float(row[-1]) for row in plan.rows)  # each to 0.05
    assert minutes == pytest.approx(task.surface.rig_minutes[place], abs=0.05 * len(plan.rows))


def test_the_file_leaves_inclined_poses_to_the_hand(tmp_path):
    poses = ("+x", "+z", "+z 45 +x", "-y", "+z 45 -x")
    rates = {"turn_rate_min": 0.1, "turn_rate_max": 0.2, "turn_rate_step": 0.1}
    path = write_protocol(tmp_path, "step", Protocol(name="step", faces=poses, faces_at="room", **rates))
    assert read_protocol(path).faces == ("+x", "+z", "-y")
