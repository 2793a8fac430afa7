"""Targets of ``undrift export``: a name, and the object that writes the file.

    c            C source of the correction in float and double
    firmware     the constants of correction/plan.py on findable grids
    constants    matrix and offset at one temperature, as JSON and as a C header
    losses       what a target cannot carry, with figures

In goes a ``Calibration``, readings in the device's unit and frame b; out comes the text of a file whose numbers are in the units
that its program wants, rad/s and m/s2 for C. Open c first.

A target is one file that ends in ``TARGET = Target(endings=(".bin",), write=write)`` and one line in ``TARGETS``; another package
adds one through the entry-point group ``undrift.targets`` (see ``plugins.py``). ``write`` takes the calibration, the options of the
command line and the name of the file, and returns ``Exported``.
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
    "constants": "undrift.export.constants:TARGET",
}
GROUP = "undrift.targets"


@dataclass(frozen=True, kw_only=True)
class ExportOptions:
    """Options that some targets take.

    Parameters
    ----------
    double : bool
        c: double where the build defines nothing.
    prefix : str
        c: what every name begins with, in lower case.
    gyro_unit : str or None
        c: unit of the gyroscope readings where the calibration has no model of them; rad/s where not given.
    accel_unit : str or None
        c: the same of the accelerometer readings; m/s2 where not given.
    temp_c : float or None
        constants: temperature at which tables are read, degC; the reference temperature by default.
    """

    double: bool = False
    prefix: str = "undrift"
    gyro_unit: str | None = None
    accel_unit: str | None = None
    temp_c: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Target:
    """How a target's file is named and written."""

    endings: tuple[str, ...]  # of the file
    more: tuple[str, ...] = ()  # endings of the files beside it, as many as ``Exported.more``
    write: "Callable[[Calibration, ExportOptions, str], Exported]"  # takes the name of the file last


def find_target(name: str) -> Target:
    """Return the target of a name."""
    names = names_in(TARGETS, GROUP)
    if name not in names:
        raise InputError(f"target: wanted one of {', '.join(names)}, got '{name}'; name one of them")
    target = load_named(name, TARGETS, GROUP)
    if not isinstance(target, Target):
        raise InputError(f"{name}: wanted a Target of undrift.export, got {target!r}; mend the package that has it")
    return target
