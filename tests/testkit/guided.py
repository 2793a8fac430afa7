"""A device in an operator's hands on a manual clock, and an operator who follows a guide."""

import math
from dataclasses import replace

import numpy as np
from scipy.stats import chi2

from testkit.quiet import without_noise
from testkit.virtual_clock import VirtualClock
from undrift.commands.bench.guides import ORDER
from undrift.live.hands import HandHeld
from undrift.record import FACES, Record
from undrift.sim.motion.motion import facing, unit_vector
from undrift.units import STANDARD_GRAVITY

STEP_S = 0.2  # between two looks of the page
LONG_STEP_S = 0.5  # for tests of the captures only


class HandFeed:
    """Readings of a hand-held device, with the interface of a source."""

    def __init__(self, seed=3, device=None, lossy=0.0, **settings):
        self.clock = VirtualClock()
        self.lost = np.random.default_rng(seed).random(100_000) < lossy  # readings that the link loses
        self.held = HandHeld(seed=seed, device=device, clock=self.clock, **settings)
        self.rows, self.moves = [], set()

    def __enter__(self):
        return self

    def __exit__(self, *failure):
        self.held.close()

    def go(self, duration_s=STEP_S):
        self.clock.wait(duration_s)
        counts, rows = self.held.read()
        self.rows.append(np.column_stack((counts / self.held.description.rate, rows)))
        self.moves |= {(move.start, move.stop) for move in self.held.moves if move.stop > 0.0}

    def recent(self, seconds=1.0, drop=None):
        """Return the newest readings. Readings in the span ``drop``, s, are lost."""
        rows = np.concatenate(self.rows[-round(seconds / STEP_S) - 1 :])
        if drop is not None:
            rows = rows[(rows[:, 0] < drop[0]) | (rows[:, 0] >= drop[1])]
        gone = self.lost[np.round(rows[:, 0] * self.held.description.rate).astype(int)]
        rows[gone, 1:] = np.nan  # as a recorder marks them
        if len(rows) < 2:
            return None
        device = self.held.device
        return Record(
            time=rows[:, 0],
            gyro=rows[:, 1:4],
            accel=rows[:, 4:7],
            temp_c=rows[:, 7],
            gyro_unit=device.gyro.unit,
            accel_unit=device.accel.unit,
            device=device.serial,
        )

    def watch(self, guide, duration_s, **lost):
        """Feed a guide for a while and return all its lights."""
        lights = []
        for _ in range(round(duration_s / STEP_S)):
            self.go()
            lights.append(guide.update(self.recent(**lost), self.clock.now()))
        return lights

    def moved_in(self, piece):
        return any(start + 1e-6 < piece.stop_s and piece.start_s < stop for start, stop in self.moves)


def joint_factor(parameters):
    """Return the coverage factor of 95 % for so many parameters jointly."""
    return math.sqrt(chi2.ppf(0.95, parameters))


def accel_as_six_faces_see_it(device, gravity_m_s2=STANDARD_GRAVITY):
    """Return matrix (3, 3) and offset (3,) of the correction by which six level faces without noise read right.

    Half sums and half differences of opposite faces: what bends the accelerometers alike on both is in their offset.
    """
    quiet = without_noise(device)
    with HandFeed(device=quiet) as feed:
        read = {}
        for face in FACES:
            up = unit_vector(face)
            feed.held.moves[-1] = replace(feed.held.moves[-1], q=facing(np.array([1.0, 0, 0, 0]), up))
            feed.go()
            read[face] = feed.rows[-1][-1, 4:7]
    forward = np.column_stack([0.5 * (read[f"+{a}"] - read[f"-{a}"]) / gravity_m_s2 for a in "xyz"])
    return np.linalg.inv(forward), np.array([0.5 * (read[f"+{a}"][k] + read[f"-{a}"][k]) for k, a in enumerate("xyz")])


def capture_faces(feed, guide, step_s=LONG_STEP_S, within_s=200.0):
    end = feed.clock.now() + within_s
    while not guide.complete:
        assert feed.clock.now() < end, f"never complete: {guide.light}"
        feed.go(step_s)
        light = guide.update(feed.recent(), feed.clock.now())
        if feed.held.moving:
            continue
        if light.state == "unknown face":  # over all its sides
            feed.held.lay(ORDER[(ORDER.index(feed.held.face) + 1) % 6])
        elif light.state == "captured" and guide.wanted:
            feed.held.lay(guide.wanted)


def capture_turns(feed, guide, step_s=LONG_STEP_S, within_s=300.0):
    end = feed.clock.now() + within_s
    while not guide.complete:
        assert feed.clock.now() < end, f"never complete: {guide.light}"
        feed.go(step_s)
        light, way = guide.update(feed.recent(), feed.clock.now()), guide.wanted
        if way is None or light.state != "still" or feed.held.moving:
            continue
        if feed.held.face != f"+{way[1]}":
            feed.held.lay(f"+{way[1]}")
        else:
            feed.held.turn(way[1], math.copysign(2.0 * math.pi, 1.0 if way[0] == "+" else -1.0))
