"""Sync of recordings: clocks by the motion that two of them share; given recordings, shifted and skewed, and drawn ones."""

import gzip
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from testkit.data import data_path, show
from testkit.hand_turns import hidden, later, make_recording, turning_rate
from undrift.errors import AlignmentError, InputError
from undrift.io.formats import read_record
from undrift.record import Record, Reference
from undrift.sync import shared_motion, with_gaps

# Stated before any result was seen
WITHIN_S = 1e-3
COVERED = 0.92  # of a hundred draws at 95 %: two standard deviations of a binomial count below
DRAWS = 100


def chain(trial, what="imu"):
    rows = np.genfromtxt(
        data_path("chain_with_optics", f"seg2_trial{trial}_{what}.csv.gz"), delimiter=",", skip_header=3
    )
    if what == "optics":
        return Reference(time=np.arange(len(rows)) / 30.0, q_nb=rows[:, -4:])
    return Record(time=np.arange(len(rows)) / 40.0, gyro=rows[:, 3:6], accel=rows[:, :3])


def robot(path, place):
    rows = np.genfromtxt(data_path("robot_arm_reference", f"{path}_{place}_imu.csv.gz"), delimiter=",", skip_header=1)
    return Record(time=np.arange(len(rows)) / 125.0, gyro=rows[:, 4:7])


def pendulum(segment, test="02b"):
    path = data_path("pendulum_with_optics", f"Pendulum_Test{test}_Trial1_Segment_{segment}.csv.gz")
    lines = gzip.decompress(path.read_bytes()).decode().splitlines()[2:]
    rows = np.array([[float(x) for x in line.replace(",", ".").split(";")[:11]] for line in lines])
    forward = np.concatenate(([True], rows[1:, 0] > np.maximum.accumulate(rows[:-1, 0])))
    return Record(time=rows[forward, 0], gyro=rows[forward, 8:11])


def worn():
    rows = np.genfromtxt(data_path("worn_lowback", "HA_001_Test11.csv.gz"), delimiter=",", names=True)
    gyro = np.stack([rows[name] for name in rows.dtype.names if name.startswith("gyr")], axis=1)
    return Record(time=np.arange(len(gyro)) / 100.0, gyro=gyro, gyro_unit="dps")


def two_of(record, rng):
    """Every other sample of a recording, as two sensors would have them: noise of their own, one clock, another mounting."""
    first, other = (Record(time=record.time[k::2], gyro=record.gyro[k::2]) for k in (0, 1))
    return first, replace(other, gyro=other.gyro @ Rotation.random(random_state=rng).as_matrix().T * 1.03 + 0.2)


def moved(one, offset_s, skew, about_s=0.0):
    """The same on a clock of its own."""
    return replace(one, time=one.time + offset_s + skew * (one.time - about_s))


def errors(found, offset_s, skew):
    """What a found clock makes wrong at start, middle and end of what is shared, s, and what it states."""
    at = np.array([found.span_s[0], np.mean(found.span_s), found.span_s[1]])
    wrong = found.happened(at + offset_s + skew * at) - at
    return wrong, np.array([found.uncertainty_s(float(t)) for t in at])


