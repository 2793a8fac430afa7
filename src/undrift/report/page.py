"""A report page: one self-contained HTML file with tables and pictures, nothing to download."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from undrift import __version__
from undrift.files import write_whole
from undrift.model import Verdict

if TYPE_CHECKING:
    from undrift.model import Calibration, TriadModel


@dataclass(frozen=True, slots=True, kw_only=True)
class Section:
    """A heading, what is said under it, a table and pictures."""

    title: str  # Heading
    text: tuple[str, ...] = ()  # Paragraphs
    columns: tuple[str, ...] = ()  # Heads of the table, with units
    rows: tuple[tuple[str, ...], ...] = ()  # Cells
    pictures: tuple[str, ...] = ()  # SVG elements
    words: bool = False  # Cells hold words rather than figures: aligned at the left


def write_page(
    path: Path, *, title: str, lead: str, sections: tuple[Section, ...], verdict: Verdict | None = None
) -> None:
    """Write a report page."""
    from jinja2 import Environment, PackageLoader

    template = Environment(loader=PackageLoader("undrift", "report"), autoescape=True).get_template("page.html.j2")
    text = template.render(title=title, lead=lead, sections=sections, verdict=verdict, version=__version__)
    write_whole(path, text)


# ---- The part of a page that shows a calibration: matrices with their uncertainty, and what the fits say.


def concise(value: float, uncertainty: float) -> str:
    """Return a value with its standard uncertainty in brackets, in units of the last digits: 0.99643(11)."""
    if not (uncertainty > 0.0 and math.isfinite(uncertainty)):
        return f"{value:.6g}"
    places = max(0, 1 - math.floor(math.log10(uncertainty)))
    if places > 9:
        return f"{value:.6g}({uncertainty:.1g})"
    return f"{value:.{places}f}({round(uncertainty * 10.0**places)})"


def triad_rows(triad: "TriadModel") -> tuple[tuple[str, ...], ...]:
    """Return one row of cells for each axis: matrix, offset, scale factor, values with their uncertainty."""
    sigma = dict(zip(triad.parameters, triad.standard_uncertainty, strict=True))
    rows = []
    for k, axis in enumerate("xyz"):
        matrix = [concise(triad.matrix[k, i], sigma.get(f"m_{axis}{other}", 0.0)) for i, other in enumerate("xyz")]
        offset = concise(triad.offset[k], sigma.get(f"offset_{axis}", 0.0))
        rows.append((axis, *matrix, offset, f"{triad.scale_factor[k]:.6g}"))
    return tuple(rows)


def triad_heads(triad: "TriadModel") -> tuple[str, ...]:
    """Return the heads of ``triad_rows``."""
    return (
        "axis",
        "m x",
        "m y",
        "m z",
        f"offset ({triad.unit_in})",
        f"scale factor ({triad.unit_in} per {triad.unit_out})",
    )


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
