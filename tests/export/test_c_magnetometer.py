"""The exported function of the magnetometer against correction/correct.py, and exports that leave it out by name."""

import subprocess
from dataclasses import replace

import numpy as np
import pytest

from testkit.c_build import STRICT, TYPES, write
from testkit.full_calibration import device, record, with_magnetometer
from undrift.correction.correct import correct
from undrift.export.c import export_c
from undrift.export.constants import CARRIED as CARRIED_CONSTANTS
from undrift.export.losses import losses

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
    write(export_c(calibration), tmp_path)
    (tmp_path / "main.c").write_text(MAIN)
    words = ["gcc", *STRICT, "-fsanitize=undefined", "-O1", f"-DUNDRIFT_{arithmetic.upper()}"]
    subprocess.run([*words, tmp_path / "undrift.c", tmp_path / "main.c", "-o", tmp_path / "run"], check=True)
    done, kind = correct(r, calibration), TYPES[arithmetic]
    inputs = np.column_stack((r.mag_ut, done.gyro)).astype(kind)
    ran = subprocess.run([tmp_path / "run"], input=inputs.tobytes(), capture_output=True, check=True)
    assert ran.stderr == b""
    got = np.frombuffer(ran.stdout, kind).reshape(-1, 3)
    assert np.abs(done.mag_ut - r.mag_ut).max() > 5.0
    np.testing.assert_allclose(got, done.mag_ut, rtol=0.0, atol=limit)


def test_header_has_the_function_of_the_magnetometer():
    export = export_c(with_magnetometer(device(drift=None)))
    assert "undrift_magnetometer(const undrift_t mag_raw[3]" in export.header
    assert any("undrift_magnetometer" in note for note in export.notes)
    assert not any("magnetometer" in text for text in export.not_carried)
    assert "magnetometer" not in export_c(device(drift=None)).source
    finding = losses(with_magnetometer(device(drift=None)), CARRIED_CONSTANTS)
    assert any("soft iron" in text for text in finding)