GIVEN = {
    "low back": worn,
    **{
        name: lambda name=name: read_record(data_path("broad", f"{name}.hdf5"))
        for name in (
            "02_undisturbed_slow_rotation_B",
            "09_undisturbed_fast_rotation_with_breaks_B",
            "24_disturbed_tapping_A",
        )
    },
}
# Halves that sample fast hand motion at 20 Hz, which aliases, or have stamps rounded to 1 ms with rows lost: 1 ms is not reached
COARSE = {
    "chain 1": lambda: chain(1),
    "chain 2": lambda: chain(2),
    "pendulum 1": lambda: pendulum(1),
    "pendulum 2": lambda: pendulum(2),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", [*GIVEN, *COARSE])
def test_two_halves_of_a_given_recording_shifted_and_skewed_are_found(name):
    rng = np.random.default_rng((*GIVEN, *COARSE).index(name))
    first, other = two_of((GIVEN | COARSE)[name](), rng)
    offset_s, skew = rng.uniform(-8.0, 8.0), rng.uniform(-2e-4, 2e-4)
    found = shared_motion(first, moved(other, offset_s, skew))
    wrong, stated = errors(found, offset_s, skew)
    show(f"{name}: wrong at start, middle, end, ms; stated", (1e3 * wrong).round(3), (1e3 * stated).round(3))
    assert found.shares
    assert (np.abs(wrong) <= stated).all()
    assert name in COARSE or np.abs(wrong).max() < WITHIN_S


@pytest.mark.slow
@pytest.mark.parametrize("trial", [1, 2])
@pytest.mark.parametrize("what", ["optics", "imu_soft"])
def test_a_given_recording_beside_another_device_is_found_again_within_1_ms_once_it_is_shifted_and_skewed(trial, what):
    """Optics and a sensor on foam: separate devices, each begun on its own. What is found must move by what was done."""
    rng = np.random.default_rng(trial)
    first, other = chain(trial), chain(trial, what)
    before = shared_motion(first, other)
    offset_s, skew = rng.uniform(-30.0, 30.0), rng.uniform(-3e-4, 3e-4)
    part = other if what == "optics" else other.between(5.0, 60.0)
    found = shared_motion(first, moved(hidden(part, 20.0, 23.0) if what == "optics" else part, offset_s, skew))
    at = np.array([found.span_s[0], found.middle_s, found.span_s[1]])
    own = at + before.offset_s + before.skew * (at - before.middle_s)
    wrong = found.happened(own + offset_s + skew * own) - at
    show(
        f"chain {trial}, {what}: late by {1e3 * before.offset_s:.2f} +- {1e3 * before.uncertainty_s():.2f} ms; moved, ms",
        (1e3 * wrong).round(3),
    )
    assert found.shares
    assert np.abs(wrong).max() < WITHIN_S


@pytest.mark.slow
def test_a_sensor_on_foam_is_late_by_no_more_than_is_stated():
    """Rows start together (SOURCE.md): what the foam delays is not seen from the rates, and stated as motion of its own."""
    for trial in (1, 2):
        found = shared_motion(chain(trial), chain(trial, "imu_soft"))
        show(f"foam {trial}: late, ms; stated", round(1e3 * found.offset_s, 2), round(1e3 * found.uncertainty_s(), 2))
        assert found.shares
        assert 1e-3 < abs(found.offset_s) < found.uncertainty_s() < 0.02


@pytest.mark.slow
@pytest.mark.parametrize(
    ("first", "other"),
    [
        (lambda: pendulum(1), lambda: pendulum(2)),
        (lambda: pendulum(1, "02a"), lambda: pendulum(2, "02a")),
        (lambda: robot("circle-100", "carpus"), lambda: robot("circle-100", "radius")),
        (lambda: robot("circle-150", "carpus"), lambda: robot("circle-150", "radius")),
        (lambda: robot("circle-250", "carpus"), lambda: robot("circle-250", "radius")),
        (lambda: chain(1), lambda: chain(2)),
        (lambda: pendulum(1, "02a"), lambda: pendulum(1, "02b")),
        (worn, lambda: chain(1)),
    ],
    ids=["pendulum b", "pendulum a", "arm 100", "arm 150", "arm 250", "two trials", "two swings", "two people"],
)
def test_neighbouring_segments_and_other_motions_have_no_clock(first, other):
    """A pendulum's segments correlate best half a period apart, joints of a planar arm anywhere."""
    found = shared_motion(first(), other())
    show("correlation, times what the next lag leaves", round(found.correlation, 3), round(found.rival, 2))
    assert not found.shares


def test_gaps_stand_where_rows_are_missing(pair):
    record, reference = pair
    part = np.ones(len(record), bool)
    part[1000:1100] = False
    torn = replace(record, time=record.time[part], gyro=record.gyro[part], accel=record.accel[part])
    whole = with_gaps(torn)
    np.testing.assert_allclose(whole.time, record.time, atol=1e-9)
    assert (np.isnan(whole.gyro).any(axis=1), np.isnan(whole.accel).any(axis=1))[0][1000:1100].all()
    assert np.isnan(whole.gyro).sum() == 300
    np.testing.assert_array_equal(whole.gyro[part], torn.gyro)
    seen = reference.valid & ((reference.time < 5.0) | (reference.time > 5.5))
    poses = replace(reference, time=reference.time[seen], q_nb=reference.q_nb[seen], moving=reference.moving[seen])
    assert (~with_gaps(poses).valid).sum() == (~seen).sum()
    assert with_gaps(record) is record


def test_optics_and_a_record_with_gaps_are_aligned_in_either_order(pair):
    record, reference = pair
    torn = hidden(later(reference, 3.2), 12.0, 20.0)
    for first, other, sign in ((record, torn, 1.0), (torn, record, -1.0)):
        found = shared_motion(first, other)
        assert found.offset_s == pytest.approx(sign * 3.2, abs=min(1e-4, found.uncertainty_s(found.middle_s)))
        assert found.skew == pytest.approx(0.0, abs=1e-5)


@pytest.fixture(scope="module")
def pair():
    return make_recording(np.random.default_rng(1), turn_s=30.0)


def test_what_does_not_turn_has_no_clock(pair):
    record, _ = pair
    still = replace(record, gyro=np.zeros_like(record.gyro))
    with pytest.raises(AlignmentError, match="wanted two recordings that turn together"):
        shared_motion(record, still)
    with pytest.raises(InputError, match="wanted a record with a gyroscope"):
        shared_motion(record, Record(time=record.time, accel=record.accel))


def drawn_pair(rng):
    """Two sensors on one body: rates, mounting, offset, noise, shift, skew and lost rows drawn."""
    seed, turn_s = int(rng.integers(1 << 31)), rng.uniform(15.0, 45.0)
    offset_s, skew = rng.uniform(-20.0, 20.0), rng.uniform(-3e-4, 3e-4)
    made = []
    for k, hz in enumerate(rng.choice((40.0, 50.0, 100.0, 128.0, 200.0, 286.0), 2)):
        true = np.arange(rng.uniform(0.0, 2.0), turn_s + 6.0, 1.0 / hz)
        rate = turning_rate(true, np.random.default_rng(seed), rest_s=3.0, turn_s=turn_s, speed=0.5)
        gyro = rate @ Rotation.random(random_state=rng).as_matrix().T * rng.uniform(0.97, 1.03)
        gyro = gyro + rng.normal(0.0, 0.01, 3) + 10.0 ** rng.uniform(-3.5, -1.7) * rng.normal(size=gyro.shape)
        lost = np.ones(len(true), bool)
        lost[(start := rng.integers(len(true) - 60)) : start + rng.integers(60)] = False
        record = Record(time=true[lost], gyro=gyro[lost])
        made.append(moved(record, offset_s, skew) if k else record)
    return *made, offset_s, skew


@pytest.mark.slow
def test_stated_uncertainties_hold_over_drawn_clocks_noise_and_axes():
    rng, inside, worst = np.random.default_rng(19), [], []
    for _ in range(DRAWS):
        first, other, offset_s, skew = drawn_pair(rng)
        found = shared_motion(first, other)
        assert found.shares
        wrong, stated = errors(found, offset_s, skew)
        inside.append(np.abs(wrong) <= stated)
        worst.append((np.abs(wrong).max(), stated.max()))
    covered, worst = np.mean(inside, axis=0), 1e3 * np.array(worst)
    show("drawn clocks inside 95 % at start, middle, end", covered, COVERED)
    show("largest error, ms: median, 95 %, most; stated: median, most", np.quantile(worst[:, 0], (0.5, 0.95, 1.0)).round(3),
         np.quantile(worst[:, 1], (0.5, 1.0)).round(3))  # fmt: skip
    assert (covered >= COVERED).all()
    assert np.quantile(worst[:, 0], 0.95) < 1e3 * WITHIN_S


@pytest.mark.parametrize("lost_s", [0.01, 0.03])
def test_rows_that_are_lost_without_a_trace_are_in_the_uncertainty(pair, lost_s):
    record, _ = pair
    late = record.time > 23.0
    cut = np.concatenate((np.flatnonzero(~late), np.flatnonzero(late)[round(200.0 * lost_s) :]))
    jump = replace(record, time=record.time[: len(cut)], gyro=record.gyro[cut], accel=record.accel[cut])
    found = shared_motion(record, jump)
    at = np.array([10.0, 22.0, 24.0, 36.0])
    wrong = found.happened(at - lost_s * (at > 23.0)) - at
    show(f"{1e3 * lost_s:g} ms lost: wrong, ms; stated", (1e3 * wrong).round(1), round(1e3 * found.uncertainty_s(), 1))
    assert np.abs(wrong).max() < found.uncertainty_s() < 2.0 * lost_s
