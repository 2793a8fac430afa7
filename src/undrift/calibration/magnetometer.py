"""Magnetometer from motion: hard iron, soft iron, alignment to the gyroscopes and lag, by the field that the motion carries along.

::

    m = K ((B - l C) h(t) + R' G R p) + b + e      reading, mean over 0.25 s, uT; B the mean of R', C its derivative
    m_b = x - l w x x,  x = A (m - b), A = K^-1    corrected field in the axes of the gyroscopes, w their rate
    h(t) = H (-cos d sin c(t), cos d cos c(t), sin d)

R turns the case to level (filter without magnetometer): its heading drifts, so that north lies at c(t), which walks at random. G is
the gradient of the place, p where the sensor is on the hand: what goes with the attitude, else taken for iron. Size H
and inclination d of the field (d < 0 points down) are those of a recording; det A = 1: motion does not show what a uT is.

Errors e, turned to level, are white noise and the disturbance of the place, correlated over the angle that the device turned
through; sizes of both, and of G p, by restricted likelihood. Stretches whose size or inclination is off are left out.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise, permutations, product
from typing import TypeAlias

import numpy as np
from scipy.linalg import block_diag, eigh
from scipy.ndimage import maximum_filter1d, uniform_filter1d
from scipy.optimize import minimize

from undrift.arrays import BoolArray, FloatArray, runs
from undrift.errors import InputError, NotObservable
from undrift.findings import Finding, Level, finding
from undrift.fit.triad import triad_fit
from undrift.frames import rotation
from undrift.model import AXES, Magnetometer, Verdict
from undrift.units import RADIAN_PER_DEGREE

BLOCK_S, KNOT_S = 0.25, 2.0  # of a mean, between knots of c(t)
STRETCH_S, LEAST_S = 150.0, 20.0  # of a stretch, of a recording
# Soft iron of 5 % is usual: twice that; hard iron up to thrice the field; lag of a filter and a slow bus, s [assumed]
SOFT_IRON, HARD_IRON, LAG_S = 0.1, 3.0, 0.02
HEADING_WALK = 0.3 * RADIAN_PER_DEGREE  # rad/sqrt(s), of calibrated gyroscopes [assumed]
PATH = 2.0  # rad, over which the disturbance of the place changes: of 0.5, 2 and 8, seven trials of BROAD choose this
_RESTING = 0.02  # rad/s, by which it changes at rest as well [assumed]
BETWEEN = (
    0.002  # K and b over the field, of one recording against another: fast and slow turns of BROAD's B differ by more
)
# uT, white, of the place, of its gradient times the lever: usual ones, within e^2 where few means say little [assumed]
_SIZES, _FACTOR = np.log((0.3, 0.5, 0.3)), 2.0
# Gradients of a field without sources, symmetric and of trace zero; of length one
_GRADIENTS = np.zeros((5, 3, 3))
_GRADIENTS[[0, 0, 1, 1, 1], [0, 1, 0, 1, 2], [0, 1, 0, 1, 2]] = 1.0, -1.0, 1.0, 1.0, -2.0
_GRADIENTS[[2, 2, 3, 3, 4, 4], [0, 1, 0, 2, 1, 2], [1, 0, 2, 0, 2, 1]] = 1.0
_GRADIENTS /= np.linalg.norm(_GRADIENTS, axis=(1, 2), keepdims=True)
STAGES, _SIZED = 9, (3, 6)  # steps of Gauss-Newton; those in which the sizes are sought
FAR, LEAST_FAR = 4.0, 0.03  # of a disturbed stretch: robust standard deviations, and of the field
SHOWN = 0.5  # of the prior deviation, below which an element counts as seen
ROUGH = 2.0 * RADIAN_PER_DEGREE  # of a heading, 1 sigma
_GLOBAL = 13  # K, b, l


FieldReadings: TypeAlias = tuple[FloatArray, FloatArray, FloatArray]  # time (N,), readings (N, 3), orientation (N, 4)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FieldFit:
    """A magnetometer, and the field of each recording that has one."""

    magnetometer: Magnetometer
    recording: tuple[int, ...]  # (R,), its place among all
    field_ut: FloatArray  # (R,), size of the field
    dip: FloatArray  # (R,), rad, below the horizon
    disturbed: FloatArray  # (R,), share of the time that was left out
    verdict: Verdict


@dataclass(eq=False)
class _FieldStretch:
    """Means of a stretch, and what is its own: log of H, d, G x p, and c at knots."""

    recording: int
    time: FloatArray  # (N,)
    reading: FloatArray  # (N, 3), uT
    turned: FloatArray  # (N, 3, 3), B
    turning: FloatArray  # (N, 3, 3), C
    level: FloatArray  # (N, 3, 3), R
    knots: FloatArray  # (N, J), weight of each knot
    calm: BoolArray  # (N,), not disturbed
    local: FloatArray  # (17 + J,)
    sizes: FloatArray  # (3,), logarithms of standard deviations
    follow: tuple[FloatArray, ...] = ()

    @classmethod
    def of(cls, recording: int, time: FloatArray, mag: FloatArray, q_nb: FloatArray) -> "_FieldStretch":
        matrices = rotation(q_nb).as_matrix()
        block = ((time - time[0]) / BLOCK_S).astype(int)
        first = np.flatnonzero(np.diff(block, prepend=-1))
        last, count = np.append(first[1:], len(time)) - 1, np.diff(np.append(first, len(time)))
        spans = np.maximum(time[last] - time[first], 1e-9)[:, None, None]
        middle = (first + last) // 2
        when = (time[middle] - time[0]) / KNOT_S
        knots = np.maximum(1.0 - np.abs(when[:, None] - np.arange(int(when[-1]) + 2)), 0.0)
        back = matrices.transpose(0, 2, 1)
        return cls(
            recording, time[middle], np.add.reduceat(mag, first) / count[:, None],
            np.add.reduceat(back, first) / count[:, None, None], (back[last] - back[first]) / spans, matrices[middle], knots,
            np.ones(len(first), dtype=bool), np.zeros(17 + knots.shape[1]), _SIZES,
        )  # fmt: skip

    def field(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return h and its derivatives by d and c, (N, 3) each; that by the log of H is h."""
        size, cd, sd = np.exp(self.local[0]), np.cos(self.local[1]), np.sin(self.local[1])
        course = self.knots @ self.local[17:]
        north, ahead = (np.stack((-np.sin(x), np.cos(x), 0.0 * x), axis=1) for x in (course, course + 0.5 * np.pi))
        up = np.array([0.0, 0.0, 1.0])
        return size * (cd * north + sd * up), size * (cd * up - sd * north), size * cd * ahead

    def rows(self, k: FloatArray, b: FloatArray, lag: float) -> FloatArray:
        """Return design and residual turned to level, (N, 3, 13 + 17 + J + 1)."""
        h, by_dip, by_course = self.field()
        turned = self.turned - lag * self.turning
        level = self.level @ np.linalg.inv(k)
        place = np.einsum("tij,njk->nitk", _GRADIENTS, self.level).reshape(-1, 3, 15)
        seen, by_h = np.einsum("nij,nj->ni", turned, h), level @ k @ turned
        columns = [
            np.einsum("nia,nb->niab", level, seen).reshape(-1, 3, 9),
            level,
            -np.einsum("nij,nj->ni", level @ k @ self.turning, h)[..., None],
            *(np.einsum("nij,nj->ni", by_h, part)[..., None] for part in (h, by_dip)),
            place,
            np.einsum("nij,nj->ni", by_h, by_course)[..., None] * self.knots[:, None, :],
            (np.einsum("nij,nj->ni", level, self.reading - seen @ k.T - b) - place @ self.local[2:17])[..., None],
        ]
        return np.concatenate(columns, axis=2)

    def leave_out(self, residual: FloatArray) -> None:
        """Mark stretches in which size or inclination of the field are off, over a second."""
        h, by_dip, _ = self.field()
        self.calm = np.ones(len(h), dtype=bool)
        for along in (h, by_dip):
            off = (residual * along).sum(axis=1) / np.exp(self.local[0])
            off = np.abs(uniform_filter1d(off - np.median(off), 4))
            most = max(FAR * 1.4826 * float(np.median(off)), LEAST_FAR * float(np.exp(self.local[0])))
            self.calm &= ~maximum_filter1d(off > most, 5)

    def equations(self, rows: FloatArray, prior: FloatArray, *, sized: bool) -> tuple[FloatArray, FloatArray]:
        """Return information and right side of K, b and l; ``prior`` (13, 13) holds while the sizes are sought.

        What is its own is eliminated, and how K and b differ between recordings: ``follow`` finds it by the step of the others.
        """
        steps = np.einsum("nij,nij->n", self.level[1:], self.level[:-1])
        angles = np.arccos(np.clip(0.5 * steps - 0.5, -1.0, 1.0)) + _RESTING * np.diff(self.time)
        path = np.append(0.0, np.cumsum(angles))[self.calm]
        place, apart = eigh(np.exp(-np.abs(np.subtract.outer(path, path)) / PATH))
        rows = np.einsum("nk,nij->kij", apart, rows[self.calm])
        walk = np.diff(np.eye(self.knots.shape[1]), axis=0)
        walk = walk.T @ walk / (HEADING_WALK**2 * KNOT_S)

        def solved(sizes: FloatArray) -> tuple[float, FloatArray, FloatArray]:
            white, density, gradient = np.exp(2.0 * sizes)
            of_local = block_diag(1e-9 * np.eye(2), np.eye(15) / gradient, walk)
            variance = np.repeat(white + density * np.maximum(place, 0.0), 3)
            flat = rows.reshape(len(variance), -1)
            normal = flat.T @ (flat / variance[:, None])
            information, seen = normal[:-1, :-1], normal[:-1, -1]
            information[_GLOBAL:, _GLOBAL:] += of_local
            seen[_GLOBAL:] -= of_local @ self.local
            whole = information + block_diag(prior, 1e-6 * np.eye(len(self.local)))
            cost = normal[-1, -1] + np.log(variance).sum() + np.linalg.slogdet(whole)[1] + 15.0 * np.log(gradient)
            cost += self.local @ of_local @ self.local + (((sizes - _SIZES) / _FACTOR) ** 2).sum()
            return float(cost - seen @ np.linalg.solve(whole, seen)), information, seen

        if sized:
            close = {"xatol": 0.05, "fatol": 0.05}
            self.sizes = minimize(lambda x: solved(x)[0], self.sizes, method="Nelder-Mead", options=close).x  # type: ignore[call-overload]
        _, whole, seen = solved(self.sizes)
        inverse, by = np.linalg.inv(whole[_GLOBAL:, _GLOBAL:]), whole[_GLOBAL:, :_GLOBAL]
        self.follow = inverse, by, seen[_GLOBAL:]
        more, right = whole[:_GLOBAL, :_GLOBAL] - by.T @ inverse @ by, seen[:_GLOBAL] - by.T @ inverse @ seen[_GLOBAL:]
        size = np.repeat((1.0, np.exp(self.local[0])), (9, 3))
        apart = more[:, :12] @ np.linalg.inv(more[:12, :12] + np.diag((BETWEEN * size) ** -2))
        return more - apart @ more[:12], right - apart @ right[:12]


