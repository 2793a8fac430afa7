"""g-sensitivity: specific force feigns a rate: ``y = x + G f``."""

from dataclasses import dataclass

from undrift.arrays import FloatArray
from undrift.sim.device.fields import quantity, settle
from undrift.sim.device.scene import Scene


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GSensitivity:
    """What a gyroscope makes of specific force.

    Parameters
    ----------
    matrix : array, shape (3, 3)
        Rate feigned, rad/s per m/s2: row i for sensor i, columns x, y, z of b.
    """

    matrix: FloatArray = quantity("{x}_per_m_s2", (3, 3))

    def __post_init__(self) -> None:
        settle(self)


def with_g(x: FloatArray, effect: GSensitivity, scene: Scene) -> FloatArray:
    """Return a signal with what specific force feigns.

    Parameters
    ----------
    x : array, shape (N, 3)
        Nominal input units.
    effect : GSensitivity
        Its matrix.
    scene : Scene
        With the specific force.

    Returns
    -------
    array, shape (N, 3)
        Nominal input units.
    """
    feigned: FloatArray = x + scene.force_b @ effect.matrix.T
    return feigned
