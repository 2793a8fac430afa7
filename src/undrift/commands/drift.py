"""``undrift drift``: fit tables over temperature from thermal sessions, or from a warm-up log.

The summary begins with the largest error of a standard motion, without and with these tables
(``validation/table_worth``).
"""

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from undrift.base.options import Files, Flag, OptionalOutput, verb
from undrift.base.summary import NOTHING_WRITTEN, Section, Summary, figure_of, plus_minus, rows_section
from undrift.commands import Progress, part_of, reading, silent
from undrift.commands.calibration_file import choose_calibration
from undrift.commands.files import Opening, check_output, ends_of, recording_of, thermal_session
from undrift.errors import InputError
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

if TYPE_CHECKING:
    from undrift.drift.fit import Choice, DriftFit, DriftSettings
    from undrift.drift.verdict import TriadSummary
    from undrift.model import Calibration
    from undrift.record import Session
    from undrift.validation.table_worth import TableWorth

_SHOWN = {"rad/s": ("deg/s", 1.0 / RADIAN_PER_DEGREE), "m/s2": ("mg", 1e3 / STANDARD_GRAVITY)}


@verb
def drift(
    *sessions: Files,
    calibration: Path | None = None,
    output: OptionalOutput = None,
    span: Annotated[str | None, Parameter(name="--range-c", allow_leading_hyphen=True)] = None,
    step_c: float = 0.5,
    spline: Literal["smooth", "not-a-knot"] = "smooth",
    tables: Literal["auto", "none", "scale", "dynamic", "scale+dynamic"] = "auto",
    lag_s: float | None = None,
    warm_up: Flag = False,
    opening: Opening = Opening(),
    progress: Progress = silent,
) -> Summary:
    """Fit tuning tables over temperature (offsets, matrix and dynamic drift) from soaks, ramps or a warm-up.

    Parameters
    ----------
    sessions : Path
        One or more thermal sessions of the device: folders with session.toml, recordings at rest while the temperature
        changes, or daily recordings with a rest in each. Several sessions are combined, and their differences count as
        uncertainty. Recordings whose clock continues within 60 s form a session.
    calibration : Path or None
        calibration.json of the device, or a folder of calibrations: the newest one of its serial number. Without it
        physical units keep their nominal scale, and counts are refused.
    output : Path or None
        calibration.json to write, with the tables. It may be the input file.
    span : str or None
        First and last node, LOW:HIGH in degC. The default is the recorded range, extended to 18 or 75 degC if these are
        at most 3 degC away.
    step_c : float
        Step between nodes, degC.
    spline : str
        smooth (stiffness by restricted likelihood), or not-a-knot (through the set-points, as the note does).
    tables : str
        Tables in addition to offsets. auto selects them by cross-validated error.
    lag_s : float or None
        Thermometer lag, s. By default it is estimated from ramps at two speeds. 0 disables the correction.
    warm_up : bool
        Fit the power-on transient at the start of each recording, or of each clock that restarts.
    """
    from undrift.drift.fit import DriftSettings
    from undrift.drift.offset import StaticSettings
    from undrift.io.store import calibration_json, write_calibration

    if not 0.0 < step_c < math.inf:
        raise InputError(f"step-c: expected more than 0 degC, got {step_c:g}. The application note uses 0.5.")
    settings = DriftSettings(
        range_c=None if span is None else ends_of("`range_c`", span),
        step_c=step_c,
        lag_s=lag_s,
        tables="scale + dynamic" if tables == "scale+dynamic" else tables,
        static=StaticSettings(not_a_knot=spline == "not-a-knot", warm_up=warm_up),
    )
    read = (*(path for path in sessions if path.exists()), opening.column_map)
    check_output(output, endings=(".json",), reads=read)  # may be the calibration that was read: it is written whole
    chosen = choose_calibration(calibration, sessions, opening)
    model, calibration = chosen.model, chosen.path
    fit, first = _read_and_fit(sessions, opening.like(model, calibration), model, settings, progress)
    if output is not None:
        write_calibration(fit.calibration, output)
    return replace(
        drift_summary(fit),
        data=calibration_json(fit.calibration),
        notes=(*chosen.notes, *_notes(fit, model, calibration)),
        written=(output,),
        after=() if output else (NOTHING_WRITTEN,),
        next=() if output is None else _next_command(recording_of(sessions), first, fit, output),
    )


