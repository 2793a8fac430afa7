"""What a twin cannot be made of is refused in words."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.hand_turns import make_recording
from undrift.errors import InputError, NotObservable
from undrift.record import Reference
from undrift.twin.accel import match, prepare_accel, solve_accel
from undrift.twin.fit import fit_twin
from undrift.twin.held_out import compare_held_out
from undrift.units import STANDARD_GRAVITY


@pytest.fixture(scope="module")
def pair():
    return make_recording(np.random.default_rng(1), turn_s=30.0, optics_noise=3e-4)


def placed(reference: Reference) -> Reference:
    return replace(reference, position=np.zeros((len(reference), 3)))


def fit_accel(recording):
    return solve_accel(prepare_accel([recording], gravity_m_s2=STANDARD_GRAVITY))


def test_records_and_references_must_match(pair):
    with pytest.raises(InputError, match="one reference"):
        fit_twin([pair[0]], [])


def test_a_record_needs_a_gyroscope(pair):
    record, reference = pair
    with pytest.raises(InputError, match="no gyroscope"):
        match(replace(record, gyro=None), reference)


def test_a_rest_of_gaps_alone_is_no_rest(pair):
    record, reference = pair
    gyro = np.array(record.gyro)
    gyro[record.time < 8.0] = np.nan
    assert np.isnan(match(replace(record, gyro=gyro), reference).rest_offset).all()


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
    with pytest.raises(NotObservable, match="20 s of motion"):
        fit_accel(match(record, placed(reference)))


def test_readings_full_of_gaps_are_refused(pair):
    record, reference = pair
    accel = np.array(record.accel)
    accel[::50] = np.nan
    broken = match(replace(record, accel=accel), placed(reference))
    with pytest.raises(NotObservable, match="no second of motion"):
        prepare_accel([broken], gravity_m_s2=STANDARD_GRAVITY)


def test_one_pose_leaves_matrix_and_offset_together(pair):
    record, reference = pair
    still = replace(placed(reference), q_nb=np.tile(reference.q_nb[0], (len(reference), 1)))
    record = replace(record, accel=np.tile((0.0, 0.0, STANDARD_GRAVITY), (len(record), 1)))
    stuck = replace(match(record, placed(reference)), reference=still)
    flat = replace(stuck, spline=replace(stuck.spline, pieces=match_pieces(still)))
    with pytest.raises(NotObservable, match="the motion determines"):
        fit_accel(flat)


def match_pieces(reference: Reference):
    from undrift.sim.motion.poses import fit_pose_spline

    return fit_pose_spline(reference).pieces
