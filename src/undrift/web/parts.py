"""Parts of pages: elements that follow the state of the bench, and the frame around them.

A page is a list of parts. A part shows a text, or the result of a function of the state (``bound``). The page's timer
calls this function periodically, and after each click. A button's handler raises an error to refuse, which is shown
next to the button. It returns the next page, if there is one. Forms are made from dataclasses with ``asked`` fields.
"""

import json
import re
import time
import tomllib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields
from functools import cache, partial
from inspect import isawaitable, iscoroutinefunction
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args, get_type_hints

from nicegui import Client, ui

from undrift.base.summary import sentence
from undrift.commands.bench.library import Remark
from undrift.errors import UndriftError

if TYPE_CHECKING:
    from undrift.commands.bench.library import Job
    from undrift.web.bench import Bench, Visit

REFRESH_S, CANCEL_S = 0.25, 2.0  # the latter: of work that can be cancelled
PRACTICE = "practice"  # the address of the practice device
SHOWN_FIRST = 3  # number of remarks shown at first; failures and warnings are always shown

Words = str | Callable[[], str]  # text, or a function that returns the current text
Handler = Callable[[], Any]  # click handler, may be awaited; returns the path of the next page, if any
Bound = list[tuple[ui.element, Callable[[], Any]]]  # parts of a page, with their update functions


@cache
def texts() -> dict[str, Any]:
    """Return the texts of pages that are data."""
    return tomllib.loads(Path(__file__).with_name("pages.toml").read_text(encoding="utf-8"))


# ---- Parts that are bound to the state


def bound(show: Callable[[], Any]) -> None:
    """Show something now, and update it with each timer tick until its part of the page is removed."""
    if not iscoroutinefunction(show):
        show()
    bound_in(ui.context.client).append((ui.context.slot.parent, show))


def bound_in(client: Client) -> Bound:
    """Return the update functions of a browser's page, which owns them."""
    bound: Bound = vars(client).setdefault("bound", [])
    return bound


async def look(client: Client) -> None:
    """Update all bound parts, redrawn parts first."""
    for parent, show in [*bound_in(client)]:
        if not parent.is_deleted:
            with parent:
                if isawaitable(waited := show()):
                    await waited
    bound_in(client)[:] = [binding for binding in bound_in(client) if not binding[0].is_deleted]


def text(tag: str, content: Words = "", classes: str = "", *, role: str = "") -> Any:
    """Add an element with plain text. The text is never interpreted as markup."""
    element = ui.element(tag).classes(classes)
    if role:
        element.props(f'role="{role}"')
    if callable(content):
        bound(lambda: set_text(element, content()))
    else:
        element._text = content
    return element


def says(name: str) -> None:
    """Add a sentence from pages.toml."""
    text("p", texts()["says"][name])


def set_text(element: Any, content: str) -> None:
    """Change the text of an element if it differs."""
    if element._text != content:
        element._text = content
        element.update()


def set_prop(element: Any, name: str, value: object) -> None:
    """Change an attribute of an element if it differs. None removes the attribute."""
    if element.props.get(name) != value:
        if value is None:
            element.props.pop(name)
        else:
            element.props[name] = value
        element.update()


def drawing(kind: str, what: Callable[[], Sequence[object]], classes: str = "") -> Any:
    """Add a drawing of a kind in static/drawings.js. It is redrawn when its content changes."""
    element = ui.element("undrift-drawing").props(f'kind="{kind}"').classes(classes)
    bound(lambda: set_prop(element, "what", json.dumps(what())))
    return element


def shown_if(element: Any, true: Callable[[], bool]) -> Any:
    """Show an element while something is true."""
    bound(lambda: element.set_visibility(true()))
    return element


def redrawn(state: Callable[[], object], draw: Callable[[], object]) -> None:
    """Add a part that is drawn again whenever the state changes, in this browser or another."""
    current, place = [state()], ui.element("div")

    def fill() -> None:
        place.clear()
        with place, ui.element("div"):  # elements bound in it are removed with it
            draw()

    def show() -> None:
        if (now := state()) != current[0]:
            current[0] = now
            fill()

    fill()
    bound(show)


def section(label: str, classes: str = "") -> Any:
    """Add a part with a name of its own."""
    return ui.element("section").classes(classes).props(f'aria-label="{label}"')


def row(classes: str = "") -> Any:
    """Add a row, which breaks where the screen is narrow."""
    return ui.element("div").classes(f"row {classes}")


# ---- Controls


