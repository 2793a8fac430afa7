"""A C99 header and source that correct readings on a microcontroller, in float or double.

The source evaluates the model of ``correction/correct.py`` in the same order: rounding, static table and warm-up, matrix or scale
table, g-sensitivity, dynamic table. Beyond its ends, a table is constant. The source allocates no memory, calls no library and
keeps no state. The time of a table lookup does not depend on the data. A separate function removes a thermometer's lag, with a
state that the caller owns. Another function adds the change of the offset from motion to rest. The warm-up requires a second entry
function, to which the caller passes the time since power-on. Two builds are possible: ``-DUNDRIFT_FLOAT`` and ``-DUNDRIFT_DOUBLE``.

If the nodes of a table are whole multiples of a step, the table is converted to the even grid that contains them all, and one
multiplication determines the cell. If this would more than double the memory, the cell is found by bisection in a fixed number of
steps.
"""

import re
import textwrap
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import PurePath
from typing import Any

import numpy as np

from undrift.arrays import FloatArray
from undrift.correction.plan import Constants, LookupTable, constants_of
from undrift.errors import InputError
from undrift.export import Exported, ExportOptions, conversions, not_in_firmware
from undrift.kernels.tables import Grid
from undrift.model import SENSORS, Calibration
from undrift.segments import TURNING_ABOVE, TURNING_HOLD_S, TURNING_MEAN_S
from undrift.units import RADIAN_PER_DEGREE, SI_UNIT

# ---- Constants of the correction (correction/plan.py), with tables for lookup in constant time.

TABLES = ("offset_table", "matrix_table", "error_table", "warm_up_table")


def named_tables(constants: Constants) -> list[tuple[str, LookupTable]]:
    """Return names and values of the tables in the constants."""
    return [(name, getattr(constants, name)) for name in TABLES if getattr(constants, name) is not None]


def triads_of(calibration: Calibration) -> tuple[Constants | None, Constants | None]:
    """Return the constants of gyroscopes and accelerometers for firmware, None for a triad without a model."""
    if calibration.gyro is None and calibration.accel is None:
        raise InputError("export: there is no model of gyroscopes or accelerometers. Calibrate first.")
    gyro, accel = (
        None if triad.model is None else _on_grids(constants_of(calibration, name))
        for name, triad in zip(SENSORS, calibration.triads, strict=True)
    )
    return gyro, accel


def _on_grids(constants: Constants) -> Constants:
    """Return the constants with tables for fast lookup. Raise InputError if any of them contains NaN."""
    tables = named_tables(constants)
    parts = [constants.matrix, *(table.values for _, table in tables), constants.half_step, constants.g_sensitivity]
    parts += [constants.offset] if constants.offset_table is None else []
    missing = sum(int(np.isnan(array).sum()) for array in parts if array is not None)
    if missing:
        raise InputError(
            f"export: the model of the {constants.name} contains {missing} NaN. Calibrate the missing parameters.",
            missing=missing,
        )
    findable: dict[str, Any] = {name: table.evened() for name, table in tables}
    return replace(constants, **findable)


def stride_of(axis: Grid) -> int:
    """Return the first stride of a bisection: the largest power of two below the number of cells, at least 1."""
    return 1 << max(0, (axis.cells - 1).bit_length() - 1)


# ---- Lead filter, which removes a thermometer's lag. It is equivalent to the filter of drift/temperature.py.
#
# With the low-passed reading z, d = x - z, a = dt / smooth and g = lag / smooth:
#
#     d = e^-a d + m (x - x_before)     m = (1 - e^-a) / a          y = x + (g - 1) d
#
# The state has two numbers. At steady temperature d is small, so the rounding errors of float are also small.

SHORTEST_S, LONGEST_S = 1e-3, 1e5  # range of smoothing times for the accuracy of float, s
MOST_GAIN = 2.0**15


@dataclass(frozen=True, slots=True, kw_only=True)
class Lead:
    """Constants of the lead filter."""

    lag_s: float  # time constant of the thermometer, s
    smooth_s: float  # time constant of the smoothing, s
    gain: float  # g - 1
    rate: float  # inverse of the smoothing time constant, 1/s


