"""Check that device and reference use the same conventions: direction and order of quaternions, vertical axis, acceleration sign.

After a constant rotation R_mb, the rates of the reference must equal the rates of the device. A large residual indicates an
inverted quaternion. The mean of the specific force in n over the whole recording must be gravity, up::

    u = mean_k R(q_k) R_mb f_k / g = (0, 0, 1)          (a motion that returns to its start has no mean acceleration)

If u is along another axis, the vertical axis of the laboratory is wrong. If u = (0, 0, -1), the vertical or the sign of the
acceleration is reversed.
"""

import math
from dataclasses import replace

import numpy as np

from undrift.arrays import FloatArray, interpolated
from undrift.errors import Implausible
from undrift.findings import Finding, finding
from undrift.frames import quaternion_conjugate, rotate
from undrift.model import AXES
from undrift.record import Record, Reference
from undrift.sync import RunningIntegral, native_poses, pose_rates
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

# Shares of the square of the rates that are left over: sound recordings leave 0.001 to 0.04 (BROAD, before calibration)
UNLIKE, LEFT_OVER, EXPLAINED = 0.15, 0.5, 0.1
TILTED, CLEARLY = 30.0 * RADIAN_PER_DEGREE, 60.0 * RADIAN_PER_DEGREE
LENGTH = (0.8, 1.2)  # range of the length of u for matching attitudes and forces
LEAST_RATE = 2.0 * RADIAN_PER_DEGREE  # smallest rms rate that exceeds the noise, rad/s


def common_rates(record: Record, poses: Reference, lag_s: float) -> tuple[FloatArray, FloatArray]:
    """Return the rates of device and reference about their means, (K, 3) each, over the steps that both have seen."""
    rates = pose_rates(poses)
    gyro = np.empty((0, 3)) if record.gyro is None else record.gyro
    mean, inside = RunningIntegral(record.time, gyro).mean(rates.start + lag_s, rates.stop + lag_s)
    good = inside & rates.valid
    return mean[good] - mean[good].mean(axis=0), rates.rate[good] - rates.rate[good].mean(axis=0)


def best_rotation(u: FloatArray, w: FloatArray) -> tuple[FloatArray, FloatArray, bool]:
    """Return the rotation (3, 3) that minimises sum |w - R u|^2, the singular values, and whether a reflection fits better."""
    left, singular, right = np.linalg.svd(w.T @ u)
    sign = float(np.sign(np.linalg.det(left @ right)))
    return left @ np.diag((1.0, 1.0, sign)) @ right, singular, sign < 0.0


def unexplained_share(record: Record, poses: Reference, lag_s: float) -> tuple[float, FloatArray]:
    """Return the share of the rates' square that no rotation between the bodies explains, and the best rotation (3, 3).

    The share is NaN if the motion is too small to compare rates.
    """
    u, w = common_rates(record, poses, lag_s)
    rotation = best_rotation(u, w)[0]
    total = 0.5 * float((w**2).sum() + (u**2).sum())
    enough = len(w) > 0 and math.sqrt(total / len(w)) >= LEAST_RATE
    return float(((w - u @ rotation.T) ** 2).sum()) / total if enough else math.nan, rotation


def check_reference(record: Record, poses: Reference, lag_s: float) -> tuple[Finding, ...]:
    """Return findings on the convention of a reference's poses, or raise an error if it is clearly wrong. The record is in SI."""
    share, rotation = unexplained_share(record, poses, lag_s)
    if math.isnan(share):
        return ()
    if share > LEFT_OVER:
        others = {
            "its quaternions turn level to body, not body to level": quaternion_conjugate(poses.q_nb),
            "its quaternions are x-y-z-w, not w-x-y-z": np.roll(poses.q_nb, 1, axis=1),
        }
        shares = {
            text: unexplained_share(record, native_poses(replace(poses, q_nb=q)), lag_s)[0]
            for text, q in others.items()
        }
        texts = [text for text in sorted(shares, key=lambda text: shares[text]) if shares[text] < EXPLAINED]
        if texts:
            raise _implausible(poses, ", or ".join(texts), "Convert them, or name their order in the map of the file.")
    if share > UNLIKE:
        return (
            finding(
                "validate.rates_differ",
                "warn",
                f"Device and reference do not turn alike: {100.0 * share:.0f} % of the squared rates remain. The "
                "reference is of another segment or trial, or the device moves on the body.",
                "Check that the reference belongs to this body and this trial.",
            ),
        )
    if record.accel is None:
        return ()

    visible = poses.valid & (poses.time + lag_s >= record.time[0]) & (poses.time + lag_s <= record.time[-1])
    force = interpolated(poses.time[visible] + lag_s, record.time, record.accel)
    finite = np.isfinite(force).all(axis=1)
    up = rotate(poses.q_nb[visible][finite], force[finite] @ rotation.T).mean(axis=0) / STANDARD_GRAVITY
    length = float(np.linalg.norm(up))
    angle = math.acos(float(np.clip(up[2] / max(length, 1e-9), -1.0, 1.0)))
    if not LENGTH[0] < length < LENGTH[1] or angle < TILTED:
        return ()
    k = int(np.abs(up).argmax())
    axis = f"{'+' if up[k] > 0.0 else '-'}{AXES[k]}"
    text = f"the axis of its laboratory that points up is {axis}, not +z"
    if axis == "-z":
        text = "acceleration has the opposite sign, or its laboratory is mirrored (left-handed) or upside down"
    if angle > CLEARLY:
        action = "Name the axis of the laboratory that points up (`reference_up`, or up in the map of a table)"
        raise _implausible(poses, text, f"{action}, or correct the sign of the columns.")
    sentence = f"Gravity is {angle / RADIAN_PER_DEGREE:.0f} deg off the vertical of the reference: {text}."
    return (
        finding("validate.not_up", "warn", sentence, "Check the axis that points up, the columns and the mounting."),
    )


def _implausible(poses: Reference, text: str, action: str) -> Implausible:
    name = poses.name or "reference"
    return Implausible(
        f"{name}: the poses do not agree with the readings of the device: {text}. {action}", mistake=text
    )
