"""Real thermal logs: a warm-up of an MPU-6050 (FreeIMU, 2014; MIT), two plateaus of a BMI270 (2026; MIT) with torn lines, and
eleven short recordings of a bicycle's MPU-6050 (2013; BSD)."""

import gzip
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from testkit.cohorts import share_limits
from testkit.data import data_path, show
from testkit.recordings import bicycle
from testkit.rest_blocks import curve_uncertainty
from undrift.drift.observe import observe_rests
from undrift.drift.offset import fit_static, variance_of_mean
from undrift.fit.triad import nominal_triad
from undrift.model import Calibration, Verdict
from undrift.record import Record, Session, Still
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

# of the accelerometers by their unit alone, so that their change since 20 degC is known
IN_G = Calibration(device="", reference_temp_c=20.0, gravity_m_s2=STANDARD_GRAVITY, accel=nominal_triad("g", "accel"))


def thermal(*records, stills=()):
    return Session(kind="thermal", serial="A", gravity_m_s2=STANDARD_GRAVITY, records=records, stills=stills)


def blocks_of(session):
    return observe_rests([session], temperatures=[[record.temp_c for record in session.records]])


@pytest.fixture(scope="module")
def warm_up():
    with gzip.open(data_path("thermal_mpu6050_warmup", "Tempdata01-02-14.csv.gz"), "rt") as file:
        raw = np.genfromtxt(file, delimiter=",", skip_header=1)
    return Record(
        time=1e-3 * raw[:, 12],
        gyro=raw[:, 3:6] / 16.4,
        accel=raw[:, :3] / 16384.0,
        temp_c=raw[:, 9] / 340.0 + 36.53,
        gyro_unit="dps",
        accel_unit="g",
    )


def read_two_point(name):
    """Return the lines that hold seven numbers; no time column: 50 Hz by the author."""
    rows = []
    with gzip.open(data_path("thermal_bmi270_two_point", name), "rt", errors="replace") as file:
        for line in file:
            try:
                row = [float(word) for word in line.split(",")]
            except ValueError:
                continue
            if len(row) == 7:
                rows.append(row)
    values = np.array(rows)
    return Record(
        time=np.arange(len(values)) / 50.0,
        gyro=values[:, 4:],
        accel=values[:, 1:4],
        temp_c=values[:, 0],
        gyro_unit="dps",
        accel_unit="g",
    )


@pytest.mark.slow
def test_slopes_of_a_warm_up_are_those_of_its_block_means(warm_up):
    fit = fit_static(blocks_of(thermal(warm_up)), nodes=np.arange(10.0, 29.1, 0.5), calibration=IN_G)
    show("MPU-6050 gyro slopes, mdeg/s/degC", np.round(1e3 * fit.gyro.slope, 2), "-3.5 / +27.9 / -2.4 within 0.5")
    show("their uncertainty", np.round(1e3 * fit.gyro.slope_uncertainty, 2))
    show("accelerometer slopes, mg/degC", np.round(1e3 * fit.accel.slope, 2), "+0.276 / -0.094 / -1.79")
    np.testing.assert_allclose(1e3 * fit.gyro.slope, [-3.5, 27.9, -2.4], atol=0.5)
    np.testing.assert_allclose(1e3 * fit.accel.slope, [0.276, -0.094, -1.79], atol=0.15)
    assert any("Turn-on bias" in item.text for item in fit.findings)


