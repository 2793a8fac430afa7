"""``undrift info``: the content of a file or folder: rates, units, spans, gaps, stills, problems, and the map it needs."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from undrift.base.options import Files, OptionalOutput, Up, WrittenPath, options, verb
from undrift.base.summary import Drawing, Section, Summary, at, figure_of
from undrift.commands import Progress, reading, silent
from undrift.commands.files import (
    Opening,
    Place,
    check_folder,
    check_output,
    name_of,
    named_columns,
    session_of,
)
from undrift.commands.old_batch import of_folder
from undrift.errors import InputError
from undrift.mounting import statement_of
from undrift.units import RADIAN_PER_DEGREE

if TYPE_CHECKING:
    from undrift.arrays import FloatArray
    from undrift.calibration.pieces import Piece
    from undrift.calibration.session import Observed
    from undrift.io.inspect import Description
    from undrift.model import Calibration, DriftTables
    from undrift.record import Record, Session, Still

_KEYS = (
    *("kind", "format", "rows", "sample_rate_hz", "usual_rate_hz", "duration_s"),
    *("columns", "gaps", "temp_c", "problems", "summary"),
)


@options
@dataclass(frozen=True, kw_only=True)
class Proposal:
    """The map to write for a table with foreign columns.

    Parameters
    ----------
    write_map : Path or None
        Map to write for a table with foreign columns, each unit with its reason: .toml.
    gyro_unit : str or None
        With --write-map: unit of the gyroscopes where nothing shows it: rad/s, dps, count or v.
    accel_unit : str or None
        With --write-map: unit of the accelerometers: m/s2, g, mg, count or v.
    """

    write_map: WrittenPath = None
    gyro_unit: str | None = None
    accel_unit: str | None = None

    def check(self, *, reads: Sequence[Path | None]) -> None:
        """Raise an error if a unit is given without a map."""
        check_output(self.write_map, endings=(".toml",), reads=reads)
        option = next((field.name for field in fields(self)[1:] if getattr(self, field.name) is not None), "")
        if option and self.write_map is None:
            raise InputError(
                f"`{option}`: this option requires `write_map`. Add `write_map` map.toml, or omit `{option}`."
            )


POSES = 9  # still phases of a recording that may calibrate a device


@verb
@of_folder(None, alone=("write_map", "write_session"))
def info(
    *files: Files,
    opening: Opening = Opening(),
    reference_up: Up = None,
    proposal: Proposal = Proposal(),
    write_session: WrittenPath = None,
    turn_deg: float | None = None,
    output: OptionalOutput = None,
    progress: Progress = silent,
) -> Summary:
    """Describe a recording, session, calibration, reference or device: rates, units, spans, gaps, stills found.

    Parameters
    ----------
    files : Path
        Any file or folder. With --write-session, recordings of the same device.
    proposal : Proposal
        The map to write for a table with foreign columns.
    write_session : Path or None
        Folder to write session.toml into, with the rests, faces and turns of bare recordings, ready to edit.
    turn_deg : float or None
        With --write-session: angle of the turns between rests, deg: 360 for full turns.
    output : Path or None
        For a folder, the output folder for the table of its files (summary.csv, .parquet, .html and .json).
    """
    from undrift.calibration.triads import find_disagreement
    from undrift.io.store import findings_json, read_calibration, verdict_json

    if write_session is not None:
        if proposal != Proposal():
            raise InputError("`write_session` and `write_map` cannot be combined. Run two commands.")
        return _write_session(files, write_session, opening, turn_deg, progress)
    if turn_deg is not None:
        raise InputError("`turn_deg` requires `write_session`: add the folder of the session, or omit `turn_deg`")
    if len(files) > 1:
        raise InputError(f"info: expected one file or folder without `write_session`, got {len(files)}. Name only one.")
    (file,) = files
    if output is not None:
        raise InputError(f"output: expected a folder of recordings for a table, got {file}. Omit `output`.")
    proposal.check(reads=(file, opening.column_map))
    with reading(progress, 0.8, file):
        description, opening = _describe_file(file, opening, reference_up)
    if proposal.write_map is not None:
        return _write_map(description, proposal.write_map, proposal, opening)
    session = description.session
    records = () if session is None else session.records
    disagree = tuple(entry for record in records if (entry := find_disagreement(record)) is not None)
    description = replace(description, findings=(*description.findings, *disagree))
    observed, reason = _look(session)
    stills = [] if observed is None else [_span(records[still.recording], still) for still in observed.stills]
    drawing = Drawing(place="undrift.commands.info:draw_found", of=(session, observed, name_of(file)))
    effects = _effects(file) if description.kind == "device" else {}
    calibration = read_calibration(file) if description.kind == "calibration" else None
    if calibration is not None:
        effects, span = _parts(calibration)
        description = replace(description, temp_c=span)
        drawing = figure_of("calibration:draw_calibration", calibration)
    verdict = None if calibration is None else calibration.verdict
    parts = effects if verdict is None else effects | {"verdict": [verdict.status, *verdict.reasons]}
    lines = (
        *_lines(description, stills, reason),
        *(f"{section}: {', '.join(texts)}" for section, texts in effects.items()),
    )
    extra_data: dict[str, object] = {
        "units": dict(description.units),
        "stills": stills,
        "map": description.example,
        "effects": parts,
    }
    extra_data |= {"findings": findings_json(description.findings), "no_still_because": reason}
    return Summary(
        title=f"What {name_of(file)} holds",
        answer=f"{description.path}: {description.kind} ({description.format})",
        data={key: getattr(description, key) for key in _KEYS}
        | extra_data
        | {"verdict": verdict and verdict_json(verdict)},
        pictures=(drawing,) if records or calibration else (),
        sections=(Section(title="What was found", text=lines),),
        verdict=verdict,
        findings=description.findings,
        brief=verdict is None,
        next=_next_command(description, len(stills), opening),
    )


def _describe_file(file: Path, opening: Opening, up: Up) -> "tuple[Description, Opening]":
    """Return the content of a file, read with a map of readings or of orientations."""
    from undrift.io.inspect import describe, describe_poses
    from undrift.io.reference import read_reference_map

    poses = None if opening.column_map is None else read_reference_map(opening.column_map)
    if poses is not None:
        return describe_poses(file, poses), replace(opening, column_map=None)
    return describe(file, opening.how(file), up=up), opening


def _write_map(description: "Description", path: Path, proposal: Proposal, opening: Opening) -> Summary:
    """Write the map that a table seems to need, each unit with its reason."""
    from undrift.files import write_whole
    from undrift.io.proposal import map_text

    units = {"gyro": proposal.gyro_unit, "accel": proposal.accel_unit}
    text = map_text(description, sample_rate_hz=opening.sample_rate_hz, units=units)
    write_whole(path, text)
    lines, complete = text.splitlines(), '"?"' not in text
    advice = f"replace each ? in {path}" + ", or repeat with `gyro_unit` or `accel_unit`" * (not of_poses(description))
    summary = {"kind": description.kind, "format": description.format, "output": str(path)}
    return Summary(
        title=f"Map of {Path(description.path).name}",
        answer=f"The map of {description.path} is complete." if complete else f"The map is not complete: {advice}.",
        data=summary | {"map": lines, "complete": complete},
        sections=(Section(title="Map", text=tuple(lines)),),
        written=(path,),
        next=("info", description.path, "--map", path) if complete else (),
    )


def _write_session(
    files: tuple[Path, ...], path: Path, opening: Opening, turn_deg: float | None, progress: Progress
) -> Summary:
    """Write a session.toml with the rests, faces and turns of bare recordings."""
    from undrift.calibration.calibrate import find_pieces
    from undrift.calibration.settings import CalibrateSettings
    from undrift.calibration.triads import check_triads
    from undrift.files import write_whole
    from undrift.io.proposal import session_text
    from undrift.io.session import NAME

    folder = path.parent if path.name == NAME else path
    check_folder(folder)
    if (folder / NAME).exists():
        raise InputError(f"{folder / NAME}: the session exists already. Edit it, or choose another folder.")
    if any((file / NAME).is_file() or file.name == NAME for file in files):
        raise InputError(f"{files[0]}: expected recordings without a session, got a session. Edit its session.toml.")
    with reading(progress, 0.5, *files):
        bare = session_of(files, Place(), opening)
        for file, record in zip(files, bare.records, strict=False):
            with named_columns(file):
                check_triads(record)
    progress("looking for rests and turns", 0.5)
    session, steady = find_pieces(bare, CalibrateSettings(turn_angle_deg=turn_deg))
    text = session_text(session, files, folder, file_map=opening.file_map(), steady=steady)
    folder.mkdir(exist_ok=True)
    write_whole(folder / NAME, text)
    faces = list(dict.fromkeys(still.face for still in session.stills if still.face is not None))
    lines = (
        f"faces: {', '.join(faces) or 'not all six, free poses'}",
        f"steady turns whose rate must be entered: {len(steady)}",
        f"gravity {session.gravity_m_s2:.5f} m/s2 ({session.gravity_source})",
    )
    counts = {
        "recordings": len(session.records),
        "faces": faces,
        "stills": len(session.stills),
        "turns": len(session.turns),
    }
    gravity = {name: getattr(session, name) for name in ("gravity_m_s2", "gravity_source")}
    return Summary(
        title="A session of bare recordings",
        answer=f"{len(session.stills)} still phases and {len(session.turns)} turns by a known angle were found.",
        data={"kind": "session", "format": "session", "output": str(folder / NAME)}
        | counts
        | {"steady_turns": len(steady)}
        | gravity,
        sections=(Section(title="What was found", text=lines),),
        written=(folder / NAME,),
        next=("calibrate", folder, "-o", "calibration.json"),
    )


# ---- A calibration and a device model


def _parts(calibration: "Calibration") -> "tuple[dict[str, list[str]], tuple[float, float] | None]":
    """Return the content of each part of a calibration, and the range of all its tables, degC."""
    lines: dict[str, list[str]] = {}
    for name, model in (("gyro", calibration.gyro), ("accel", calibration.accel)):
        lines[name] = ["no model"] if model is None else [f"{model.method}, {model.unit_in} to {model.unit_out}"]
        if model is not None and model.g_sensitivity is not None:
            lines[name].append("g-sensitivity")
    has_temperature = calibration.reference_temp_c == calibration.reference_temp_c  # not NaN
    if calibration.mounting is not None:
        lines["mounting"] = [statement_of(calibration.mounting)]
    lines["reference temperature"] = [f"{calibration.reference_temp_c:.2f} degC" if has_temperature else "not known"]
    if calibration.drift is None:
        return lines, None
    tables, spans = _tables(calibration.drift)
    if tables:
        lines["tables"] = tables
    return lines, (float(max(s[0] for s in spans)), float(min(s[-1] for s in spans))) if spans else None


def _tables(drift: "DriftTables") -> "tuple[list[str], list[FloatArray]]":
    """Return a line for each table, and the temperatures of their nodes."""
    static, scale, dynamic = drift.static, drift.scale, drift.dynamic
    parts = []
    for what, table in (("offset", static), ("matrix", scale)):
        for name in ("gyro", "accel"):
            if table is not None:
                values, marks = getattr(table, f"{name}_{what}"), getattr(table, f"{name}_extrapolated")
                parts.append((f"{what} of the {name}", table.temp_c, values, marks))
    if dynamic is not None:
        low, high = dynamic.turn_rate[0] / RADIAN_PER_DEGREE, dynamic.turn_rate[-1] / RADIAN_PER_DEGREE
        what = f"error of the gyro over {low:.0f} to {high:.0f} deg/s"
        parts.append((what, dynamic.temp_c, dynamic.error, dynamic.extrapolated))
    lines, spans = [], []
    for what, temp_c, values, marks in parts:
        if values is not None:
            far = 0 if marks is None else int(marks.sum())
            count = values.shape[0] if marks is None else marks.size
            lines.append(f"{what} {temp_c[0]:g} to {temp_c[-1]:g} degC ({count} nodes, {far} extrapolated)")
            spans.append(temp_c)
    if static is not None and static.warm_up is not None:
        lines.append(f"warm-up over {static.warm_up.power_on_s[-1]:g} s")
    if drift.lag_s > 0.0:
        lines.append(f"thermometer lag {drift.lag_s:g} s")
    return lines, spans


def _effects(file: Path) -> dict[str, list[str]]:
    """Return the content of a device model: the active effects of each triad, the thermometer, the source."""
    from undrift.sim.device.effects import effects_of
    from undrift.sim.device.model import read_device

    device = read_device(file)
    triads = {"gyro": device.gyro, "accel": device.accel}
    effects = {name: [*effects_of(triad), f"reading in {triad.unit}"] for name, triad in triads.items()}
    return effects | {"source": [device.source_tag]}


# ---- A recording or session: still phases, and what a person sees


def _look(session: "Session | None") -> "tuple[Observed | None, str]":
    """Return the still phases, or the reason why there are none. A recording that is too short is not an error."""
    from undrift.calibration.session import look
    from undrift.calibration.settings import CalibrateSettings

    if session is None:
        return None, ""
    settings = CalibrateSettings()
    try:
        observed = look(session, settings)
    except InputError:
        shortest, window = min(record.duration_s for record in session.records), settings.still.window_s
        return None, f"no still phase: {shortest:.3g} s are too short to look for one ({window:g} s and more)"
    return observed, "" if observed.stills else next(search.reason for search in observed.searches)


def _span(record: "Record", piece: "Still | Piece") -> tuple[float, float]:
    """Return the times of the first and the last sample of a stretch, s."""
    return float(record.time[piece.start]), float(record.time[piece.stop - 1])


def draw_found(session: "Session", observed: "Observed | None", name: str) -> Any:
    """Draw a recording or session with its phases."""
    from undrift.calibration.pieces import pieces_of

    pieces = () if observed is None else pieces_of(observed)
    return at("undrift.report.figures:draw_recording")(session.records, pieces, title=f"{name}: found")


def _lines(description: "Description", stills: Sequence[tuple[float, float]], no_still_because: str) -> list[str]:
    """Return the lines about a file for the terminal."""
    lines = [description.summary.partition(", for example")[0] if description.example else description.summary]
    lines += [f"{name}: {unit}" for name, unit in description.units]
    if description.kind in ("recording", "session"):
        lines += [f"{name}: none" for name in ("gyro", "accel") if name not in dict(description.units)]
    if description.columns and description.kind != "recording":
        remainder = f", ... {len(description.columns)} in all" if len(description.columns) > 12 else ""
        lines.append(f"columns: {', '.join(description.columns[:12])}{remainder}")
    if description.temp_c:
        lines.append(f"temperature: {description.temp_c[0]:.2f} to {description.temp_c[1]:.2f} degC")
    if description.gaps:
        lines.append(f"gaps: {description.gaps} samples")
    if stills:
        spans = ", ".join(f"{start:.1f}-{stop:.1f}" for start, stop in stills[:8])
        lines.append(f"still phases: {len(stills)} ({spans}{', ...' if len(stills) > 8 else ''} s)")
    elif no_still_because:
        lines.append(no_still_because)
    return [*lines, *description.lines(), *_hints(description)]


def of_poses(description: "Description") -> bool:
    """Return True if a table needs a map of orientations."""
    return bool(description.example) and "quaternion = " in description.example[0]


def _hints(description: "Description") -> list[str]:
    """Return the map that a table may need, and what to do with it."""
    if not description.example:
        return []
    rate = " and `sample_rate_hz`" if "sample_rate_hz = ?" in description.example else ""
    return [
        f"write the lines below into map.toml (`write_map` map.toml{rate} does so and proposes units), replace each "
        f"?, and read the "
        f"file with {'`reference_map`' if of_poses(description) else '`column_map`'} map.toml",
        *description.example,
    ]


def _next_command(description: "Description", stills: int, opening: Opening) -> tuple[object, ...]:
    """Return the next command, if one can be suggested."""
    if description.example:
        ready = "sample_rate_hz = ?" not in description.example
        return ("info", description.path, "--write-map", "map.toml") if ready else ()
    missing = next(
        (item.values.get("missing") for item in description.findings if item.code == "recording.not_read"), ""
    )
    if missing == "sensor":
        return ("info", description.path, "--sensor", description.columns[0])
    if missing == "sample_rate_hz" and description.format == "ximu":
        return ("info", description.path, "--sample-rate-hz", "256")
    if description.kind == "markers" and any(item.code == "recording.up_axis" for item in description.findings):
        return ("info", description.path, "--reference-up", "y")
    if description.kind == "session" and description.summary.startswith("calibration"):
        return ("calibrate", description.path, "-o", "calibration.json")
    if description.kind == "recording" and stills >= POSES:
        return ("calibrate", description.path, *opening.words(), "-o", "calibration.json")
    return ()
