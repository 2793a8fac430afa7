"""How far motion has shown each element of a device, and the movement that shows the one that is known least.

::

    2 u(e) <= limit of e       P % of scale factors and cross-axis terms, P % of gravity of the accelerometers' offset,
                               P / 10 deg/s of the gyroscopes' offset, 2 P % and 2 P uT of the magnetometer

u(e) is the standard uncertainty that the fit states. What a prior knows well enough needs no movement.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.element_prior import ELEMENTS
from undrift.calibration.in_motion import InMotion
from undrift.model import AXES, Calibration, TriadModel
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

ENOUGH_PERCENT = 0.5
_PAIRS = ("y-z", "x-z", "x-y")
_TURN = "level its {} axis and turn it about that axis, half a turn to and fro, for ten seconds"
_HOLD = "hold its {} axis up for five seconds, then down"
_ALL = "turn it slowly about every axis, away from iron, for ten seconds"


class _ElementGroup(NamedTuple):
    """Three elements of a kind."""

    name: str
    unit: str
    limit: float  # Of one percent wanted
    movement: str
    axes: tuple[str, ...] = AXES


_GROUPS = (
    _ElementGroup("gyroscope scale", "%", 1.0, _TURN),
    _ElementGroup("gyroscope cross-axis", "%", 1.0, _TURN.replace("its {} axis", "a line between its {} axes"), _PAIRS),
    _ElementGroup("gyroscope offset", "deg/s", 0.1, "lay it down and leave it at rest for five seconds"),
    _ElementGroup("accelerometer scale", "%", 1.0, _HOLD),
    _ElementGroup("accelerometer cross-axis", "%", 1.0, _HOLD.replace("its {} axis", "both its {} axes"), _PAIRS),
    _ElementGroup("accelerometer offset", "m/s2", 0.01 * STANDARD_GRAVITY, _HOLD),
    _ElementGroup("magnetometer axes", "%", 2.0, _ALL),
    _ElementGroup("magnetometer hard iron", "uT", 2.0, _ALL),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class ElementKnown:
    """One element: how far it is known, and how far that is wanted, expanded uncertainty, 95 %."""

    name: str  # gyroscope scale, ...
    axis: str
    uncertainty: float
    wanted: float
    unit: str
    movement: str  # That shows it

    @property
    def enough(self) -> bool:
        """Whether it is known as far as is wanted."""
        return self.uncertainty <= self.wanted


def elements_known(
    calibration: Calibration, fit: InMotion, percent: float = ENOUGH_PERCENT
) -> tuple[ElementKnown, ...]:
    """Return the elements of a calibration from motion, by groups of three."""
    return tuple(
        ElementKnown(
            name=group.name, axis=axis, uncertainty=2.0 * float(spread), wanted=percent * group.limit, unit=group.unit,
            movement=group.movement.format(axis.replace("-", " and ")),
        )
        for group, spreads in zip(_GROUPS, _spreads(calibration, fit), strict=False)
        for axis, spread in zip(group.axes, spreads, strict=True)
    )  # fmt: skip


def _spreads(calibration: Calibration, fit: InMotion) -> Iterator[FloatArray]:
    """Yield standard uncertainties (3,) of each group; the gyroscopes' offset is that of the newest recording."""
    per_rate, per_force = fit.units
    yield from _of_matrix(fit.gyro.model)
    yield fit.offset_uncertainty[-1] * per_rate / RADIAN_PER_DEGREE
    yield from _of_matrix(fit.accel.model)
    yield fit.accel.model.standard_uncertainty[9:] * per_force
    if calibration.magnetometer is not None:
        spread = calibration.magnetometer.model.standard_uncertainty
        yield 100.0 * np.linalg.norm(spread[:9].reshape(3, 3), axis=1)
        yield spread[9:]


def _of_matrix(triad: TriadModel) -> tuple[FloatArray, FloatArray]:
    """Return what scale factors and symmetric cross-axis terms are known to, % of the scale."""
    kinds = ELEMENTS[:6, :9]
    spread = np.sqrt(np.diag(kinds @ triad.covariance[:9, :9] @ kinds.T)) * 300.0 / np.trace(triad.matrix)
    return spread[:3], spread[3:]
