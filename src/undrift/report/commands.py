"""The pages of calibrate, noise, correct, orient, twin and rig run: what each brings to the frame.

The page of a calibration judges it by its own recordings: readings of every piece are corrected as any recording is, so that

    residual of a pose      |a| - g                              of a dwell   w - rate * axis
    leverage of piece i     x_i' (sum x x')^+ x_i / rank,        x = (a, 1) or (w, 1); of norms alone (a_j a_k, a_j) / |a|

"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from undrift.base.summary import Cells, Origin, Section, Summary, number, table_section
from undrift.commands.certificate import departures_words, expanded_words, gravity_uncertainty
from undrift.model import AXES
from undrift.report import figures
from undrift.report.certificate import draw_calibration
from undrift.report.figures import AXIS_MARKERS, DEVICE, ERROR, LIMIT, OPTICS, SHADE, envelope, new_figure, svg_of
from undrift.report.page import calibration_sections, write_page
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from undrift.arrays import FloatArray
    from undrift.calibration.observe import CalibrateSettings
    from undrift.calibration.pieces import Piece
    from undrift.model import Calibration
    from undrift.record import Record, Session
    from undrift.rig.folder import Piece as DwellPiece
    from undrift.rig.run import RunResult

MG, DPS = STANDARD_GRAVITY / 1e3, RADIAN_PER_DEGREE

# ---- calibrate


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Judged:
    """A piece that a calibration used, with what it reads when corrected."""

    piece: "Piece"
    accel: "FloatArray"  # (3,), mean, m/s2; NaN without accelerometers
    gyro: "FloatArray"  # (3,), mean, rad/s; NaN without gyroscopes
    stated: "FloatArray"  # (3,), turn rate that the table had, rad/s; NaN where none is stated


def judge_pieces(
    session: "Session", settings: "CalibrateSettings", made: "Calibration"
) -> tuple[list["Record"], list[Judged], list["Piece"]]:
    """Return the corrected records of a session, the pieces that the calibration used, and those that it left out."""
    from undrift.calibration.pieces import pieces_of
    from undrift.correction.correct import correct_whole

    pieces, _ = pieces_of(session, settings, made)
    records = [correct_whole(_calibrated(record, made), made, policy="hold").record for record in session.records]
    rates = {(turn.recording, turn.start): turn for turn in session.turns if turn.turn_rate is not None}
    judged = []
    for piece in pieces:
        record, turn = records[piece.recording], rates.get((piece.recording, piece.start))
        skip = round(settings.settle_s * record.sample_rate_hz) if piece.kind == "turn" else 0
        inner = slice(piece.start + skip, max(piece.start + skip + 1, piece.stop - skip))
        means = [
            np.full(3, np.nan) if values is None else np.nanmean(values[inner], axis=0)
            for values in (record.accel, record.gyro)
        ]
        stated = (
            np.full(3, np.nan) if turn is None else (turn.turn_rate or 0.0) * np.eye(3)[AXES.index(turn.axis or "x")]
        )
        if not piece.why:
            judged.append(Judged(piece=piece, accel=means[0], gyro=means[1], stated=stated))
    return records, judged, [piece for piece in pieces if piece.why]


def _calibrated(record: "Record", made: "Calibration") -> "Record":
    """Leave out a triad that the calibration has no model of: its unit may be counts."""
    left: dict[str, Any] = {} if made.gyro else {"gyro": None, "gyro_unit": "rad/s"}
    return replace(record, **left | ({} if made.accel else {"accel": None, "accel_unit": "m/s2"}))


def leverages(judged: Sequence[Judged], made: "Calibration") -> "FloatArray":
    """Return the share of each piece in what is known: its leverage over the rank, mean over the triads; (n,)."""
    shares = []
    for triad, name, kinds in ((made.accel, "accel", ("still",)), (made.gyro, "gyro", ("still", "turn"))):
        rows = np.array([np.append(getattr(one, name), 1.0) for one in judged if one.piece.kind in kinds])
        if triad is None or not len(rows) or np.isnan(rows).any():
            continue
        rows[:, :3] /= np.abs(rows[:, :3]).max()
        if triad.method.startswith("multi-position") and name == "accel":
            upper = np.triu_indices(3)
            rows = np.column_stack(((rows[:, :3, None] * rows[:, None, :3])[:, upper[0], upper[1]], rows[:, :3]))
        levers = np.einsum("ij,ji->i", rows, np.linalg.pinv(rows))
        share = np.zeros(len(judged))
        share[[k for k, one in enumerate(judged) if one.piece.kind in kinds]] = levers / levers.sum()
        shares.append(share)
    return np.mean(shares, axis=0) if shares else np.full(len(judged), np.nan)


def write_calibration_report(
    made: "Calibration",
    session: "Session",
    settings: "CalibrateSettings",
    path: Path,
    *,
    about: tuple[str, ...] = (),
    origin: Origin | None = None,
) -> None:
    """Write the page of a calibration; ``about`` says what was calibrated and what was found in the session."""
    records, judged, out = judge_pieces(session, settings, made)
    poses, dwells = _residuals(judged, made)
    parts = [f"gravity to {np.sqrt(np.mean(poses**2)):.2g} mg rms in {len(poses)} poses"] if len(poses) else []
    if len(dwells):
        parts.append(f"the table's rates to {np.sqrt(np.mean(dwells**2)):.2g} deg/s rms in {len(dwells)} dwells")
    triads = [(name, triad) for name in ("accel", "gyro") if (triad := getattr(made, name)) is not None]
    doubts = "; ".join(expanded_words(*pair, gravity_uncertainty(made, pair[0])) for pair in triads)
    ideal = (*(departures_words(*pair) for pair in triads), "Bars: expanded uncertainty, 95 %, as in the certificate.")
    text = (
        f"The fit reproduces {' and '.join(parts)}. These are residuals of the fit, on its own readings: what they all share, as "
        "tilted faces or a wrong gravity, is not in them. The uncertainty above is that of other readings at this temperature."
    )
    sections = [Section(title="Matrix and offsets: the picture above", text=ideal)]
    if parts:
        drawn = (svg_of(_draw_residuals(judged, made)),)
        sections.append(Section(title="Residuals of the fit", text=(text,), pictures=drawn))
    if made.accel is not None:
        text = "Shaded: the stills that were used. Turns and handling lie between them."
        drawn = (svg_of(_draw_norm(records, judged, made.gravity_m_s2)),)
        sections.append(Section(title="Specific force over the session", text=(text,), pictures=drawn))
    summary = Summary(
        title=f"Calibration of {made.device or 'a device'}",
        answer=f"Expanded uncertainty (95 %) at the temperature of the calibration: {doubts}.",
        pictures=(svg_of(draw_calibration(made)),),
        verdict=made.verdict,
        sections=(
            *sections,
            _contributions(session, judged, out, made),
            *calibration_sections(made),
            Section(title="What was calibrated", text=about),
        ),
    )
    write_page(path, summary, origin)


def _residuals(judged: Sequence[Judged], made: "Calibration") -> tuple["FloatArray", "FloatArray"]:
    """Return |a| - g of each pose, mg, and rate errors of each dwell, deg/s (n, 3)."""
    norms = np.array([np.linalg.norm(one.accel) - made.gravity_m_s2 for one in judged if one.piece.kind == "still"])
    rates = np.array([one.gyro - one.stated for one in judged if one.piece.kind == "turn"]).reshape(-1, 3)
    return norms[np.isfinite(norms)] / MG, rates[np.isfinite(rates).all(axis=1)] / DPS


def _draw_residuals(judged: Sequence[Judged], made: "Calibration") -> "Figure":
    """Draw the residual of each pose and each dwell."""
    poses, dwells = _residuals(judged, made)
    figure, panels = new_figure(int(len(poses) > 0) + int(len(dwells) > 0), share_x=False)
    figures.entitle(figure, "Residual of each pose and dwell: the fit on its own readings")
    if len(poses):
        marks = np.arange(1, len(poses) + 1)
        panels[0].vlines(marks, 0.0, poses, color=LIMIT, linewidth=0.8)
        panels[0].plot(marks, poses, "o", color=DEVICE, markersize=4.0)
        panels[0].set(xlabel="pose, in order of time", ylabel="|a| - g (mg)")
    if len(dwells):
        marks = np.arange(1, len(dwells) + 1)
        for k, axis in enumerate(AXES):
            panels[-1].plot(
                marks + 0.2 * (k - 1),
                dwells[:, k],
                AXIS_MARKERS[k],
                color=figures.AXIS_COLOURS[k],
                markersize=4.0,
                label=f"gyro {axis}",
            )
        panels[-1].set(xlabel="dwell at a known rate, in order of time", ylabel="rate error (deg/s)")
        figures.legend_above(panels[-1])
    for panel in panels:
        panel.axhline(0.0, color=OPTICS, linewidth=0.6)
    return figure


def _draw_norm(records: Sequence["Record"], judged: Sequence[Judged], gravity_m_s2: float) -> "Figure":
    """Draw |a| over the recordings, one after the other, with the stills shaded."""
    figure, (panel,) = new_figure(1, height=2.4)
    figures.entitle(figure, "Norm of the specific force over the session, stills shaded")
    start = 0.0
    for number_, record in enumerate(records):
        time = record.time - record.time[0] + start
        if record.accel is not None:
            panel.plot(*envelope(time, np.linalg.norm(record.accel, axis=1), 600), color=DEVICE, linewidth=0.8)
        for one in judged:
            if one.piece.recording == number_ and one.piece.kind == "still":
                ends = float(time[one.piece.start]), float(time[one.piece.stop - 1])
                panel.axvspan(*ends, facecolor=SHADE, linewidth=0.0, zorder=0)
                panel.plot(
                    ends,
                    [np.linalg.norm(one.accel)] * 2,
                    color=ERROR,
                    linewidth=2.2,
                    solid_capstyle="butt",
                    label="mean of a still" if start == 0.0 else None,
                )
        start = float(time[-1]) + 1.0 / record.sample_rate_hz
    panel.axhline(gravity_m_s2, color=OPTICS, linewidth=0.6, linestyle="--", label="local gravity")
    where = "time, recordings one after the other (s)" if len(records) > 1 else "time (s)"
    panel.set(xlabel=where, ylabel="|a| (m/s2)")
    figures.legend_above(panel)
    return figure


def _contributions(
    session: "Session", judged: Sequence[Judged], out: Sequence["Piece"], made: "Calibration"
) -> Section:
    """Return what each recording brought to the fit."""
    shares, names = leverages(judged, made), [name for name, _ in session.inputs if not name.endswith(".toml")]
    rows = []
    for k, record in enumerate(session.records):
        own = [place for place, one in enumerate(judged) if one.piece.recording == k]
        kinds = [judged[place].piece.kind for place in own]
        name = names[k] if len(names) == len(session.records) else f"recording {k + 1}"
        used = sum(judged[place].piece.stop - judged[place].piece.start for place in own)
        counted = (len(record), used, kinds.count("still"), kinds.count("turn"), sum(one.recording == k for one in out))
        rows.append((name, *map(str, counted), number(100.0 * float(shares[own].sum()), ".1f")))
    text = "Information: share of its poses and dwells in the leverage on matrix and offsets, equal weights, mean of both triads."
    heads = ("recording", "samples", "of them used", "stills used", "turns used", "pieces left out", "information (%)")
    return Section(title="What each recording contributed", text=(text,), columns=heads, rows=tuple(rows))


# ---- correct, orient, twin, rig run


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
