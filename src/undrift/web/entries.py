"""Lists of files and jobs, the newest first: each is chosen by a click, renamed, or deleted after a question."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from nicegui import ui

from undrift.web import parts
from undrift.web.library import Entry, came_words

if TYPE_CHECKING:
    from undrift.web.bench import Visit

SHOWN = 20  # of a list that is not folded


def listing(
    visit: "Visit",
    title: str,
    every: Callable[[], Sequence[Any]],
    chosen: Callable[[], Any],
    choose: Callable[[Any], Any],
) -> None:
    """Add a list that follows what the bench holds; nothing else of the page is drawn anew for it."""

    def draw() -> None:
        if entries := every():
            parts.text("h2", title)
            with ui.element("ul").classes("bench-list"):
                for one in entries[:SHOWN]:
                    _row(visit, one, chosen(), choose)
            if len(entries) > SHOWN:
                with parts.folded(f"{len(entries) - SHOWN} more"), ui.element("ul").classes("bench-list"):
                    for one in entries[SHOWN:]:
                        _row(visit, one, chosen(), choose)

    def state() -> object:
        known = [
            (one.folder, one.title, getattr(one, "kind", None), one.error, getattr(one, "calibration", None))
            for one in every()
        ]
        return known, chosen() and chosen().folder, visit.renamed and visit.renamed.folder

    parts.redrawn(state, draw)


def _row(visit: "Visit", one: Entry, chosen: Entry | None, choose: Callable[[Any], Any]) -> None:
    def rename() -> None:
        visit.library.rename(one, visit.new_name)
        visit.renamed = None

    with ui.element("li"):
        parts.button(one.name, partial(choose, one), "choose", pressed=one is chosen)
        parts.text("span", f"{one.summary} ({came_words(one)})", "soft")
        if visit.renamed is one:
            parts.Field("Name", visit.new_name, keep=partial(setattr, visit, "new_name"))
            parts.button("Save the name", rename)
            parts.button("Cancel", partial(setattr, visit, "renamed", None))
            return

        def begin() -> None:
            visit.renamed, visit.new_name = one, one.name

        parts.button("Rename", begin, name=f"Rename {one.name}")
        ask = f"Delete {one.name} and what was made of it? This cannot be undone."
        parts.button("Delete", partial(visit.bench.delete, one), name=f"Delete {one.name}", ask=ask)
