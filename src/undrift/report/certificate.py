"""Certificate of a calibration: results with expanded uncertainty, budget by source, reference values and limits, for A4.

Scale factors and cross-axis terms are elements of the correction matrix, shares of a budget in per cent of its mean diagonal.
"""

import math
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from undrift import __version__
from undrift.arrays import FloatArray
from undrift.calibration.expanded import ParameterTable, block_of, expand, gravity_uncertainty
from undrift.correction.answer import answer_sentence
from undrift.errors import InputError
from undrift.files import write_whole
from undrift.findings import most_consequential_first
from undrift.io.store import content_hash
from undrift.model import Calibration, TriadModel
from undrift.report.calibration import BLOCKS, NAMES, SHOWN_UNIT, budget_units, parameter_unit, triads_of
from undrift.report.report import Cell, Estimate, Report, Table
from undrift.units import INHABITED_GRAVITY, is_physical, si_factor

# row of the budget, type of evaluation (GUM 4.2, 4.3), and triad that has the source
SOURCE_ROWS = {
    "rate": ("Rig: stated rate", "B", "gyro"),
    "angle": ("Rig: entered angle of turns", "B", "gyro"),
    "axis": ("Rig: axis of turns", "B", "gyro"),
    "ripple": ("Rig: rate that ripples or differs from dwell to dwell", "A", "gyro"),
    "mounting": ("Rig: mounting, level of the table and wobble", "A, B", "gyro"),
    "level": ("Level of the faces, or direction of gravity in poses", "A", "accel"),
    "gravity": ("Local gravity", "B", "accel"),
    "nonlinearity": ("Quadratic terms of a data sheet's size", "B", "accel"),
    "temperature": ("Temperature during the session", "B", ""),
    "noise": ("Noise", "A", ""),
    "adc": ("ADC: rounding to codes", "B", ""),
    "instability": ("Fit: instability of the offset", "A", ""),
    "repeatability": ("Repeatability: scatter beyond the noise", "A", ""),
    "prior": ("Fit: not determined by the session", "B", ""),
    "fit": ("Fit: sources not separated", "A, B", ""),
}
OPTIONAL_SOURCES = {"angle", "axis", "fit", "gravity", "nonlinearity"}  # without a row if not in a calibration
METHODS = {  # descriptions of methods on a certificate
    "six-face": "six faces against gravity",
    "rate-table": "steady rates of a rate table, about each axis",
    "known-rotation": "turns by a known angle about each axis",
    "multi-position": "rests in free poses against the size of gravity",
    "rest": "rests only: the offset is measured, the scale factor is nominal",
    "reference": "motion against an orientation reference",
    "motion": "only gravity in free motion",
}
BY_HAND = (
    "Customer", "Ambient temperature", "Relative humidity", "Due date", "Date of issue", "Authorised by", "Signature",
)  # fmt: skip
RULE = (
    "Decision rule: simple acceptance (ILAC-G8:09/2019). A departure of at most the limit is reported as within, "
    "whatever U is. Near the limit, every second statement may be wrong. Departures are the largest deviations of "
    "the readings from nominal, before correction."
)


def certificate_report(calibration: Calibration, limits: Mapping[str, float]) -> Report:
    """Return results, budgets and, with limits of the readings before correction, the statement of conformity."""
    triads = triads_of(calibration)
    if not triads:
        raise InputError("certificate: expected a calibrated gyroscope or accelerometer, got neither. Calibrate first.")
    tables = list[Table]()
    for name, model in triads.items():
        if not (model.parameters and np.isfinite(model.covariance).all() and model.covariance.any()):
            raise InputError(
                f"certificate: expected a covariance of the {NAMES[name]}, got none. Calibrate from recordings with undrift."
            )
        table = expand(model, gravity_uncertainty(calibration, name))
        tables += [_results(name, model, table), _budget(name, model, table)]
    return Report(
        title=f"Certificate of {calibration.device or 'a device'}",
        answer=answer_sentence(calibration),
        tables=[_conformity(calibration, limits)],
        details=tables,
        findings=calibration.verdict.findings,
        judged=True,
        data={"content_sha256": content_hash(calibration)},
    )


def write_certificate(calibration: Calibration, path: Path, report: Report, entries: Mapping[str, str]) -> None:
    """Write a certificate as a page for A4, with the entries of the laboratory. The same input gives the same bytes."""
    from jinja2 import Environment, PackageLoader

    provenance, verdict = calibration.provenance, calibration.verdict
    environment = Environment(loader=PackageLoader("undrift", "report"), autoescape=True)
    text = environment.get_template("certificate.html.j2").render(
        device=calibration.device or "without serial number",
        date=provenance.created[:10] or "not stated",
        head=[*entries.items(), *((label, "") for label in BY_HAND)],
        software=", ".join(f"{name} {version}" for name, version in provenance.versions) or f"undrift {__version__}",
        status=verdict.status,
        findings=[item.sentence for item in most_consequential_first(verdict.findings) if item.level != "info"],
        conditions=[*_conditions(calibration)],
        tables=[*report.tables, *report.details],
        references=[*_references(calibration)],
        limits=[*_limits_of_validity(calibration)],
        hash=report.data["content_sha256"],
        inputs=provenance.inputs,
    )
    write_whole(path, text.lstrip() + "\n")


