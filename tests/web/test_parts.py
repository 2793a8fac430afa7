"""Parts of pages: what is bound follows the state and goes with its part; a click shows its refusal, or opens the next page."""

import asyncio
import gc
import weakref
from dataclasses import fields
from types import SimpleNamespace

import pytest

pytest.importorskip("nicegui")

from nicegui import Client
from nicegui.page import page

from undrift.commands.certificate import Statement
from undrift.errors import InputError
from undrift.web import parts


@pytest.fixture
def client():
    made = Client(page("/parts"), request=None)
    made.opened = []
    made.open = made.opened.append
    with made:
        yield made


def look(client):
    asyncio.run(parts.look(client))


def click(client, button):
    (listener,) = button._event_listeners.values()
    asyncio.run(listener.handler(None))


def words(client):
    return [element._text for element in client.elements.values() if getattr(element, "_text", "")]


def test_what_is_bound_follows_the_state_and_goes_with_the_part_that_is_drawn_anew(client):
    state = {"part": 1, "line": "one"}
    parts.redrawn(lambda: state["part"], lambda: parts.text("p", lambda: state["line"]))
    bound = len(parts.bound_in(client))
    state["line"] = "two"
    look(client)
    assert words(client) == ["two"]
    for state["part"] in range(2, 6):
        look(client)
    look(client)
    assert words(client) == ["two"]
    assert len(parts.bound_in(client)) == bound


def test_a_refusal_stands_beside_its_button_until_the_next_click(client):
    answers = [InputError("expected a device, got none. Connect it"), "/result", None]

    def handler():
        answer = answers.pop(0)
        if isinstance(answer, InputError):
            raise answer
        return answer

    button = parts.button("Go", handler)
    click(client, button)
    assert words(client) == ["Go", "expected a device, got none. Connect it"]
    click(client, button)
    assert words(client) == ["Go"]
    click(client, button)
    assert client.opened == ["/result"]


@pytest.mark.slow
def test_a_page_that_is_closed_is_forgotten():
    closed = Client(page("/parts"), request=None)
    with closed:
        parts.text("p", lambda: "bound")
        parts.button("Go", lambda: None)
    closed.delete()
    known = weakref.ref(closed)
    del closed
    gc.collect()
    assert known() is None


def test_the_settings_of_a_command_are_a_form_with_their_sentences(client):
    typed = {"laboratory": "Lab of room 2"}
    parts.settings_form(Statement, typed)
    shown = words(client)
    for one in fields(Statement):
        assert parts.texts()["controls"][f"--{one.name}"] in shown  # every one, in words of a page
    assert "Name and address of the laboratory." in shown
    inputs = [element for element in client.elements.values() if element.tag == "input"]
    assert "Lab of room 2" in [element.props.get("^value") for element in inputs]
    (listener,) = inputs[0]._event_listeners.values()
    listener.handler(SimpleNamespace(args="C-17"))
    assert typed == {"laboratory": "Lab of room 2", "number": "C-17"}
