"""Targets of ``undrift export``, each with a name and a function that writes the file.

    c            C source of the correction in float and double
    arduino      a library folder with the same source and a sketch
    firmware     constants of correction/plan.py with tables that firmware can look up quickly
    constants    matrix and offset at one temperature, as JSON and as a C header
    losses       parts of a calibration that a target does not contain, with numbers

Input: a ``Calibration``, for readings in the device's unit and frame b. Output: the text of a file with numbers in the units of the
receiving program, rad/s and m/s2 for C. Open c first.

A target is a module with ``TARGET = Target(endings=(".bin",), write=write)`` and a row in ``TARGETS``. Another package
can add a target with the entry-point group ``undrift.targets`` (see ``plugins.py``). ``write`` takes the calibration,
the options of the command line and the name of the file, and returns ``Exported``.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from undrift.errors import InputError
from undrift.plugins import load_named, names_in

if TYPE_CHECKING:
    from undrift.export.losses import Exported
    from undrift.model import Calibration

TARGETS = {
    "c": "undrift.export.c:TARGET",
    "arduino": "undrift.export.arduino:TARGET",
    "constants": "undrift.export.constants:TARGET",
}
GROUP = "undrift.targets"


@dataclass(frozen=True, kw_only=True)
class ExportOptions:
    """Options of the targets.

    Parameters
    ----------
    prefix : str
        c: prefix of all names, in lower case.
    gyro_unit : str or None
        c: unit of the gyroscope readings if the calibration has no gyroscope model, rad/s by default.
    accel_unit : str or None
        c: unit of the accelerometer readings if the calibration has no accelerometer model, m/s2 by default.
    temp_c : float or None
        constants: temperature at which tables are read, degC, the reference temperature by default.
    """

    prefix: str = "undrift"
    gyro_unit: str | None = None
    accel_unit: str | None = None
    temp_c: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Target:
    """File endings and write function of a target."""

    endings: tuple[str, ...] = ()  # endings of the file
    folder: bool = False  # the output is a folder with the files of ``Exported.tree``
    more: tuple[str, ...] = ()  # endings of the further files, as many as ``Exported.more``
    write: "Callable[[Calibration, ExportOptions, str], Exported]"  # the last argument is the name of the file


def find_target(name: str) -> Target:
    """Return the target with a name."""
    names = names_in(TARGETS, GROUP)
    if name not in names:
        raise InputError(f"target: unknown target '{name}'. Use one of {', '.join(names)}.")
    target = load_named(name, TARGETS, GROUP)
    if not isinstance(target, Target):
        raise InputError(
            f"{name}: expected a Target of undrift.export, got {target!r}. Correct the package that adds it."
        )
    return target
