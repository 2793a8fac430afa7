"""Further functions of the exported C source against correction/correct.py: rest, magnetometer, warm-up, lag of the thermometer."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.c_build import LAG_MAIN, TYPES, UNDEFINED, build
from testkit.data import show
from testkit.full_calibration import ROUNDINGS, device, record, tables, with_magnetometer
from undrift.correction.correct import correct, correct_checked
from undrift.errors import InputError
from undrift.export import not_in_constants
from undrift.export.c import export_c
from undrift.model import StaticDrift, WarmUp
from undrift.segments import find_turning

N, STEP_S = 3000, 0.0078125
MOVING = np.array([0.0011, -0.0007, 0.0009])
REST_MAIN = """
#include <stdio.h>
#include "undrift.h"
int main(void)
{
    undrift_t in[8], out[6]; /* readings, temperature, step */
    undrift_turning_t turning = {0};
    while (fread(in, sizeof in, 1, stdin) == 1) {
        (void)undrift_correct(in, in + 3, in[6], out, out + 3);
        undrift_at_rest(&turning, out, in[7]);
        fwrite(out, sizeof out, 1, stdout);
    }
    return 0;
}
"""


def moving(drift):
    model = device(drift=drift, g=False)
    return replace(model, gyro=replace(model.gyro, moving_offset=MOVING))


def turns_and_rests(calibration):
    rng, rate, time = np.random.default_rng(5), np.zeros((N, 3)), np.arange(N) * STEP_S
    for start, size in ((400, 2.0), (1100, 0.05), (1900, 0.3)):
        rate[start : start + 200] = size * np.sin(np.linspace(0.0, 9.0, 200))[:, None] * rng.normal(size=3)
    table = calibration.drift and calibration.drift.static.gyro_offset[0]
    gyro = np.round(rate @ calibration.gyro.forward_matrix.T + (calibration.gyro.offset if table is None else table))
    return record(N, gyro=gyro, time=time, temp_c=np.full(N, 18.0))


def both(calibration, r, arithmetic, folder):
    """Return the rates in C and in Python, and the record."""
    kind = TYPES[arithmetic]
    inputs = np.column_stack((r.gyro, r.accel, r.temp_c, np.full(N, STEP_S))).astype(kind)
    row = np.dtype((kind, 6))
    got = build(export_c(calibration), folder, arithmetic, *UNDEFINED, main=REST_MAIN).rows(inputs, row)[:, :3]
    return got, correct_checked(r, calibration).record.gyro, r


@pytest.mark.parametrize("arithmetic", ["double", "float"])
@pytest.mark.parametrize("drift", [None, tables(dynamic=None)], ids=["constant", "tables"])
def test_rates_at_rest_are_those_of_the_corrector(arithmetic, drift, tmp_path):
    calibration = moving(drift)
    got, wanted, r = both(calibration, turns_and_rests(calibration), arithmetic, tmp_path)
    turning, _ = find_turning(wanted, r.time)
    assert 0.1 < turning.mean() < 0.6
    near = np.abs(np.diff(turning, prepend=0.0)) > 0.0  # the sample at which a turn begins or ends may be another
    limit = 2e-6 if arithmetic == "float" else 1e-12
    assert (np.abs(got - wanted) <= limit)[~near].all()
    assert near.sum() == 6  # three turns


def test_gap_at_rest_is_bridged(tmp_path):
    calibration = moving(None)
    r = turns_and_rests(calibration)
    gyro = np.array(r.gyro)
    gyro[430:440] = np.nan
    got, wanted, _ = both(calibration, replace(r, gyro=gyro), "double", tmp_path)
    np.testing.assert_array_equal(np.isnan(got), np.isnan(wanted))
    assert (np.abs(got - wanted) < 1e-12)[:470][np.isfinite(wanted[:470])].all()


MAG_MAIN = """
#include <stdio.h>
#include "undrift.h"
int main(void)
{
    undrift_t in[6];
    while (fread(in, sizeof in, 1, stdin) == 1) {
        undrift_magnetometer(in, in + 3, in);
        fwrite(in, 3 * sizeof in[0], 1, stdout);
    }
    return 0;
}
"""


def fields():
    rng = np.random.default_rng(4)
    r = record(500, gyro=np.round(rng.normal(0.0, 8000.0, (500, 3))), temp_c=np.full(500, 25.0))
    return replace(r, mag_ut=rng.uniform(-60.0, 60.0, (500, 3)))


@pytest.mark.parametrize(("arithmetic", "limit"), [("double", 1e-12), ("float", 3e-5)])
def test_magnetometer_corrects_as_python_does(arithmetic, limit, tmp_path):
    calibration, r = with_magnetometer(device(drift=None)), fields()
    done, kind = correct(r, calibration), TYPES[arithmetic]
    inputs, row = np.column_stack((r.mag_ut, done.gyro)).astype(kind), np.dtype((kind, 3))
    got = build(export_c(calibration), tmp_path, arithmetic, *UNDEFINED, main=MAG_MAIN).rows(inputs, row)
    assert np.abs(done.mag_ut - r.mag_ut).max() > 5.0
    np.testing.assert_allclose(got, done.mag_ut, rtol=0.0, atol=limit)


def test_header_has_the_function_of_the_magnetometer():
    export = export_c(with_magnetometer(device(drift=None)))
    assert "undrift_magnetometer(const undrift_t mag_raw[3]" in export.header
    assert any("undrift_magnetometer" in note for note in export.notes)
    assert not any("magnetometer" in text for text in export.not_carried)
    assert "magnetometer" not in export_c(device(drift=None)).source
    assert any("soft iron" in text for text in not_in_constants(with_magnetometer(device(drift=None))))


EXTRA = [[400.0, -300.0, 200.0], [150.0, -90.0, 70.0], [30.0, -20.0, 10.0], [4.0, -9.0, 3.0], [0.0, 0.0, 0.0]]
NODES = {"even": [0.0, 60.0, 120.0, 180.0, 600.0], "searched": [0.0, 7.3, 61.11, 200.7, 901.3]}
SINCE_MAIN = """
#include <stdio.h>
#include "undrift.h"
int main(void)
{
    undrift_t in[8], out[12]; /* readings, temperature, time since power-on */
    while (fread(in, sizeof in, 1, stdin) == 1) {
        int32_t status = undrift_correct_since(in, in + 3, in[6], in[7], out, out + 3);
        status |= undrift_correct(in, in + 3, in[6], out + 6, out + 9) << 8;
        fwrite(out, sizeof out, 1, stdout);
        fwrite(&status, sizeof status, 1, stdout);
    }
    return 0;
}
"""


def warming(nodes="searched", **changes):
    """A device with every table, an extra offset after power-on, and a thermometer lag where one is given."""
    adc, drift = changes.pop("adc", ROUNDINGS[1]), tables()
    static = replace(drift.static, warm_up=WarmUp(power_on_s=NODES[nodes], gyro_offset=EXTRA))
    return device(drift=replace(drift, static=static, **changes), adc=adc)


def run_since(exported, folder, arithmetic, inputs, options=("-O1",)):
    row = np.dtype([("out", TYPES[arithmetic], 12), ("status", "i4")])
    rows = build(exported, folder, arithmetic, *options, main=SINCE_MAIN).rows(inputs, row)
    return rows["out"].astype(float), rows["status"]


def given(exported, arithmetic, r, since):
    """The inputs that the arithmetic holds, and the same as a record whose clock began at power-on."""
    parts = np.column_stack((r.gyro, r.accel, r.temp_c, since))
    inputs = parts.astype(TYPES[arithmetic])
    real = inputs.astype(float)
    return inputs, replace(r, gyro=real[:, :3], accel=real[:, 3:6], temp_c=real[:, 6], time=real[:, 7])


@pytest.mark.slow
@pytest.mark.parametrize("arithmetic", ["double", "float"])
@pytest.mark.parametrize("nodes", NODES)
def test_the_warm_up_comes_off_as_correct_takes_it_off(nodes, arithmetic, tmp_path):
    calibration = warming(nodes)
    exported = export_c(calibration)
    since = np.linspace(0.0, 1300.0, 4000)  # from power-on until long after it is over
    inputs, same = given(exported, arithmetic, record(4000, low=10.0, high=82.0), since)
    out, status = run_since(exported, tmp_path, arithmetic, inputs)
    done = correct_checked(same, calibration, policy="hold", power_on_s=float(same.time[0]))
    plain = correct_checked(same, calibration, policy="hold")
    np.testing.assert_array_equal((status & 1).astype(bool), done.outside)
    assert np.abs(done.record.gyro - plain.record.gyro).max() > 0.3  # what it is worth
    static, gain = calibration.drift.static, np.abs(calibration.gyro.matrix)
    terms = (np.abs(same.gyro) + np.abs(static.gyro_offset).max(axis=0) + np.abs(EXTRA).max(axis=0)) @ gain.T
    of_accel = (np.abs(same.accel) + np.abs(static.accel_offset).max(axis=0)) @ np.abs(calibration.accel.matrix).T
    terms += of_accel @ np.abs(calibration.gyro.g_sensitivity).T + np.abs(calibration.drift.dynamic.error).max()
    # as for the rest: float 24 bits and a dozen operations
    limit = {"float": 1e-6, "double": 1e-13}[arithmetic] * terms
    for name, c, python in (("since", out[:, :3], done), ("without", out[:, 6:9], plain)):
        ratio = float((np.abs(c - python.record.gyro) / limit).max())
        show(f"warm-up {name}, {nodes}, {arithmetic}: worst error over its limit", f"{ratio:.3g}", 1)
        assert ratio <= 1.0
    np.testing.assert_array_equal(out[:, 3:6], out[:, 9:12])
    settled = same.time >= NODES[nodes][-1]
    np.testing.assert_array_equal(out[settled, :3], out[settled, 6:9])  # not a bit is left of it afterwards
    assert settled.sum() > 1000


@pytest.mark.slow
@pytest.mark.parametrize("arithmetic", ["float"])
@pytest.mark.parametrize("nodes", NODES)
def test_wild_times_do_nothing_undefined(nodes, arithmetic, tmp_path):
    exported = export_c(warming(nodes))
    wild = [-np.inf, -1e30, -0.0, np.inf, np.nan, 1e30]
    r = record(len(wild), low=25.0, high=25.0)
    inputs, _ = given(exported, arithmetic, r, np.arange(len(wild), dtype=float))
    inputs[:] = inputs[-1]
    inputs[:, 7] = wild
    out, _ = run_since(exported, tmp_path, arithmetic, inputs, UNDEFINED)
    before = 3  # of the times above, those that are not after power-on
    assert (out[:before, :3] == out[0, :3]).all()
    assert (np.abs(out[:before, :3] - out[:before, 6:9]) > 0.05).any()
    np.testing.assert_array_equal(out[before:, :3], out[before:, 6:9])


def test_warm_up_without_offsets_is_carried_too(tmp_path):
    static = StaticDrift(
        temp_c=[18.0, 75.0], accel_offset=np.zeros((2, 3)), warm_up=WarmUp(power_on_s=NODES["even"], gyro_offset=EXTRA)
    )
    calibration = device(drift=replace(tables(), static=static, dynamic=None), g=False)
    exported = export_c(calibration)
    inputs, same = given(exported, "double", record(50, low=20.0, high=70.0), np.linspace(0.0, 50.0, 50))
    out, _ = run_since(exported, tmp_path, "double", inputs)
    python = correct_checked(same, calibration, power_on_s=0.0).record
    np.testing.assert_allclose(out[:, :3], python.gyro, rtol=0.0, atol=1e-12)  # sums of 3 rad/s


LAG_S, SMOOTH_S = 84.0, 6.0


def lagging(**changes):
    return device(drift=replace(tables(), lag_s=LAG_S, lag_smooth_s=SMOOTH_S, **changes))


@pytest.mark.slow
def test_wild_readings_and_steps_do_nothing_undefined(tmp_path):
    wild = np.array([0.0, np.inf, -np.inf, np.nan, 1e30, -1e30, 1e-30, 25.0], dtype="f4")
    inputs = np.random.default_rng(3).choice(wild, (4000, 8))
    build(export_c(lagging()), tmp_path, "float", *UNDEFINED, main=LAG_MAIN).rows(inputs, np.dtype(("f4", 7)))


def test_smoothing_that_does_not_fit_is_refused():
    assert "undrift_temperature" not in export_c(device(drift=tables())).header
    assert "undrift_temperature(undrift_lag_t *lag" in export_c(lagging()).header
    with pytest.raises(InputError, match=r"0.001 to 100000 s .* 84 s .*over 1e-05 s"):
        export_c(device(drift=replace(tables(), lag_s=84.0, lag_smooth_s=1e-5)))
