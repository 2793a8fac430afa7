"""Still phases, plateaus, rotations and faces: on simulated records and on every kind of real one."""

import numpy as np
import pytest

from testkit.data import data_path, show
from testkit.faces import faces_at
from testkit.recordings import nilspod
from undrift.errors import InputError
from undrift.record import Record
from undrift.segments import StillSettings, find_still, find_turns, sliding_moments, unpadded

FS = 100.0


def jig(name):
    d = np.load(data_path("ratetable_jig", f"{name}.npz"))
    return Record(time=d["t_imu"], gyro=d["gyro_bno_dps"], accel=d["acc_bno_g"], gyro_unit="dps", accel_unit="g")


def worn(**change):
    d = np.genfromtxt(data_path("worn_lowback", "HA_001_Test11.csv.gz"), delimiter=",", skip_header=1)
    values = {"gyro": d[:, 4:7], "accel": d[:, 1:4], "gyro_unit": "dps", "accel_unit": "g", **change}
    return Record(time=np.arange(len(d)) / 100.0, **values)


def poses(rng, directions, noise=0.02, still_s=5.0, move_s=2.0):
    """Hold each direction of gravity, then move to the next one at a rate of two rad/s about x."""
    accel, gyro = [], []
    for k, direction in enumerate(directions):
        n = int(still_s * FS)
        accel.append(np.tile(np.asarray(direction, float) * 9.81, (n, 1)))
        gyro.append(np.zeros((n, 3)))
        if k + 1 < len(directions):
            m = int(move_s * FS)
            phase = np.sin(np.linspace(0.0, np.pi, m))[:, None]
            accel.append(np.linspace(direction, directions[k + 1], m) * 9.81 + 2.0 * phase)
            gyro.append(np.array([[2.0, 0.0, 0.0]]) * phase)
    accel, gyro = np.concatenate(accel), np.concatenate(gyro)
    return Record(
        time=np.arange(len(accel)) / FS,
        accel=accel + noise * rng.standard_normal(accel.shape),
        gyro=gyro + 0.1 * noise * rng.standard_normal(gyro.shape) + 0.05,
    )


def test_a_window_that_touches_a_gap_is_never_still():
    values = np.zeros((50, 3))
    values[25, 1] = np.nan
    _, spread = sliding_moments(values, 10, 1)
    assert np.isinf(spread[16:26]).all()
    assert np.isfinite(spread[:16]).all()
    assert np.isfinite(spread[26:]).all()


def test_held_poses_are_found():
    record = poses(np.random.default_rng(1), [(1, 0, 0), (0, 1, 0), (0, 0, 1), (-1, 0, 0), (0, -1, 0), (0, 0, -1)])
    search = find_still(record)
    assert len(search.stills) == 6
    assert search.reason == ""
    for k, still in enumerate(search.stills):
        start, stop = 700 * k, 700 * k + 500
        assert start <= still.start <= start + 70
        assert stop - 70 <= still.stop <= stop


def test_rests_of_a_log_with_two_decimals_are_found():
    readings = np.loadtxt(data_path("multipos_mpu9150", "imu2.log.gz"))  # accel m/s2, gyro rad/s

    def count(decimals):
        rounded = np.round(readings, decimals)
        record = Record(time=np.arange(len(readings)) / FS, gyro=rounded[:, 3:], accel=rounded[:, :3])
        return len(find_still(record).stills)

    assert count(2) == count(5) == 22


def test_a_threshold_in_noise_floors_is_used():
    record = poses(np.random.default_rng(3), [(1, 0, 0), (0, 1, 0)])
    search = find_still(record, StillSettings(threshold_floors=6.0))
    assert len(search.stills) == 2
    nothing = find_still(record, StillSettings(threshold_floors=1e-6))
    assert nothing.stills == ()
    assert "too short" in nothing.reason


