"""Faces: which sensor axis points up in a still phase, told by gravity."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError
from undrift.record import Record
from undrift.session import FACES, Face, Still
from undrift.units import RADIAN_PER_DEGREE, is_physical


def still_means(values: FloatArray, stills: Sequence[Still]) -> FloatArray:
    """Return the mean reading of each still phase, gaps left out.

    Parameters
    ----------
    values : array, shape (N, 3)
        Readings of one triad.
    stills : sequence of Still
        Phases of that record.

    Returns
    -------
    array, shape (P, 3)
        Means, same unit.

    Raises
    ------
    InputError
        A phase that is all gap.
    """
    for still in stills:
        if np.isnan(values[still.start : still.stop]).all(axis=0).any():
            raise InputError(
                f"still [{still.start}, {still.stop}): wanted readings, got nothing but gaps; choose another stretch"
            )
    return np.array([np.nanmean(values[s.start : s.stop], axis=0) for s in stills]).reshape(-1, 3)


def label_faces(record: Record, stills: Sequence[Still], *, margin_deg: float = 15.0) -> tuple[Still, ...]:
    """Name the sensor axis that points up in each still phase.

    The axis that reads +g names the face; a pose farther than ``margin_deg`` from every axis stays free (None). Readings in
    counts are centred first by a sphere through the poses (least squares), which needs five poses.

    Parameters
    ----------
    record : Record
        With accelerometer, any unit.
    stills : sequence of Still
        Phases of that record.
    margin_deg : float
        Largest angle between gravity and the axis, deg.

    Returns
    -------
    tuple of Still
        The same phases with faces.

    Raises
    ------
    InputError
        No accelerometer, or counts with fewer than five poses.
    """
    if record.accel is None:
        raise InputError("label_faces: wanted an accelerometer, got a record without; map the accel columns")
    if not stills:
        return ()
    faces = faces_of(still_means(record.accel, stills), centred=is_physical(record.accel_unit), margin_deg=margin_deg)
    return tuple(replace(still, face=face) for still, face in zip(stills, faces, strict=True))


def faces_of(means: FloatArray, *, centred: bool, margin_deg: float = 15.0) -> tuple[Face | None, ...]:
    """Name the axis that points up for each mean reading.

    Parameters
    ----------
    means : array, shape (P, 3)
        Mean accelerometer reading of each pose.
    centred : bool
        True where zero reading is zero force, within a third of gravity; else the centre of a sphere through the poses is taken.
    margin_deg : float
        Largest angle between gravity and the axis, deg.

    Returns
    -------
    tuple of (str or None)
        Faces.

    Raises
    ------
    InputError
        Fewer than five poses to find the centre from.
    """
    up = means if centred else means - _sphere_centre(means)
    up = up / np.linalg.norm(up, axis=1, keepdims=True)
    faces: list[Face | None] = []
    for direction in up:
        axis = int(np.argmax(np.abs(direction)))
        near = abs(direction[axis]) >= np.cos(margin_deg * RADIAN_PER_DEGREE)
        faces.append(FACES[2 * axis + (0 if direction[axis] > 0.0 else 1)] if near else None)
    return tuple(faces)


def _sphere_centre(points: FloatArray) -> FloatArray:
    # |p|^2 = 2 c.p + (r^2 - |c|^2): linear in c.
    if len(points) < 5:
        raise InputError(
            f"label_faces: wanted five poses or more to find the zero of readings in counts, got {len(points)}; "
            "label the faces in session.toml"
        )
    shift = points.mean(axis=0)
    p = points - shift
    design = np.column_stack((2.0 * p, np.ones(len(p))))
    solution = np.linalg.lstsq(design, (p * p).sum(axis=1), rcond=None)[0]
    centre: FloatArray = solution[:3] + shift
    return centre
