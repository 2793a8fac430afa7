"""Twins: white noise at rest, refusals, and recordings that begin and end in motion."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.data import show
from testkit.hand_turns import Device, make_recording
from undrift.errors import InputError, NotObservable
from undrift.record import Record, Reference
from undrift.twin.accel import match, prepare_accel, solve_accel
from undrift.twin.fit import fit_twin, rest_noise
from undrift.twin.held_out import compare_held_out
from undrift.units import STANDARD_GRAVITY

RATE_HZ = 400.0


def at_rest(seed, *, walk=1e-4, step=0.0, sway=0.0):
    rng = np.random.default_rng(seed)
    time = np.arange(24000) / RATE_HZ
    noise = walk * np.sqrt(RATE_HZ) * rng.standard_normal((len(time), 3))
    noise += sway * np.sin(2.0 * np.pi * 0.3 * time)[:, None]
    if step:
        noise = np.rint(noise / step) * step
    return Record(time=time, gyro=noise)


@pytest.mark.parametrize("sway", [0.0, 2e-3])
def test_white_noise_lies_within_its_standard_error(sway):
    noise = rest_noise([at_rest(1, sway=sway)], "gyro")
    assert np.abs((noise.random_walk - 1e-4) / noise.random_walk_error).max() < 4.0
    assert noise.random_walk_error.max() < 1.5e-6


def test_noise_of_the_codes_is_removed():
    step = 2e-3  # as large as the noise
    assert rest_noise([at_rest(2, step=step)], "gyro", step=step).random_walk == pytest.approx(
        np.full(3, 1e-4), rel=0.03
    )


@pytest.fixture(scope="module")
def pair():
    return make_recording(np.random.default_rng(1), turn_s=30.0, optics_noise=3e-4)


def placed(reference: Reference) -> Reference:
    return replace(reference, position=np.zeros((len(reference), 3)))


def fit_accel(recording):
    return solve_accel(prepare_accel([recording], gravity_m_s2=STANDARD_GRAVITY))


def test_one_recording_leaves_none_to_hold_out(pair):
    with pytest.raises(InputError, match="two recordings"):
        compare_held_out(fit_twin([pair[0]], [pair[1]]), rng=np.random.default_rng(0))


def test_poses_without_positions_tell_nothing_of_the_accelerometer(pair):
    with pytest.raises(InputError, match="positions of the reference"):
        fit_accel(match(*pair))
    twin = fit_twin([pair[0]], [pair[1]])
    lost = {p.name: p.reason for p in twin.parameters if not p.identifiable}
    assert "positions of the reference" in lost["lever_arm"]
    assert twin.accel is None


def test_short_motion_is_refused(pair):
    record, reference = make_recording(np.random.default_rng(2), turn_s=12.0)
    with pytest.raises(NotObservable, match="20 s or more of motion"):
        fit_accel(match(record, placed(reference)))


@pytest.mark.slow
def test_recordings_that_begin_and_end_in_motion_make_a_twin_that_predicts_them() -> None:
    rng = np.random.default_rng(8)
    forward, offset = np.eye(3) + 0.01 * rng.standard_normal((3, 3)), np.radians([0.5, -0.3, 0.8])
    pairs = []
    for change in np.radians([[0.03, 0.0, -0.03], [-0.03, 0.03, 0.0]]):
        device = Device(forward=forward, offset=offset + change, noise=1e-3)
        record, reference = make_recording(rng, device, turn_s=40.0, optics_hz=30.0, optics_noise=3e-4, mark=False)
        pairs.append((record.between(10.0, 46.0), reference))
    records, references = zip(*pairs, strict=True)
    twin = fit_twin(records, references)
    assert [m.span.rested for m in twin.prepared.matches] == [False, False]
    model = twin.gyro.triad.model
    error = model.matrix - np.linalg.inv(forward)
    show("matrix off by", np.abs(error).max(), 2e-3)
    assert np.abs(error).max() < 2e-3
    np.testing.assert_allclose(np.degrees(model.offset - offset), 0.0, atol=0.1)  # 0.1 deg/s between switch-ons
    (lost,) = (one for one in twin.parameters if one.name == "gyro_motion_offset")
    assert "No recording contains a rest" in lost.reason
    assert twin.gyro_noise is None
    found = compare_held_out(twin, rng=rng, lengths_s=(5.0,))
    pitch = [np.degrees(np.nanmedian(one.pitch)) for one in found]
    show("held out, largest pitch difference in 5 s, deg", pitch, 0.5)
    assert len(pitch) == 2
    assert max(pitch) < 0.5
