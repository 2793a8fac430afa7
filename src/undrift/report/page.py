"""The frame of every report page: a self-contained HTML file, from ``page.html.j2`` and ``page.css``, without scripts.

A page begins with its answer in a sentence and a picture. Then come the verdict with at most three findings, sections
with figures and tables, folded details (open in print), and provenance. The command supplies the sentence, the picture
and the sections. Figures follow the colour scheme of the reader. page.css defines their dark colours.
"""

import platform
import re
import shlex
from collections.abc import Iterable
from html import escape
from itertools import count
from pathlib import Path

from undrift import __version__
from undrift.base.spoken import showing, spoken, spoken_template
from undrift.base.summary import Drawing, Origin, Section, Summary, at, sentence
from undrift.files import write_whole
from undrift.findings import SHOWN_FIRST, Finding, most_consequential_first
from undrift.report.figures import svg_of
from undrift.report.report import Report

SCREEN_LINES = 3 * 32  # of text on three screens: longer pages have contents


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
        text = environment.get_template("report_page.html.j2").render(
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


def write_page(path: Path, summary: Summary, origin: Origin | None = None) -> None:
    """Write a report page. Findings are listed with those of the verdict. Empty sections are omitted."""
    from jinja2 import Environment, PackageLoader

    style = Path(__file__).with_name("page.css").read_text()
    environment = Environment(loader=PackageLoader("undrift", "report"), autoescape=True)
    environment.filters["sentence"] = sentence
    template = environment.get_template("page.html.j2")
    sections = (*summary.sections, *summary.page(), Section(title="Notes", text=summary.notes))
    filled = [
        entry
        for entry in sections
        if entry.on != "terminal" and (entry.text or entry.findings or entry.rows or entry.pictures)
    ]
    verdict = summary.verdict
    visible, number = [section for section in filled if not section.folded], count(1)
    lines = sum(4 + 2 * len(entry.text) + len(entry.rows) + 14 * len(entry.pictures) for entry in visible)
    with showing():
        text = template.render(
            summary=summary,
            shown=visible,
            folded=[section for section in filled if section.folded],
            findings=_each_code_first((*(verdict.findings if verdict else ()), *summary.findings)),
            contents=lines > SCREEN_LINES,
            ordered=most_consequential_first,
            first=SHOWN_FIRST,
            style=style,
            inlined=lambda picture: _inline(_draw(picture), next(number), set(re.findall(r"--c([0-9a-f]{6}):", style))),
            origin=origin or Origin(),
            spoken=spoken,
            told=spoken_template,
            versions=_versions(),
        )
    write_whole(path, text.lstrip())


def _draw(picture: Drawing | str) -> str:
    return picture if isinstance(picture, str) else str(at("undrift.report.figures:svg_of")(picture.draw()))


def _each_code_first(findings: Iterable[Finding]) -> list[Finding]:
    """Return findings by their consequence, the first of each code before the others of the same."""
    ordered = most_consequential_first(findings)
    first = list({item.code: item for item in reversed(ordered)}.values())[::-1]
    return [*(item for item in ordered if item in first), *(item for item in ordered if item not in first)]


def _inline(svg: str, number: int, palette: set[str]) -> str:
    """Return a picture as a part of a page: no names of other places, own ids, colours that follow the scheme."""
    svg = re.sub(r"<metadata>.*?</metadata>|<\?xml.*?\?>|<!DOCTYPE.*?>| xmlns(:\w+)?=\"[^\"]*\"", "", svg, flags=re.S)
    svg = re.sub(
        r"<svg ([^>]*?)>", lambda m: "<svg " + re.sub(r'(width|height|version)="[^"]*" ?', "", m[1]) + ">", svg
    )
    used = set(re.findall(r"(?:url\(#|href=\"#)([^)\"]+)", svg))
    svg = re.sub(r' id="([^"]*)"', lambda m: f' id="p{number}{m[1]}"' if m[1] in used else "", svg)
    svg = re.sub(r'(url\(#|href="#)', rf"\g<1>p{number}", svg).replace("xlink:href", "href")
    svg = re.sub(
        r'(<rect[^>]*) fill="(#[0-9a-f]{6})"', r'\1 style="fill: \2"', svg
    )  # of a hatch: an attribute takes no variable
    return re.sub(
        r"(?<=: )#([0-9a-f]{6})\b", lambda m: f"var(--c{m[1]}, #{m[1]})" if m[1] in palette else f"#{m[1]}", svg
    )


def _versions() -> str:
    import numpy as np
    import scipy

    return (
        f"undrift {__version__}, Python {platform.python_version()}, numpy {np.__version__}, scipy {scipy.__version__}"
    )
