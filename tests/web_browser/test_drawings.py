"""The drawings of the pages: well formed, the right face on top, and a right-handed box whichever way it stands."""

import re
from xml.etree import ElementTree

import numpy as np
import pytest
from playwright.sync_api import Page

from undrift.record import FACES
from undrift.sim.motion.motion import unit_vector
from undrift.web.app import STATIC

SVG = "{http://www.w3.org/2000/svg}"


@pytest.fixture
def draw(page: Page):
    """Return what draws a kind of drawing, as the text of its SVG."""
    page.set_content("<undrift-drawing></undrift-drawing>")
    page.add_script_tag(path=STATIC / "drawings.js")

    def make(kind, *what):
        return page.locator("undrift-drawing").evaluate(
            """(element, [kind, what]) => {
                element.setAttribute("kind", kind); element.setAttribute("what", JSON.stringify(what)); return element.innerHTML;
            }""",
            [kind, what],
        )

    return make


def parsed(svg):
    return ElementTree.fromstring(svg.replace("<svg ", '<svg xmlns="http://www.w3.org/2000/svg" ', 1))


@pytest.mark.slow
@pytest.mark.parametrize("face", FACES)
def test_three_sides_of_a_right_handed_box_are_seen_the_wanted_one_on_top(draw, face):
    drawn = parsed(draw("box", face))
    names = {text.text: (float(text.get("x")), float(text.get("y"))) for text in drawn.iter(f"{SVG}text")}
    assert drawn.get("aria-label") == f"Box with {face} up"
    (top,) = [text.text for text in drawn.iter(f"{SVG}text") if text.get("class") == "top"]
    assert top == face
    assert len(names) == 3
    # Seen from outside, the names of three sides that meet in a corner follow each other counter-clockwise as right-handed axes do
    left, right = sorted((name for name in names if name != face), key=lambda name: names[name][0])
    assert names[face][1] < min(names[left][1], names[right][1])
    assert np.cross(unit_vector(left), unit_vector(right)) == pytest.approx(unit_vector(face))


@pytest.mark.slow
@pytest.mark.parametrize(("turn", "words"), [("+", "counter-clockwise"), ("-", "clockwise")])
def test_the_arrow_goes_round_the_way_the_words_say(draw, turn, words):
    svg = draw("box", "+z", turn)
    assert parsed(svg).get("aria-label") == f"Box with +z up, turned {words} seen from above"
    points = np.array(re.findall(r"(-?[\d.]+) (-?[\d.]+)", re.search(r'class="act" d="([^"]*)"', svg)[1]), float)
    front = points[np.argsort(points[:, 1])[-1]]  # the lowest point is the nearest one
    after = points[np.argsort(points[:, 1])[-1] + 3]
    assert (after[0] > front[0]) == (turn == "+")  # seen from above, counter-clockwise goes to the right in front
