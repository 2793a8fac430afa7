"""Lists of files and jobs, newest first, selected with a click, and the drop area for files."""

import json
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from nicegui import ui

from undrift.commands.bench.library import came_words
from undrift.web import parts

if TYPE_CHECKING:
    from undrift.web.bench import Visit


def listing(
    title: str,
    every: Callable[[], Sequence[Any]],
    chosen: Callable[[], Any],
    choose: Callable[[Any], Any],
) -> None:
    """Add a list that follows the files and jobs of the bench. static/drawings.js redraws only the list."""
    widget, state = ui.element("undrift-list").props(f'label="{title}"'), list[object]()

    def show() -> None:
        now = [(e.folder.name, e.name, e.error, e is chosen() and e.summary) for e in every()]
        if state != [now]:
            state[:] = [now]
            rows = [(e.folder.name, e.name, f"{e.summary} ({came_words(e)})", e is chosen()) for e in every()]
            parts.set_prop(widget, "what", json.dumps(rows))

    def handle(event: Any) -> Any:
        return next((choose(e) for e in every() if e.folder.name == event.args["detail"]), None)

    widget.on("choose", parts.acted(handle), ["detail"])
    parts.bound(show)


def drop(visit: "Visit", then: str = "") -> None:
    """Add an area for dropping or choosing files. Then open a page, if one is named."""
    client = ui.context.client
    bench, recordings = visit.bench, visit.recordings
    with ui.element("label").classes("drop bench-file") as drop:
        parts.text("span", "Drop files or a folder here, or choose files: ")
        chooser = ui.element("input").props('type="file" multiple aria-label="Choose files"')
    status = parts.status_line("")
    js = "(event) => { event.preventDefault(); benchUpload(event.currentTarget, %s); }"
    chooser.on("change", js_handler=js % "event.target.files")
    dropped = "(event) => { event.preventDefault(); benchDropped(event.currentTarget, event.dataTransfer.items); }"
    drop.on("drop", js_handler=dropped)
    drop.on("dragover", js_handler="(event) => { event.preventDefault(); event.currentTarget.classList.add('over'); }")
    drop.on("dragleave", js_handler="(event) => event.currentTarget.classList.remove('over')")

    def sending(event: Any) -> None:
        parts.set_text(status, f"Sending {event.args['detail']['name']} ...")

    async def sent(event: Any) -> None:
        detail = event.args["detail"]
        if detail.get("error"):
            parts.set_text(status, str(detail["error"]))
            return
        parts.set_text(status, f"Reading {detail['name']} ...")
        files = [bench.inside(str(file)) for file in detail.get("files", (detail.get("file"),))]
        await (recordings.add_together(files) if len(files) > 1 else recordings.add(files[0]))
        parts.set_text(status, "")
        if then:
            client.open(then)

    for element in (chooser, drop):
        element.on("sending", sending, ["detail"])
        element.on("sent", sent, ["detail"])
