"""Calibration certificate: results with expanded uncertainty, budget by source, reference values, limits, as one HTML page.

Scale factors and cross-axis terms are elements of the correction matrix, shares of a budget in per cent of its mean
diagonal. Limits apply to the readings before correction, with simple acceptance (ILAC-G8:09/2019). The result is
"within" if the largest departure from nominal over the axes is at most the limit, independent of its uncertainty.
Otherwise it is "outside".
"""

import math
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from undrift import __version__
from undrift.base.options import Output, options, verb
from undrift.base.summary import Result, Section, Summary, at, figure_of, rows_section
from undrift.commands.answer import (
    BLOCKS,
    NAMES,
    OFFSETS,
    SHOWN,
    answer_sentence,
    budget_units,
    rms_of,
    two_digits,
    uncertainty_section,
)
from undrift.commands.expanded import COVERAGE, ParameterTable, block_of, expand, gravity_uncertainty
from undrift.commands.files import check_output
from undrift.errors import InputError
from undrift.findings import most_consequential_first
from undrift.units import INHABITED_GRAVITY, is_physical, si_factor

if TYPE_CHECKING:
    from undrift.model import Calibration, TriadModel

# Row of the budget, how it is evaluated (GUM 4.2, 4.3), and which triads have it
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
METHODS = {  # a method's name and its description on a certificate
    "six-face": "six faces against gravity",
    "rate-table": "steady rates of a rate table, about each axis",
    "known-rotation": "turns by a known angle about each axis",
    "multi-position": "rests in free poses against the size of gravity",
    "rest": "rests only: the offset is measured, the scale factor is nominal",
    "reference": "motion against an orientation reference",
    "motion": "gravity in free motion, nothing else",
}
LONGEST = 200  # characters of an entry
BLANK = (
    "Customer",
    "Ambient temperature",
    "Relative humidity",
    "Due date",
    "Date of issue",
    "Authorised by",
    "Signature",
)  # by hand
LIMITS = {  # keys of a file of limits: triad, kind of parameter
    f"{name}_{key}": (name, key.partition("_")[0])
    for name, offset in (("gyro", "offset_dps"), ("accel", "offset_mg"))
    for key in ("scale_percent", "cross_percent", offset)
}
JUDGED = ("quantity", "largest departure", "U", "limit", "unit", "result")
RULE = (
    "Decision rule: simple acceptance (ILAC-G8:09/2019). A departure of at most the limit is reported as within, "
    "whatever U is. Near the limit, every second statement may be wrong. Departures are the largest deviations of "
    "the readings from nominal, before correction."
)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Certified(Result):
    """A calibration of which a certificate was written."""

    calibration: "Calibration"
    output: Path
    content: dict[str, Any]  # of the certificate

    def summary(self) -> Summary:
        """Return the largest expanded uncertainties, and each of them as the certificate has it."""
        from undrift.io.store import verdict_json

        model, content = self.calibration, self.content
        identity = {"file": str(self.output), "content_sha256": content["hash"]}
        identity |= {key: content[key] for key in ("statement", "conformity", "triads")}
        lines = tuple(f"{label}: {text}" for label, text in content["head"] if text)
        blank = ", ".join(label.lower() for label, text in content["head"] if not text)
        return Summary(
            title=f"Certificate of {model.device or 'a device'}",
            answer=answer_sentence(model),
            data=identity | {"verdict": verdict_json(model.verdict)},
            pictures=(figure_of("calibration:draw_calibration", model),),
            sections=(
                uncertainty_section(model),
                rows_section(
                    "Statement of conformity", content["conformity"], text=(RULE,) if content["conformity"] else ()
                ),
                Section(title="Statements of the laboratory", text=(*lines, f"Lines to fill in by hand: {blank}.")),
            ),
            verdict=model.verdict,
            written=(self.output,),
        )


