"""study.toml, the preset of the note, recorded people, and what a plan refuses."""

from pathlib import Path

import numpy as np
import pytest

from testkit.data import data_path
from undrift.errors import FileFormatError, InputError
from undrift.io.reference import write_reference
from undrift.programme import write_protocol
from undrift.record import Reference
from undrift.sim.motion.poses import PoseSpline, fit_pose_spline
from undrift.sim.motion.tasks import draw_task
from undrift.study.plan import TABLE_1, note_study, read_study
from undrift.study.recorded import (
    SKIN,
    OwnMotion,
    Posed,
    check_rest,
    find_rest,
    length_of_rest,
    read_motion,
    read_poses,
)
from undrift.study.run import perform
from undrift.study.sessions import SESSIONS, table_protocol
from undrift.units import STANDARD_GRAVITY

TEXT = """
[study]
subjects = 5
sessions = ["hand", "three rates"]
categories = ["level_2", "young"]
[study.bench]
level_deg = 0.2
[[session]]
name = "mine"
protocol = "mine.toml"
[[task]]
name = "step"
[task.tried]
cutoff_hz = [11.1, 20.0]
turn_rate_max_dps = [90.0, 50.0]
[[task]]
name = "sit_to_stand"
category = "knee"
[category.knee]
like = "elderly"
step_s = [2.4, 0.5]
"""


@pytest.fixture
def folder(tmp_path):
    write_protocol(table_protocol("mine", 15.0, 15.0, 60.0), tmp_path / "mine.toml")
    (tmp_path / "study.toml").write_text(TEXT)
    return tmp_path


def test_a_plan_has_its_tasks_sessions_and_people(folder):
    study = read_study(folder / "study.toml")
    assert [task.key for task in study.tasks] == ["step", "step-young", "sit_to_stand-knee"]
    assert [session.name for session in study.sessions] == ["hand", "three rates", "mine"]
    assert study.name == "study"
    assert study.bench.errors.level == pytest.approx(np.radians(0.2))
    assert study.bench.encoder_lines == 10_000
    assert len(list(study.tasks[0].variations())) == 4


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        (('"hand"', '"foot"'), "foot"),
        (("[90.0, 50.0]", "[90.0, 51.0]"), "step must divide"),
        (('name = "step"', 'name = "dance"'), "dance"),
        (('category = "knee"', 'category = "hip"'), "hip"),
        (('name = "mine"', 'name = "hand"'), "different sessions"),
    ],
)
def test_a_plan_that_cannot_be_run_is_refused(folder, changed, said):
    (folder / "study.toml").write_text(TEXT.replace(*changed, 1))
    with pytest.raises((FileFormatError, InputError), match=said):
        read_study(folder / "study.toml")


def test_the_preset_is_the_notes_study():
    study = note_study()
    assert [task.name for task in study.tasks] == list(TABLE_1)
    assert (study.fit, study.timing, study.subjects) == ("paper", "aligned", 30)
    assert [session.name for session in study.sessions] == list(SESSIONS)
    for task in study.tasks:
        rates = [numbers.session().protocol.turn_rates() for *_, numbers in task.variations()]
        assert min(np.abs(rate).min() for rate in rates) > np.radians(0.09)  # one count of the encoder in 0.1 s
    own = TABLE_1["sit_to_stand"].numbers.session().protocol.turn_rates()
    assert 3 * len(own) == 102  # columns of the note's matrix


def test_recorded_people_perform_their_own_motions(tmp_path):
    for seed in range(3):
        task = draw_task("sit_to_stand", rng=np.random.default_rng(seed), rest_s=2.0)
        time = np.arange(round(task.duration_s * 100.0)) / 100.0
        poses = Reference(time=time, q_nb=task.at(time, 9.81).q_nb, position=task.position(time))
        (tmp_path / "people").mkdir(exist_ok=True)
        write_reference(poses, tmp_path / "people" / f"{seed}.parquet")
    (tmp_path / "study.toml").write_text('[[task]]\nname = "rise"\n[task.motion]\nfolder = "people"\n')
    study = read_study(tmp_path / "study.toml")
    lengths = [perform(study, study.tasks[0], number)[0].duration_s for number in range(4)]
    assert len(set(lengths[:3])) == 3
    assert lengths[3] == lengths[0]


