"""Settings that a GRBL controller stores: ``$100`` and its neighbours steps per degree, ``$110`` rate, ``$120`` acceleration."""

from undrift.errors import LinkError
from undrift.rig.grbl.controller import GrblController

AXES = "XYZABC"
STEPS, RATE, ACCELERATION = 100, 110, 120  # of the first axis: steps/deg, deg/min, deg/s2


def stored(grbl: GrblController, first: int, axis: str) -> tuple[int, float]:
    """Return a setting of an axis.

    Parameters
    ----------
    grbl : GrblController
        Where it is stored.
    first : int
        Number of the first axis' setting: STEPS, RATE or ACCELERATION.
    axis : str
        X, Y, Z, A, B or C.

    Returns
    -------
    number : int
        The axis' own, or the first's on a controller that lists one axis only.
    value : float
        steps/deg, deg/min or deg/s2.

    Raises
    ------
    LinkError
        None is listed, or one that is not above zero.
    """
    listed = dict(line.removeprefix("$").split("=", 1) for line in grbl.do("$$") if line.startswith("$"))
    own = first + AXES.index(axis)
    number = own if str(own) in listed else first
    text = listed.get(str(number), "nothing").split(" ")[0]
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value < 1e9:
        raise LinkError(
            f"{grbl.name}: wanted ${number} above 0, got {text}; set it on the controller, check cable and baud"
        )
    return number, value


def store_acceleration(grbl: GrblController, axis: str, acceleration_dps2: float) -> float:
    """Store the run-up of an axis.

    Parameters
    ----------
    grbl : GrblController
        Idle.
    axis : str
        X, Y, Z, A, B or C.
    acceleration_dps2 : float
        deg/s2; thousandths count.

    Returns
    -------
    float
        As the controller lists it, deg/s2.

    Raises
    ------
    LinkError
        It lists something else.
    """
    number, _ = stored(grbl, ACCELERATION, axis)
    grbl.do(f"${number}={acceleration_dps2:.3f}")
    _, held = stored(grbl, ACCELERATION, axis)
    if abs(held - acceleration_dps2) > 1e-3:
        raise LinkError(f"{grbl.name}: wanted ${number}={acceleration_dps2:.3f}, got {held:g}; check cable and baud")
    return held
