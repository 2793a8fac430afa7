"""C text: literals, arrays, lookups in a table, and comments that nothing can break out of."""

import re
import textwrap

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.errors import InputError
from undrift.export.firmware import Axis
from undrift.export.fixed import FixedAxis

WIDTH = 116
SMALLEST, LARGEST = 1e-37, 3e38  # what a float literal may be


class Printer:
    """Prints arrays and lookups, and counts the bytes of the arrays.

    Parameters
    ----------
    prefix : str
        Begins every name.
    """

    def __init__(self, prefix: str) -> None:
        self.prefix, self.upper = prefix, prefix.upper()
        self.sizes = {"float": 0, "double": 0, "fixed": 0}

    def ints(self, kind: str, name: str, values: IntArray) -> str:
        """Return the definition of an array of integers.

        Parameters
        ----------
        kind : str
            int16_t, int32_t or uint32_t.
        name : str
            After the prefix.
        values : array of int
            Any shape; printed flat.

        Returns
        -------
        str
            C.
        """
        flat = [str(int(v)) for v in np.ravel(values)]
        self.sizes["fixed"] += len(flat) * (2 if kind == "int16_t" else 4)
        return self._array(kind, name, flat)

    def reals(self, name: str, values: FloatArray) -> str:
        """Return the definition of an array of floats or doubles, as the build has it.

        Parameters
        ----------
        name : str
            After the prefix.
        values : array
            Any shape and unit; printed flat.

        Returns
        -------
        str
            C.
        """
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
        """Return the lines that find a cell and a position in it, and mark what lies outside.

        Parameters
        ----------
        triad, table : str
            Begin the names of the axis' arrays.
        axis : FixedAxis
            The axis.
        x : str
            C expression that is looked up.
        place : str
            temp, rate or since.
        fraction : str
            C variable that takes the position.
        what : str
            TEMPERATURE or RATE: which mark to set; empty for none.
        cell : str
            C variable that takes the cell.

        Returns
        -------
        str
            C.
        """
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
        """Return the lines that find a cell and a position in it, and mark what lies outside.

        Parameters
        ----------
        triad, table : str
            Begin the names of the axis' arrays.
        axis : Axis
            The axis.
        x : str
            C expression that is looked up.
        place : str
            temp, rate or since.
        fraction : str
            C variable that takes the position.
        what : str
            TEMPERATURE or RATE: which mark to set; empty for none.
        cell : str
            C variable that takes the cell.

        Returns
        -------
        str
            C.
        """
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
    """Return a C literal that reads back to the last bit as a double, and that a float can be.

    Parameters
    ----------
    x : float
        Any unit; below 1e-37 it is zero.

    Returns
    -------
    str
        With a point or an exponent, without a suffix.

    Raises
    ------
    InputError
        Beyond what a float holds.
    """
    if abs(x) > LARGEST:
        raise InputError(f"export c: wanted numbers that float holds, got {x:g}; mend the calibration")
    text = repr(x if abs(x) >= SMALLEST else 0.0)
    return text if "." in text or "e" in text else text + ".0"


def comment_text(text: str) -> str:
    """Return text that cannot end a comment, continue a line or form a trigraph.

    Parameters
    ----------
    text : str
        Anything.

    Returns
    -------
    str
        Printable ASCII.
    """
    plain = re.sub(r"[^ -~]", "?", text).replace("\\", "/")
    plain = re.sub(r"\?{2,}", "?", plain)
    return plain.replace("*/", "* /").replace("/*", "/ *")


def wrapped(line: str) -> list[str]:
    """Return a line of a comment as lines that are not too long.

    Parameters
    ----------
    line : str
        One line.

    Returns
    -------
    list of str
        At least one.
    """
    return textwrap.wrap(line, WIDTH + 6, subsequent_indent="    ") or [""]