def test_a_record_shorter_than_a_window_says_so():
    record = Record(time=np.arange(50) / FS, gyro=np.zeros((50, 3)))
    with pytest.raises(InputError, match=r"got 0\.49 s"):
        find_still(record)


def rates_of(record, turns, stills):
    """Return the mean reading of each plateau minus the offset at rest."""
    rest = np.concatenate([record.gyro[still.start : still.stop] for still in stills]).mean(axis=0)
    return np.array([record.gyro[turn.start : turn.stop].mean(axis=0) for turn in turns.plateaus]) - rest


def test_steady_turn_is_a_plateau_and_no_still_phase():
    rng = np.random.default_rng(4)
    rate = np.concatenate(
        [np.zeros(800), np.full(800, 20.0), np.zeros(800), np.full(800, 25.0), np.full(800, 26.5), np.zeros(800)]
    )
    gyro = np.column_stack((np.zeros_like(rate), np.zeros_like(rate), rate)) + rng.normal(1.0, 0.05, (len(rate), 3))
    record = Record(time=np.arange(len(rate)) / FS, gyro=gyro, gyro_unit="dps")
    search = find_still(record)
    assert len(search.stills) == 3
    assert all(np.abs(rate[s.start : s.stop]).max() == 0.0 for s in search.stills)
    turns = find_turns(record, search.stills)
    assert [t.axis for t in turns.plateaus] == ["z", "z", "z"]
    # 800 samples of 0.05 deg/s noise, smoothed: means are good to 0.002 deg/s; 0.01 is five sigma
    np.testing.assert_allclose(rates_of(record, turns, search.stills)[:, 2], [20.0, 25.0, 26.5], atol=0.01)


def test_rotations_between_stills_carry_their_angle():
    record = poses(np.random.default_rng(5), [(1, 0, 0), (0, 1, 0), (0, 0, 1)])
    turns = find_turns(record, find_still(record).stills)
    assert [t.axis for t in turns.rotations] == ["x", "x"]
    # half a sine of 2 rad/s over 2 s: 2 * 2 / (pi / 2) rad
    np.testing.assert_allclose(turns.rotation_angle[:, 0], 8.0 / np.pi, rtol=0.01)


def test_faces_are_named_after_the_axis_that_points_up():
    directions = [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1), (0.6, 0.8, 0.0)]
    record = poses(np.random.default_rng(6), directions)
    stills = find_still(record).stills
    assert faces_at(record, stills) == ["+x", "-x", "+y", "-y", "+z", "-z", None]
    counts = Record(time=record.time, accel=record.accel * 400.0 + 32768.0, accel_unit="count")
    assert faces_at(counts, stills) == ["+x", "-x", "+y", "-y", "+z", "-z", None]
    with pytest.raises(InputError, match="got 2"):
        faces_at(counts, stills[:2])


@pytest.mark.parametrize("missing", ["", "gyro", "accel"])
def test_real_session_shows_six_faces_and_three_turns(missing):
    record = nilspod()
    if missing:
        record = Record(
            time=record.time,
            gyro=None if missing == "gyro" else record.gyro,
            accel=None if missing == "accel" else record.accel,
            gyro_unit="dps",
        )
    search = find_still(record)
    show(f"ferraris still phases without {missing or 'nothing'}", len(search.stills), 13)
    assert len(search.stills) == 13
    if missing != "gyro":
        turns = find_turns(record, search.stills)
        full = np.abs(turns.rotation_angle).max(axis=1) > 300.0
        assert [t.axis for t, is_full in zip(turns.rotations, full, strict=True) if is_full] == ["x", "y", "z"]
        largest = np.sort(np.abs(turns.rotation_angle).max(axis=1))[-3:]
        show("integrals of the three turns, deg", largest, "353.7 359.4 370.0 +- 0.5")
        np.testing.assert_allclose(largest, [353.7, 359.4, 370.0], atol=0.5)
    if missing != "accel":
        assert set(faces_at(record, search.stills)) == {"+x", "-x", "+y", "-y", "+z", "-z"}


