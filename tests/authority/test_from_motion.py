"""What benchmarks/from_motion.py and benchmarks/erring_bench/in_motion.py print, on few devices."""

from itertools import islice

import numpy as np
import pytest
from benchmarks.erring_bench import in_motion
from benchmarks.from_motion import pitch_errors, steps

from testkit.data import data_path, show
from undrift.sim.device.presets import random_device


@pytest.mark.slow
def test_each_step_leaves_less_of_the_end_error_and_less_yet_by_a_filter():
    data_path("broad", "03_undisturbed_slow_rotation_C.hdf5")
    found = {}
    for name, ended in steps(("03", "24")):
        found[name] = np.mean([(*one.strapdown, *one.filtered) for one in ended], axis=0)
        show(f"C, {name}: strapdown total, inclination, VQF total, inclination, deg", found[name].round(2).tolist())
    fitted, alone = found["reference fit, offset from motion"], found["motion of the others, offset from motion"]
    assert found["raw"][0] > 40.0
    assert found["rest"][0] > 3.0
    assert found["reference fit"][0] < 1.2
    assert fitted[1] < 0.75 * found["reference fit"][1]  # gravity shows the inclination: 0.57 of 0.95 deg
    assert alone[0] < 1.5
    assert alone[1] < found["motion of the others, rest"][1]
    for one in found.values():
        assert one[3] < 0.6  # a filter's inclination is that of its accelerometers


@pytest.mark.slow
def test_rest_and_motion_leave_a_tenth_of_the_pitch_error_of_fifty_seconds_of_stance():
    none, rest, motion = np.sqrt(
        np.mean([np.square(pitch_errors("posturography, 50 s", seed)) for seed in (1, 2, 3)], axis=0)
    )
    show("pitch error, rms, deg: none, rest, motion", [round(float(e), 4) for e in (none, rest, motion)])
    assert rest < 0.1 * none
    assert motion < 0.1 * none


@pytest.mark.slow
def test_intervals_hold_devices_in_hands_on_a_bench_that_errs():
    for row in islice(in_motion.rows(4, 1), 6):
        show(f"{row.group}: inside, %, rmse over stated", (row.inside_percent, round(row.rmse / row.stated, 2)))
        assert row.inside_percent >= 75.0
        assert row.rmse < 1.6 * row.stated


def test_the_true_offset_of_a_recording_is_what_it_reads_at_rest():
    device = random_device(np.random.default_rng(3), grade="industrial")
    records, offsets = in_motion.handled(device, np.random.default_rng(4))
    rested = [(record, offset) for record, offset in zip(records, offsets, strict=True) if record.time[0] == 0.0]
    assert 0 < len(rested) < len(records)
    for record, offset in rested:
        still = record.gyro[record.time < 5.5].mean(axis=0)
        assert np.degrees(still - offset) == pytest.approx(0.0, abs=0.01)  # g-sensitivity is 0.003 deg/s per g