@options
@dataclass(frozen=True, kw_only=True)
class Statement:
    """Entries of the laboratory required by ISO/IEC 17025. For missing entries, the certificate has lines to fill in by
    hand.

    Parameters
    ----------
    number : str
        Number of the certificate.
    laboratory : str
        Name and address of the laboratory.
    operator : str
        Who calibrated.
    """

    number: str = ""
    laboratory: str = ""
    operator: str = ""

    def entries(self) -> dict[str, str]:
        """Return the statements by name, empty if not given."""
        for name in ("number", "laboratory", "operator"):
            if not (text := getattr(self, name)).isprintable() or len(text) > LONGEST:
                raise InputError(
                    f"`{name}`: expected one line of at most {LONGEST} characters, got {text[:20]!r}.... Shorten it."
                )
        return {name: getattr(self, name).strip() for name in ("number", "laboratory", "operator")}


@verb
def certificate(
    calibration: Path, /, *, output: Output, statement: Statement = Statement(), limits: Path | None = None
) -> Certified:
    """Write a calibration certificate with results, expanded uncertainty, budget by source, reference values and
    limits.

    The page prints on A4. The same calibration and entries give the same file, byte for byte.

    The page prints on A4. The same calibration and statements give the same file, byte for byte.

    Parameters
    ----------
    calibration : Path
        calibration.json of the device.
    output : Path
        The page, named *.html.
    limits : Path or None
        Limits of the readings before correction, .toml, such as gyro_offset_dps = 20 or accel_scale_percent = 3.
    """
    from undrift.io.store import read_calibration

    check_output(output, endings=(".html",), reads=(calibration, limits))
    model = read_calibration(calibration)
    content = certificate_content(model, statement, {} if limits is None else read_limits(limits))
    at("undrift.report.calibration:write_certificate")(model, output, content)
    return Certified(calibration=model, output=output, content=content)


def read_limits(path: Path) -> dict[str, float]:
    """Return the limits of a file by their keys in ``LIMITS``."""
    from undrift.files import checked_file

    try:
        limits = tomllib.loads(checked_file(path).read_text(encoding="utf-8"))
    except ValueError as error:
        raise InputError(
            f"{path}: expected limits as TOML, got {error}. Write for example accel_offset_mg = 50."
        ) from error
    for key, limit in limits.items():
        if key not in LIMITS or not isinstance(limit, int | float) or not 0.0 < limit < math.inf:
            raise InputError(f"{path}: expected one of {', '.join(LIMITS)} above 0, got {key} = {limit}. Correct it.")
    return {key: float(limit) for key, limit in limits.items()}


def certificate_content(
    calibration: "Calibration", statement: Statement = Statement(), limits: Mapping[str, float] | None = None
) -> dict[str, Any]:
    """Return the texts and the rows of tables of a certificate."""
    from undrift.io.store import content_hash

    triads = {name: triad for name in NAMES if (triad := getattr(calibration, name)) is not None}
    if not triads:
        raise InputError("certificate: expected a calibrated gyroscope or accelerometer, got neither. Calibrate first.")
    for name, triad in triads.items():
        if not (triad.parameters and np.isfinite(triad.covariance).all() and triad.covariance.any()):
            raise InputError(
                f"certificate: expected a covariance of the {NAMES[name].lower()}, got none. Calibrate from "
                f"recordings with undrift."
            )
    provenance, entries = calibration.provenance, statement.entries()
    labels = {"number": "Certificate number", "laboratory": "Laboratory", "operator": "Calibrated by"}
    return {
        "statement": {name: text or None for name, text in entries.items()},
        "head": [*((label, entries[name]) for name, label in labels.items()), *((label, "") for label in BLANK)],
        "conformity": [*_conformity(calibration, triads, limits or {})],
        "rule": RULE,
        "device": calibration.device or "without serial number",
        "hash": content_hash(calibration),
        "date": provenance.created[:10] or "not stated",
        "conditions": [*_conditions(calibration), *_procedure(calibration, triads)],
        "triads": [_triad(name, triad, gravity_uncertainty(calibration, name)) for name, triad in triads.items()],
        "traceability": [*_traceability(calibration, triads)],
        "limits": [*_limits(calibration, triads)],
        "verdict": calibration.verdict.status,
        "findings": [
            item.sentence for item in most_consequential_first(calibration.verdict.findings) if item.level != "info"
        ],
        "inputs": [list(pair) for pair in provenance.inputs],
        "software": ", ".join(f"{name} {version}" for name, version in provenance.versions) or f"undrift {__version__}",
    }


