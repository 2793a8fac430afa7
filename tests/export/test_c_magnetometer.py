"""The exported function of the magnetometer against correction/correct.py, and exports that leave it out by name."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.c_build import TYPES, UNDEFINED, run_program
from testkit.full_calibration import device, record, with_magnetometer
from undrift.correction.correct import correct
from undrift.export import not_in_constants
from undrift.export.c import export_c

N = 500
MAIN = """
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


def readings():
    rng = np.random.default_rng(4)
    r = record(N, gyro=np.round(rng.normal(0.0, 8000.0, (N, 3))), temp_c=np.full(N, 25.0))
    return replace(r, mag_ut=rng.uniform(-60.0, 60.0, (N, 3)))


@pytest.mark.parametrize(("arithmetic", "limit"), [("double", 1e-12), ("float", 3e-5)])
def test_fields_are_those_of_the_corrector(arithmetic, limit, tmp_path):
    calibration, r = with_magnetometer(device(drift=None)), readings()
    done, kind = correct(r, calibration), TYPES[arithmetic]
    inputs, row = np.column_stack((r.mag_ut, done.gyro)).astype(kind), np.dtype((kind, 3))
    got = run_program(export_c(calibration), tmp_path, arithmetic, inputs, row, main=MAIN, options=UNDEFINED)
    assert np.abs(done.mag_ut - r.mag_ut).max() > 5.0
    np.testing.assert_allclose(got, done.mag_ut, rtol=0.0, atol=limit)


def test_header_has_the_function_of_the_magnetometer():
    export = export_c(with_magnetometer(device(drift=None)))
    assert "undrift_magnetometer(const undrift_t mag_raw[3]" in export.header
    assert any("undrift_magnetometer" in note for note in export.notes)
    assert not any("magnetometer" in text for text in export.not_carried)
    assert "magnetometer" not in export_c(device(drift=None)).source
    assert any("soft iron" in text for text in not_in_constants(with_magnetometer(device(drift=None))))
