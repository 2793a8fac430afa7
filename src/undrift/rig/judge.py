"""Accept or reject a dwell: check for a steady turn, complete readings, a device at rest if planned, and steady temperature of air
and board.

Let w be the turn rate, T the dwell and d the time uncertainty of a position (the link's delay). With a =
ANGLE_TOLERANCE, a dwell is accepted if

    |slope - w|           <= TURN_RATE_TOLERANCE |w| + (a + 2 |w| d) / T
    |between ends - w|    <= TURN_RATE_TOLERANCE |w| + 2 (a + |w| d) / T
    misfit                <= a                                    no stop and no jump (rig/rig.py)
    2 d / T               <= LINK_TOLERANCE, if w is not 0        otherwise the delays hide the motion, and the dwell is repeated
    finite readings, air and board: at least LEAST_PART of them, and steady (check_readings, check_board)

A rest is repeated if the table was pushed or the wrong face was mounted (`Disturbed`). Let s be the spread of a channel in the
first rests of this rig, and f the mean specific force of a face.

    largest spread of an eighth of the rest    <= STILL s               with s of at least half a step of the converter
    |f - f(other face)|                        >= APART s               otherwise the face was not changed
    |component of f(+k) - f(-k) along k|       >= cos 30 deg of it      and of f itself along k in a physical unit

If readings are in counts, an earlier face may have been mounted wrongly. The message names this face.
"""

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import RigFault, RigTimeout
from undrift.programme import Dwell
from undrift.record import Face, Record
from undrift.rig.rig import Achieved
from undrift.units import RADIAN_PER_DEGREE, is_physical

PARTS = 8  # number of parts of a dwell
COARSEST_C = 1.0  # largest resolution step of a thermometer, K (a larger step is a jump)
TURN_RATE_TOLERANCE = 0.03  # relative tolerance of the achieved rate, 1
# additional tolerance of a few counts over a dwell, also the largest deviation from a steady turn, rad
ANGLE_TOLERANCE = 0.05 * RADIAN_PER_DEGREE
LINK_TOLERANCE = 0.1  # largest fraction of a rate that the link's delays may hide, 1
LEAST_PART = 0.8  # smallest fraction of a dwell's readings that must arrive, 1


def check_delays(achieved: Achieved, late_s: float, where: str) -> None:
    """Raise RigTimeout if the delays of the positions hide the turn rate, or if the dwell ended after the steady turn."""
    if late_s > 0.0 or 2.0 * achieved.delay_s > LINK_TOLERANCE * achieved.span_s:
        raise RigTimeout(
            f"rig: times of positions must be known to {LINK_TOLERANCE:.0%} of the dwell in {where}, got delays of "
            f"{achieved.delay_s:.3g} s in {achieved.span_s:.3g} s. Check the link and the load of this computer, or use longer "
            "dwells. Then continue with `resume`.",
            delay_s=achieved.delay_s,
        )


def check_rate(achieved: Achieved, set_rate: float, where: str) -> None:
    """Raise RigFault if the table did not turn steadily at its rate in a dwell."""
    off = TURN_RATE_TOLERANCE * abs(set_rate)
    slip = ANGLE_TOLERANCE / achieved.span_s
    late = 2.0 * abs(set_rate) * achieved.delay_s / achieved.span_s
    rates = ((achieved.turn_rate, off + slip + late), (achieved.between_ends, off + 2.0 * slip + late))
    for rate, allowed in rates:
        if not abs(rate - set_rate) <= allowed:
            raise RigFault(
                f"rig: expected {set_rate:.6g} rad/s within {allowed:.2g} in {where}, got {rate:.6g}. Check the table, its "
                "amplifier and its encoder.",
                turn_rate=rate,
            )
    if not achieved.misfit <= ANGLE_TOLERANCE:
        raise RigFault(
            f"rig: expected a steady turn within {ANGLE_TOLERANCE / RADIAN_PER_DEGREE:.2g} deg in {where}, got a "
            f"deviation of {achieved.misfit / RADIAN_PER_DEGREE:.2g} deg. The table stopped, jumped or was pushed. Check it.",
            misfit=achieved.misfit,
        )


def check_readings(record: Record, dwell_s: float, where: str) -> int:
    """Return the number of missing readings. Raise RigTimeout if too many are missing."""
    finite = int(np.isfinite(_channels(record)).all(axis=1).sum())
    expected = record.sample_rate_hz * max(dwell_s, record.duration_s)
    if finite < LEAST_PART * expected:
        raise RigTimeout(
            f"device: expected at least {LEAST_PART:.0%} of {expected:.0f} readings in {where}, got {finite}. Check the "
            "device and its link, then continue with `resume`.",
            readings=finite,
        )
    return len(record) - finite


