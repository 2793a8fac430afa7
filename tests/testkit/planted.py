"""People who walk, step up, or stand up and go, with a device at the low back: motions whose events are planted.

Angles and the way of the device are closed forms on a fine grid, differentiated there; no equation of the estimator and none of the
library's tasks. Walking is a pendulum upside down: the trunk is lowest, and pushed up most, when a foot has come down::

    k(t)   a smooth course through the contacts: 0, 1, 2, ... at t_0, t_1, ...
    up     -h cos(2 pi k) + h_2 sin(4 pi k)         left   w sin(pi k)          pitch, roll, yaw: waves of k, and the turns

A leg turns by a curve of the stride through a few nodes of its rate, whose extremes and zeros lie there: contacts are nodes.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator

from testkit.walking import GRAVITY, _smooth_rise, _sway, orientation
from undrift.frames import quaternion_conjugate, quaternion_product, rotate
from undrift.sim.motion.motion import Motion, mean_rate

DEGREE = np.pi / 180.0
FINE, RATE_HZ = 1000, 100


@dataclass
class Planted:
    """A motion, and when what happens in it."""

    motion: Motion
    contacts: np.ndarray  # s
    turns: list  # (start, stop, angle): s, s, rad to the left


def motion_of(t, roll, pitch, yaw, position):
    """Return the motion, sampled, of angles (N,) and a way (N, 3) on the fine grid."""
    q = orientation(roll, pitch, yaw)
    push = np.gradient(np.gradient(position, t, axis=0), t, axis=0) + np.array([0.0, 0.0, GRAVITY])
    turn = quaternion_product(quaternion_conjugate(q[:-2]), q[2:])
    rate = turn[:, 1:] * np.sign(turn[:, :1]) * FINE  # of two steps: half the angle's sine, twice the time
    rate = np.vstack((rate[:1], rate, rate[-1:]))
    rows = slice(4, -4, FINE // RATE_HZ)
    force = rotate(quaternion_conjugate(q), push)[rows]
    return Motion(
        time=t[rows], q_nb=q[rows], rate_b=rate[rows], mean_rate_b=mean_rate(t[rows], q[rows], rate[rows][0]), force_b=force,
        gravity_m_s2=GRAVITY, moving=np.ones(len(force)),
    )  # fmt: skip


def walked(rng, t, contacts):
    """Return angles (N, 3) and displacement (N, 3) of the trunk while walking ahead with yaw 0, from foot contacts."""
    padded = np.concatenate((contacts[:1] - np.diff(contacts[:2]), contacts, contacts[-1:] + np.diff(contacts[-2:])))
    k = CubicSpline(padded, np.arange(-1, len(contacts) + 1.0))(np.clip(t, padded[0], padded[-1]))
    on = _smooth_rise(t, padded[0], contacts[0] - padded[0]) - _smooth_rise(t, contacts[-1], padded[-1] - contacts[-1])
    height, side = rng.uniform(0.010, 0.022), rng.uniform(0.015, 0.03)
    late = rng.normal(0.0, 0.3, 4)
    up = -height * np.cos(2.0 * np.pi * k) + rng.uniform(0.0, 0.15) * height * np.sin(4.0 * np.pi * k)
    angles = np.stack(
        (
            rng.uniform(1.0, 4.0) * DEGREE * np.sin(np.pi * k + late[0]),
            (3.0 + rng.uniform(0.7, 2.0) * np.cos(2.0 * np.pi * k + late[1])) * DEGREE,
            rng.uniform(2.0, 6.0) * DEGREE * np.sin(np.pi * k + late[2]),
        ),
        axis=1,
    )
    speed = rng.uniform(0.45, 0.7) * np.gradient(k, t) * (1.0 + 0.15 * np.cos(2.0 * np.pi * k + late[3]))
    way = np.stack((np.cumsum(on * speed) / FINE, side * on * np.sin(np.pi * k), on * up), axis=1)
    return angles * on[:, None], way


def contacts_of(rng, start, count, duration=None):
    """Return instants of steps: a person's own duration, each a little different, the legs too."""
    duration = rng.uniform(0.45, 0.75) if duration is None else duration
    uneven = rng.normal(0.0, 0.03) * (-1.0) ** np.arange(count - 1)
    return start + np.concatenate(([0.0], np.cumsum(duration * (1.0 + uneven + rng.normal(0.0, 0.025, count - 1)))))


def walk(rng, count=24):
    """Return a person who is upright, walks ahead, and stops."""
    contacts = contacts_of(rng, 4.5, count)
    t = np.arange(round((contacts[-1] + 4.0) * FINE)) / FINE
    angles, way = walked(rng, t, contacts)
    angles = angles + np.stack([_sway(rng, t, size * DEGREE) for size in (0.3, 0.4, 0.5)], axis=1)
    return Planted(motion_of(t, *angles.T, way), contacts, [])


