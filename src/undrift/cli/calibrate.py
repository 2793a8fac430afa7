"""``undrift calibrate``: fit what a session allows."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from undrift.cli.common import Flag

if TYPE_CHECKING:
    from undrift.model import Calibration, TriadModel


def calibrate(
    session: Path,
    /,
    *,
    output: Annotated[Path | None, Parameter(name=["--output", "-o"])] = None,
    accel: Literal["six-face", "multi-position"] | None = None,
    gyro: Literal["rate-table", "known-rotation", "multi-position"] | None = None,
    mode: Literal["paper", "affine", "levelled"] | None = None,
    latitude_deg: float | None = None,
    json: Flag = False,
) -> int:
    """Fit what a session allows, and say what was not observable.

    Parameters
    ----------
    session : Path
        Folder with session.toml, or that file.
    output : Path or None
        calibration.json to write.
    accel : str or None
        How to calibrate the accelerometers; what the session allows by default.
    gyro : str or None
        How to calibrate the gyroscopes; what the session allows by default.
    mode : str or None
        paper (the note's equations to the letter), affine, or levelled (six faces, weighted by how level they lay).
    latitude_deg : float or None
        Takes the Earth's rotation off a rate table that stands level there.
    json : bool
        The calibration as one JSON object on stdout.

    Returns
    -------
    int
        0, or 1 when the verdict is bad.
    """
    from undrift.calibration.calibrate import calibrate as fit
    from undrift.calibration.observe import CalibrateSettings
    from undrift.cli.common import checked_output, waiting, write_json
    from undrift.io.session import read_session
    from undrift.io.store import calibration_json, write_calibration

    if output is not None:
        checked_output(output, endings=(".json",), reads=())  # no recording ends so

    with waiting("reading and fitting"):
        made = fit(
            read_session(session),
            accel=accel,
            gyro=gyro,
            mode=mode,
            settings=CalibrateSettings(latitude_deg=latitude_deg),
        )
    if output is not None:
        write_calibration(made, output)
    if json:
        write_json(calibration_json(made))
    else:
        show_calibration(made)
        _say_next(session, output)
    return 1 if made.verdict.status == "bad" else 0


def show_calibration(calibration: "Calibration") -> None:
    """Show a calibration as tables and its verdict in words.

    Parameters
    ----------
    calibration : Calibration
        What was fitted.
    """
    import math

    from undrift.cli.common import console, show_verdict

    out = console()
    where = "" if math.isnan(calibration.reference_temp_c) else f" at {calibration.reference_temp_c:.1f} degC"
    device = calibration.device or "device without a serial number"
    out.print(f"{device}{where}, gravity {calibration.gravity_m_s2:.5f} m/s2", markup=False)
    for name, triad in (("accelerometers", calibration.accel), ("gyroscopes", calibration.gyro)):
        if triad is None:
            out.print(f"{name}: not calibrated", markup=False)
        else:
            _show_triad(name, triad)
    if calibration.adc is not None:
        adc = calibration.adc
        for name, lsb, rounding in (
            ("gyro", adc.gyro_lsb, adc.gyro_rounding),
            ("accel", adc.accel_lsb, adc.accel_rounding),
        ):
            if lsb is not None:
                steps = ", ".join(f"{step:.6g}" for step in lsb)
                out.print(f"ADC {name}: step {steps}, rounded {rounding.replace('_', ' ')}", markup=False)
    show_verdict(calibration.verdict)


def _show_triad(name: str, triad: "TriadModel") -> None:
    from undrift.cli.common import console, table
    from undrift.report.page import triad_heads, triad_notes, triad_rows

    title = f"{name} ({triad.method}): corrected = matrix @ (raw - offset), {triad.unit_out} per {triad.unit_in}"
    shown = table(title, *triad_heads(triad))
    for row in triad_rows(triad):
        shown.add_row(*row)
    out = console()
    out.print(shown, markup=False)
    for note in triad_notes(triad):
        out.print(f"  {note}", markup=False)


def _say_next(session: Path, output: Path | None) -> None:
    from undrift.cli.common import console

    if output is None:
        console().print(
            f"Nothing was written. To keep it: undrift calibrate {session} -o calibration.json", markup=False
        )
    else:
        console().print(
            f"Wrote {output}. Next: undrift correct RECORD --calibration {output} -o corrected.parquet", markup=False
        )
