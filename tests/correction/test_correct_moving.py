"""The change of the offset while a device turns, and what codes lose: batch, stream, rest, exports, files of before."""

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from testkit import twins
from testkit.full_calibration import ROUNDINGS, device, record, tables
from undrift.correction.correct import Corrector, correct_checked
from undrift.correction.rest import rest_offset
from undrift.io.store import read_calibration, write_calibration
from undrift.model import CODE_NAMES, MATRIX_NAMES, MOVING_NAMES, OFFSET_NAMES
from undrift.record import Still
from undrift.segments import find_turning

N = 1200
FIRST = Still(start=0, stop=290)  # a rest of 2.9 s
MOVING, CODE = np.array([0.02, -0.01, 0.03]), np.array([0.4, -0.3, 0.7])  # rad/s, counts
CLOSE = 1e-13


def moving(drift=None, *, code=CODE, **changes):
    model = device(drift=drift, **changes)
    gyro = replace(
        model.gyro, moving_offset=MOVING, code_offset=code,
        parameters=(*MATRIX_NAMES, *OFFSET_NAMES, *MOVING_NAMES, *CODE_NAMES), covariance=np.eye(18) * 1e-6,
    )  # fmt: skip
    return replace(model, gyro=gyro)


def turns_and_rests(calibration, **changes):
    """Two turns between rests, in counts, and the true rates."""
    rng, time = np.random.default_rng(5), np.arange(N) * 0.01
    rate = np.zeros((N, 3))
    rate[300:520], rate[800:900] = rng.normal(size=(220, 3)) * 2.0, (0.2, 0.0, 0.1)
    gyro = np.round(rate @ calibration.gyro.forward_matrix.T + calibration.gyro.offset)
    return record(N, gyro=gyro, time=time, **changes)


def as_at_rest(calibration):
    return replace(calibration, gyro=replace(calibration.gyro, moving_offset=None))


@pytest.mark.parametrize("g", [True, False])
def test_the_change_is_subtracted_while_the_device_turns_alone(g):
    c = moving(g=g)
    r = turns_and_rests(c)
    got, without = (correct_checked(r, item).record for item in (c, as_at_rest(c)))
    u = r.gyro + CODE * np.sign(r.gyro) * (np.abs(r.gyro) > np.abs(CODE))
    w, _ = twins.corrected(c, u, r.accel, r.temp_c)
    np.testing.assert_allclose(without.gyro, w, rtol=0, atol=CLOSE)
    m = twins.turning(w, r.time)
    np.testing.assert_allclose(got.gyro, w - m[:, None] * MOVING, rtol=0, atol=CLOSE)
    if not g:  # forces drawn at random make rates by the g-sensitivity
        assert m[:300].max() == m[640:790].max() == 0.0  # half a second beyond what the low-pass needs
        assert m[303:570].min() == m[805:940].min() == 1.0  # from a few samples on


def test_a_table_of_offsets_is_that_of_rests():
    c = moving(tables(dynamic=None), g=False)
    r = turns_and_rests(c)
    got, without = (correct_checked(r, item).record.gyro for item in (c, as_at_rest(c)))
    m = find_turning(without, r.time)[0]
    np.testing.assert_allclose(got - without, -m[:, None] * MOVING, rtol=0, atol=CLOSE)


@pytest.mark.slow
@settings(max_examples=25, deadline=None)
@given(cuts=st.sets(st.integers(2, N - 2)))
def test_stream_with_turns_equals_the_batch(cuts):
    c = moving()
    r = turns_and_rests(c)
    gyro = np.array(r.gyro)
    gyro[310:320] = np.nan
    r = replace(r, gyro=gyro)
    batch = correct_checked(r, c, threads=3).record.gyro
    bounds = [0, *(k for k in sorted(cuts) if k - 1 not in cuts), N]
    corrector, pieces = Corrector(c), []
    for first, stop in pairwise(bounds):
        pieces.append(corrector.push_checked(r.part(first, stop)).record.gyro)
        saved, corrector = corrector.state, Corrector(c)
        corrector.state = saved
    assert np.concatenate(pieces).tobytes() == batch.tobytes()
    assert np.isnan(batch[310:320]).all()
    assert np.isfinite(batch[320:]).all()


def test_the_rest_is_subtracted_once():
    # What a device reads at rest has moved by 3 counts: the rest takes that, and the turns keep the change to motion.
    c = moving(g=False)
    r = turns_and_rests(c)
    later = replace(r, gyro=np.asarray(r.gyro) + 3.0)
    rest = rest_offset(correct_checked(later, c).record, FIRST)
    gyro = correct_checked(later, c, offset=rest).record.gyro
    np.testing.assert_allclose(gyro[:280].mean(axis=0), 0.0, atol=1e-12)
    before = correct_checked(r, c, offset=rest_offset(correct_checked(r, c).record, FIRST)).record.gyro
    np.testing.assert_allclose(gyro[300:520], before[300:520], rtol=0, atol=2e-3)  # but for codes about zero


def test_the_rest_states_what_is_left_of_the_change_to_motion():
    c = moving(g=False)
    r = turns_and_rests(c, accel=np.tile((0.0, 0.0, 1962.0), (N, 1)))
    rest, assumed = (
        correct_checked(r, item, offset="rest").rest
        for item in (c, replace(c, gyro=replace(c.gyro, moving_offset=None)))
    )
    assert rest.moved == pytest.approx(np.sqrt(3e-6 + 3.0 * np.radians(0.005) ** 2), rel=1e-12)
    assert assumed.moved == pytest.approx(np.sqrt(3.0) * np.radians(0.02), rel=1e-12)
    assert rest.uncertainty == pytest.approx(np.sqrt(np.trace(rest.covariance[0]) + rest.moved**2), rel=1e-12)


def test_files_hold_both_and_those_of_before_are_read(tmp_path):
    result, file = moving(), tmp_path / "calibration.json"
    write_calibration(result, file)
    again = read_calibration(file).gyro
    assert (again.moving_offset == MOVING).all()
    assert (again.code_offset == CODE).all()
    assert again.values[-6:].tolist() == [*MOVING, *CODE]
    tree = json.loads(file.read_text())
    for key in ("moving_offset", "code_offset"):
        del tree["gyro"][key]
    tree["gyro"]["parameters"], tree["gyro"]["covariance"] = [*MATRIX_NAMES, *OFFSET_NAMES], np.eye(12).tolist()
    file.write_text(json.dumps(tree))
    older = read_calibration(file).gyro
    assert older.moving_offset is None
    assert older.code_offset is None


@pytest.mark.parametrize("adc", ROUNDINGS)
def test_fitted_code_offset_replaces_half_a_step(adc):
    plain = moving(g=False)
    c, r = replace(plain, adc=adc), turns_and_rests(plain)
    assert correct_checked(r, c).record.gyro.tobytes() == correct_checked(r, plain).record.gyro.tobytes()
