"""Planner: moves that follow each other on one axis without a rest between, where they go the same way.

The speed at a joint is the slower feed of the two moves, or zero where the way turns; no move may be entered faster than it can be
left, v_in^2 <= v_out^2 + 2 a d.
"""

import math

Leg = tuple[float, float]


def plan(moves: list[tuple[float, float]], rate: float, acceleration: float) -> tuple[list[Leg], list[float]]:
    """Return the legs of constant acceleration that a chain of moves is made of.

    Parameters
    ----------
    moves : list of (float, float)
        Distance, deg, signed, and feed, deg/s, of each.
    rate : float
        Of the axis at the beginning, deg/s, signed.
    acceleration : float
        deg/s2.

    Returns
    -------
    legs : list of (float, float)
        Duration, s, and acceleration, deg/s2.
    ends : list of float
        When each move ends, s from the beginning.
    """
    count = len(moves)
    speeds = [abs(rate)] + [_joint(moves[i], moves[i + 1]) for i in range(count - 1)] + [0.0]
    for i in range(count - 1, 0, -1):
        speeds[i] = min(speeds[i], _reach(speeds[i + 1], moves[i][0], acceleration))
    for i in range(count):
        speeds[i + 1] = min(speeds[i + 1], _reach(speeds[i], moves[i][0], acceleration))
    legs: list[Leg] = []
    ends: list[float] = []
    time = 0.0
    for (distance, feed), enter, leave in zip(moves, speeds[:-1], speeds[1:], strict=True):
        for duration, change in _legs(abs(distance), feed, enter, leave, acceleration):
            legs.append((duration, math.copysign(1.0, distance) * change))
            time += duration
        ends.append(time)
    return legs, ends


def _joint(before: tuple[float, float], after: tuple[float, float]) -> float:
    return min(before[1], after[1]) if before[0] * after[0] > 0.0 else 0.0


def _reach(speed: float, distance: float, acceleration: float) -> float:
    return math.sqrt(speed * speed + 2.0 * acceleration * abs(distance))


def _legs(distance: float, feed: float, enter: float, leave: float, a: float) -> list[Leg]:
    peak = min(feed, math.sqrt(max(a * distance + 0.5 * (enter * enter + leave * leave), 0.0)))
    peak = max(peak, enter, leave)
    up, down = (peak - enter) / a, (peak - leave) / a
    cruised = distance - 0.5 * (enter + peak) * up - 0.5 * (peak + leave) * down
    level = max(cruised / peak, 0.0) if peak > 0.0 else 0.0
    return [(duration, change) for duration, change in ((up, a), (level, 0.0), (down, -a)) if duration > 0.0]
