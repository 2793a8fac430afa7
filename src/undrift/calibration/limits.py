"""What a session cannot tell by its kind, however well it was recorded, and which recording would: a remark each, no blame.

===============  ============================================  ==================================================
by               not told                                      told by
===============  ============================================  ==================================================
multi-position   how the sensors sit in the case               rests on six faces
six-face         whether the box is square                     free poses
multi-position   g-sensitivity of the gyroscopes               six faces and turns by known angles, or a rate table
known-rotation   whether the scale holds at other rates        a rate table
rate-table       g-sensitivity, without an accelerometer       its rests on six faces
any              offset and scale at other temperatures        a thermal session, ``undrift drift``
===============  ============================================  ==================================================

What it did not tell because of how it was recorded (faces or turns that are missing) the procedures say themselves.
"""

import numpy as np

from undrift.calibration.model import Verdict
from undrift.calibration.outcome import Outcome

CASE = (
    "how the sensors sit in the case was not told, the axes are the accelerometer's own: free poses show lengths alone; rests on "
    "six faces of the case show it"
)
FACES = (
    "accelerometer: its axes are those of the faces, and a box out of square counts as misaligned sensors; nine or more free poses "
    "tell the angles between the sensors without a box"
)
G_SENSITIVITY = (
    "gyroscope: its g-sensitivity was not told by moves between poses and is taken for nothing; rests on six faces with turns by "
    "known angles about x, y and z show it, or a rate table"
)
OTHER_RATES = "gyroscope: turns by known angles do not tell whether the scale holds at every rate; a rate table does"
NO_ACCEL = (
    "gyroscope: its g-sensitivity was not told, for want of an accelerometer's rests on six faces in the same session; "
    "record them"
)


def limits_of(accel: Outcome, gyro: Outcome, temp_c: float, *, thermal: bool) -> Verdict:
    """Return what the kind of a session leaves untold.

    Parameters
    ----------
    accel, gyro : Outcome
        What was fitted, and how.
    temp_c : float
        Mean temperature of what was used, degC; NaN where it is not known.
    thermal : bool
        The session is a thermal one, or other temperatures were set aside, which was said.

    Returns
    -------
    Verdict
        Good, with a remark for each limit.
    """
    said: list[str] = []
    if accel.fit is not None and accel.method == "multi-position":
        said.append(CASE)
    if accel.fit is not None and accel.method == "six-face":
        said.append(FACES)
    if gyro.fit is not None and gyro.method == "multi-position":
        said.append(G_SENSITIVITY)
    if gyro.fit is not None and gyro.method == "known-rotation":
        said.append(OTHER_RATES)
    if gyro.fit is not None and gyro.method == "rate-table" and accel.fit is None:
        told = any("g-sensitivity" in reason for reason in gyro.fit.verdict.reasons)
        said += [] if told else [NO_ACCEL]
    if not thermal:
        said.append(_temperature(temp_c))
    return Verdict(reasons=tuple(said))


def _temperature(temp_c: float) -> str:
    which = f"one temperature, {temp_c:.1f} degC" if np.isfinite(temp_c) else "one temperature, which was not recorded"
    return f"offset and scale were seen at {which}; at others a thermal session tells them, by undrift drift"
