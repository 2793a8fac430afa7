"""A C99 header and source that correct readings on a microcontroller, in float or double.

The source evaluates the model of ``correction/correct.py`` in the same order: rounding, static table and warm-up, matrix or scale
table, g-sensitivity, dynamic table. Beyond its ends, a table is constant. The source allocates no memory, calls no library and
keeps no state. The time of a table lookup does not depend on the data. A separate function removes a thermometer's lag, with a
state that the caller owns (export/firmware.py). Another one adds the change of the offset from motion to rest. The warm-up requires
a second entry function, to which the caller passes the time since power-on. Two builds are possible: ``-DUNDRIFT_FLOAT`` and
``-DUNDRIFT_DOUBLE``.
"""

import re
import textwrap
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import numpy as np

from undrift.arrays import FloatArray
from undrift.correction.plan import Constants, LookupTable, TableAxis, constants_of
from undrift.errors import InputError
from undrift.export import ExportOptions, Target, firmware
from undrift.export.losses import Exported, Part, losses
from undrift.model import SENSORS, Calibration, Sensor
from undrift.segments import TURNING_ABOVE, TURNING_HOLD_S, TURNING_MEAN_S
from undrift.units import RADIAN_PER_DEGREE, SI_UNIT, canonical_unit, is_physical

# ---- C text: literals, arrays, table lookups and safe comments.

WIDTH = 116
SMALLEST, LARGEST = 1e-37, 3e38  # range of a float literal


class Printer:
    """Printer of arrays and lookups as C text."""

    def __init__(self, prefix: str) -> None:
        self.prefix, self.upper = prefix, prefix.upper()

    def reals(self, name: str, values: FloatArray) -> str:
        """Return the definition of an array of floats or doubles, depending on the build."""
        cells = [f"{self.upper}_C({literal(float(v))})" for v in np.ravel(values)]
        text = textwrap.fill(
            ", ".join(cells) + ",", WIDTH, initial_indent="    ", subsequent_indent="    ", break_on_hyphens=False
        )
        return f"static const {self.prefix}_t {self.prefix}_{name}[{len(cells)}] = {{\n{text.rstrip(',')}\n}};\n"

    def lookup(
        self,
        triad: str,
        table: str,
        axis: TableAxis,
        x: str,
        place: str,
        fraction: str,
        what: str,
        cell: str = "cell",
    ) -> str:
        """Return the C lines that find a cell and the position in it, and mark a value outside the table."""
        name, c = f"{self.prefix}_{triad}_{table}_{place}", f"{self.upper}_C"
        start, stop = f"{c}({literal(axis.start)})", f"{c}({literal(axis.stop)})"
        outside = f"{x} >= {start} && {x} <= {stop} ? 0 : {self.upper}_{what}_HELD"
        pad = "\n" + " " * (4 if cell == "cell" else 8)
        mark = f"status |= {outside};{pad}" if what else ""
        if axis.even:
            even = f"{start}, {c}({literal(float(axis.inverse[0]))})"
            return f"{mark}{cell} = {self.prefix}_cell({x}, {even}, {axis.cells}, &{fraction});"
        inner = f"{x}, {name}, {name}_inverse, {axis.cells}, {firmware.stride_of(axis)}, &{fraction}"
        return f"{mark}{cell} = {self.prefix}_search({inner});"


def literal(x: float) -> str:
    """Return a C literal that is exact as a double and in the range of a float."""
    if abs(x) > LARGEST:
        raise InputError(f"export c: {x:g} is beyond the range of float. Check the calibration.")
    text = repr(x if abs(x) >= SMALLEST else 0.0)
    return text if "." in text or "e" in text else text + ".0"


def comment_text(text: str) -> str:
    """Return text that cannot end a comment, continue a line or form a trigraph."""
    plain = re.sub(r"[^ -~]", "?", text).replace("\\", "/")
    plain = re.sub(r"\?{2,}", "?", plain)
    return plain.replace("*/", "* /").replace("/*", "/ *")


def wrapped(line: str) -> list[str]:
    """Return a line of a comment, wrapped to the line width."""
    return textwrap.wrap(line, WIDTH + 6, subsequent_indent="    ") or [""]


