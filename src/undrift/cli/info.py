"""``undrift info``: what a file holds."""

from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from undrift.cli.common import Flag, Opening
from undrift.errors import InputError
from undrift.units import RADIAN_PER_DEGREE

if TYPE_CHECKING:
    from undrift.arrays import FloatArray
    from undrift.io.inspect import Description
    from undrift.model import Calibration, DriftTables
    from undrift.record import Record, Still

# ---- What a calibration holds, for ``undrift info``.


def contents_of(path: Path, found: "Description") -> "tuple[Description, dict[str, list[str]]]":
    """Return what a calibration holds.

    Parameters
    ----------
    path : Path
        calibration.json.
    found : Description
        What is known of it.

    Returns
    -------
    found : Description
        With the span of all its tables, degC.
    lines : dict
        What there is to say of each part.
    """
    from undrift.io.store import read_calibration

    held = read_calibration(path)
    lines = _triads(held)
    tables, spans = _tables(held.drift)
    if tables:
        lines["tables"] = tables
    lines["verdict"] = [held.verdict.status, *held.verdict.reasons]
    span = (max(s[0] for s in spans), min(s[-1] for s in spans)) if spans else None
    return replace(found, temp_c=None if span is None else (float(span[0]), float(span[1]))), lines


def _triads(held: "Calibration") -> dict[str, list[str]]:
    lines: dict[str, list[str]] = {}
    for name, model in (("gyro", held.gyro), ("accel", held.accel)):
        if model is None:
            lines[name] = ["no model"]
            continue
        lines[name] = [f"{model.method}, {model.unit_in} to {model.unit_out}"]
        if model.g_sensitivity is not None:
            lines[name].append("g-sensitivity")
    known = held.reference_temp_c == held.reference_temp_c
    lines["reference temperature"] = [f"{held.reference_temp_c:.2f} degC" if known else "not known"]
    return lines


def _tables(drift: "DriftTables | None") -> "tuple[list[str], list[FloatArray]]":
    """A sentence each, and the temperatures of their nodes."""
    said: list[str] = []
    spans: list[FloatArray] = []
    if drift is None:
        return said, spans
    static, scale, dynamic = drift.static, drift.scale, drift.dynamic
    parts = []
    if static is not None:
        parts += [
            ("offset of the gyro", static.temp_c, static.gyro_offset, static.gyro_extrapolated),
            ("offset of the accel", static.temp_c, static.accel_offset, static.accel_extrapolated),
        ]
    if scale is not None:
        parts += [
            ("matrix of the gyro", scale.temp_c, scale.gyro_matrix, scale.gyro_extrapolated),
            ("matrix of the accel", scale.temp_c, scale.accel_matrix, scale.accel_extrapolated),
        ]
    if dynamic is not None:
        low, high = dynamic.turn_rate[0] / RADIAN_PER_DEGREE, dynamic.turn_rate[-1] / RADIAN_PER_DEGREE
        what = f"error of the gyro over {low:.0f} to {high:.0f} deg/s"
        parts.append((what, dynamic.temp_c, dynamic.error, dynamic.extrapolated))
    for what, temp_c, values, marks in parts:
        if values is not None:
            far = 0 if marks is None else int(marks.sum())
            count = values.shape[0] if marks is None else marks.size
            said.append(f"{what} {temp_c[0]:g} to {temp_c[-1]:g} degC ({count} nodes, {far} extrapolated)")
            spans.append(temp_c)
    if static is not None and static.warm_up is not None:
        said.append(f"warm-up over {static.warm_up.power_on_s[-1]:g} s")
    if drift.lag_s > 0.0:
        said.append(f"thermometer lag {drift.lag_s:g} s")
    return said, spans


# ---- What ``undrift info`` says of a folder that is neither a session nor a recording: one line for each file in it.


def is_plain_folder(path: Path) -> bool:
    """Tell a folder of files from one that is a session or a recording.

    Parameters
    ----------
    path : Path
        File or folder.

    Returns
    -------
    bool
        True for a folder without session.toml or the files of a known device.
    """
    from undrift.io.formats import detect

    if not path.is_dir():
        return False
    try:
        detect(path)
    except InputError:
        return True
    return False


