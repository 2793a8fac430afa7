"""Errors of a bench (table, faces and hands of the operator) and their random draws.

They are used for motions sample by sample (``sim.motion.bench``), for means dwell by dwell (``sim.table_sessions``) and for the
study's plan. All draws are standard normal or uniform numbers, which are then scaled. So a dwell has the same draws in every
session, for any size of the errors.
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


@stored(keys=OF_TABLE)  # keys of [study.bench]
@dataclass(frozen=True, slots=True, kw_only=True)
class BenchErrors:
    """Standard deviations of the errors of a bench. With zeros, the bench is ideal."""

    # tilt of each face, about each axis, rad
    face_tilt: Annotated[float, Ge(0.0), Key("face_tilt_deg", unit=RADIAN_PER_DEGREE)] = 0.0
    hand_axis: float = 0.0  # tilt of the axis of a turn by hand, about each perpendicular axis, rad
    # misalignment of the device on the rig, about each axis, rad, drawn for each mounting
    mount_tilt: Annotated[float, Ge(0.0), Key("mount_tilt_deg", unit=RADIAN_PER_DEGREE)] = 0.0
    # tilt of the rig's axis from the vertical, about each horizontal axis, rad, drawn once per rig
    level: Annotated[float, Ge(0.0), Key("level_deg", unit=RADIAN_PER_DEGREE)] = 0.0
    # wobble of the table's axis between dwells, or of a plane between angles, about each axis, rad
    wobble: Annotated[float, Ge(0.0), Key("wobble_deg", unit=RADIAN_PER_DEGREE)] = 0.0
    # relative error of rate or frequency, drawn once per rig
    table_rate: Annotated[float, Ge(0.0), Key("table_rate_percent", unit=0.01)] = 0.0
    ripple: float = 0.0  # relative amplitude of a rate error with the period of a turn
    excess: float = 0.0  # relative transient error of the rate at the start of a dwell
    settle_s: float = 0.5  # time constant of that transient, s
    # error of the angle turned in a dwell, rad
    servo: Annotated[float, Ge(0.0), Key("servo_deg", unit=RADIAN_PER_DEGREE)] = 0.0
    encoder_lines: Annotated[int, Ge(0)] = 0  # lines of the table's encoder, four counts each (0: rates without steps)


IDEAL = BenchErrors()


# ---- Draws sample by sample, from named streams.


def level_of(errors: BenchErrors, streams: Streams) -> FloatArray:
    """Return the tilt of a rig from level, as a quaternion in n, (4,)."""
    level_n = np.array([*streams.of("bearing").normal(0.0, errors.level, 2), 0.0])
    size = float(np.linalg.norm(level_n))
    return turn_quaternion(np.cross(level_n, [0.0, 0.0, 1.0]) / (size or 1.0), np.array(size))


def gain_of(errors: BenchErrors, streams: Streams) -> float:
    """Return the ratio of true to nominal rate or frequency of a rig."""
    return 1.0 + float(streams.of("motor").normal(0.0, errors.table_rate))


# ---- Draws dwell by dwell, the same for every session.


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BenchDraws:
    """Random numbers of a bench, the same for all its sessions, with U kinds of dwells."""

    mount: FloatArray  # (3, 3), normal, with a row per axis that is up
    level: FloatArray  # (2,), normal
    clock: float  # normal
    face: FloatArray  # (6, 3), normal
    wobble: FloatArray  # (U, 3), normal
    servo: FloatArray  # (U,), normal
    start: FloatArray  # (U, 2), from 0 to 1: phase of the encoder, azimuth


def draw_bench(rng: np.random.Generator, turns: Sequence[np.random.Generator]) -> BenchDraws:
    """Draw a bench. Each rate has its own generator, so that its draws do not depend on the other rates."""
    draws = [(generator.standard_normal((6, 4)), generator.uniform(size=(6, 2))) for generator in turns]
    normals, start = (np.concatenate(arrays) for arrays in zip(*draws, strict=True))
    return BenchDraws(  # in the order of the draws
        mount=rng.standard_normal((3, 3)),
        level=rng.standard_normal(2),
        clock=float(rng.standard_normal(1)[0]),
        face=rng.standard_normal((6, 3)),
        wobble=normals[:, :3],
        servo=normals[:, 3],
        start=start,
    )
