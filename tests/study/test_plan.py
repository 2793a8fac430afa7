"""study.toml, the note's preset, and what a plan refuses."""

import numpy as np
import pytest

from undrift.errors import FileFormatError, InputError
from undrift.io.reference import write_reference
from undrift.programme import write_protocol
from undrift.record import Reference
from undrift.sim.motion.tasks import draw_task
from undrift.study.plan import TABLE_1, note_study, read_study, with_categories
from undrift.study.run import perform
from undrift.study.sessions import SESSIONS, table_protocol

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
    assert study.bench.level == pytest.approx(np.radians(0.2))
    assert study.bench.encoder_lines == 10_000
    assert len(list(study.tasks[0].variations())) == 4


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        (('"hand"', '"foot"'), "foot"),
        (("[11.1, 20.0]", "[]"), "cutoff_hz"),
        (("[90.0, 50.0]", "[90.0, 51.0]"), "step must divide"),
        (('name = "step"', 'name = "dance"'), "dance"),
        (('category = "knee"', 'category = "hip"'), "hip"),
        (("subjects = 5", "subjects = 2"), "subjects"),
        (('name = "mine"', 'name = "hand"'), "each once"),
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


def test_categories_cross_the_tasks():
    study = with_categories(note_study(), ["young", "elderly"])
    assert len(study.tasks) == 6
    with pytest.raises(InputError, match="ancient"):
        with_categories(note_study(), ["ancient"])


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


def test_a_unit_without_assumed_figures_keeps_the_draws_of_the_others():
    study = note_study()
    unit, bare = study.unit(3), study.unit(3, assumed=False)
    np.testing.assert_array_equal(unit.gyro.scale.error, bare.gyro.scale.error)  # known
    assert unit.gyro.offset.per_k.any()
    assert not bare.gyro.offset.per_k.any()  # assumed
