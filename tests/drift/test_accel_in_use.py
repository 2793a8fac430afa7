"""Accelerometers in use: rests in directions of all kinds against a known device, and the given MPU-9150 sessions."""

import gzip
from dataclasses import replace

import numpy as np
import pytest

from testkit.data import data_path, show
from testkit.plain_triad import plain_triad
from undrift.calibration.norm import MG
from undrift.drift.accel_in_use import learn_accel, rest_forces, with_accel_in_use
from undrift.model import Calibration, DriftTables, RestForces, ScaleDrift, StaticDrift
from undrift.record import Record, Session
from undrift.segments import StillSettings, find_still
from undrift.units import STANDARD_GRAVITY as G

KNOWN = np.array([1e-3] * 3 + [5e-4] * 3 + [1.0 * MG] * 3)  # scale, cross-axis, offset of a fresh calibration
ROW, COLUMN = [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]


def symmetric(six):
    made = np.zeros((3, 3))
    made[ROW, COLUMN] = made[COLUMN, ROW] = six
    return made


def calibration(*, known=False, drift=None):
    """Return accelerometers in m/s2 that read true: of a data sheet, or with the uncertainty of a calibration."""
    model = plain_triad("m/s2", "m/s2", "accel")
    if known:
        variance = np.diag(symmetric(KNOWN[:6]).ravel() ** 2)
        for a, b in ((1, 3), (2, 6), (5, 7)):  # cross-axis errors of a symmetric matrix
            variance[a, b] = variance[b, a] = variance[a, a]
        covariance = np.zeros((12, 12))
        covariance[:9, :9], covariance[9:, 9:] = variance, np.diag(KNOWN[6:] ** 2)
        model = replace(model, covariance=covariance)
    return Calibration(device="", reference_temp_c=25.0, gravity_m_s2=G, accel=model, drift=drift)


def rests(rng, errors, up, *, temp_c=25.0, slope=0.0, recordings=1, rest=0.5 * MG, turn_on=0.0, ageing=0.0, base=None):
    """Return rests along up (m, 3) of a device with errors E and d (9,), dealt out to recordings a day apart."""
    up = up / np.linalg.norm(up, axis=1)[:, None]
    number, temp_c = np.sort(np.arange(len(up)) % recordings), np.broadcast_to(temp_c, len(up))
    aged = np.cumsum(ageing / 30.0**0.5 * rng.standard_normal((recordings, 3)), axis=0)
    shift = aged + turn_on * rng.standard_normal((recordings, 3))
    force = G * up @ np.linalg.inv(np.eye(3) + symmetric(errors[:6])).T + errors[6:] + shift[number]
    force += slope * (temp_c - 25.0)[:, None]
    length = np.linalg.norm(force, axis=1)[:, None]
    force *= 1.0 + rng.standard_normal((len(up), 1)) * np.hypot(rest, 0.1 * MG) / length
    model = (base or calibration()).accel
    variance = np.full(len(up), (0.1 * MG) ** 2)
    return RestForces(force=force, variance=variance, temp_c=temp_c, recording=number, model=model), aged[-1]


def lengths(model, errors, up):
    """Return what a model makes of gravity along up (m, 3) in a device with such errors, less gravity, m/s2."""
    up = up / np.linalg.norm(up, axis=1)[:, None]
    reading = G * up @ np.linalg.inv(np.eye(3) + symmetric(errors[:6])).T + errors[6:]
    return np.linalg.norm((reading - model.offset) @ model.matrix.T, axis=1) - G


def rms_mg(x):
    return float(np.sqrt(np.mean(np.square(x)))) / MG


