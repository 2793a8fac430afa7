"""Calibrate a magnetometer in motion: hard iron, soft iron, alignment to the gyroscopes and lag.

::

    m = K ((B - l C) h(t) + R' G R p) + b + e      reading in uT, mean over 0.25 s (B mean of R', C its derivative)
    m_b = x - l w x x,  x = A (m - b), A = K^-1    corrected field in the axes of the gyroscopes, w their rate
    h(t) = H (-cos d sin c(t), cos d cos c(t), sin d)

R turns the case to level (filter without magnetometer). Its heading drifts, so north is at c(t), a random walk. G is the field
gradient of the room and p the position of the sensor on the hand. G p changes with the attitude, and is mistaken for iron unless it
is fitted. Each recording has its own size H and inclination d of the field (d < 0 points down). Motion does not determine the size
of a uT, so det A = 1.

Errors e, turned to level, are white noise and the disturbance of the room, which is correlated over the angle that the device has
turned. Restricted likelihood determines the sizes of both, and of G p. Stretches with another size or inclination are omitted.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import groupby, pairwise, permutations, product
from typing import TypeAlias

import numpy as np
from scipy.linalg import block_diag, eigh
from scipy.ndimage import maximum_filter1d, uniform_filter1d
from scipy.optimize import minimize

from undrift.arrays import BoolArray, FloatArray, runs
from undrift.errors import InputError, NotObservable
from undrift.findings import Finding, finding
from undrift.fit.gls import carried
from undrift.fit.triad import inverse_jacobian, triad_fit
from undrift.frames import rotation
from undrift.model import AXES, Magnetometer
from undrift.units import RADIAN_PER_DEGREE

BLOCK_S, KNOT_S = 0.25, 2.0  # length of a mean, and distance between knots of c(t)
STRETCH_S, LEAST_S = 150.0, 20.0  # length of a stretch, and shortest recording
# Soft iron: twice the usual 5 %. Hard iron: up to three times the field. Lag of a filter and a slow bus, s. Assumed.
SOFT_IRON, HARD_IRON, LAG_S = 0.1, 3.0, 0.02
HEADING_WALK = 0.3 * RADIAN_PER_DEGREE  # random walk of the heading with calibrated gyroscopes, rad/sqrt(s). Assumed.
PATH = 2.0  # angle over which the room's disturbance changes, rad: the best of 0.5, 2 and 8 in seven BROAD trials
RESTING = 0.02  # equivalent rate at which the disturbance changes at rest, rad/s. Assumed.
BETWEEN = 0.002  # difference of K and b over the field between recordings (larger in device B of BROAD)
# uT: white noise, disturbance of the room, gradient times p. Usual sizes, within a factor of e^2. Assumed.
SIZES, SIZE_RANGE = np.log((0.3, 0.5, 0.3)), 2.0
# gradients of a field without sources, symmetric and of trace zero, of length one
GRADIENTS = np.zeros((5, 3, 3))
GRADIENTS[[0, 0, 1, 1, 1], [0, 1, 0, 1, 2], [0, 1, 0, 1, 2]] = 1.0, -1.0, 1.0, 1.0, -2.0
GRADIENTS[[2, 2, 3, 3, 4, 4], [0, 1, 0, 2, 1, 2], [1, 0, 2, 0, 2, 1]] = 1.0
GRADIENTS /= np.linalg.norm(GRADIENTS, axis=(1, 2), keepdims=True)
STEPS, SIZED = 9, (3, 6)  # Gauss-Newton steps, and the steps at which the sizes are estimated
FAR, LEAST_FAR = 4.0, 0.03  # limits of a disturbed stretch: in robust standard deviations, and relative to the field
ROUGH = 2.0 * RADIAN_PER_DEGREE  # heading uncertainty, 1 sigma
WIDEST = 0.2  # share of the largest uncertainty of hard iron, for the axes that cause most of it
SHARED = 13  # parameters of a device: K, b, l

FieldReadings: TypeAlias = tuple[FloatArray, FloatArray, FloatArray]  # time (N,), readings (N, 3), orientation (N, 4)


@dataclass(kw_only=True, eq=False)
class _FieldStretch:
    """Means of a stretch, and its own parameters: log of H, d, G x p, and c at knots."""

    recording: int
    time: FloatArray  # (N,)
    reading: FloatArray  # (N, 3), uT
    turned: FloatArray  # (N, 3, 3), B
    turning: FloatArray  # (N, 3, 3), C
    level: FloatArray  # (N, 3, 3), R
    knots: FloatArray  # (N, J), weight of each knot
    calm: BoolArray  # (N,), True if not disturbed
    local: FloatArray  # (17 + J,)
    sizes: FloatArray = field(default_factory=SIZES.copy)  # (3,), logarithms of standard deviations

    def field(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return h and its derivatives by d and c, (N, 3) each. The derivative by log H is h."""
        size, cd, sd = np.exp(self.local[0]), np.cos(self.local[1]), np.sin(self.local[1])
        course = self.knots @ self.local[17:]
        north, ahead = (np.stack((-np.sin(x), np.cos(x), 0.0 * x), axis=1) for x in (course, course + 0.5 * np.pi))
        up = np.array([0.0, 0.0, 1.0])
        return size * (cd * north + sd * up), size * (cd * up - sd * north), size * cd * ahead

    def rows(self, k: FloatArray, b: FloatArray, lag: float) -> FloatArray:
        """Return design and residual turned to level, (N, 3, 13 + 17 + J + 1)."""
        h, dip_slope, course_slope = self.field()
        rotation, level = self.turned - lag * self.turning, self.level @ np.linalg.inv(k)
        place = np.einsum("tij,njk->nitk", GRADIENTS, self.level).reshape(-1, 3, 15)
        field, field_jacobian = np.einsum("nij,nj->ni", rotation, h), level @ k @ rotation
        residual = np.einsum("nij,nj->ni", level, self.reading - field @ k.T - b) - place @ self.local[2:17]
        columns = [
            np.einsum("nia,nb->niab", level, field).reshape(-1, 3, 9),
            level,
            -np.einsum("nij,nj->ni", level @ k @ self.turning, h)[..., None],
            *(np.einsum("nij,nj->ni", field_jacobian, slope)[..., None] for slope in (h, dip_slope)),
            place,
            np.einsum("nij,nj->ni", field_jacobian, course_slope)[..., None] * self.knots[:, None, :],
            residual[..., None],
        ]
        return np.concatenate(columns, axis=2)

    def leave_out(self, residual: FloatArray) -> None:
        """Exclude stretches in which the size or inclination of the field, averaged over a second, is wrong."""
        h, dip_slope, _ = self.field()
        self.calm, size = np.ones(len(h), dtype=bool), float(np.exp(self.local[0]))
        for direction in (h, dip_slope):
            deviation = (residual * direction).sum(axis=1) / size
            deviation = np.abs(uniform_filter1d(deviation - np.median(deviation), 4))
            self.calm &= ~maximum_filter1d(
                deviation > max(FAR * 1.4826 * float(np.median(deviation)), LEAST_FAR * size), 5
            )

    def normal(self, rows: FloatArray, prior: FloatArray, *, sized: bool) -> tuple[FloatArray, FloatArray]:
        """Return information and right side of K, b, l and the stretch. ``prior`` (13, 13) is used when the sizes are estimated."""
        steps = np.einsum("nij,nij->n", self.level[1:], self.level[:-1])
        angles = np.arccos(np.clip(0.5 * steps - 0.5, -1.0, 1.0)) + RESTING * np.diff(self.time)
        path = np.append(0.0, np.cumsum(angles))[self.calm]
        place, eigenvectors = eigh(np.exp(-np.abs(np.subtract.outer(path, path)) / PATH))
        rows = np.einsum("nk,nij->kij", eigenvectors, rows[self.calm]).reshape(3 * len(path), -1)
        walk = np.diff(np.eye(self.knots.shape[1]), axis=0)
        walk = walk.T @ walk / (HEADING_WALK**2 * KNOT_S)

        def solved(sizes: FloatArray) -> tuple[float, FloatArray, FloatArray]:
            white, density, gradient = np.exp(2.0 * sizes)
            local_prior = block_diag(1e-9 * np.eye(2), np.eye(15) / gradient, walk)
            variance = np.repeat(white + density * np.maximum(place, 0.0), 3)
            normal = rows.T @ (rows / variance[:, None])
            information, right = normal[:-1, :-1], normal[:-1, -1]
            information[SHARED:, SHARED:] += local_prior
            right[SHARED:] -= local_prior @ self.local
            total = information + block_diag(prior, 1e-6 * np.eye(len(self.local)))
            cost = normal[-1, -1] + np.log(variance).sum() + np.linalg.slogdet(total)[1] + 15.0 * np.log(gradient)
            cost += self.local @ local_prior @ self.local + (((sizes - SIZES) / SIZE_RANGE) ** 2).sum()
            return float(cost - right @ np.linalg.solve(total, right)), information, right

        if sized:
            close = {"xatol": 0.05, "fatol": 0.05}
            self.sizes = minimize(lambda x: solved(x)[0], self.sizes, method="Nelder-Mead", options=close).x  # type: ignore[call-overload]
        return solved(self.sizes)[1:]


