"""The pages of correct and rig run: what each brings to the frame."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from undrift.base.summary import Cells, Origin, Section, Summary, table_section
from undrift.model import AXES
from undrift.report import figures
from undrift.report.figures import AXIS_MARKERS, OPTICS, new_figure, svg_of
from undrift.report.page import write_page
from undrift.units import RADIAN_PER_DEGREE

if TYPE_CHECKING:
    from undrift.record import Record
    from undrift.rig.folder import Piece as DwellPiece
    from undrift.rig.run import RunResult

DPS = RADIAN_PER_DEGREE


def write_correct_report(
    path: Path,
    record: "Record",
    rows: Sequence[dict[str, Any]],
    *,
    remarks: tuple[str, ...],
    origin: Origin | None = None,
) -> None:
    """Write the page of corrected recordings; the record is the first of them, or its beginning."""
    samples = sum(row["samples"] for row in rows)
    outside = sum(row["samples_outside"] + row["samples_without_temperature"] for row in rows)
    far = sum(row["samples_extrapolated"] for row in rows)
    covered = "none outside the temperatures of the calibration"
    if far or outside:
        shares = [f"{100.0 * count / samples:.3g} %" for count in (far, outside)]
        covered = f"{shares[0]} of them where the tuning tables are extrapolated, {shares[1]} outside"
    heads = ("recording", "output", "samples", "outside tables", "extrapolated", "without temperature")
    keys = ("samples", "samples_outside", "samples_extrapolated", "samples_without_temperature")
    table = tuple(
        (Path(row["recording"]).name, Path(row["output"]).name, *(str(row[key]) for key in keys)) for row in rows
    )
    summary = Summary(
        title=f"Corrected: {table[0][0]}" + (f" and {len(rows) - 1} more" if len(rows) > 1 else ""),
        answer=f"{samples} samples are in rad/s and m/s2, {covered}.",
        pictures=(svg_of(figures.draw_record(record)),),
        sections=(
            Section(title="Recordings", columns=heads, rows=table),
            Section(title="Warnings and notes", text=remarks),
        ),
    )
    write_page(path, summary, origin)


def write_rig_report(path: Path, result: "RunResult", name: str, *, origin: Origin | None = None) -> None:
    """Write the page of a rig run."""
    turns = [piece for piece in result.pieces if piece.purpose == "rate"]
    missing = sum(piece.missing for piece in result.pieces)
    off = [(piece.turn_rate - piece.nominal_turn_rate) / DPS for piece in turns]
    figure, (panel,) = new_figure(1, height=2.2)
    figures.entitle(figure, "Achieved less nominal rate of each dwell, 95 %")
    for k, axis in enumerate(AXES):
        own = [place for place, piece in enumerate(turns) if piece.axis == axis]
        if own:
            bars = [1.96 * turns[place].turn_rate_uncertainty / DPS for place in own]
            style: Any = {
                "color": figures.AXIS_COLOURS[k],
                "fmt": AXIS_MARKERS[k],
                "markersize": 4.0,
                "capsize": 2.0,
                "label": f"about {axis}",
            }
            panel.errorbar([turns[p].nominal_turn_rate / DPS for p in own], [off[p] for p in own], yerr=bars, **style)
    panel.axhline(0.0, color=OPTICS, linewidth=0.6)
    panel.set(xlabel="nominal rate (deg/s)", ylabel="difference (deg/s)")
    figures.legend_above(panel)
    cells: Cells[DwellPiece] = (
        ("dwell", lambda piece: piece.name),
        ("purpose", lambda piece: piece.purpose),
        ("up", lambda piece: piece.up),
        ("samples", lambda piece: str(piece.samples)),
        ("missing", lambda piece: str(piece.missing)),
        ("nominal (deg/s)", lambda piece: f"{piece.nominal_turn_rate / DPS:+g}" if piece.purpose == "rate" else ""),
        ("achieved (deg/s)", lambda piece: f"{piece.turn_rate / DPS:+.4f}" if piece.purpose == "rate" else ""),
        ("temperature (degC)", lambda piece: "" if piece.device_c is None else f"{piece.device_c:.2f}"),
    )
    summary = Summary(
        title=f"Rig run: {name}, on {result.rig}",
        answer=f"{len(result.pieces)} dwells are on the disk, {missing} readings are missing"
        + (f", and achieved rates differ from nominal ones by up to {max(map(abs, off)):.2g} deg/s." if turns else "."),
        pictures=(svg_of(figure),) if turns else (),
        sections=(table_section("Dwells", result.pieces, cells),),
    )
    write_page(path, summary, origin)
