"""A C99 header and source that correct readings on a microcontroller, in float, double or fixed point.

The source evaluates the model of ``correction/correct.py`` in its order: rounding, static table and warm-up, matrix or scale table,
g-sensitivity, dynamic table; a table is held at its ends. It allocates nothing, calls nothing, keeps no state, and looks a table
up in a time that does not depend on the data. A thermometer's lag is removed by a function of its own, whose state the caller
owns (export/firmware.py), and the change of the offset from motion to rest likewise; the warm-up by a second entry, to which the
caller gives the time since power-on. One source makes three builds: ``-DUNDRIFT_FLOAT``, ``-DUNDRIFT_DOUBLE``, ``-DUNDRIFT_FIXED``.
"""

import re
import textwrap
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.correction.plan import Constants, LookupTable, TableAxis, constants_of
from undrift.errors import InputError
from undrift.export import ExportOptions, Target, firmware
from undrift.export.losses import Exported, Part, losses, texts_of
from undrift.findings import Finding, finding
from undrift.model import SENSORS, Calibration, Sensor
from undrift.segments import TURNING_ABOVE, TURNING_HOLD_S, TURNING_MEAN_S
from undrift.units import RADIAN_PER_DEGREE, SI_UNIT, STANDARD_GRAVITY, canonical_unit, is_physical

# ---- C text: literals, arrays, lookups in a table, and comments that nothing can break out of.

WIDTH = 116
Pair = tuple[Constants, firmware.FixedTriad]  # in real numbers and in integers
SMALLEST, LARGEST = 1e-37, 3e38  # what a float literal may be


class Printer:
    """Prints arrays and lookups, and counts the bytes of the arrays."""

    def __init__(self, prefix: str) -> None:
        self.prefix, self.upper = prefix, prefix.upper()
        self.sizes: dict[firmware.Arithmetic, int] = {"float": 0, "double": 0, "fixed": 0}

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
        text = textwrap.fill(
            ", ".join(cells) + ",", WIDTH, initial_indent="    ", subsequent_indent="    ", break_on_hyphens=False
        )
        return f"static const {kind} {self.prefix}_{name}[{len(cells)}] = {{\n{text.rstrip(',')}\n}};\n"

    def lookup(
        self,
        triad: str,
        table: str,
        axis: TableAxis | firmware.FixedAxis,
        x: str,
        place: str,
        fraction: str,
        what: str,
        cell: str = "cell",
    ) -> str:
        """Return the lines that find a cell and a position in it, and mark what lies outside."""
        name, c = f"{self.prefix}_{triad}_{table}_{place}", f"{self.upper}_C"
        if isinstance(axis, firmware.FixedAxis):
            real, start, stop = axis.axis, str(axis.nodes[0]), str(axis.nodes[-1])
            outside = f"{x} < {start} || {x} > {stop} ? {self.upper}_{what}_HELD : 0"
            even, uneven = f"{start}, {stop}, {axis.inverse[0]}u, {axis.shift}", f", {axis.shift}"
        else:
            real, start, stop = axis, f"{c}({literal(axis.start)})", f"{c}({literal(axis.stop)})"
            outside = f"{x} >= {start} && {x} <= {stop} ? 0 : {self.upper}_{what}_HELD"
            even, uneven = f"{start}, {c}({literal(float(axis.inverse[0]))})", ""
        pad = "\n" + " " * (4 if cell == "cell" else 8)
        held = f"status |= {outside};{pad}" if what else ""
        if real.even:
            return f"{held}{cell} = {self.prefix}_cell({x}, {even}, {real.cells}, &{fraction});"
        inner = f"{x}, {name}, {name}_inverse{uneven}, {real.cells}, {firmware.stride_of(real)}, &{fraction}"
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
    ("lag", "warm-up", "moving", "rounding", "static", "scale", "dynamic", "g", "gain", "cross", "accel gain", "accel cross",
     "magnetometer")
)  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ExportedC:
    """A C99 header and source, and what they cost."""

    header: str
    source: str
    not_carried: tuple[str, ...]  # What the calibration holds and the source does not
    notes: tuple[str, ...]  # What the firmware must know or do
    costs: tuple[firmware.Cost, ...]  # Of the float, double and fixed builds
    findings: tuple[Finding, ...]  # What is not carried, and the notes, as codes with numbers
    gyro_bound: FloatArray  # (3,), fixed point: worst error against exact arithmetic, rad/s
    accel_bound: FloatArray  # (3,), the same, m/s2


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
        The device's model.
    options : ExportOptions
        Default arithmetic, prefix of names, room for codes.
    header_name : str
        Name of the file that the source includes.
    date : str
        When it was exported, for the comment.

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
    if not re.fullmatch(r"[a-z][a-z0-9_]{0,30}", options.prefix):
        raise InputError(
            f"export c: wanted a prefix of lower-case letters, digits and _, got {options.prefix!r}; name it so"
        )
    for bits in (options.gyro_raw_bits, options.accel_raw_bits):
        if bits is not None and not 0 <= bits <= 30:
            raise InputError(f"export c: wanted 0 to 30 bits behind the point of a reading, got {bits}; choose fewer")
    notes: list[Finding] = []
    gyro, accel = (_triad_of(calibration, options, name, notes) for name in SENSORS)
    of_accel = firmware.fixed_triad(accel, raw_bits=options.accel_raw_bits, full=firmware.FULL_FORCE)
    of_gyro = firmware.fixed_triad(
        gyro,
        raw_bits=options.gyro_raw_bits,
        full=firmware.FULL_RATE,
        accel_bound=of_accel.bound,
        accel_full=firmware.FULL_FORCE,
    )
    pairs = [(accel, of_accel), (gyro, of_gyro)]
    lead = firmware.lead_of(calibration)
    if lead is not None:
        notes.append(finding("export.lag_removed", "info", lag_s=lead.lag_s, prefix=options.prefix))
    if gyro.warm_up_table is not None:
        over = gyro.warm_up_table.temp.stop
        notes.append(finding("export.warm_up_removed", "info", over_s=over, prefix=options.prefix))
    if gyro.at_rest is not None:
        notes.append(finding("export.at_rest", "info", prefix=options.prefix))
    if calibration.magnetometer is not None:
        notes.append(finding("export.magnetometer_apart", "info", prefix=options.prefix))
    texts = texts_of(losses(calibration, CARRIED), notes)
    source, sizes = _source(pairs, calibration, options, header_name, lead)
    costs = tuple(firmware.cost_of((accel, gyro), each, size, lead=lead is not None) for each, size in sizes.items())
    return ExportedC(
        header=_header(pairs, calibration, options, costs, texts["not_carried"] + texts["notes"], lead, date),
        source=source,
        costs=costs,
        gyro_bound=of_gyro.bound,
        accel_bound=of_accel.bound,
        **texts,
    )