def check_prefix(prefix: str) -> None:
    """Raise InputError if a prefix is not the start of an identifier."""
    if not re.fullmatch(r"[a-z][a-z0-9_]{0,30}", prefix):
        raise InputError(
            f"export: prefix must be lower-case letters, digits and _, got {prefix!r}. Choose another prefix."
        )


# ---- Export of the C source.

CARRIED: frozenset[Part] = frozenset(
    ("lag", "warm-up", "moving", "rounding", "static", "scale", "dynamic", "g", "gain", "cross", "accel gain", "accel cross",
     "magnetometer")
)  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ExportedC:
    """A C99 header and source."""

    header: str
    source: str
    not_carried: tuple[str, ...]  # parts of the calibration that the source does not contain
    notes: tuple[str, ...]  # requirements for the firmware


def export_c(
    calibration: Calibration,
    options: ExportOptions = ExportOptions(),
    *,
    header_name: str = "undrift.h",
    date: str = "",
) -> ExportedC:
    """Return the C99 header and source of a calibration.

    Parameters
    ----------
    calibration : Calibration
        Calibration of the device.
    options : ExportOptions
        Default arithmetic, prefix of names, units of a triad without a model.
    header_name : str
        Name of the header file, for the source's include.
    date : str
        Date of the export, for the comment.

    Returns
    -------
    ExportedC
        Both files, and the parts of the calibration that they do not contain.

    Raises
    ------
    InputError
        If the model is missing or contains NaN, if a unit is given for a triad with a model, if the prefix is not an identifier, or
        if a number is beyond the range of float.

    Examples
    --------
    >>> import numpy as np, undrift
    >>> rng = np.random.default_rng(7)
    >>> device = undrift.random_device(rng)
    >>> calibration = undrift.calibrate(undrift.simulate_session("bench", device, rng=rng))
    >>> source = undrift.export_c(calibration)
    >>> "undrift_correct" in source.header
    True
    """
    check_prefix(options.prefix)
    notes: list[str] = []
    prefix = options.prefix
    gyro, accel = (_triad_of(calibration, options, name, notes) for name in SENSORS)
    triads = [accel, gyro]
    lead = firmware.lead_of(calibration)
    if lead is not None:
        notes.append(
            f"{prefix}_temperature removes the thermometer's lag of {lead.lag_s:.3g} s. Pass every temperature through it "
            f"before {prefix}_correct"
        )
    if gyro.warm_up_table is not None:
        notes.append(
            f"{prefix}_correct_since takes the time since power-on and subtracts the extra offset after power-on, which is zero "
            f"after {gyro.warm_up_table.temp.stop:g} s. {prefix}_correct does not subtract it"
        )
    if gyro.at_rest is not None:
        notes.append(
            f"offsets apply while the device turns. Pass every result of {prefix}_correct through {prefix}_at_rest, which adds "
            "the difference at rest"
        )
    if calibration.magnetometer is not None:
        notes.append(
            f"{prefix}_magnetometer corrects the magnetometer (uT to uT, in the axes of the gyroscopes). Pass the corrected rate "
            "at the same time with each reading"
        )
    not_carried = losses(calibration, CARRIED)
    return ExportedC(
        header=_header(triads, calibration, options, (*not_carried, *notes), lead, date),
        source=_source(triads, calibration, options, header_name, lead),
        not_carried=not_carried,
        notes=tuple(notes),
    )


def _triad_of(calibration: Calibration, options: ExportOptions, name: Sensor, notes: list[str]) -> Constants:
    """Return a triad. Without a model, return nominal constants and add a note."""
    triad = firmware.triads_of(calibration)[SENSORS.index(name)]
    unit = options.gyro_unit if name == "gyro" else options.accel_unit
    if triad is not None and unit is not None:
        raise InputError(
            f"export c: the {name} model already has the unit {triad.unit_in}, got {unit}. Omit {name}_unit.",
            wanted=triad.unit_in,
            got=unit,
        )
    if triad is None:  # readings in a physical unit are only converted to SI
        what, quantity = "gyroscopes" if name == "gyro" else "accelerometers", calibration.triad(name).quantity
        unit_name = canonical_unit(unit or SI_UNIT[quantity], quantity)
        if not is_physical(unit_name):
            raise InputError(
                f"export: the {name} has no model and requires a physical unit, got {unit}. Calibrate it, or set the unit "
                "of the firmware's readings."
            )
        triad = constants_of(calibration, name, unit_name)
        notes.append(f"{what} have no model, so {name}_raw is read in {unit_name}, with nominal values")
    return triad


