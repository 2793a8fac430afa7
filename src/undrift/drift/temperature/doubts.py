"""Doubts about a temperature column: what looks stale, sudden, coarse or too hot, each with its numbers."""

import numpy as np

from undrift.arrays import BoolArray, FloatArray

STALE_S = 30.0  # a value that stays this long and then jumps was not measured meanwhile
JUMP_C = 1.0  # K within a second: more than a board changes
BESIDE = 5  # readings on either side of a jump
HOT_C = 45.0  # above it all along: no room, and no body
COARSE_C = 0.5
ALONE = 8.0  # times the scatter about the running median
LEAST_ALONE_C = 0.5


def standing_alone(temp_c: FloatArray, step_c: float) -> BoolArray:
    """Return the readings that lie apart from those before and after.

    Parameters
    ----------
    temp_c : array, shape (N,)
        degC, NaN for gaps.
    step_c : float
        Step of the readings, K.

    Returns
    -------
    array of bool, shape (N,)
        Further from the median of five than eight times the usual scatter, two steps and a half, and 0.5 K.
    """
    from scipy.ndimage import median_filter

    known = np.flatnonzero(np.isfinite(temp_c))
    alone = np.zeros(len(temp_c), dtype=bool)
    if len(known) < 5:
        return alone
    values = temp_c[known]
    off = np.abs(values - median_filter(values, size=5, mode="nearest"))
    usual = 1.4826 * float(np.median(off))
    alone[known] = off > max(ALONE * usual, 2.5 * step_c, LEAST_ALONE_C)
    return alone


def find_stale(temp_c: FloatArray, time: FloatArray, step_c: float) -> tuple[BoolArray, list[str]]:
    """Return the readings that repeat an old one, and a sentence on them.

    A value stayed for 30 s or more and then jumped by over a step and a half; or it stayed far longer than values of this
    column do, whose noise changes them all the time. The first reading of such a stretch counts.

    Parameters
    ----------
    temp_c : array, shape (N,)
        degC, NaN for gaps.
    time : array, shape (N,)
        s, increasing.
    step_c : float
        Step of the readings, K.

    Returns
    -------
    stale : array of bool, shape (N,)
        Readings to leave out.
    said : list of str
        None or one.
    """
    known = np.flatnonzero(np.isfinite(temp_c))
    values, at = temp_c[known], time[known]
    first = np.flatnonzero(np.concatenate(([True], np.diff(values) != 0.0)))
    last = np.append(first[1:], len(values)) - 1
    stay = at[last] - at[first]
    jump = np.append(np.abs(np.diff(values[first])), 0.0)
    wait = np.append(at[first[1:]] - at[last[:-1]], 0.0)  # a gap between may have hidden the way
    sudden = (jump > max(1.5 * step_c, 0.2)) & (wait < 5.0 * float(np.median(np.diff(at))))
    lively = len(first) > 0.3 * len(values)  # noise changes most readings
    long = (stay >= STALE_S) & (sudden | lively)
    stale = np.zeros(len(temp_c), dtype=bool)
    for run in np.flatnonzero(long):
        stale[known[first[run] + 1 : last[run] + 1]] = True
    if not long.any():
        return stale, []
    worst = int(np.flatnonzero(long)[np.argmax(stay[long])])
    text = (
        f"stale, it stays at {values[first[worst]]:.2f} degC for {stay[worst]:.0f} s from {at[first[worst]]:.6g} s on"
    )
    text += f" and then jumps by {jump[worst]:.2f} K" if jump[worst] else ""
    return stale, [text + f" ({int(long.sum())} such): left out"]


def find_doubts(temp_c: FloatArray, time: FloatArray, step_c: float, noise_c: float) -> list[str]:
    """Return what else looks wrong: coarse steps, jumps, a temperature of no room.

    Parameters
    ----------
    temp_c : array, shape (N,)
        Without NaN, degC.
    time : array, shape (N,)
        s, increasing.
    step_c : float
        Step of the readings, K.
    noise_c : float
        Standard deviation of one reading, K.

    Returns
    -------
    list of str
        A sentence each.
    """
    said: list[str] = []
    if step_c >= COARSE_C:
        said.append(f"quantised, it comes in steps of {step_c:g} K; smoothed over time")
    said += _jumps(temp_c, time, step_c, noise_c)
    if temp_c.min() > HOT_C:
        said.append(
            f"implausible unless a chamber held it, {temp_c.min():.1f} to {temp_c.max():.1f} degC throughout: the warmth of a "
            "chip, or a wrong scale; a table counts in the degrees of this column"
        )
    return said


def _jumps(temp_c: FloatArray, time: FloatArray, step_c: float, noise_c: float) -> list[str]:
    """Return a sentence on medians of five readings that differ from the next five by more than a board changes."""
    if len(temp_c) < 2 * BESIDE:
        return []
    middle = np.median(np.lib.stride_tricks.sliding_window_view(temp_c, BESIDE), axis=1)
    change = np.abs(middle[BESIDE:] - middle[:-BESIDE])
    lasts = time[2 * BESIDE - 1 :] - time[: 1 - 2 * BESIDE]
    jumps = np.flatnonzero(change > np.maximum(JUMP_C * np.maximum(lasts, 1.0), max(1.5 * step_c, 6.0 * noise_c)))
    if len(jumps) == 0:
        return []
    groups = np.split(jumps, np.flatnonzero(np.diff(jumps) > BESIDE) + 1)
    first = groups[0][len(groups[0]) // 2] + BESIDE  # the medians differ while most of one side is beyond the jump
    return [
        f"jumps by {change[jumps].max():.2f} K, faster than a board changes, first at {time[first]:.6g} s ({len(groups)} such)"
    ]
