"""``undrift calibrate``: fit what a session, or bare recordings, allow."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from cyclopts import Parameter

from undrift.base.options import Details, Files, Flag, Json, OptionalOutput, Report
from undrift.cli.common import say, say_next, show_table, show_verdict, waiting, write_json
from undrift.commands.files import (
    Opening,
    Place,
    Rests,
    Sensitivity,
    check_figure,
    check_output,
    check_report,
    name_of,
    origin_of,
    recording_of,
    session_of,
)
from undrift.commands.register import Register, registered_lines

if TYPE_CHECKING:
    from undrift.calibration.observe import CalibrateSettings
    from undrift.model import Calibration
    from undrift.record import Session


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Table:
    """How good the rate table of a session is, in place of what the session states.

    Parameters
    ----------
    table_level_deg : float or None
        Standard uncertainty of the rate table's axis against the vertical, deg; as the session states, else 0.1.
    mount_tilt_deg : float or None
        Standard uncertainty of the mounting on the table about each axis, deg; as the session states, else 0.1.
    rate_uncertainty : float or None
        Standard uncertainty of the stated rates in common, relative; as the session states, else 0.0001.
    wobble_deg : float or None
        Standard uncertainty of the table's axis from dwell to dwell, deg; as the session states, else 0.01.
    """

    table_level_deg: float | None = None
    mount_tilt_deg: float | None = None
    rate_uncertainty: float | None = None
    wobble_deg: float | None = None


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Fitting:
    """How readings are averaged and fitted.

    Parameters
    ----------
    window_s : float
        Longest stretch of each face that is averaged, s.
    settle_s : float
        Start of each dwell at a known rate that is left out, s.
    angle_uncertainty_deg : float
        Standard uncertainty of a turn by a known angle, deg.
    axis_uncertainty_deg : float
        Standard uncertainty of the axis of such turns against the case, about each axis across it, deg.
    scale_tolerance : float
        Largest relative difference of a scale factor from the stated unit; physical units only.
    polynomial_degree : int
        Degree of the polynomial in time that filters each face before it is averaged.
    spline_cutoff_hz : float or None
        Low-pass each dwell at a known rate by a spline with this cut-off, Hz; no filter by default.
    cross_axis_prior : float
        Standard deviation of a cross-axis term that the session does not show, relative to the scale; 0.01 is 1 %.
    """

    window_s: float = 6.0
    settle_s: float = 0.3
    angle_uncertainty_deg: float = 1.0
    axis_uncertainty_deg: float = 0.5
    scale_tolerance: float = 0.25
    polynomial_degree: int = 1
    spline_cutoff_hz: float | None = None
    cross_axis_prior: float = 0.01


def calibrate(
    *files: Files,
    place: Place = Place(),
    opening: Opening = Opening(),
    turn_deg: float | None = None,
    output: OptionalOutput = None,
    report: Report = None,
    accel: Literal["six-face", "multi-position"] | None = None,
    gyro: Literal["rate-table", "known-rotation", "multi-position", "rest", "none"] | None = None,
    mode: Literal["paper", "affine", "levelled"] | None = None,
    keep_offset: Flag = False,
    adc: Literal["auto", "none"] = "auto",
    fitting: Fitting = Fitting(),
    table: Table = Table(),
    sensitivity: Sensitivity = Sensitivity(),
    rests: Rests = Rests(),
    registering: Register = Register(),
    figure: Path | None = None,
    details: Details = False,
    json: Json = False,
) -> int:
    """Fit what a session, or bare recordings, allow, with verdict and findings.

    Parameters
    ----------
    files : Path
        One folder with session.toml, or one or several recordings of one device: rests, faces and turns are found in them.
    turn_deg : float or None
        Angle of the turns between rests in bare recordings, deg, one or more about each axis: 360 for full turns.
    output : Path or None
        calibration.json to write.
    accel : str or None
        How to calibrate the accelerometers; what the session allows by default.
    gyro : str or None
        How to calibrate the gyroscopes; what the session allows by default. rest takes their offset alone, none leaves them out.
    mode : str or None
        paper (the note's equations to the letter), affine, or levelled (six faces, weighted by how level they lay).
    keep_offset : bool
        Mode paper, whose matrix has no offset column: the readings are free of it, remove none.
    adc : str
        "auto" looks for the step and rounding of the codes; "none" leaves them.
    figure : Path or None
        Picture to write of the recordings, with what was used and what was left out: .svg, .png or .pdf.
    """
    from undrift.calibration.calibrate import calibrate as fit
    from undrift.calibration.observe import CalibrateSettings
    from undrift.io.store import calibration_json, write_calibration
    from undrift.report.commands import write_calibration_report

    check_output(output, endings=(".json",), reads=(*files, opening.column_map))
    check_report(report, reads=(*files, opening.column_map))
    check_figure(figure, reads=files)
    registering.check()
    settings = CalibrateSettings(
        still=rests.settings(),
        latitude_deg=place.latitude_deg,
        turn_angle_deg=turn_deg,
        remove_offset=not keep_offset,
        identify_adc=adc == "auto",
        **(asdict(fitting) | asdict(table) | asdict(sensitivity)),
    )
    with waiting("reading and fitting"):
        held = session_of(files, place, opening)
        made = fit(held, accel=accel, gyro=gyro, mode=mode, settings=settings)
    kept = registering.add(made, source=output)
    triads = (("accelerometers", "accel", made.accel), ("gyroscopes", "gyro", made.gyro))
    lacking = [n for n, key, model in triads if not model and any(getattr(r, key) is not None for r in held.records)]
    if output is not None:
        write_calibration(made, output)
    if report is not None:
        about, read = (_heading(made), _pieces(made)), origin_of(*files, opening.column_map)
        write_calibration_report(made, held, settings, report, about=about, origin=read)
    _draw(held, settings, made, f"{name_of(files[0])}: used", figure)
    if json:
        beside = {"lacking": lacking} | ({"registered": kept} if kept else {})
        write_json(calibration_json(made) | beside, "calibrate")
    else:
        _show(made)
        show_verdict(made.verdict, details=details)
        say(*registered_lines(kept))
        _say_next(files, output, (report, figure), lacking)
    return 1 if made.verdict.status == "bad" else 0


def _say_next(
    files: tuple[Path, ...], output: Path | None, pictures: tuple[Path | None, ...], lacking: list[str]
) -> None:
    """Say what was written, what it lacks, and how a recording is corrected by it where it has the accelerometers."""
    say(*(f"Wrote {path}" for path in (*pictures, output) if path is not None))
    if lacking:
        say(f"Not complete: no model of the {' and '.join(lacking)}, whose readings stay raw; the verdict says why")
    if output is None:
        say("Nothing was written. To keep it, repeat the command with -o calibration.json")
    elif (recording := recording_of(files)) is not None and "accelerometers" not in lacking:
        say_next("correct", recording, "--calibration", output, "-o", "corrected.parquet")


def _draw(held: "Session", settings: "CalibrateSettings", made: "Calibration", title: str, path: Path | None) -> None:
    """Draw the recordings with what was used and what was left out."""
    if path is None:
        return
    from undrift.calibration.pieces import pieces_of
    from undrift.report.figures import draw_recording, save_figure

    pieces, _ = pieces_of(held, settings, made)
    save_figure(draw_recording(held.records, pieces, title=title, used=True), path)


def _heading(calibration: "Calibration") -> str:
    known = calibration.reference_temp_c == calibration.reference_temp_c  # not NaN
    where = f" at {calibration.reference_temp_c:.1f} degC" if known else ""
    device = calibration.device or "device without a serial number"
    source = dict(calibration.provenance.settings).get("gravity", "stated")
    how = {"standard": "standard, assumed", "latitude and height": "by latitude and height"}.get(source, source)
    return f"{device}{where}, gravity {calibration.gravity_m_s2:.5f} m/s2 ({how})"


def _pieces(calibration: "Calibration") -> str:
    """Return what was found and used: still phases, faces, turns."""
    held = dict(calibration.provenance.settings)
    return f"still phases: {held['stills']}; faces: {held['faces']}; turns: {held['turns']}"


def _show(calibration: "Calibration") -> None:
    """Show matrices, offsets and ADC steps."""
    from undrift.report.page import triad_heads, triad_notes, triad_rows

    say(_heading(calibration), _pieces(calibration))
    for name, triad in (("accelerometers", calibration.accel), ("gyroscopes", calibration.gyro)):
        if triad is None:
            say(f"{name}: not calibrated")
            continue
        title = f"{name} ({triad.method}): corrected = matrix @ (raw - offset), {triad.unit_out} per {triad.unit_in}"
        show_table(title, triad_heads(triad), triad_rows(triad))
        say(*(f"  {note}" for note in triad_notes(triad)))
    adc = calibration.adc
    if adc is None:
        return
    for name in ("gyro", "accel"):
        lsb, rounding = getattr(adc, f"{name}_lsb"), getattr(adc, f"{name}_rounding")
        if lsb is not None:
            steps = ", ".join(f"{step:.6g}" for step in lsb)
            say(f"ADC {name}: step {steps}, rounded {rounding.replace('_', ' ')}")