def acted(handler: Callable[[Any], Any]) -> Callable[..., Any]:
    """Return an event handler that shows errors, opens the next page, and updates the page."""
    client, place, refusals = ui.context.client, ui.context.slot.parent, list[Any]()

    async def act(event: Any) -> None:
        while refusals:
            refusals.pop().delete()
        try:
            went = handler(event)
            went = await went if isawaitable(went) else went
        except UndriftError as error:
            went = None
            if not place.is_deleted:
                with place:
                    refusals.append(text("p", page_words(str(error)), "bench-error", role="alert"))
        if isinstance(went, str):
            client.open(went)  # of the client, because the button may be replaced by then
        await look(client)

    return act


def button(label: Words, handler: Handler, classes: str = "", *, name: str = "", pressed: bool | None = None) -> Any:
    """Add a plain button with label, handler, name for screen readers, and whether it is the selected one of several."""
    element = text("button", label, classes).props('type="button"')
    if name:
        element.props["aria-label"] = name
    if pressed is not None:
        element.props["aria-pressed"] = str(pressed).lower()
    # the second click of a double click is ignored: it would undo the first
    element.on("click", acted(lambda _: handler()), js_handler="(event) => { if (event.detail < 2) emit() }")
    return element


def next_step(label: Words, handler: Handler | str) -> Any:
    """Add the one obvious next step of a page: a button that calls, or a link to another page."""
    if isinstance(handler, str):
        return ui.link(str(label), handler).classes("next")
    return button(label, handler, "next")


def disabled_if(element: Any, true: Callable[[], bool]) -> Any:
    """Disable a plain button while something is true."""
    bound(lambda: set_prop(element, "disabled", true() or None))
    return element


class Field:
    """A labelled input, a choice, or (kind list) an input with proposals. ``value`` is the current entry."""

    def __init__(
        self,
        label: str,
        value: str = "",
        *,
        hint: str = "",
        kind: str = "text",
        options: Sequence[str] | Callable[[], Sequence[str]] = (),
        keep: Callable[[str], Any] = bool,
    ) -> None:
        self.value, self._keep = value, keep
        options = options() if callable(options) else options
        with ui.element("label").classes("bench-field"):
            text("span", texts()["controls"].get(label, label))
            if options and kind != "list":
                with ui.element("select") as self.element:
                    for option in options:
                        choice = text("option", option).props("selected" if option == value else "")
                        choice.props["value"] = option
            else:
                step = ' step="any"' if kind == "number" else ""
                self.element = ui.element("input").props(f'type="{kind}" autocomplete="off"{step}')
                # set the attribute, because the property would reset the input at each redraw
                self.element.props["^value"] = value
            if kind == "list":  # to type, or to choose
                with ui.element("datalist") as listed:
                    for option in options:
                        ui.element("option").props["value"] = option
                self.element.props["list"] = listed.html_id
            if hint:
                text("span", hint, "soft")
        self.element.on("input", self._take, js_handler="(event) => emit(event.target.value)")

    def set(self, value: str) -> None:
        """Show another value."""
        self.value = value
        self.element.props["^value"] = value
        self.element.update()
        self.element.client.run_javascript(f"getHtmlElement({self.element.id}).value = {json.dumps(value)}")

    def number(self) -> float | None:
        """Return the input as a number, or None if it is not a number."""
        try:
            return float(self.value.replace(",", "."))
        except ValueError:
            return None

    def _take(self, event: Any) -> None:
        self.value = str(event.args)
        self._keep(self.value)


def form(holder: Any, *names: str, proposed: Sequence[str] = ()) -> dict[str, Field]:
    """Add a row of inputs for the ``asked`` fields of a dataclass, with proposed values. Entries are stored in its
    fields.
    """
    extras: dict[str, Any] = {"kind": "list", "options": proposed} if proposed else {}
    how = {field.name: {**field.metadata, **extras} for field in fields(holder)}
    with row("form"):
        return {
            name: Field(value=getattr(holder, name), keep=partial(setattr, holder, name), **how[name]) for name in names
        }


def settings_form(settings: type, typed: dict[str, str]) -> None:
    """Add a form for the settings of a command, with names, sentences and choices. Entries are stored by name."""
    about = dict(re.findall(r"\n    (\w+) : .*\n        (.+)", settings.__doc__ or ""))
    with row("form"):
        for name, hint in get_type_hints(settings).items():
            options = tuple(option for argument in get_args(hint) for option in get_args(argument))
            how = {"hint": about.get(name, ""), "options": ("", *options) if options else ()}
            Field(f"--{name.replace('_', '-')}", typed.get(name, ""), keep=partial(typed.__setitem__, name), **how)


