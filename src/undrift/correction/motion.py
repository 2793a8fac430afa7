"""Offset from motion: what gravity, carried along by the strapdown, shows of the gyroscopes' offset while the device moves.

::

    F(t) = R(t) f(t) = g u + a(t)          specific force f, turned by the strapdown R of the rates w into the first frame
    R of w - b  =  (I - [J b]x) R          J(t) = integral of R dt: an offset b turns all that follows
    <F>_k = g u - A_k b + P_k d + e_k      Hann means over 5 s; A_k = <[F]x J>_k, P_k = <R>_k, d offset of the accelerometers

A body that comes back has no mean acceleration: what is left of a is white, and means that half overlap share a sixth. What the
calibration leaves turns the frame at random with density q: horizontal means k and l share g^2 q min(t_k, t_l). Both sizes are
those of greatest restricted likelihood. b, d and the vertical u are found by generalised least squares, linearised anew about
the last b (Gauss-Newton). Long recordings are cut into stretches, each with a vertical, an offset and sizes of its own; offsets
follow a random walk from one stretch to the next.

The prior of b is the mean at a rest; where there is none, what a calibration or a data sheet leaves of it. Gravity shows no turn
about the vertical: along an axis that stays upright b keeps its prior. A long push (lift, car, bend) reads as a tilt: it enters the
sizes, and widens what is stated.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.linalg import eigh
from scipy.optimize import minimize

from undrift.arrays import FloatArray, frozen
from undrift.correction.rest import LEAST_IN_MOTION_S, MOVED, RestOffset
from undrift.errors import InputError
from undrift.findings import Finding, finding
from undrift.kernels.rotation import carried_means
from undrift.model import OFFSET_NAMES, TriadModel
from undrift.record import Record, Still
from undrift.segments import unpadded
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, si_factor

MEAN_S, STRETCH_S, SHORT_S = 5.0, 300.0, 25.0  # s, of a Hann mean, of a stretch, of those from which a start is found
WALK = 2e-4 * RADIAN_PER_DEGREE  # rad/s/sqrt(s), of a consumer gyroscope's offset [assumed]
# m/s2, offset of accelerometers, and share by which their size of gravity is off: calibrated, and by data sheets [assumed]
CALIBRATED, RAW = (0.05, 0.005), (0.5, 0.03)
# Logarithms of both variances, of m/s2 and of rad/sqrt(s): usual ones, within e^2 each way where few means say little [assumed]
_SIZES, _FACTOR = 2.0 * np.log((0.03, 0.1 * RADIAN_PER_DEGREE)), 4.0
# rad/s, of an offset without a rest: turn-on repeatability of a calibrated device, and a raw one's zero-rate output [assumed]
CALIBRATED_RATE, RAW_RATE = 0.1 * RADIAN_PER_DEGREE, 1.0 * RADIAN_PER_DEGREE
_UNRESTED = 1.6  # error without a rest over what the equations state of it: 30 simulated people who move freely
_LOOSE = 1.0 * RADIAN_PER_DEGREE  # rad/s, of the offset while the sizes are sought
_SHARED = 1.0 / 6.0  # correlation of Hann means that half overlap
_SHOWN = ("offset_dps", "uncertainty_dps", "prior_dps", "acceleration_m_s2")
_ROUNDS, _SETTLED = 8, 1e-7  # of linearisation; rad/s


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MotionOffset:
    """The offset that motion shows, in the middle of each stretch."""

    time: FloatArray  # (S,), s
    rate: FloatArray  # (S, 3), rad/s, frame b
    covariance: FloatArray  # (S, 3, 3), (rad/s)^2
    prior: FloatArray  # (3,), standard deviation of what was known before, rad/s
    acceleration: float  # What is left of it in a mean, rms, m/s2
    rest: RestOffset | None  # What it began with; None where it never rested
    vertical: (
        FloatArray  # (3,), specific force of a body at rest in the attitude of the first sample, m/s2, frame b there
    )
    vertical_covariance: FloatArray  # (3, 3), (m/s2)^2

    def __post_init__(self) -> None:
        count = len(self.time)
        shapes = {"time": (count,), "rate": (count, 3), "covariance": (count, 3, 3), "prior": (3,)}
        shapes |= {"vertical": (3,), "vertical_covariance": (3, 3)}
        for name, shape in shapes.items():
            object.__setattr__(self, name, frozen(getattr(self, name), shape, f"MotionOffset.{name}"))

    def at(self, time: FloatArray) -> FloatArray:
        """Return the offset (N, 3) at times (N,), linear between stretches."""
        return np.stack([np.interp(time, self.time, axis) for axis in self.rate.T], axis=1)

    @property
    def uncertainty(self) -> float:
        """Standard uncertainty of the worst stretch, all axes together, rad/s."""
        return float(np.sqrt(np.trace(self.covariance, axis1=1, axis2=2).max()))

    @property
    def rest_s(self) -> tuple[float, float] | None:
        """First and last sample of the rest, on the recording's clock."""
        return None if self.rest is None else self.rest.rest_s

    @property
    def stills(self) -> tuple[Still, ...] | None:
        """Rests that were found on the way; None for a named stretch."""
        return None if self.rest is None else self.rest.stills

    @property
    def figures(self) -> dict[str, Any]:
        """What was subtracted, as JSON has it."""
        spread = np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2).max(axis=0))
        return {
            "rest_s": self.rest_s,
            "offset_dps": self.rate.mean(axis=0) / RADIAN_PER_DEGREE,
            "offset_uncertainty_dps": spread / RADIAN_PER_DEGREE,
            "prior_dps": self.prior / RADIAN_PER_DEGREE,
            "acceleration_m_s2": self.acceleration,
        }

    @property
    def finding(self) -> Finding:
        """What was subtracted, in words."""
        _, *figures = self.figures.values()
        return finding("correct.motion_offset", "info", **dict(zip(_SHOWN, figures, strict=True)))


