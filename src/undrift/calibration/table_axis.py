"""Table axis: about which axis of the case a rate table really turned, by the gravity felt, and what stays unknown.

In one block (one mounting, axis k of the case along the table's) the device turns about u = k + d, d small and across k. The
table's axis is off the vertical by l, and the accelerometers are off it by an arm r. Dwell i at rate w_i and azimuth psi feels,
across k::

    mean f_i / g = d + mean R_k(-psi) l - r w_i^2 / g          d, l, r two components each: 6 parameters a block

    minimise  sum |residual|^2 / s^2 + |l|^2 / level^2 + |r|^2 / arm^2

psi is the integral of the gyroscope of the axis, so dwells need no whole turns. All blocks share the accelerometers' errors; d of
all is the mean of what is felt and of 0 +- mount, by their covariances. Without accelerometers d = 0 +- mount. The errors that are
left multiply every rate: w_true = (I + D) w, so that

    dM = D M        dG = D G        D = [d_x, d_y, d_z] + diag(relative error of the rate)

Rate: a dwell whose rate ripples once a turn, at a phase unknown, and settles late, by the gyroscope itself. Of block means within
a dwell that turns by theta, with b = sin(theta/2) / (theta/2), ripple of mean square A makes the variance A (1 - b^2) within, and
A b^2 in the mean: none over whole turns. The first half less the second, h, shows a rate that settles: h / 2.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.findings import Finding, finding
from undrift.fit.least_squares import block_size
from undrift.model import AXES, TriadModel, level_of
from undrift.record import RateTable, Record, Turn
from undrift.units import RADIAN_PER_DEGREE

ARM_SD_M = 0.1  # m, of the accelerometers from the table's axis: half the plate of a small table
UNEVEN_PERCENT = (0.1, 2.0)  # of the scale factor, 1 sigma: marginal above the first, bad above the second
_MOUNTED = 4.0  # standard uncertainties: 6 components beyond it: once in 2,600 sessions
_SMALL_ANGLE = 1e-3  # rad: what every case lies off by, however well it is mounted
_LEAST_BLOCKS = 4  # in a dwell, for its unevenness


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TableAxes:
    """The axes of the dwells, and the covariance of what multiplies their rates."""

    axis_b: FloatArray  # (N, 3), unit vectors
    covariance: FloatArray  # (9, 9), of D row by row
    off: FloatArray  # (N,), measured angle between case axis and table axis, rad; NaN where gravity did not show it
    beyond: float  # Largest d as felt, in standard deviations of mounting and measurement; 0 where nothing is felt
    uneven: FloatArray  # (3,), standard uncertainty of the mean rate about x, y, z by ripple and settling, relative


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Dwells:
    """The dwells of a session as its recordings hold them."""

    records: Sequence[Record]
    turns: Sequence[Turn]  # Those with an axis and a rate
    reading: FloatArray  # (N, 3), mean gyroscope reading of each
    up: FloatArray  # (N,), 1 where +axis points up, -1 down, 0 where it is not vertical
    settle_s: float  # Start of each that is left out, s

    def windows(self, k: int) -> slice:
        """Return the settled samples of a dwell."""
        turn = self.turns[k]
        time = self.records[turn.recording].time[turn.start : turn.stop]
        return slice(turn.start + int(np.searchsorted(time, time[0] + self.settle_s)), turn.stop)

    @property
    def own(self) -> FloatArray:
        """Number of the axis of each dwell, (N,)."""
        return np.array([AXES.index(turn.axis or "x") for turn in self.turns], int)

    @property
    def turn_rate(self) -> FloatArray:
        """Stated rate of each dwell, (N,), rad/s."""
        return np.array([turn.turn_rate for turn in self.turns], float)


def table_axes(dwells: Dwells, table: RateTable, accel: TriadModel | None, gravity_m_s2: float) -> TableAxes:
    """Return the axes about which the dwells turned the case."""
    own, rates = dwells.own, dwells.turn_rate
    slope = np.array([_line(rates[own == k], dwells.reading[own == k, k]) for k in range(3)])
    axis_b, off, covariance = np.eye(3)[own], np.full(len(own), np.nan), np.zeros((9, 9))
    beyond = 0.0
    total = np.array([max(float((rates[own == k] ** 2).sum()), 1e-300) for k in range(3)])
    seen: list[tuple[list[int], FloatArray, FloatArray, FloatArray, FloatArray]] = []
    for _, members in groupby(range(len(own)), key=lambda n: (dwells.turns[n].recording, own[n], dwells.up[n])):
        rows = list(members)
        k, up = int(own[rows[0]]), float(dwells.up[rows[0]])
        # D[:, k] of one block, as its part in all dwells about k
        places = np.zeros((9, 2))
        places[[3 * ((k + 1) % 3) + k, 3 * ((k + 2) % 3) + k], [0, 1]] = float((rates[rows] ** 2).sum()) / total[k]
        felt = None if accel is None or up == 0.0 else _felt(dwells, rows, slope[k], table, accel, gravity_m_s2)
        if felt is None or accel is None:
            covariance += (table.mount_tilt_deg * RADIAN_PER_DEGREE) ** 2 * places @ places.T
            continue
        # df = dM s - M do, s = M^-1 g k: what an error of the accelerometers makes of the axis
        at_rest = np.linalg.solve(accel.matrix, np.eye(3)[k])
        jacobian = np.hstack((np.kron(np.eye(3), at_rest), -up / gravity_m_s2 * accel.matrix))
        seen.append((rows, *felt, jacobian[[(k + 1) % 3, (k + 2) % 3]], places))
    if seen and accel is not None:
        tilts, spread, beyond = _with_prior(seen, accel, table)
        for (rows, shown, *_), tilt in zip(seen, tilts, strict=True):
            k = int(own[rows[0]])
            axis_b[np.ix_(rows, [(k + 1) % 3, (k + 2) % 3])] = tilt
            off[rows] = np.hypot(*shown)
        every = np.hstack([part[-1] for part in seen])
        covariance += every @ spread @ every.T
    uneven = rate_unevenness(dwells, slope[:, 0])
    diagonal = np.ix_([0, 4, 8], [0, 4, 8])
    covariance[diagonal] += table.rate_uncertainty**2 + np.diag(uneven**2)
    length = np.linalg.norm(axis_b, axis=1)[:, None]
    return TableAxes(axis_b=axis_b / length, covariance=covariance, off=off, beyond=beyond, uneven=uneven)


def _with_prior(
    seen: list[tuple[list[int], FloatArray, FloatArray, FloatArray, FloatArray]], accel: TriadModel, table: RateTable
) -> tuple[FloatArray, FloatArray, float]:
    """Return d of each block (B, 2), the covariance of all (2B, 2B), and the largest as felt in its standard deviations."""
    felt = np.concatenate([part[1] for part in seen])
    jacobian = np.vstack([part[3] for part in seen])
    spread = jacobian @ accel.covariance[:12, :12] @ jacobian.T
    for block, part in enumerate(seen):
        own = slice(2 * block, 2 * block + 2)
        spread[own, own] += part[2]
    mounted = (table.mount_tilt_deg * RADIAN_PER_DEGREE) ** 2 * np.eye(len(felt))
    gain = np.linalg.solve(spread + mounted, mounted).T
    beyond = float((np.abs(felt) / np.sqrt(np.diag(spread + mounted))).max())
    return (gain @ felt).reshape(-1, 2), mounted - gain @ mounted, beyond


def _line(rate: FloatArray, reading: FloatArray) -> FloatArray:
    """Return scale factor and offset of one sensor, NaN where its dwells do not show them."""
    if len(np.unique(rate)) < 2:
        return np.full(2, np.nan)
    return np.asarray(np.linalg.lstsq(np.column_stack((rate, np.ones_like(rate))), reading, rcond=None)[0])


def _felt(
    dwells: Dwells, rows: list[int], line: FloatArray, table: RateTable, accel: TriadModel, gravity_m_s2: float
) -> tuple[FloatArray, FloatArray] | None:
    """Return d (2,) of one block and its covariance (2, 2), without that of the accelerometers; None where it is not seen."""
    turn, up, k = dwells.turns[rows[0]], float(dwells.up[rows[0]]), int(dwells.own[rows[0]])
    record = dwells.records[turn.recording]
    begin, end = min(dwells.turns[n].start for n in rows), max(dwells.turns[n].stop for n in rows)
    if record.accel is None or record.gyro is None or np.isnan(line).any() or np.isnan(record.gyro[begin:end]).any():
        return None
    rate = (record.gyro[begin:end, k] - line[1]) / line[0]
    step = 0.5 * (rate[1:] + rate[:-1]) * np.diff(record.time[begin:end])
    azimuth = np.concatenate(([0.0], np.cumsum(step)))
    size, up_b, designs, dwell = block_size(record.sample_rate_hz), [], [], []
    for number, n in enumerate(rows):
        window = dwells.windows(n)
        force = (np.asarray(record.accel[window]) - accel.offset) @ accel.matrix.T / gravity_m_s2
        angle = azimuth[window.start - begin : window.stop - begin]
        parts = np.column_stack((np.cos(angle), np.sin(angle), up * force[:, [(k + 1) % 3, (k + 2) % 3]]))
        count = len(parts) // size
        means = parts[: count * size].reshape(count, size, 4).mean(axis=1)
        for cosine, sine, *across in means[~np.isnan(means).any(axis=1)]:
            square = dwells.turn_rate[n] ** 2 / gravity_m_s2
            designs += [[1.0, 0.0, cosine, sine, square, 0.0], [0.0, 1.0, -sine, cosine, 0.0, square]]
            up_b += across
            dwell += [number, number]
    if len(set(dwell)) < len(rows):
        return None
    level = max(table.table_level_deg * RADIAN_PER_DEGREE, 1e-9)
    precision = np.array([0.0, 0.0, level**-2, level**-2, ARM_SD_M**-2, ARM_SD_M**-2])
    wobble = table.wobble_deg * RADIAN_PER_DEGREE
    return _posterior(np.array(designs), np.array(up_b), np.array(dwell), wobble, precision)


def _posterior(
    design: FloatArray, reading: FloatArray, dwell: IntArray, wobble: float, precision: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the first two parameters and their covariance: block means (E,) of dwells, which wobble moves as wholes."""
    dwells, spare = int(dwell[-1]) + 1, len(reading) - design.shape[1]
    each = len(reading) / (2.0 * dwells)  # block means of one component in a dwell
    variance = 1.0
    for _ in range(4):
        inverse = np.linalg.inv(design.T @ design / variance + np.diag(precision))
        theta = inverse @ design.T @ reading / variance
        left = reading - design @ theta
        within = float(left @ left) / max(spare - 2, 1)
        whole = np.concatenate([np.bincount(dwell[c::2], left[c::2]) for c in (0, 1)])  # sums over each dwell
        between = float(whole @ whole) / each / max(2 * dwells - design.shape[1], 1)
        variance = max(within + each * wobble**2, between, 1e-18)
    return theta[:2], inverse[:2, :2]


