"""A report page: one self-contained HTML file with tables and pictures, nothing to download."""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from undrift import __version__
from undrift.files import write_whole
from undrift.findings import SHOWN_FIRST, Finding, most_consequential_first
from undrift.model import AXES, Verdict

if TYPE_CHECKING:
    from undrift.model import Calibration, TriadModel

Item = TypeVar("Item")
Cells = Sequence[tuple[str, Callable[[Item], str]]]  # heads of a table, each with what makes its cells


@dataclass(frozen=True, slots=True, kw_only=True)
class Section:
    """A heading with text, findings, a table and pictures under it."""

    title: str
    text: tuple[str, ...] = ()  # Paragraphs
    findings: tuple[Finding, ...] = ()  # The most consequential are shown, the others folded
    columns: tuple[str, ...] = ()  # Heads of the table, with units
    rows: tuple[tuple[str, ...], ...] = ()  # Cells
    pictures: tuple[str, ...] = ()  # SVG elements
    words: bool = False  # Cells hold words rather than figures: aligned at the left


def rows_section(title: str, rows: Sequence[dict[str, str]], **more: Any) -> Section:
    """Return a section with rows that all have the same heads, and more of its fields; without rows, with nothing."""
    if not rows:
        return Section(title=title)
    return Section(title=title, columns=tuple(rows[0]), rows=tuple(tuple(row.values()) for row in rows), **more)


def table_section(title: str, items: Iterable[Item], cells: Cells[Item], **more: Any) -> Section:
    """Return a section with a row for each item; each column is a head and the function that makes its cell."""
    rows = tuple(tuple(cell(item) for _, cell in cells) for item in items)
    return Section(title=title, columns=tuple(head for head, _ in cells), rows=rows, **more)


def write_page(
    path: Path, *, title: str, lead: str, sections: tuple[Section, ...], verdict: Verdict | None = None
) -> None:
    """Write a report page."""
    from jinja2 import Environment, PackageLoader

    template = Environment(loader=PackageLoader("undrift", "report"), autoescape=True).get_template("page.html.j2")
    text = template.render(
        title=title,
        lead=lead,
        sections=sections,
        verdict=verdict,
        reasons=() if verdict is None else most_consequential_first(verdict.findings),
        ordered=most_consequential_first,
        first=SHOWN_FIRST,
        version=__version__,
    )
    write_whole(path, text)


# ---- cells


def number(value: float, form: str = ".2f") -> str:
    """Return a figure, or a dash where there is none."""
    return f"{value:{form}}" if math.isfinite(value) else "–"


def interval(ends: Sequence[float], form: str = ".3f") -> str:
    """Return an interval."""
    return f"{ends[0]:{form}} to {ends[1]:{form}}"


def plain_words(name: str) -> str:
    """Return a name of the code as words."""
    return name.replace("_", " ")


def concise(value: float, uncertainty: float) -> str:
    """Return a value with its standard uncertainty in brackets, in units of the last digits: 0.99643(11)."""
    if not (uncertainty > 0.0 and math.isfinite(uncertainty)):
        return f"{value:.6g}"
    places = max(0, 1 - math.floor(math.log10(uncertainty)))
    if places > 9:
        return f"{value:.6g}({uncertainty:.1g})"
    return f"{value:.{places}f}({round(uncertainty * 10.0**places)})"


# ---- a calibration


def triad_rows(triad: "TriadModel") -> tuple[tuple[str, ...], ...]:
    """Return one row of cells for each axis: matrix, offset, scale factor, values with their uncertainty."""
    sigma = dict(zip(triad.parameters, triad.standard_uncertainty, strict=True))
    return tuple(
        (
            axis,
            *(concise(triad.matrix[k, i], sigma.get(f"m_{axis}{other}", 0.0)) for i, other in enumerate(AXES)),
            concise(triad.offset[k], sigma.get(f"offset_{axis}", 0.0)),
            f"{triad.scale_factor[k]:.6g}",
        )
        for k, axis in enumerate(AXES)
    )


def triad_heads(triad: "TriadModel") -> tuple[str, ...]:
    """Return the heads of ``triad_rows``."""
    scale = f"scale factor ({triad.unit_in} per {triad.unit_out})"
    return ("axis", "m x", "m y", "m z", f"offset ({triad.unit_in})", scale)


def triad_notes(triad: "TriadModel") -> tuple[str, ...]:
    """Return what goes with the rows: residual, rank, condition, range, g-sensitivity."""
    low, high = triad.valid_range
    notes = [
        f"residual {triad.rms_residual:.3g} {triad.unit_out} rms over {triad.count} equations; rank {triad.rank}, "
        f"condition {triad.condition:.3g}; valid {low:.3g} to {high:.3g} {triad.unit_out}"
    ]
    if triad.g_sensitivity is not None:
        worst = float(abs(triad.g_sensitivity).max())
        notes.append(f"g-sensitivity up to {worst:.2g} {triad.unit_out} per m/s2")
    return tuple(notes)


def calibration_sections(calibration: "Calibration") -> tuple[Section, ...]:
    """Return the sections of a page that show a calibration."""
    named = (("Accelerometers", calibration.accel), ("Gyroscopes", calibration.gyro))
    return tuple(
        Section(
            title=f"{name}: {triad.method}",
            text=(
                f"corrected = matrix @ (raw - offset); matrix in {triad.unit_out} per {triad.unit_in}, standard uncertainty of "
                "the last digits in brackets.",
                *triad_notes(triad),
            ),
            columns=triad_heads(triad),
            rows=triad_rows(triad),
        )
        for name, triad in named
        if triad is not None
    )
