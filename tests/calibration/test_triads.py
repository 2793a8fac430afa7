"""Gyroscopes and accelerometers of one recording, and a recording and its calibration, are held to one another."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from testkit.broad_trials import trial
from testkit.data import data_path, show
from undrift import Record
from undrift.calibration.triads import check_triads, find_disagreement
from undrift.errors import Implausible
from undrift.units import STANDARD_GRAVITY

RATE_HZ = 100.0


def turned_by_hand(seconds: float = 40.0, *, seed: int = 3, reach_m: float = 0.15) -> Record:
    """Return what ideal sensors read in a hand that turns and swings them: slow waves in angle and place."""
    rng = np.random.default_rng(seed)
    t = np.arange(int(seconds * 1000.0)) / 1000.0

    def waves(size: float) -> np.ndarray:
        f, phase = rng.uniform(0.1, 0.6, (4, 3)), rng.uniform(0.0, 6.3, (4, 3))
        return sum(size / 2.0 * np.sin(2.0 * np.pi * f[k] * t[:, None] + phase[k]) for k in range(4))

    r_nb = Rotation.from_euler("xyz", waves(0.9)).as_matrix()  # Rz Ry Rx
    skew = np.einsum("nji,njk->nik", r_nb, np.gradient(r_nb, 1e-3, axis=0))
    rate = np.stack((skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]), axis=1)
    place = waves(reach_m)
    acceleration = np.gradient(np.gradient(place, 1e-3, axis=0), 1e-3, axis=0) + np.array([0.0, 0.0, STANDARD_GRAVITY])
    force = np.einsum("nji,nj->ni", r_nb, acceleration)
    noise = rng.standard_normal((2, len(t), 3))
    step = round(1000.0 / RATE_HZ)
    return Record(
        time=t[::step], gyro=(rate + 0.01 * noise[0] + 0.03)[::step], accel=(force * 1.02 + 0.05 * noise[1])[::step]
    )


def told(record: Record) -> str:
    """Return what is found, "" for nothing."""
    finding = find_disagreement(record)
    return "" if finding is None else finding.text


@pytest.mark.parametrize("seed", range(4))
def test_a_sound_recording_raises_no_suspicion(seed):
    assert told(turned_by_hand(seed=seed)) == ""


ORDERS = [order for order in itertools.permutations(range(3)) if order != (0, 1, 2)]


@pytest.mark.parametrize("declared_hz", [50.0, 200.0])
def test_a_wrong_sample_rate_is_named_with_the_true_one(declared_hz):
    record = turned_by_hand()
    finding = find_disagreement(replace(record, time=record.time * RATE_HZ / declared_hz))
    assert finding is not None
    assert f"{declared_hz:.3g} were declared" in finding.text
    rate_hz = finding.values["sample_rate_hz"]
    show("sample rate found of 100 Hz", rate_hz)
    assert rate_hz == pytest.approx(RATE_HZ, rel=0.05)  # the offset of 3 deg/s and the hand's swing are in it


def test_reversed_acceleration_is_not_seen_in_motion():
    record = turned_by_hand()  # a point reflection: no motion shows it
    assert told(replace(record, accel=-record.accel)) == ""


@pytest.mark.slow
@pytest.mark.parametrize("number", [2, 3, 5, 7, 9, 24, 32, 35])
def test_broad_recordings_agree_and_their_exchanged_axes_do_not(number):
    record = trial(number)[0].in_si()
    assert told(record) == ""
    for order in ORDERS:
        assert "exchanged" in told(replace(record, gyro=record.gyro[:, order]))


@pytest.mark.slow
def test_a_pendulum_raises_no_suspicion_though_it_hides_gravity():
    # Its accelerometer hardly feels the tangential component of gravity: no rotation keeps nearly as much as the true one.
    for path in sorted(data_path("pendulum_with_optics").glob("*.csv.gz")):
        values = np.genfromtxt(path, delimiter=";", skip_header=2, encoding="utf-8", converters={2: comma})
        time = np.arange(len(values)) * 0.0114
        assert told(Record(time=time, gyro=values[:, 8:11], accel=values[:, 5:8])) == ""


def comma(text: str) -> float:
    return float(text.replace(",", "."))


def with_column(sensor, axis, factor):
    """Return the recording with one column of a sensor times a factor."""
    record, sign = turned_by_hand(), np.ones(3)
    sign[axis] = factor
    return replace(record, **{sensor: getattr(record, sensor) * sign})


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("sensor", ["gyro", "accel"])
def test_exchanged_columns_are_refused(sensor, order):
    record = turned_by_hand()
    with pytest.raises(Implausible, match="exchanged"):
        check_triads(replace(record, **{sensor: getattr(record, sensor)[:, order]}))


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sensor", ["gyro", "accel"])
def test_reversed_column_is_refused(sensor, axis):
    name = {"gyro": "gyroscope", "accel": "accelerometer"}[sensor]
    with pytest.raises(Implausible, match=f"{name} column {'xyz'[axis]}"):
        check_triads(with_column(sensor, axis, -1.0))
