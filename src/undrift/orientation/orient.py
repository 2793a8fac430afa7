"""Orient a record: initial tilt at a still phase, strapdown from there forward and back.

The tilt holds at the last sample of the still phase. Before it, each step is undone: q_(k-1) = q_k exp(-w_k (t_k - t_(k-1))).
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from undrift.arrays import FloatArray, frozen
from undrift.calibration.model import TriadModel
from undrift.errors import InputError
from undrift.orientation.angles import heading_of, inclination_of, sagittal_pitch
from undrift.orientation.strapdown import check_gaps, integrate_strapdown
from undrift.orientation.tilt import Tilt, initial_tilt
from undrift.record import Record
from undrift.session import Face, Still

LONGEST_HOLE_S = 0.1  # a person turns by 10 deg in it


@dataclass(frozen=True, slots=True, kw_only=True)
class OrientSettings:
    """How a record is oriented.

    Parameters
    ----------
    offset : str
        "none", or "rest": the mean rate of the still phase is taken off, which also takes off a true slow turn.
    heading : float
        Heading at the still phase, rad.
    forward, up : str
        Device axes that point forward and up on the upright segment; they define the pitch.
    """

    offset: Literal["none", "rest"] = "none"
    heading: float = 0.0
    forward: Face = "+x"
    up: Face = "+z"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Orientation:
    """Orientation of the device case over time.

    Parameters
    ----------
    time : array, shape (N,)
        s, the record's clock.
    q_nb : array, shape (N, 4)
        b to n, w-x-y-z.
    inclination : array, shape (N,)
        Angle of the body's z from the vertical, rad.
    heading : array, shape (N,)
        Turn about the vertical, rad.
    pitch : array, shape (N,)
        Gravity in the sagittal plane, forward lean positive, rad.
    tilt : Tilt
        Orientation at the still phase, with its uncertainty.
    still : Still
        That phase.
    offset : array, shape (3,)
        Rate that was taken off, rad/s.
    """

    time: FloatArray
    q_nb: FloatArray
    inclination: FloatArray
    heading: FloatArray
    pitch: FloatArray
    tilt: Tilt
    still: Still
    offset: FloatArray

    def __post_init__(self) -> None:
        n = len(self.time)
        shapes: tuple[tuple[str, tuple[int, ...]], ...] = (
            ("time", (n,)),
            ("q_nb", (n, 4)),
            ("inclination", (n,)),
            ("heading", (n,)),
            ("pitch", (n,)),
            ("offset", (3,)),
        )
        for name, shape in shapes:
            object.__setattr__(self, name, frozen(getattr(self, name), shape, f"Orientation.{name}"))


def orient(
    record: Record,
    still: Still | None = None,
    settings: OrientSettings = OrientSettings(),
    *,
    accel_model: TriadModel | None = None,
) -> Orientation:
    """Find the orientation of the device at every sample.

    Parameters
    ----------
    record : Record
        Rate and specific force in physical units, best corrected.
    still : Still, optional
        Where the device stood still; the first still phase that is found when absent.
    settings : OrientSettings
        Offset, heading and axes.
    accel_model : TriadModel, optional
        The accelerometer's model, whose covariance then counts in the uncertainty of the tilt.

    Returns
    -------
    Orientation
        Quaternions, angles, and the tilt that they rest on.

    Raises
    ------
    InputError
        No gyroscope, no still phase, gaps, holes in time, a dead axis, or readings in counts.
    """
    record = record.in_si()
    if record.gyro is None:
        raise InputError("orient: wanted gyroscope readings, got none; map the columns that hold them")
    _check_whole(record.time, record.gyro)
    still = _first_still(record) if still is None else still
    tilt = initial_tilt(record, still, heading=settings.heading, accel_model=accel_model)
    offset = record.gyro[still.start : still.stop].mean(axis=0) if settings.offset == "rest" else np.zeros(3)
    q = _both_ways(record.gyro - offset, record.time, tilt.q_nb, still.stop - 1)
    return Orientation(
        time=record.time,
        q_nb=q,
        inclination=inclination_of(q),
        heading=heading_of(q),
        pitch=sagittal_pitch(q, forward=settings.forward, up=settings.up),
        tilt=tilt,
        still=still,
        offset=offset,
    )


def _check_whole(time: FloatArray, gyro: FloatArray) -> None:
    """Raise where readings are missing for longer than a motion can be bridged, or where an axis is dead."""
    check_gaps(gyro, time, "orient")
    steps = np.diff(time)
    holes = np.flatnonzero(steps > max(LONGEST_HOLE_S, 5.0 * float(np.median(steps))))
    if len(holes):
        at = int(holes[0])
        raise InputError(
            f"orient: wanted readings without holes over {LONGEST_HOLE_S:g} s, got {len(holes)}, the first of {steps[at]:.3g} s at "
            f"{time[at]:.6g} s; after a hole the orientation is unknown: orient each stretch with a rest of its own",
            hole_s=float(steps[at]),
        )
    dead = [axis for axis, moves in zip("xyz", np.ptp(gyro, axis=0) > 0.0, strict=True) if not moves]
    if dead and len(dead) < 3:
        raise InputError(
            f"orient: wanted three gyroscopes that turn, got {', '.join(dead)} at one value throughout; check them"
        )


def _first_still(record: Record) -> Still:
    from undrift.segments import find_still

    found = find_still(record)
    if not found.stills:
        reason = found.reason.removeprefix("no still phase: ")
        raise InputError(
            f"orient: wanted a still phase, got none: {reason}; name a stretch at rest (--still-start-s, --still-stop-s), or "
            "record with a pause"
        )
    return found.stills[0]


def _both_ways(gyro: FloatArray, time: FloatArray, q_nb: FloatArray, anchor: int) -> FloatArray:
    q = np.empty((len(time), 4))
    q[anchor:] = integrate_strapdown(gyro[anchor:], time[anchor:], q_nb)
    undone = np.vstack((np.zeros(3), -gyro[anchor:0:-1]))  # the step that led to sample k, backwards, leads to k - 1
    q[: anchor + 1] = integrate_strapdown(undone, -time[anchor::-1], q_nb)[::-1]
    return q
