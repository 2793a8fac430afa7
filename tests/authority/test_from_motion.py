"""What benchmarks/from_motion.py and benchmarks/erring_bench/in_motion.py print, on few devices."""

import numpy as np
import pytest
from benchmarks.from_motion import steps

from testkit.data import data_path, show


@pytest.mark.slow
def test_each_step_reduces_the_end_error():
    data_path("broad", "03_undisturbed_slow_rotation_C.hdf5")
    result = {}
    for name, ended in steps(("03", "24")):
        result[name] = np.mean([(*value.strapdown, *value.filtered) for value in ended], axis=0)
        show(f"C, {name}: strapdown total, inclination, VQF total, inclination, deg", result[name].round(2).tolist())
    fitted, alone = result["reference fit, offset from motion"], result["motion of the others, offset from motion"]
    assert result["raw"][0] > 40.0
    assert result["rest"][0] > 3.0
    assert result["reference fit"][0] < 1.2
    assert fitted[1] < 0.75 * result["reference fit"][1]  # gravity shows the inclination: 0.57 of 0.95 deg
    assert alone[0] < 1.5
    assert alone[1] < result["motion of the others, rest"][1]
    for value in result.values():
        assert value[3] < 0.6  # a filter's inclination is that of its accelerometers