def _read_and_fit(
    sessions: tuple[Path, ...],
    opening: Opening,
    model: "Calibration | None",
    settings: "DriftSettings",
    progress: Progress,
) -> "tuple[DriftFit, Session]":
    """Read the sessions and fit. Return the fit and the first session."""
    from undrift.drift.fit import fit_drift
    from undrift.drift.observe import one_power_on
    from undrift.io.formats import detect
    from undrift.record import Session

    read, bare, session_list = list[Session](), list[Session](), list[Session]()
    for k, path in enumerate(sessions):
        with reading(part_of(progress, 0.4 * k / len(sessions), 0.4 * (k + 1) / len(sessions)), 1.0, path):
            read.append(thermal_session(path, opening, model))
        (session_list if detect(path) == "session" else bare).append(read[-1])
    together = [
        *session_list,
        *one_power_on(bare),
    ]  # recordings without a session form one session if their clock continues
    return fit_drift(together, model, settings=settings, progress=part_of(progress, 0.4, 1.0)), read[0]


def _notes(fit: "DriftFit", model: "Calibration | None", path: Path | None) -> Iterator[str]:
    from undrift.drift.verdict import without_tables

    drift = fit.calibration.drift
    if drift is not None and drift.lag_s > 0.0:
        yield f"thermometer lag removed: {drift.lag_s:.3g} s"
    if model is not None:
        yield f"calibration given: {path}, with {len(without_tables(model).verdict.reasons)} findings of its own"


def _next_command(recording: Path | None, session: "Session", fit: "DriftFit", output: Path) -> tuple[object, ...]:
    """Return how to correct a recording with the tables: from power-on with a warm-up model, and held outside the
    range.
    """
    static = None if fit.calibration.drift is None else fit.calibration.drift.static
    how, temp_c = list[str](), session.records[0].temp_c
    if static is not None and static.warm_up is not None:
        how += ["--power-on-s", "0"]  # as it was recorded
    if static is not None and temp_c is not None:
        outside = (temp_c < static.temp_c[0]) | (temp_c > static.temp_c[-1])
        how += ["--policy", "hold"] if outside.any() else []
    return ("correct", recording, "--calibration", output, *how, "-o", "corrected.parquet") if recording else ()


# ---- what the tables are worth, and what they hold


def drift_summary(fit: "DriftFit") -> Summary:
    """Return the content of a thermal fit, and its benefit for a standard motion: the largest error before and after."""
    worth, count, dwells = _worth(fit), len(fit.rests), len(fit.steps)
    answer = f"{count} blocks of rest and {dwells} dwells give no tuning table of gyroscope offsets."
    lead = f"The fit uses {count} blocks of rest and {dwells} dwells at known rates. Values after +- are standard uncertainties."
    if worth is not None:
        before, after = f"{worth.constant_deg:.2f} deg", f"{worth.tables_deg:.2f} deg"
        answer = f"A lean {worth.motion} errs by up to {before} without tables and {after} with these tables."
        if worth.turned:
            before += f", and {worth.rest_deg:.2f} deg if the offset at a rest before the motion is subtracted"
            after += f", and {worth.both_deg:.2f} deg with that rest too"
        lead = f"Without tables: {before}. With these tables: {after} (95 %). {worth.answer}. {lead}"
    return Summary(
        title=f"Thermal drift of {fit.calibration.device or 'device without a serial number'}",
        answer=answer,
        pictures=(figure_of("drift:draw_drift", fit),) if fit.gyro_summary or fit.accel_summary else (),
        sections=(Section(title="Before and after", text=(lead,)), *drift_sections(fit, drawn=True)),
        verdict=fit.verdict,
    )


def _worth(fit: "DriftFit") -> "TableWorth | None":
    """Return the benefit of the tables, or None without a table of the gyroscopes."""
    import numpy as np

    from undrift.validation.table_worth import expected_errors

    finite = np.isfinite(fit.rests.gyro_variance).all(axis=1)
    variance = np.median(fit.rests.gyro_variance[finite], axis=0) if finite.any() else np.zeros(3)
    return expected_errors(fit.calibration, rest_variance=variance)


