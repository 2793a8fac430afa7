"""A twin of recordings that begin and end in motion predicts a recording held out."""

import numpy as np
import pytest

from testkit.data import show
from testkit.hand_turns import Device, make_recording
from undrift.twin.fit import fit_twin
from undrift.twin.held_out import compare_held_out


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
    assert "No recording rests" in lost.reason
    assert twin.gyro_noise is None
    found = compare_held_out(twin, rng=rng, lengths_s=(5.0,))
    pitch = [np.degrees(np.nanmedian(one.pitch)) for one in found]
    show("held out, largest pitch difference in 5 s, deg", pitch, 0.5)
    assert len(pitch) == 2
    assert max(pitch) < 0.5
