"""What a rate table did: about which axis it turned the case, and at what rate."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.cramer_rao import white_device
from testkit.quiet import without_noise
from undrift.calibration.calibrate import calibrate
from undrift.calibration.settings import CalibrateSettings
from undrift.calibration.table import DwellMeans, mountings, table_axes
from undrift.errors import InputError
from undrift.record import RateTable, Still, Turn
from undrift.sim.device.effects import LeverArm
from undrift.sim.motion.bench import BenchErrors, BenchSettings
from undrift.sim.motion.motion import unit_vector
from undrift.sim.sessions import simulate_session

# ---- the axis of a rate table as gravity shows it: exact without noise, and what stays unknown is stated

DEG = np.pi / 180.0
G = 9.80665
ARM = LeverArm(arms=np.tile((0.03, -0.02, 0.04), (3, 1)))
QUIET = BenchErrors(mount_tilt=0.5 * DEG, level=0.2 * DEG)


def turned(kind="rate_table", table=QUIET, seed=3, **settings):
    rng = np.random.default_rng(seed)
    device = without_noise(white_device(rng))
    device = replace(device, accel=replace(device.accel, lever_arm=ARM))
    bench = BenchSettings(
        sample_rate_hz=50.0,
        turn_rates=tuple(rate * DEG for rate in (20.0, 50.0, 90.0)),
        errors=table,
        **settings,
    )
    return device, simulate_session(kind, device, rng=rng, settings=bench)


def dwells_of(session):
    record = session.records[0]
    parts = [record.gyro[t.start + 20 : t.stop].mean(axis=0) for t in session.turns]
    return DwellMeans(
        reading=np.array(parts),
        turn_rate=np.array([turn.turn_rate for turn in session.turns]),
        axis=tuple(turn.axis for turn in session.turns),
        up=np.ones(len(parts)),
    )


def axes_of(session, table, accel, turns=None, records=None):
    turns = session.turns if turns is None else turns
    return table_axes(
        session.records if records is None else records, turns, dwells_of(session), mountings(turns),
        table=table, accel=accel, gravity_m_s2=G, settle_s=0.3,
    )  # fmt: skip


def sigma_of(found, session):
    """Return the standard uncertainty of the axis of each dwell, in the two directions across it, (N, 2), rad."""
    sigma = np.sqrt((found.columns**2).sum(axis=2))
    own = np.array(["xyz".index(turn.axis) for turn in session.turns])
    return sigma[np.arange(3) != own[:, None]].reshape(-1, 2)


def true_accel(device):
    """Return the accelerometers as they are, with no uncertainty: a level table's six faces give them."""
    rng = np.random.default_rng(5)
    calibration = calibrate(
        simulate_session("six_face", device, rng=rng), settings=CalibrateSettings(identify_adc=False)
    )
    assert calibration.accel is not None
    return calibration.accel


@pytest.mark.slow
def test_axis_is_found_through_a_table_off_level():
    device, session = turned()
    axes = axes_of(session, RateTable(mount_tilt_deg=5.0, table_level_deg=0.2), true_accel(device))
    true = np.array([turn_axis(session, turn) for turn in session.turns])
    nominal = np.array([unit_vector(turn.axis) for turn in session.turns])
    assert np.abs(true - nominal).max() > 0.2 * DEG
    # What is left is of second order, 0.5 deg of mounting by 0.2 deg of level, and the prior of the arm.
    assert np.abs(axes.direction - true).max() < 0.01 * DEG


def turn_axis(session, turn):
    """Return the axis about which the case turned, from the truth of the same seed: a noise-free gyroscope's reading."""
    device, _ = turned()
    record = session.records[0]
    reading = record.gyro[turn.start + 20 : turn.stop].mean(axis=0)
    rate = np.linalg.solve(device.gyro.forward_matrix, reading - device.gyro.raw_offset)
    return rate / np.linalg.norm(rate) * np.sign(turn.turn_rate)


