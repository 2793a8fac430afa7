"""Poses in which accelerometers are calibrated: faces, inclined ones, and what their tilts are worth in the pose worn."""

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.poses import errors, one_protocol, start_tilt

from testkit.data import show
from testkit.surfaces import errors as planted_errors
from undrift.errors import FileFormatError, InputError
from undrift.model import TriadModel
from undrift.record import FACES
from undrift.sim.bench_errors import BenchErrors
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.truth import true_calibration
from undrift.sim.motion.motion import unit_vector
from undrift.sim.table_sessions import FACE, ROOM_TEMP_C
from undrift.study.case import device_of, faces_of, session_of
from undrift.study.judge import PARAMETERS
from undrift.study.plan import POSES, Study, StudyTask, note_study, read_study
from undrift.study.run import TaskSurface
from undrift.study.target import needs_of
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

STUDY = note_study(subjects=200)
TASK, EXACT = STUDY.tasks[0], replace(STUDY, bench=BenchErrors())


def test_an_inclined_pose_lies_between_two_faces() -> None:
    np.testing.assert_allclose(unit_vector("+z 45 +x"), [np.sqrt(0.5), 0.0, np.sqrt(0.5)], atol=1e-15)
    np.testing.assert_allclose(unit_vector("-y 30 +z"), [0.0, -np.sqrt(0.75), 0.5], atol=1e-15)
    np.testing.assert_allclose(unit_vector("-y 30 +z", np.radians(60.0)), [0.0, 0.0, 1.0], atol=1e-15)
    assert [len(one) for one in POSES] == [6, 5, 5, 5, 5, 10, 12]
    assert [[face for face in FACES if face not in one] for one in POSES[:4]] == [[], ["-z"], ["-x"], ["+z"]]


def calibrated(study: Study, poses: tuple[str, ...], number: int, device: DeviceModel) -> TriadModel:
    """The accelerometers of a subject's device in some poses."""
    laid = replace(TASK.base, faces=poses, turn_rate_min=0.1, turn_rate_max=0.2, turn_rate_step=0.1)
    sessions = session_of(laid).chosen(FACE)
    assert len(sessions.kind) == len(poses)
    model = faces_of(study, device, number, sessions, laid.faces)
    assert model is not None
    return model


@pytest.mark.parametrize("place", range(len(POSES)))
def test_every_set_of_poses_gives_the_true_accelerometers_on_a_perfect_bench(place: int) -> None:
    device = device_of(STUDY, 0).without_noise()
    model = calibrated(EXACT, POSES[place], 0, device)
    true = true_calibration(device, temp_c=ROOM_TEMP_C).accel
    assert true is not None
    # steps of 12 bits are 1e-3 of gravity, of which codes that nothing dithers lose up to half
    assert np.abs(model.matrix @ np.linalg.inv(true.matrix) - np.eye(3)).max() < 4e-3


def test_a_pose_has_the_same_draws_in_every_set() -> None:
    device, faces = device_of(STUDY, 3), ("+x", "-x", "+y", "+z")
    one, two = (calibrated(STUDY, poses, 3, device) for poses in ((*faces, "+z 45 +x"), ("+z 45 +x", *faces)))
    # read in another order they differ by bias instability and noise, not by tilts of 0.1 deg, 1.7e-3
    assert np.abs(one.matrix @ np.linalg.inv(two.matrix) - np.eye(3)).max() < 5e-4
    other = calibrated(STUDY, (*faces, "+z 45 +y"), 3, device)
    assert np.abs(one.matrix @ np.linalg.inv(other.matrix) - np.eye(3)).max() > 5e-4