def lead_of(calibration: Calibration) -> Lead | None:
    """Return the lead filter of a calibration, or None if it has no lag or no tables."""
    drift = calibration.drift
    if drift is None or not drift.lag_s > 0.0 or (drift.static, drift.scale, drift.dynamic) == (None, None, None):
        return None
    smooth = drift.lag_smooth_s
    if not (SHORTEST_S <= smooth <= LONGEST_S and drift.lag_s / smooth <= MOST_GAIN):
        raise InputError(
            f"export c: smoothing must be {SHORTEST_S:g} to {LONGEST_S:g} s and lag at most {MOST_GAIN:g} times that, got a lag of "
            f"{drift.lag_s:g} s with smoothing over {smooth:g} s. Fit the lag again."
        )
    return Lead(lag_s=drift.lag_s, smooth_s=smooth, gain=drift.lag_s / smooth - 1.0, rate=1.0 / smooth)


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
        axis: Grid,
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
        if axis.inverse > 0.0:
            even = f"{start}, {c}({literal(axis.inverse)})"
            return f"{mark}{cell} = {self.prefix}_cell({x}, {even}, {axis.cells}, &{fraction});"
        inner = f"{x}, {name}, {name}_inverse, {axis.cells}, {stride_of(axis)}, &{fraction}"
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
        Prefix of names.
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
        If the model is missing or contains NaN, if the prefix is not an identifier, or if a number is beyond the range of float.

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
    notes = [*conversions(calibration)]
    prefix = options.prefix
    gyro, accel = _nominal_if_missing(calibration, notes)
    lead = lead_of(calibration)
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
    not_carried = not_in_firmware(calibration)
    parts = _parts(calibration, [accel, gyro], options.prefix, lead)
    parts |= {"header": header_name, "date": date, "notes": (*not_carried, *notes)}
    environment = _environment()
    lines = environment.get_template("comment.j2").render(parts).splitlines()
    comment = [comment_text(piece) for line in lines for piece in wrapped(line)]
    source = environment.get_template("undrift.c.j2").render(parts)
    return ExportedC(
        header=environment.get_template("undrift.h.j2").render(parts, comment=comment),
        source=re.sub(r"\n{3,}", "\n\n", source),
        not_carried=not_carried,
        notes=tuple(notes),
    )


def _parts(calibration: Calibration, triads: list[Constants], prefix: str, lead: Lead | None) -> dict[str, Any]:
    """Return the variables of the templates."""
    accel, gyro = triads
    tables = [table for triad in triads for _, table in named_tables(triad)]
    axes = [axis for table in tables for _, axis in _axes(table)]
    printer, warm_up = Printer(prefix), gyro.warm_up_table
    return {
        "title": f"Correction of the inertial sensor {comment_text(calibration.device) or '(no serial number)'}",
        "created": calibration.provenance.created, "verdict": calibration.verdict.status,
        "p": prefix, "P": prefix.upper(), "triads": triads, "accel": accel, "gyro": gyro, "span": _span,
        "lead": lead, "lag_s": f"{lead.lag_s:g}" if lead else "", "smooth_s": f"{lead.smooth_s:g}" if lead else "",
        "warm_up": warm_up is not None, "warm_s": f"{warm_up.temp.stop:g}" if warm_up else "",
        "at_rest": gyro.at_rest, "moving": gyro.at_rest is not None, "mag": calibration.magnetometer,
        "turning": (TURNING_ABOVE, TURNING_MEAN_S, TURNING_HOLD_S),
        "above": f"{TURNING_ABOVE / RADIAN_PER_DEGREE:g}", "held": f"{TURNING_HOLD_S:g}",
        "any_even": any(axis.inverse > 0.0 for axis in axes), "any_search": any(axis.inverse == 0.0 for axis in axes),
        "any_line": any(table.turn_rate is None for table in tables),
        "any_plane": any(table.turn_rate is not None for table in tables),
        "tables_of": named_tables, "axes_of": _axes, "reals_of": printer.reals,
        "inverse_of": lambda axis: 1.0 / np.diff(axis.nodes), "lookup": printer.lookup, "literal": literal,
    }  # fmt: skip


def _nominal_if_missing(calibration: Calibration, notes: list[str]) -> list[Constants]:
    """Return gyroscopes and accelerometers. A triad without a model is in SI units with nominal values, and a note reports it."""
    constants = list[Constants]()
    for name, triad in zip(SENSORS, triads_of(calibration), strict=True):
        if triad is None:
            unit = SI_UNIT[calibration.triad(name).quantity]
            what = "gyroscopes" if name == "gyro" else "accelerometers"
            notes.append(f"{what} have no model, so {name}_raw is read in {unit}, with nominal values")
            triad = constants_of(calibration, name, unit)
        constants.append(triad)
    return constants


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


def _span(tables: list[LookupTable]) -> str:
    if not tables:
        return "without a table"
    low, high = max(t.temp.start for t in tables), min(t.temp.stop for t in tables)
    return f"{low:g} to {high:g} degC"


# ---- Target of ``undrift export``.


def write_c(calibration: Calibration, options: ExportOptions, name: str) -> Exported:
    """Return header and source. The source includes the header by name."""
    if not re.fullmatch(r"[\w.-]+", name, re.ASCII):
        raise InputError(
            f"{name}: the name of a C header may contain only letters, digits, -, _ and . (full stop). Rename it."
        )
    exported = export_c(calibration, options, header_name=name, date=utc_now())
    files = {name: exported.header, str(PurePath(name).with_suffix(".c")): exported.source}
    return Exported(files=files, not_carried=exported.not_carried, notes=exported.notes)


def utc_now() -> str:
    """Return the current time in UTC, such as 2026-11-30T12:00:00Z."""
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
