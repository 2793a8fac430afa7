"""A C99 header and source that correct readings on a microcontroller, in float, double or fixed point.

The source evaluates the model of ``correction/correct.py`` in its order: rounding, static table and warm-up, matrix or scale table,
g-sensitivity, dynamic table; a table is held at its ends. It allocates nothing, calls nothing, keeps no state, and looks a table
up in a time that does not depend on the data. A thermometer's lag is removed by a function of its own, whose state the caller
owns (export/firmware.py); the warm-up by a second entry, to which the caller gives the time since power-on. One source makes three
builds: ``-DUNDRIFT_FLOAT``, ``-DUNDRIFT_DOUBLE``, ``-DUNDRIFT_FIXED``.
"""

import re
import textwrap
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.errors import InputError
from undrift.export import ExportOptions, Target
from undrift.export.firmware import (
    ASSUMPTION,
    FULL_FORCE,
    FULL_RATE,
    Arithmetic,
    Axis,
    Cost,
    FixedAxis,
    FixedTable,
    FixedTriad,
    Lead,
    Table,
    Triad,
    cost_of,
    fixed_triad,
    lead_of,
    nominal_triad,
    triads_of,
)
from undrift.export.losses import Exported, Part, losses
from undrift.model import Calibration
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

# ---- C text: literals, arrays, lookups in a table, and comments that nothing can break out of.

WIDTH = 116
SMALLEST, LARGEST = 1e-37, 3e38  # what a float literal may be


class Printer:
    """Prints arrays and lookups, and counts the bytes of the arrays."""

    def __init__(self, prefix: str) -> None:
        self.prefix, self.upper = prefix, prefix.upper()
        self.sizes = {"float": 0, "double": 0, "fixed": 0}

    def ints(self, kind: str, name: str, values: IntArray) -> str:
        """Return the definition of an array of integers."""
        flat = [str(int(v)) for v in np.ravel(values)]
        self.sizes["fixed"] += len(flat) * (2 if kind == "int16_t" else 4)
        return self._array(kind, name, flat)

    def reals(self, name: str, values: FloatArray) -> str:
        """Return the definition of an array of floats or doubles, as the build has it."""
        flat = [f"{self.upper}_C({literal(float(v))})" for v in np.ravel(values)]
        self.sizes["float"] += 4 * len(flat)
        self.sizes["double"] += 8 * len(flat)
        return self._array(f"{self.prefix}_t", name, flat)

    def _array(self, kind: str, name: str, cells: list[str]) -> str:
        lines, line = [], "   "
        for cell in cells:
            if len(line) + len(cell) + 2 > WIDTH:
                lines.append(line)
                line = "   "
            line += f" {cell},"
        lines.append(line.rstrip(","))
        return f"static const {kind} {self.prefix}_{name}[{len(cells)}] = {{\n" + "\n".join(lines) + "\n};\n"

    def fixed_cell(
        self, triad: str, table: str, axis: FixedAxis, x: str, place: str, fraction: str, what: str, cell: str = "cell"
    ) -> str:
        """Return the lines that find a cell and a position in it, and mark what lies outside."""
        start, stop, name = int(axis.nodes[0]), int(axis.nodes[-1]), f"{self.prefix}_{triad}_{table}_{place}"
        pad = "\n" + " " * (4 if cell == "cell" else 8)
        held = f"status |= {x} < {start} || {x} > {stop} ? {self.upper}_{what}_HELD : 0;{pad}" if what else ""
        if axis.axis.even:
            inner = f"{x}, {start}, {stop}, {int(axis.inverse[0])}u, {axis.shift}, {axis.axis.cells}, &{fraction}"
            return f"{held}{cell} = {self.prefix}_cell({inner});"
        inner = f"{x}, {name}, {name}_inverse, {axis.shift}, {axis.axis.cells}, {axis.axis.stride}, &{fraction}"
        return f"{held}{cell} = {self.prefix}_search({inner});"

    def real_cell(
        self, triad: str, table: str, axis: Axis, x: str, place: str, fraction: str, what: str, cell: str = "cell"
    ) -> str:
        """Return the lines that find a cell and a position in it, and mark what lies outside."""
        c, name = f"{self.upper}_C", f"{self.prefix}_{triad}_{table}_{place}"
        start, stop = literal(axis.start), literal(axis.stop)
        pad = "\n" + " " * (4 if cell == "cell" else 8)
        held = (
            f"status |= {x} >= {c}({start}) && {x} <= {c}({stop}) ? 0 : {self.upper}_{what}_HELD;{pad}" if what else ""
        )
        if axis.even:
            inner = f"{x}, {c}({start}), {c}({literal(float(axis.inverse[0]))}), {axis.cells}, &{fraction}"
            return f"{held}{cell} = {self.prefix}_cell({inner});"
        inner = f"{x}, {name}, {name}_inverse, {axis.cells}, {axis.stride}, &{fraction}"
        return f"{held}{cell} = {self.prefix}_search({inner});"