def check_board(record: Record, tolerance_c: float, where: str) -> None:
    """Raise RigFault if the device's thermometer drifts or jumps in a dwell. Without a thermometer, nothing is checked."""
    if record.temp_c is None:
        return
    temp_c = record.temp_c[np.isfinite(record.temp_c)]
    if len(temp_c) < 2:
        return
    middles = [float(np.median(chunk)) for chunk in np.array_split(temp_c, min(PARTS, len(temp_c)))]
    steps = np.diff(np.unique(temp_c))
    step_c = min(float(steps.min()), COARSEST_C) if len(steps) else 0.0
    change_c = max(middles) - min(middles)
    if change_c > tolerance_c + step_c:
        raise RigFault(
            f"device: its temperature must be steady within {tolerance_c:g} K in {where}, got a change of {change_c:.2f} K. "
            "Check the chamber and the air around the device, then continue with `resume`.",
            change_c=change_c,
        )


# ---- Comparison of a rest with earlier rests of the rig.

STILL = 8.0  # largest spread of an eighth of a rest, relative to the usual spread
APART = 5.0  # smallest distance between two faces, in spreads
SLANT = float(np.cos(np.radians(30.0)))
FIRST = 3  # number of rests that determine the usual spread


class Disturbed(RigFault):
    """A rest that was disturbed or mounted wrongly and must be repeated."""


class RestCheck:
    """Check of rests, which stores the spreads of the first rests and the mean readings of each face."""

    def __init__(self) -> None:
        self._spreads: list[FloatArray] = []
        self._faces: dict[Face, FloatArray] = {}
        self._files: dict[Face, str] = {}  # file of each face in the run folder

    def check(self, step: Dwell, record: Record, where: str) -> None:
        """Raise Disturbed for a rest that was not still, or a face that was not mounted as planned."""
        if step.turn_rate != 0.0 or step.purpose == "turn":
            return
        parts = _spreads(record)
        usual = np.median([*self._spreads, np.median(parts, axis=0)], axis=0) + _half_steps(record)
        worst = float(np.nanmax(parts.max(axis=0) / np.where(usual > 0.0, usual, 1.0)))
        if worst > STILL:
            raise Disturbed(
                f"device: not at rest in {where}, got {worst:.0f} times the spread of this rig's rests. Do not touch the table "
                "during a rest. Continue with `resume`.",
                spread=worst,
            )
        if step.purpose == "face" and record.accel is not None:
            self._check_face(step.up, record.accel, record.accel_unit, APART * usual[-3:], where)

    def keep(self, step: Dwell, record: Record, file: str = "") -> None:
        """Store an accepted rest."""
        if step.turn_rate != 0.0 or step.purpose == "turn":
            return
        if len(self._spreads) < FIRST:
            self._spreads.append(np.median(_spreads(record), axis=0))
        if step.purpose == "face" and record.accel is not None and step.up not in self._faces:
            self._faces[step.up], self._files[step.up] = np.nanmean(record.accel, axis=0), file

    def _check_face(self, up: Face, accel: FloatArray, unit: str, distance: FloatArray, where: str) -> None:
        """Raise Disturbed if the readings belong to another face, or if gravity is not along the axis of the face."""
        force = np.nanmean(accel, axis=0)
        others = {face: other for face, other in self._faces.items() if face != up}
        same = next((face for face, other in others.items() if (np.abs(force - other) <= distance).all()), None)
        opposite = next((face for face in others if face[1] == up[1]), None)
        advice = "Mount it again"
        if same is not None:
            reason = f"the readings of {same}"
        elif is_physical(unit) and not _is_along(up, force, signed=True):
            reason = "gravity along another axis"
        elif not is_physical(unit) and opposite is not None and not _is_along(up, force - others[opposite]):
            reason = f"gravity along another axis than {opposite}"
        else:
            return
        if not is_physical(unit) and (earlier := same or opposite):
            advice += f". If {earlier} was mounted wrongly, delete {self._files[earlier]} and continue with `resume`"
        raise Disturbed(f"device: {up} must be up in {where}, got {reason}. {advice}.", up=up)


def _is_along(face: Face, force: FloatArray, *, signed: bool = False) -> bool:
    """Return True if a force is along the axis of a face. `signed` also compares the sign, which is unknown in counts."""
    along = (1.0 if face[0] == "+" else -1.0) * float(force["xyz".index(face[1])])
    return (along if signed else abs(along)) >= SLANT * float(np.linalg.norm(force))


def _channels(record: Record) -> FloatArray:
    """Return the readings of both triads, (N, channels)."""
    return np.column_stack([values for values in (record.gyro, record.accel) if values is not None])


def _spreads(record: Record) -> FloatArray:
    """Return the standard deviation of every channel in each eighth of a rest, (PARTS, channels)."""
    return np.array([np.nanstd(eighth, axis=0) for eighth in np.array_split(_channels(record), PARTS)])


def _half_steps(record: Record) -> FloatArray:
    """Return half the smallest step between readings of each channel, or 0 if all readings are equal."""
    steps = (np.diff(np.unique(column[np.isfinite(column)])) for column in _channels(record).T)
    return np.array([0.5 * float(step.min()) if len(step) else 0.0 for step in steps])