def _triad_of(calibration: Calibration, options: ExportOptions, name: Sensor, notes: list[Finding]) -> Constants:
    """Return a triad, nominal where there is no model, with a note on that."""
    triad = firmware.triads_of(calibration)[SENSORS.index(name)]
    unit = options.gyro_unit if name == "gyro" else options.accel_unit
    if triad is not None and unit is not None:
        raise InputError(
            f"export c: wanted no unit of the {name}, whose model is for {triad.unit_in}, got {unit}; leave {name}_unit out",
            wanted=triad.unit_in,
            got=unit,
        )
    if triad is None:  # readings in a physical unit, made SI and left alone otherwise
        what, quantity = "gyroscopes" if name == "gyro" else "accelerometers", calibration.triad(name).quantity
        known = canonical_unit(unit or SI_UNIT[quantity], quantity)
        if not is_physical(known):
            raise InputError(
                f"export: wanted a physical unit of the {name}, which has no model, got {unit}; calibrate it, or name the unit "
                "that the firmware hands over"
            )
        triad = constants_of(calibration, name, known)
        notes.append(finding("export.nominal", "info", triad=what, name=name, unit=known))
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


def _axes(table: LookupTable | firmware.FixedTable, what: str = "") -> list[tuple[str, Any]]:
    return [
        ("since" if what == "warm_up_table" else "temp", table.temp),
        *([("rate", table.turn_rate)] if table.turn_rate is not None else []),
    ]


