"""``undrift drift``: fit tables over temperature from thermal sessions, or from a warm-up log.

The summary begins with the largest error of a standard motion, without and with these tables
(``validation/table_worth``).
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from undrift.base.options import Files, Flag, OptionalOutput, verb
from undrift.base.summary import NOTHING_WRITTEN, Section, Summary, figure_of, plus_minus, rows_section
from undrift.commands import Progress, part_of, reading, silent
from undrift.commands.calibration_file import choose_calibration
from undrift.commands.files import Opening, check_output, recording_of, thermal_session
from undrift.units import RADIAN_PER_DEGREE, SI_UNIT, STANDARD_GRAVITY

if TYPE_CHECKING:
    from undrift.arrays import BoolArray, FloatArray
    from undrift.drift.fit import DriftFit, DriftSettings
    from undrift.drift.offset import TriadDrift
    from undrift.model import Calibration
    from undrift.record import Session
    from undrift.validation.table_worth import TableWorth

_SHOWN = {"rad/s": ("deg/s", 1.0 / RADIAN_PER_DEGREE), "m/s2": ("mg", 1e3 / STANDARD_GRAVITY)}


@verb
def drift(
    *sessions: Files,
    calibration: Path | None = None,
    output: OptionalOutput = None,
    step_c: float = 0.5,
    spline: Literal["smooth", "not-a-knot"] = "smooth",
    tables: Literal["none", "scale", "dynamic", "scale+dynamic"] = "scale+dynamic",
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
        uncertainty. Each recording is a session, with a switch-on of its own.
    calibration : Path or None
        calibration.json of the device, or a folder of calibrations: the newest one of its serial number. Without it
        physical units keep their nominal scale, and counts are refused.
    output : Path or None
        calibration.json to write, with the tables. It may be the input file.
    step_c : float
        Step between nodes, degC. They span the recorded range, and reach 18 and 75 degC if these are at most 3 degC away.
    spline : str
        smooth (stiffness by restricted likelihood), or not-a-knot (through the set-points, as the note does).
    tables : str
        Tables in addition to offsets, if the turns determine them.
    lag_s : float or None
        Thermometer lag, s. By default it is estimated from ramps at two speeds. 0 disables the correction.
    warm_up : bool
        Fit the power-on transient at the start of each recording, or of each clock that restarts.
    """
    from undrift.drift.fit import DriftSettings
    from undrift.drift.offset import StaticSettings
    from undrift.io.store import calibration_json, write_calibration

    settings = DriftSettings(
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
    from undrift.record import Session

    read = list[Session]()
    for k, path in enumerate(sessions):
        with reading(part_of(progress, 0.4 * k / len(sessions), 0.4 * (k + 1) / len(sessions)), 1.0, path):
            read.append(thermal_session(path, opening, model))
    return fit_drift(read, model, settings=settings, progress=part_of(progress, 0.4, 1.0)), read[0]


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
        answer = f"In a lean {worth.motion}, the error is up to {before} without tables and {after} with these tables."
        if worth.turned:
            before += f", and {worth.rest_deg:.2f} deg if the offset at a rest before the motion is subtracted"
            after += f", and {worth.both_deg:.2f} deg with that rest too"
        lead = f"Without tables: {before}. With these tables: {after} (95 %). {worth.answer}. {lead}"
    return Summary(
        title=f"Thermal drift of {fit.calibration.device or 'device without a serial number'}",
        answer=answer,
        pictures=(figure_of("drift:draw_drift", fit),) if summarise(fit, "gyro") or summarise(fit, "accel") else (),
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
    sections = list[Section]()
    for name, triad in (("Gyroscope", summarise(fit, "gyro")), ("Accelerometer", summarise(fit, "accel"))):
        if triad is not None:
            pictures = () if drawn and not sections else (figure_of("drift:draw_offsets", triad),)
            sections.append(rows_section(offset_title(name, triad), offset_rows(triad), pictures=pictures))
    if fit.scale is not None:
        pictures = (figure_of("drift:draw_scale", fit.scale),)
        sections.append(
            rows_section("Scale factor of the gyroscopes over temperature", scale_rows(fit), pictures=pictures)
        )
    dynamic = None if fit.calibration.drift is None else fit.calibration.drift.dynamic
    if dynamic is not None and dynamic.error.any():
        sections.append(Section(title="Dynamic drift", pictures=(figure_of("drift:draw_dynamic", dynamic),)))
    return tuple(sections)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TriadSummary:
    """Offset over temperature of three sensors, with n nodes and k blocks of rest, values in ``unit``."""

    unit: str  # rad/s or m/s2
    seen_c: tuple[float, float]  # lowest and highest temperature of the data, degC
    temp_c: "FloatArray"  # (n,), nodes, degC
    departure: "FloatArray"  # (n, 3), from the constant offset
    uncertainty: "FloatArray"  # (n, 3), standard uncertainty
    extrapolated: "BoolArray"  # (n,), True if no data were near
    fit: "TriadDrift | None"  # None if the table is of several poses
    factor: "FloatArray"  # (3,), unit per raw unit
    constant: "FloatArray"  # (3,), offset of the calibration, raw unit
    block_cooling: "FloatArray"  # (k,), 1 while cooling, -1 while warming


def summarise(fit: "DriftFit", sensor: Literal["gyro", "accel"]) -> TriadSummary | None:
    """Return the offsets of a triad over temperature, or None without a table."""
    import numpy as np

    from undrift.drift.offset import cooling

    triad = fit.calibration.triad(sensor)
    table, model = triad.offsets, triad.model
    if table is None or model is None or table.uncertainty is None or table.extrapolated is None:
        return None
    drift = fit.static.gyro if sensor == "gyro" else fit.static.accel
    seen = table.temp_c[~table.extrapolated] if not table.extrapolated.all() else table.temp_c
    factor = model.si_per_reading(triad.quantity)
    return TriadSummary(
        unit=SI_UNIT[triad.quantity],
        seen_c=(float(seen[0]), float(seen[-1])) if drift is None else drift.span_c,
        temp_c=table.temp_c,
        departure=(table.value - model.offset) * factor,
        uncertainty=table.uncertainty * factor,
        extrapolated=table.extrapolated,
        fit=drift,
        factor=factor,
        constant=model.offset,
        block_cooling=np.zeros(0) if drift is None else cooling(drift.offsets.blocks),
    )


def shown_unit(unit: str) -> tuple[str, float]:
    """Return the unit that people read, and how many of it the other is."""
    return _SHOWN.get(unit, (unit, 1.0))


def offset_rows(summary: TriadSummary) -> list[dict[str, str]]:
    """Return a row for each axis: slope, uncertainty of the table, hysteresis, sessions."""
    import numpy as np

    (unit, factor), fit = shown_unit(summary.unit), summary.fit
    near = np.flatnonzero(~summary.extrapolated | summary.extrapolated.all())
    usual = np.median(summary.uncertainty[near], axis=0) * factor
    raw, ends = summary.factor * factor, near[[0, -1]] if len(near) > 1 else np.array([0, -1])
    span_c = np.diff(summary.temp_c[ends])
    slope = np.diff(summary.departure[ends], axis=0)[0] / span_c * factor
    slope_uncertainty = np.linalg.norm(summary.uncertainty[ends], axis=0) / span_c * factor
    if fit is not None:
        slope, slope_uncertainty = fit.slope * raw, fit.slope_uncertainty * np.abs(raw)
    rows = []
    for k, axis in enumerate("xyz"):
        row = {
            "axis": axis,
            f"slope ({unit} per degC)": plus_minus(slope[k], slope_uncertainty[k]),
            f"table +- ({unit})": f"{usual[k]:.2g}",
        }
        if fit is not None and fit.hysteresis is not None and fit.hysteresis_uncertainty is not None:
            half = fit.hysteresis[k] * raw[k], fit.hysteresis_uncertainty[k] * abs(raw[k])
            row[f"hysteresis half-width ({unit})"] = plus_minus(*half)
        if fit is not None and fit.turn_on is not None:
            row[f"between sessions ({unit})"] = f"{np.sqrt(fit.turn_on.variance[k]) * abs(raw[k]):.2g}"
        rows.append(row)
    return rows


def offset_title(name: str, summary: TriadSummary) -> str:
    """Return the range of an offset table as a line of text."""
    low, high = summary.seen_c
    nodes = summary.temp_c
    step = (nodes[-1] - nodes[0]) / (len(nodes) - 1)
    count = int(summary.extrapolated.sum())
    far = f", {count} of them extrapolated" if count else ""
    title = f"{name} offset over temperature: {low:.1f} to {high:.1f} degC measured"
    return f"{title}, {len(nodes)} nodes {nodes[0]:g} to {nodes[-1]:g} degC by {step:g}{far}"


def scale_rows(fit: "DriftFit") -> list[dict[str, str]]:
    """Return a row for each axis: change of the scale factor over the nodes with data, relative to the reference temperature."""
    import numpy as np

    if fit.scale is None:
        return []
    temp_c, near = fit.scale.drift.temp_c, np.flatnonzero(~np.asarray(fit.scale.drift.gyro_extrapolated))
    scale, doubt = (table.diagonal(axis1=1, axis2=2) for table in (fit.scale.forward, fit.scale.uncertainty))
    reference = scale[np.abs(temp_c - fit.calibration.reference_temp_c).argmin()]
    percent = 100.0 / (reference * (temp_c[near[-1]] - temp_c[near[0]]))
    slope = np.where(np.isfinite(doubt[0]), (scale[near[-1]] - scale[near[0]]) * percent, np.nan)
    slope_doubt = np.hypot(doubt[near[0]], doubt[near[-1]]) * np.abs(percent)
    rows = zip("xyz", map(plus_minus, slope, slope_doubt), strict=True)
    return [{"axis": axis, "scale factor (% per degC)": thermal} for axis, thermal in rows]