def find_motion_offset(record: Record, rest: RestOffset | None, model: TriadModel | None = None) -> MotionOffset:
    """Return the offset that the motion of a corrected record shows, beside the mean at a rest or what its model leaves."""
    record = unpadded(record)
    advice = "record with a pause at rest" if rest is None else "use `offset` rest"
    if record.gyro is None or record.accel is None:
        raise InputError(f"offset from motion: wanted rates and specific force, got one of them; {advice}")
    gaps = int((~np.isfinite(np.hstack((record.gyro, record.accel)))).any(axis=1).sum())
    if gaps or record.duration_s < LEAST_IN_MOTION_S:
        got = f"{gaps} gaps (NaN)" if gaps else f"{record.duration_s:.3g} s"
        raise InputError(
            f"offset from motion: wanted {LEAST_IN_MOTION_S:g} s or more without gaps, got {got}; {advice}"
        )
    prior = _unrested(model) if rest is None else rest.covariance + np.eye(3) * MOVED**2
    usual = np.zeros(3) if rest is None else rest.rate
    stretches, offsets, information = _fitted(record, usual, usual, prior, STRETCH_S)
    if rest is None:  # over a whole recording the vertical may turn too far for a linearisation about no offset
        short = _fitted(record, usual, usual, prior, SHORT_S)[1][:-3].reshape(-1, 3).mean(axis=0)
        other = _fitted(record, short, usual, prior, STRETCH_S)
        if sum(one.cost for one in other[0]) < sum(one.cost for one in stretches):
            stretches, offsets, information = other
    covariance, count = np.linalg.inv(information), 3 * len(stretches)
    covariance *= _UNRESTED**2 if rest is None else 1.0
    first = np.r_[:3, count : count + 3]
    vertical, of_vertical = stretches[0].vertical(covariance[np.ix_(first, first)])
    return MotionOffset(
        vertical=vertical,
        vertical_covariance=of_vertical,
        time=np.array([one.middle for one in stretches]),
        rate=offsets[:count].reshape(-1, 3),
        covariance=np.stack([covariance[k : k + 3, k : k + 3] for k in range(0, count, 3)]),
        prior=np.sqrt(np.diag(prior)),
        acceleration=float(np.sqrt(np.mean([np.exp(one.sizes[0]) for one in stretches]))),
        rest=rest,
    )


def _fitted(
    record: Record, near: FloatArray, usual: FloatArray, prior: FloatArray, stretch_s: float
) -> "tuple[list[_HannMeans], FloatArray, FloatArray]":
    """Return stretches of about a length, offsets of each and of the accelerometers, and their information; near is a start."""
    edges = np.linspace(0, len(record), max(1, round(record.duration_s / stretch_s)) + 1).astype(int)
    force, rate, error = np.asarray(record.accel), np.asarray(record.gyro), record.accel_uncertainty
    calibrated = error is not None and np.diag(error.covariance)[9:].max() < RAW[0] ** 2 / 4.0
    accel = CALIBRATED if calibrated else RAW
    stretches = [_HannMeans(record.time[a:b], rate[a:b], force[a:b], accel) for a, b in pairwise(edges)]
    middle, count = np.array([one.middle for one in stretches]), 3 * len(stretches)
    walk_of_offsets = _walk_information(middle, prior, accel[0])
    start, theta = (np.append(np.tile(one, len(stretches)), np.zeros(3)) for one in (usual, near))
    for _ in range(_ROUNDS):
        information, seen = walk_of_offsets.copy(), walk_of_offsets @ (start - theta)
        for k, one in enumerate(stretches):
            places = np.r_[3 * k : 3 * k + 3, count : count + 3]
            own, towards = one.equations(*theta[places].reshape(2, 3))
            information[np.ix_(places, places)] += own
            seen[places] += towards
        step = np.linalg.solve(information, seen)
        theta = theta + step
        if np.abs(step[:count]).max() < _SETTLED:
            break
    return stretches, theta, information


def _unrested(model: TriadModel | None) -> FloatArray:
    """Return the covariance of an offset that no rest shows: that of the calibration, and what a switch-on changes."""
    if model is None or not model.covariance.any():
        return np.eye(3) * RAW_RATE**2
    offset = [model.parameters.index(name) for name in OFFSET_NAMES]
    turned = model.matrix * si_factor(model.unit_out, "rate")
    spread: FloatArray = turned @ model.covariance[np.ix_(offset, offset)] @ turned.T
    return spread + np.eye(3) * CALIBRATED_RATE**2


