"""Parts: a motion cut where it is not known, so that a device can be simulated on each piece without a gap."""

from dataclasses import replace
from typing import TypeVar

import numpy as np

from undrift.errors import InputError
from undrift.session import Still, Turn
from undrift.sim.motion.motion import Motion

Label = TypeVar("Label", Still, Turn)


def part_of(motion: Motion, start: int, stop: int) -> Motion:
    """Return samples [start, stop) of a motion.

    Parameters
    ----------
    motion : Motion
        Any.
    start, stop : int
        Samples.

    Returns
    -------
    Motion
        On the same clock, with the labels that lie wholly within.

    Raises
    ------
    InputError
        Not two samples or more within the motion.
    """
    if not 0 <= start < stop - 1 < len(motion):
        raise InputError(f"motion: wanted samples within 0 and {len(motion)}, two or more, got [{start}, {stop})")
    cut = slice(start, stop)
    swing = motion.angular_acceleration_b
    return Motion(
        time=motion.time[cut],
        q_nb=motion.q_nb[cut],
        rate_b=motion.rate_b[cut],
        mean_rate_b=motion.mean_rate_b[cut],
        force_b=motion.force_b[cut],
        gravity_m_s2=motion.gravity_m_s2,
        stills=tuple(_moved(s, start) for s in motion.stills if start <= s.start and s.stop <= stop),
        turns=tuple(_moved(t, start) for t in motion.turns if start <= t.start and t.stop <= stop),
        moving=motion.moving[cut],
        angular_acceleration_b=None if swing is None else swing[cut],
        valid=motion.valid[cut],
    )


def known_parts(motion: Motion) -> tuple[Motion, ...]:
    """Return the pieces of a motion that are known, each without a gap.

    Parameters
    ----------
    motion : Motion
        With ``valid`` 0 where the cameras lost the body.

    Returns
    -------
    tuple of Motion
        In order of time, two samples or more each.
    """
    edges = np.flatnonzero(np.diff(np.concatenate(([0.0], motion.valid > 0.0, [0.0]))))
    return tuple(
        part_of(motion, int(start), int(stop))
        for start, stop in zip(edges[::2], edges[1::2], strict=True)
        if stop - start > 1
    )


def _moved(label: Label, start: int) -> Label:
    return replace(label, start=label.start - start, stop=label.stop - start)