def fit_magnetometer(readings: Sequence[FieldReadings | None]) -> FieldFit:
    """Fit the magnetometer of a device to recordings in motion.

    Of each: time (N,), s; readings (N, 3), uT, NaN for gaps; orientation (N, 4), case to level, z up, whose heading may drift; None
    where a recording has no magnetometer.
    Raises InputError for recordings that are short, NotObservable for a device that is not turned.
    """
    numbered = [(number, each) for number, each in enumerate(readings) if each is not None]
    stretches = [stretch for number, each in numbered for stretch in _cut(number, *each)]
    usual, k, b = _start(stretches)
    size = float(np.exp(np.mean([stretch.local[0] for stretch in stretches])))
    lag, spread = 0.0, np.repeat((SOFT_IRON, HARD_IRON * size, LAG_S), (9, 3, 1))
    for stage in range(STAGES):
        gauge = np.append(np.linalg.inv(k).T, np.zeros(4))  # of the log of det K
        prior = np.diag(1.0 / spread**2) + 1e8 * np.outer(gauge, gauge)
        information, towards = prior.copy(), np.concatenate(((usual - k).ravel(), -b, [-lag])) / spread**2
        for stretch in stretches:
            rows = stretch.rows(k, b, lag)
            if stage > 1:
                stretch.leave_out(rows[..., -1])
            if stretch.calm.sum() * BLOCK_S < LEAST_S or np.linalg.det(k) <= 0.0:
                raise NotObservable(
                    f"magnetometer, recording {stretch.recording + 1}: wanted {LEAST_S:g} s or more of a field that turns as the "
                    "gyroscopes do, got less; check its columns, and move away from iron, cables and magnets"
                )
            more, right = stretch.equations(rows, prior, sized=stage in _SIZED)
            information, towards = information + more, towards + right
        covariance = np.linalg.inv(information)
        step = covariance @ towards
        k, b, lag = k + step[:9].reshape(3, 3), b + step[9:12], lag + float(step[12])
        gain = np.cbrt(abs(np.linalg.det(k)))
        k = k / gain
        for stretch in stretches:
            inverse, by, seen = stretch.follow
            stretch.local = stretch.local + inverse @ (seen - by @ step)
            stretch.local[0] += np.log(gain)
    return _result(stretches, k, np.append(b, lag), covariance, usual, spread)