def _source(
    pairs: list[Pair], calibration: Calibration, options: ExportOptions, header_name: str, lead: firmware.Lead | None
) -> tuple[str, dict[firmware.Arithmetic, int]]:
    printer = Printer(options.prefix)
    tables = [table for triad, _ in pairs for _, table in firmware.named_tables(triad)]
    axes = [axis for table in tables for _, axis in _axes(table)]
    mag, fixed_mag = calibration.magnetometer, None
    if mag is not None:
        parts = ((mag.model.matrix, 24), (mag.model.offset, firmware.OUT_BITS), (mag.lag_s, 24))
        fixed_mag = [np.round(np.asarray(part) * 2.0**bits).astype(np.int64) for part, bits in parts]
    gyro, rule = pairs[1][0], (TURNING_ABOVE, TURNING_MEAN_S, TURNING_HOLD_S)
    text = _environment().get_template("undrift.c.j2").render(
        title=_title(calibration), header=header_name, p=options.prefix, P=options.prefix.upper(),
        triads=pairs, accel=pairs[0][0], gyro=gyro, at_rest=gyro.at_rest, turning=rule,
        fixed_at_rest=None if gyro.at_rest is None else np.round(gyro.at_rest * 2.0**firmware.OUT_BITS).astype(np.int64),
        fixed_turning=[round(x * 2.0**bits) for x, bits in zip(rule, (24, 20, 20), strict=True)],
        any_even=any(axis.even for axis in axes), any_search=any(not axis.even for axis in axes),
        any_line=any(table.turn_rate is None for table in tables),
        any_plane=any(table.turn_rate is not None for table in tables),
        tables_of=firmware.named_tables, ints=printer.ints, reals_of=printer.reals, axes_of=_axes, places=int,
        lead=lead, literal=literal, lookup=printer.lookup, mag=mag, fixed_mag=fixed_mag,
    )  # fmt: skip
    return re.sub(r"\n{3,}", "\n\n", text), printer.sizes


def _title(calibration: Calibration) -> str:
    return f"Correction of the inertial sensor {comment_text(calibration.device) or '(no serial number)'}"


def _header(
    pairs: list[Pair],
    calibration: Calibration,
    options: ExportOptions,
    costs: tuple[firmware.Cost, ...],
    notes: tuple[str, ...],
    lead: firmware.Lead | None,
    date: str,
) -> str:
    default = "fixed" if options.fixed else "double" if options.double else "float"
    warm = pairs[1][0].warm_up_table
    about = {
        "title": _title(calibration), "default": default, "date": date, "p": options.prefix,
        "P": options.prefix.upper(), "triads": pairs, "created": calibration.provenance.created, "lead": lead,
        "verdict": calibration.verdict.status, "costs": costs, "notes": notes, "assumption": firmware.ASSUMPTION, "span": _span,
        "lag_s": f"{lead.lag_s:g}" if lead else "", "smooth_s": f"{lead.smooth_s:g}" if lead else "",
        "warm_up": warm is not None, "warm_s": f"{warm.temp.stop:g}" if warm else "",
        "dps": RADIAN_PER_DEGREE, "g": STANDARD_GRAVITY, "moving": pairs[1][0].at_rest is not None,
        "mag": calibration.magnetometer is not None,
        "above": f"{TURNING_ABOVE / RADIAN_PER_DEGREE:g}", "held": f"{TURNING_HOLD_S:g}",
    }  # fmt: skip
    lines = _environment().get_template("comment.j2").render(about).splitlines()
    comment = [comment_text(part) for line in lines for part in wrapped(line)]
    return str(_environment().get_template("undrift.h.j2").render(about, comment=comment))


def _span(tables: list[LookupTable]) -> str:
    if not tables:
        return "without a table"
    low, high = max(t.temp.start for t in tables), min(t.temp.stop for t in tables)
    return f"{low:g} to {high:g} degC"


# ---- Target of ``undrift export``


def write_c(calibration: Calibration, options: ExportOptions, name: str) -> Exported:
    """Return header and source with their figures; the source includes the header by its name."""
    if not re.fullmatch(r"[\w.-]+", name, re.ASCII):
        raise InputError(
            f"{name}: wanted a file name of letters, digits, -, _ and . for a C header, got others; rename it"
        )
    made = export_c(calibration, options, header_name=name, date=datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"))
    cost_keys = ("arithmetic", "table_bytes", "flash_bytes", "cycles", "lead_cycles")
    bound = {"gyro_rad_s": float(made.gyro_bound.max()), "accel_m_s2": float(made.accel_bound.max())}
    builds = [{key: getattr(cost, key) for key in cost_keys} for cost in made.costs]
    texts = {key: getattr(made, key) for key in ("not_carried", "notes", "findings")}
    figures = {"builds": builds, "fixed_point_bound": bound}
    return Exported(text=made.header, more=(made.source,), figures=figures, **texts)


TARGET = Target(endings=(".h",), more=(".c",), write=write_c)
