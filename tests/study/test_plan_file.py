"""study.toml: what it says arrives, what it cannot mean is refused with its line, and motions of one's own are performed."""

import pickle
import re
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from testkit.data import show
from testkit.surfaces import candidates
from undrift.base.codec import tree_of, value_of
from undrift.errors import FileFormatError, InputError
from undrift.io.reference import write_reference
from undrift.record import Reference
from undrift.sim.bench_errors import BenchErrors
from undrift.sim.device.model import write_device
from undrift.sim.device.presets import preset
from undrift.sim.motion.tasks import draw_task
from undrift.study import judge
from undrift.study.case import device_of, make_case, session_of
from undrift.study.judge import find_optimum
from undrift.study.plan import (
    NOTE_BENCH,
    ProtocolEntry,
    StudyFile,
    note_study,
    read_motion,
    read_study,
)
from undrift.study.run import InProcess, run_study
from undrift.study.space import Setting
from undrift.study.statistics import mean_limits
from undrift.study.target import leave_one_out

DPS = np.pi / 180.0
TEXT = """
[study]
device = "enc03j_3031"
subjects = 3
seed = 5
excursion_k = [8.0, 9.0]
rig_minutes_max = 100.0
[[task]]
name = "sit_to_stand"
[task.space]
cutoff_hz = [5.0, 11.1]
turn_rate_step_dps = [10.0]
turn_rate_min_dps = [10.0]
turn_rate_max_dps = [50.0, 90.0]
[task.protocol]
dwell_s = 1.0
bracket_s = 3.0
set_points_c = [18.0, 36.0, 54.0, 75.0]
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "study.toml"
    path.write_text(text)
    return path


def recorded(
    folder: Path, *, position: bool = True, gap: bool = False, name: str = "poses", seed: int = 3, rest_s: float = 2.0
) -> Path:
    """A sit-to-stand as a camera system would store it, 100 Hz."""
    task = draw_task("sit_to_stand", rng=np.random.default_rng(seed), rest_s=rest_s)
    time = np.arange(round(task.duration_s * 100.0)) / 100.0
    q = task.at(time, 9.81).q_nb.copy()
    if gap:
        q[250:300] = np.nan
    path = folder / f"{name}.parquet"
    write_reference(Reference(time=time, q_nb=q, position=task.position(time) if position else None), path)
    return path


def test_what_the_file_says_arrives(tmp_path: Path) -> None:
    study = read_study(written(tmp_path, TEXT))
    assert (study.name, study.device, study.subjects, study.seed) == ("study", "enc03j_3031", 3, 5)
    assert (study.excursion_k, study.rig_minutes_max, study.objective) == ((8.0, 9.0), 100.0, "rms")
    assert study.margin_deg == note_study().margin_deg == pytest.approx(0.15 / 3**0.5, abs=5e-4)  # the note's Figure 3
    largest = read_study(written(tmp_path, TEXT.replace("seed = 5", "seed = 5\nobjective = 'maximum'")))
    assert largest.margin_deg == 0.15
    assert study.timing == note_study().timing == "offline"
    ended = read_study(written(tmp_path, TEXT.replace("seed = 5", "seed = 5\nobjective = 'end'\ntiming = 'real time'")))
    assert (ended.objective, ended.timing, ended.margin_deg) == ("end", "real time", 0.15)
    for wrong in ("timing = 'later'", "objective = 'mean'"):
        with pytest.raises(FileFormatError, match=wrong.split(" ")[0]):
            read_study(written(tmp_path, TEXT.replace("seed = 5", f"seed = 5\n{wrong}")))
    stated = read_study(written(tmp_path, TEXT.replace("seed = 5", "seed = 5\nmargin_deg = 0.05")))
    assert stated == replace(study, margin_deg=0.05)
    with pytest.raises(FileFormatError, match="margin_deg"):
        read_study(written(tmp_path, TEXT.replace("seed = 5", "seed = 5\nmargin_deg = 0.0")))
    (task,) = study.tasks
    first = candidates(task, 11.1)[0]
    assert first.turn_rates() == pytest.approx(np.array([-50, -40, -30, -20, 20, 30, 40, 50]) * DPS)
    assert (first.dwell_s, first.bracket_s, first.cutoff_hz) == (1.0, 3.0, 11.1)
    assert first.temperatures_c == (18.0, 36.0, 54.0, 75.0)


def test_what_the_bench_does_wrong_arrives_and_an_error_below_zero_is_refused(tmp_path: Path) -> None:
    assert read_study(written(tmp_path, TEXT)).bench == NOTE_BENCH
    stated = "[study.bench]\nmount_tilt_deg = 0.5\nencoder_lines = 0\ntable_rate_percent = 0.2\n[[task]]\nname"
    bench = read_study(written(tmp_path, TEXT.replace("[[task]]\nname", stated))).bench
    assert bench == replace(NOTE_BENCH, mount_tilt=0.5 * DPS, encoder_lines=0, table_rate=0.002)
    assert note_study().bench == NOTE_BENCH
    assert value_of(BenchErrors, tree_of(bench), "bench") == bench  # as summary.json has it
    assert read_study(written(tmp_path, TEXT.replace("seed = 5", "chain_percent = 2.0"))).chain_sd == 0.02
    assert read_study(written(tmp_path, TEXT)).chain_sd == note_study().chain_sd == 0.01
    with pytest.raises(FileFormatError, match=r"wobble_deg.*greater than or equal to 0"):
        read_study(
            written(tmp_path, TEXT.replace("[[task]]\nname", "[study.bench]\nwobble_deg = -1.0\n[[task]]\nname"))
        )


def test_a_device_file_is_taken_in_and_every_subject_wears_it(tmp_path: Path) -> None:
    write_device(preset("enc03j_3031"), tmp_path / "twin.json")
    study = read_study(written(tmp_path, TEXT.replace("enc03j_3031", "twin.json")))
    (tmp_path / "twin.json").unlink()
    assert study.device == "twin"
    study = pickle.loads(pickle.dumps(study))
    one, two = device_of(study, 0), device_of(study, 1)
    np.testing.assert_array_equal(one.gyro.offset.constant, preset("enc03j_3031").gyro.offset.constant)
    np.testing.assert_array_equal(one.gyro.offset.constant, two.gyro.offset.constant)
    surfaces = run_study(study, InProcess(), tmp_path / "runs")
    again = run_study(study, InProcess(), tmp_path / "runs")  # the folder knows its study by the device's content
    assert (surfaces[0].error_rms_deg == again[0].error_rms_deg).all()


@pytest.mark.slow
def test_a_folder_of_people_is_performed_one_by_each_subject_and_their_rests_are_found(tmp_path: Path) -> None:
    own = TEXT.replace('"sit_to_stand"', '"rising"').replace("subjects = 3", "subjects = 30\ntarget_deg = 1.0")
    own += '[task.motion]\nfolder = "captures"\n'
    folder = tmp_path / "captures"
    with pytest.raises(FileFormatError, match=r"wanted a folder of recorded people, got .*No such file"):
        read_study(written(tmp_path, own))
    folder.mkdir()
    rests = (2.0, 3.0, 9.0, 1.5)
    for number, rest_s in enumerate(rests):
        if number == 2:
            with pytest.raises(FileFormatError, match="wanted three people or more, got 2; record more"):
                read_study(written(tmp_path, own))
        recorded(folder, name=f"person{number}", seed=number, rest_s=rest_s)
    study = read_study(written(tmp_path, own))
    (task,) = study.tasks
    assert task.motion is not None
    assert (study.subjects, task.motion.people) == (4, 4)  # no person counts twice
    found = [task.motion.of(number)[0].rest_s for number in range(4)]
    show("rests found, s, of 2, 3, 9 and 1.5", found[0], f"{found[1:]}")
    for rest_s, wanted in zip(found, rests, strict=True):
        assert min(wanted, 6.0) - 0.3 <= rest_s <= min(wanted + 0.5, 6.0)
    lengths = [make_case(study, task, number, Setting(11.1)).pitch.shape for number in (0, 1, 4)]
    assert lengths[0] == lengths[2] != lengths[1]
    both = own.replace("folder =", 'file = "captures/person0.parquet"\nfolder =')
    with pytest.raises(
        FileFormatError, match=r"a file, a folder with one of each person, .* got file and folder; name one"
    ):
        read_study(written(tmp_path, both))
    with pytest.raises(FileFormatError, match="wanted a body at rest for its first rest_s = 4 s"):
        read_study(written(tmp_path, f"{own}rest_s = 4.0\n"))


def test_people_who_were_recorded_are_each_judged_with_what_the_others_choose(tmp_path: Path) -> None:
    folder = tmp_path / "captures"
    folder.mkdir()
    for number in range(4):
        recorded(folder, name=f"person{number}", seed=number)
    own = (
        TEXT.replace("rig_minutes_max = 100.0\n", "")
        .replace('"sit_to_stand"', '"rising"')
        .replace("subjects = 3", "subjects = 4\ntarget_deg = 3.0")
    )
    study = read_study(written(tmp_path, own + '[task.motion]\nfolder = "captures"\n'))
    (surface,) = run_study(study, InProcess(), tmp_path / "runs")
    error = surface.aimed(study)
    poor = replace(surface, error_rms_deg=np.where(np.arange(error.shape[1]) == 0, error, error + 10.0))
    optimum, nan = find_optimum(poor, study), float("nan")
    other = judge.Tested(subjects=4, failed=0, error_rms_deg=nan, error_max_deg=nan, interval_rms_deg=(nan, nan),
                   interval_max_deg=(nan, nan), limits_deg=(nan, nan))  # fmt: skip
    alone = leave_one_out(study.tasks[0], poor, optimum, study, other)
    assert alone.limits_deg == mean_limits(error[:, 0], study.confidence)  # every three choose the one that is good
    drawn = replace(study.tasks[0], name="sit_to_stand", motion=None)
    assert leave_one_out(drawn, poor, optimum, study, other) is other


def test_motions_that_cannot_be_performed_are_refused(tmp_path: Path) -> None:
    own = TEXT + '[task.motion]\nfile = "poses.parquet"\nrest_s = 2.0\n'
    with pytest.raises(FileFormatError, match="wanted a file of poses or markers"):
        read_study(written(tmp_path, own))
    recorded(tmp_path, position=False)
    with pytest.raises(FileFormatError, match="wanted poses with positions"):
        read_study(written(tmp_path, own))
    recorded(tmp_path, gap=True)
    with pytest.raises(FileFormatError, match="wanted poses without long gaps, got 1"):
        read_study(written(tmp_path, own))
    recorded(tmp_path)
    with pytest.raises(FileFormatError, match=r"wanted a rest_s of 0\.5 s to"):
        read_study(written(tmp_path, own.replace("rest_s = 2.0", "rest_s = 100.0")))
    motion = read_study(written(tmp_path, own)).tasks[0].motion
    assert motion is not None
    with pytest.raises(InputError, match="wanted the file that the study began with"):
        read_motion(replace(motion, sha256="0" * 64))


@pytest.mark.parametrize(
    ("was", "becomes", "text"),
    [
        ("seed = 5", "sede = 5", r"line 5: \[study\], sede: wanted a known key"),
        ("[5.0, 11.1]", "[]", r"\[\[task\]\] 1, space, cutoff_hz"),
        ('"enc03j_3031"', '"no_such"', "wanted one of enc03j_3031.* or a device.json, got 'no_such'"),
        ('"sit_to_stand"', '"dancing"', "got 'dancing'; name one, or give a motion of your own"),
        ('"sit_to_stand"', '"a task"', "wanted a name of letters, digits and _"),
        ("step_dps = [10.0]", "step_dps = [7.0]", "steps that divide the span"),
        ("subjects = 3", "subjects = 2", "greater than or equal to 3"),
    ],
)
def test_files_that_cannot_be_meant_are_refused(tmp_path: Path, was: str, becomes: str, text: str) -> None:
    with pytest.raises(FileFormatError, match=text):
        read_study(written(tmp_path, TEXT.replace(was, becomes)))


def test_the_example_of_the_page_is_one_and_its_defaults_are_the_notes() -> None:
    page = (Path(__file__).parents[2] / "docs" / "study.md").read_text()
    found = re.search(r"```toml\n(.*?)```", page, re.S)
    assert found
    held = value_of(StudyFile, tomllib.loads(found.group(1)), "docs/study.md")
    assert held.task[0].protocol == ProtocolEntry()
    assert held.study.bench == NOTE_BENCH
    base = note_study().tasks[0].base
    assert (base.dwell_s, base.bracket_s, base.face_s, base.grid) == (2.0, 6.0, 6.0, "paper")
    assert base.temperatures_c == held.task[0].protocol.set_points_c


def test_two_tasks_of_one_name_are_refused(tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match="wanted another name for each task"):
        read_study(written(tmp_path, TEXT + TEXT[TEXT.index("[[task]]") :]))


PLACES = """
[[task]]
name = "step"
[task.space]
cutoff_hz = [11.1]
turn_rate_step_dps = [20.0]
turn_rate_min_dps = [10.0]
turn_rate_max_dps = [50.0]
places = [[], [18.0, 45.0], [18.0, 30.0, 60.0]]
"""


def test_lists_of_set_points_are_tried_as_they_are(tmp_path):
    (tmp_path / "study.toml").write_text(PLACES)
    study = read_study(tmp_path / "study.toml")
    (task,) = study.tasks
    points = task.space.points()
    protocols = [task.protocol_of(point) for point in points]
    assert [one.temperatures_c for one in protocols] == [(), (18.0, 45.0), (18.0, 30.0, 60.0)]
    minutes = [session_of(one).length_s[0] / 60.0 for one in protocols]
    assert minutes == sorted(minutes)
    assert minutes[2] > 1.4 * minutes[1] > 10.0 * minutes[0]
    for old, new, wanted in (
        (
            "places",
            "set_points = [1, 2]\nplaces",
            "places: wanted lists of set-points, or set_points and warmest_c, got both",
        ),
        ("[18.0, 45.0]", "[45.0, 18.0]", "wanted rising temperatures"),
    ):
        (tmp_path / "study.toml").write_text(PLACES.replace(old, new))
        with pytest.raises(FileFormatError, match=wanted):
            read_study(tmp_path / "study.toml")