def _walk_information(middle: FloatArray, prior: FloatArray, accel: float) -> FloatArray:
    """Return what is known of offsets (S, 3) that begin with a prior and walk, and of the accelerometers': information."""
    count = 3 * len(middle)
    information = np.zeros((count + 3, count + 3))
    information[:3, :3], information[count:, count:] = np.linalg.inv(prior), np.eye(3) / accel**2
    for k, length in enumerate(np.diff(middle)):
        here = slice(3 * k, 3 * k + 6)
        information[here, here] += np.kron([[1.0, -1.0], [-1.0, 1.0]], np.eye(3)) / (WALK**2 * length)
    return information


class _HannMeans:
    """A stretch of a recording: its Hann means, and the sizes of what disturbs them."""

    def __init__(self, time: FloatArray, rate: FloatArray, force: FloatArray, accel: tuple[float, float]) -> None:
        self.time, self.rate, self.force, self.accel = time, rate, force, accel
        self.middle = 0.5 * float(time[0] + time[-1])
        width = max(4, round(MEAN_S * (len(time) - 1) / float(time[-1] - time[0])))
        self.first = np.arange(0, len(self.time) - width + 1, width // 2)
        self.weight = np.hanning(width + 2)[1:-1] / np.hanning(width + 2).sum()
        self.sizes = _SIZES
        count = len(self.first)
        shared = np.eye(count) + _SHARED * (np.eye(count, k=1) + np.eye(count, k=-1))
        when = MEAN_S * (0.5 + 0.5 * np.arange(count))
        # combinations of means that neither error correlates: their variance is white + density walk, none about the vertical
        walk, self.apart = eigh(STANDARD_GRAVITY**2 * np.minimum.outer(when, when), shared)
        self.walk = np.concatenate((walk, walk, np.zeros(count)))

    def equations(self, offset: FloatArray, of_force: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return information (6, 6) and right side (6,) for changes of the offsets of both triads, the vertical eliminated."""
        mean, design = self._means(offset, of_force)
        up = mean.mean(axis=0)
        frame = np.linalg.svd(up[None])[2][[1, 2, 0]]  # two horizontal axes, and the vertical
        frame[2] *= np.sign(frame[2] @ up)
        mean, design = mean @ frame.T, np.einsum("ij,kjp->kip", frame, design)
        columns = np.concatenate((-design, np.tile(np.eye(3), (len(mean), 1, 1)), mean[:, :, None]), axis=2)
        rows = np.einsum("km,kie->ime", self.apart, columns).reshape(-1, 10)
        accel, scale = self.accel

        def solved(sizes: FloatArray) -> tuple[float, FloatArray, FloatArray]:
            white, density = np.exp(sizes)
            variance = white + density * self.walk
            known = rows.T @ (rows / variance[:, None])
            information, seen, cost = known[:9, :9], known[:9, 9], float(known[9, 9] + np.log(variance).sum())
            information[8, 8] += 1.0 / (scale * STANDARD_GRAVITY) ** 2
            seen[8] += 1.0 / (scale**2 * STANDARD_GRAVITY)
            whole = information + np.diag([1.0 / _LOOSE**2] * 3 + [1.0 / accel**2] * 3 + [0.0] * 3)
            cost += float(np.linalg.slogdet(whole)[1] - seen @ np.linalg.solve(whole, seen))
            return cost + float((((sizes - _SIZES) / _FACTOR) ** 2).sum()), information, seen

        close = {"xatol": 0.02, "fatol": 0.02}
        self.sizes = minimize(lambda sizes: solved(sizes)[0], self.sizes, method="Nelder-Mead", options=close).x  # type: ignore[call-overload]
        self.cost, information, seen = solved(self.sizes)
        gone = information[:6, 6:] @ np.linalg.inv(information[6:, 6:])
        self.level = frame, np.linalg.inv(information[6:, 6:]), gone.T, seen[6:]
        return information[:6, :6] - gone @ information[6:, :6], seen[:6] - gone @ seen[6:]

    def vertical(self, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the vertical (3,) by the last equations, and its covariance by that of both offsets (6, 6)."""
        frame, alone, by_offsets, seen = self.level
        return frame.T @ alone @ seen, frame.T @ (alone + by_offsets @ covariance @ by_offsets.T) @ frame

    def _means(self, offset: FloatArray, of_force: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the means (K, 3) and what offsets of gyroscopes and accelerometers add to them (K, 3, 6)."""
        out = np.empty((len(self.first), 21))
        rate, force = ((a - b).reshape(-1) for a, b in ((self.rate, offset), (self.force, of_force)))
        carried_means(rate, force, self.time, self.first, self.weight, out.reshape(-1))
        turned, fixed = out[:, 3:12].reshape(-1, 3, 3), out[:, 12:].reshape(-1, 3, 3)
        return out[:, :3], np.concatenate((turned, -fixed), axis=2)
