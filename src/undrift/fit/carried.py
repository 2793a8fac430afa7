"""Gravity in the level frame of the strapdown: the effect of rate and force errors on mean specific forces in motion.

::

    F(t) = R(t) f(t) = g u + a(t)          specific force f, turned by the strapdown R of the rates w into the first frame
    <F>_k + D_k x = g u + e_k              Hann means over 5 s, with the effect D_k of changes x of the model

An error x e of the rate turns all later vectors, and adds (the integral of R e x dt) x F. An error of the force adds itself, turned
by R. A body that returns has no mean acceleration, so the remainder of a is white. Means that overlap by half have a correlation of
one sixth. Remaining model errors turn the frame at random with density q: horizontal means k and l share g^2 q min(t_k, t_l).
Restricted likelihood determines both sizes. A long push (lift, car, bend) looks like a tilt, which increases the sizes and the
uncertainty.
"""

import numpy as np

from undrift.arrays import FloatArray
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

MEAN_S = 5.0  # length of a Hann mean
# Logarithms of both variances, of m/s2 and of rad/sqrt(s): usual values, with a prior range of e^2 for few means [assumed]
_SIZES, _FACTOR = 2.0 * np.log((0.03, 0.1 * RADIAN_PER_DEGREE)), 4.0
_RESTING = 0.05  # factor of both variances at rest [assumed]
_SHARED = 1.0 / 6.0  # correlation of Hann means that half overlap
STEADY = 0.7  # length of the mean direction of gravity over 5 s, below which the device tumbles [assumed]