def fit_magnetometer(readings: Mapping[int, FieldReadings]) -> tuple[Magnetometer, tuple[Finding, ...]]:
    """Fit the magnetometer of a device to recordings in motion, and return it with findings.

    ``readings`` maps the number of each recording to time (N,), s, readings (N, 3), uT, with NaN for gaps, and orientation (N, 4)
    from case to level, z up, with any heading. Raise InputError for short recordings, NotObservable if the device is not turned.
    """
    stretches = [stretch for number, reading in readings.items() for stretch in _cut(number, *reading)]
    usual, k, b = _start(stretches)
    size = float(np.exp(np.mean([stretch.local[0] for stretch in stretches])))
    lag, spread = 0.0, np.repeat((SOFT_IRON, HARD_IRON * size, LAG_S), (9, 3, 1))
    for number in range(STEPS):
        gauge = np.append(np.linalg.inv(k).T, np.zeros(4))  # gradient of the log of det K
        prior = np.diag(1.0 / spread**2) + 1e8 * np.outer(gauge, gauge)
        information, right = prior.copy(), np.concatenate(((usual - k).ravel(), -b, [-lag])) / spread**2
        followers = list[tuple[FloatArray, FloatArray, FloatArray]]()
        for stretch in stretches:
            rows = stretch.rows(k, b, lag)
            if number > 1:
                stretch.leave_out(rows[..., -1])
            if stretch.calm.sum() * BLOCK_S < LEAST_S or np.linalg.det(k) <= 0.0:
                raise NotObservable(
                    f"magnetometer, recording {stretch.recording + 1}: {LEAST_S:g} s or more of a field that turns as the "
                    f"gyroscopes do are needed. Check its columns, and move away from iron, cables and magnets."
                )
            total, right_part = stretch.normal(rows, prior, sized=number in SIZED)
            # the parameters of a stretch are eliminated, then the difference of K and b between recordings
            inverse, coupling = np.linalg.inv(total[SHARED:, SHARED:]), total[SHARED:, :SHARED]
            followers.append((inverse, coupling, right_part[SHARED:]))
            shared = total[:SHARED, :SHARED] - coupling.T @ inverse @ coupling
            between = np.repeat((BETWEEN, BETWEEN * np.exp(stretch.local[0])), (9, 3))
            share = shared[:, :12] @ np.linalg.inv(shared[:12, :12] + np.diag(between**-2))
            right_part = right_part[:SHARED] - coupling.T @ inverse @ right_part[SHARED:]
            information = information + shared - share @ shared[:12]
            right = right + right_part - share @ right_part[:12]
        covariance = np.linalg.inv(information)
        step = covariance @ right
        k, b, lag = k + step[:9].reshape(3, 3), b + step[9:12], lag + float(step[12])
        gain = np.cbrt(abs(np.linalg.det(k)))
        k = k / gain
        for stretch, (inverse, coupling, right_part) in zip(stretches, followers, strict=True):
            stretch.local = stretch.local + inverse @ (right_part - coupling @ step)
            stretch.local[0] += np.log(gain)
    matrix = np.linalg.inv(k)
    jacobian = block_diag(inverse_jacobian(matrix), np.eye(4))
    covariance = carried(jacobian, covariance)
    fields = np.concatenate([(stretch.reading - b) @ matrix.T for stretch in stretches])
    model = triad_fit(
        np.concatenate([stretch.rows(k, b, lag)[stretch.calm][..., -1] for stretch in stretches]).ravel(),
        method="motion", unit_in="uT", unit_out="uT", matrix=matrix, offset=b, covariance=covariance[:12, :12], rank=12,
        condition=float(np.linalg.cond(covariance[:12, :12] / np.outer(spread[:12], spread[:12]))) ** 0.5,
        valid_range=(float(fields.min()), float(fields.max())),
    ).model  # fmt: skip
    magnetometer = Magnetometer(model=model, lag_s=lag, lag_uncertainty_s=float(np.sqrt(covariance[12, 12])))
    return magnetometer, tuple(_findings(stretches, np.sqrt(np.diag(covariance)), np.abs(usual).T))