def pieces_of(*words):
    """Return pieces one after the other: rests by their face, "?" in any pose; turns by axis, or axis and "by" an angle."""
    results = []
    for n, word in enumerate(words):
        span = {"start": 10 * n, "stop": 10 * n + 9}
        if word == "?" or word[0] in "+-":
            results.append(Still(face=None if word == "?" else word, **span))
        else:
            results.append(Turn(axis=word[0], **({"angle": 6.0} if "by" in word else {"turn_rate": 1.0}), **span))
    return results


@pytest.mark.parametrize(
    ("words", "numbers"),
    [
        ("-x +x x x ? +x", [-1, 0, 0, 0, -1, 0]),  # the rest before on the other face is a mounting of its own
        ("+x x +y y y +x x", [0, 0, 1, 1, 1, 2, 2]),
        ("+x x -x x", [0, 0, 1, 1]),
        ("+x -x +y", [-1, -1, -1]),  # six faces on a plate
        ("+x xby +x x", [-1, -1, 0, 0]),
        ("x y", [0, 1]),
    ],
)
def test_pieces_with_one_axis_up_are_one_mounting(words, numbers):
    result = mountings(pieces_of(*words.split()))
    assert (result < 0).tolist() == [number < 0 for number in numbers]
    on = result >= 0
    alike = np.array(numbers)[:, None] == np.array(numbers)[None, :]
    np.testing.assert_array_equal((result[:, None] == result[None, :])[np.ix_(on, on)], alike[np.ix_(on, on)])


def test_each_recording_has_its_level():
    device, session = turned(table=BenchErrors(mount_tilt=0.1 * DEG, level=0.2 * DEG))
    turns = tuple(
        replace(turn, recording=n, start=0, stop=turn.stop - turn.start) for n, turn in enumerate(session.turns)
    )
    parts = tuple(session.records[0].part(turn.start, turn.stop) for turn in session.turns)
    dwells = dwells_of(session)
    axes = axes_of(session, RateTable(table_level_deg=0.2, wobble_deg=0.01), true_accel(device), turns, parts)
    rates = (dwells.reading - device.gyro.raw_offset) @ np.linalg.inv(device.gyro.forward_matrix).T
    true = rates / np.linalg.norm(rates, axis=1)[:, None] * np.sign(dwells.turn_rate)[:, None]
    assert np.abs(axes.direction - true).max() < 0.01 * DEG
    assert sigma_of(axes, session).max() < 0.05 * DEG


def test_codes_of_an_accelerometer_are_shared_by_a_mounting():
    device, session = turned(table=BenchErrors(), dwell_s=6.0)
    record = session.records[0]
    accel = true_accel(device)
    step = 0.1 / accel.matrix[0, 0]  # 0.1 m/s2, 10 bits of 5 g
    coarse = replace(record, accel=np.round(record.accel / step) * step)
    table = RateTable(mount_tilt_deg=5.0, table_level_deg=0.0, wobble_deg=0.0)
    fine, rough = (sigma_of(axes_of(session, table, accel, records=(item,)), session) for item in (record, coarse))
    assert np.all(rough**2 - fine**2 > 0.9 * 0.1**2 / 12.0 / G**2)  # the sensors' scales differ by some per cent


def test_rests_on_a_table_are_no_level_faces():
    device, session = turned("bench", BenchErrors(mount_tilt=0.5 * DEG), still_s=3.0)
    session = replace(session, rate_table=RateTable(mount_tilt_deg=0.5))
    accel = calibrate(session, settings=CalibrateSettings(identify_adc=False)).accel
    assert accel is not None
    away = accel.matrix @ device.accel.forward_matrix - np.eye(3)
    # The plate is level. A rest on the table taken for a face of its own has a third of 0.5 deg in it.
    assert np.abs(away).max() < 0.02 * DEG


@pytest.mark.parametrize("name", ["table_level_deg", "mount_tilt_deg", "rate_uncertainty", "wobble_deg"])
def test_what_no_table_can_be_is_refused(name):
    for value in (-0.1, float("nan")):
        with pytest.raises(InputError, match=name):
            RateTable(**{name: value})
