"""``undrift info``: what a file holds."""

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from undrift.cli.opening import Flag, Opening

if TYPE_CHECKING:
    from undrift.io.describe import Description
    from undrift.record import Record
    from undrift.session import Still


def info(
    file: Path, /, *, opening: Opening = Opening(), up: Literal["y", "z"] | None = None, json: Flag = False
) -> int:
    """Say what a recording, session, calibration, reference or device holds: rates, units, spans, gaps, stills found.

    Parameters
    ----------
    file : Path
        Any file or folder.
    opening : Opening
        How to read a foreign recording.
    up : str or None
        Laboratory axis that points up, for markers in TRC or C3D.
    json : bool
        One JSON object on stdout.

    Returns
    -------
    int
        Exit code.
    """
    from undrift.cli.listing import is_plain_folder, show_folder
    from undrift.cli.output import write_json
    from undrift.io.describe import describe

    if is_plain_folder(file):
        show_folder(file, json=json)
        return 0
    found = describe(file, opening.columns(), settings=opening.settings(), up=up)
    stills, reason = _stills(file, found, opening)
    effects = _effects(file) if found.kind == "device" else {}
    if found.kind == "calibration":
        from undrift.cli.contents import contents_of

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
    from undrift.sim.device.chain import effects_of
    from undrift.sim.device.store import read_device

    device = read_device(file)
    return {
        "gyro": [*effects_of(device.gyro), f"reading in {device.gyro.unit}"],
        "accel": [*effects_of(device.accel), f"reading in {device.accel.unit}"],
        "source": [device.source_tag],
    }


def _line(text: str) -> None:
    from undrift.cli.output import console

    console().print(text, markup=False)


def _stills(file: Path, found: "Description", opening: Opening) -> tuple[list[list[float]], str]:
    """Return [start_s, stop_s] of every still phase, and why there is none."""
    from undrift.io.recording import read_record
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
    from undrift.cli.output import console

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
    if found.kind == "markers" and any("points up" in problem for problem in found.problems):
        return ["say: undrift info FILE --up y, and undrift validate RECORD --reference FILE --reference-up y"]
    return []