def _cut(number: int, time: FloatArray, mag: FloatArray, q_nb: FloatArray) -> Iterator[_FieldStretch]:
    there = np.isfinite(mag).all(axis=1) & np.isfinite(q_nb).all(axis=1)
    time, mag, q_nb = time[there], mag[there], q_nb[there]
    length = float(time[-1] - time[0]) if len(time) else 0.0
    if length < LEAST_S:
        raise InputError(
            f"magnetometer, recording {number + 1}: wanted readings over {LEAST_S:g} s or more, got {length:.3g} s; leave it out"
        )
    edges = np.linspace(time[0], time[-1], max(1, round(length / STRETCH_S)) + 1)
    edges[-1] += 1.0
    for a, z in pairwise(np.searchsorted(time, edges)):
        yield _FieldStretch.of(number, time[a:z], mag[a:z], q_nb[a:z])


def _start(stretches: list[_FieldStretch]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return how the axes lie to those of the gyroscopes, up to small angles, as K, twice, and b; the field goes to the stretches.

    R A m = h + R A b is linear in A where h and A b are eliminated; of right-handed axes the best is taken: field and axes turned
    about alike look the same.
    """
    square, whole = np.zeros((9, 9)), []
    for stretch in stretches:
        beside = np.concatenate((stretch.level, np.tile(np.eye(3), (len(stretch.level), 1, 1))), axis=2).reshape(-1, 6)
        linear = np.einsum("nij,nk->nijk", stretch.level, stretch.reading).reshape(-1, 9)
        linear -= beside @ np.linalg.lstsq(beside, linear, rcond=None)[0]
        square += linear.T @ linear
        whole.append(beside)
    signs, orders = product((1.0, -1.0), repeat=3), list(permutations(np.eye(3)))
    signed = (np.array(order) * sign for sign in signs for order in orders)
    axes = min((one for one in signed if np.linalg.det(one) > 0.0), key=lambda one: one.ravel() @ square @ one.ravel())
    turned = [np.einsum("nij,nj->ni", one.level @ axes, one.reading).ravel() for one in stretches]
    blocks = block_diag(*(beside[:, 3:] for beside in whole))
    design = np.hstack((np.concatenate([beside[:, :3] for beside in whole]), blocks))
    ab, *fields = np.linalg.lstsq(design, np.concatenate(turned), rcond=None)[0].reshape(-1, 3)
    for stretch, h in zip(stretches, fields, strict=True):
        stretch.local[:2] = np.log(np.linalg.norm(h)), np.arctan2(h[2], np.hypot(h[0], h[1]))
        stretch.local[17:] = np.arctan2(-h[0], h[1])
    return axes.T, axes.T, axes.T @ ab


def _result(
    stretches: list[_FieldStretch], k: FloatArray, others: FloatArray, covariance: FloatArray,
    usual: FloatArray, spread: FloatArray,
) -> FieldFit:  # fmt: skip
    """Return the inverse model with its covariance, judged; others are b and l; K was usual before, within its spread."""
    b, lag = others[:3], float(others[3])
    matrix = np.linalg.inv(k)
    to_matrix = block_diag(-np.kron(matrix, matrix.T), np.eye(4))
    covariance = to_matrix @ covariance @ to_matrix.T
    residuals = [one.rows(k, b, lag)[one.calm][..., -1] for one in stretches]
    of_each = [[*each] for _, each in groupby(stretches, lambda one: one.recording)]
    means = np.array([np.mean([one.local[:2] for one in each], axis=0) for each in of_each])
    fields = np.concatenate([(one.reading - b) @ matrix.T for one in stretches])
    model = triad_fit(
        np.concatenate(residuals).ravel(),
        method="motion", unit_in="uT", unit_out="uT", matrix=matrix, offset=b, covariance=covariance[:12, :12], rank=12,
        condition=float(np.linalg.cond(covariance[:12, :12] / np.outer(spread[:12], spread[:12]))) ** 0.5,
        valid_range=(float(fields.min()), float(fields.max())),
    ).model  # fmt: skip
    magnetometer = Magnetometer(model=model, lag_s=lag, lag_uncertainty_s=float(np.sqrt(covariance[12, 12])))
    disturbed = np.array([1.0 - np.mean(np.concatenate([one.calm for one in each])) for each in of_each])
    verdict = Verdict.of(*_judged(covariance, usual, spread, means), *_disturbed(of_each))
    return FieldFit(
        magnetometer=magnetometer, recording=tuple(each[0].recording for each in of_each), field_ut=np.exp(means[:, 0]),
        dip=-means[:, 1], disturbed=disturbed, verdict=verdict,
    )  # fmt: skip


def _judged(covariance: FloatArray, usual: FloatArray, spread: FloatArray, means: FloatArray) -> Iterator[Finding]:
    """Yield axes that the motion hides, what is left of a heading, and axes that lie otherwise than the gyroscopes'."""
    sigma, size = np.sqrt(np.diag(covariance)), np.exp(means[:, 0])
    widest = sigma[:9].reshape(3, 3).max(axis=0), sigma[9:12]
    soft, hard = (np.abs(usual).T @ one for one in widest)  # gyroscopes' axes
    unseen = ((soft > SHOWN * spread[0]) | (hard > SHOWN * SOFT_IRON * size.mean())) & (hard > 0.2 * hard.max())
    heading = float((np.hypot(soft.max(), hard.max() / size) / np.cos(means[:, 1])).max())
    if unseen.any():
        axes = ", ".join(axis for axis, hidden in zip(AXES, unseen, strict=True) if hidden)
        yield finding("magnetometer.prior", "warn", axes=axes, offset_ut=float(hard.max()))
    elif heading > ROUGH:
        yield finding("magnetometer.heading", "warn", heading_deg=heading / RADIAN_PER_DEGREE)
    if (usual != np.eye(3)).any():
        named = [f"{'-' if row.sum() < 0.0 else '+'}{AXES[int(np.abs(row).argmax())]}" for row in usual]
        yield finding("magnetometer.axes", "info", axes=", ".join(named))


def _disturbed(of_each: list[list[_FieldStretch]]) -> Iterator[Finding]:
    """Yield the stretches of each recording in which the field was another."""
    for each in of_each:
        time, calm = np.concatenate([one.time for one in each]), np.concatenate([one.calm for one in each])
        if calm.all():
            continue
        first, stop = min(runs(~calm), key=lambda span: span[0] - span[1])
        percent, span = 100.0 * float(1.0 - calm.mean()), {"start_s": time[first], "stop_s": time[stop - 1]}
        level: Level = "warn" if percent > 50.0 else "info"
        yield finding("magnetometer.disturbed", level, recording=each[0].recording + 1, percent=percent, **span)
