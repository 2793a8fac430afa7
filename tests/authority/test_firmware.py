"""Exported C against correction/correct.py on real recordings, and on the simulated device of the note with its true tables."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.broad_trials import trial
from testkit.c_build import build
from testkit.column_maps import column_map
from testkit.data import data_path, show
from testkit.full_calibration import device
from undrift.correction.correct import correct_checked
from undrift.export.c import export_c
from undrift.io.column_map import ChannelScale
from undrift.io.formats import read_counted
from undrift.model import AdcModel, DriftTables, StaticDrift
from undrift.sim.device.presets import random_device
from undrift.sim.device.truth import true_calibration, true_tables
from undrift.sim.sessions import simulate_trial
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

LSB = 2000.0 / 32768.0 * RADIAN_PER_DEGREE  # of the BROAD gyroscopes, which cut codes off


def warm_up():
    """The warm-up of an MPU-6050, in counts; offsets over temperature from the means of half-degree bins."""
    columns = column_map(
        time="Time", gyro=("Gx", "Gy", "Gz"), accel=("Ax", "Ay", "Az"), temp="dTemp", time_unit="ms",
        gyro_unit="count", accel_unit="count", temp_unit="degC", temp_scale=ChannelScale(1.0 / 340.0, 36.53),
    )  # fmt: skip
    record = read_counted(data_path("thermal_mpu6050_warmup", "Tempdata01-02-14.csv.gz"), columns).record
    nodes = np.arange(11.0, 28.6, 0.5)
    cell = np.round((record.temp_c - nodes[0]) / 0.5)

    def over_bins(values):
        return np.array([values[cell == k].mean(axis=0) for k in range(len(nodes))])

    up = [0.0, 0.0, 16384.0]
    static = StaticDrift(temp_c=nodes, gyro_offset=over_bins(record.gyro), accel_offset=over_bins(record.accel) - up)
    model = device(g=True)
    gyro = replace(model.gyro, matrix=model.gyro.matrix / 1e-3 * RADIAN_PER_DEGREE / 16.4)
    accel = replace(model.accel, matrix=model.accel.matrix / 5e-3 * STANDARD_GRAVITY / 16384.0)
    return record, replace(model, device="", gyro=gyro, accel=accel, drift=DriftTables(static=static))


def in_motion():
    """A BROAD trial: full matrix, g-sensitivity, half a code step back."""
    record, _ = trial(5)
    model = device(unit="si", g=True, adc=AdcModel(gyro_lsb=[LSB] * 3, gyro_rounding="toward_zero"))
    return record, replace(model, device=record.device)


def of_the_note():
    """A sit-to-stand of a simulated ENC-03J whose board warms from 20 to 35 degC, true tables over 18 to 75 degC."""
    rng = np.random.default_rng(11)
    model = random_device(rng, grade="enc03j_3031")
    rates = np.arange(-100.0, 101.0, 5.0) * RADIAN_PER_DEGREE
    tables = true_tables(model, np.linspace(18.0, 75.0, 115), rates)
    record = simulate_trial("sit_to_stand", model, rng=rng, temp_c=(20.0, 35.0)).record
    return record, replace(true_calibration(model), drift=tables)


@pytest.mark.slow
@pytest.mark.parametrize("recording", [warm_up, in_motion, of_the_note], ids=["MPU-6050 warm-up", "BROAD", "ENC-03J"])
def test_firmware_corrects_a_recording_as_python_does(recording, tmp_path):
    record, calibration = recording()
    exported = export_c(calibration)
    temp = np.zeros(len(record)) if record.temp_c is None else record.temp_c
    for arithmetic in ("double", "float"):
        run = build(exported, tmp_path, arithmetic, "-O2")
        inputs = run.inputs(record.gyro, record.accel, temp)
        gyro, accel, temp_c = run.real(inputs)
        same = replace(record, gyro=gyro, accel=accel, temp_c=None if record.temp_c is None else temp_c)
        python = correct_checked(same, calibration, policy="hold").record
        w, a, _ = run(inputs)
        for name, c, wanted, unit in (("gyro", w, python.gyro, RADIAN_PER_DEGREE), ("accel", a, python.accel, 1.0)):
            worst = np.abs(c - wanted).max()
            # of the largest value in the recording: 24 bits are 6e-8, a dozen roundings in a row
            full = float(np.abs(wanted).max())
            limit = 1e-6 * full if arithmetic == "float" else 1e-13 * max(full, 1.0)
            label = f"{arithmetic}, {name}: worst difference, {'deg/s' if name == 'gyro' else 'm/s2'}"
            show(label, f"{worst / unit:.3g}", f"{limit / unit:.3g}")
            assert worst <= limit
            if arithmetic == "double":  # and of each value, but for those that cancel to less than 1e-9 of full scale
                large = np.abs(wanted) > 1e-9 * max(full, 1.0)
                assert (np.abs(c - wanted)[large] <= 1e-6 * np.abs(wanted)[large]).all()
