"""``undrift drift``: tuning tables over temperature from thermal sessions, or from a mere warm-up log."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from undrift.base.options import Details, Files, Flag, Json, OptionalOutput, Report
from undrift.cli.common import Steps, say, say_next, show_table, show_verdict, write_json
from undrift.commands import part_of
from undrift.commands.files import Opening, check_figure, check_output, check_report, origin_of, recording_of
from undrift.commands.register import Register, registered_lines
from undrift.errors import InputError

if TYPE_CHECKING:
    from undrift.drift.fit import DriftFit, DriftSettings
    from undrift.model import Calibration
    from undrift.record import Session


def drift(
    *sessions: Files,
    calibration: Path | None = None,
    output: OptionalOutput = None,
    report: Report = None,
    figure: Path | None = None,
    span: Annotated[str | None, Parameter(name="--range-c", allow_leading_hyphen=True)] = None,
    step_c: float = 0.5,
    spline: Literal["smooth", "not-a-knot"] = "smooth",
    tables: Literal["auto", "none", "scale", "dynamic", "scale+dynamic"] = "auto",
    lag_s: float | None = None,
    warm_up: Flag = False,
    opening: Opening = Opening(),
    registering: Register = Register(),
    details: Details = False,
    json: Json = False,
) -> int:
    """Tuning tables over temperature: offsets, matrix and dynamic drift, from soaks, ramps or a warm-up.

    Parameters
    ----------
    sessions : Path
        One or more thermal sessions of the device: folders with session.toml, recordings at rest while the temperature
        changes, or tables of set-points (a map with set_points). Several are combined; how far they differ counts as
        uncertainty. Recordings whose clock runs on within 60 s are one session.
    calibration : Path or None
        calibration.json of the device. Without it physical units keep their nominal scale, and counts are refused.
    output : Path or None
        calibration.json to write, with the tables in it; may be the one that was read.
    figure : Path or None
        Picture of the gyroscopes' offset over temperature to write: .svg, .png or .pdf.
    span : str or None
        First and last node, LOW:HIGH in degC, wider or narrower than what was seen; by default what was seen, and 18 or 75 where
        that is 3 degC away or less.
    step_c : float
        Step between nodes, degC.
    spline : str
        smooth (stiffness by restricted likelihood), or not-a-knot (through the set-points, as the note does).
    tables : str
        Which tables besides offsets: auto chooses by cross-validated error.
    lag_s : float or None
        Thermometer lag, s; estimated from ramps at two speeds by default, 0 leaves it in.
    warm_up : bool
        Fit the power-on transient with which each recording, or each clock that begins anew, begins.
    """
    from undrift.drift.checks import verdict_before
    from undrift.drift.fit import DriftSettings
    from undrift.drift.static import StaticSettings
    from undrift.io.store import calibration_json, read_calibration, write_calibration
    from undrift.report.drift import draw_offsets, write_drift_report
    from undrift.report.figures import save_figure

    if not 0.0 < step_c < float("inf"):
        raise InputError(f"step-c: wanted more than 0 degC, got {step_c:g}; 0.5 is the note's")
    settings = DriftSettings(
        range_c=None if span is None else _range(span),
        step_c=step_c,
        lag_s=lag_s,
        tables="scale + dynamic" if tables == "scale+dynamic" else tables,
        static=StaticSettings(not_a_knot=spline == "not-a-knot", warm_up=warm_up),
    )
    read = (*(path for path in sessions if path.exists()), opening.column_map)
    check_output(output, endings=(".json",), reads=read)  # may be the calibration that was read: it is written whole
    check_report(report, reads=(*read, calibration))
    check_figure(figure, reads=(*read, calibration))
    model = None if calibration is None else read_calibration(calibration)
    registering.check(None if model is None else model.device)
    fit, seen, of_samples = _fit(sessions, opening.like(model, calibration), model, settings)
    kept = registering.add(fit.calibration, source=output)
    if figure is not None:
        if fit.gyro_summary is None:
            raise InputError(f"{figure}: wanted gyroscopes to draw, got none; leave out --figure")
        save_figure(draw_offsets(fit.gyro_summary), figure)
    if report is not None:
        write_drift_report(fit, report, origin_of(*sessions, calibration))
    if output is not None:
        write_calibration(fit.calibration, output)
    if json:
        write_json(calibration_json(fit.calibration) | ({"registered": kept} if kept else {}), "drift")
    else:
        _show(fit)
        show_verdict(fit.verdict, details=details)
        if model is not None:
            say(f"calibration given: {calibration}, with {len(verdict_before(model).reasons)} findings of its own")
        say(*registered_lines(kept))
        _say_next(fit, output, (figure, report), (recording_of(sessions) if of_samples else None, seen))
    return 1 if fit.calibration.verdict.status == "bad" else 0


def _fit(
    sessions: tuple[Path, ...], opening: Opening, model: "Calibration | None", settings: "DriftSettings"
) -> "tuple[DriftFit, tuple[float, float] | None, bool]":
    """Read the sessions and fit, with a bar; return the fit, the first one's temperatures, degC, and whether it holds samples."""
    import numpy as np

    from undrift.drift.fit import fit_drift
    from undrift.drift.sessions import check_once, one_power_on
    from undrift.io.formats import detect

    with Steps("drift") as shown:
        held = []
        for k, path in enumerate(sessions):
            shown(f"reading {path.name}", 0.4 * k / len(sessions))
            session = read_thermal(path, opening, model)
            held.append((session, detect(path) == "session" or bool(session.means)))
        check_once([session for session, _ in held])
        bare = [session for session, stated in held if not stated]
        temps = held[0][0].records[0].temp_c
        known = np.empty(0) if temps is None else temps[np.isfinite(temps)]
        seen = (float(known.min()), float(known.max())) if len(known) else None
        fit = fit_drift(
            [
                *(session for session, stated in held if stated),
                *one_power_on(bare),
            ],  # together where their clock runs on
            model,
            settings=settings,
            progress=part_of(shown, 0.4, 1.0),
        )
        return fit, seen, not held[0][0].means


