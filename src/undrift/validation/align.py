"""Alignment: the constant rotation between the device's case and the body that the reference tracks.

Kabsch's problem on rates [1]_: the rotation R that minimises sum |w - R u|^2 over common rates, from the singular value
decomposition of sum w u^T, offsets taken out first. The rates are averaged over the same stretches and the lag is undone.

References
----------
.. [1] W. Kabsch, "A solution for the best rotation to relate two sets of vectors", 1976.
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import AlignmentError
from undrift.record import Record, Reference
from undrift.sync import native_poses, pose_rates
from undrift.sync.rates import RunningIntegral

_LEAST_SPREAD = 0.02  # of the largest singular value: the second axis of turning


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Alignment:
    """Rotation from the device's case b to the body m of the reference.

    Parameters
    ----------
    rotation : array, shape (3, 3)
        R_mb: a vector in b, seen in m.
    angle : float
        Of that rotation, rad.
    residual_rms : float
        Of the rates after the rotation, per axis, rad/s.
    """

    rotation: FloatArray
    angle: float
    residual_rms: float


def align_rates(record: Record, reference: Reference, *, lag_s: float) -> Alignment:
    """Find how the device sits on the body that the reference tracks.

    Parameters
    ----------
    record : Record
        With a gyroscope in rad/s, corrected as well as it can be.
    reference : Reference
        Poses of the body.
    lag_s : float
        How late the record's samples are, s.

    Returns
    -------
    Alignment
        Proper rotation, its angle, and what is left.

    Raises
    ------
    AlignmentError
        The body turned about one axis only, or one of the frames is left-handed.
    """
    rates = pose_rates(native_poses(reference))
    gyro = np.empty((0, 3)) if record.gyro is None else record.gyro
    mean, inside = RunningIntegral(record.time, gyro).mean(rates.start + lag_s, rates.stop + lag_s)
    good = inside & rates.valid
    u, w = mean[good] - mean[good].mean(axis=0), rates.rate[good] - rates.rate[good].mean(axis=0)
    product = w.T @ u
    left, singular, right = np.linalg.svd(product)
    if not singular[1] > _LEAST_SPREAD * singular[0]:
        raise AlignmentError(
            "alignment: wanted turning about two axes or more, got one; turn the device about another axis, or give the "
            "mounting",
            spread=float(singular[1] / max(singular[0], 1e-300)),
        )
    sign = float(np.sign(np.linalg.det(left @ right)))
    if sign < 0.0 and singular[2] > 0.2 * singular[1]:
        raise AlignmentError(
            "alignment: wanted a rotation between two right-handed frames, got a reflection; one axis of the device or of the "
            "reference is reversed"
        )
    rotation = left @ np.diag((1.0, 1.0, sign)) @ right
    cosine = float(np.clip(0.5 * (np.trace(rotation) - 1.0), -1.0, 1.0))
    residual = w - u @ rotation.T
    return Alignment(
        rotation=rotation,
        angle=float(np.arccos(cosine)),
        residual_rms=float(np.sqrt((residual**2).mean())),
    )
