"""Planner: moves that follow each other on one axis without a rest between, where they go the same way.

The speed at a joint is the slower feed of the two moves, or zero where the way turns; no move may be entered faster than it can be
left, v_in^2 <= v_out^2 + 2 a d. An axis that is too fast for what is left, or goes the other way, comes to rest first and returns.
"""

import math

Leg = tuple[float, float]
DONE = 1e-6  # deg: a move with less to go is over; far less than a step
ROUNDING = 1e-6  # of a speed


def plan(moves: list[tuple[float, float]], rate: float, acceleration: float) -> tuple[list[Leg], list[float]]:
    """Return the legs of constant acceleration that a chain of moves is made of: they end at rest, where the last move ends.

    Parameters
    ----------
    moves : list of (float, float)
        Distance, deg, signed, and feed, deg/s, of each; one at least.
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
    todo, part_of = _merged(moves)
    ends: list[float] = [0.0]
    speeds = _speeds(todo, abs(rate), acceleration)
    allowed = _reach(speeds[1], todo[0][0], acceleration) * (1.0 + ROUNDING)
    legs: list[Leg] = []
    if rate != 0.0 and (rate * todo[0][0] <= 0.0 or abs(rate) > allowed):
        legs.append((abs(rate) / acceleration, -math.copysign(acceleration, rate)))
        todo[0] = (todo[0][0] - 0.5 * rate * abs(rate) / acceleration, todo[0][1])
        speeds = _speeds(todo, 0.0, acceleration)
    time = sum(duration for duration, _ in legs)
    for (distance, feed), enter, leave in zip(todo, speeds[:-1], speeds[1:], strict=True):
        for duration, change in _legs(abs(distance), feed, enter, leave, acceleration):
            legs.append((duration, math.copysign(1.0, distance) * change))
            time += duration
        ends.append(time)
    return legs, [ends[part] for part in part_of]


def _merged(moves: list[tuple[float, float]]) -> tuple[list[tuple[float, float]], list[int]]:
    """Return the chain with moves shorter than a step joined to a neighbour, and how many of the chain end with each move."""
    todo: list[tuple[float, float]] = []
    part_of: list[int] = []
    carried = 0.0
    for distance, feed in moves:
        carried += distance
        if abs(carried) >= DONE:
            todo.append((carried, feed))
            carried = 0.0
        part_of.append(len(todo))
    if todo:
        todo[-1] = (todo[-1][0] + carried, todo[-1][1])
        return todo, part_of
    return [(carried, moves[-1][1])], [*part_of[:-1], 1]


def _speeds(moves: list[tuple[float, float]], enter: float, acceleration: float) -> list[float]:
    """Return the speeds at the joints: none that cannot be braked from, none that cannot be reached."""
    count = len(moves)
    speeds = [enter] + [_joint(moves[i], moves[i + 1]) for i in range(count - 1)] + [0.0]
    for i in range(count - 1, 0, -1):
        speeds[i] = min(speeds[i], _reach(speeds[i + 1], moves[i][0], acceleration))
    for i in range(count):
        speeds[i + 1] = min(speeds[i + 1], _reach(speeds[i], moves[i][0], acceleration))
    return speeds


def _joint(before: tuple[float, float], after: tuple[float, float]) -> float:
    return min(before[1], after[1]) if before[0] * after[0] > 0.0 else 0.0


def _reach(speed: float, distance: float, acceleration: float) -> float:
    return math.sqrt(speed * speed + 2.0 * acceleration * abs(distance))


def _legs(distance: float, feed: float, enter: float, leave: float, a: float) -> list[Leg]:
    if distance == 0.0:
        return []
    if enter >= _reach(leave, distance, a):  # by rounding: brake that little harder
        duration = 2.0 * distance / (enter + leave)
        return [(duration, (leave - enter) / duration)]
    peak = min(feed, math.sqrt(a * distance + 0.5 * (enter * enter + leave * leave)))
    peak = max(peak, leave)
    change = abs(peak - enter) / a
    down = (peak - leave) / a
    level = (distance - 0.5 * (enter + peak) * change - 0.5 * (peak + leave) * down) / peak
    legs = ((change, math.copysign(a, peak - enter)), (max(level, 0.0), 0.0), (down, -a))
    return [leg for leg in legs if leg[0] > 0.0]