def _environment() -> Any:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    return Environment(  # C source, not HTML
        loader=PackageLoader("undrift", "export"),
        autoescape=False,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        undefined=StrictUndefined,
    )


def _axes(table: LookupTable, what: str = "") -> list[tuple[str, Any]]:
    return [
        ("since" if what == "warm_up_table" else "temp", table.temp),
        *([("rate", table.turn_rate)] if table.turn_rate is not None else []),
    ]


def _source(
    triads: list[Constants],
    calibration: Calibration,
    options: ExportOptions,
    header_name: str,
    lead: firmware.Lead | None,
) -> str:
    printer = Printer(options.prefix)
    tables = [table for triad in triads for _, table in firmware.named_tables(triad)]
    axes = [axis for table in tables for _, axis in _axes(table)]
    accel, gyro = triads
    text = _environment().get_template("undrift.c.j2").render(
        title=_title(calibration), header=header_name, p=options.prefix, P=options.prefix.upper(),
        triads=triads, accel=accel, gyro=gyro, at_rest=gyro.at_rest, turning=(TURNING_ABOVE, TURNING_MEAN_S, TURNING_HOLD_S),
        any_even=any(axis.even for axis in axes), any_search=any(not axis.even for axis in axes),
        any_line=any(table.turn_rate is None for table in tables),
        any_plane=any(table.turn_rate is not None for table in tables),
        tables_of=firmware.named_tables, reals_of=printer.reals, axes_of=_axes,
        lead=lead, literal=literal, lookup=printer.lookup, mag=calibration.magnetometer,
    )  # fmt: skip
    return re.sub(r"\n{3,}", "\n\n", text)


def _title(calibration: Calibration) -> str:
    return f"Correction of the inertial sensor {comment_text(calibration.device) or '(no serial number)'}"


def _header(
    triads: list[Constants],
    calibration: Calibration,
    options: ExportOptions,
    notes: tuple[str, ...],
    lead: firmware.Lead | None,
    date: str,
) -> str:
    gyro = triads[1]
    warm = gyro.warm_up_table
    about = {
        "title": _title(calibration), "date": date, "p": options.prefix,
        "P": options.prefix.upper(), "triads": triads, "created": calibration.provenance.created, "lead": lead,
        "verdict": calibration.verdict.status, "notes": notes, "span": _span,
        "lag_s": f"{lead.lag_s:g}" if lead else "", "smooth_s": f"{lead.smooth_s:g}" if lead else "",
        "warm_up": warm is not None, "warm_s": f"{warm.temp.stop:g}" if warm else "",
        "moving": gyro.at_rest is not None,
        "mag": calibration.magnetometer is not None,
        "above": f"{TURNING_ABOVE / RADIAN_PER_DEGREE:g}", "held": f"{TURNING_HOLD_S:g}",
    }  # fmt: skip
    lines = _environment().get_template("comment.j2").render(about).splitlines()
    comment = [comment_text(piece) for line in lines for piece in wrapped(line)]
    return str(_environment().get_template("undrift.h.j2").render(about, comment=comment))


def _span(tables: list[LookupTable]) -> str:
    if not tables:
        return "without a table"
    low, high = max(t.temp.start for t in tables), min(t.temp.stop for t in tables)
    return f"{low:g} to {high:g} degC"


# ---- Target of ``undrift export``.


def write_c(calibration: Calibration, options: ExportOptions, name: str) -> Exported:
    """Return header and source. The source includes the header by its name."""
    if not re.fullmatch(r"[\w.-]+", name, re.ASCII):
        raise InputError(
            f"{name}: the name of a C header may contain only letters, digits, -, _ and . (full stop). Rename it."
        )
    exported = export_c(calibration, options, header_name=name, date=datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"))
    return Exported(
        text=exported.header, more=(exported.source,), not_carried=exported.not_carried, notes=exported.notes
    )


TARGET = Target(endings=(".h",), more=(".c",), write=write_c)
