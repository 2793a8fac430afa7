"""The Allan plot shows each triad that there is, with the interval of each point."""

import re

import numpy as np
import pytest

from undrift.calibration.noise import TERMS, fit_noise
from undrift.record import Record
from undrift.report.figures import draw_allan, draw_allan_fit, svg_of

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
    for label in ("averaging time (s)", "rest: Allan deviation, lines: observable terms of the model, band: 95 %"):
        assert label in text
    assert "nan" not in re.sub(r"[a-zA-Z]nan|nan[a-zA-Z]", "", text)
    assert svg_of(draw_allan(found, title="rest: Allan deviation")) == text


def test_each_coefficient_is_marked_where_it_is_read():
    time = np.arange(400_000) / 100.0
    rate = RNG.normal(0.0, 1e-3, (400_000, 3)) + np.cumsum(RNG.normal(0.0, 1e-5, (400_000, 3)), axis=0)
    found = fit_noise(Record(time=time, gyro=rate))
    for panel, axis in zip(draw_allan_fit(found, "gyro", TERMS["gyro"]).axes, found.gyro, strict=True):
        marks = dict(line.get_xydata()[0] for line in panel.lines if len(line.get_xdata()) == 1)
        assert marks[1.0] == pytest.approx(axis.angle_random_walk.value, rel=1e-12)
        assert marks[3.0] == pytest.approx(axis.rate_random_walk.value, rel=1e-12)