@pytest.mark.slow
def test_five_faces_are_worse_than_six_by_the_tilt_of_one_face_and_by_nothing_else() -> None:
    show("tilt of the start over that of a face: six, without -z, -x, +z", [start_tilt(poses) for poses in POSES[:4]])
    # by hand, worn upright: without -z the face +z alone counts; with it the two share, and the others make the offset
    upright = [start_tilt(poses, 0.0) for poses in POSES[:4]]
    assert upright == pytest.approx([np.sqrt(11.0 / 18.0), 1.0, np.sqrt(0.75), np.sqrt(1.5)])
    subjects = 60
    task = one_protocol(STUDY, TASK, range(4))
    every, level = errors(STUDY, task, subjects), errors(STUDY, task, subjects, "cross-axis")
    apart = every - every[:, :1]
    half = 1.96 * apart.std(axis=0, ddof=1) / np.sqrt(subjects)
    show("error less that of six faces, deg: without -z, -x, +z", (apart.mean(axis=0)[1:], half[1:]))
    show("on a bench without tilts, deg", (level - level[:, :1]).mean(axis=0)[1:])
    assert apart[:, 3].mean() > half[3]  # without the face that is worn
    assert apart[:, 1].mean() - half[1] < 0.0087  # five are not shown to be worse, nor better, by a tenth of the margin
    assert np.abs((level - level[:, :1]).mean(axis=0)[1:3]).max() < 0.002


def test_sets_of_a_plan_arrive_and_an_inclined_plane_is_an_instrument(tmp_path) -> None:
    path = tmp_path / "study.toml"
    rates = "turn_rate_step_dps = [10.0]\nturn_rate_min_dps = [10.0]\nturn_rate_max_dps = [50.0]"
    text = f'[[task]]\nname = "step"\n[task.space]\ncutoff_hz = [11.4]\n{rates}\n'
    path.write_text(text + 'poses = [["+x", "-x", "+y", "+z"], ["+z", "+x 45 +z", "+y 30 -x", "-y", "-z"]]')
    (task,) = read_study(path).tasks
    assert dict(task.space.further) == {"poses": (1.0, 2.0)}
    assert [task.protocol_of(point).faces for point in task.space.points()] == list(task.poses)

    further = {"poses": np.array([1.0, 2.0]), "set_points": np.array([1.0, 2.0])}
    surface = TaskSurface(task="step", **{n: np.ones(2) for n in (*PARAMETERS, "rig_minutes")}, **planted_errors(np.ones((3, 2))),
                          further=further)  # fmt: skip
    assert not any(surface.at_end(value, "poses") for value in (1.0, 2.0))  # sets have no order
    assert surface.at_end(1.0, "set_points") is False
    assert surface.at_end(2.0, "set_points") is True
    assert needs_of(task, surface, 0) == ("faces fixture", "rate table")
    assert needs_of(task, surface, 1) == ("faces fixture", "inclined plane", "rate table", "chamber")
    for wrong, said in (('["+x up"]', r'got "\+x up"; write it so'), ('["+z 45 -z"]', r'got "\+z 45 -z"; write it so'),
                        ('["+x", "+y", "+z"]', "wanted sets of four poses or more"),
                        ('["+x", "+x", "+y", "+z"]', "each pose once")):  # fmt: skip
        path.write_text(f"{text}poses = [{wrong}]")
        with pytest.raises(FileFormatError, match=said):
            read_study(path)
    with pytest.raises(InputError, match="numbers of these sets"):
        StudyTask(name="step", base=task.base, space=replace(task.space, further=(("poses", (9.0,)),)))


@pytest.mark.slow
@pytest.mark.parametrize(("place", "factor"), [(0, np.sqrt(11.0 / 18.0)), (1, 1.0), (3, np.sqrt(1.5)), (5, None)])
def test_the_tilt_of_the_start_is_what_the_weights_say(place: int, factor: float | None) -> None:
    tilt, up = 0.1 * RADIAN_PER_DEGREE, np.array([0.0, 0.0, STANDARD_GRAVITY])
    tilted, device, starts = replace(STUDY, bench=BenchErrors(face_tilt=tilt)), device_of(STUDY, 0).without_noise(), []
    exact = calibrated(EXACT, POSES[place], 0, device)
    reading = np.linalg.solve(exact.matrix, up) + exact.offset
    for number in range(200):
        model = calibrated(tilted, POSES[place], number, device)
        starts.append((model.matrix @ (reading - model.offset))[:2] / STANDARD_GRAVITY)
    spread, factor = float(np.std(np.array(starts))) / tilt, factor or start_tilt(POSES[place], 0.0)
    show("tilt of the start over that of a face", spread, factor)
    assert spread == pytest.approx(factor, rel=0.12)  # 3 standard errors of 400 angles are 0.106; codes 0.01
