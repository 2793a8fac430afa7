"""Whether a dwell may be kept: the table turned steadily, the device spoke and lay still, air and board kept their temperature.

With rate w, dwell T, time d in which a position may have been taken (the link's delay, or a tick) and a = angle_tolerance, a dwell
is refused unless

    |slope - w|           <= tolerance |w| + (a + 2 |w| d) / T
    |between ends - w|    <= tolerance |w| + 2 (a + |w| d) / T
    misfit                <= a                                    no stop, no jump: rig/rig.py
    2 d / T               <= link_tolerance, where w is not 0     else the link hides what the table does: read once more
    finite readings, air and board: at least least_part of them, and steady (check_readings, check_board, _look_at_air)

A rest is taken again where someone pushed the table or mounted the wrong face (`Disturbed`). With s the spread of a channel in the
first rests of this rig, and f the mean specific force of a face as read,

    largest spread of an eighth of the rest    <= STILL s               where s is not below half a step of the converter
    |f - f(other face)|                        >= APART s               else nobody mounted it
    |component of f(+k) - f(-k) along k|       >= cos 30 deg of it      and of f itself along k in a physical unit

A turn is taken again where it does not read as one, as when the device's readings come later than the link shows.
With m the mean of the gyroscopes over the dwell, m0 over the last rest, and from the rest the noise n of an eighth and e of m - m0,

    |mean of an eighth - m|     <= UNSTEADY |m - m0| + SHOWN n     else a part of it was read at another rate
    largest |m - m0| / e        >= SHOWN, for |w| >= SLOWEST       else it reads as at rest
    |m - m0 - g w|              <= UNLIKE |g w| + SHOWN e          g = (m - m0) / w of the other turns about this axis; at a rate
                                                                   beyond all of theirs it may be less: out of range

and a rest after turns unless |m - m0| <= UNLIKE of the largest that a turn reads.

In counts two faces that contradict each other do not tell which of them is wrong (`Contradiction`). A sound pair about another axis
does: its middle is what no acceleration reads, so that f less the middle lies along k for the face that is mounted as stated.
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError, RigFault, RigTimeout
from undrift.programme import Dwell
from undrift.record import Axis, Face, Record
from undrift.rig.rig import Achieved
from undrift.units import RADIAN_PER_DEGREE, is_physical

PARTS = 8  # of a dwell, for the board
COARSEST_C = 1.0  # step of a thermometer, K: more is a jump


@dataclass(frozen=True, slots=True, kw_only=True)
class RunSettings:
    """When a run gives up."""

    turn_rate_tolerance: float = 0.03  # Achieved against set rate, 1
    # A few counts: on top of it, over a dwell, and farthest from a steady turn, rad
    angle_tolerance: float = 0.05 * RADIAN_PER_DEGREE
    link_tolerance: float = 0.1  # Part of a rate that the link's delays may hide, 1
    least_part: float = 0.8  # Part of a dwell's readings that must come, 1
    soak_timeout_s: float = 6.0 * 3600.0  # Longest soak, table s
    # Time constant with which a device without thermometer follows the air, s; five of them are waited for
    device_lag_s: float = 120.0

    def __post_init__(self) -> None:
        if not self.device_lag_s >= 0.0:
            raise InputError(
                f"run: wanted a device lag of 0 s or more, got {self.device_lag_s}; state how late it follows the air"
            )


def link_hides(achieved: Achieved, settings: RunSettings) -> bool:
    """Return whether the positions came too late to determine how fast the table turned."""
    return 2.0 * achieved.delay_s > settings.link_tolerance * achieved.span_s


def check_rate(achieved: Achieved, held: float, settings: RunSettings, where: str) -> None:
    """Refuse a dwell in which the table did not hold its rate all the time."""
    off = settings.turn_rate_tolerance * abs(held)
    slip = settings.angle_tolerance / achieved.span_s
    late = 2.0 * abs(held) * achieved.delay_s / achieved.span_s
    found = ((achieved.turn_rate, off + slip + late), (achieved.between_ends, off + 2.0 * slip + late))
    for rate, allowed in found:
        if not abs(rate - held) <= allowed:
            raise RigFault(
                f"rig: wanted {held:.6g} rad/s held within {allowed:.2g} in {where}, got {rate:.6g}; look at the table, its "
                "amplifier and its encoder",
                turn_rate=rate,
            )
    if not achieved.misfit <= settings.angle_tolerance:
        raise RigFault(
            f"rig: wanted a steady turn within {settings.angle_tolerance / RADIAN_PER_DEGREE:.2g} deg in {where}, got "
            f"{achieved.misfit / RADIAN_PER_DEGREE:.2g} deg off a straight line; it stopped, jumped or was pushed: look "
            "at the table",
            misfit=achieved.misfit,
        )


def check_readings(record: Record, dwell_s: float, settings: RunSettings, where: str) -> int:
    """Refuse a dwell in which the device sent too little."""
    came = np.ones(len(record), bool)
    for values in (record.gyro, record.accel):
        if values is not None:
            came &= np.isfinite(values).all(axis=1)
    finite, rate = int(came.sum()), record.sample_rate_hz
    wanted = rate * max(dwell_s, record.duration_s)
    if finite < settings.least_part * wanted:
        raise RigTimeout(
            f"device: wanted {settings.least_part:.0%} of {wanted:.0f} readings in {where}, got {finite}, the others missing; look "
            "at the device and its link, then continue with `resume`",
            readings=finite,
        )
    return len(record) - finite


def check_board(record: Record, tolerance_c: float, where: str) -> None:
    """Refuse a dwell in which the device's own thermometer drifts or jumps; without one nothing is checked."""
    if record.temp_c is None:
        return
    temp_c = record.temp_c[np.isfinite(record.temp_c)]
    if len(temp_c) < 2:
        return
    middles = [float(np.median(part)) for part in np.array_split(temp_c, min(PARTS, len(temp_c)))]
    steps = np.diff(np.unique(temp_c))
    step_c = min(float(steps.min()), COARSEST_C) if len(steps) else 0.0
    change_c = max(middles) - min(middles)
    if change_c > tolerance_c + step_c:
        raise RigFault(
            f"device: wanted its thermometer steady within {tolerance_c:g} K throughout {where}, got a change of {change_c:.2f} K; "
            "look at the chamber and at the air around the device, then continue with `resume`",
            change_c=change_c,
        )


