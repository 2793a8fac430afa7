"""Table axis: about which axis of the case a rate table really turned, by the gravity felt, and what stays unknown.

In one mounting, axis k of the case along the table's, the device turns about u = k + d, d small and across k. The table's axis is
off the vertical by l, and the accelerometers are off it by an arm r. Dwell i at rate w_i and azimuth psi feels, across k::

    mean f_i / g = d + mean R_k(-psi) l - r w_i^2 / g          d, l, r two components each, l anew for each recording

    minimise  sum |residual|^2 / s^2 + |l|^2 / level^2 + |r|^2 / arm^2

psi is the integral of the gyroscope of the axis within a recording, so dwells need no whole turns. All mountings share the
accelerometers' errors; d of all is the mean of what is felt and of 0 +- mount, by their covariances, and without accelerometers
0 +- mount. The errors that are left multiply every rate: w_true = (I + D) w, so that

    dM = D M        dG = D G        D = [d_x, d_y, d_z] + diag(relative error of the rate)

Rate: a dwell whose rate ripples once a turn, at a phase unknown, and settles late, by the gyroscope itself. Of block means within
a dwell that turns by theta, with b = sin(theta/2) / (theta/2), ripple of mean square A makes the variance A (1 - b^2) within, and
A b^2 in the mean: none over whole turns. The first half less the second, h, shows a rate that settles: h / 2.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.calibration.adc import code_steps, code_variance
from undrift.findings import Finding, finding
from undrift.fit.least_squares import block_size
from undrift.model import AXES, TriadModel, level_of
from undrift.record import Axis, Face, RateTable, Record, Still, Turn
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
    mounting: IntArray  # (N,), number of the mounting of each
    reading: FloatArray  # (N, 3), mean gyroscope reading of each
    up: FloatArray  # (N,), 1 where +axis points up, -1 down, 0 where it is not vertical
    settle_s: float  # Start of each that is left out, s

    def settled(self, k: int) -> slice:
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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Mounted:
    """One mounting as gravity shows it."""

    rows: list[int]  # Its dwells
    tilt: FloatArray  # (2,), d as felt
    covariance: FloatArray  # (2, 2), without that of the accelerometers
    of_accel: FloatArray  # (2, 12), what errors of the accelerometers' matrix and offset make of d
    places: FloatArray  # (9, 2), what d makes of D


def mountings(pieces: Sequence[Still | Turn]) -> IntArray:
    """Return the number of the mounting on a rate table of each piece (P,), -1 off the table.

    Turns about one axis at stated rates and rests with that axis up belong together as long as nothing else comes between.
    """
    runs: list[list[int]] = [[]]
    axis: Axis | None = None
    face: Face | None = None
    for n in sorted(range(len(pieces)), key=lambda n: (pieces[n].recording, pieces[n].start)):
        piece = pieces[n]
        if isinstance(piece, Turn):
            up, about = None, None if piece.turn_rate is None else piece.axis
        elif piece.face is not None:
            up, about = piece.face, AXES["xyz".index(piece.face[-1])]
        else:
            continue  # a rest in any pose
        if about is None or about != axis or (up and face and up != face):
            runs.append([])
            face = None
        axis, face = about, up or face
        runs[-1] += [n] if about else []
    numbers = np.full(len(pieces), -1)
    for number, run in enumerate(runs):
        if any(isinstance(pieces[n], Turn) for n in run):
            numbers[run] = number
    return numbers


def table_axes(dwells: Dwells, table: RateTable, accel: TriadModel | None, gravity_m_s2: float) -> TableAxes:
    """Return the axes about which the dwells turned the case."""
    own, rates = dwells.own, dwells.turn_rate
    slope = np.array([_line(rates[own == k], dwells.reading[own == k, k]) for k in range(3)])
    axis_b, off, covariance = np.eye(3)[own], np.full(len(own), np.nan), np.zeros((9, 9))
    beyond = 0.0
    total = np.array([max(float((rates[own == k] ** 2).sum()), 1e-300) for k in range(3)])
    codes = np.zeros(3) if accel is None else _accel_codes(dwells)
    seen: list[_Mounted] = []
    blocks: dict[tuple[int, int, float], list[int]] = {}
    for n in sorted(range(len(own)), key=lambda n: dwells.turns[n].recording):
        blocks.setdefault((int(dwells.mounting[n]), int(own[n]), float(dwells.up[n])), []).append(n)
    for (_, k, up), rows in blocks.items():
        across = [(k + 1) % 3, (k + 2) % 3]
        # D[:, k] of one mounting, as its part in all dwells about k
        places = np.zeros((9, 2))
        places[[3 * across[0] + k, 3 * across[1] + k], [0, 1]] = float((rates[rows] ** 2).sum()) / total[k]
        felt = None if accel is None or up == 0.0 else _felt(dwells, rows, slope[k], table, accel, gravity_m_s2)
        if felt is None or accel is None:
            covariance += (table.mount_tilt_deg * RADIAN_PER_DEGREE) ** 2 * places @ places.T
            continue
        # df = dM s - M do, s = M^-1 g k: what an error of the accelerometers makes of the axis
        at_rest = np.linalg.solve(accel.matrix, np.eye(3)[k])
        jacobian = np.hstack((np.kron(np.eye(3), at_rest), -up / gravity_m_s2 * accel.matrix))[across]
        # all dwells feel the same gravity, and so read the same codes
        rounding = accel.matrix[across] / gravity_m_s2
        spread = felt[1] + (rounding * codes) @ rounding.T
        seen.append(_Mounted(rows=rows, tilt=felt[0], covariance=spread, of_accel=jacobian, places=places))
    if seen and accel is not None:
        tilts, spread, beyond = _with_prior(seen, accel, table)
        for one, tilt in zip(seen, tilts, strict=True):
            k = int(own[one.rows[0]])
            axis_b[np.ix_(one.rows, [(k + 1) % 3, (k + 2) % 3])] = tilt
            off[one.rows] = np.hypot(*one.tilt)
        every = np.hstack([one.places for one in seen])
        covariance += every @ spread @ every.T
    uneven = rate_unevenness(dwells, slope[:, 0])
    diagonal = np.ix_([0, 4, 8], [0, 4, 8])
    covariance[diagonal] += table.rate_uncertainty**2 + np.diag(uneven**2)
    length = np.linalg.norm(axis_b, axis=1)[:, None]
    return TableAxes(axis_b=axis_b / length, covariance=covariance, off=off, beyond=beyond, uneven=uneven)


def _accel_codes(dwells: Dwells) -> FloatArray:
    """Return the variance that rounding to codes leaves in a mean of each accelerometer (3,), its unit squared."""
    windows = [dwells.records[turn.recording].accel for turn in dwells.turns]
    parts = [np.asarray(values)[dwells.settled(n)] for n, values in enumerate(windows) if values is not None]
    scatter = np.nanmedian([np.nanvar(part, axis=0) for part in parts], axis=0) if parts else np.zeros(3)
    return code_variance(code_steps(dwells.records, rate=False), scatter)


def _with_prior(seen: list[_Mounted], accel: TriadModel, table: RateTable) -> tuple[FloatArray, FloatArray, float]:
    """Return d of each mounting (B, 2), the covariance of all (2B, 2B), and the largest as felt in its standard deviations."""
    felt = np.concatenate([one.tilt for one in seen])
    jacobian = np.vstack([one.of_accel for one in seen])
    spread = jacobian @ accel.covariance[:12, :12] @ jacobian.T
    for number, one in enumerate(seen):
        own = slice(2 * number, 2 * number + 2)
        spread[own, own] += one.covariance
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
    """Return d (2,) of one mounting and its covariance (2, 2), without that of the accelerometers; None where it is not seen."""
    up = float(dwells.up[rows[0]])
    recordings = sorted({dwells.turns[n].recording for n in rows})
    parts: list[FloatArray] = []  # of each dwell, its block means: cos psi, sin psi, the two components felt
    for recording in recordings:
        own = [n for n in rows if dwells.turns[n].recording == recording]
        parts += _across(dwells, own, line, accel, up / gravity_m_s2) or [np.empty((0, 4))]
    if any(len(part) == 0 for part in parts):
        return None
    designs, across, dwell = [], [], []
    for number, (n, part) in enumerate(zip(rows, parts, strict=True)):
        square, place = dwells.turn_rate[n] ** 2 / gravity_m_s2, 2 * recordings.index(dwells.turns[n].recording)
        design = np.zeros((len(part), 2, 4 + 2 * len(recordings)))
        design[:, [0, 1], [0, 1]], design[:, [0, 1], [2, 3]] = 1.0, square
        design[:, [0, 1], [4 + place, 5 + place]] = part[:, :1]
        design[:, 0, 5 + place], design[:, 1, 4 + place] = part[:, 1], -part[:, 1]
        designs.append(design.reshape(-1, design.shape[2]))
        across.append(part[:, 2:].ravel())
        dwell += [number] * 2 * len(part)
    level = max(table.table_level_deg * RADIAN_PER_DEGREE, 1e-9)
    precision = np.array([0.0, 0.0, ARM_SD_M**-2, ARM_SD_M**-2] + [level**-2] * 2 * len(recordings))
    wobble = table.wobble_deg * RADIAN_PER_DEGREE
    return _posterior(np.vstack(designs), np.concatenate(across), np.array(dwell), wobble, precision)


def _across(
    dwells: Dwells, rows: list[int], line: FloatArray, accel: TriadModel, gain: float
) -> list[FloatArray] | None:
    """Return block means (E, 4) of the dwells of one recording: cosine and sine of the azimuth, what is felt across the axis."""
    k, record = int(dwells.own[rows[0]]), dwells.records[dwells.turns[rows[0]].recording]
    begin, end = min(dwells.turns[n].start for n in rows), max(dwells.turns[n].stop for n in rows)
    if record.accel is None or record.gyro is None or np.isnan(line).any() or np.isnan(record.gyro[begin:end]).any():
        return None
    rate = (record.gyro[begin:end, k] - line[1]) / line[0]
    step = 0.5 * (rate[1:] + rate[:-1]) * np.diff(record.time[begin:end])
    azimuth = np.concatenate(([0.0], np.cumsum(step)))
    size, found = block_size(record.sample_rate_hz), []
    for n in rows:
        window = dwells.settled(n)
        force = gain * (np.asarray(record.accel[window]) - accel.offset) @ accel.matrix.T
        angle = azimuth[window.start - begin : window.stop - begin]
        parts = np.column_stack((np.cos(angle), np.sin(angle), force[:, [(k + 1) % 3, (k + 2) % 3]]))
        count = len(parts) // size
        means = parts[: count * size].reshape(count, size, 4).mean(axis=1)
        found.append(means[~np.isnan(means).any(axis=1)])
    return found


def _posterior(
    design: FloatArray, reading: FloatArray, dwell: IntArray, wobble: float, precision: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the first two parameters and their covariance: block means (E,) of dwells, which wobble moves as wholes."""
    dwells, square = int(dwell[-1]) + 1, design.T @ design
    each = len(reading) / (2.0 * dwells)  # block means of one component in a dwell
    variance = 1.0
    for _ in range(4):
        inverse = np.linalg.inv(square / variance + np.diag(precision))
        theta = inverse @ design.T @ reading / variance
        left = reading - design @ theta
        fitted = float(np.trace(inverse @ square)) / variance  # parameters that the readings determine
        within = float(left @ left) / max(len(reading) - fitted - 2.0, 1.0)
        whole = np.concatenate([np.bincount(dwell[c::2], left[c::2]) for c in (0, 1)])  # sums over each dwell
        between = float(whole @ whole) / each / max(2.0 * dwells - fitted, 1.0)
        variance = max(within + each * wobble**2, between, 1e-18)
    return theta[:2], inverse[:2, :2]