class CarriedMeans:
    """A stretch of a recording with its Hann means and the sizes of its errors."""

    def __init__(self, time: FloatArray, moving: FloatArray | None = None) -> None:
        """Prepare windows for samples at ``time`` (N,), s. ``moving`` (N,) is 1 in motion and 0 at rest, or None without a rest."""
        self.time = time
        from scipy.linalg import eigh  # imported here for a quick --help

        self.middle = 0.5 * float(time[0] + time[-1])
        width = max(4, round(MEAN_S * (len(time) - 1) / float(time[-1] - time[0])))
        self.first = np.arange(0, len(time) - width + 1, width // 2)
        self.weight = np.hanning(width + 2)[1:-1] / np.hanning(width + 2).sum()
        self.sizes = _SIZES  # logarithms of both variances
        moving = np.ones(len(time)) if moving is None else moving
        share = np.maximum([self.weight @ moving[k : k + width] for k in self.first], _RESTING)
        when = np.cumsum(0.5 * MEAN_S * share)
        rests = share == _RESTING
        # a rest has one mean: several means would determine the sizes
        used_windows = np.flatnonzero(~rests | ~np.append(False, rests[:-1]))
        self.first, scatter, when = self.first[used_windows], np.sqrt(share[used_windows]), when[used_windows]
        distance = np.subtract.outer(used_windows, used_windows)
        shared = np.outer(scatter, scatter) * ((distance == 0) + _SHARED * (abs(distance) == 1))
        # combinations of means that neither error correlates: their variance is white + density walk, without a walk about the
        # vertical
        walk, self.apart = eigh(STANDARD_GRAVITY**2 * np.minimum.outer(when, when), shared)
        self.walk = np.concatenate((walk, walk, np.zeros(len(walk))))

    def means(
        self, rate: FloatArray, force: FloatArray, rate_regressors: FloatArray, force_regressors: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return means (K, 3) of F, and the effect of unit errors of a rate, (K, 3, 3, C), and of a force, (K, 3, 3, D).

        The errors are x_c e_b and y_c e_b for regressors x (N, C) and y (N, D) of rates (N, 3), rad/s, and forces (N, 3), m/s2.
        """
        from undrift.kernels.rotation import carried_means

        count, channels = len(self.first), (rate_regressors.shape[1], force_regressors.shape[1])
        out = np.empty((count, 3 + 9 * sum(channels)))
        w, f, x, y = (
            np.ascontiguousarray(values).reshape(-1) for values in (rate, force, rate_regressors, force_regressors)
        )
        carried_means(w, f, x, y, self.time, self.first, self.weight, out.reshape(-1))
        rate_slopes, force_slopes = np.split(out[:, 3:], [9 * channels[0]], axis=1)
        return out[:, :3], rate_slopes.reshape(count, 3, 3, -1), force_slopes.reshape(count, 3, 3, -1)

    def equations(
        self, mean: FloatArray, design: FloatArray, usual: FloatArray, length: tuple[float, float]
    ) -> tuple[FloatArray, FloatArray]:
        """Return information (P, P) and right side (P,) for changes x of P parameters, without the vertical.

        Means (K, 3) have the ``design`` (K, 3, P). ``usual`` (P,) contains the prior standard deviations of x while the sizes are
        estimated. ``length`` contains gravity and its deviation, m/s2.
        """
        up, unknown = mean.mean(axis=0), design.shape[2]
        frame = np.linalg.svd(up[None])[2][[1, 2, 0]]  # two horizontal axes, and the vertical
        frame[2] *= np.sign(frame[2] @ up)
        mean, design = mean @ frame.T, np.einsum("ij,kjp->kip", frame, design)
        columns = np.concatenate((-design, np.tile(np.eye(3), (len(mean), 1, 1)), mean[:, :, None]), axis=2)
        rows = np.einsum("km,kie->ime", self.apart, columns).reshape(-1, unknown + 4)
        gravity, spread = length

        def solved(sizes: FloatArray) -> tuple[float, FloatArray, FloatArray]:
            white, density = np.exp(sizes)
            variance = white + density * self.walk
            normal = rows.T @ (rows / variance[:, None])
            information, right, cost = normal[:-1, :-1], normal[:-1, -1], float(normal[-1, -1] + np.log(variance).sum())
            information[-1, -1] += 1.0 / spread**2
            right[-1] += gravity / spread**2
            total = information + np.diag(np.append(1.0 / usual**2, np.zeros(3)))
            cost += float(np.linalg.slogdet(total)[1] - right @ np.linalg.solve(total, right))
            return cost + float((((sizes - _SIZES) / _FACTOR) ** 2).sum()), information, right

        from scipy.optimize import minimize

        close = {"xatol": 0.02, "fatol": 0.02}
        self.sizes = minimize(lambda sizes: solved(sizes)[0], self.sizes, method="Nelder-Mead", options=close).x  # type: ignore[call-overload]
        self.cost, information, right = solved(self.sizes)
        inverse = np.linalg.inv(information[unknown:, unknown:])
        gain = information[:unknown, unknown:] @ inverse
        self.left = mean - inverse @ right[unknown:]  # (K, 3), two horizontal components and the vertical one
        self.level = frame, inverse, gain.T, right[unknown:]
        return information[:unknown, :unknown] - gain @ information[unknown:, :unknown], right[:unknown] - gain @ right[
            unknown:
        ]

    def vertical(self, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the vertical (3,) from the last equations, and its covariance for a covariance (P, P) of the parameters."""
        frame, inverse, gain, right = self.level
        return frame.T @ inverse @ right, frame.T @ (inverse + gain @ covariance @ gain.T) @ frame


def tilted_axes(time: FloatArray, force: FloatArray, deviation: float) -> FloatArray:
    """Return the projector (3, 3) onto the axes that leave the vertical by more than accelerometers can measure, in means over 5 s.

    An error of the rate about the vertical does not turn gravity. If an axis stays within ``deviation / g`` of the vertical, rms,
    errors of the accelerometers (``deviation``, m/s2) would seem to determine it. A swing that ends within 5 s does not reveal such
    an error either, because its accelerations look like gravity.
    """
    directions = force / np.linalg.norm(force, axis=1)[:, None]
    means = [part.mean(axis=0) for part in np.array_split(directions, max(1, round((time[-1] - time[0]) / MEAN_S)))]
    steady = [mean / np.linalg.norm(mean) for mean in means if np.linalg.norm(mean) > STEADY]
    # mean square sine of the angle to the vertical, which is 1 while the device tumbles
    mean_squares, axes = np.linalg.eigh(np.eye(3) - sum(np.outer(up, up) for up in steady) / len(means))
    tilts = axes[:, mean_squares > (deviation / STANDARD_GRAVITY) ** 2]
    return np.asarray(tilts @ tilts.T)
