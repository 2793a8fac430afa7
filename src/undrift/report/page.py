"""Frame of every report page: a self-contained HTML file without scripts, from ``page.html.j2`` and ``page.css``.

A page begins with its answer in a sentence and a figure. Then come the verdict with at most three findings, tables and figures,
folded details (open in print), and provenance. Figures follow the colour scheme of the reader. page.css defines their dark colours.
"""

import os
import platform
import re
import shlex
from dataclasses import dataclass, field
from datetime import UTC, datetime
from itertools import count
from pathlib import Path

from markupsafe import escape

from undrift import __version__
from undrift.base.spoken import showing, spoken
from undrift.files import write_whole
from undrift.findings import SHOWN_FIRST
from undrift.report.figures import svg_of
from undrift.report.report import Report


def today() -> str:
    """Return the date of a page, ISO 8601, UTC. The environment variable SOURCE_DATE_EPOCH (s since 1970) overrides it."""
    epoch = os.environ.get("SOURCE_DATE_EPOCH", "")
    moment = datetime.fromtimestamp(int(epoch), UTC) if epoch.isdigit() else datetime.now(UTC)
    return moment.isoformat(timespec="seconds")


@dataclass(frozen=True, slots=True, kw_only=True)
class Origin:
    """Command and input files of a page, and its date."""

    command: str = ""
    inputs: tuple[tuple[str, str], ...] = ()  # file and sha256
    date: str = field(default_factory=today)


def write_report(path: Path, report: Report, origin: Origin | None = None) -> None:
    """Write the page of a report."""
    write_whole(path, page_text(report, origin))


def page_text(report: Report, origin: Origin | None = None) -> str:
    """Return a report as a self-contained HTML page."""
    from jinja2 import Environment, PackageLoader

    style, number = Path(__file__).with_name("page.css").read_text(), count(1)
    palette = set(re.findall(r"--c([0-9a-f]{6}):", style))
    environment = Environment(loader=PackageLoader("undrift", "report"), autoescape=True)
    with showing():
        text = environment.get_template("page.html.j2").render(
            report=report,
            first=SHOWN_FIRST,
            style=style,
            svg=lambda figure: _inline(svg_of(figure()), next(number), palette),
            next_command=shlex.join(map(str, report.next_command)),
            origin=origin or Origin(),
            spoken=spoken,
            versions=_versions(),
        )
    return text.lstrip()


def notebook_text(report: Report) -> str:
    """Return a report as a part of a notebook: answer, verdict with its first findings, and tables."""
    parts = [f"<h4>{escape(report.title)}</h4><p>{escape(report.answer)}</p>"] if report.answer else []
    if report.verdict_shown:
        items = "".join(f"<li>{escape(item.text)}</li>" for item in report.ordered_findings[:SHOWN_FIRST])
        parts.append(f"<p>Verdict: {report.status}</p><ul>{items}</ul>")
    for table in report.tables:
        heads = "".join(f"<th>{escape(head)}</th>" for head in table.columns)
        rows = ("".join(f"<td>{escape(cell)}</td>" for cell in row) for row in table.cells)
        body = "".join(f"<tr>{row}</tr>" for row in rows)
        parts.append(f"<table><caption>{escape(table.title)}</caption><tr>{heads}</tr>{body}</table>")
    return "".join(parts)


def _inline(svg: str, number: int, palette: set[str]) -> str:
    """Return a figure as part of a page, without external names, with its own ids, and with colours that follow the scheme."""
    svg = re.sub(r"<metadata>.*?</metadata>|<\?xml.*?\?>|<!DOCTYPE.*?>| xmlns(:\w+)?=\"[^\"]*\"", "", svg, flags=re.S)
    svg = re.sub(
        r"<svg ([^>]*?)>", lambda m: "<svg " + re.sub(r'(width|height|version)="[^"]*" ?', "", m[1]) + ">", svg
    )
    used = set(re.findall(r"(?:url\(#|href=\"#)([^)\"]+)", svg))
    svg = re.sub(r' id="([^"]*)"', lambda m: f' id="p{number}{m[1]}"' if m[1] in used else "", svg)
    svg = re.sub(r'(url\(#|href="#)', rf"\g<1>p{number}", svg).replace("xlink:href", "href")
    svg = re.sub(
        r'(<rect[^>]*) fill="(#[0-9a-f]{6})"', r'\1 style="fill: \2"', svg
    )  # colours of a hatch, because an attribute cannot contain a variable
    return re.sub(
        r"(?<=: )#([0-9a-f]{6})\b", lambda m: f"var(--c{m[1]}, #{m[1]})" if m[1] in palette else f"#{m[1]}", svg
    )


def _versions() -> str:
    import numpy as np
    import scipy

    return (
        f"undrift {__version__}, Python {platform.python_version()}, numpy {np.__version__}, scipy {scipy.__version__}"
    )