def departures(name: str, triad: "TriadModel", gravity: float = 0.0) -> "dict[str, tuple[float, float]]":
    """Return the largest departure of the readings from nominal and its U, in the units of the budget, or NaN if
    unknown.
    """
    table, (per, _) = expand(triad, gravity), budget_units(name, triad)
    nominal = (
        1.0 / si_factor(triad.unit_in, "rate" if name == "gyro" else "accel")
        if is_physical(triad.unit_in)
        else math.nan
    )
    values = {
        "scale": 100.0 * (triad.scale_factor / nominal - 1.0),
        "cross": (100.0 * triad.matrix / np.diag(triad.matrix).mean())[~np.eye(3, dtype=bool)],
        "offset": triad.offset / triad.scale_factor * SHOWN[name][1] + 0.0 * nominal,
    }
    worst = dict[str, tuple[float, float]]()
    for block, value in values.items():
        expanded = np.abs(per[block] * table.expanded[table.of_block(block)])
        largest = int(abs(value).argmax())
        worst[block] = float(value[largest]), float(expanded[largest]) if len(expanded) else 0.0
    return worst


def _conformity(
    calibration: "Calibration", triads: "Mapping[str, TriadModel]", limits: Mapping[str, float]
) -> Iterator[dict[str, str]]:
    """Yield a row for each limit of a triad that is calibrated."""
    for key, limit in limits.items():
        name, block = LIMITS[key]
        if (triad := triads.get(name)) is None:
            continue
        value, expanded = departures(name, triad, gravity_uncertainty(calibration, name))[block]
        result, figures = "within" if abs(value) <= limit else "outside", ("–", "–")
        if not math.isfinite(value):
            result = "nominal unknown"
        elif not expanded > 0.0:
            result = "not calibrated"
        else:
            figures = rounded(value, expanded)
        label = f"{NAMES[name]}: {OFFSETS[name] if block == 'offset' else BLOCKS[block]}"
        cells = (label, *figures, f"{limit:g}", budget_units(name, triad)[1][block], result)
        yield dict(zip(JUDGED, cells, strict=True))


def _conditions(calibration: "Calibration") -> Iterator[tuple[str, str]]:
    settings = dict(calibration.provenance.settings)
    temp_c = calibration.reference_temp_c
    yield "Reference temperature", "not recorded" if math.isnan(temp_c) else f"{temp_c:.2f} °C"
    source = settings.get("gravity", "not stated")
    yield "Local gravity", f"{calibration.gravity_m_s2:.5f} m/s² (source: {source})"
    for name, label in (("stills", "Rests"), ("faces", "Faces up"), ("turns", "Turns")):
        if name in settings:
            yield label, settings[name]
    if calibration.drift is not None and calibration.drift.static is not None:
        nodes = calibration.drift.static.temp_c
        yield "Temperature of the drift table", f"{nodes[0]:.1f} °C to {nodes[-1]:.1f} °C"


def method_words(method: str) -> str:
    """Return a method of calibration in words."""
    return METHODS.get(method, method)


