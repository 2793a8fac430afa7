"""``undrift session new``: a session.toml of bare recordings, with what was found in them, ready to edit."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from undrift.base.options import Files, Output, verb
from undrift.base.summary import Section, Summary
from undrift.commands import Progress, reading, silent
from undrift.commands.files import Opening, Place, check_folder, named_columns, session_of
from undrift.errors import InputError
from undrift.units import RADIAN_PER_DEGREE

if TYPE_CHECKING:
    from undrift.findings import Finding
    from undrift.rate_log import LoggedTurn
    from undrift.record import Session


@verb
def new(
    *files: Files,
    output: Output,
    place: Place = Place(),
    opening: Opening = Opening(),
    turn_deg: float | None = None,
    rates: Path | None = None,
    rates_offset_s: float | None = None,
    progress: Progress = silent,
) -> Summary:
    """Write a session.toml with the rests, faces and turns found in bare recordings, ready to edit.

    Parameters
    ----------
    files : Path
        One or several recordings of one device; they stay where they are.
    output : Path
        Folder for session.toml, made where it is missing.
    turn_deg : float or None
        Angle of the turns between rests, deg: 360 for full turns.
    rates : Path or None
        Log of a rate table's own controller: time_s (or time_ms, time_us) and turn_rate_dps (or turn_rate_rad_s, turn_rate_rpm) or
        angle_deg (or angle_rad, angle_turns). Its clock is aligned with the recordings; its steady dwells become the turns.
    rates_offset_s : float or None
        Time of the recording less that of the log, to a second, where a table that repeats itself leaves it open.
    """
    from undrift.calibration.calibrate import find_pieces
    from undrift.calibration.observe import CalibrateSettings
    from undrift.files import write_whole
    from undrift.io.proposal import session_text
    from undrift.io.session import NAME
    from undrift.io.store import findings_json

    check_folder(output)
    if rates_offset_s is not None and (rates is None or len(files) > 1):
        raise InputError("`rates_offset_s`: wanted one recording and `rates` beside it, got others; leave it out")
    if (output / NAME).exists():
        raise InputError(f"{output / NAME}: wanted a new session, got one that exists; edit it, or name another folder")
    with reading(progress, 0.5, *files):
        bare = _bare(files, place, opening)
    progress("looking for rests and turns", 0.5)
    found, steady = find_pieces(bare, CalibrateSettings(turn_angle_deg=turn_deg))
    log = None if rates is None else _logged(rates, found, rates_offset_s)
    if log is not None:
        found, steady = replace(found, turns=()), ()
    logged = [] if log is None else [(each.turn, each.uncertainty) for each in log[0]]
    text = session_text(found, files, output, file_map=opening.file_map(), steady=steady, logged=logged)
    output.mkdir(exist_ok=True)
    write_whole(output / NAME, text)
    faces = list(dict.fromkeys(still.face for still in found.stills if still.face is not None))
    logs = {} if log is None else {"rates": log[1], "findings": findings_json(log[2])}
    lines = (
        f"faces: {', '.join(faces) or 'not all six, free poses'}",
        f"steady turns, their rate to be stated: {len(steady)}",
        *(() if log is None else _log_lines(log[1])),
        f"gravity {found.gravity_m_s2:.5f} m/s2 ({found.gravity_source})",
    )
    return Summary(
        title="A session of bare recordings",
        answer=f"{len(found.stills)} still phases and {len(found.turns)} turns by a known angle were found.",
        data={
            "output": str(output / NAME),
            "recordings": len(found.records),
            "faces": faces,
            "stills": len(found.stills),
            "turns": len(found.turns),
            "steady_turns": len(steady),
            **{name: getattr(found, name) for name in ("gravity_m_s2", "gravity_source")},
            **logs,
        },
        sections=(Section(title="What was found", text=lines),),
        findings=() if log is None else log[2],
        written=(output / NAME,),
        next=("calibrate", output, "-o", "calibration.json"),
    )


def _bare(files: tuple[Path, ...], place: Place, opening: Opening) -> "Session":
    """Read bare recordings as a session."""
    from undrift.correction.consistency import check_triads
    from undrift.io.session import NAME

    if any((file / NAME).is_file() or file.name == NAME for file in files):
        raise InputError(f"{files[0]}: wanted bare recordings, got a session; edit its session.toml")
    bare = session_of(files, place, opening)
    for file, record in zip(files, bare.records, strict=False):
        with named_columns(file):
            check_triads(record)
    return bare


def _logged(
    path: Path, session: "Session", offset_s: float | None
) -> "tuple[tuple[LoggedTurn, ...], dict[str, Any], tuple[Finding, ...]]":
    """Return the dwells of a table's log on the recordings, what is stated of them, and what speaks against their unit."""
    from undrift.rate_log import LEAST_S, align_clocks, cut_dwells, read_rate_log

    log = read_rate_log(path)
    clocks = [align_clocks(log, record, offset_s) for record in session.records]
    turns, missed = cut_dwells(log, list(zip(session.records, clocks, strict=True)))
    if not turns:
        raise InputError(
            f"{path}: wanted steady dwells of {LEAST_S:g} s or more on the recording, got none ({missed} left out); "
            "check the log"
        )
    keys = ("offset_s", "offset_uncertainty_s", "drift", "drift_uncertainty", "correlation")
    shown = [{key: getattr(each, key) for key in keys} for each in clocks]
    largest_dps = max(each.uncertainty for each in turns) / RADIAN_PER_DEGREE
    return (
        turns,
        {"dwells": len(turns), "left_out": missed, "largest_uncertainty_dps": largest_dps, "clocks": shown},
        _unit_in_doubt(session, turns),
    )


def _unit_in_doubt(session: "Session", turns: "tuple[LoggedTurn, ...]") -> "tuple[Finding, ...]":
    import numpy as np

    from undrift.calibration.checks import range_in_doubt

    pairs = [(session.records[one.turn.recording], one.turn) for one in turns]
    rates = [
        (np.linalg.norm(np.nanmean(record.gyro[turn.start : turn.stop], axis=0)) / abs(turn.turn_rate), record.gyro)
        for record, turn in pairs
        if turn.turn_rate and record.gyro is not None and record.gyro_unit == "count"
    ]
    if not rates:
        return ()
    scale, largest = np.median([one for one, _ in rates]), max(np.nanmax(np.abs(gyro)) for _, gyro in rates)
    return range_in_doubt(float(scale), float(largest))


NOTABLE_DRIFT = 1e-3  # a scale factor is wrong by as much where the table's clock is the wrong one


def _log_lines(log: dict[str, Any]) -> list[str]:
    lines = [
        f"dwells from the log: {log['dwells']}, left out {log['left_out']}; standard uncertainty of rates up to "
        f"{log['largest_uncertainty_dps']:.2g} deg/s"
    ]
    for each in log["clocks"]:
        lines.append(
            f"recording - log: {each['offset_s']:.3f} +- {each['offset_uncertainty_s']:.3f} s, drift "
            f"{each['drift'] * 1e6:+.0f} +- {each['drift_uncertainty'] * 1e6:.0f} ppm"
        )
        if abs(each["drift"]) > NOTABLE_DRIFT:
            lines.append(f"the clocks differ by {abs(each['drift']):.2%}; rates are the table's: check both")
    return lines