def rate_unevenness(dwells: Dwells, scale: FloatArray) -> FloatArray:
    """Return how uncertain ripple and settling leave the mean rate about each axis, relative, 1 sigma, (3,)."""
    own, rates = dwells.own, dwells.turn_rate
    means = [_block_means(dwells, n) for n in range(len(own))]
    uneven = np.zeros(3)
    for k in range(3):
        rows = [int(n) for n in np.flatnonzero(own == k) if len(means[n]) >= _LEAST_BLOCKS and rates[n] != 0.0]
        others = [means[int(n)][:, k] for n in np.flatnonzero(own != k) if len(means[n]) > 1]
        if not rows or not np.isfinite(scale[k]):
            continue
        spare = sum(len(part) - 1 for part in others)
        noise = sum(float(((part - part.mean()) ** 2).sum()) for part in others) / spare if spare else 0.0
        w = rates[rows] * scale[k]
        parts = [means[n][:, k] for n in rows]
        halves = np.array([p[: len(p) // 2].mean() - p[-(len(p) // 2) :].mean() for p in parts])
        settle = float(w @ halves / (w @ w))
        of_noise = noise * float(w**2 @ [2.0 / (len(p) // 2) for p in parts]) / float(w @ w) ** 2
        late = max(0.0, settle**2 - of_noise) / 4.0
        half = 0.5 * np.abs(rates[rows]) * [_duration(dwells, n) for n in rows]
        kept = np.sin(half) / half  # b
        excess = np.array([p.var(ddof=1) for p in parts]) - noise - late * w**2
        ripple = max(0.0, float(w**2 @ excess) / max(float(w**4 @ (1.0 - kept**2)), 1e-300))
        uneven[k] = np.sqrt(late + ripple * (float(w**2 @ kept) / float(w @ w)) ** 2)
    return uneven


def _duration(dwells: Dwells, n: int) -> float:
    window = dwells.windows(n)
    return float(window.stop - window.start) / dwells.records[dwells.turns[n].recording].sample_rate_hz


def _block_means(dwells: Dwells, n: int) -> FloatArray:
    record = dwells.records[dwells.turns[n].recording]
    values = np.asarray(record.gyro)[dwells.windows(n)]
    size = block_size(record.sample_rate_hz)
    count = len(values) // size
    return np.asarray(values[: count * size].reshape(count, size, 3).mean(axis=1))


def table_findings(axes: TableAxes, mount_tilt: float) -> Iterator[Finding]:
    """Yield what the axes of a table show that a user can act on."""
    if np.isfinite(axes.off).any():
        off = float(np.nanmax(axes.off))
        beyond = axes.beyond > _MOUNTED and off > _SMALL_ANGLE
        degrees, stated = off / RADIAN_PER_DEGREE, mount_tilt / RADIAN_PER_DEGREE
        yield finding("rate_table.mounting", "warn" if beyond else "info", angle_deg=degrees, stated_deg=stated)
    worst = 100.0 * float(axes.uneven.max())
    if worst > UNEVEN_PERCENT[0]:
        axis, wanted = AXES[int(axes.uneven.argmax())], UNEVEN_PERCENT[0]
        level = level_of(worst, UNEVEN_PERCENT)
        yield finding("rate_table.uneven_rate", level, axis=axis, uncertainty_percent=worst, wanted=wanted)


def with_table(model: TriadModel, covariance: FloatArray) -> TriadModel:
    """Return a model of rates whose covariance also holds what multiplies every rate, (9, 9)."""
    jacobian = np.zeros((len(model.covariance), 9))
    jacobian[:9] = np.kron(np.eye(3), model.matrix.T)
    if model.g_sensitivity is not None:
        jacobian[12:21] = np.kron(np.eye(3), model.g_sensitivity.T)
    return replace(model, covariance=model.covariance + jacobian @ covariance @ jacobian.T)