def literal(x: float) -> str:
    """Return a C literal that reads back to the last bit as a double, and that a float can be."""
    if abs(x) > LARGEST:
        raise InputError(f"export c: wanted numbers that float holds, got {x:g}; mend the calibration")
    text = repr(x if abs(x) >= SMALLEST else 0.0)
    return text if "." in text or "e" in text else text + ".0"


def comment_text(text: str) -> str:
    """Return text that cannot end a comment, continue a line or form a trigraph."""
    plain = re.sub(r"[^ -~]", "?", text).replace("\\", "/")
    plain = re.sub(r"\?{2,}", "?", plain)
    return plain.replace("*/", "* /").replace("/*", "/ *")


def wrapped(line: str) -> list[str]:
    """Return a line of a comment as lines that are not too long."""
    return textwrap.wrap(line, WIDTH + 6, subsequent_indent="    ") or [""]


# ---- c

CARRIED: frozenset[Part] = frozenset(
    ("lag", "warm-up", "rounding", "static", "scale", "dynamic", "g", "gain", "cross", "accel gain", "accel cross")
)  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True)
class CSettings:
    """How the source is written."""

    default: Arithmetic = "float"  # Arithmetic of a build that defines none: float, double or fixed
    # Begins every name, so that two devices fit into one program: a C identifier in lower case
    prefix: str = "undrift"
    header_name: str = "undrift.h"  # File name that the source includes
    # Fixed point: bits behind the point of a reading; None chooses 16, fewer where the offsets show large codes
    gyro_raw_bits: int | None = None
    accel_raw_bits: int | None = None
    # Physical unit of the readings of a triad that has no model; None for rad/s and m/s2
    gyro_unit: str | None = None
    accel_unit: str | None = None
    date: str = ""  # When it was exported; written into the comment


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ExportedC:
    """A C99 header and source, and what they cost."""

    header: str
    source: str
    not_carried: tuple[str, ...]  # What the calibration holds and the source does not
    notes: tuple[str, ...]  # What the firmware must know or do
    costs: tuple[Cost, ...]  # Of the float, double and fixed builds
    gyro_bound: FloatArray  # (3,), fixed point: worst error against exact arithmetic, rad/s
    accel_bound: FloatArray  # (3,), the same, m/s2


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _View:
    """A triad in real numbers and in integers, as the template asks for it."""

    name: str
    real: Triad
    fixed: FixedTriad

    def __getattr__(self, name: str) -> Any:
        return getattr(self.real, name)

    @property
    def named_tables(self) -> list[tuple[str, Table]]:
        return [(name, getattr(self.real, name)) for name in _TABLES if getattr(self.real, name) is not None]

    @property
    def fixed_tables(self) -> list[tuple[str, FixedTable]]:
        return [(name, getattr(self.fixed, name)) for name in _TABLES if getattr(self.fixed, name) is not None]

    @property
    def rates(self) -> int:
        return 0 if self.real.error_table is None else self.real.error_table.values.shape[1]


_TABLES = ("offset_table", "matrix_table", "error_table", "warm_up_table")


