"""Pictures: they draw without a warning, say what they show in text, keep peaks and gaps, and are the same twice."""

import re
from types import SimpleNamespace

import numpy as np
import pytest

from undrift.calibration.noise import TERMS, fit_noise
from undrift.record import Record
from undrift.report.figures import (
    draw_allan,
    draw_allan_fit,
    envelope,
    legend_above,
    new_figure,
    save_figure,
    svg_of,
    trial_figure,
)

rng = np.random.default_rng(3)


def trial(time, pitch):
    """Return what is drawn of a trial."""
    error = SimpleNamespace(total=0.002 * rng.normal(size=len(time)), inclination=0.0 * time, pitch=0.0 * time)
    return SimpleNamespace(
        recording="walk", time=time, reference_pitch=pitch, sensor_pitch=pitch + 0.01, error=error, moving=time > 3.0
    )  # fmt: skip


def walk():
    time = np.linspace(0.0, 10.0, 500)
    pitch = 0.3 * np.sin(time)
    pitch[100:150] = np.nan
    return trial_figure(trial(time, pitch))


def test_a_picture_says_in_text_what_it_shows():
    text = svg_of(walk())
    words = ("optics", "device", "total", "inclination", "pitch (deg)", "error (deg)", "time (s)", "walk: sagittal")
    for label in words:
        assert label in text, label
    assert 'aria-label="walk: sagittal pitch: pitch (deg), error (deg) against time (s)"' in text
    assert "nan" not in re.sub(r"[a-zA-Z]nan|nan[a-zA-Z]", "", text)


def test_an_angle_that_wraps_is_not_joined_across():
    time = np.arange(100.0)
    angle = np.radians((time * 10.0 + 180.0) % 360.0 - 180.0)
    drawn = trial_figure(trial(time, angle)).axes[0].lines[0].get_ydata()
    assert np.isnan(drawn).sum() == 3  # at 180, 540 and 900 deg
    assert np.nanmax(np.abs(np.diff(drawn))) <= 10.0 + 1e-9
    assert np.isfinite(angle).all()  # the array of the caller does not change


@pytest.mark.parametrize(
    ("name", "start"), [("a.svg", b"<?xml"), ("a.png", b"\x89PNG"), ("a.pdf", b"%PDF"), ("a.PNG", b"\x89PNG")]
)
def test_a_figure_is_saved_by_its_ending(tmp_path, name, start):
    figure = walk()
    save_figure(figure, tmp_path / name)
    first = (tmp_path / name).read_bytes()
    assert first.startswith(start)
    save_figure(figure, tmp_path / name)
    assert (tmp_path / name).read_bytes() == first


@pytest.mark.parametrize("name", ["we$ird_$x$", r"a$\frac{$"])
def test_a_dollar_in_a_name_stays_one_and_powers_of_ten_are_plain_numbers(name):
    figure, (axes,) = new_figure("y")
    axes.loglog([1.0, 1e4], [1.0, 1e3])
    axes.set_title(name)
    text = svg_of(figure)
    assert name in text
    bare = re.sub("<!--.*?-->", "", text)
    assert "mathdefault" not in bare
    assert ">1000</text>" in bare


def test_a_name_stands_once_in_a_legend():
    _, (panel,) = new_figure("y")
    for k in range(24):
        panel.plot([k, k + 1], [1.0, 1.0], label="mean of a still")
    panel.plot([0, 24], [0.0, 0.0], label="local gravity")
    legend_above(panel)
    assert [text.get_text() for text in panel.get_legend().get_texts()] == ["mean of a still", "local gravity"]


# ---- envelope


def test_a_peak_of_one_sample_is_drawn_at_its_time():
    time = np.arange(50_000) / 286.0
    course = np.sin(time)
    course[31_415], course[40_001] = 8.41, -7.7
    drawn_time, drawn = envelope(time, course)
    assert len(drawn) <= 4000
    assert (drawn.max(), drawn.min()) == (8.41, -7.7)
    assert drawn_time[drawn.argmax()] == time[31_415]
    assert drawn_time[drawn.argmin()] == time[40_001]
    assert (np.diff(drawn_time) > 0.0).all()


def test_no_line_crosses_a_gap_however_short():
    time = np.arange(10_000.0)
    course = np.cos(time / 500.0)
    course[4_321] = np.nan  # within a column
    course[6_000:7_000] = np.nan  # over many
    drawn_time, drawn = envelope(time, course, columns=100)
    for gap in (4_321.0, 6_500.0):
        k = int(np.searchsorted(drawn_time, gap))
        assert np.isnan(drawn[k - 1]) or np.isnan(drawn[k])
    assert np.isfinite(drawn[(drawn_time > 4_500.0) & (drawn_time < 5_900.0)]).all()
    assert set(drawn[np.isfinite(drawn)]) <= set(course)


# ---- Allan deviation


@pytest.mark.parametrize("triads", [("gyro", "accel"), ("accel",)])
def test_every_triad_has_a_panel_with_its_unit_and_names(triads):
    both = {"gyro": rng.normal(0.0, 1e-3, (4000, 3)), "accel": rng.normal(0.0, 1e-2, (4000, 3))}
    found = fit_noise(Record(time=np.arange(4000) / 100.0, **{name: both[name] for name in triads}))
    figure = draw_allan(found, title="rest: Allan deviation")
    assert len(figure.axes) == len(triads)
    text = svg_of(figure)
    for name, unit in (("gyro", "rad/s"), ("accel", "m/s2")):
        assert (f"Allan deviation ({unit})" in text) == (name in triads)
        assert (f"{name} y" in text) == (name in triads)
    assert "nan" not in re.sub(r"[a-zA-Z]nan|nan[a-zA-Z]", "", text)


def test_each_coefficient_is_marked_where_it_is_read():
    time = np.arange(400_000) / 100.0
    rate = rng.normal(0.0, 1e-3, (400_000, 3)) + np.cumsum(rng.normal(0.0, 1e-5, (400_000, 3)), axis=0)
    found = fit_noise(Record(time=time, gyro=rate))
    for panel, axis in zip(draw_allan_fit(found, "gyro", TERMS["gyro"]).axes, found.gyro, strict=True):
        marks = dict(line.get_xydata()[0] for line in panel.lines if len(line.get_xdata()) == 1)
        assert marks[1.0] == pytest.approx(axis.angle_random_walk.value, rel=1e-12)
        assert marks[3.0] == pytest.approx(axis.rate_random_walk.value, rel=1e-12)