def list_folder(path: Path) -> list[tuple[str, str, str]]:
    """Describe what lies directly in a folder.

    Parameters
    ----------
    path : Path
        The folder.

    Returns
    -------
    list of (str, str, str)
        Name, kind and summary of each file or folder; kind "damaged" where it cannot be read, with the reason.

    Raises
    ------
    InputError
        An empty folder.
    """
    held = sorted(entry for entry in path.iterdir() if not entry.name.startswith("."))
    if not held:
        raise InputError(f"{path}: wanted a recording or a folder of recordings, got an empty folder; check the path")
    return [(entry.name, *_described(entry)) for entry in held]


def _described(path: Path) -> tuple[str, str]:
    from undrift.io.inspect import describe

    if is_plain_folder(path):
        return "folder", "not looked into"
    try:
        found = describe(path)
    except InputError as error:
        return "damaged", str(error)
    return found.kind, found.summary


def show_folder(path: Path, *, json: bool) -> None:
    """Say what lies in a folder, for a person or as JSON.

    Parameters
    ----------
    path : Path
        The folder.
    json : bool
        One JSON object with the keys of ``undrift info``, and files.
    """
    from undrift.cli.common import console, write_json

    found = list_folder(path)
    kinds = Counter(kind for _, kind, _ in found)
    summary = f"{len(found)} entries: " + ", ".join(f"{count} {kind}" for kind, count in sorted(kinds.items()))
    if json:
        head = {"kind": "folder", "format": "folder", "rows": None, "sample_rate_hz": None, "duration_s": None}
        rest = {"columns": [], "units": {}, "gaps": 0, "temp_c": None, "stills": []}
        problems = [text for _, kind, text in found if kind == "damaged"]
        files = [{"name": name, "kind": kind, "summary": text} for name, kind, text in found]
        write_json(head | rest | {"problems": problems, "findings": [], "summary": summary, "files": files})
        return
    out = console()
    out.print(f"{path}: folder, {summary}", markup=False)
    for name, kind, text in found:
        out.print(f"  {name}: {kind}, {text}", markup=False)
    out.print("  name one of them to see more", markup=False)


# ---- info


def info(
    file: Path, /, *, opening: Opening = Opening(), reference_up: Literal["y", "z"] | None = None, json: Flag = False
) -> int:
    """Say what a recording, session, calibration, reference or device holds: rates, units, spans, gaps, stills found.

    Parameters
    ----------
    file : Path
        Any file or folder.
    opening : Opening
        How to read a foreign recording.
    reference_up : str or None
        Laboratory axis that points up, for markers in TRC or C3D.
    json : bool
        One JSON object on stdout.

    Returns
    -------
    int
        Exit code.
    """
    from undrift.cli.common import write_json
    from undrift.io.inspect import describe
    from undrift.io.store import findings_json

    if is_plain_folder(file):
        show_folder(file, json=json)
        return 0
    found = describe(file, opening.columns(), settings=opening.settings(), up=reference_up)
    stills, reason = _stills(file, found, opening)
    effects = _effects(file) if found.kind == "device" else {}
    if found.kind == "calibration":
        found, effects = contents_of(file, found)
    if json:
        write_json(
            {
                "kind": found.kind,
                "format": found.format,
                "rows": found.rows,
                "sample_rate_hz": found.sample_rate_hz,
                "usual_rate_hz": found.usual_rate_hz,
                "duration_s": found.duration_s,
                "columns": found.columns,
                "units": dict(found.units),
                "gaps": found.gaps,
                "temp_c": found.temp_c,
                "stills": stills,
                "problems": found.problems,
                "findings": findings_json(found.findings),
                "summary": found.summary,
                "map": found.example,
                "no_still_because": reason,
                "effects": effects,
            }
        )
        return 0
    _show(found, stills, reason)
    for part, names in effects.items():
        if part == "verdict":  # one reason a line
            _line(f"  verdict: {names[0]}")
            for name in names[1:]:
                _line(f"    - {name}")
        else:
            _line(f"  {part}: {', '.join(names)}")
    return 0


