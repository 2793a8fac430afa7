"""Errors of a bench: its table, its faces and the hands of the operator; and their draws.

One list serves motions sample by sample (``sim.motion.bench``), means dwell by dwell (``sim.table_sessions``) and the study's
plan. All is drawn from standard normal numbers and from uniform ones, so that benches of one state err alike, whatever the size
of the errors: a dwell has the same draws in every session that has it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Ge

from undrift.arrays import FloatArray
from undrift.base.codec import Key, stored
from undrift.sim.device.simulate import Streams
from undrift.sim.motion.motion import turn_quaternion
from undrift.units import RADIAN_PER_DEGREE

OF_TABLE = (
    "face_tilt", "mount_tilt", "level", "wobble", "table_rate", "servo", "encoder_lines",
)  # fmt: skip


@stored(keys=OF_TABLE)  # of [study.bench]
@dataclass(frozen=True, slots=True, kw_only=True)
class BenchErrors:
    """Standard deviations of what a bench does wrong; all zero is an ideal one."""

    # Of each face against level, about each axis, rad
    face_tilt: Annotated[float, Ge(0.0), Key("face_tilt_deg", unit=RADIAN_PER_DEGREE)] = 0.0
    hand_axis: float = 0.0  # Of the axis of a turn by hand, about each axis across it, rad
    # Of the device against the rig, about each axis, rad; each mounting anew
    mount_tilt: Annotated[float, Ge(0.0), Key("mount_tilt_deg", unit=RADIAN_PER_DEGREE)] = 0.0
    # Of the rig's axis against the vertical, about each horizontal axis, rad; one rig, one draw
    level: Annotated[float, Ge(0.0), Key("level_deg", unit=RADIAN_PER_DEGREE)] = 0.0
    # Of a table's axis from dwell to dwell, or a plane's from angle to angle, about each axis, rad
    wobble: Annotated[float, Ge(0.0), Key("wobble_deg", unit=RADIAN_PER_DEGREE)] = 0.0
    # Of the true rate or frequency against the stated one, relative; one rig, one draw
    table_rate: Annotated[float, Ge(0.0), Key("table_rate_percent", unit=0.01)] = 0.0
    ripple: float = 0.0  # Of the rate once a turn, amplitude, relative
    excess: float = 0.0  # Of the rate at the start of a dwell, relative; a transient
    settle_s: float = 0.5  # Time constant of that transient, s
    # Of the angle turned in a dwell against the commanded one, rad
    servo: Annotated[float, Ge(0.0), Key("servo_deg", unit=RADIAN_PER_DEGREE)] = 0.0
    encoder_lines: Annotated[int, Ge(0)] = 0  # Of the table's encoder, four counts a line; 0 reads rates without steps


IDEAL = BenchErrors()


# ---- sample by sample: named streams


def level_of(errors: BenchErrors, streams: Streams) -> FloatArray:
    """Return by how much a rig is off level, as a turn in n, (4,)."""
    level_n = np.array([*streams.of("bearing").normal(0.0, errors.level, 2), 0.0])
    size = float(np.linalg.norm(level_n))
    return turn_quaternion(np.cross(level_n, [0.0, 0.0, 1.0]) / (size or 1.0), np.array(size))


def gain_of(errors: BenchErrors, streams: Streams) -> float:
    """Return true over stated rate or frequency of a rig."""
    return 1.0 + float(streams.of("motor").normal(0.0, errors.table_rate))


# ---- dwell by dwell: the same numbers for every session


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BenchDraws:
    """Numbers by which a bench errs, the same for every session on it: U kinds of dwells."""

    mount: FloatArray  # (3, 3), normal, by the axis that is up
    level: FloatArray  # (2,), normal
    clock: float  # Normal
    face: FloatArray  # (6, 3), normal
    wobble: FloatArray  # (U, 3), normal
    servo: FloatArray  # (U,), normal
    start: FloatArray  # (U, 2), from 0 to 1: phase of the encoder, azimuth


def draw_bench(rng: np.random.Generator, turns: Sequence[np.random.Generator]) -> BenchDraws:
    """Draw a bench; each size of rate has a generator of its own, so that it meets the same draws beside any others."""
    drawn = [(each.standard_normal((6, 4)), each.uniform(size=(6, 2))) for each in turns]
    normals, start = (np.concatenate(part) for part in zip(*drawn, strict=True))
    return BenchDraws(  # in the order of the draws
        mount=rng.standard_normal((3, 3)),
        level=rng.standard_normal(2),
        clock=float(rng.standard_normal(1)[0]),
        face=rng.standard_normal((6, 3)),
        wobble=normals[:, :3],
        servo=normals[:, 3],
        start=start,
    )