def _cut(number: int, time: FloatArray, mag: FloatArray, q_nb: FloatArray) -> Iterator[_FieldStretch]:
    """Yield the means over blocks of each stretch of a recording."""
    finite = np.isfinite(mag).all(axis=1) & np.isfinite(q_nb).all(axis=1)
    length_s = float(np.ptp(time[finite])) if finite.any() else 0.0
    if length_s < LEAST_S:
        raise InputError(
            f"magnetometer, recording {number + 1}: readings over {LEAST_S:g} s or more are needed, got {length_s:.3g} s."
        )
    time, mag, level = time[finite], mag[finite], rotation(q_nb[finite]).as_matrix()
    edges = np.linspace(time[0], time[-1], max(1, round(length_s / STRETCH_S)) + 1)
    edges[-1] += 1.0
    for begin, end in pairwise(np.searchsorted(time, edges)):
        t, inverse = time[begin:end], level[begin:end].transpose(0, 2, 1)
        first = np.flatnonzero(np.diff(((t - t[0]) / BLOCK_S).astype(int), prepend=-1))
        last, count = np.append(first[1:], len(t)) - 1, np.diff(np.append(first, len(t)))
        middle, spans = (first + last) // 2, np.maximum(t[last] - t[first], 1e-9)
        when = (t[middle] - t[0]) / KNOT_S
        knots = np.maximum(1.0 - np.abs(when[:, None] - np.arange(int(when[-1]) + 2)), 0.0)
        yield _FieldStretch(
            recording=number,
            time=t[middle],
            reading=np.add.reduceat(mag[begin:end], first) / count[:, None],
            turned=np.add.reduceat(inverse, first) / count[:, None, None],
            turning=(inverse[last] - inverse[first]) / spans[:, None, None],
            level=level[begin:end][middle],
            knots=knots,
            calm=np.ones(len(first), dtype=bool),
            local=np.zeros(17 + knots.shape[1]),
        )