def rate_unevenness(dwells: Dwells, scale: FloatArray) -> FloatArray:
    """Return how uncertain ripple and settling leave the mean rate about each axis, relative, 1 sigma, (3,)."""
    own, rates = dwells.own, dwells.turn_rate
    sample_rates = {turn.recording: dwells.records[turn.recording].sample_rate_hz for turn in dwells.turns}
    means = [_block_means(dwells, n, sample_rates) for n in range(len(own))]
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
        half = 0.5 * np.abs(rates[rows]) * [_duration(dwells, n, sample_rates) for n in rows]
        kept = np.sin(half) / half  # b
        excess = np.array([p.var(ddof=1) for p in parts]) - noise - late * w**2
        ripple = max(0.0, float(w**2 @ excess) / max(float(w**4 @ (1.0 - kept**2)), 1e-300))
        uneven[k] = np.sqrt(late + ripple * (float(w**2 @ kept) / float(w @ w)) ** 2)
    return uneven


def _duration(dwells: Dwells, n: int, sample_rates: Mapping[int, float]) -> float:
    window = dwells.settled(n)
    return float(window.stop - window.start) / sample_rates[dwells.turns[n].recording]


def _block_means(dwells: Dwells, n: int, sample_rates: Mapping[int, float]) -> FloatArray:
    recording = dwells.turns[n].recording
    values = np.asarray(dwells.records[recording].gyro)[dwells.settled(n)]
    size = block_size(sample_rates[recording])
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


def table_term(model: TriadModel, covariance: FloatArray) -> FloatArray:
    """Return what multiplies every rate, with its covariance (9, 9), as a term of that of a model."""
    jacobian = np.zeros((len(model.covariance), 9))
    jacobian[:9] = np.kron(np.eye(3), model.matrix.T)
    if model.g_sensitivity is not None:
        jacobian[12:21] = np.kron(np.eye(3), model.g_sensitivity.T)
    return np.asarray(jacobian @ covariance @ jacobian.T)