def _range(text: str) -> tuple[float, float]:
    low, _, high = text.partition(":")
    try:
        ends = float(low), float(high)
    except ValueError:
        raise InputError(f"range-c: wanted LOW:HIGH in degC, got '{text}'; for example 18:75") from None
    if not (-273.15 < ends[0] < ends[1] < float("inf")):
        raise InputError(f"range-c: wanted LOW below HIGH in degC, got '{text}'; for example 18:75")
    return ends


def read_thermal(path: Path, opening: Opening, model: "Calibration | None") -> "Session":
    """Read a session; a recording by itself is a session of one."""
    from dataclasses import replace

    from undrift.files import sha256_of
    from undrift.io.formats import detect
    from undrift.io.session import entry_of, read_session, session_from_files
    from undrift.record import Session
    from undrift.units import STANDARD_GRAVITY

    if detect(path) == "session":
        return read_session(path)
    if (file_map := opening.file_map()) is not None and entry_of(file_map).set_points is not None:
        return replace(
            session_from_files([path], file_map), gravity_m_s2=STANDARD_GRAVITY if model is None else model.gravity_m_s2
        )
    record = opening.record(path)
    return Session(
        kind="thermal",
        serial=record.device,
        gravity_m_s2=STANDARD_GRAVITY if model is None else model.gravity_m_s2,
        records=(record,),
        inputs=((path.name, sha256_of(path)),) if path.is_file() else (),
        file_map=opening.file_map(),
    )


def _show(fit: "DriftFit") -> None:
    from undrift.report import drift as report

    device = fit.calibration.device or "device without a serial number"
    say(f"{device}: {len(fit.rests)} blocks of rest, {len(fit.steps)} dwells at known rates")
    for name, summary in (("gyroscope", fit.gyro_summary), ("accelerometer", fit.accel_summary)):
        if summary is not None:
            show_table(report.offset_title(name, summary), *report.offset_table(summary))
    if rows := report.scale_rows(fit):
        show_table("gyroscope scale factor over temperature", report.SCALE_HEADS, rows)
    if fit.choice is not None:
        show_table("which tables", report.CHOICE_HEADS, report.choice_rows(fit.choice.alternatives))
    drift = fit.calibration.drift
    if drift is not None and drift.lag_s > 0.0:
        say(f"thermometer lag removed: {drift.lag_s:.3g} s")


def _say_next(
    fit: "DriftFit",
    output: Path | None,
    written: tuple[Path | None, ...],
    first: tuple[Path | None, tuple[float, float] | None],
) -> None:
    """Say what was written, and how the first recording, with its temperatures, is corrected by it."""
    recording, temp_c = first
    say(*(f"Wrote {path}" for path in written if path is not None))
    if output is None:
        say("No tables were written: add -o calibration.json to keep them")
        return
    static = None if fit.calibration.drift is None else fit.calibration.drift.static
    aged = ["--power-on-s", "0"] if static is not None and static.warm_up is not None else []  # as it was recorded
    outside = (
        static is not None and temp_c is not None and (temp_c[0] < static.temp_c[0] or temp_c[1] > static.temp_c[-1])
    )
    held = ["--policy", "hold"] if outside else []
    say(f"Wrote {output}")
    if recording is not None:
        say_next("correct", recording, "--calibration", output, *aged, *held, "-o", "corrected.parquet")