def choices(label: str, every: Sequence[str], holder: Any, name: str) -> None:
    """Add checkboxes. The chosen values are stored in a field of a holder, in their order."""
    with ui.element("fieldset").classes("row choices"):
        text("legend", label)
        for option in every:
            with ui.element("label"):
                box = ui.element("input").props(f'type="checkbox" value="{option}"')
                if option in getattr(holder, name):
                    box.props("checked")
                text("span", option)

                def take(event: Any, option: str = option) -> None:
                    chosen = {*getattr(holder, name)} - {option} | ({option} if event.args else set())
                    setattr(holder, name, tuple(item for item in every if item in chosen))

                box.on("change", take, js_handler="(event) => emit(event.target.checked)")


# ---- Words for a person


def status_line(content: Words, classes: str = "soft") -> Any:
    """Add a line that is read out when it changes."""
    return text("p", content, classes, role="status")


def error_line(content: Words) -> Any:
    """Add a line for errors, empty if there are none."""
    return text("p", lambda: page_words(content() if callable(content) else content), "bench-error", role="alert")


@contextmanager
def folded(title: str) -> Iterator[Any]:
    """Add parts that are folded below a line."""
    with ui.element("details") as details:
        text("summary", title)
        yield details


def remarks_list(remarks: Sequence[Remark]) -> None:
    """List the remarks of a command with the recommended actions. Notes after the first few are folded."""
    count = max(SHOWN_FIRST, sum(remark.level != "info" for remark in remarks))
    with ui.element("ul").classes("remarks"):
        for remark in remarks[:count]:
            with ui.element("li").classes(remark.level):
                text("strong", f"{texts()['levels'][remark.level]}: ")
                text("span", page_words(remark.text).rstrip(".") + ".")
                if action := page_words(remark.action):
                    text("p", sentence(action), "soft")
    if len(remarks) > count:
        with folded(f"{len(remarks) - count} more"):
            for remark in remarks[count:]:
                remarks_list([remark])


def page_words(text: str) -> str:
    """Return a text of a command or of the library with the options that a page offers called as they are there."""
    for option, label in texts()["controls"].items():
        argument = option.removeprefix("--").replace("-", "_")
        text = re.sub(rf"{option}(?![\w-])|`{argument}`", f"“{label}”", text)
    return text


def refused(visit: "Visit", job: "Job | None", error: str, keep: Callable[[str], object] = bool) -> None:
    """Show the refusal. If gyroscopes, turns or rates caused a job's calibration to fail, offer to calibrate without
    them.
    """
    error_line(error)
    about_gyro = re.search("gyro|turn|rotation|rate", error)
    if job is None or not job.words or "--gyro" in job.words or error != job.error or not about_gyro:
        return

    async def again() -> str | None:
        turns = job.words.index("--turn-deg") if "--turn-deg" in job.words else len(job.words)  # not used then
        outcome = await visit.calibrate(job, *job.words[:turns], *job.words[turns + 2 :], "--gyro", "none")
        keep(outcome.error)
        return "/calibrate" if outcome.done else None

    button(texts()["controls"]["--gyro none"], again)


# ---- What every page has: heading, what is connected, the work that goes on


def frame(bench: "Bench", title: str) -> tuple[Any, Any]:
    """Build a page with the timer for its bound parts. Return the containers for its rail and its parts."""
    with ui.element("header").classes("bench-head"):
        ui.link("undrift bench", "/").classes("bench-name")
        status_line(lambda: device_line(bench), "bench-device")
    rail = ui.element("nav").classes("rail").props('aria-label="Stages"')
    with ui.element("div").classes("bench-main"):
        text("h1", title)
        main = ui.element("div")
        with row("bench-work"):
            status_line(lambda: bench.working[-1].words() if bench.working else "")
            bar = ui.element("progress").props('max="1" aria-label="How far the work is"')
            shown_if(bar, lambda: bool(bench.working) and bench.working[-1].share is not None)
            bound(lambda: set_prop(bar, "value", bench.working and bench.working[-1].share))
            cancel = button("Cancel", lambda: bench.working[-1].cancel() if bench.working else None)
            shown_if(cancel, lambda: bool(bench.working) and time.monotonic() - bench.working[-1].began > CANCEL_S)
    ui.timer(REFRESH_S, partial(look, ui.context.client))
    return rail, main


def device_line(bench: "Bench") -> str:
    """Return a description of the connected device."""
    if bench.connecting:
        return f"Connecting {bench.connecting} ..."
    if bench.source is None:
        return (bench.source_error and f"No device: {bench.source_error}") or "No device connected"
    return f"Device: {bench.source.name}" + (f" ({bench.source.error})" if bench.source.error else "")