# ---- what the rig's own rests say about the next

STILL = 8.0  # spreads: an eighth of a rest that scatters more was disturbed
APART = 5.0  # spreads between two faces: less is the same face
SLANT = float(np.cos(np.radians(30.0)))
FIRST = 3  # rests that tell the rig's own spread


class Disturbed(RigFault):
    """A rest that someone disturbed or mounted wrongly: it is taken again."""


class Contradiction(Disturbed):
    """A rest that does not fit one that was kept, in counts: either of them may be the wrong one."""

    other: Face  # The one that was kept
    surely: bool  # Other faces show that it is that one


class RestCheck:
    """Remembers how still this rig's first rests were and what each face read."""

    def __init__(self) -> None:
        self._spreads: list[FloatArray] = []
        self._faces: dict[Face, FloatArray] = {}

    def check(self, step: Dwell, record: Record, where: str) -> None:
        """Refuse a rest that was not still, or a face that does not read as mounted."""
        if step.turn_rate != 0.0 or step.purpose == "turn":
            return
        parts = _spreads(record)
        usual = np.median([*self._spreads, np.median(parts, axis=0)], axis=0) + _half_steps(record)
        worst = float(np.nanmax(parts.max(axis=0) / np.where(usual > 0.0, usual, 1.0)))
        if worst > STILL:
            raise Disturbed(
                f"device: wanted it at rest in {where}, got {worst:.0f} times the spread of this rig's rests; nobody may touch the "
                "table while it is read: continue with `resume`",
                spread=worst,
            )
        if step.purpose == "face" and record.accel is not None:
            self._check_face(step.up, record.accel, record.accel_unit, APART * usual[-3:], where)

    def keep(self, step: Dwell, record: Record) -> None:
        """Remember a rest that was kept."""
        if step.turn_rate != 0.0 or step.purpose == "turn":
            return
        if len(self._spreads) < FIRST:
            self._spreads.append(np.median(_spreads(record), axis=0))
        if step.purpose == "face" and record.accel is not None:
            self._faces.setdefault(step.up, np.nanmean(record.accel, axis=0))

    def forget(self, face: Face) -> None:
        """Drop what a face read: it is taken again."""
        self._faces.pop(face, None)

    def _check_face(self, up: Face, accel: FloatArray, unit: str, apart: FloatArray, where: str) -> None:
        force, others = np.nanmean(accel, axis=0), {face: f for face, f in self._faces.items() if face != up}
        same = next((face for face, seen in others.items() if (np.abs(force - seen) <= apart).all()), None)
        against = next((face for face in others if face[1] == up[1]), None)
        if same is not None:
            got, other = f"the readings of {same}", same
        elif is_physical(unit):
            if _lies_along(up, force, signed=True):
                return
            got, other = "gravity along another axis", up
        elif against is not None and not _lies_along(up, force - others[against]):
            got, other = f"gravity along another axis than {against}", against
        else:
            return
        if is_physical(unit):
            raise Disturbed(f"device: wanted {up} up in {where}, got {got}; mount it again", up=up)
        middles = [
            0.5 * (others[plus] + others[minus])
            for plus, minus in (("+x", "-x"), ("+y", "-y"), ("+z", "-z"))
            if plus in others and minus in others and other not in (plus, minus)
        ]
        sound = [all(_lies_along(face, f - at) for at in middles) for face, f in ((up, force), (other, others[other]))]
        if middles and sound == [False, True]:
            raise Disturbed(f"device: wanted {up} up in {where}, got {got}; mount it again", up=up)
        raise Contradiction(
            f"device: wanted {up} up in {where}, got {got}; one of the two is not mounted as stated: mount both again, with "
            "--resume",
            other=other,
            surely=bool(middles) and sound == [True, False],
        )