def _start(stretches: list[_FieldStretch]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return K, the rotation from the gyroscope axes up to small angles (twice), and b. Set the field of the stretches.

    R A m = h + R A b is linear in A if h and A b are eliminated. The best right-handed axes are used.
    """
    square, blocks = np.zeros((9, 9)), list[FloatArray]()
    for stretch in stretches:
        columns = np.concatenate((stretch.level, np.tile(np.eye(3), (len(stretch.level), 1, 1))), axis=2).reshape(-1, 6)
        linear = np.einsum("nij,nk->nijk", stretch.level, stretch.reading).reshape(-1, 9)
        linear -= columns @ np.linalg.lstsq(columns, linear, rcond=None)[0]
        square += linear.T @ linear
        blocks.append(columns)
    signs, orders = product((1.0, -1.0), repeat=3), list(permutations(np.eye(3)))
    signed = [np.array(order) * sign for sign in signs for order in orders]
    axes = min((m for m in signed if np.linalg.det(m) > 0.0), key=lambda m: m.ravel() @ square @ m.ravel())
    level_readings = [np.einsum("nij,nj->ni", stretch.level @ axes, stretch.reading).ravel() for stretch in stretches]
    design = np.hstack(
        (np.concatenate([block[:, :3] for block in blocks]), block_diag(*(block[:, 3:] for block in blocks)))
    )
    ab, *fields = np.linalg.lstsq(design, np.concatenate(level_readings), rcond=None)[0].reshape(-1, 3)
    for stretch, h in zip(stretches, fields, strict=True):
        stretch.local[:2] = np.log(np.linalg.norm(h)), np.arctan2(h[2], np.hypot(h[0], h[1]))
        stretch.local[17:] = np.arctan2(-h[0], h[1])
    return axes.T, axes.T, axes.T @ ab


def _findings(stretches: list[_FieldStretch], sigma: FloatArray, gyro_axes: FloatArray) -> Iterator[Finding]:
    """Yield findings about an uncertain heading, with the axes that cause it, and about disturbed stretches of each recording.

    ``sigma`` (13,) are the standard uncertainties. ``gyro_axes`` (3, 3) moves them to the axes of the gyroscopes.
    """
    soft, hard = gyro_axes @ sigma[:9].reshape(3, 3).max(axis=0), gyro_axes @ sigma[9:12]
    horizontal = [np.exp(stretch.local[0]) * np.cos(stretch.local[1]) for stretch in stretches]
    steepest = min(float(np.cos(stretch.local[1])) for stretch in stretches)
    heading = float(np.hypot(soft.max() / steepest, hard.max() / min(horizontal)))
    if heading > ROUGH:
        axes = tuple(axis for axis, wide in zip(AXES, hard > WIDEST * hard.max(), strict=True) if wide)
        yield finding(
            "magnetometer.heading",
            "warn",
            f"The magnetic heading is uncertain by up to {heading / RADIAN_PER_DEGREE:.2g} deg (1 sigma), mostly from hard and "
            "soft "
            f"iron along {', '.join(axes)} (hard iron: {hard.max():.2g} uT).",
            "Add twenty seconds for each of these axes: hold it level and turn the device about it by a full turn, slowly.",
            axes=axes,
        )
    for recording, group in groupby(stretches, lambda stretch: stretch.recording):
        times, calms = zip(*[(stretch.time, stretch.calm) for stretch in group], strict=True)
        time, calm = np.concatenate(times), np.concatenate(calms)
        if not calm.all():
            first, stop = max(runs(~calm), key=lambda span: span[1] - span[0])
            percent, start_s, stop_s = 100.0 * float(1.0 - calm.mean()), time[first], time[stop - 1]
            yield finding(
                "magnetometer.disturbed",
                "warn" if percent > 50.0 else "info",
                f"The magnetic field was disturbed for {percent:.2g} % of recording {recording + 1}, longest from {start_s:.1f} to "
                f"{stop_s:.1f} s. These stretches were left out.",
                "Keep away from iron, cables and magnets.",
                recording=recording + 1,
                percent=percent,
                start_s=start_s,
                stop_s=stop_s,
            )