def export_c(calibration: Calibration, settings: CSettings = CSettings()) -> ExportedC:
    """Return the C99 header and source of a calibration.

    Parameters
    ----------
    calibration : Calibration
        The device's model.
    settings : CSettings
        Default arithmetic, names, room for codes.

    Returns
    -------
    ExportedC
        Both files, costs, and the error bound of fixed point.

    Raises
    ------
    InputError
        No model, NaN in it, a unit for a triad that has a model, a prefix that is no identifier, or numbers that the arithmetic
        does not hold.

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
    if not re.fullmatch(r"[a-z][a-z0-9_]{0,30}", settings.prefix):
        raise InputError(
            f"export c: wanted a prefix of lower-case letters, digits and _, got {settings.prefix!r}; name it so"
        )
    for bits in (settings.gyro_raw_bits, settings.accel_raw_bits):
        if bits is not None and not 0 <= bits <= 30:
            raise InputError(f"export c: wanted 0 to 30 bits behind the point of a reading, got {bits}; choose fewer")
    gyro, accel, notes = _triads(calibration, settings)
    of_accel = fixed_triad(accel, raw_bits=settings.accel_raw_bits, full=FULL_FORCE)
    of_gyro = fixed_triad(
        gyro, raw_bits=settings.gyro_raw_bits, full=FULL_RATE, accel_bound=of_accel.bound, accel_full=FULL_FORCE
    )
    views = [_View(name=t.name, real=t, fixed=x) for t, x in ((accel, of_accel), (gyro, of_gyro))]
    lead = lead_of(calibration)
    if lead is not None:
        notes += (
            f"the thermometer's lag of {lead.lag_s:.3g} s is removed by {settings.prefix}_temperature: pass every reading "
            f"through it before {settings.prefix}_correct",
        )
    if gyro.warm_up_table is not None:
        over = gyro.warm_up_table.temp.stop
        notes += (
            f"the extra offset after power-on, zero from {over:g} s on, is subtracted by {settings.prefix}_correct_since, which "
            f"takes the time since power-on; {settings.prefix}_correct leaves it in",
        )
    source, sizes = _source(views, calibration, settings, lead)
    triads = tuple(view.real for view in views)
    costs = tuple(cost_of(triads, arithmetic, size, lead=lead is not None) for arithmetic, size in sizes)
    not_carried = losses(calibration, CARRIED)
    return ExportedC(
        header=_header(views, calibration, settings, costs, not_carried + notes, lead),
        source=source,
        not_carried=not_carried,
        notes=notes,
        costs=costs,
        gyro_bound=of_gyro.bound,
        accel_bound=of_accel.bound,
    )


def _triads(calibration: Calibration, settings: CSettings) -> tuple[Triad, Triad, tuple[str, ...]]:
    """Return both triads, nominal where there is no model, with a note on those."""
    gyro, accel = triads_of(calibration)
    for name, triad, unit in (("gyro", gyro, settings.gyro_unit), ("accel", accel, settings.accel_unit)):
        if triad is not None and unit is not None:
            raise InputError(
                f"export c: wanted no unit of the {name}, whose model is for {triad.unit_in}, got {unit}; leave {name}_unit out",
                wanted=triad.unit_in,
                got=unit,
            )
    notes = []
    if gyro is None:
        gyro = nominal_triad("gyro", "rate", settings.gyro_unit or "rad/s")
        notes.append(f"gyroscopes have no model: nominal values are passed on; gyro_raw is taken as {gyro.unit_in}")
    if accel is None:
        accel = nominal_triad("accel", "accel", settings.accel_unit or "m/s2")
        notes.append(
            f"accelerometers have no model: nominal values are passed on; accel_raw is taken as {accel.unit_in}"
        )
    return gyro, accel, tuple(notes)


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


def _axes(table: Table | FixedTable, what: str = "") -> list[tuple[str, Any]]:
    return [
        ("since" if what == "warm_up_table" else "temp", table.temp),
        *([("rate", table.turn_rate)] if table.turn_rate is not None else []),
    ]


def _source(
    views: list[_View], calibration: Calibration, settings: CSettings, lead: Lead | None
) -> tuple[str, tuple[tuple[Arithmetic, int], ...]]:
    printer = Printer(settings.prefix)
    tables = [table for view in views for table in view.real.every_table]
    axes = [axis for table in tables for _, axis in _axes(table)]
    text = _environment().get_template("undrift.c.j2").render(
        title=_title(calibration), header=settings.header_name, p=settings.prefix, P=settings.prefix.upper(),
        triads=views, gyro=next((v for v in views if v.name == "gyro"), None),
        accel=next((v for v in views if v.name == "accel"), None),
        any_even=any(axis.even for axis in axes), any_search=any(not axis.even for axis in axes),
        any_line=any(table.turn_rate is None for table in tables),
        any_plane=any(table.turn_rate is not None for table in tables),
        ints=printer.ints, reals_of=printer.reals, axes_of=_axes, places=int,
        lead=lead, literal=literal, fixed_cell=printer.fixed_cell, real_cell=printer.real_cell,
    )  # fmt: skip
    sizes: tuple[tuple[Arithmetic, int], ...] = (
        ("float", printer.sizes["float"]),
        ("double", printer.sizes["double"]),
        ("fixed", printer.sizes["fixed"]),
    )
    return re.sub(r"\n{3,}", "\n\n", text), sizes


def _title(calibration: Calibration) -> str:
    return f"Correction of the inertial sensor {comment_text(calibration.device) or '(no serial number)'}"


def _header(
    views: list[_View],
    calibration: Calibration,
    settings: CSettings,
    costs: tuple[Cost, ...],
    notes: tuple[str, ...],
    lead: Lead | None,
) -> str:
    p = calibration.provenance
    warm = [view.real.warm_up_table for view in views if view.real.warm_up_table is not None]
    return str(
        _environment().get_template("undrift.h.j2").render(
            title=_title(calibration),
            comment=[comment_text(line) for line in _comment(views, calibration, settings, costs, notes)],
            default=settings.default, p=settings.prefix, P=settings.prefix.upper(), triads=views, created=p.created,
            lead=lead, lag_s=f"{lead.lag_s:g}" if lead else "", smooth_s=f"{lead.smooth_s:g}" if lead else "",
            warm_up=bool(warm), warm_s=f"{warm[0].temp.stop:g}" if warm else "",
        )
    )  # fmt: skip


def _comment(
    views: list[_View], calibration: Calibration, settings: CSettings, costs: tuple[Cost, ...], notes: tuple[str, ...]
) -> list[str]:
    warming = " and warm-up" if any(view.real.warm_up_table is not None for view in views) else ""
    lines = [
        f"Calibrated: {calibration.provenance.created or 'not stated'}. Exported: {settings.date or 'not stated'}.",
        f"Verdict of the calibration: {calibration.verdict.status}.",
        "",
        "Readings in sensor axes s, results in the case frame b: gyroscopes rad/s, accelerometers m/s2, temperature degC.",
    ]
    lines += [f"  {view.name}_raw: {view.real.unit_in}, temperatures {_span(view.real)}" for view in views]
    lines += [
        f"Order of the steps: 1 half a code step back, 2 offset(T){warming}, 3 matrix M(T), 4 g-sensitivity, "
        "5 dynamic drift e(w, T).",
        "Tables are linear between their nodes and held at their ends; the return value says when.",
        "Input and output may be the same arrays. No allocation, no library, no state; a lookup takes the same time everywhere.",
        "",
        f"Builds: define {settings.prefix.upper()}_FLOAT, _DOUBLE or _FIXED; without any: {settings.default}.",
        "Flash (tables exact, code estimated) and time of one call, estimated:",
        f"  {ASSUMPTION}",
    ]
    lines += [
        f"  {c.arithmetic:6} {c.table_bytes} + {c.code_bytes} = {c.flash_bytes} bytes, {c.cycles} cycles"
        + (f", and {c.lead_cycles} of {settings.prefix}_temperature" if c.lead_cycles else "")
        for c in costs
    ]
    lines += [
        "",
        "Fixed point: int32, 16 bits behind the point (Q16.16) unless a _RAW_BITS below says fewer. Error against exact",
    ]
    lines += ["arithmetic on the same inputs, at most, while no axis exceeds 2000 deg/s and 16 g:"]
    for view in views:
        worst = float(view.fixed.bound.max())
        if view.name == "gyro":
            lines.append(f"  gyro_out {worst:.3g} rad/s ({worst / RADIAN_PER_DEGREE:.3g} deg/s)")
        else:
            lines.append(f"  accel_out {worst:.3g} m/s2 ({worst / STANDARD_GRAVITY * 1e3:.3g} mg)")
    if notes:
        lines += ["", "Not carried, and notes:", *(f"  - {text}" for text in notes)]
    return [part for line in lines for part in wrapped(line)]


def _span(triad: Triad) -> str:
    if not triad.tables:
        return "without a table"
    low, high = max(t.temp.start for t in triad.tables), min(t.temp.stop for t in triad.tables)
    return f"{low:g} to {high:g} degC"


# ---- Target of ``undrift export``


def write_c(calibration: Calibration, options: ExportOptions, name: str) -> Exported:
    """Return header and source with their figures; the source includes the header by its name."""
    if not re.fullmatch(r"[\w.-]+", name, re.ASCII):
        raise InputError(
            f"{name}: wanted a file name of letters, digits, -, _ and . for a C header, got others; rename it"
        )
    settings = CSettings(
        default="fixed" if options.fixed else "double" if options.double else "float",
        prefix=options.prefix,
        header_name=name,
        gyro_raw_bits=options.gyro_raw_bits,
        accel_raw_bits=options.accel_raw_bits,
        gyro_unit=options.gyro_unit,
        accel_unit=options.accel_unit,
        date=datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
    )
    made = export_c(calibration, settings)
    keys = ("arithmetic", "table_bytes", "flash_bytes", "cycles", "lead_cycles")
    figures = {
        "builds": [{key: getattr(cost, key) for key in keys} for cost in made.costs],
        "fixed_point_bound": {
            "gyro_rad_s": float(made.gyro_bound.max()),
            "accel_m_s2": float(made.accel_bound.max()),
        },
    }
    return Exported(
        text=made.header, more=(made.source,), not_carried=made.not_carried, notes=made.notes, figures=figures
    )


TARGET = Target(endings=(".h",), more=(".c",), write=write_c)
