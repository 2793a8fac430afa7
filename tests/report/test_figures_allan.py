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
    for label in ("averaging time (s)", "rest: Allan deviation, lines: fitted model, band: 95 %"):
        assert label in text
    assert "nan" not in re.sub(r"[a-zA-Z]nan|nan[a-zA-Z]", "", text)
    assert svg_of(draw_allan(found, title="rest: Allan deviation")) == text