def step_up(rng, count=3, *, pause=3.0, height=None):
    """Return a person who climbs steps, with or without a stance between, and start, duration and height of each lift."""
    duration, height = rng.uniform(0.6, 1.2), rng.uniform(0.12, 0.22) if height is None else height
    starts = 5.0 + (duration + pause) * np.arange(count) + rng.uniform(-0.05, 0.05, count) * pause
    t = np.arange(round((starts[-1] + duration + 5.0) * FINE)) / FINE
    lean, shift = rng.uniform(5.0, 16.0) * DEGREE, rng.uniform(2.0, 7.0) * DEGREE
    pitch, roll, up, ahead, yaw = (
        _sway(rng, t, size) for size in (0.3 * DEGREE, 0.3 * DEGREE, 0.0, 0.002, 0.3 * DEGREE)
    )
    for k, start in enumerate(starts):
        before = start - 0.4 * duration
        pitch = pitch + lean * (
            _smooth_rise(t, before, 0.7 * duration) - _smooth_rise(t, start + 0.3 * duration, 0.8 * duration)
        )
        roll = roll + (-1) ** k * shift * (
            _smooth_rise(t, before, 0.5 * duration) - _smooth_rise(t, start + 0.1, 0.6 * duration)
        )
        up = up + height * _smooth_rise(t, start, duration)
        ahead = ahead + 0.28 * _smooth_rise(t, before, 1.3 * duration)
    way = np.stack((ahead, 0.02 * np.sin(roll), up), axis=1)
    return Planted(motion_of(t, roll, pitch, yaw, way), starts, []), duration, height


def _slow_sway(rng, t, rms):
    """Return the sway of an upright body. Slow sway is larger, as in stance below its own frequency."""
    lines = np.geomspace(0.03, 0.6, 9) * rng.uniform(0.9, 1.1, 9)
    sway = sum(np.sin(2.0 * np.pi * f * t + rng.uniform(0.0, 2.0 * np.pi)) / f**0.5 for f in lines)
    return rms * sway / np.sqrt(0.5 * (1.0 / lines).sum())


def up_and_go(rng, *, turned=np.pi, begun=5.0):
    """Return a person who gets up, walks out, turns, walks back, turns and sits down. Each turn has an angle to the
    left.
    """
    sits, rise, lean = rng.normal(0.0, 3.0) * DEGREE, rng.uniform(1.4, 2.2), rng.uniform(25.0, 40.0) * DEGREE
    duration, turn = rng.uniform(0.48, 0.7), rng.uniform(1.6, 2.6)
    walks = begun + rise + 0.3
    out = contacts_of(rng, walks + duration, 20, duration)
    turns = [(out[6], out[6] + turn, turned), (out[14], out[14] + turn, np.pi)]
    stop = out[14] + turn + 0.2  # the person is upright after the turn, and sits down
    contacts = out[out < stop]
    down = contacts[-1] + duration
    t = np.arange(round((down + rise + 4.0) * FINE)) / FINE
    angles, way = walked(rng, t, contacts)
    yaw = sum(angle * _smooth_rise(t, a, b - a) for a, b, angle in turns)
    ahead = np.gradient(way[:, 0], t)
    path = np.stack((np.cumsum(ahead * np.cos(yaw)), np.cumsum(ahead * np.sin(yaw)), FINE * way[:, 2]), axis=1) / FINE
    path[:, 2] += 0.35 * (
        _smooth_rise(t, begun + 0.4 * rise, 0.5 * rise) - _smooth_rise(t, down + 0.2 * rise, 0.6 * rise)
    )
    path[:, :2] += way[:, 1:2] * np.stack((-np.sin(yaw), np.cos(yaw)), axis=1)
    bent = _smooth_rise(t, begun, 0.5 * rise) - _smooth_rise(t, begun + 0.5 * rise, 0.5 * rise)
    bent += _smooth_rise(t, down, 0.5 * rise) - _smooth_rise(t, down + 0.5 * rise, 0.5 * rise)
    pitch = angles[:, 1] + sits + lean * bent + _slow_sway(rng, t, 0.1 * DEGREE)  # who sits sways little
    roll, yaw = angles[:, 0] + _slow_sway(rng, t, 0.1 * DEGREE), yaw + angles[:, 2] + _slow_sway(rng, t, 0.1 * DEGREE)
    return Planted(motion_of(t, roll, pitch, yaw, path), contacts, turns), (begun, begun + rise), (down, down + rise)


# Rate at which a segment swings forward, deg/s at a stride of 1.1 s, over the share of a stride since the initial contact: of a
# shank 0 there, least at the end contact; the first value of each that bends balances the stride.
SHANK = ((0.0, 0.05, 0.15, 0.35, 0.50, 0.61, 0.68, 0.79, 0.93, 1.0), (0, -170, -60, -40, -110, -215, 0, 380, 140, 0))
THIGH = ((0.0, 0.05, 0.25, 0.45, 0.53, 0.68, 0.86, 0.94, 1.0), (-20, -15, -80, -60, 0, 190, 0, -40, -20))
NODE = 5  # end contact of the shank, mid-swing of the thigh


