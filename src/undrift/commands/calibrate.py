"""``undrift calibrate``: calibrate from a session or from recordings without a session."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from undrift.base.options import Files, Flag, OptionalOutput
from undrift.calibration.calibrate import calibrated as fit
from undrift.calibration.calibrate import find_pieces, from_motion
from undrift.calibration.in_motion import InMotion
from undrift.calibration.pieces import Piece, pieces_of
from undrift.calibration.settings import AccelFit, CalibrateSettings, GyroFit
from undrift.commands.files import Opening, Place, recording_of, session_of
from undrift.commands.outputs import check_output
from undrift.errors import InputError
from undrift.io.store import write_calibration
from undrift.model import Calibration
from undrift.rate_log import LEAST_S, align_clocks, cut_dwells, read_rate_log
from undrift.record import Session
from undrift.report import Report, Table
from undrift.report.calibration import NAMES, calibration_report
from undrift.report.figures import draw_recording
from undrift.screen import progress, reading
from undrift.units import RADIAN_PER_DEGREE

NOTABLE_DRIFT = 1e-3  # relative drift of the clocks: the clock of the table causes the same error of the scale factor
PART = "kind"  # setting of a calibration's origin


def calibrate(
    *files: Files,
    place: Place = Place(),
    opening: Opening = Opening(),
    turn_deg: float | None = None,
    rates: Path | None = None,
    output: OptionalOutput = None,
    calibrate_from: Annotated[Literal["pieces", "motion"], Parameter(name="--from")] = "pieces",
    kind: str | None = None,
    magnetometer: Flag = False,
    accel: AccelFit | None = None,
    gyro: GyroFit | None = None,
    mode: Literal["paper", "affine"] | None = None,
) -> Report:
    """Calibrate from a session or from recordings without a session, with verdict and findings.

    Parameters
    ----------
    files : Path
        A folder with session.toml, or recordings of the same device. Rests, faces and turns are detected in recordings.
    turn_deg : float or None
        Angle of the turns between rests in bare recordings, deg, one or more about each axis: 360 for full turns.
    rates : Path or None
        Log of the rate table's controller: time_s (or time_ms, time_us) and turn_rate_dps (or turn_rate_rad_s, turn_rate_rpm) or
        angle_deg (or angle_rad, angle_turns). Its clock is aligned with the recordings. Its steady dwells become the turns.
    output : Path or None
        calibration.json to write.
    calibrate_from : str
        "pieces" uses rests, faces and turns. "motion" uses only gravity while the device is turned or worn, for 20 s or more.
    kind : str or None
        Preset of the device's part, such as mpu6050. Its temperature sensitivity and the lag of its thermometer are used as prior.
    magnetometer : bool
        With --from motion, also fit hard and soft iron of the magnetometer, and its alignment to the gyroscopes.
    accel : str or None
        Method of the accelerometers. By default, the session determines it.
    gyro : str or None
        Method of the gyroscopes. By default, the session determines it. "rest" fits only their offset. "none" omits them.
    mode : str or None
        paper (the note's equations to the letter) or affine.
    """
    check_output(output, endings=(".json",), reads=(*files, opening.column_map, rates))
    pieces_options = {
        "--accel": accel, "--gyro": gyro, "--mode": mode, "--turn-deg": turn_deg, "--rates": rates, "--kind": kind,
    }  # fmt: skip
    used = [name for name, value in pieces_options.items() if value is not None]
    if calibrate_from == "motion" and used:
        raise InputError(f"calibrate: {' and '.join(used)} cannot be used with --from motion. Omit one of them.")
    if calibrate_from == "pieces" and magnetometer:
        raise InputError("calibrate: --magnetometer requires --from motion. Add it, or omit --magnetometer.")
    settings = CalibrateSettings(latitude_deg=place.latitude_deg, turn_angle_deg=turn_deg)
    with reading(0.5, *files):
        session = session_of(files, place, opening)
    if kind is not None:
        from undrift.sim.device.presets import sensitivity_of  # imported here for a quick --help

        session = replace(session, sensitivity=sensitivity_of(kind))
    progress("fitting", 0.5)
    tables, details, pieces = list[Table](), list[Table](), tuple[Piece, ...]()
    if rates is not None:
        session, clocks = _turns_of_log(session, rates, settings)
        tables.append(clocks)
    if calibrate_from == "motion":
        calibration, motion = from_motion(session, magnetometer=magnetometer)
        tables.append(_motion_offsets(session, motion))
    else:
        calibration, observed = fit(session, accel=accel, gyro=gyro, mode=mode, settings=settings)
        pieces = pieces_of(observed, calibration)
        details.append(_recordings(session, pieces))
    if kind is not None:
        provenance = calibration.provenance
        calibration = replace(
            calibration, provenance=replace(provenance, settings=(*provenance.settings, (PART, kind)))
        )
    if output is not None:
        write_calibration(calibration, output)
    figures = [lambda: draw_recording(session.records, pieces, title="What was used", used=True)] if pieces else []
    report, recording = calibration_report(calibration), recording_of(files)
    follows = output is not None and recording is not None and calibration.accel is not None
    return replace(
        report,
        tables=[*report.tables, *tables],
        details=[*details, *report.details],
        notes=[
            *dict.fromkeys(session.notes),
            *report.notes,
            *_lacking(session, calibration),
            *([] if output else [NOT_WRITTEN]),
        ],
        figures=[*figures, *report.figures],
        written=[output] if output else [],
        next_command=("correct", recording, "--calibration", output, "-o", "corrected.parquet") if follows else (),
    )


NOT_WRITTEN = "Nothing was written. To keep the calibration, add -o calibration.json."


def _lacking(session: Session, calibration: Calibration) -> Iterator[str]:
    """Yield a note about each triad with readings but without a model."""
    for key, name in NAMES.items():
        if getattr(calibration, key) is None and any(getattr(record, key) is not None for record in session.records):
            yield f"The {name} are not calibrated, and their readings stay raw. The findings list what is missing."


def _turns_of_log(session: Session, path: Path, settings: CalibrateSettings) -> tuple[Session, Table]:
    """Return bare recordings with their rests and the dwells of a table's log, and the alignment of the clocks."""
    if session.turns or session.stills:
        raise InputError(f"--rates: expected recordings, got a session with its own rests or turns. Omit {path}.")
    log = read_rate_log(path)
    lines = [align_clocks(log, record) for record in session.records]
    turns, missed = cut_dwells(log, list(zip(session.records, lines, strict=True)))
    if not turns:
        raise InputError(
            f"{path}: expected steady dwells of {LEAST_S:g} s or more on the recording, got none ({missed} left out). "
            "Check the log."
        )
    largest_dps = max(turn.uncertainty for turn in turns) / RADIAN_PER_DEGREE
    note = f"{len(turns)} dwells, {missed} left out. The standard uncertainty of a rate is at most {largest_dps:.2g} deg/s."
    if any(abs(line.skew) > NOTABLE_DRIFT for line in lines):
        note += " The clocks differ notably, and the rates are on the clock of the table. Check both clocks."
    columns = ("recording", "offset (s)", "offset u (s)", "drift (ppm)", "drift u (ppm)")
    rows = [
        (name, line.lag_s, line.lag_uncertainty_s, 1e6 * line.skew, 1e6 * line.skew_uncertainty)
        for name, line in zip(_names(session, len(lines)), lines, strict=True)
    ]
    clocks = Table(title="Clock of the log", columns=columns, rows=rows, note=note)
    return replace(find_pieces(session, settings)[0], turns=tuple(turn.turn for turn in turns)), clocks


def _motion_offsets(session: Session, motion: InMotion) -> Table:
    """Return the offset of each recording, and the disturbance by the body's acceleration."""
    offsets, uncertainty = motion.offsets / RADIAN_PER_DEGREE, motion.offset_uncertainty / RADIAN_PER_DEGREE
    columns = ("recording", "x (deg/s)", "y (deg/s)", "z (deg/s)", "u (deg/s)", "acceleration (m/s2)")
    rows = [
        (name, *offset.tolist(), float(sigma.max()), float(acceleration))
        for name, offset, sigma, acceleration in zip(
            _names(session, len(offsets)), offsets, uncertainty, motion.acceleration, strict=True
        )
    ]
    note = "u: standard uncertainty of the least certain axis. Acceleration: what remains of the body's motion in means over 5 s."
    return Table(title="Gyroscope offset of each recording", columns=columns, rows=rows, form=".3f", note=note)


def _recordings(session: Session, pieces: tuple[Piece, ...]) -> Table:
    """Return the part of each recording that the fit used."""
    rows = []
    for k, (name, record) in enumerate(zip(_names(session, len(session.records)), session.records, strict=True)):
        used = [piece for piece in pieces if piece.recording == k and not piece.why]
        kinds, omitted = (
            [piece.kind for piece in used],
            sum(piece.recording == k and bool(piece.why) for piece in pieces),
        )
        seconds = sum(piece.stop - piece.start for piece in used) / record.sample_rate_hz
        rows.append(
            (name, len(record) / record.sample_rate_hz, seconds, kinds.count("still"), kinds.count("turn"), omitted)
        )
    columns = ("recording", "length (s)", "used (s)", "rests used", "turns used", "not used")
    return Table(title="Recordings", columns=columns, rows=rows, form=".1f")


def _names(session: Session, count: int) -> list[str]:
    names = [name for name, _ in session.inputs if not name.endswith(".toml")]
    return names if len(names) == count else [f"recording {k + 1}" for k in range(count)]
