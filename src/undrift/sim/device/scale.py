"""Scale, cross-axis and misalignment: ``y = (I + X) diag(1 + s) E x``, E the sensors' unit vectors in b, one a row.

y is in nominal input units: what the nominal sensitivity would make of the output.
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError
from undrift.sim.device.fields import quantity, settle


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scale:
    """How motion becomes output.

    Parameters
    ----------
    nominal_sensitivity : float
        What the data sheet says, output unit per rad/s or m/s2.
    error : array, shape (3,)
        Relative error of each sensor's sensitivity.
    axes : array, shape (3, 3)
        Unit vector of each sensor in b, one a row.
    cross_axis : array, shape (3, 3)
        Crosstalk between the channels, relative; row i receives, column j gives.
    """

    nominal_sensitivity: float = quantity("{out}_per_{x}")
    error: FloatArray = quantity("", (3,), 0.0)
    axes: FloatArray = quantity("", (3, 3), ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)))
    cross_axis: FloatArray = quantity("", (3, 3), 0.0)

    def __post_init__(self) -> None:
        settle(self)
        length = np.linalg.norm(self.axes, axis=1)
        if (np.abs(length - 1.0) > 1e-9).any():
            raise InputError(
                f"scale: wanted unit vectors as axes, got lengths {np.array2string(length, precision=4)}; "
                "put the gain into the scale error"
            )
        if self.nominal_sensitivity <= 0.0:
            raise InputError(
                f"scale: wanted a nominal sensitivity above 0, got {self.nominal_sensitivity:g}; turn axes for a sign"
            )

    @property
    def matrix(self) -> FloatArray:
        """(I + X) diag(1 + s) E, shape (3, 3)."""
        matrix: FloatArray = (np.eye(3) + self.cross_axis) @ ((1.0 + self.error)[:, None] * self.axes)
        return matrix


def scaled(x: FloatArray, effect: Scale, extra: FloatArray | None = None) -> FloatArray:
    """Return what the channels make of a motion.

    Parameters
    ----------
    x : array, shape (N, 3)
        Rate or specific force, frame b.
    effect : Scale
        The sensors.
    extra : array, shape (N, 3, 3), optional
        What each sensor feels beside it: sample, sensor, axis of b.

    Returns
    -------
    array, shape (N, 3)
        Nominal input units, one channel a column.
    """
    if extra is None:
        return np.asarray(x @ effect.matrix.T)
    along = x @ effect.axes.T + np.einsum("ij,nij->ni", effect.axes, extra)
    return np.asarray((along * (1.0 + effect.error)) @ (np.eye(3) + effect.cross_axis).T)
