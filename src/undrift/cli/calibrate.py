"""``undrift calibrate``: fit what a session allows."""

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from undrift.cli.common import (
    Details,
    Flag,
    Json,
    OptionalOutput,
    Rests,
    check_figure,
    check_output,
    name_of,
    say,
    show_table,
    show_verdict,
    waiting,
    write_json,
)

if TYPE_CHECKING:
    from undrift.calibration.observe import CalibrateSettings
    from undrift.model import Calibration
    from undrift.record import Session


def calibrate(
    session: Path,
    /,
    *,
    output: OptionalOutput = None,
    report: Path | None = None,
    accel: Literal["six-face", "multi-position"] | None = None,
    gyro: Literal["rate-table", "known-rotation", "multi-position"] | None = None,
    mode: Literal["paper", "affine", "levelled"] | None = None,
    keep_offset: Flag = False,
    adc: Literal["auto", "none"] = "auto",
    window_s: float = 6.0,
    settle_s: float = 0.3,
    latitude_deg: float | None = None,
    angle_uncertainty_deg: float = 1.0,
    scale_tolerance: float = 0.25,
    polynomial_degree: int = 1,
    spline_cutoff_hz: float | None = None,
    rests: Rests = Rests(),
    figure: Path | None = None,
    details: Details = False,
    json: Json = False,
) -> int:
    """Fit what a session allows, with verdict and findings.

    Parameters
    ----------
    session : Path
        Folder with session.toml, or that file.
    output : Path or None
        calibration.json to write.
    report : Path or None
        Report page to write: .html.
    accel : str or None
        How to calibrate the accelerometers; what the session allows by default.
    gyro : str or None
        How to calibrate the gyroscopes; what the session allows by default.
    mode : str or None
        paper (the note's equations to the letter), affine, or levelled (six faces, weighted by how level they lay).
    keep_offset : bool
        Mode paper, whose matrix has no offset column: the readings are free of it, remove none.
    adc : str
        "auto" looks for the step and rounding of the codes; "none" leaves them.
    window_s : float
        Longest stretch of each face that is averaged, s.
    settle_s : float
        Start of each dwell at a known rate that is left out, s.
    latitude_deg : float or None
        Removes the Earth's rotation from a rate table that stands level there.
    angle_uncertainty_deg : float
        Standard uncertainty of a turn by a known angle, deg.
    scale_tolerance : float
        Largest relative difference of a scale factor from the stated unit; physical units only.
    polynomial_degree : int
        Degree of the polynomial in time that filters each face before it is averaged.
    spline_cutoff_hz : float or None
        Low-pass each dwell at a known rate by a spline with this cut-off, Hz; no filter by default.
    rests : Rests
        How stretches at rest are found where the session states none.
    figure : Path or None
        Picture to write of the recordings, with what was used and what was left out: .svg, .png or .pdf.

    Returns
    -------
    int
        0, or 1 when the verdict is bad.
    """
    from undrift.calibration.calibrate import calibrate as fit
    from undrift.calibration.observe import CalibrateSettings
    from undrift.io.session import read_session
    from undrift.io.store import calibration_json, write_calibration

    check_output(output, endings=(".json",))  # no recording ends so
    check_output(report, endings=(".html",))
    check_figure(figure, reads=(session,))
    settings = CalibrateSettings(
        still=rests.settings(),
        window_s=window_s,
        settle_s=settle_s,
        latitude_deg=latitude_deg,
        angle_uncertainty_deg=angle_uncertainty_deg,
        scale_tolerance=scale_tolerance,
        polynomial_degree=polynomial_degree,
        spline_cutoff_hz=spline_cutoff_hz,
        remove_offset=not keep_offset,
        identify_adc=adc == "auto",
    )
    with waiting("reading and fitting"):
        made = fit(held := read_session(session), accel=accel, gyro=gyro, mode=mode, settings=settings)
    if figure is not None:
        _draw(held, settings, made, f"{name_of(session)}: used", figure)
    if output is not None:
        write_calibration(made, output)
    if report is not None:
        _report(made, report)
    code = 1 if made.verdict.status == "bad" else 0
    if json:
        write_json(calibration_json(made))
        return code
    _show(made)
    show_verdict(made.verdict, details=details)
    say(*(f"Wrote {path}" for path in (report, figure) if path is not None), _next(session, output))
    return code


def _next(session: Path, output: Path | None) -> str:
    """Return what was written, and what to do with it."""
    if output is None:
        return f"Nothing was written. To keep it: undrift calibrate {session} -o calibration.json"
    return f"Wrote {output}. Next: undrift correct RECORD --calibration {output} -o corrected.parquet"


def _report(made: "Calibration", path: Path) -> None:
    from undrift.report.page import calibration_sections, write_page

    title, sections = f"Calibration of {made.device or 'a device'}", calibration_sections(made)
    write_page(path, title=title, lead=_heading(made), sections=sections, verdict=made.verdict)


def _draw(held: "Session", settings: "CalibrateSettings", made: "Calibration", title: str, path: Path) -> None:
    """Draw the recordings with what was used and what was left out."""
    from undrift.calibration.pieces import pieces_of
    from undrift.report.figures import draw_recording, save_figure

    pieces, _ = pieces_of(held, settings, made)
    save_figure(draw_recording(held.records, pieces, title=title, used=True), path)


def _heading(calibration: "Calibration") -> str:
    known = calibration.reference_temp_c == calibration.reference_temp_c  # not NaN
    where = f" at {calibration.reference_temp_c:.1f} degC" if known else ""
    device = calibration.device or "device without a serial number"
    return f"{device}{where}, gravity {calibration.gravity_m_s2:.5f} m/s2"


def _show(calibration: "Calibration") -> None:
    """Show matrices, offsets and ADC steps."""
    from undrift.report.page import triad_heads, triad_notes, triad_rows

    say(_heading(calibration))
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
