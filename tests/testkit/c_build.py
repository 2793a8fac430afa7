"""The exported C source compiled and run: float and double, on the inputs that Python gets too."""

import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from undrift.export.c import ExportedC

STRICT = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic"]
UNDEFINED = ("-O1", "-fsanitize=undefined,float-cast-overflow", "-fno-sanitize-recover=all")
TYPES = {"float": np.dtype("f4"), "double": np.dtype("f8")}
MAIN = """
#include <stdio.h>
#include "undrift.h"
int main(void)
{
    undrift_t in[7], out[6];
    while (fread(in, sizeof in, 1, stdin) == 1) {
        const int32_t status = undrift_correct(in, in + 3, in[6], out, out + 3);
        fwrite(out, sizeof out, 1, stdout);
        fwrite(&status, sizeof status, 1, stdout);
    }
    return 0;
}
"""

LAG_MAIN = """
#include <stdio.h>
#include "undrift.h"
int main(void)
{
    undrift_t in[8], out[7]; /* readings, temperature, step */
    undrift_lag_t lag = {0};
    while (fread(in, sizeof in, 1, stdin) == 1) {
        out[6] = undrift_temperature(&lag, in[6], in[7]);
        (void)undrift_correct(in, in + 3, out[6], out, out + 3);
        fwrite(out, sizeof out, 1, stdout);
    }
    return 0;
}
"""


@dataclass(frozen=True)
class Build:
    """A program made of an export in one arithmetic."""

    program: Path
    arithmetic: str

    def inputs(self, gyro, accel, temp_c):
        """Return the nearest inputs that the arithmetic can represent, in the form for the program."""
        return np.column_stack((gyro, accel, temp_c)).astype(TYPES[self.arithmetic])

    def real(self, inputs):
        """Return the same inputs as double: gyro, accel, temp_c."""
        parts = inputs.astype(float)
        return parts[:, :3], parts[:, 3:6], parts[:, 6]

    def rows(self, inputs, row):
        """Return what the program writes for inputs, as rows of a type."""
        done = subprocess.run([self.program], input=inputs.tobytes(), capture_output=True, check=True, timeout=120)
        assert done.stderr == b""
        rows = np.frombuffer(done.stdout, row)
        assert len(rows) == len(inputs)
        return rows

    def __call__(self, inputs):
        """Return gyro, accel and status of every row of inputs."""
        rows = self.rows(inputs, np.dtype([("out", TYPES[self.arithmetic], 6), ("status", "i4")]))
        out = rows["out"].astype(float)
        return out[:, :3], out[:, 3:], rows["status"]


def write(exported: ExportedC, folder: Path, main: str = MAIN) -> None:
    """Write both files and a program that reads samples and writes results."""
    (folder / "undrift.h").write_text(exported.header)
    (folder / "undrift.c").write_text(exported.source)
    (folder / "main.c").write_text(main)


def build(exported: ExportedC, folder: Path, arithmetic: str, *options: str, main: str = MAIN) -> Build:
    """Compile an export, with warnings as errors."""
    write(exported, folder, main)
    program = folder / f"correct_{arithmetic}"
    sources = [folder / "undrift.c", folder / "main.c"]
    words = ["gcc", *STRICT, *(options or ("-O1",)), f"-DUNDRIFT_{arithmetic.upper()}", *sources, "-o", program]
    done = subprocess.run(words, capture_output=True, text=True, timeout=120, check=False)
    assert (done.returncode, done.stderr) == (0, ""), done.stderr
    return Build(program, arithmetic)