@pytest.mark.parametrize("unit", [0, 1, 2])
def test_mpu9150_rests_that_were_left_out_have_the_length_of_gravity_within_1_5_mg(unit):
    with gzip.open(data_path("multipos_mpu9150", f"imu{unit}.log.gz"), "rt") as file:
        log = np.loadtxt(file)
    record = Record(time=np.arange(len(log)) / 100.0, accel=log[:, :3], gyro=log[:, 3:])
    session = Session(kind="thermal", serial="", gravity_m_s2=G, records=(record,))
    stills = find_still(record, StillSettings(min_duration_s=2.0)).stills
    base, course = calibration(), [np.full(len(record), 25.0)]
    parts = (stills, stills[::2], stills[1::2])
    halves = [rest_forces(session, part, np.zeros(len(part), bool), course, base) for part in parts]
    fit = learn_accel(base, halves[0], np.zeros(1))
    assert fit.changed
    show(f"unit {unit}: a direction left out, before and after, mg rms", fit.held_out / MG, (25.0, 1.5))
    assert fit.held_out[0] > 8.0 * MG
    assert fit.held_out[1] <= 1.5 * MG  # published autocalibration leaves 3.0 to 8.0
    for half, other in ((1, 2), (2, 1)):
        learnt = learn_accel(base, halves[half], np.zeros(1))
        made = with_accel_in_use(base, learnt).accel
        left = np.linalg.norm((halves[other].force - made.offset) @ made.matrix.T, axis=1) - G
        show(f"unit {unit}: every second rest left out, mg rms", rms_mg(left), 1.5)
        assert learnt.changed
        assert rms_mg(left) <= 1.5


def drawn(rng, *, known, days=10):
    """Return a device, its calibration, what ten days of four rests each make of it, and its errors on the last day."""
    sizes = KNOWN if known else np.array([0.01] * 3 + [5e-3] * 3 + [30.0 * MG] * 3)
    errors, base, old = sizes * rng.standard_normal(9), calibration(known=known), 150 if known else 0
    errors[6:] += 0.5 * MG * (old / 30.0) ** 0.5 * rng.standard_normal(3)
    up = rng.standard_normal((4 * days, 3))
    seen, aged = rests(
        rng, errors, up, recordings=days, temp_c=25.0 + rng.uniform(-6.0, 6.0, len(up)), slope=0.3 * MG,
        turn_on=0.5 * MG, ageing=0.5 * MG, base=base,
    )  # fmt: skip
    errors = errors + np.concatenate((np.zeros(6), aged + 0.5 * MG * rng.standard_normal(3)))
    return base, learn_accel(base, seen, old + np.arange(float(days))), errors


@pytest.mark.slow
@pytest.mark.parametrize("count", [30, 200])
@pytest.mark.parametrize("known", [False, True])
def test_stated_uncertainty_holds_and_no_device_becomes_worse(known, count):
    rng, inside, before, after = np.random.default_rng(7), [], [], []
    up = rng.standard_normal((300, 3))
    for _ in range(count):
        base, fit, errors = drawn(rng, known=known)
        made = with_accel_in_use(base, fit).accel
        before.append(rms_mg(lengths(base.accel, errors, up)))
        after.append(rms_mg(lengths(made, errors, up)))
        if fit.changed:
            # errors as the fit has them: along readings of the calibration before
            inside.append(np.abs(fit.change[:9] - errors) <= 1.96 * np.sqrt(np.diag(fit.covariance)[:9]))
    before, after = np.array(before), np.array(after)
    share = float(np.mean(inside))
    show(f"{count} devices, {len(inside)} updated: inside 95 %", share, (0.9, 0.98))
    show("rms of all directions before and after, median mg", [np.median(before), np.median(after)])
    show("share in which it grew, and the most", [np.mean(after > before), (after - before).max()])
    assert len(inside) > 0.8 * count
    assert 0.9 <= share <= 0.985
    assert np.mean(after > before) <= 0.1
    assert (after - before).max() < 0.4
    assert np.median(after) < 0.7 * np.median(before)


def test_a_device_that_always_lies_the_same_way_stays_as_it_was():
    rng = np.random.default_rng(1)
    seen, _ = rests(rng, np.array([0.01] * 9), np.tile([0.1, 0.2, 1.0], (30, 1)), recordings=3)
    fit = learn_accel(calibration(), seen, np.arange(3.0))
    assert not fit.changed
    assert [note.code for note in fit.findings] == ["drift.learn_accel_idle"]
    assert "rest it once on each of its six sides" in fit.findings[0].action
    base = calibration()
    assert with_accel_in_use(base, fit) is base