@pytest.mark.parametrize("name", ["giro_test_filt"])
def test_rate_table_steps_are_seven_plateaus(name):
    record = jig(name)
    stills = find_still(record).stills
    turns = find_turns(record, stills)
    rates = rates_of(record, turns, stills)
    show(f"{name} plateaus, deg/s", np.round(rates[:, 1], 1), "60 120 180 240 360 540 720 within 1 %")
    assert all(np.abs(record.gyro[s.start : s.stop]).max() < 5.0 for s in stills)
    assert [t.axis for t in turns.plateaus] == ["y"] * 7
    np.testing.assert_allclose(rates[:, 1], [60, 120, 180, 240, 360, 540, 720], rtol=0.01)


@pytest.mark.parametrize(
    "change",
    [{}, {"gyro_unit": "count", "accel_unit": "count"}],
    ids=["all", "units unknown"],
)
def test_a_worn_sensor_has_no_still_phase_and_none_is_invented(change):
    search = find_still(worn(**change))
    show("worn", search.reason)
    assert search.stills == ()
    assert search.reason.startswith("no still phase")


def test_counts_of_a_moving_body_are_no_long_rest() -> None:
    time = np.arange(1400) / 100.0
    rng = np.random.default_rng(3)
    sway = np.sin(2.0 * np.pi * 0.9 * time + 0.4 * np.sin(time))[:, None]
    gyro = np.round(1200.0 * sway * [0.2, 1.0, 0.1] + rng.normal(0.0, 6.0, (1400, 3)))
    accel = np.round([0.0, 0.0, 16384.0] + 1500.0 * sway * [1.0, 0.1, 0.4] + rng.normal(0.0, 40.0, (1400, 3)))
    moving = find_still(Record(time=time, gyro=gyro, accel=accel, gyro_unit="count", accel_unit="count"))
    assert moving.stills == ()
    assert moving.reason
    resting = np.round(rng.normal(0.0, 6.0, (1400, 3)))
    still = find_still(Record(time=time, gyro=resting, gyro_unit="count"))
    assert len(still.stills) == 1


# ---- rows that fill a file up


def padded(record, before, after):
    rows = [np.repeat(v[:1], before, axis=0) for v in (record.gyro, record.accel)]
    ends = [np.repeat(v[-1:], after, axis=0) for v in (record.gyro, record.accel)]
    gyro, accel = (np.concatenate(item) for item in zip(rows, (record.gyro, record.accel), ends, strict=True))
    return Record(time=np.arange(len(gyro)) / 100.0, gyro=gyro, accel=accel)


@pytest.mark.parametrize("moving", [False, True])
def test_rows_that_repeat_at_the_ends_are_left_out(moving):
    rng, t = np.random.default_rng(3), np.arange(1000) / 100.0
    swing = np.stack([np.sin(2.0 * t + k) for k in range(3)], axis=1) * moving
    record = Record(
        time=t, gyro=swing + 1e-3 * rng.normal(size=(1000, 3)), accel=9.81 + swing + 0.01 * rng.normal(size=(1000, 3))
    )
    assert unpadded(record) is record
    done = unpadded(padded(record, 60, 150))
    assert len(done) == len(record)
    np.testing.assert_array_equal(done.gyro, record.gyro)
    assert unpadded(padded(record, 5, 5)).duration_s > record.duration_s  # a chance repeat is none


def test_a_device_that_repeats_its_codes_at_rest_is_not_padded():
    t = np.arange(1000) / 100.0
    smooth = np.where(t > 4.0, np.sin(t - 4.0) ** 3, 0.0)[:, None] * [1.0, 0.5, -0.3]
    for record in (
        Record(time=t, gyro=smooth, accel=9.81 + smooth),  # without noise
        # coarse codes
        Record(time=t, gyro=np.round(20.0 * smooth) / 20.0, accel=9.81 + np.round(20.0 * smooth) / 20.0),
    ):
        assert unpadded(record) is record
