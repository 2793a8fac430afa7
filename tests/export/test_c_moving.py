"""The exported change of the offset from motion to rest against correction/correct.py."""

import re
from dataclasses import replace

import numpy as np
import pytest

from testkit.c_build import TYPES, UNDEFINED, run_program
from testkit.full_calibration import device, record, tables
from undrift.correction.correct import correct_checked
from undrift.export.c import export_c
from undrift.segments import find_turning

N, STEP_S = 3000, 0.0078125
MOVING = np.array([0.0011, -0.0007, 0.0009])
MAIN = """
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
    got = run_program(export_c(calibration), folder, arithmetic, inputs, row, main=MAIN, options=UNDEFINED)[:, :3]
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


def test_a_gap_is_bridged(tmp_path):
    calibration = moving(None)
    r = turns_and_rests(calibration)
    gyro = np.array(r.gyro)
    gyro[430:440] = np.nan
    got, wanted, _ = both(calibration, replace(r, gyro=gyro), "double", tmp_path)
    np.testing.assert_array_equal(np.isnan(got), np.isnan(wanted))
    assert (np.abs(got - wanted) < 1e-12)[:470][np.isfinite(wanted[:470])].all()


def test_header_and_notes_say_what_to_call():
    exported = export_c(moving(None))
    assert "through undrift_at_rest" in " ".join(exported.notes)
    assert "6 by undrift_at_rest" in re.sub(r"[\s*]+", " ", exported.header)
    assert not any("change of the offset" in text for text in exported.not_carried)
    assert "at_rest" not in export_c(device(drift=None)).header
