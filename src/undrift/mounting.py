"""Mounting of a device on the body, from its case axes b to the axes a of the segment that wears it.

Axes a are x forward, y left, z up, when the wearer stands upright. ``R_ab`` maps b to a. Its rows are forward, left and up, in b.

``up``       the vertical in b during the longest stance of the wearer
``forward``  from walks between stances: the horizontal acceleration, integrated from rest to rest, is the velocity, and its mean
             points forward. Or from bows of the trunk: the vertical in b leaves ``up`` towards the back.

The scatter of the pieces (walks, bows) determines the uncertainty of their mean. A common error of all pieces, due to the variation
of human movement, is added (``STANCE``, ``SHARED``).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np

from undrift.arrays import BoolArray, FloatArray, runs
from undrift.calibration.triads import check_triads
from undrift.errors import Implausible, InputError
from undrift.findings import Finding, Verdict, finding, told_apart
from undrift.frames import integrate_strapdown, quaternion_conjugate, rotate
from undrift.model import AXES, BodyMounting
from undrift.orientation import check_whole, filtered, initial_tilt, shortest_rotation_up
from undrift.record import Record, Still
from undrift.segments import unpadded
from undrift.units import RADIAN_PER_DEGREE as DEG

Worn = Literal["lower-back", "thigh", "shank", "foot", "wrist"]
Movement = Literal["walk", "bow"]
Span = tuple[float, float]

# standard uncertainty of upright about x and y, rad: sway of older people in quiet stance
STANCE = (0.6 * DEG, 0.9 * DEG)
# usual scatter of the pieces (simulated people, rounded up), rad, common error of all pieces, rad, and smallest number of pieces
SCATTER = {"walk": 1.5 * DEG, "bow": 3.0 * DEG}
SHARED = {"walk": 0.7 * DEG, "bow": 2.0 * DEG}
FEWEST = {"walk": 1, "bow": 2}
WARN = 5.0 * DEG  # uncertainty of the mounting above which a finding is reported
TURNED = 45.0 * DEG  # limit of the difference from the previous mounting
OFFSET = 0.5 * DEG  # offset of the gyroscopes before the filter, rad/s
STANCE_S, EDGE_S = 3.0, 0.3  # shortest stance, and its parts at both ends in which the body still moves, s
WALK_S, START_S = 15.0, 1.2  # longest walk that is integrated, and its first and last part, which may turn, s
BAND_HZ, SLOW_HZ = (0.7, 5.0), 0.5  # frequency limits of steps, and of their amplitude
QUIET, STEPS = 0.3, 0.6  # rms of the vertical acceleration over two seconds in stance and in steps, m/s2
SWAY, TURN = 4.0 * DEG, 20.0 * DEG  # rate of the vertical in stance, and about it in a straight walk, rad/s
LEAN, UPRIGHT = 10.0 * DEG, 20.0 * DEG  # smallest lean of a bow, and largest tilt of an upright stance
CLEAR = 4.0  # smallest length of a clear direction, in its uncertainties
LEAST_HZ, MOST_HZ = 15.0, 5000.0  # limits of the sample rate (steps come twice a second)
USUAL_PIECES = 4  # weight of the usual scatter, as a number of pieces


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MountFit:
    """Mounting of a device, if the recordings determine it."""

    mounting: BodyMounting | None  # mounting, or None if an axis is not determined
    verdict: Verdict


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Track:
    """Stances and steps of a recording, N samples in b."""

    record: Record  # in SI units
    up: FloatArray  # (N, 3), vertical direction
    quiet: BoolArray  # (N,)
    walk: BoolArray  # (N,), True in straight walks


RECORD_AGAIN = (
    "Stand upright and still for 3 s, walk straight for 8 s and halt, four times, or bow twice or more (`movement`). "
    "Check that the device does not slip."
)


def find_mounting(records: Sequence[Record], place: Worn, movement: Movement = "walk") -> MountFit:
    """Determine the mounting of a device from recordings between which it was not remounted."""
    if movement == "bow" and place != "lower-back":
        raise InputError(f"mount: in a bow, the {place} does not move like the trunk. Choose walk.")
    tracks = [_track(record) for record in records]
    stance = _up(tracks)
    if stance is None:
        return _undetermined("Up", f"there is no upright stance of {STANCE_S:g} s")
    up, variances, basis = stance
    pieces = _pieces(tracks, up, movement)
    direction = _direction(pieces, up, SCATTER[movement]) if len(pieces) >= FEWEST[movement] else None
    if direction is None:
        name = "walks between two stances" if movement == "walk" else "bows"
        why = f"the {len(pieces)} {name} have no common direction" if len(pieces) else f"there are no {name}"
        return _undetermined("Forward", why)
    forward, scatter = direction
    worn = BodyMounting(
        place=place,
        matrix=np.stack((forward, np.cross(up, forward), up)),
        covariance=np.diag((*variances, scatter**2 + SHARED[movement] ** 2)),
        basis=f"{basis}; forward by {len(pieces)} {'walks between stances' if movement == 'walk' else 'bows'}",
    )
    # a wrong sign of the accelerometers has no other effect
    ahead, upward = (nearest_side(direction)[0] for direction in (forward, up))
    look = finding(
        "mount.look",
        "info",
        f"Side {ahead} of the device points forward and side {upward} up.",
        "Check this on the device: otherwise, accelerometer columns are exchanged or have the opposite sign.",
    )
    size = told_apart(worn.uncertainty / DEG, ".1f", WARN / DEG)
    uncertain = finding(
        "mount.uncertain", "warn", f"The mounting is uncertain by {size} deg (limit {WARN / DEG:g} deg).", RECORD_AGAIN
    )
    return MountFit(mounting=worn, verdict=Verdict.of(look, *((uncertain,) if worn.uncertainty > WARN else ())))


def nearest_side(direction: FloatArray) -> tuple[str, float]:
    """Return the side of the device nearest to a direction in b, such as "+x", and the angle between them, rad."""
    k = int(np.abs(direction).argmax())
    return f"{'+-'[int(direction[k] < 0.0)]}{AXES[k]}", float(np.arccos(min(1.0, abs(direction[k]))))


def statement_of(worn: BodyMounting) -> str:
    """Return a sentence about the sides of the device that point forward and up."""
    (forward, ahead), _, (up, upright) = map(nearest_side, worn.matrix)
    return (
        f"{worn.place.capitalize().replace('-', ' ')}: side {forward} of the device points forward ({ahead / DEG:.1f} deg off) "
        f"and {up} up ({upright / DEG:.1f} deg off), with a standard uncertainty of {worn.uncertainty / DEG:.1f} deg."
    )


def check_turned(worn: BodyMounting, before: BodyMounting | None) -> tuple[Finding, ...]:
    """Return a finding if a device is turned relative to its previous mounting, or relative to +x forward and +z up."""
    turn = worn.matrix if before is None else worn.matrix @ before.matrix.T
    angle = np.arccos(np.clip((np.trace(turn) - 1.0) / 2.0, -1.0, 1.0))
    if angle < TURNED:
        return ()
    ways = ("upside down", "left and right swapped", "front and back swapped")
    how = ", ".join(way for way, cosine in zip(ways, np.diag(turn)[::-1], strict=True) if cosine < -0.7) or "turned"
    against = "+x forward and +z up" if before is None else "the previous mounting"
    sentence = f"The device is {how}: {angle / DEG:.0f} deg off {against}."
    action = "If this is not intended, turn the device and record again."
    return (finding("mount.look", "warn" if before else "info", sentence, action),)


def _undetermined(direction: str, why: str) -> MountFit:
    missing = finding("mount.not_determined", "fail", f"{direction} is not determined: {why}.", RECORD_AGAIN)
    return MountFit(mounting=None, verdict=Verdict.of(missing))


def _track(record: Record) -> _Track:
    """Find stances and steps of a recording with a filter that tracks the inclination."""
    from scipy.signal import butter, sosfiltfilt

    check_whole(record := unpadded(record.in_si()))
    if not LEAST_HZ <= record.sample_rate_hz <= MOST_HZ:
        raise Implausible(
            f"mount: {record.sample_rate_hz:.3g} samples a second are not between {LEAST_HZ:g} and {MOST_HZ:g}. Correct the unit "
            "of time or the sample rate. Milliseconds or microseconds may have been read as s."
        )
    check_triads(record)
    if record.accel is None or np.isnan(record.accel).any():
        raise InputError("mount: accelerometer readings without gaps are needed. Map them, or choose another stretch.")
    rate, gyro = record.sample_rate_hz, np.asarray(record.gyro)
    q_nb, _ = filtered(record, gyro, OFFSET, magnetometer=False)
    up = rotate(quaternion_conjugate(q_nb), np.array([0.0, 0.0, 1.0]))
    band, slow = butter(2, BAND_HZ, "bandpass", fs=rate, output="sos"), butter(2, SLOW_HZ, fs=rate, output="sos")
    rise = sosfiltfilt(band, (record.accel * up).sum(axis=1))
    size = np.sqrt(np.maximum(sosfiltfilt(slow, rise**2), 0.0))
    half = max(1, round(0.25 * rate))
    tilt_rate = np.pad(np.linalg.norm(up[2 * half :] - up[: -2 * half], axis=1) * rate / (2 * half), half, mode="edge")
    spin = sosfiltfilt(slow, (gyro * up).sum(axis=1))
    quiet, walk = (tilt_rate < SWAY) & (size < QUIET), (size > STEPS) & (np.abs(spin) < TURN)
    return _Track(record=record, up=up, quiet=quiet, walk=walk)


def _up(tracks: Sequence[_Track]) -> tuple[FloatArray, Span, str] | None:
    """Return the vertical of the upright segment in b, its variances about x and y, and the stance, or None without a stance."""
    steps = np.concatenate([track.up[track.walk] for track in tracks])
    walked_s = sum(float(track.walk.sum()) / track.record.sample_rate_hz for track in tracks)
    mean = steps.mean(axis=0) / np.linalg.norm(steps.mean(axis=0)) if walked_s > STANCE_S else None
    upright = []
    for track in tracks:
        time, least = track.record.time, STANCE_S * track.record.sample_rate_hz
        for first, last in [run for run in runs(track.quiet) if run[1] - run[0] >= least]:
            tilt = initial_tilt(track.record, Still(start=int(first), stop=int(last)))
            up = tilt.specific_force / np.linalg.norm(tilt.specific_force)
            if mean is None or up @ mean > np.cos(UPRIGHT):
                start, stop = time[[first, last - 1]].tolist()
                upright.append((stop - start, start, up, tilt.inclination_uncertainty**2 / 2.0))
    if not upright:
        return None
    length, start, up, variance = max(upright, key=lambda stretch: stretch[0])
    x, y = (variance + sway**2 for sway in STANCE)
    return up, (x, y), f"up from standing at {start:.1f} to {start + length:.1f} s"


def _pieces(tracks: Sequence[_Track], up: FloatArray, movement: Movement) -> FloatArray:
    """Return horizontal vectors (K, 3) in b that point forward on average."""
    if movement == "walk":
        ways = [way for track in tracks for way in _bouts(track)]
    else:
        least = 0.3 * tracks[0].record.sample_rate_hz
        leans = [(track, a, b) for track in tracks for a, b in runs(track.up @ up < np.cos(LEAN)) if b - a > least]
        ways = [-track.up[a:b].mean(axis=0) for track, a, b in leans]
    return np.reshape(ways, (-1, 3)) @ (np.eye(3) - np.outer(up, up))


def _direction(pieces: FloatArray, up: FloatArray, spread: float) -> tuple[FloatArray, float] | None:
    """Return the direction of the robust mean of pieces (K, 3) and its standard uncertainty, rad, or None if it is not clear."""
    middle, weight, count = pieces.mean(axis=0), np.ones(len(pieces)), len(pieces)
    for _ in range(50):
        distance = np.linalg.norm(pieces - middle, axis=1)
        weight = 1.0 / np.maximum(distance, float(np.median(distance)) + 1e-12)
        weight /= weight.sum()
        middle = weight @ pieces
    length = max(float(np.linalg.norm(middle)), 1e-12)
    forward, deviation = middle / length, (pieces - middle) / length * (count * weight)[:, None]
    along_sigma, cross_sigma = (
        float(np.sqrt((((deviation @ way) ** 2).sum() + USUAL_PIECES * spread**2) / (count - 1 + USUAL_PIECES) / count))
        for way in (forward, np.cross(up, forward))
    )
    return (forward, cross_sigma) if 1.0 / max(along_sigma, cross_sigma) > CLEAR else None


def _bouts(track: _Track) -> list[FloatArray]:
    """Return the mean velocity of each walk between two stances, (3,) in b, m/s."""
    rate, edge, start = (round(track.record.sample_rate_hz * span_s) for span_s in (1.0, EDGE_S, START_S))
    time, force, gyro = track.record.time, np.asarray(track.record.accel), np.asarray(track.record.gyro)
    rests = [(int(a) + edge, int(b) - edge) for a, b in runs(track.quiet) if b - a > rate]
    if not rests:
        return []
    # gravity at both ends of a rest determines the sway, and the remaining readings of the gyroscopes are their offset
    ups = {k: force[k - edge : k + edge].mean(axis=0) for rest in rests for k in rest}
    size = float(np.mean([np.linalg.norm(up) for up in ups.values()]))
    sway = np.sum([np.cross(ups[b], ups[a]) for a, b in rests], axis=0) / size**2
    inner = np.concatenate([gyro[a:b] for a, b in rests])
    gyro = gyro - inner.mean(axis=0) + sway * track.record.sample_rate_hz / len(inner)
    velocities = []
    for (_, first), (last, _) in pairwise(rests):
        if not 3 * start <= last - first < WALK_S * rate or track.walk[first + start : last - start].mean() < 0.9:
            continue
        rows = slice(first, last)
        q = integrate_strapdown(gyro[rows], time[rows], shortest_rotation_up(ups[first]))
        velocity = np.cumsum(rotate(q, force[rows]) - [0.0, 0.0, size], axis=0) / rate
        velocity -= np.linspace(0.0, 1.0, last - first)[:, None] * velocity[-1]  # the velocity is zero at the end
        velocities.append(rotate(quaternion_conjugate(q), velocity * [1.0, 1.0, 0.0]).mean(axis=0))
    return velocities
