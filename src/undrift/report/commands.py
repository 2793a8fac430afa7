"""The page of a rig run: what it brings to the frame."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from undrift.base.summary import Cells, Origin, Summary, table_section
from undrift.model import AXES
from undrift.report import figures
from undrift.report.figures import AXIS_MARKERS, OPTICS, new_figure, svg_of
from undrift.report.page import write_page
from undrift.units import RADIAN_PER_DEGREE

if TYPE_CHECKING:
    from undrift.rig.folder import RecordedDwell as DwellPiece
    from undrift.rig.run import RunResult

DPS = RADIAN_PER_DEGREE


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
