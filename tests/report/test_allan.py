"""The Allan plot shows each triad that there is, with the interval of each point."""

import re

import numpy as np
import pytest

from undrift.calibration.noise import fit_noise
from undrift.record import Record
from undrift.report.figures import draw_allan, svg_of

RNG = np.random.default_rng(5)
TIME = np.arange(4000) / 100.0
BOTH = {"gyro": RNG.normal(0.0, 1e-3, (4000, 3)), "accel": RNG.normal(0.0, 1e-2, (4000, 3))}


@pytest.mark.parametrize("triads", [("gyro", "accel"), ("gyro",), ("accel",)])
def test_every_triad_has_a_panel_with_its_unit_and_names(triads):
    found = fit_noise(Record(time=TIME, **{name: BOTH[name] for name in triads}))
    figure = draw_allan(found, title="rest: Allan deviation")
    assert len(figure.axes) == len(triads)
    text = svg_of(figure)
    for name, unit in (("gyro", "rad/s"), ("accel", "m/s2")):
        assert (f"Allan deviation ({unit})" in text) == (name in triads)
        assert (f"{name} y" in text) == (name in triads)
    for label in ("averaging time (s)", "white noise, slope -1/2", "rest: Allan deviation, bars: 95 %"):
        assert label in text
    assert "nan" not in re.sub(r"[a-zA-Z]nan|nan[a-zA-Z]", "", text)
    assert svg_of(draw_allan(found, title="rest: Allan deviation")) == text


def test_the_bars_end_at_the_limits_of_the_deviation():
    found = fit_noise(Record(time=TIME, **BOTH))
    panel = draw_allan(found, title="")
    bars = panel.axes[1].containers[2].lines[2][0].get_segments()
    np.testing.assert_allclose([bar[0, 1] for bar in bars], found.accel_limits[0, :, 2], rtol=1e-12)
    np.testing.assert_allclose([bar[1, 1] for bar in bars], found.accel_limits[1, :, 2], rtol=1e-12)
    assert (found.accel_limits[0] < found.accel_adev).all()
    assert (found.accel_adev < found.accel_limits[1]).all()
