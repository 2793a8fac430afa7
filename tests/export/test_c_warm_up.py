"""The exported warm-up against correction/correct.py told the time since power-on, and the stated bytes of a source with all
parts."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.c_build import TYPES, UNDEFINED, run_program
from testkit.data import show
from testkit.full_calibration import ROUNDINGS, device, record, tables
from undrift.correction.correct import correct_checked
from undrift.export.c import export_c
from undrift.model import StaticDrift, WarmUp

EXTRA = [[400.0, -300.0, 200.0], [150.0, -90.0, 70.0], [30.0, -20.0, 10.0], [4.0, -9.0, 3.0], [0.0, 0.0, 0.0]]
NODES = {"even": [0.0, 60.0, 120.0, 180.0, 600.0], "searched": [0.0, 7.3, 61.11, 200.7, 901.3]}
MAIN = """
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


def run(exported, folder, arithmetic, inputs, options=("-O1",)):
    row = np.dtype([("out", TYPES[arithmetic], 12), ("status", "i4")])
    rows = run_program(exported, folder, arithmetic, inputs, row, main=MAIN, options=options)
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
    out, status = run(exported, tmp_path, arithmetic, inputs)
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
    out, _ = run(exported, tmp_path, arithmetic, inputs, UNDEFINED)
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
    out, _ = run(exported, tmp_path, "double", inputs)
    python = correct_checked(same, calibration, power_on_s=0.0).record
    np.testing.assert_allclose(out[:, :3], python.gyro, rtol=0.0, atol=1e-12)  # sums of 3 rad/s