def _effects(file: Path) -> dict[str, list[str]]:
    """Return what a device model holds: the effects of each triad that are switched on, the thermometer, the source."""
    from undrift.sim.device.effects import effects_of
    from undrift.sim.device.model import read_device

    device = read_device(file)
    return {
        "gyro": [*effects_of(device.gyro), f"reading in {device.gyro.unit}"],
        "accel": [*effects_of(device.accel), f"reading in {device.accel.unit}"],
        "source": [device.source_tag],
    }


def _line(text: str) -> None:
    from undrift.cli.common import console

    console().print(text, markup=False)


def _stills(file: Path, found: "Description", opening: Opening) -> tuple[list[list[float]], str]:
    """Return [start_s, stop_s] of every still phase, and why there is none."""
    from undrift.io.formats import read_record
    from undrift.io.session import read_session

    if found.kind == "session":
        session = read_session(file)
        stills = session.stills or tuple(s for k, record in enumerate(session.records) for s in _search(record, k)[0])
        clocks = [record.time for record in session.records]
        return [[float(clocks[s.recording][s.start]), float(clocks[s.recording][s.stop - 1])] for s in stills], ""
    if found.kind != "recording":
        return [], ""
    record = read_record(file, opening.columns(), settings=opening.settings())
    stills, reason = _search(record)
    return [[float(record.time[s.start]), float(record.time[s.stop - 1])] for s in stills], reason


def _search(record: "Record", recording: int = 0) -> "tuple[tuple[Still, ...], str]":
    """Return the still phases, and why there is none; a recording too short to tell is told, not refused."""
    from undrift.errors import InputError
    from undrift.segments import StillSettings, find_still

    try:
        search = find_still(record, recording=recording)
    except InputError:
        window = StillSettings().window_s
        return (), f"no still phase: {record.duration_s:.3g} s are too short to look for one ({window:g} s and more)"
    return search.stills, search.reason


def _show(found: "Description", stills: list[list[float]], reason: str) -> None:
    from undrift.cli.common import console

    out = console()
    out.print(f"{found.path}: {found.kind} ({found.format})", markup=False)
    out.print(f"  {found.summary.partition(', for example')[0] if found.example else found.summary}", markup=False)
    for name, unit in found.units:
        out.print(f"  {name}: {unit}", markup=False)
    if found.kind in ("recording", "session"):
        for name in ("gyro", "accel"):
            if name not in dict(found.units):
                out.print(f"  {name}: none")
    if found.columns and found.kind != "recording":
        shown = ", ".join(found.columns[:12]) + (
            f", ... {len(found.columns)} in all" if len(found.columns) > 12 else ""
        )
        out.print(f"  columns: {shown}", markup=False)
    if found.temp_c:
        out.print(f"  temperature: {found.temp_c[0]:.2f} to {found.temp_c[1]:.2f} degC")
    if found.gaps:
        out.print(f"  gaps: {found.gaps} samples")
    if stills:
        spans = ", ".join(f"{start:.1f}-{stop:.1f}" for start, stop in stills[:8])
        out.print(f"  still phases: {len(stills)} ({spans}{', ...' if len(stills) > 8 else ''} s)")
    elif reason:
        out.print(f"  {reason}", markup=False)
    for problem in found.problems:
        if problem != found.summary:
            out.print(f"  problem: {problem}", markup=False)
    for hint in _hints(found):
        out.print(f"  {hint}", markup=False)


def _hints(found: "Description") -> list[str]:
    """Return what to type next, in the words of the command line."""
    if found.example:
        return [
            "write the lines below into map.toml, put what is true where it says ?, and say: undrift info FILE --map map.toml",
            *found.example,
        ]
    if found.kind == "table" and found.format == "apdm":
        return [f"say: undrift info FILE --sensor {found.columns[0]}"]
    if found.kind == "table" and found.format == "ximu":
        return ["say: undrift info FILE --sample-rate-hz 256"]
    if found.kind == "markers" and any(item.code == "recording.up_axis" for item in found.findings):
        return [
            "say: undrift info FILE --reference-up y, and undrift validate RECORD --reference FILE --reference-up y"
        ]
    return []
