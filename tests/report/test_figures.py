"""Pictures: they draw without a warning, say what they show in text, and are the same twice."""

import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest

from undrift.report.figures import (
    draw_comparison,
    legend_above,
    new_figure,
    save_figure,
    svg_of,
)

rng = np.random.default_rng(3)


def comparison():
    time = np.linspace(0.0, 10.0, 500)
    optics = 20.0 * np.sin(time)
    optics[100:150] = np.nan
    device = optics + 0.1 * rng.normal(size=500)
    errors = [(name, device - optics) for name in ("total", "inclination", "pitch")]
    return draw_comparison(time, device, optics, errors, title="walk: sagittal pitch")


def test_a_picture_says_in_text_what_it_shows():
    text = svg_of(comparison())
    for label in (
        "optics",
        "device",
        "total",
        "inclination",
        "pitch (deg)",
        "error (deg)",
        "time (s)",
        "walk: sagittal pitch",
    ):
        assert label in text, label
    root = ET.fromstring(text)  # whole XML, without a head
    assert root.tag.endswith("svg")
    assert "<path" in text
    assert "nan" not in re.sub(r"[a-zA-Z]nan|nan[a-zA-Z]", "", text)


def test_an_angle_that_wraps_is_not_joined_across():
    time = np.arange(100.0)
    angle = (time * 10.0 + 180.0) % 360.0 - 180.0
    figure = draw_comparison(time, angle, angle, [("total", 0.0 * time)], title="turning")
    drawn = figure.axes[0].lines[0].get_ydata()
    assert np.isnan(drawn).sum() == 3  # at 180, 540 and 900 deg
    assert np.nanmax(np.abs(np.diff(drawn))) <= 10.0 + 1e-9
    np.testing.assert_array_equal(angle, (time * 10.0 + 180.0) % 360.0 - 180.0)  # the caller's array is untouched


@pytest.mark.parametrize(
    ("name", "start"), [("a.svg", b"<?xml"), ("a.png", b"\x89PNG"), ("a.pdf", b"%PDF"), ("a.PNG", b"\x89PNG")]
)
def test_a_figure_is_saved_by_its_ending(tmp_path, name, start):
    figure = comparison()
    save_figure(figure, tmp_path / name)
    first = (tmp_path / name).read_bytes()
    assert first.startswith(start)
    save_figure(figure, tmp_path / name)
    assert (tmp_path / name).read_bytes() == first
    assert [path.name for path in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize("name", ["we$ird_$x$", r"a$\frac{$"])
def test_a_dollar_in_a_name_stays_one_and_powers_of_ten_are_plain_numbers(name):
    figure, (axes,) = new_figure(1)
    axes.loglog([1.0, 1e4], [1.0, 1e3])
    axes.set_title(name)
    text = svg_of(figure)
    assert name in text
    bare = re.sub("<!--.*?-->", "", text)
    assert "mathdefault" not in bare
    assert ">1000</text>" in bare


def test_a_name_stands_once_in_a_legend() -> None:
    _, (panel,) = new_figure(1, height=2.0)
    for k in range(24):
        panel.plot([k, k + 1], [1.0, 1.0], label="mean of a still")
    panel.plot([0, 24], [0.0, 0.0], label="local gravity")
    legend_above(panel)
    assert [text.get_text() for text in panel.get_legend().get_texts()] == ["mean of a still", "local gravity"]