# ---- tables


def _results(name: str, model: TriadModel, table: ParameterTable) -> Table:
    """Return each parameter with its expanded uncertainty, in its unit and in the unit of the budget."""
    rows, units = list[dict[str, Cell]](), budget_units(name, model)
    for parameter, value, expanded in zip(table.names, table.value.tolist(), table.expanded.tolist(), strict=True):
        (factor, unit), fixed = units[block_of(parameter)], not expanded > 0.0
        rows.append(
            {
                "parameter": parameter,
                "value ± U": value if fixed else Estimate(value, expanded),
                "unit": parameter_unit(parameter, model),
                "U": None if fixed else abs(factor) * expanded,
                "unit of U": unit,
            }
        )
    equation = "corrected = M (raw - o)" + (" - G a" if model.g_sensitivity is not None else "")
    equation += " - d in motion" if model.moving_offset is not None else ""
    note = (
        f"{equation}. Expanded uncertainty U = k u with k = 2, at a coverage probability of about 95 %. A parameter without U is "
        "fixed."
    )
    form = {"value ± U": ".6g", "U": ".2g"}
    return Table.of(f"{NAMES[name].capitalize()}: results", rows, form=form, note=note)


def _budget(name: str, model: TriadModel, table: ParameterTable) -> Table:
    """Return a row for each source: evaluation, rms over the parameters of each kind. The last rows are combined and expanded."""
    units, separated = budget_units(name, model), "fit" not in table.shares
    places = {block: table.of_block(block) for block in BLOCKS if table.of_block(block)}
    rows = list[tuple[Cell, ...]]()

    def add(label: str, kind: str, values: FloatArray) -> None:
        sizes = [abs(units[block][0]) * math.sqrt(float((values[at] ** 2).mean())) for block, at in places.items()]
        rows.append((label, kind, *(size or None for size in sizes)))

    always = separated and {source for source, row in SOURCE_ROWS.items() if row[2] in ("", name)} - OPTIONAL_SOURCES
    for source, (label, kind, _) in SOURCE_ROWS.items():
        if source in table.shares or (always and source in always):
            add(label, kind, table.shares.get(source, np.zeros(len(table.names))))
    add("Combined standard uncertainty", "", table.standard)
    add("Expanded uncertainty", "", table.expanded)
    note = (
        "Standard uncertainty by source, root mean square over the parameters of a kind; type of evaluation A or B (JCGM 100). "
        "Scale factor and cross-axis sensitivity in per cent of the mean scale factor."
    )
    note += "" if separated else " The calibration contains no separate shares, so one line contains all sources."
    columns = ("source", "type", *(f"{BLOCKS[block]} ({units[block][1]})" for block in places))
    return Table(
        title=f"{NAMES[name].capitalize()}: uncertainty budget", columns=columns, rows=rows, form=".2g", note=note
    )


def _conformity(calibration: Calibration, limits: Mapping[str, float]) -> Table:
    """Return a row for each limit of a calibrated triad."""
    triads, rows = triads_of(calibration), list[dict[str, Cell]]()
    for key, limit in limits.items():
        name, block = key.split("_")[:2]
        if (model := triads.get(name)) is None:
            continue
        departure, expanded = departures(name, model, gravity_uncertainty(calibration, name))[block]
        result = "within" if abs(departure) <= limit else "outside"
        if not math.isfinite(departure):
            result = "nominal unknown"
        elif not expanded > 0.0:
            result = "not calibrated"
        rows.append(
            {
                "quantity": f"{NAMES[name]}: {BLOCKS[block]}",
                "largest departure": departure,
                "U": expanded,
                "limit": limit,
                "unit": budget_units(name, model)[block][1],
                "result": result,
            }
        )
    return Table.of("Statement of conformity", rows, note=RULE)


def departures(name: str, model: TriadModel, gravity: float = 0.0) -> dict[str, tuple[float, float]]:
    """Return the largest departure of the readings from nominal and its U, in the units of the budget, or NaN if unknown."""
    table, units = expand(model, gravity), budget_units(name, model)
    unknown = np.full(3, math.nan)
    values = {"scale": unknown, "offset": unknown}
    if is_physical(model.unit_in):
        nominal = 1.0 / si_factor(model.unit_in, "rate" if name == "gyro" else "accel")
        values["scale"] = 100.0 * (model.scale_factor / nominal - 1.0)
        values["offset"] = model.offset / model.scale_factor * SHOWN_UNIT[name][1]
    values["cross"] = (100.0 * model.matrix / np.diag(model.matrix).mean())[~np.eye(3, dtype=bool)]
    largest = dict[str, tuple[float, float]]()
    for block, departure in values.items():
        expanded, k = np.abs(units[block][0] * table.expanded[table.of_block(block)]), int(abs(departure).argmax())
        largest[block] = float(departure[k]), float(expanded[k]) if len(expanded) else 0.0
    return largest