def _procedure(calibration: "Calibration", triads: "Mapping[str, TriadModel]") -> Iterator[tuple[str, str]]:
    for name, triad in triads.items():
        method, _, mode = triad.method.partition("/")
        fit = f"{method_words(method)}; {mode or 'default'} fit of {triad.count} equations"
        rms, unit, factor = triad.rms_residual, *SHOWN[name]
        yield NAMES[name], f"{fit}, rank {triad.rank}, residual {rms * factor:.3g} {unit} rms"
    if calibration.adc is not None:
        yield "ADC", f"gyroscopes {calibration.adc.gyro_rounding}, accelerometers {calibration.adc.accel_rounding}"


def _triad(name: str, triad: "TriadModel", gravity: float) -> dict[str, Any]:
    table, (per, units) = expand(triad, gravity), budget_units(name, triad)
    blocks = [block for block in BLOCKS if table.of_block(block)]
    labels = BLOCKS | {"offset": OFFSETS[name]}
    return {
        "title": NAMES[name],
        "model": "corrected = M (raw − o)"
        + ("" if triad.g_sensitivity is None else " − G a")
        + ("" if triad.moving_offset is None else " − d in motion"),
        "separated": triad.budget is not None,
        "results": [_result(name, triad, table, n, per, units) for n in range(len(table.names))],
        "blocks": [f"{labels[block]} ({units[block]})" for block in blocks],
        "budget": [*_budget_rows(name, table, blocks, per)],
        "si": triad.unit_out,
        "student": bool((table.coverage > COVERAGE).any()),
    }


def _result(
    name: str, triad: "TriadModel", table: ParameterTable, n: int, per: Mapping[str, float], units: Mapping[str, str]
) -> list[str]:
    """Return quantity, value with its unit, U, U in the units of the budget, k, and the value in SI units."""
    block, parameter = block_of(table.names[n]), table.names[n]
    unit_in, (shown_unit, per_si) = triad.unit_in, SHOWN[name]
    unit, factor = unit_in, 1.0
    if block in ("g", "moving"):
        unit, factor = units[block], per[block]
    elif block not in ("offset", "code"):
        unit, factor = f"{shown_unit} per {unit_in}", per_si
        if is_physical(unit_in):
            unit, factor = "1", 1.0 / si_factor(unit_in, "rate" if name == "gyro" else "accel")
    value, expanded = table.value[n] * factor, table.expanded[n] * abs(factor)
    value_text, less = rounded(value, expanded)
    fixed = not expanded > 0.0
    relative = "–" if fixed else f"{two_digits(table.expanded[n] * abs(per[block]))} {units[block]}"
    coverage, scale = "–" if fixed else f"{table.coverage[n]:.2f}", 1.0
    if block in ("offset", "code"):
        scale = abs(per[block]) / per_si
    si = "–" if unit == "1" else rounded(table.value[n] * scale, table.expanded[n] * scale)[0]
    return [parameter, value_text, unit, "held" if fixed else less, relative, coverage, si]


def rounded(value: float, uncertainty: float) -> tuple[str, str]:
    """Return a value and its uncertainty to two digits of the uncertainty."""
    if not uncertainty > 0.0:
        return f"{value:.6g}", "0"
    places = 1 - math.floor(math.log10(uncertainty))
    if 0 <= places <= 7:
        return f"{value:.{places}f}", f"{uncertainty:.{places}f}"
    power = math.floor(math.log10(max(abs(value), uncertainty)))
    digits = max(0, places + power)
    return f"{value / 10.0**power:.{digits}f}e{power}", f"{uncertainty / 10.0**power:.{digits}f}e{power}"


def _budget_rows(name: str, table: ParameterTable, blocks: list[str], per: Mapping[str, float]) -> Iterator[list[str]]:
    """Yield a row for each source: evaluation, rms over the parameters of each block. The last rows are combined and
    expanded.
    """
    places = {block: table.of_block(block) for block in blocks}
    for source, (label, kind, only) in SOURCE_ROWS.items():
        if source == "gravity" and name == "accel" and source not in table.shares:
            yield [label, kind, *("not included" if block == "scale" else "–" for block in blocks)]
        share = table.shares.get(source)
        if share is None and (
            only not in ("", name)
            or source in ("angle", "axis", "fit", "gravity", "nonlinearity")
            or "fit" in table.shares
        ):
            continue
        cells = (0.0 if share is None else abs(per[b]) * rms_of(share[places[b]]) for b in blocks)
        yield [label, kind, *map(two_digits, cells)]
    for label, values in (("Combined standard uncertainty", table.standard), ("Expanded uncertainty", table.expanded)):
        yield [label, "", *(two_digits(abs(per[b]) * rms_of(values[places[b]])) for b in blocks)]


