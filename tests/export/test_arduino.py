"""The Arduino library: its sketch compiles with the library against stubs, runs, and prints the corrected readings."""

import re
import shutil
import subprocess

import numpy as np
import pytest

from testkit.full_calibration import device, record, tables
from undrift.cli.app import run
from undrift.correction.correct import correct
from undrift.io.store import write_calibration

STUB = """
#pragma once
#include <stdint.h>
#include <stdio.h>
struct SerialStub {
    void begin(long) {}
    void print(const char *text) { fputs(text, stdout); }
    void print(char letter) { putchar(letter); }
    void print(double value, int digits) { printf("%.*f", digits, value); }
    void println(double value, int digits) { printf("%.*f\\n", digits, value); }
};
static SerialStub Serial;
static uint32_t micros() { static uint32_t now = 0; return now += 10000; }
struct WireStub {
    uint8_t bytes[14] = {BYTES};
    int at = 0;
    void begin() {}
    void setClock(long) {}
    void beginTransmission(uint8_t) {}
    void write(uint8_t) {}
    void endTransmission(bool = true) {}
    uint8_t requestFrom(uint8_t, uint8_t size) { at = 0; return size; }
    int read() { return bytes[at++]; }
};
static WireStub Wire;
"""
COUNTS = np.array([1200, -300, 16000, -3000, 250, -90, 700], dtype=">i2")  # accelerometers, temperature, gyroscopes
STRICT = ("-Wall", "-Wextra", "-Werror", "-fsanitize=undefined", "-fno-sanitize-recover=all")


@pytest.mark.skipif(shutil.which("g++") is None, reason="a compiler of C and C++")
@pytest.mark.parametrize("drift", [None, tables()], ids=["constants", "tables"])
def test_the_sketch_prints_the_corrected_readings(tmp_path, drift):
    calibration = device(drift=drift)
    write_calibration(calibration, tmp_path / "c.json")
    library = tmp_path / "undrift_imu"
    assert run(["export", str(tmp_path / "c.json"), "--target", "arduino", "-o", str(library)]) == 0
    assert "name=undrift_imu\n" in (library / "library.properties").read_text()
    assert "undrift_correct\tKEYWORD2" in (library / "keywords.txt").read_text()
    stub = STUB.replace("BYTES", ", ".join(map(str, COUNTS.tobytes())))
    for name in ("Arduino.h", "Wire.h"):
        (tmp_path / name).write_text(stub if name == "Arduino.h" else '#include "Arduino.h"\n')
    sketch = (library / "examples" / "Corrected" / "Corrected.ino").read_text()
    (tmp_path / "main.cpp").write_text(sketch + "int main() { setup(); for (int k = 0; k < 3; k++) loop(); }\n")
    include = [f"-I{tmp_path}", f"-I{library / 'src'}"]
    subprocess.run(["gcc", "-c", *STRICT, library / "src" / "undrift.c", "-o", tmp_path / "c.o"], check=True)
    words = ["g++", "-std=c++11", *STRICT, *include, tmp_path / "main.cpp", tmp_path / "c.o", "-o", tmp_path / "run"]
    subprocess.run(words, check=True)
    done = subprocess.run([tmp_path / "run"], capture_output=True, text=True, check=True, timeout=60)
    cells = re.split(r"[:,]", done.stdout.splitlines()[-1])
    shown = [float(cell) for cell in cells if not cell.endswith(")")]
    counts, temp_c = COUNTS.astype(float), COUNTS[3] / 340.0 + 36.53
    twice = [np.tile(part, (2, 1)) for part in (counts[4:], counts[:3])]
    raw = record(2, gyro=twice[0], accel=twice[1], temp_c=np.full(2, temp_c))
    made = correct(raw, calibration, policy="hold")
    np.testing.assert_allclose(shown, [*made.gyro[0], *made.accel[0], temp_c], atol=6e-3)
