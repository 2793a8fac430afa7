"""The offset that motion shows: intervals hold on simulated people, it follows the device, gravity bears it out on real trials."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import binom

from testkit.data import show
from undrift.arrays import FloatArray
from undrift.correction.correct import correct_checked
from undrift.correction.motion import STRETCH_S, fit_motion
from undrift.correction.rest import MOVED, RemainingOffset, find_rest_offset
from undrift.errors import InputError
from undrift.model import MATRIX_NAMES, MOVING_NAMES, OFFSET_NAMES
from undrift.orientation import OrientSettings, orient
from undrift.record import Record
from undrift.sim.device.presets import random_device
from undrift.sim.device.simulate import simulate_device
from undrift.sim.device.truth import true_calibration
from undrift.sim.motion.tasks import TaskName, draw_task
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY
from undrift.validation.expected import offset_answer

RATE_HZ = 50.0


def worn(seed: int, name: TaskName, scale: float = 1e-3) -> tuple[Record, np.ndarray, np.ndarray]:
    """Return what a calibration with errors of its own leaves of a drawn task, its true mean offset, and one a rest would show."""
    rng = np.random.default_rng(seed)
    task = draw_task(name, rng=rng)
    motion = task.at(np.arange(round(task.duration_s * RATE_HZ)) / RATE_HZ, STANDARD_GRAVITY)
    device = random_device(rng)
    calibration = true_calibration(device, temp_c=25.0)
    assert calibration.gyro is not None
    assert calibration.accel is not None
    gyro = replace(calibration.gyro, matrix=calibration.gyro.matrix @ (np.eye(3) + scale * rng.standard_normal((3, 3))))
    accel = replace(calibration.accel, offset=calibration.accel.offset + 0.02 * rng.standard_normal(3))
    done = correct_checked(
        simulate_device(device, motion, rng=rng).record, replace(calibration, gyro=gyro, accel=accel), check=False
    ).record
    moved = MOVED * rng.standard_normal(3)
    rate = np.asarray(done.gyro) + moved
    return replace(done, gyro=rate), (rate - motion.mean_rate_b).mean(axis=0), moved


@pytest.mark.slow
@pytest.mark.parametrize("devices", [15, 300])
@pytest.mark.parametrize(("name", "raw"), [("free", False), ("free", True), ("posturography", False)])
def test_intervals_hold_the_offset_of_people_who_move(name: TaskName, raw: bool, devices: int) -> None:
    errors, stated, before = [], [], []
    for seed in range(devices):
        record, true, moved = worn(seed, name)
        if raw:  # accelerometers as data sheets have them
            rng = np.random.default_rng(900 + seed)
            wrong = np.eye(3) + 0.02 * rng.standard_normal((3, 3))
            record = replace(record, accel=record.accel @ wrong.T + 0.3 * rng.standard_normal(3))
        rest = find_rest_offset(record)
        rest = replace(rest, rate=rest.rate - moved)  # at rest the offset was another
        offset = fit_motion(record, rest).offset
        errors.append(offset.rate[0] - true)
        stated.append(np.sqrt(np.diag(offset.covariance[0])))
        before.append(rest.mean - true)
    error, sigma, first = (np.degrees(item) for item in (errors, stated, before))
    inside = int((np.abs(error) < 1.96 * sigma).sum())
    ratio = float(np.sqrt((error**2).mean() / (sigma**2).mean()))
    show(f"{name}, inside 95 %, rmse over stated", (inside / error.size, ratio), "0.90 to 0.98")
    show(
        "rmse by axis with the rest alone, with motion, deg/s",
        np.sqrt([(first**2).mean(axis=0), (error**2).mean(axis=0)]).round(4).tolist(),
    )
    low = binom.ppf(0.001, error.size, 0.90)
    assert inside >= low
    assert 0.7 < ratio < 1.3
    # people stay upright: z keeps what the rest says
    assert (error[:, :2] ** 2).sum() < 0.3 * (first[:, :2] ** 2).sum()


def swaying(seconds: float, drift: np.ndarray) -> Record:
    """Return somebody who leans to and fro by 10 deg about x and y, whose offset drifts evenly by a vector (3,), rad/s."""
    time = np.arange(round(20.0 * seconds)) / 20.0
    lean = np.stack((np.sin(0.7 * time), np.cos(0.5 * time), np.zeros_like(time)), axis=1) * np.radians(10.0)
    turned = Rotation.from_rotvec(lean)
    rate = np.vstack(((turned[:-1].inv() * turned[1:]).as_rotvec() * 20.0, np.zeros(3)))
    # a rate leads to its own sample
    rate = np.roll(rate, 1, axis=0) + np.linspace(-0.5, 0.5, len(time))[:, None] * drift
    force = turned.inv().apply([0.0, 0.0, STANDARD_GRAVITY]) + 0.1 * np.random.default_rng(1).standard_normal(
        (len(time), 3)
    )
    return Record(time=time, gyro=rate, accel=force, state="corrected")


def swinging() -> Record:
    """Return 90 s of a sensor near the pivot of a pendulum: 30 deg about y, 8 deg about x, at 0.5 Hz, with no offset."""
    time = np.arange(9000) / 100.0
    phase = np.pi * time
    angles = np.stack((8.0 * np.sin(phase), 30.0 * np.cos(phase), np.zeros_like(phase)), axis=1)
    turned = Rotation.from_euler("xyz", angles, degrees=True)
    rate = np.vstack((np.zeros(3), (turned[:-1].inv() * turned[1:]).as_rotvec() * 100.0))
    position = turned.apply([0.0, 0.0, -0.3])
    acceleration = np.gradient(np.gradient(position, 0.01, axis=0), 0.01, axis=0)
    force = turned.inv().apply(acceleration + np.array([0.0, 0.0, STANDARD_GRAVITY]))
    noise = np.random.default_rng(2).standard_normal((2, len(time), 3))
    return Record(time=time, gyro=rate + 1e-3 * noise[0], accel=force + 0.02 * noise[1], state="corrected")


def test_swings_do_not_determine_the_offset_about_the_vertical() -> None:
    offset = fit_motion(swinging(), None).offset
    errors = np.abs(np.degrees(offset.mean))
    show(
        "offset of a pendulum, largest over its uncertainty", float((errors / np.degrees(offset.deviation)).max()), 2.0
    )
    assert (errors < 2.0 * np.degrees(offset.deviation)).all()
    assert offset.deviation[2] > 0.9 * offset.prior[2] > 5.0 * offset.deviation[:2].max()
    assert "correct.motion_offset_kept" in [finding.code for finding in offset.findings]


def known(rate: FloatArray) -> RemainingOffset:
    """Return an offset (3,) that a rest of a second determines exactly."""
    zero = np.zeros((1, 3, 3))
    return RemainingOffset(time=np.array([0.5]), rate=rate[None], covariance=zero, rest_s=(0.0, 1.0), moved=0.0)


def test_offset_of_a_long_recording_is_followed() -> None:
    drift = np.radians([0.03, -0.02, 0.0])
    offset = fit_motion(
        swaying(4.0 * STRETCH_S, drift),
        known(-0.5 * drift),
    ).offset
    assert offset.rate.shape == (4, 3)
    true = ((np.arange(4) + 0.5) / 4.0 - 0.5)[:, None] * drift
    off = np.degrees(offset.rate - true)[:, :2]
    show("errors of four stretches about x and y, deg/s", np.abs(off).max(), 0.003)
    assert np.abs(off).max() < 0.003
    np.testing.assert_allclose(offset.at(offset.time), offset.rate)


def test_orient_states_what_motion_shows_and_drifts_less() -> None:
    record, _, _ = worn(5, "free")
    later = np.where(record.time > 8.0, 0.03 * RADIAN_PER_DEGREE, 0.0)[:, None] * np.array([1.0, 0.0, 0.0])
    record = replace(record, gyro=np.asarray(record.gyro) + later)
    rest, moved = (orient(record, settings=OrientSettings(offset=offset)) for offset in ("rest", "motion"))
    assert "correct.offset_subtracted" in [finding.code for finding in moved.findings]
    result = float((moved.offset - rest.offset)[0]) / RADIAN_PER_DEGREE
    show("offset about x that came after the rest, deg/s", result, "0.03")
    assert result == pytest.approx(0.03, abs=0.015)
    assert MOVED < moved.offset_uncertainty < 0.8 * rest.offset_uncertainty  # both count the change from rest to motion


@pytest.mark.slow
@pytest.mark.parametrize("devices", [8, 60])
def test_offset_is_found_without_a_rest(devices: int) -> None:
    away, stated = [], []
    for seed in range(devices):
        record, true, _ = worn(seed, "free")
        far = 0.3 * RADIAN_PER_DEGREE * np.random.default_rng(seed).standard_normal(3)
        offset = fit_motion(replace(record, gyro=np.asarray(record.gyro) + far), None).offset
        assert offset.rest_s is None
        away.append(offset.rate.mean(axis=0) - true - far)
        stated.append(np.sqrt(np.diagonal(offset.covariance, axis1=1, axis2=2).mean(axis=0)))
    inside = np.abs(away) < 1.96 * np.array(stated)
    show("inside 95 %, without a rest", f"{inside.mean():.1%}")
    # A start far away left walks of the attitude that explained it, with errors of 0.3 deg/s about level axes.
    assert np.median(np.abs(away)[:, :2]) < 0.01 * RADIAN_PER_DEGREE
    assert inside.mean() > 0.9  # of 30 other people 97.8 % held: 1.6 times of what the equations state is stated


@pytest.mark.parametrize(("stated_dps", "wanted_dps"), [(0.001, 0.005), (1.0, 0.02)])
def test_fitted_change_to_motion_replaces_the_assumed_one(stated_dps: float, wanted_dps: float) -> None:
    record, _, _ = worn(5, "free")
    rest = replace(find_rest_offset(record), covariance=np.zeros((1, 3, 3)))
    gyro = true_calibration(random_device(np.random.default_rng(5)), temp_c=25.0).gyro
    assert gyro is not None
    model = replace(
        gyro,
        parameters=(*MATRIX_NAMES, *OFFSET_NAMES, *MOVING_NAMES),
        moving_offset=np.zeros(3),
        covariance=np.diag(np.repeat((0.0, (stated_dps * RADIAN_PER_DEGREE) ** 2), (12, 3))),
    )
    before = [fit_motion(record, rest, item).offset.prior / RADIAN_PER_DEGREE for item in (None, model)]
    np.testing.assert_allclose(before, [[0.02] * 3, [wanted_dps] * 3], rtol=0.05)


def test_rate_error_moves_the_offset_as_stated() -> None:
    record, *_ = worn(4, "free")
    rest = find_rest_offset(record)
    rates = np.asarray(record.gyro)
    first = fit_motion(record, rest).offset
    done = replace(record, gyro=rates - first.at(record.time))
    answer = offset_answer(done, first.prior, np.asarray(done.gyro))
    for axis, channel in ((0, 0), (1, 0), (2, 2)):
        moved = []
        for size in (5e-4, -5e-4):  # half the difference, as the sizes are sought anew each time
            wrong = np.zeros((3, 3))
            wrong[axis, channel] = size
            other = fit_motion(replace(record, gyro=rates + np.asarray(done.gyro) @ wrong.T), rest).offset
            moved.append(0.5 * other.rate[0] / size)
        stated = answer[:, axis, channel]
        show(f"offset by an error {'xyz'[axis]}{'xyz'[channel]}, found and stated", [sum(moved), stated], "0.01 apart")
        assert sum(moved) == pytest.approx(stated, abs=0.01)
        assert np.abs(stated).max() > 0.03
    short = done.part(0, round(4.0 * RATE_HZ))
    assert not offset_answer(short, first.prior, np.asarray(short.gyro)).any()


def with_a_gap(record: Record) -> Record:
    accel = np.array(record.accel)
    accel[7] = np.nan
    return replace(record, accel=accel)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda record: record.part(0, 200), "got 9.95 s"),
        (with_a_gap, "got 1 gaps"),
        (lambda record: replace(record, accel=None), "specific force"),
    ],
)
def test_recordings_whose_motion_shows_no_offset_are_refused(change, words) -> None:
    with pytest.raises(InputError, match=words):
        fit_motion(change(swaying(30.0, np.zeros(3))), known(np.zeros(3)))