def _leg(rng, nodes):
    """Return a segment's pitch over a stride, rad, by phase, and the phase of each node: a person's own size and timing."""
    phase, rate = (np.array(one, dtype=float) for one in nodes)
    phase[1:-1] += rng.uniform(-0.015, 0.015, len(phase) - 2)
    rate *= rng.uniform(0.7, 1.15) * rng.uniform(0.9, 1.1, len(rate)) * DEGREE * 1.1
    rate[-1] = rate[0]
    whole = PchipInterpolator(phase, rate).integrate(0.0, 1.0)
    for _ in range(40):  # the slow part of the stance is adjusted so that a stride ends as it began
        rate[2:4] -= whole
        whole = PchipInterpolator(phase, rate).integrate(0.0, 1.0)
    angle = PchipInterpolator(phase, rate).antiderivative()
    mean = np.mean(angle(np.linspace(0.0, 1.0, 1000)))
    return (lambda k: -(angle(np.mod(k, 1.0)) - mean)), phase


def walk_of_leg(rng, place, count=16):
    """Return a walking person with a device at a shank or thigh, and end contacts or mid-swings (s)."""
    legs = {"shank": _leg(rng, SHANK), "thigh": _leg(rng, THIGH)}
    contacts = contacts_of(rng, 5.0, count, rng.uniform(0.95, 1.4))
    padded = np.concatenate((contacts[:1] - np.diff(contacts[:2]), contacts, contacts[-1:] + np.diff(contacts[-2:])))
    t = np.arange(round((padded[-1] + 4.0) * FINE)) / FINE
    course = CubicSpline(padded, np.arange(-1, count + 1.0))
    k = course(np.clip(t, padded[0], padded[-1]))
    on = _smooth_rise(t, padded[0], 0.6) - _smooth_rise(t, padded[-1] - 0.6, 0.6)
    angle = {name: leg(k) for name, (leg, _) in legs.items()}
    bend = rng.uniform(1.0, 4.0, 2) * DEGREE
    roll, yaw = (
        size * on * np.sin(2.0 * np.pi * k + late) for size, late in zip(bend, rng.uniform(0, 6, 2), strict=True)
    )
    pitch, roll, yaw = (
        one + _sway(rng, t, size * DEGREE) for one, size in ((on * angle[place], 0.3), (roll, 0.3), (yaw, 0.4))
    )
    hip = np.cumsum(on * rng.uniform(0.9, 1.3)) / FINE, 0.02 * on * np.cos(4.0 * np.pi * k)
    position = np.stack((hip[0], 0.0 * t, hip[1]), axis=1)
    arms = [0.42, 0.15] if place == "shank" else [0.2]
    for one, arm in zip((angle["thigh"], angle["shank"]), arms, strict=False):
        position[:, 0] -= arm * np.sin(on * one)
        position[:, 2] -= arm * np.cos(on * one)
    ends = np.interp(np.arange(count) - 1.0 + legs[place][1][NODE], k, t)
    return Planted(motion_of(t, roll, pitch, yaw, position), contacts, []), ends[1:]


def chair_of_thigh(rng, count=5):
    """Return a person who sits and gets up several times, with a device at a thigh, and start and end of rises and of
    sittings (s).
    """
    sits, stands = rng.uniform(-95.0, -70.0) * DEGREE, rng.normal(0.0, 4.0) * DEGREE
    lasts = rng.uniform(0.8, 2.0, (2, count))
    pauses = rng.uniform(0.4, 1.5, (2, count))
    rises = 5.0 + np.cumsum(np.append(0.0, (lasts + pauses).sum(axis=0)[:-1]))
    downs = rises + lasts[0] + pauses[0]
    t = np.arange(round((downs[-1] + lasts[1, -1] + 5.0) * FINE)) / FINE
    up = sum(_smooth_rise(t, a, n) for a, n in zip(rises, lasts[0], strict=True))
    up = up - sum(_smooth_rise(t, a, n) for a, n in zip(downs, lasts[1], strict=True))
    pitch = sits + (stands - sits) * up + _slow_sway(rng, t, 0.2 * DEGREE)
    roll, yaw = (up * rng.normal(0.0, 3.0) * DEGREE + _slow_sway(rng, t, 0.2 * DEGREE) for _ in range(2))
    way = np.stack((-0.25 * np.sin(pitch), 0.02 * np.sin(roll), 0.25 * np.cos(pitch)), axis=1)  # about the knee
    spans = [np.stack((one, one + last), axis=1) for one, last in zip((rises, downs), lasts, strict=True)]
    return Planted(motion_of(t, roll, pitch, yaw, way), rises, []), *spans
