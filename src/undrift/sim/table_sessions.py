"""Sessions on a rate table that errs: a programme laid out in time, and what is truly imposed while it runs.

For a dwell at the commanded rate w about the axis e of the case, at a set-point T_s, t after the readings in it began::

    rate        w + servo / duration               about   a = e turned by the mounting, then by the wobble of this dwell
    read rate   counts of the encoder over the dwell, times 1 - table_rate
    force       g (a + level (c a' + s a''))       c, s the means of cosine and sine of the azimuth over the dwell
    temperature T_s + soak - left exp(-t / lag),   left = lag times the slope at which the soak counted as reached

The device is mounted once for each axis and swept through the set-points; a table has one level and one clock.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import lru_cache

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.errors import InputError
from undrift.record import FACES
from undrift.rig.programme import DAMPING, LEAST_SETTLE_S, Dwell, Protocol, programme_of, settle_time
from undrift.sim.bench_errors import BenchDraws, BenchErrors
from undrift.sim.device.dwells import Dwells
from undrift.sim.motion.motion import unit_vector
from undrift.units import STANDARD_GRAVITY

WARMED_UP_S = 1800.0  # the bench waits half an hour after power-on
ROOM_TEMP_C = 25.0
FACE, REST, RATE = 0, 1, 2
QUICKEST_HZ = 1e9  # a cut-off frequency with the shortest settling


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sessions:
    """What sessions do, N dwells of S sessions one after the other."""

    kind: IntArray  # (N,), FACE, REST or RATE
    axis: IntArray  # (N,), of the case, 0 to 2: that points up, and that the table turns about
    face: IntArray  # (N,), which of FACES points up
    rate: FloatArray  # (N,), commanded about +axis, rad/s
    soak: IntArray  # (N,), which set-point
    set_c: FloatArray  # (N,), of the chamber, or the room's, degC
    start_s: FloatArray  # (N,), of the readings, s since power-on
    duration_s: FloatArray  # (N,), of the readings, s
    first: IntArray  # (S + 1,), first dwell of each session, and N
    length_s: FloatArray  # (S,), of each session on the rig, s

    def settling(self, cutoff_hz: float, damping: float = DAMPING) -> "Sessions":
        """Return one session that was laid out for the shortest settling, as it is with a low-pass."""
        more = (settle_time(cutoff_hz, damping) - LEAST_SETTLE_S) * np.arange(1, len(self.kind) + 1)
        return replace(self, start_s=self.start_s + more, length_s=self.length_s + more[-1])

    def chosen(self, *kinds: int) -> "Sessions":
        """Return the dwells of some kinds."""
        kept = np.isin(self.kind, kinds)
        rows = {f.name: getattr(self, f.name)[kept] for f in fields(self)[:-2]}
        return replace(self, **rows, first=np.concatenate(([0], np.cumsum(kept)))[self.first])


@lru_cache(maxsize=256)
def lay_out(protocol: Protocol) -> Sessions:
    """Lay out the session of a protocol, with the shortest settling."""
    if protocol.turn_rate_step <= 0.0:
        raise InputError("study: wanted a protocol with rates, got none; state turn_rate_step and the two ends")
    protocol = replace(protocol, cutoff_hz=QUICKEST_HZ)
    steps = [*programme_of(replace(protocol, faces=())).steps]
    if protocol.faces:
        steps = [*programme_of(replace(protocol, turn_rate_step=0.0, temperatures_c=())).steps, *steps]
    dwells: list[Dwell] = []
    starts, clock = [], WARMED_UP_S
    for step in steps:
        if isinstance(step, Dwell):
            dwells.append(step)
            starts.append(clock + step.ramp_s + step.settle_s)
        clock += step.duration_s
    kinds = {"face": FACE, "bracket": REST, "rate": RATE}
    set_c = np.array([ROOM_TEMP_C if dwell.temp_c is None else dwell.temp_c for dwell in dwells])
    kind = np.array([kinds[dwell.purpose] for dwell in dwells])
    return Sessions(
        kind=kind,
        axis=np.array(["xyz".index(dwell.up[1]) for dwell in dwells]),
        face=np.array([FACES.index(dwell.up) for dwell in dwells]),
        rate=np.array([dwell.turn_rate for dwell in dwells]),
        soak=np.where(kind == FACE, 0, np.searchsorted(protocol.temperatures_c or (ROOM_TEMP_C,), set_c)),
        set_c=set_c,
        start_s=np.array(starts),
        duration_s=np.array([dwell.dwell_s for dwell in dwells]),
        first=np.array([0, len(dwells)]),
        length_s=np.array([clock - WARMED_UP_S]),
    )


def joined(sessions: Sequence[Sessions]) -> Sessions:
    """Return sessions one after the other."""
    rows = {f.name: np.concatenate([getattr(one, f.name) for one in sessions]) for f in fields(Sessions)}
    rows["first"] = np.concatenate(([0], np.cumsum([len(one.kind) for one in sessions])))
    return Sessions(**rows)


def impose(
    sessions: Sessions, errors: BenchErrors, draws: BenchDraws, row: IntArray, *, soak_c_per_min: float
) -> tuple[Dwells, FloatArray]:
    """Return what is truly imposed by rests and rates, and the rates that the encoder reads, (N,) rad/s; row (N,) of the draws."""
    axis, length = sessions.axis, sessions.duration_s
    seat = _turned(np.eye(3), errors.mount_tilt * draws.mount)
    about = _turned(seat[axis], errors.wobble * draws.wobble[row])
    rate = sessions.rate + np.where(sessions.kind == RATE, errors.servo * draws.servo[row] / length, 0.0)
    angle, phase, azimuth = rate * length, draws.start[row, 0], 2.0 * np.pi * draws.start[row, 1]
    if errors.encoder_lines:
        count = 2.0 * np.pi / (4.0 * errors.encoder_lines)
        angle = (np.floor(phase + angle / count) - np.floor(phase)) * count
    middle, mean = azimuth + 0.5 * rate * length, np.sinc(rate * length / (2.0 * np.pi))
    tilt = errors.level * float(np.hypot(*draws.level))
    across = np.cos(middle)[:, None] * np.eye(3)[axis - 2] + np.sin(middle)[:, None] * np.eye(3)[axis - 1]
    since, lag = _since(sessions), errors.board_lag_s
    visited = axis, sessions.soak
    temp_c = sessions.set_c + errors.soak_k * draws.soak[visited]
    if lag > 0.0:  # rising but from the last set-point of one mounting to the first of the next
        falls = np.where((sessions.soak == 0) & (axis > 0), -1.0, 1.0)
        temp_c = temp_c - falls * draws.left[visited] * (soak_c_per_min / 60.0 * lag) * np.exp(-since / lag)
    dwells = Dwells(
        start_s=sessions.start_s,
        duration_s=length,
        rate_b=rate[:, None] * about,
        force_b=STANDARD_GRAVITY * (seat[axis] + tilt * mean[:, None] * across),
        temp_c=temp_c,
        first=sessions.first,
    )
    return dwells, angle / length * (1.0 - errors.table_rate * draws.clock)


def impose_faces(sessions: Sessions, errors: BenchErrors, draws: BenchDraws) -> Dwells:
    """Return what is truly imposed by rests on faces."""
    up = _turned(
        np.array([unit_vector(FACES[face]) for face in sessions.face]), errors.face_tilt * draws.face[sessions.face]
    )
    return Dwells(
        start_s=sessions.start_s,
        duration_s=sessions.duration_s,
        rate_b=np.zeros_like(up),
        force_b=STANDARD_GRAVITY * up,
        temp_c=sessions.set_c,
        first=sessions.first,
    )


def _turned(axis_b: FloatArray, tilt: FloatArray) -> FloatArray:
    """Return unit vectors turned by small rotations, (N, 3)."""
    off = axis_b + np.cross(tilt, axis_b)
    return np.asarray(off / np.linalg.norm(off, axis=1, keepdims=True))


def _since(sessions: Sessions) -> FloatArray:
    """Return the time since the first reading of the same axis and soak, (N,) s."""
    visit, n = 1000 * sessions.axis + sessions.soak, len(sessions.axis)
    begins = np.concatenate(([True], visit[1:] != visit[:-1]))
    begins[sessions.first[:-1]] = True
    return np.asarray(sessions.start_s - sessions.start_s[np.maximum.accumulate(np.where(begins, np.arange(n), 0))])