@pytest.mark.parametrize(
    ("up", "directions", "names"),
    [
        (np.vstack((np.eye(3), -np.eye(3)[:2])), 5, "offset z"),  # a side is missing
        # many directions, all with z above the horizon by 40 degrees: scale and offset of z are one
        ([[c, s, 1.0] for c, s in ((0, 0), (1, 0), (0, 1), (-1, 0), (0, -1), (0.8, 0.8), (-0.8, -0.8))], 6, "offset z"),
    ],
)
def test_rests_that_leave_a_side_out_change_nothing_and_name_what_is_missing(up, directions, names):
    up = np.repeat(np.array(up, float), 4, axis=0)
    seen, _ = rests(np.random.default_rng(2), np.array([0.01] * 9), up)
    fit = learn_accel(calibration(), seen, np.zeros(1))
    assert not fit.changed
    assert fit.findings[0].code == "drift.learn_accel_sphere"
    assert fit.directions >= directions
    assert names in fit.findings[0].text


def test_a_calibration_that_is_as_good_is_kept():
    rng, kept = np.random.default_rng(3), 0
    up = rng.standard_normal((20, 3))
    for _ in range(10):
        base = calibration(known=True)
        seen, _ = rests(rng, np.zeros(9), up, rest=3.0 * MG, base=base)
        fit = learn_accel(base, seen, np.zeros(1))
        kept += not fit.changed
        made = with_accel_in_use(base, fit).accel
        assert rms_mg(lengths(made, np.zeros(9), up)) < 1.0
    assert kept >= 8


def test_the_axes_stay_and_are_as_uncertain_as_they_were():
    rng = np.random.default_rng(4)
    base = calibration()
    covariance = np.array(base.accel.covariance)
    covariance[1, 1] = covariance[3, 3] = 0.01**2
    covariance[1, 3] = covariance[3, 1] = -(0.01**2)  # a rotation about z by 0.01
    base = replace(base, accel=replace(base.accel, covariance=covariance))
    seen, _ = rests(rng, np.array([0.01, -0.01, 0.02, 5e-3, -5e-3, 0.0, 0.3, -0.2, 0.1]), rng.standard_normal((30, 3)))
    seen = replace(seen, model=base.accel)
    fit = learn_accel(base, seen, np.zeros(1))
    made = with_accel_in_use(base, fit).accel
    assert fit.changed
    turn = made.matrix @ np.linalg.inv(base.accel.matrix)
    np.testing.assert_allclose(turn, turn.T, atol=1e-15)
    twist = np.zeros(12)
    twist[[1, 3]] = 0.5, -0.5
    assert twist @ made.covariance @ twist == pytest.approx(0.01**2, rel=0.05)
    assert np.linalg.eigvalsh(made.covariance).min() > -1e-12


def test_a_slope_that_the_rests_span_goes_into_a_table_over_temperature():
    rng, slope = np.random.default_rng(5), np.array([1.0, -0.5, 0.3]) * MG
    nodes = np.arange(5.0, 46.0, 5.0)
    tables = DriftTables(static=StaticDrift(temp_c=nodes, gyro_offset=np.zeros((9, 3))))
    base = calibration(drift=tables)
    errors = np.array([0.01, -0.01, 0.0, 0.0, 0.0, 0.0, 0.2, -0.1, 0.1])
    temp_c = rng.uniform(15.0, 35.0, 60)
    seen, _ = rests(rng, errors, rng.standard_normal((60, 3)), temp_c=temp_c, slope=slope, recordings=6, base=base)
    fit = learn_accel(base, seen, np.arange(6.0))
    made = with_accel_in_use(base, fit).drift.static
    true = errors[6:] + slope * (nodes - 25.0)[:, None]
    inner = (nodes >= 15.0) & (nodes <= 35.0)
    assert fit.changed
    assert np.abs(made.accel_offset - true)[inner].max() < 2.0 * MG
    assert (np.abs(made.accel_offset - true) < 3.5 * made.accel_uncertainty).all()
    assert made.accel_extrapolated.tolist() == [True] + [True] + [False] * 5 + [True, True]
    # rests at one temperature show no slope, and make no table
    seen, _ = rests(rng, errors, rng.standard_normal((60, 3)), recordings=6, base=base)
    made = with_accel_in_use(base, learn_accel(base, seen, np.arange(6.0)))
    assert made.drift.static.accel_offset is None
    assert np.abs(made.accel.offset - errors[6:]).max() < 2.0 * MG


