"""A report as the page shows it: answer, verdict, findings, tables, figures and files. It is kept as JSON."""

from base64 import b64encode
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from nicegui import ui

from undrift.findings import SHOWN_FIRST
from undrift.report.figures import svg_of
from undrift.report.report import Drawing, Report, Table

SIGNS = {"fail": ("error", "Failed"), "warn": ("warning", "Warning"), "info": ("info", "Note")}  # icon, and in words


def shown_of(report: Report, plain: Callable[[str], str]) -> dict[str, Any]:
    """Return what the page shows of a report. ``plain`` words its texts for the page."""

    def drawn(figure: Drawing | None) -> str:
        return "" if figure is None else b64encode(svg_of(figure()).encode()).decode()

    def tables(several: Sequence[Table]) -> list[dict[str, Any]]:
        return [
            {
                "title": table.title, "columns": list(table.columns), "note": plain(table.note),
                "cells": table.cells, "figure": drawn(table.figure),
            }
            for table in several if table.rows or table.note or table.figure
        ]  # fmt: skip

    return {
        "title": plain(report.title),
        "answer": plain(report.answer),
        "verdict": report.status if report.verdict_shown else "",
        "findings": [(item.level, plain(item.sentence), plain(item.action)) for item in report.ordered_findings],
        "figures": [drawn(figure) for figure in report.figures],
        "tables": tables(report.tables),
        "details": tables(report.details),
        "notes": [plain(note) for note in report.notes],
        "files": [path.name for path in report.written],
    }


def show(shown: dict[str, Any], link: Callable[[str], str]) -> None:
    """Show a report. ``link`` returns the address of a file."""
    section = ui.element("section").classes(f"result {shown['verdict']}")
    section.props["aria-label"] = shown["title"]
    with section:
        ui.label(shown["title"]).classes("soft")
        ui.label(shown["answer"]).classes("answer")
        if shown["verdict"]:
            ui.label(f"Verdict: {shown['verdict']}").classes("verdict")
        show_findings(shown["findings"])
        with ui.row():
            for name in shown["files"]:
                opened = name.endswith(".html")
                label = "Open the report" if opened else f"Download {name}"
                ui.link(label, link(name) + ("" if opened else "?download=1"), new_tab=opened)
        _show_figures(shown["figures"][:1], shown["title"])
        _show_tables(shown["tables"])
        _show_figures(shown["figures"][1:], shown["title"])
        if shown["details"] or shown["notes"]:
            with ui.expansion("Details"):
                _show_tables(shown["details"])
                for note in shown["notes"]:
                    ui.label(note)


def show_findings(findings: Sequence[Sequence[str]]) -> None:
    """Show findings with their actions. The less consequential ones are folded."""
    first = max(SHOWN_FIRST, sum(level == "fail" for level, *_ in findings))
    _list(findings[:first])
    if len(findings) > first:
        with ui.expansion(f"{len(findings) - first} more findings"):
            _list(findings[first:])


def _list(findings: Iterable[Sequence[str]]) -> None:
    for level, sentence, action in findings:
        icon, name = SIGNS[level]
        with ui.row(wrap=False).classes(f"finding {level}"):
            ui.icon(icon).props('aria-hidden="true"')
            with ui.element("div"):
                ui.label(f"{name}: {sentence}")
                if action:
                    ui.label(action).classes("soft")


def _show_tables(tables: Iterable[dict[str, Any]]) -> None:
    for table in tables:
        ui.label(table["title"]).classes("heading").props('role="heading" aria-level="3"')
        if table["cells"]:
            heads = [
                {"name": f"c{k}", "label": head, "field": f"c{k}", "align": "right" if k else "left"}
                for k, head in enumerate(table["columns"])
            ]
            rows = [{"id": n} | {f"c{k}": cell for k, cell in enumerate(row)} for n, row in enumerate(table["cells"])]
            scroll = ui.element("div").classes("wide").props('tabindex="0" role="region"')
            scroll.props["aria-label"] = table["title"]
            with scroll:
                ui.table(columns=heads, rows=rows, row_key="id").props("dense flat hide-bottom")
        if table["note"]:
            ui.label(table["note"])
        _show_figures([table["figure"]], table["title"])


def _show_figures(figures: Iterable[str], title: str) -> None:
    for figure in filter(None, figures):
        image = ui.element("img").classes("figure")
        image.props["alt"], image.props["src"] = title, f"data:image/svg+xml;base64,{figure}"