def test_a_rate_below_one_count_of_the_encoder_in_a_tenth_of_a_second_is_refused(folder):
    text = TEXT.replace(
        "turn_rate_max_dps = [90.0, 50.0]", "turn_rate_min_dps = [0.05]\nturn_rate_step_dps = [0.005, 0.01]"
    )
    (folder / "study.toml").write_text(text)
    with pytest.raises(FileFormatError, match="encoder"):
        read_study(folder / "study.toml")
    (folder / "study.toml").write_text(text.replace("level_deg = 0.2", "level_deg = 0.2\nencoder_lines = 100000"))
    read_study(folder / "study.toml")


DEG = np.pi / 180.0
FILE = Path("poses.parquet")


def leaning(rate_dps: float, *, from_s: float, noise_deg: float = 0.0) -> PoseSpline:
    """A body that stands, and from an instant on leans forward at a steady rate."""
    time = np.arange(600) / 100.0
    lean = rate_dps * DEG * np.maximum(time - from_s, 0.0)
    lean = lean + noise_deg * DEG * np.random.default_rng(1).standard_normal(len(time))
    q = np.stack((np.cos(lean / 2.0), np.zeros(600), np.sin(lean / 2.0), np.zeros(600)), axis=1)
    return fit_pose_spline(Reference(time=time, q_nb=q, position=np.zeros((600, 3))), SKIN)


def test_a_turn_in_the_stated_rest_is_refused_with_the_length_of_the_rest() -> None:
    is_still = find_rest(leaning(40.0, from_s=2.0))
    with pytest.raises(InputError, match=r"rest_s = 3 s") as caught:
        check_rest(is_still, 3.0, FILE)
    assert 1.7 <= caught.value.numbers["still_s"] <= 2.0
    check_rest(is_still, float(caught.value.numbers["still_s"]), FILE)  # the advice is accepted


def test_a_slow_turn_counts_by_the_tilt_that_it_spoils() -> None:
    is_still = find_rest(leaning(3.0, from_s=0.0))  # slower than the limit
    with pytest.raises(InputError, match=r"The body is still for only 0\.6 s"):
        check_rest(is_still, 2.0, FILE)  # half of 3 deg/s times 2 s


def test_noise_of_cameras_is_no_motion() -> None:
    # 0.1 deg: 0.1 mm on markers 60 mm apart
    assert length_of_rest(find_rest(leaning(0.0, from_s=0.0, noise_deg=0.1))) > 5.5


@pytest.mark.slow
def test_people_who_stand_are_at_rest_and_a_squat_that_has_begun_is_not() -> None:
    stood = data_path("mocap_sit_to_stand", "static1.trc.gz")
    standing = fit_pose_spline(read_poses(stood, Posed(body="pelvis", up="y")), SKIN)
    check_rest(find_rest(standing), 4.5, stood)
    squat = data_path("c3d", "squat.c3d.gz")
    for up in ("y", "z"):
        own = OwnMotion(path=str(squat), rest_s=2.0, body="pelvis", up=up)
        with pytest.raises(InputError, match="or set hold = true and rest_s = 6"):
            read_motion(own)


def test_a_pose_that_is_held_is_a_rest_before_the_same_motion() -> None:
    squat = data_path("c3d", "squat.c3d.gz")
    own = OwnMotion(path=str(squat), rest_s=6.0, body="pelvis", up="y", hold=True)
    task = read_motion(own)
    time = np.arange(-10, 1000) / 100.0
    motion, before = task.at(time, STANDARD_GRAVITY), time < 6.0
    assert task.moving_s == (6.0, pytest.approx(task.duration_s))
    np.testing.assert_array_equal(motion.rate_b[before], 0.0)
    np.testing.assert_array_equal(motion.valid, 1.0)
    np.testing.assert_allclose(np.linalg.norm(motion.force_b[before], axis=1), STANDARD_GRAVITY, rtol=1e-12)
    plain = task.spline.at(time[~before] - 6.0 + task.spline.span_s[0], STANDARD_GRAVITY)
    np.testing.assert_array_equal(motion.q_nb[~before], plain.q_nb)
    np.testing.assert_array_equal(motion.force_b[~before], plain.force_b)
    np.testing.assert_allclose(motion.q_nb[before], np.tile(plain.q_nb[0], (before.sum(), 1)), atol=1e-12)
