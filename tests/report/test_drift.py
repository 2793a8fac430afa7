"""Pages and pictures of thermal fits: drawn without a warning, with their names and units, and cells to the right digit."""

import re
from functools import cache

import numpy as np
import pytest

from testkit.pictures import cut_texts
from undrift.drift.fit import fit_drift
from undrift.model import DynamicDrift
from undrift.report.drift import draw_dynamic, draw_offsets, draw_scale, drift_report, summarise
from undrift.report.figures import svg_of
from undrift.sim.device.presets import preset
from undrift.sim.device.truth import true_calibration
from undrift.sim.motion.bench import BenchSettings
from undrift.sim.thermal import ChamberSettings, ThermalSettings, simulate_thermal_session

BENCH = BenchSettings(
    sample_rate_hz=50.0, still_s=6.0, move_s=1.0, turn_rates=tuple(np.radians((30.0, 60.0, 90.0))), dwell_s=1.5
)
CHAMBER = ChamberSettings(ramp_rate_c_per_min=20.0, air_lag_s=5.0, board_lag_s=10.0, soak_hold_s=300.0)
SETTINGS = ThermalSettings(bench=BENCH, chamber=CHAMBER, set_points_c=(18.0, 37.0, 56.0, 75.0), back=True, faces="six")


@cache
def soaked():
    """A fit of soaks up and down on six faces."""
    device = preset("enc03j_3031")
    made = simulate_thermal_session("soak", device, rng=np.random.default_rng(1), settings=SETTINGS)
    return fit_drift([made], true_calibration(device))


@cache
def summary(sensor="gyro"):
    return summarise(soaked(), sensor)


def test_tables_are_in_the_units_that_people_read():
    tables = {table.key: table for table in drift_report(soaked()).tables}
    gyro, accel = tables["gyroscope_offset_over_temperature"], tables["accelerometer_offset_over_temperature"]
    assert [*gyro.columns][1:] == ["slope (deg/s per degC)", "table u (deg/s)", "hysteresis half-width (deg/s)"]
    assert [*accel.columns][1:] == ["slope (mg per degC)", "table u (mg)"]
    assert re.fullmatch(
        r"Measured from [\d.]+ to [\d.]+ degC. \d+ nodes from [\d.]+ to [\d.]+ degC by 0.5, \d+ of them extrapolated.",
        gyro.note,
    )


def test_the_thermal_sensitivity_of_the_scale_is_that_of_the_device():
    (scale,) = (table for table in drift_report(soaked()).tables if table.title.startswith("Scale factor"))
    for _, slope in scale.rows:
        assert abs(slope.value) == pytest.approx(0.2, abs=0.01)  # %/K, of the preset


DRAWN = {
    "offsets": lambda: draw_offsets(summary()),
    "offsets of poses": lambda: draw_offsets(summary("accel")),
    "scale": lambda: draw_scale(soaked().scale),
    "dynamic": lambda: draw_dynamic(
        DynamicDrift(
            temp_c=np.array([20.0, 30.0]),
            turn_rate=np.array([-1.0, 0.0, 1.0]),
            error=np.where(np.arange(3) == 1, 0.0, np.full((2, 3, 3), 0.01)),
            extrapolated=np.array([[True, False, True], [False] * 3]),
        )
    ),
}
WORDS = {
    "offsets": ("offset minus the constant offset", "x (deg/s)", "extrapolated", "warming", "95 %"),
    "offsets of poses": ("uncertainty of the table", "a pose has no single offset"),
    "scale": ("scale factor against", "z (%)", "soaks, 95 %"),
    "dynamic": ("measured rate (deg/s)", "20 degC", "correction (deg/s)"),
}


@pytest.mark.parametrize("name", DRAWN)
def test_every_picture_names_what_it_shows_and_is_the_same_twice(name):
    text = svg_of(DRAWN[name]())
    for word in WORDS[name]:
        assert word in text, word
    assert text == svg_of(DRAWN[name]())
    assert cut_texts(DRAWN[name]()) == []
