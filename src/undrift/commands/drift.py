"""``undrift drift``: fit tables over temperature from thermal sessions, or from a warm-up log."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Literal

from undrift.base.options import Files, Flag, OptionalOutput
from undrift.commands.files import Opening, Reader, recording_of, thermal_session
from undrift.commands.outputs import check_output
from undrift.drift.fit import DriftFit, DriftSettings, fit_drift
from undrift.drift.offset import StaticSettings
from undrift.drift.verdict import without_tables
from undrift.io.store import write_calibration
from undrift.model import Calibration
from undrift.record import Session
from undrift.report import Report
from undrift.report.drift import drift_report
from undrift.screen import part, progress, reading

NOT_WRITTEN = "Nothing was written. To keep the tables, add -o calibration.json."


def drift(
    *sessions: Files,
    calibration: Path | None = None,
    output: OptionalOutput = None,
    step_c: float = 0.5,
    spline: Literal["smooth", "not-a-knot"] = "smooth",
    tables: Literal["none", "scale", "dynamic", "scale+dynamic"] = "scale+dynamic",
    warm_up: Flag = False,
    opening: Opening = Opening(),
) -> Report:
    """Fit tuning tables over temperature (offsets, matrix and dynamic drift) from soaks, ramps or a warm-up.

    Parameters
    ----------
    sessions : Path
        One or more thermal sessions of the device: folders with session.toml, recordings at rest while the temperature
        changes, or daily recordings with a rest in each. Several sessions are combined, and their differences count as
        uncertainty. Each recording is a session with a separate switch-on.
    calibration : Path or None
        calibration.json of the device, or a folder of calibrations: the newest one with its serial number. Without it, physical
        units keep their nominal scale, and counts are refused.
    output : Path or None
        calibration.json to write, with the tables. It may be the input file.
    step_c : float
        Step between nodes, degC. The nodes span the recorded range, and extend to 18 or 75 degC if this is at most 3 degC away.
    spline : str
        smooth (stiffness by restricted likelihood), or not-a-knot (through the set-points, as the note does).
    tables : str
        Tables in addition to offsets, if the turns determine them.
    warm_up : bool
        Fit the power-on transient at the start of each recording, or of each clock that restarts.
    """
    settings = DriftSettings(
        step_c=step_c,
        tables="scale + dynamic" if tables == "scale+dynamic" else tables,
        static=StaticSettings(not_a_knot=spline == "not-a-knot", warm_up=warm_up),
    )
    reads = (*(path for path in sessions if path.exists()), opening.column_map)
    check_output(output, endings=(".json",), reads=reads)  # may be the input, as it is written atomically
    reader, read = Reader(opening, calibration, sessions), list[Session]()
    for k, path in enumerate(sessions):
        with part(0.4 * k / len(sessions), 0.4 * (k + 1) / len(sessions)), reading(1.0, path):
            read.append(thermal_session(path, reader))
    with part(0.4, 1.0):
        fit = fit_drift(read, reader.model, settings=settings, progress=progress)
    notes = [*reader.notes, *_notes(fit, reader.model, reader.path)]
    report = drift_report(fit)
    if output is None:
        return replace(report, notes=[*notes, NOT_WRITTEN])
    write_calibration(fit.calibration, output)
    return replace(
        report,
        notes=notes,
        written=[output],
        next_command=_next_command(recording_of(sessions), read[0], fit, output),
    )


def _notes(fit: DriftFit, model: Calibration | None, path: Path | None) -> Iterator[str]:
    yield f"The fit uses {len(fit.rests)} blocks of rest and {len(fit.steps)} dwells at known rates."
    drift = fit.calibration.drift
    if drift is not None and drift.lag_s > 0.0:
        yield f"The lag of the thermometer, {drift.lag_s:.3g} s, was removed."
    if model is not None:
        yield f"The calibration {path} has {len(without_tables(model).verdict.reasons)} earlier findings."


def _next_command(recording: Path | None, session: Session, fit: DriftFit, output: Path) -> tuple[object, ...]:
    """Return the command that corrects a recording with the tables, from power-on if there is a warm-up model."""
    static = None if fit.calibration.drift is None else fit.calibration.drift.static
    command, temp_c = list[str](), session.records[0].temp_c
    if static is not None and static.warm_up is not None:
        command += ["--power-on-s", "0"]  # the recording started at power-on
    if static is not None and temp_c is not None:
        outside = (temp_c < static.temp_c[0]) | (temp_c > static.temp_c[-1])
        command += ["--policy", "hold"] if outside.any() else []
    return ("correct", recording, "--calibration", output, *command, "-o", "corrected.parquet") if recording else ()