UNSTEADY, UNLIKE = 0.1, 0.25  # of what a turn reads
SHOWN = 6.0  # standard errors
SLOWEST = 5.0 * RADIAN_PER_DEGREE  # rad/s: a slower turn may be less than a step of the converter


class TurnCheck:
    """Remembers what this device reads in turns about each axis, less what the last rest reads."""

    def __init__(self) -> None:
        self._rest: tuple[float | None, Record] | None = None  # the last one, with its set-point
        # Turn rate, and readings less those at rest (3,), by axis
        self._kept: dict[Axis | None, list[tuple[float, FloatArray]]] = {}

    def check(self, step: Dwell, turn_rate: float, record: Record, where: str) -> None:
        """Refuse a turn that does not read as one at its rate, and a rest that reads as a turn."""
        temp_c, last = self._rest or (None, None)
        if step.purpose == "turn" or last is None or last.gyro is None or record.gyro is None:
            return
        parts, rest = _part_means(record.gyro), _part_means(last.gyro)
        longer = max(1.0, len(last) / len(record))
        noise = np.sqrt(2.0 * longer * rest.var(axis=0) + len(parts) * _half_steps(last)[:3] ** 2 / 3.0)  # of a part
        error, shown = noise / np.sqrt(len(parts)), parts.mean(axis=0) - rest.mean(axis=0)
        steady = (UNSTEADY * np.abs(shown) + SHOWN * noise).max()
        if step.purpose != "rate":
            turns = [np.abs(each).max() for kept in self._kept.values() for _, each in kept]
            is_turn = step.temp_c == temp_c and np.abs(shown).max() > UNLIKE * max(turns, default=np.inf)
            got = "those of a turn" if is_turn else ""
        elif (np.abs(parts - parts.mean(axis=0)) > steady).any():
            got = "readings that change within it"
        elif abs(turn_rate) >= SLOWEST and (np.abs(shown) < SHOWN * error).all():
            got = "those of a rest"
        else:
            got = "those of another rate" if self._is_unlike(step.axis, turn_rate, shown, SHOWN * error.max()) else ""
        if got:
            raise Disturbed(
                f"device: wanted the readings of {where}, got {got}; look at the device's link and at what else this computer "
                "does, then continue with `resume`",
                turn_rate=turn_rate,
            )

    def keep(self, step: Dwell, turn_rate: float, record: Record) -> None:
        """Remember a turn or a rest that was kept."""
        if record.gyro is None or step.purpose == "turn":
            return
        if step.purpose != "rate":
            self._rest = step.temp_c, record
        elif self._rest is not None and self._rest[1].gyro is not None and abs(turn_rate) >= SLOWEST:
            shown = np.nanmean(record.gyro, axis=0) - np.nanmean(self._rest[1].gyro, axis=0)
            self._kept.setdefault(step.axis, []).append((turn_rate, shown))

    def _is_unlike(self, axis: Axis | None, turn_rate: float, shown: FloatArray, error: float) -> bool:
        if not (kept := self._kept.get(axis)):
            return False
        rates, others = np.array([rate for rate, _ in kept]), np.array([each for _, each in kept])
        alike = turn_rate * (rates @ others) / (rates @ rates)
        if np.abs(shown - alike).max() <= UNLIKE * np.abs(alike).max() + error:
            return False
        out_of_range = abs(turn_rate) > np.abs(rates).max() and shown @ alike > 0.0
        return not (out_of_range and np.linalg.norm(shown) >= (1.0 - UNLIKE) * np.linalg.norm(others, axis=1).max())


def _part_means(gyro: FloatArray) -> FloatArray:
    """Return the mean of each eighth of a dwell, (PARTS, 3); fewer where it has fewer readings."""
    finite = gyro[np.isfinite(gyro).all(axis=1)]
    return np.array([part.mean(axis=0) for part in np.array_split(finite, min(PARTS, len(finite)))])


def _lies_along(face: Face, force: FloatArray, *, signed: bool = False) -> bool:
    """Return whether a force lies along the axis of a face; in counts the sign of an axis is not known."""
    along = (1.0 if face[0] == "+" else -1.0) * float(force["xyz".index(face[1])])
    return (along if signed else abs(along)) >= SLANT * float(np.linalg.norm(force))


def _spreads(record: Record) -> FloatArray:
    """Return the standard deviation of every channel in each eighth of a rest, (PARTS, channels)."""
    held = np.column_stack([values for values in (record.gyro, record.accel) if values is not None])
    return np.array([np.nanstd(part, axis=0) for part in np.array_split(held, PARTS)])


def _half_steps(record: Record) -> FloatArray:
    """Return half the least step between readings of each channel; 0 where all are equal."""
    held = np.column_stack([values for values in (record.gyro, record.accel) if values is not None])
    steps = (np.diff(np.unique(column[np.isfinite(column)])) for column in held.T)
    return np.array([0.5 * float(step.min()) if len(step) else 0.0 for step in steps])
