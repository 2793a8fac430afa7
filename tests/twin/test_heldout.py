"""A twin says where a held-out motion goes beyond its training: translation to rotation, real turns about one axis to all."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.broad_trials import trial
from testkit.data import show
from testkit.hand_turns import Device, make_recording
from undrift.record import Record, Reference
from undrift.sim.motion.poses import OpticsSettings, see
from undrift.sim.motion.tasks import Task, draw_task
from undrift.twin.fit import Prepared, fit_prepared, prepare_twin
from undrift.twin.heldout import Excitation, compare_held_out, end_errors, excitation, motion_windows, not_excited
from undrift.units import STANDARD_GRAVITY

RATE_HZ = 100.0


def slower(task: Task, share: float) -> Task:
    """Return a task with all its translation and a share of its rotation."""
    turns = {
        name: tuple(replace(c, amplitudes=tuple(share * a for a in c.amplitudes)) for c in getattr(task, name))
        for name in ("roll", "pitch", "yaw")
    }
    return replace(task, **turns)


def drawn(seed: int, share: float) -> tuple[Record, Reference]:
    rng = np.random.default_rng(seed)
    task = slower(draw_task("free", rng=rng, rest_s=12.0), share)
    time = np.arange(round(task.duration_s * RATE_HZ)) / RATE_HZ
    motion = task.at(time, STANDARD_GRAVITY)
    gyro = motion.mean_rate_b + 2e-4 * rng.standard_normal((len(time), 3))
    accel = motion.force_b + 0.02 * rng.standard_normal((len(time), 3))
    poses = see(task, rng=rng, settings=OpticsSettings(sample_rate_hz=RATE_HZ, angle_sd=3e-4, gaps=0))
    return Record(time=time, gyro=gyro, accel=accel), poses


def excited(prepared: Prepared, training: list[int], held_out: int) -> Excitation:
    twin = fit_prepared(prepared, chosen=training, brief=True)
    windows = [motion_windows(prepared.matches[k]) for k in (held_out, *training)]
    found = excitation(windows[0], windows[1:], twin.gyro.triad.model)
    names = [match.name for match in prepared.matches]
    show(
        f"{[names[k] for k in training]} to {names[held_out]}: windows beyond, predicted and trained, deg",
        f"{found.beyond:.2f}, {np.degrees(found.predicted):.3f}, {np.degrees(found.trained):.3f}",
    )
    return found


def test_a_twin_of_translation_says_that_rotation_is_beyond_it() -> None:
    pairs = [drawn(1, 0.08), drawn(2, 0.08), drawn(3, 1.0), drawn(4, 1.0)]
    records, references = zip(*pairs, strict=True)
    prepared = prepare_twin(records, references, names=["translation", "again", "rotation", "rotation again"])
    rotation = excited(prepared, [0, 1], 2)
    found = rotation.finding("rotation")
    assert found is not None
    assert (found.code, found.level) == ("twin.beyond_training", "warn")
    assert found.values["beyond_percent"] > 90.0
    assert found.values["predicted_deg"] > 5.0 * found.values["trained_deg"]  # twelve times the rotation
    assert found.action == f"train on a recording with turns about {found.values['axis']} as well"
    # The error that the true device, the identity here, leaves over those windows is what was predicted.
    twin = fit_prepared(prepared, chosen=[0, 1], brief=True)
    wrong = np.concatenate(((twin.gyro.triad.model.matrix - np.eye(3)).ravel(), np.zeros(3)))
    error = np.sqrt(((motion_windows(prepared.matches[2]) @ wrong) ** 2).sum(axis=1).mean())
    show("error over the windows, deg", f"{np.degrees(error):.3f}", f"{np.degrees(rotation.predicted):.3f} predicted")
    assert rotation.predicted / 3.0 < error < 2.0 * rotation.predicted  # nine elements of one draw
    assert excited(prepared, [0], 1).finding("again") is None
    assert excited(prepared, [2], 3).finding("rotation again") is None


@pytest.mark.parametrize(("share", "axes"), [(0.08, ("x", "y", "z")), (1.0, None)])
def test_a_twin_says_about_which_axes_it_was_never_turned(share: float, axes: tuple[str, ...] | None) -> None:
    prepared = prepare_twin(*zip(*(drawn(seed, share) for seed in (11, 12)), strict=True))
    found = not_excited(prepared, fit_prepared(prepared, brief=True))
    assert (found and found.values["axes"]) == axes
    if found is not None:
        show("one turn in 5 s, by the fit's own uncertainty, deg", f"{found.values['off_deg']:.2f}")
        assert found.code == "twin.not_excited"
        assert 0.1 < found.values["off_deg"] < 1.0


@pytest.mark.slow
def test_a_real_twin_of_turns_about_x_says_that_those_about_y_are_beyond_it() -> None:
    # BROAD trial 02 turns about x for its first 100 s (about y at 13 deg/s rms); 07 and 09 turn at 300 deg/s about all axes.
    record, poses = trial(2)
    early = poses.time < 100.0
    cut = replace(
        poses,
        time=poses.time[early],
        q_nb=poses.q_nb[early],
        position=poses.position[early],
        moving=poses.moving[early],
    )
    pairs = [(record.between(0.0, 100.0), cut), trial(7), trial(9)]
    records, references = zip(*pairs, strict=True)
    prepared = prepare_twin(records, references, names=["02 about x", "07", "09"])
    for held_out in (1, 2):
        found = excited(prepared, [0], held_out).finding(prepared.matches[held_out].name)
        assert found is not None
        assert found.values["axis"] == "y"
    assert excited(prepared, [1], 2).finding("09") is None
    assert excited(prepared, [2], 1).finding("07") is None


@pytest.mark.slow
def test_recordings_that_begin_and_end_in_motion_make_a_twin_that_predicts_their_ends() -> None:
    rng = np.random.default_rng(8)
    forward, offset = np.eye(3) + 0.01 * rng.standard_normal((3, 3)), np.radians([0.5, -0.3, 0.8])
    pairs = []
    for change in np.radians([[0.03, 0.0, -0.03], [-0.03, 0.03, 0.0]]):
        device = Device(forward=forward, offset=offset + change, noise=1e-3)
        record, reference = make_recording(rng, device, turn_s=40.0, optics_hz=30.0, optics_noise=3e-4, mark=False)
        pairs.append((record.between(10.0, 46.0), reference))
    records, references = zip(*pairs, strict=True)
    prepared = prepare_twin(records, references)
    twin = fit_prepared(prepared)
    assert [m.span.rested for m in prepared.matches] == [False, False]
    model = twin.gyro.triad.model
    error = model.matrix - np.linalg.inv(forward)
    show("matrix off by", np.abs(error).max(), 2e-3)
    assert np.abs(error).max() < 2e-3
    np.testing.assert_allclose(np.degrees(model.offset - offset), 0.0, atol=0.1)  # 0.1 deg/s between switch-ons
    (lost,) = (one for one in twin.parameters if one.name == "gyro_motion_offset")
    assert "No recording rests" in lost.reason
    assert twin.gyro_noise is None
    ends = end_errors(prepared, rng=rng, draws=40)
    assert [one.row for one in ends] == ["raw", "raw"]  # nothing at rest to subtract
    show("end errors inside the draws", [one.covered for one in ends])
    assert all(one.covered[0] for one in ends)
    found = compare_held_out(prepared, rng=rng, lengths_s=(5.0,))
    pitch = [np.degrees(np.nanmedian(one.errors.pitch)) for one in found]
    show("held out, largest pitch difference in 5 s, deg", pitch, 0.5)
    assert len(pitch) == 2
    assert max(pitch) < 0.5
