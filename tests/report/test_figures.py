"""Pictures: they draw without a warning, say what they show in text, and are the same twice."""

import re
import xml.etree.ElementTree as ET
from types import SimpleNamespace

import numpy as np
import pytest

from testkit.pictures import cut_texts
from undrift.calibration.pieces import Piece
from undrift.record import Record
from undrift.report.figures import (
    draw_bars,
    draw_comparison,
    draw_held_out,
    draw_record,
    draw_recording,
    legend_above,
    new_figure,
    save_figure,
    svg_of,
)

rng = np.random.default_rng(3)


def comparison(*, gaps=True):
    time = np.linspace(0.0, 10.0, 500)
    optics = 20.0 * np.sin(time)
    if gaps:
        optics[100:150] = np.nan
    device = optics + 0.1 * rng.normal(size=500)
    errors = [(name, device - optics) for name in ("total", "inclination", "pitch")]
    return draw_comparison(time, device, optics, errors, title="walk: sagittal pitch")


DRAWN = {
    "comparison": (
        comparison,
        ["optics", "device", "total", "inclination", "pitch (deg)", "error (deg)", "time (s)", "walk: sagittal pitch"],
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", DRAWN)
def test_a_picture_says_in_text_what_it_shows(name):
    draw, labels = DRAWN[name]
    text = svg_of(draw())
    for label in labels:
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


def test_a_figure_without_any_optics_still_draws():
    nothing = np.full(50, np.nan)
    figure = draw_comparison(np.arange(50.0), np.zeros(50), nothing, [("total", nothing)], title="unseen")
    assert "unseen" in svg_of(figure)


@pytest.mark.parametrize(
    ("name", "start"), [("a.svg", b"<?xml"), ("a.png", b"\x89PNG"), ("a.pdf", b"%PDF"), ("a.PNG", b"\x89PNG")]
)
def test_a_figure_is_saved_by_its_ending(tmp_path, name, start):
    figure = held_out()
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


LONG = "20261124_patient_0007_left_thigh_second_session_after_lunch_protocol_of_the_clinic_03.csv"


def readings(**more):
    """Return a record with a gap, and a gyroscope that is saturated for a while."""
    gyro = rng.normal(0.0, 0.1, (1000, 3))
    gyro[300:330] = 5.0
    gyro[600:620] = np.nan
    return Record(time=np.arange(1000) / 100.0, gyro=gyro, accel=gyro + 9.81, **more)


def recording():
    left_out = [
        Piece(
            kind=kind,
            start=k,
            stop=k + 40,
            recording=0,
            why=f"{why}, which the settings of the session ask for: {k} deg",
        )
        for k, kind, why in (
            (0, "still", "too restless"),
            (100, "turn", "not a full turn"),
            (200, "turn", "beside a gap"),
        )
    ]
    used = [
        Piece(kind=kind, start=k, stop=k + 90, recording=0, label="+x") for k, kind in ((400, "still"), (700, "turn"))
    ]
    return draw_recording([readings()], [*left_out, *used], title=f"{LONG} and {LONG}", used=True)


def held_out():
    pitch = rng.normal(0.0, 0.01, 20) ** 2
    return draw_held_out([SimpleNamespace(recording=LONG, window_s=10.0, pitch=pitch)] * 2)


def long_comparison():
    time = np.linspace(0.0, 1.0, 50)
    return draw_comparison(time, time, time, [(LONG, time), (f"{LONG} again", time), ("total", time)], title=LONG * 2)


LONG_NAMED = {
    "comparison": long_comparison,
    "recording": recording,
    "record": lambda: draw_record(readings(device=LONG)),
    "bars": lambda: draw_bars([LONG, f"{LONG} again"], {LONG: [1.0, 2.0], "total": [2.0, 3.0]}, title=LONG, label="rms (deg)"),
    "held out": held_out,
}  # fmt: skip


@pytest.mark.parametrize("name", LONG_NAMED)
def test_long_names_of_recordings_and_protocols_are_written_in_lines_that_fit(name):
    figure = LONG_NAMED[name]()
    assert cut_texts(figure) == []
    shown = re.sub(r"\s", "", ET.canonicalize(svg_of(figure), strip_text=True))
    assert LONG in re.sub(r"<[^>]*>", "", shown)  # in several lines, none of it lost


def test_a_name_stands_once_in_a_legend() -> None:
    _, (panel,) = new_figure(1, height=2.0)
    for k in range(24):
        panel.plot([k, k + 1], [1.0, 1.0], label="mean of a still")
    panel.plot([0, 24], [0.0, 0.0], label="local gravity")
    legend_above(panel)
    assert [text.get_text() for text in panel.get_legend().get_texts()] == ["mean of a still", "local gravity"]