def _traceability(calibration: "Calibration", triads: "Mapping[str, TriadModel]") -> Iterator[str]:
    settings = dict(calibration.provenance.settings)
    yield "Results are traceable only to the reference values below, which the user entered or left at their defaults."
    methods = {name: triad.method.partition("/")[0] for name, triad in triads.items()}
    if methods.get("gyro") == "rate-table":
        quantities = (
            ("rate_uncertainty", "rates in common", "(relative)"), ("mount_tilt_deg", "mounting", "deg"),
            ("table_level_deg", "level of the table", "deg"), ("wobble_deg", "wobble", "deg"),
        )  # fmt: skip
        entered = ", ".join(f"{label} {settings[key]} {unit}" for key, label, unit in quantities if key in settings)
        yield f"Rates: as entered for the rate table. Standard uncertainties: {entered or 'not stated'}."
    elif methods.get("gyro") == "known-rotation":
        angle, axis = (settings.get(f"{name}_uncertainty_deg", "not stated") for name in ("angle", "axis"))
        yield f"Angles: as entered for the turns. Standard uncertainties: angle {angle} deg, axis of the turns {axis} deg."
    elif "gyro" in methods and methods["gyro"] != "rest":
        yield f"Gyroscopes: {method_words(methods['gyro'])}; see the procedure."
    if "accel" in triads:
        source, how, (least, most) = settings.get("gravity", "not stated"), "taken as exact", INHABITED_GRAVITY
        if u := gravity_uncertainty(calibration):
            how = f"assumed; standard uncertainty {100.0 * u:.2f} % (uniform, {least:.3f} to {most:.3f} m/s²) is in the budget"
        yield (
            f"Local gravity: {calibration.gravity_m_s2:.5f} m/s² (source: {source}), {how}. "
            "A relative error of it is the same relative error of the accelerometers' scale factor."
        )
    yield "This document lists no certificates of these references and claims no accreditation."


def _limits(calibration: "Calibration", triads: "Mapping[str, TriadModel]") -> Iterator[str]:
    if calibration.magnetometer is not None:
        yield "The magnetometer is not part of this certificate."
    for name, triad in triads.items():
        low, high = (value * (1.0 if name == "accel" else SHOWN[name][1]) for value in triad.valid_range)
        unit = "m/s²" if name == "accel" else "deg/s"
        if high > low:
            yield f"{NAMES[name]}: calibrated from {low:.4g} to {high:.4g} {unit}, at steady values. Larger values are not covered."
    if "accel" in triads:
        method, size = triads["accel"].method, "of a data sheet's size (2e-4 per m/s²) is included in U of their offset"
        remark = "is part of their offset, and not included in U"
        if method.startswith(("six-face", "multi-position")):
            six = method.startswith("six-face")
            remark = (
                f"{size}. 18 free poses would determine it" if six else f"{size}, as far as the poses leave it open"
            )
        yield f"The accelerometers are taken as linear within 1 g. A quadratic term {remark}."
    tables = calibration.drift
    if tables is None or tables.static is None:
        yield "Offsets hold at the reference temperature. Change with temperature is not included in U."
    else:
        nodes = tables.static.temp_c
        yield f"Drift tables hold from {nodes[0]:.1f} to {nodes[-1]:.1f} °C. U of the results is that at the reference temperature."
    yield "Change with time, shock and supply voltage are not included. Calibrate again when a known rest reads otherwise."