def drift_sections(fit: "DriftFit", *, drawn: bool = False) -> tuple[Section, ...]:
    """Return the sections of a thermal fit, without the picture that was drawn before."""
    import numpy as np

    first = fit.gyro_summary or fit.accel_summary
    sections = []
    for name, triad in (("Gyroscope", fit.gyro_summary), ("Accelerometer", fit.accel_summary)):
        if triad is not None:
            pictures = () if drawn and triad is first else (figure_of("drift:draw_offsets", triad),)
            sections.append(rows_section(offset_title(name, triad), offset_rows(triad), pictures=pictures))
    scale, rows = fit.scale_summary, scale_rows(fit)
    if rows or (scale is not None and np.isfinite(scale.soak_percent).any()):
        pictures = () if scale is None else (figure_of("drift:draw_scale", scale),)
        sections.append(rows_section("Scale factor of the gyroscopes over temperature", rows, pictures=pictures))
    dynamic = None if fit.calibration.drift is None else fit.calibration.drift.dynamic
    if dynamic is not None and dynamic.error.any():
        sections.append(Section(title="Dynamic drift", pictures=(figure_of("drift:draw_dynamic", dynamic),)))
    if fit.choice is not None:
        judged = int(np.isfinite(fit.choice.left_out_rms_dps).sum()) > 1  # one mark compares nothing
        pictures = (figure_of("drift:draw_alternatives", fit.choice),) if judged else ()
        sections.append(
            rows_section("Which tables", choice_rows(fit.choice), text=(fit.choice.why.text,), pictures=pictures)
        )
    return tuple(sections)


def shown_unit(unit: str) -> tuple[str, float]:
    """Return the unit that people read, and how many of it the other is."""
    return _SHOWN.get(unit, (unit, 1.0))


def offset_rows(summary: "TriadSummary") -> list[dict[str, str]]:
    """Return a row for each axis: slope, uncertainty of the table, hysteresis, sessions."""
    unit, factor = shown_unit(summary.unit)
    rows = []
    for k, axis in enumerate("xyz"):
        row = {
            "axis": axis,
            f"slope ({unit} per degC)": plus_minus(summary.slope[k] * factor, summary.slope_uncertainty[k] * factor),
            f"table +- ({unit})": f"{summary.usual_uncertainty[k] * factor:.2g}",
        }
        if summary.half_loop is not None and summary.half_loop_uncertainty is not None:
            half = summary.half_loop[k] * factor, summary.half_loop_uncertainty[k] * factor
            row[f"hysteresis half-width ({unit})"] = plus_minus(*half)
        if summary.turn_on is not None:
            row[f"between sessions ({unit})"] = f"{summary.turn_on[k] * factor:.2g}"
        rows.append(row)
    return rows


def offset_title(name: str, summary: "TriadSummary") -> str:
    """Return the range of an offset table as a line of text."""
    low, high = summary.seen_c
    nodes = summary.temp_c
    step = (nodes[-1] - nodes[0]) / (len(nodes) - 1)
    count = int(summary.extrapolated.sum())
    far = f", {count} of them extrapolated" if count else ""
    title = f"{name} offset over temperature: {low:.1f} to {high:.1f} degC seen"
    return f"{title}, {len(nodes)} nodes {nodes[0]:g} to {nodes[-1]:g} degC by {step:g}{far}"


def scale_rows(fit: "DriftFit") -> list[dict[str, str]]:
    """Return a row for each axis: thermal sensitivity of the scale factor."""
    scale = None if fit.choice is None else fit.choice.scale
    if scale is None:
        return []
    rows = zip("xyz", map(plus_minus, scale.percent_per_k, scale.percent_per_k_uncertainty), strict=True)
    return [{"axis": axis, "scale factor (% per degC)": thermal} for axis, thermal in rows]


def choice_rows(choice: "Choice") -> list[dict[str, str]]:
    """Return a row for each choice of tables."""
    from undrift.drift.fit import ALTERNATIVES

    tried = (choice.fitted_rms_dps, choice.left_out_rms_dps, choice.standard_error_dps)
    none = all(map(math.isnan, choice.left_out_rms_dps))
    return [
        {
            "tables with offsets": name,
            "fitted (deg/s rms)": f"{fitted:.3g}" if math.isfinite(fitted) else "not fitted",
            "held out (deg/s rms)": "nothing held out" if none else plus_minus(error, doubt).lstrip("+"),
            "chosen": "chosen" * (name == choice.chosen),
        }
        for name, fitted, error, doubt in zip(ALTERNATIVES, *tried, strict=True)
    ]