def split_by(record, seconds):
    """Return which stretches of a record, of so many seconds each, as stills."""
    number = ((record.time - record.time[0]) // seconds).astype(int)
    edges = np.append(np.searchsorted(number, np.arange(number[-1] + 1)), len(number))
    return [Still(start=int(a), stop=int(b)) for a, b in pairwise(edges)]


def left(record, seconds, parity, nodes):
    """Fit on every other stretch and return what is left of the ten-second means of the rest, and their uncertainty."""
    stretches = split_by(record, seconds)
    taught = thermal(record, stills=tuple(stretches[parity::2]))
    fit = fit_static(blocks_of(taught), nodes=nodes, calibration=IN_G)
    judged = blocks_of(thermal(record, stills=tuple(stretches[1 - parity :: 2])))
    accel = fit.accel.curve.at(nodes).value

    def at(table):
        return np.column_stack([np.interp(judged.temp_c, nodes, column) for column in table.T])

    stated = np.hypot(at(fit.table.gyro_uncertainty), np.sqrt(judged.gyro_variance))
    beyond = np.interp(judged.temp_c, nodes, fit.table.gyro_extrapolated.astype(float)) > 0.0
    return judged.gyro - at(fit.table.gyro_offset), judged.accel - at(accel), stated, beyond


@pytest.mark.parametrize(
    ("parity", "before"), [(0, ("4.86 5.87 3.89", "89 97 100 %")), (1, ("5.87 6.76 5.80", "91 99 93 %"))]
)
def test_each_half_of_a_log_is_held_by_a_table_of_the_other_half(warm_up, parity, before):
    # ``before``: by the smoother that preceded restricted likelihood, 2026-11-22, for comparison alone.
    gyro, _, stated, _ = left(warm_up, 60.0, parity, np.arange(10.0, 29.6, 0.5))
    rms, inside = np.sqrt((gyro**2).mean(axis=0)), (np.abs(gyro) <= 1.96 * stated).mean(axis=0)
    show(f"half {parity}: error of the other half, mdeg/s", np.round(1e3 * rms, 2), before[0])
    show(f"half {parity}: inside the stated 95 %", np.round(100.0 * inside), before[1])
    assert (inside >= 0.90).all()  # the lower end of what a row has to hold


def left_out(blocks, group, calibration=IN_G):
    """Leave groups of blocks out in turn; return errors of the table and stated deviations of both triads, (groups, 6)."""
    errors, stated = [], []
    for number in np.unique(group):
        out, rest = blocks.taken(group == number), blocks.taken(group != number)
        at = out.temp_c.mean()
        nodes = np.unique(np.append(np.linspace(rest.temp_c.min(), rest.temp_c.max(), 15), at))
        fit, node = fit_static(rest, nodes=nodes, calibration=calibration), int(np.abs(nodes - at).argmin())
        for triad, y, variance, step in (
            (fit.gyro, out.gyro, out.gyro_variance, out.gyro_step_error),
            (fit.accel, out.accel, out.accel_variance, out.accel_step_error),
        ):
            if triad is not None:
                errors.append(y.mean(axis=0) - triad.curve.at(nodes).value[node])
                noise = variance_of_mean(np.nan_to_num(variance), step)
                stated.append(np.sqrt(triad.uncertainty[node] ** 2 + noise))
    shape = (len(np.unique(group)), -1)
    return np.reshape(errors, shape), np.reshape(stated, shape)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("log", "before"),
    [
        ("each minute of a warm-up", "100 98 %; 4.1 3.9 3.5 mdeg/s"),
        ("one minute of three of a warm-up", "100 99 %; 5.3 13.2 4.7 mdeg/s"),
        ("recordings of a bicycle", "94 %; 26.8 8.2 6.7 mdeg/s"),
    ],
)
def test_soak_left_out_of_a_real_log_lies_within_its_interval(warm_up, log, before):
    # ``before``: where each axis sought its own sizes, 2026-11-22, for comparison alone. No given log is of a chamber.
    if log == "recordings of a bicycle":
        records = [replace(record, accel=None) for record in bicycle()]
        blocks = observe_rests(
            [thermal(record) for record in records], temperatures=[[record.temp_c] for record in records]
        )
        error, stated = left_out(blocks, blocks.session, None)
        error, stated = (record / RADIAN_PER_DEGREE for record in (error, stated))
    else:
        blocks = blocks_of(thermal(warm_up))
        minute = ((blocks.time - blocks.time[0]) // 60.0).astype(int)
        every = 3 if "three" in log else 1
        error, stated = left_out(blocks.taken(minute % every == 0), minute[minute % every == 0])
    inside = np.abs(error) <= 1.96 * stated
    rms = 1e3 * np.sqrt((error**2).mean(axis=0))
    for k, unit in zip(range(0, error.shape[1], 3), ("mdeg/s", "mg"), strict=False):
        own, limit = float(inside[:, k : k + 3].mean()), share_limits(3 * len(error))[0]
        show(f"{log}, left out in turn: inside", f"{own:.3f}", f"{limit:.3f}, before {before}")
        show(f"error, {unit}", np.round(rms[k : k + 3], 2))
        assert own >= limit


def test_two_plateaus_give_a_line_that_owns_up_to_the_gap():
    session = thermal(read_two_point("BMI_270_cold_test.csv.gz"), read_two_point("BMI_270_hot_test.csv.gz"))
    nodes = np.arange(13.0, 50.1, 0.5)
    fit = fit_static(blocks_of(session), nodes=nodes)
    show("BMI270 gyro slopes, mdeg/s/degC", np.round(1e3 * fit.gyro.slope, 2), "+19.1 / +12.9 / -1.5 within 0.5")
    np.testing.assert_allclose(1e3 * fit.gyro.slope, [19.1, 12.9, -1.5], atol=0.5)
    middle = (nodes > 20.0) & (nodes < 40.0)
    assert fit.table.gyro_extrapolated[middle].all()
    show("uncertainty at 13, 30 and 47.5 degC, mdeg/s", np.round(1e3 * fit.table.gyro_uncertainty[[0, 34, 69]], 0))
    assert (fit.table.gyro_uncertainty[middle] > fit.table.gyro_uncertainty[0]).all()
    curve = curve_uncertainty(fit.gyro)  # without what every visit adds, which is the same everywhere
    assert (curve[34, :2] > 5.0 * curve[0, :2]).all()
    line = fit.table.gyro_offset[0] + (nodes - 13.0)[:, None] * fit.gyro.slope
    np.testing.assert_allclose(fit.table.gyro_offset[middle], line[middle], atol=0.05)
    assert fit.accel is None
    assert any("six faces" in item.text for item in fit.findings)
    assert Verdict.of(*fit.findings).status == "marginal"


def test_eleven_recordings_of_a_bicycle_give_slopes():
    blocks = blocks_of(thermal(*bicycle()))
    assert len(np.unique(blocks.pose)) == 11
    fit = fit_static(blocks, nodes=np.arange(21.0, 24.6, 0.5))
    slope = 1e3 * fit.gyro.slope / RADIAN_PER_DEGREE
    stated = 1e3 * fit.gyro.slope_uncertainty / RADIAN_PER_DEGREE
    show("bicycle gyro slopes, mdeg/s/degC", np.round(slope, 1), "-84 / +18 / -4")
    show("their uncertainty", np.round(stated, 1))
    show("span, degC", f"{np.ptp(blocks.temp_c):.2f}")
    np.testing.assert_array_less(np.abs(slope - [-84.0, 18.0, -4.0]), 3.0 * np.maximum(stated, 1.0))
    assert (stated < 40.0).all()