def test_tables_of_accelerometers_are_updated_with_the_constants():
    rng, nodes = np.random.default_rng(6), np.array([10.0, 25.0, 40.0])
    known = np.array([[-0.1], [0.0], [0.1]]) * np.ones(3)
    gains = np.array([0.99, 1.0, 1.01])[:, None, None] * np.eye(3)
    tables = DriftTables(
        static=StaticDrift(temp_c=nodes, accel_offset=known, accel_uncertainty=np.full((3, 3), 0.05)),
        scale=ScaleDrift(temp_c=nodes, accel_matrix=gains),
    )
    base = calibration(drift=tables)
    errors = np.array([0.01, -0.01, 0.02, 5e-3, 0.0, 0.0, 0.05, -0.05, 0.02])
    seen, _ = rests(rng, errors, rng.standard_normal((40, 3)), temp_c=rng.uniform(20.0, 30.0, 40), base=base)
    fit = learn_accel(base, seen, np.zeros(1))
    made = with_accel_in_use(base, fit)
    at = made.drift.static.accel_offset[1] - known[1]
    np.testing.assert_allclose(at, fit.change[6:9], atol=1e-12)
    np.testing.assert_allclose(made.drift.scale.accel_matrix[1], made.accel.matrix, atol=1e-12)
    assert rms_mg(lengths(made.accel, errors, rng.standard_normal((100, 3)))) < 1.0


def test_rests_are_corrected_by_tables_and_states_noise_codes_and_sway():
    rng, time = np.random.default_rng(8), np.arange(0.0, 20.0, 0.01)
    accel = np.tile([0.0, 0.0, G], (len(time), 1)) + 0.02 * rng.standard_normal((len(time), 3)) + [0.0, 0.0, 0.1]
    session = Session(kind="thermal", serial="", gravity_m_s2=G, records=(Record(time=time, accel=accel),))
    stills = find_still(session.records[0], StillSettings(min_duration_s=2.0)).stills
    static = StaticDrift(temp_c=np.array([20.0, 30.0]), accel_offset=np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.2]]))
    base, course = calibration(drift=DriftTables(static=static)), [25.0 + 0.1 * time]
    table = rest_forces(session, stills, np.zeros(1, bool), course, base)
    assert len(table.temp_c) == 1
    np.testing.assert_allclose(np.linalg.norm(table.force, axis=1), G - 0.02, atol=2e-3)  # 0.12 at 26 degC
    assert 0.5 < table.variance[0] / (0.02**2 / len(time)) < 2.5
    body = rest_forces(session, stills, np.ones(1, bool), course, base)
    assert body.variance[0] - table.variance[0] == pytest.approx((0.02 / 19.0) ** 2)
    warming = rest_forces(session, stills, np.zeros(1, bool), [25.0 + 0.3 * time], base)
    assert len(warming.temp_c) == 3  # parts within 2 K
    missing = [np.full(len(time), np.nan)]
    assert rest_forces(session, stills, np.zeros(1, bool), missing, base) is None
    assert rest_forces(session, stills, np.zeros(1, bool), course, replace(base, accel=None)) is None


def test_a_rest_that_is_none_is_left_out():
    rng = np.random.default_rng(9)
    up = rng.standard_normal((40, 3))
    seen, _ = rests(rng, np.array([0.01] * 3 + [0.0] * 3 + [0.2] * 3), up, recordings=4)
    force = np.array(seen.force)
    force[[5, 20]] *= 1.06  # a lift that starts, a car in a bend
    sound = learn_accel(calibration(), seen, np.arange(4.0))
    fit = learn_accel(calibration(), replace(seen, force=force), np.arange(4.0))
    assert fit.changed
    assert np.abs(fit.change[6:9] - sound.change[6:9]).max() < 1.0 * MG
