"""Mounting: how a device is worn, from its case axes b to the axes a of the segment that wears it.

Axes a: x forward, y left, z up, when the wearer stands upright. ``R_ab`` maps b to a: its rows are forward, left and up seen in b.

``up``       the vertical seen in b while the wearer stands still: the mean over the longest such stretch
``forward``  by walking: as a person leaves a posture, or takes one, the horizontal acceleration summed from rest is the velocity,
             and its mean over a stride points forward. Strides that go on show it at the low back. A body that rises over its leg
             slows down, and speeds up as it falls: with horizontal acceleration a_h and vertical speed v, 0.7 to 5 Hz, ::

                 -sum a_h v                       points forward; what left and right steps do sideways cancels

             By a named movement: the vertical seen in b leaves ``up`` to the back of a segment that leans forward.

Each comes in pieces (postures, strides, repetitions), whose scatter is the uncertainty of their mean; what all pieces share,
because people are no machines, is added (``STANCE``, ``CUES``). Cues are averaged by their variances.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from undrift.arrays import BoolArray, FloatArray, runs
from undrift.correction.consistency import check_triads
from undrift.errors import Implausible, InputError
from undrift.findings import Finding, Verdict, finding
from undrift.frames import integrate_strapdown, quaternion_conjugate, rotate
from undrift.model import AXES, BodyMounting
from undrift.orientation import check_whole, filtered, initial_tilt, shortest_rotation_up
from undrift.record import Record, Still
from undrift.segments import unpadded
from undrift.units import RADIAN_PER_DEGREE as DEG

Worn = Literal["lower-back", "thigh", "shank", "foot", "wrist"]
Posture = Literal["standing", "sitting"]
Movement = Literal["walk", "bow", "squat", "raise"]
Span = tuple[float, float]


# Whether the segment's upper end goes forward (1) or back (-1): a bow of the trunk, a squat, a straight limb raised forward
LEANS: dict[Movement, dict[Worn, float]] = {
    "bow": {"lower-back": 1.0},
    "squat": {"lower-back": 1.0, "thigh": -1.0, "shank": 1.0},
    "raise": {"thigh": -1.0, "shank": -1.0, "foot": -1.0, "wrist": -1.0},
}
# Standard uncertainty of an upright posture about the segment's x and y, as a person takes it again, rad: standing, as quiet stance
# sways (an older person's, rms); sitting, and the mean over walking in place of a posture [assumed]
STANCE = {"standing": (0.6 * DEG, 0.9 * DEG), "sitting": (3.0 * DEG, 3.0 * DEG), "walking": (5.0 * DEG, 5.0 * DEG)}
# How far pieces of a cue scatter as a rule, and what all of them share, rad: as simulated people have it, rounded up (those of
# tests/testkit/walking.py); and how many it takes
CUES = {
    "walks from or to a posture": (1.5 * DEG, 0.7 * DEG, 1),
    "pairs of strides": (10.0 * DEG, 6.0 * DEG, 3),
    "repetitions": (3.0 * DEG, 2.0 * DEG, 2),
}
WARN = 5.0 * DEG  # of a whole mounting
OFFSET = 0.5 * DEG  # rad/s, that gyroscopes have before the filter
POSTURE_S, PIECE_S, END_S = 3.0, 2.2, (1.2, 2.4)  # a posture, two strides, the stride beside a posture, s
BOUT_S = 15.0  # s, the longest walk that is integrated whole
_BAND_HZ, _SLOW_HZ = (0.7, 5.0), 0.5  # of steps, their size
_QUIET, _STEPS = 0.3, 0.6  # m/s2, rms of the vertical acceleration over two seconds, in postures and in steps
_SWAYS, _TURNS = 4.0 * DEG, 20.0 * DEG  # rad/s: the vertical turns faster in no posture; no straight walk
_LEANT, _NEAR = 10.0 * DEG, 20.0 * DEG  # of a movement at least; of an upright posture from the mean over walking
_CLEAR, _APART = 4.0, 9.0  # a direction in its uncertainties; squared differences of cues over their variances
_SLIP, _CLEARLY = 15.0 * DEG, 4.0  # from the first half of the walks to the second; in its uncertainties [assumed]
LEAST_HZ, MOST_HZ = 15.0, 5000.0  # of a recording: steps come twice a second
_DRAWN = 4  # pieces that the usual spread counts for


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MountFit:
    """How a device is worn, as far as the recordings show it."""

    mounting: BodyMounting | None  # None where an element is not shown
    basis: tuple[str, ...]  # What showed up, and forward
    verdict: Verdict


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Seen:
    """What one recording shows, N samples in b."""

    record: Record  # In SI units
    gyro: FloatArray  # (N, 3), rad/s
    force: FloatArray  # (N, 3), m/s2
    q_nb: FloatArray  # (N, 4)
    up: FloatArray  # (N, 3), the vertical
    drive: FloatArray  # (N, 3), minus horizontal acceleration times vertical speed
    quiet: BoolArray  # (N,)
    walk: BoolArray  # (N,)


def _look(record: Record) -> _Seen:
    """Return vertical, steps and postures of a recording, by a filter that tracks the inclination."""
    from scipy.signal import butter, sosfiltfilt

    check_whole(record := unpadded(record.in_si()))
    if not LEAST_HZ <= record.sample_rate_hz <= MOST_HZ:
        raise Implausible(
            f"mount: wanted {LEAST_HZ:g} to {MOST_HZ:g} samples a second, got {record.sample_rate_hz:.3g}: milliseconds or "
            "microseconds may be taken for s; state the unit of time or the sample rate"
        )
    check_triads(record)
    if record.accel is None or np.isnan(record.accel).any():
        raise InputError(
            "mount: wanted accelerometer readings without gaps, got none or gaps; map them, or take another stretch"
        )
    rate, gyro, force = record.sample_rate_hz, np.asarray(record.gyro), np.asarray(record.accel)
    q_nb, _ = filtered(record, gyro, OFFSET, magnetometer=False)
    up = rotate(quaternion_conjugate(q_nb), np.array([0.0, 0.0, 1.0]))
    band, slow = butter(2, _BAND_HZ, "bandpass", fs=rate, output="sos"), butter(2, _SLOW_HZ, fs=rate, output="sos")
    rise = (force * up).sum(axis=1)
    push, rise = (sosfiltfilt(band, one, axis=0) for one in (force - rise[:, None] * up, rise))
    size = np.sqrt(np.maximum(sosfiltfilt(slow, rise**2), 0.0))
    half = max(1, round(0.25 * rate))
    turned = np.pad(np.linalg.norm(up[2 * half :] - up[: -2 * half], axis=1) * rate / (2 * half), half, mode="edge")
    spin = sosfiltfilt(slow, (gyro * up).sum(axis=1))
    return _Seen(
        record=record, gyro=gyro, force=force, q_nb=q_nb, up=up,
        drive=-push * sosfiltfilt(band, np.cumsum(rise) / rate)[:, None],
        quiet=(turned < _SWAYS) & (size < _QUIET), walk=(size > _STEPS) & (np.abs(spin) < _TURNS),
    )  # fmt: skip


def find_mounting(
    records: Sequence[Record], place: Worn, posture: Posture = "standing", movement: Movement = "walk", named: Span | None = None
) -> MountFit:  # fmt: skip
    """Find how a device is worn from recordings of one wearing; ``named`` is the posture in the first, s, else it is found."""
    if movement != "walk" and place not in LEANS[movement]:
        others = " or ".join(("walk", *(one for one in LEANS if place in LEANS[one])))
        raise InputError(f"mount: wanted a movement of the {place}, {others}, got {movement}; name one of them")
    seen = [_look(one) for one in records]
    up, tilt, findings, basis = _up(seen, posture, named)
    if up is None:
        return MountFit(mounting=None, basis=(), verdict=Verdict.of(*findings))
    forward, heading, more, way = _forward(seen, up, place, movement)
    if forward is None:
        return MountFit(mounting=None, basis=(basis,), verdict=Verdict.of(*findings, *more))
    matrix, covariance = np.stack((forward, np.cross(up, forward), up)), np.diag((*tilt, heading))
    worn = BodyMounting(place=place, matrix=matrix, covariance=covariance, basis=f"{basis}; {way}")
    ahead, upward = (f"{'+-'[int(way[k] < 0.0)]}{AXES[k]}" for way in matrix[::2] for k in [int(np.abs(way).argmax())])
    more += (finding("mount.look", "info", forward=ahead, up=upward),)
    if worn.uncertainty > WARN:
        more += (finding("mount.uncertain", "warn", degrees=worn.uncertainty / DEG, limit=WARN / DEG),)
    return MountFit(mounting=worn, basis=(basis, way), verdict=Verdict.of(*findings, *more))


def _still_at(record: Record, span: Span) -> Still:
    start, stop = record.time.searchsorted(span)
    return Still(start=int(start), stop=max(int(stop), int(start) + 1))


def _up(
    seen: Sequence[_Seen], posture: Posture, named: Span | None
) -> tuple[FloatArray | None, Span, tuple[Finding, ...], str]:
    """Return the vertical of the upright segment in b, the variances about its x and y, findings, and what showed it."""
    steps = np.concatenate([one.up[one.walk] for one in seen])
    walked_s = sum(float(one.walk.sum()) / one.record.sample_rate_hz for one in seen)
    mean = steps.mean(axis=0) / np.linalg.norm(steps.mean(axis=0)) if walked_s > POSTURE_S else None
    upright, others = [], 0
    for one in seen[:1] if named else seen:
        least, time = POSTURE_S * one.record.sample_rate_hz, one.record.time
        stills = [Still(start=int(a), stop=int(b)) for a, b in runs(one.quiet) if b - a >= least]
        for still in [_still_at(one.record, named)] if named else stills:
            tilt, (start, stop) = initial_tilt(one.record, still), time[[still.start, still.stop - 1]].tolist()
            up = tilt.specific_force / np.linalg.norm(tilt.specific_force)
            if mean is None or named or posture == "sitting" or up @ mean > np.cos(_NEAR):
                upright.append((stop - start, start, up, tilt.inclination_uncertainty**2 / 2.0))
            others += 1
    if upright:
        length, start, up, variance = max(upright, key=lambda one: one[0])
        x, y = (variance + one**2 for one in STANCE[posture])
        return up, (x, y), (), f"up by {posture} from {start:.1f} to {start + length:.1f} s"
    if mean is None:
        return None, (0.0, 0.0), (finding("mount.no_up", "fail", least_s=POSTURE_S),), ""
    x, y = STANCE["walking"]
    shown = finding("mount.no_stance", "warn", least_s=POSTURE_S, other=others, degrees=x / DEG)
    return mean, (x**2, y**2), (shown,), f"up by the mean over {walked_s:.0f} s of walking"


def _forward(
    seen: Sequence[_Seen], up: FloatArray, place: Worn, movement: Movement
) -> tuple[FloatArray | None, float, tuple[Finding, ...], str]:
    """Return forward in b, level, the variance of its heading, findings, and what showed it."""
    if movement == "walk":
        strides = [one.drive[k].mean(axis=0) for one in seen for k in _strides(one)] if place == "lower-back" else []
        pieces = {
            "walks from or to a posture": [way for one in seen for way in _bouts(one)],
            "pairs of strides": strides,
        }
    else:
        gone = [(one.up[a:b].mean(axis=0), b - a) for one in seen for a, b in runs(one.up @ up < np.cos(_LEANT))]
        least = 0.3 * seen[0].record.sample_rate_hz
        pieces = {"repetitions": [-LEANS[movement][place] * way for way, count in gone if count > least]}
    shown, level, slips = [], np.eye(3) - np.outer(up, up), [0.0]
    for name, ways in pieces.items():
        spread, shared, fewest = CUES[name]
        if len(ways) >= 2 * fewest:
            slips.append(_slip(np.array(ways) @ level, up, spread))
        if len(ways) >= fewest:
            forward, scatter, clear = _direction(np.array(ways) @ level, up, spread)
            shown += [(forward, 1.0 / (scatter**2 + shared**2), f"{len(ways)} {name}")] * (clear > _CLEAR)
    if not shown:
        count = max(map(len, pieces.values()))
        return None, 0.0, (finding("mount.no_forward", "fail", count=count, place=place, movement=movement),), ""
    total, what = sum(weight for _, weight, _ in shown), "forward by " + " and ".join(what for _, _, what in shown)
    forward = np.sum([weight * way for way, weight, _ in shown], axis=0)
    forward /= np.linalg.norm(forward)
    off = [float(np.arctan2(np.cross(forward, way) @ up, forward @ way)) for way, _, _ in shown]
    chi = sum(weight * angle**2 for (_, weight, _), angle in zip(shown, off, strict=True))
    slip, findings = max(slips), tuple[Finding, ...]()
    if slip > 0.0:
        findings += (finding("mount.slipped", "warn", degrees=slip / DEG),)
    if chi > _APART:
        findings += (finding("mount.apart", "warn", degrees=(max(off) - min(off)) / DEG, cues=what),)
    return forward, max(1.0, chi if chi > _APART else 0.0) / total + 0.25 * slip**2, findings, what


def _slip(pieces: FloatArray, up: FloatArray, spread: float) -> float:
    """Return by how much forward turned from the first half of the pieces to the second, rad; 0 where that may be their scatter."""
    half = len(pieces) // 2
    (first, a, _), (second, b, _) = (_direction(part, up, spread) for part in (pieces[:half], pieces[half:]))
    turn = abs(float(np.arctan2(np.cross(first, second) @ up, first @ second)))
    return turn if turn > max(_SLIP, _CLEARLY * float(np.hypot(a, b))) else 0.0


def _direction(pieces: FloatArray, up: FloatArray, spread: float) -> tuple[FloatArray, float, float]:
    """Return the direction of the mean of pieces (K, 3), less weight to those far off, its standard uncertainty, and how clear."""
    middle, weight, count = pieces.mean(axis=0), np.ones(len(pieces)), len(pieces)
    for _ in range(50):
        apart = np.linalg.norm(pieces - middle, axis=1)
        weight = 1.0 / np.maximum(apart, float(np.median(apart)) + 1e-12)
        weight /= weight.sum()
        middle = weight @ pieces
    length = max(float(np.linalg.norm(middle)), 1e-12)
    forward, off = middle / length, (pieces - middle) / length * (count * weight)[:, None]
    along, across = (
        float(np.sqrt((((off @ way) ** 2).sum() + _DRAWN * spread**2) / (count - 1 + _DRAWN) / count))
        for way in (forward, np.cross(up, forward))
    )
    return forward, across, 1.0 / max(along, across)


def _strides(one: _Seen) -> list[slice]:
    size = round(PIECE_S * one.record.sample_rate_hz)
    return [slice(k, k + size) for a, b in runs(one.walk) for k in range(a, b - size + 1, size)]


def _bouts(one: _Seen) -> list[FloatArray]:
    """Return the mean velocity of each walk between two postures, or of the stride beside one, (3,) in b, m/s."""
    time, rate, speeds = one.record.time, one.record.sample_rate_hz, []
    rests = [(int(a), int(b)) for a, b in runs(one.quiet) if b - a > rate]
    if not rests:
        return []
    (early, late), edge = (round(rate * span) for span in END_S), round(0.3 * rate)
    # Gravity at both ends of the rests shows how the body swayed there: what else gyroscopes read there is their offset
    ups = {at: one.force[at - edge : at + edge].mean(axis=0) for a, b in rests for at in (a + edge, b - edge)}
    size = float(np.mean([np.linalg.norm(up) for up in ups.values()]))
    sway = np.sum([np.cross(ups[b - edge], ups[a + edge]) for a, b in rests], axis=0) / size**2
    inner = np.concatenate([one.gyro[a + edge : b - edge] for a, b in rests])
    gyro = one.gyro - inner.mean(axis=0) + sway * rate / len(inner)
    starts, stops = [b - edge for _, b in rests], [a + edge for a, _ in rests]
    whole = [(at, to) for at, to in zip(starts, stops[1:], strict=False) if to - at < BOUT_S * rate]
    spans = [*whole, *((at, at + late) for at in starts if at not in dict(whole))]
    spans += [(at, at - late) for at in stops if at not in dict(whole).values()]
    for at, to in spans:
        way, closed = 1 if to > at else -1, (at, to) in whole
        rows = np.arange(at, to, way)
        middle = rows[early : -early if closed else None]
        if rows.min() < 0 or rows.max() + 1 >= len(time) or len(middle) < early or one.walk[middle].mean() < 0.9:
            continue
        q = integrate_strapdown(way * gyro[rows + (way < 0)], way * time[rows], shortest_rotation_up(ups[at]))
        speed = np.cumsum(rotate(q, one.force[rows]) - [0.0, 0.0, size], axis=0) * way / rate
        speed -= np.linspace(0.0, 1.0, len(rows))[:, None] * speed[-1] * closed  # it ends at rest
        seen_b = rotate(quaternion_conjugate(q), speed * [1.0, 1.0, 0.0])
        speeds.append(seen_b.mean(axis=0) if closed else seen_b[early:].mean(axis=0))
    return speeds
