"""Figures 1 and 2 as drawings: their functions exist, every block number is there, and the text is large enough and in its box."""

import importlib
import re
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.patches import Rectangle

from undrift.report.figures import svg_of
from undrift.report.note import DYNAMIC, FIGURE_1, FLOWS, STATIC, STEPS, draw_figure2, main, place_of

ROOT = Path(__file__).parents[2]
SCREEN_PX, MARGINS_PX, LEAST_PX = 390.0, 32.0, 9.0  # of a page: 1 rem on each side
PIXEL_PT = 0.75


def words_of(svg: str) -> list[str]:
    return [text.text or "" for text in ET.fromstring(svg).iter("{http://www.w3.org/2000/svg}text")]


@pytest.mark.parametrize("dotted", sorted({dotted for step in STEPS for dotted in step.ours}))
def test_every_function_of_the_drawings_is_there(dotted: str) -> None:
    name, file = place_of(dotted)
    assert (ROOT / "src" / "undrift" / file).is_file()
    held = importlib.import_module("undrift." + file.removesuffix(".py").replace("/", "."))
    module = held.__name__
    for part in name.split("."):
        held = getattr(held, part)
    assert callable(held)
    assert held.__module__ == module  # where it is written, not where it is used


@pytest.mark.parametrize("name", FLOWS)
def test_every_step_is_drawn(name: str) -> None:
    shown = " ".join(words_of(svg_of(FLOWS[name]()))).replace("\N{NO-BREAK SPACE}", " ")
    steps = FIGURE_1 if name == "note-figure-1.svg" else STEPS[len(FIGURE_1) :]
    assert len(steps) == (8 if name == "note-figure-1.svg" else 9)
    for step in steps:
        for wanted in (step.note.replace("\N{NO-BREAK SPACE}", " "), *(" ".join(place_of(d)) for d in step.ours)):
            assert re.sub(r"\s+", " ", wanted) in re.sub(r"\s+", " ", shown)


def test_every_block_number_of_the_notes_text_is_drawn_in_its_column() -> None:
    shown = " ".join(words_of(svg_of(draw_figure2()))).replace("\N{NO-BREAK SPACE}", " ")
    assert re.findall(r"block (\d)", shown) == list("23456789")
    assert [re.findall(r"\d", branch.blocks) for branch in (STATIC, DYNAMIC)] == [list("2345"), list("6789")]


@pytest.mark.parametrize("name", FLOWS)
def test_text_is_large_enough_on_a_narrow_screen_and_stays_in_its_box(name: str) -> None:
    figure = FLOWS[name]()
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    scale = min(1.0, (SCREEN_PX - MARGINS_PX) / (figure.get_figwidth() * 72.0 / PIXEL_PT))
    (axes,) = figure.axes
    boxes = [patch.get_window_extent(canvas.get_renderer()) for patch in axes.patches if isinstance(patch, Rectangle)]
    sheet, texts = figure.bbox, [text for text in axes.texts if text.get_text()]
    assert len(texts) > 20
    assert len(boxes) >= 8
    for text in texts:
        assert text.get_fontsize() / PIXEL_PT * scale >= LEAST_PX
        own = text.get_window_extent(canvas.get_renderer())
        assert sheet.x0 <= own.x0 < own.x1 <= sheet.x1, text.get_text()
        middle = 0.5 * (own.x0 + own.x1), 0.5 * (own.y0 + own.y1)
        held = [box for box in boxes if box.contains(*middle)]
        if text.get_rotation() == 0.0:  # the word at the loop has no box
            assert held, text.get_text()
            inner = min(held, key=lambda box: box.width * box.height)
            assert inner.x0 < own.x0, text.get_text()
            assert own.x1 < inner.x1, text.get_text()


@pytest.mark.parametrize("name", FLOWS)
def test_the_drawings_of_the_docs_are_those_of_the_code(name: str, tmp_path: Path) -> None:
    assert main(str(tmp_path)) == 0
    shipped = (ROOT / "docs" / name).read_text()
    assert words_of(shipped) == words_of((tmp_path / name).read_text())
    assert f"({name})" in (ROOT / "docs" / "note.md").read_text()