# ---- further statements of a certificate


def _conditions(calibration: Calibration) -> Iterator[tuple[str, str]]:
    settings, temp_c = dict(calibration.provenance.settings), calibration.reference_temp_c
    yield "Reference temperature", "not recorded" if math.isnan(temp_c) else f"{temp_c:.2f} °C"
    yield "Local gravity", f"{calibration.gravity_m_s2:.5f} m/s² (source: {settings.get('gravity', 'not stated')})"
    for key, label in (("stills", "Rests"), ("faces", "Faces up"), ("turns", "Turns")):
        if key in settings:
            yield label, settings[key]
    if calibration.drift is not None and calibration.drift.static is not None:
        nodes = calibration.drift.static.temp_c
        yield "Temperature of the drift table", f"{nodes[0]:.1f} °C to {nodes[-1]:.1f} °C"
    for name, model in triads_of(calibration).items():
        (method, _, mode), (unit, factor) = model.method.partition("/"), SHOWN_UNIT[name]
        fit = f"{METHODS.get(method, method)}; {mode or 'default'} fit of {model.count} equations"
        yield (
            NAMES[name].capitalize(),
            f"{fit}, rank {model.rank}, residual {model.rms_residual * factor:.3g} {unit} rms",
        )
    if calibration.adc is not None:
        yield "ADC", f"gyroscopes {calibration.adc.gyro_rounding}, accelerometers {calibration.adc.accel_rounding}"


def _references(calibration: Calibration) -> Iterator[str]:
    settings, triads = dict(calibration.provenance.settings), triads_of(calibration)
    yield "Results are traceable only to the reference values below, which the user entered or left at their defaults."
    method = triads["gyro"].method.partition("/")[0] if "gyro" in triads else ""
    if method == "rate-table":
        quantities = (
            ("rate_uncertainty", "rates in common", "(relative)"), ("mount_tilt_deg", "mounting", "deg"),
            ("table_level_deg", "level of the table", "deg"), ("wobble_deg", "wobble", "deg"),
        )  # fmt: skip
        entered = ", ".join(f"{label} {settings[key]} {unit}" for key, label, unit in quantities if key in settings)
        yield f"Rates: as entered for the rate table. Standard uncertainties: {entered or 'not stated'}."
    elif method == "known-rotation":
        angle, axis = (settings.get(f"{name}_uncertainty_deg", "not stated") for name in ("angle", "axis"))
        yield f"Angles: as entered for the turns. Standard uncertainties: angle {angle} deg, axis of the turns {axis} deg."
    elif method and method != "rest":
        yield f"Gyroscopes: {METHODS.get(method, method)}; see the procedure."
    if "accel" in triads:
        statement, (least, most) = "taken as exact", INHABITED_GRAVITY
        if u := gravity_uncertainty(calibration):
            interval = f"uniform, {least:.3f} to {most:.3f} m/s²"
            statement = f"assumed; standard uncertainty {100.0 * u:.2f} % ({interval}) is in the budget"
        yield (
            f"Local gravity: {calibration.gravity_m_s2:.5f} m/s² (source: {settings.get('gravity', 'not stated')}), {statement}. "
            "A relative error of gravity causes the same relative error of the accelerometers' scale factor."
        )
    yield "This document does not list certificates of these references and does not claim accreditation."


def _limits_of_validity(calibration: Calibration) -> Iterator[str]:
    triads = triads_of(calibration)
    if calibration.magnetometer is not None:
        yield "The magnetometer is not part of this certificate."
    for name, model in triads.items():
        unit, factor = ("m/s²", 1.0) if name == "accel" else SHOWN_UNIT[name]
        low, high = (value * factor for value in model.valid_range)
        if high > low:
            calibrated = f"calibrated from {low:.4g} to {high:.4g} {unit}, at steady values"
            yield f"{NAMES[name].capitalize()}: {calibrated}. Larger values are not covered."
    if "accel" in triads:
        method, size = triads["accel"].method, "of data-sheet size (2e-4 per m/s²) is included in U of their offset"
        remark = "is part of their offset, and is not included in U"
        if method.startswith("six-face"):
            remark = f"{size}. 18 free poses would determine it"
        elif method.startswith("multi-position"):
            remark = f"{size}, as far as the poses do not determine it"
        yield f"The accelerometers are taken as linear within 1 g. A quadratic term {remark}."
    static = None if calibration.drift is None else calibration.drift.static
    if static is None:
        yield "Offsets apply at the reference temperature. Change with temperature is not included in U."
    else:
        nodes = static.temp_c
        yield f"Drift tables apply from {nodes[0]:.1f} to {nodes[-1]:.1f} °C. U applies at the reference temperature."
    yield "Change with time, shock and supply voltage are not included. Calibrate again if a known rest reads differently."
