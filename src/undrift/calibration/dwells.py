"""Dwells on a rate table: mean readings, at what rate and about which axis the table really turned, linearity of one axis.

``uneven_rate`` finds how a ripple and settling change the rate, ``table_axes`` about which axis of the case gravity shows the table
to turn; ``dwell_means`` and ``imposed_rates`` give a fit its readings and its inputs, ``table_errors`` what stays unknown.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.calibration.adc import code_steps, code_variance
from undrift.calibration.checks import axis_vectors, check_saturation
from undrift.calibration.observe import middles
from undrift.errors import InputError, NotObservable
from undrift.findings import Finding, above, finding
from undrift.fit.equations import GROUP_SHOWS, fit_components
from undrift.fit.least_squares import block_size, noise_of_means
from undrift.model import AXES, TriadModel
from undrift.record import Axis, MountedFace, RateTable, Record, Still, Turn, TurnAxis
from undrift.units import EARTH_RATE, RADIAN_PER_DEGREE

# ---- table rate: a ripple of the table's rate with its angle, and how it settles, by the gyroscope of the turned axis
#
# Dwell i at the stated rate w_i, psi the table's angle, t since its start, turned about k::
#
#     reading_k = o_i + S_k w_i (1 + r(psi, t))
#     r = a cos psi + b sin psi + c cos 2 psi + d sin 2 psi + sum_j e_j exp(-t / T_j)
#     mean rate = w_i (1 + rho_i)        rho_i the mean of r over the dwell
#
# a to d are those of one mounting in one recording, since psi is the integral of the gyroscope; e_j those of a mounting. o_i is
# free, so only what changes within a dwell determines them, and no scale factor enters. Terms once a turn, twice a turn and those
# of settling are groups of a size of their own, each in where it shows (fit/least_squares.py). What of the rate is left beyond
# the noise counts as white. Stated rates that are measured means hold all of that already: where the means of the readings follow
# them better, rho is 0.


SHOWS = 3.0  # standard errors of a scatter that exceeds another, for it to count
# Half octaves: how a table settles lies between, and so does what its shape leaves unknown
_SETTLES_S = (0.15, 0.21, 0.3, 0.42, 0.6, 0.85, 1.2)
_LEAST_BLOCKS = 4  # in a dwell, for its unevenness
_PASSES = 4  # of fit and noise
_LEAST_NOISE = 1e-7  # of block means, of the rate: below any gyroscope, and sound arithmetic
_FIRST = 1e-6  # variance of a term to begin with: 0.1 % of the rate


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
    def sizes(self) -> list[int]:
        """Samples of a block of each dwell, (N,)."""
        of = {k: block_size(self.records[k].sample_rate_hz) for k in {turn.recording for turn in self.turns}}
        return [of[turn.recording] for turn in self.turns]

    @property
    def own(self) -> IntArray:
        """Number of the axis of each dwell, (N,)."""
        return np.array([AXES.index(turn.axis or "x") for turn in self.turns], int)

    @property
    def turn_rate(self) -> FloatArray:
        """Stated rate of each dwell, (N,), rad/s."""
        return np.array([turn.turn_rate for turn in self.turns], float)

    @property
    def lines(self) -> FloatArray:
        """Scale factor and offset of each sensor by its own dwells, (3, 2); NaN where these do not show them."""
        return np.array([_line(self.turn_rate[self.own == k], self.reading[self.own == k, k]) for k in range(3)])

    def codes(self, *, rate: bool) -> FloatArray:
        """Return the variance that rounding to codes leaves in a mean of each sensor (3,), its unit squared."""
        windows = [
            self.records[turn.recording].gyro if rate else self.records[turn.recording].accel for turn in self.turns
        ]
        parts = [np.asarray(values)[self.settled(n)] for n, values in enumerate(windows) if values is not None]
        scatter = np.nanmedian([np.nanvar(part, axis=0) for part in parts], axis=0) if parts else np.zeros(3)
        return code_variance(code_steps(self.records, rate=rate), scatter)


def _line(rate: FloatArray, reading: FloatArray) -> FloatArray:
    if len(np.unique(rate)) < 2:
        return np.full(2, np.nan)
    return np.asarray(np.linalg.lstsq(np.column_stack((rate, np.ones_like(rate))), reading, rcond=None)[0])


def azimuths(dwells: Dwells, rows: list[int], line: FloatArray) -> list[FloatArray] | None:
    """Return the angle of the table (M,) in the settled part of dwells of one recording; None where a gap hides it."""
    k, record = int(dwells.own[rows[0]]), dwells.records[dwells.turns[rows[0]].recording]
    begin, end = min(dwells.turns[n].start for n in rows), max(dwells.turns[n].stop for n in rows)
    if record.gyro is None or np.isnan(line).any() or np.isnan(record.gyro[begin:end]).any():
        return None
    rate = (record.gyro[begin:end, k] - line[1]) / line[0]
    step = 0.5 * (rate[1:] + rate[:-1]) * np.diff(record.time[begin:end])
    angle = np.concatenate(([0.0], np.cumsum(step)))
    return [angle[dwells.settled(n).start - begin : dwells.settled(n).stop - begin] for n in rows]


def block_means(values: FloatArray, size: int) -> FloatArray:
    """Return means (E, C) of whole blocks of values (N, C)."""
    count = len(values) // size
    return np.asarray(values[: count * size].reshape(count, size, values.shape[1]).mean(axis=1))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class UnevenRate:
    """By how much the mean rate of each dwell is off the stated one, relative."""

    ratio: FloatArray  # (N,), rho
    covariance: FloatArray  # (N, N)
    size: FloatArray  # (3,), rms of terms once a turn, twice a turn and of settling, relative; 0 where they do not show


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Piece:
    """One dwell: the terms that may change its rate, and its reading."""

    dwell: int
    own: int  # Number of its axis
    places: list[int]  # Of its terms among all parameters
    mean: FloatArray  # (T,), of its terms
    away: FloatArray  # (E, T + 1), block means of its terms and of the reading over S w, less their mean
    drive: float  # |S w|, unit of the reading


def uneven_rate(dwells: Dwells) -> UnevenRate:
    """Fit ripple and settling to what the gyroscope of the turned axis reads within the dwells."""
    count, codes = len(dwells.own), np.nan_to_num(dwells.codes(rate=True))
    pieces, groups = _pieces(dwells)
    width = sum(map(len, groups))
    theta: FloatArray = np.zeros(width)
    covariance: FloatArray = np.zeros((width, width))
    noise, size = np.zeros(3), np.zeros(3)
    for _ in range(_PASSES if pieces else 0):
        noise = _left(pieces, theta, covariance, noise) + codes
        normal, moment = np.zeros((width, width)), np.zeros(width)
        for one in pieces:
            weighted = one.away * one.drive / noise[one.own] ** 0.5
            normal[np.ix_(one.places, one.places)] += weighted[:, :-1].T @ weighted[:, :-1]
            moment[one.places] += weighted[:, :-1].T @ weighted[:, -1]
        found = fit_components(normal, moment, np.zeros(width), groups, np.zeros(3), _FIRST)
        theta, covariance, size = found.theta, found.covariance, np.sqrt(found.variance)
    mean, jitter = np.zeros((count, width)), np.zeros(count)
    more = _jitter(dwells, noise)
    for one in pieces:
        mean[one.dwell, one.places] = one.mean
        jitter[one.dwell] = more[one.own] / len(one.away) / one.drive**2
    ratio, spread = mean @ theta, mean @ covariance @ mean.T
    if _measured(dwells, pieces, noise, ratio, np.diag(spread)):
        ratio, spread, size = 0.0 * ratio, 0.0 * spread, np.zeros(3)
    return UnevenRate(ratio=ratio, covariance=spread + np.diag(jitter), size=size)


def _measured(dwells: Dwells, pieces: list[_Piece], noise: FloatArray, ratio: FloatArray, spread: FloatArray) -> bool:
    """Return whether the stated rates are measured means: readings follow them, and not those that the terms make."""
    better = 0.0
    for k in range(3):
        own = [one for one in pieces if one.own == k]
        rows = [one.dwell for one in own]
        variance = np.array([noise[k] / len(one.away) + one.drive**2 * spread[one.dwell] for one in own])
        root, rates = np.sqrt(variance), dwells.turn_rate[rows]
        for sign, rate in ((-1.0, rates), (1.0, rates * (1.0 + ratio[rows]))):
            design, reading = (
                np.column_stack((rate, np.ones_like(rate))) / root[:, None],
                dwells.reading[rows, k] / root,
            )
            left = reading - design @ np.linalg.lstsq(design, reading, rcond=None)[0]
            better += sign * float(left @ left)
    return better > GROUP_SHOWS


def _pieces(dwells: Dwells) -> tuple[list[_Piece], list[IntArray]]:
    """Return the dwells that show how even their rate is, and the places of the terms of each group."""
    axis, lines, rates, sizes = dwells.own, dwells.lines, dwells.turn_rate, dwells.sizes
    phases: list[tuple[list[int], list[FloatArray]]] = []
    for key in sorted({(t.recording, int(m)) for t, m in zip(dwells.turns, dwells.mounting, strict=True)}):
        rows = [n for n, t in enumerate(dwells.turns) if (t.recording, int(dwells.mounting[n])) == key]
        for group in (rows, *([n] for n in rows)):  # a gap between dwells leaves each a phase of its own
            angles = azimuths(dwells, group, lines[axis[group[0]]])
            if angles is not None:
                phases.append((group, angles))
                if group is rows:
                    break
    mounts = sorted(set(dwells.mounting.tolist()))
    last, pieces = 4 * len(phases), []
    for number, (group, angles) in enumerate(phases):
        for n, psi in zip(group, angles, strict=True):
            window, drive = dwells.settled(n), lines[axis[n], 0] * rates[n]
            if rates[n] == 0.0 or len(psi) < _LEAST_BLOCKS * sizes[n]:
                continue
            record = dwells.records[dwells.turns[n].recording]
            since = record.time[window] - record.time[dwells.turns[n].start]
            waves = [np.cos(psi), np.sin(psi), np.cos(2.0 * psi), np.sin(2.0 * psi)]
            terms = np.column_stack([*waves, *(np.exp(-since / settle) for settle in _SETTLES_S)])
            means = block_means(np.column_stack((terms, np.asarray(record.gyro)[window, axis[n]] / drive)), sizes[n])
            late = last + len(_SETTLES_S) * mounts.index(dwells.mounting[n])
            places = [*range(4 * number, 4 * number + 4), *range(late, late + len(_SETTLES_S))]
            piece = _Piece(
                dwell=n, own=int(axis[n]), places=places, mean=terms.mean(axis=0), away=means - means.mean(axis=0), drive=abs(drive)
            )  # fmt: skip
            pieces.append(piece)
    turned = np.arange(last).reshape(-1, 2, 2)
    return pieces, [turned[:, 0].ravel(), turned[:, 1].ravel(), np.arange(last, last + len(_SETTLES_S) * len(mounts))]


def _left(pieces: list[_Piece], theta: FloatArray, covariance: FloatArray, noise: FloatArray) -> FloatArray:
    """Return the variance (3,) of block means of each sensor about its own axis that the terms leave; 1 where it has none."""
    square, spare = np.zeros(3), np.zeros(3)
    for one in pieces:
        terms = one.away[:, :-1] * one.drive
        left = one.drive * one.away[:, -1] - terms @ theta[one.places]
        square[one.own] += left @ left
        spare[one.own] += len(left) - 1
        if noise[one.own] > 0.0:  # parameters that the readings determine
            spare[one.own] -= ((terms.T @ terms) * covariance[np.ix_(one.places, one.places)]).sum() / noise[one.own]
    floor = np.full(3, 1e-300)
    for one in pieces:  # the last digit of readings without noise
        floor[one.own] = max(floor[one.own], (_LEAST_NOISE * one.drive) ** 2)
    return np.where(spare > 0.5, np.maximum(square / np.maximum(spare, 0.5), floor), 1.0)


def _jitter(dwells: Dwells, noise: FloatArray) -> FloatArray:
    """Return by how much the variance (3,) of block means about the own axis exceeds that about the others, where it shows."""
    more, axis = np.zeros(3), dwells.own
    windows = [np.asarray(dwells.records[t.recording].gyro)[dwells.settled(n)] for n, t in enumerate(dwells.turns)]
    parts = [block_means(window, size) for window, size in zip(windows, dwells.sizes, strict=True)]
    for k in range(3):
        others = [parts[n][:, k] for n in np.flatnonzero(axis != k) if len(parts[n]) > 1]
        spare = sum(len(part) - 1 for part in others)
        if spare and (axis == k).any():
            usual = sum(float(((part - part.mean()) ** 2).sum()) for part in others) / spare
            blocks = sum(len(parts[n]) - 1 for n in np.flatnonzero(axis == k))
            shows = 1.0 + SHOWS * (2.0 / spare + 2.0 / max(blocks, 1)) ** 0.5
            more[k] = noise[k] - usual if noise[k] > shows * usual else 0.0
    return more


# ---- table axis: about which axis of the case a rate table really turned, by the gravity felt, and what stays unknown
#
# In one mounting, axis k of the case along the table's, dwell i turns the device about u_i = k + d + e_i, d and e small and across
# k, e the wobble from dwell to dwell. The table's axis is off the vertical by l + h_i, the accelerometers off it by an arm r. The
# dwell, at rate w_i and azimuth psi, feels across k::
#
#     mean f_i / g = d + e_i + mean R_k(-psi) (l + h_i) - r w_i^2 / g          two components each, l anew for each recording
#
#     minimise  sum |residual|^2 / s^2 + |l|^2 / level^2 + |r|^2 / arm^2 + (|e|^2 + |h|^2) / wobble^2
#
# wobble is the stated one, or the larger one that the likelihood shows. psi is the integral of the gyroscope of the axis within a
# recording, so dwells need no whole turns. All mountings share the accelerometers' errors; the mean axis of each is that felt and
# k +- m, by their covariances, averaged over m by the likelihood of what is felt; without accelerometers it is k +- mount. The
# mean rate is w_i (1 + rho_i) (above). Errors of axis and rate that are left are those of dwells, weighed as the fit weighs them,
# and multiply every rate: w_true = (I + D) w::
#
#     dM = D M        dG = D G        D = sum_i c_i du_i k_i' + diag(relative error of the rate)

ARM_SD_M = 0.1  # m, of the accelerometers from the table's axis: half the plate of a small table
UNEVEN_PERCENT = (0.1, 2.0)  # of the scale factor, 1 sigma: marginal above the first, bad above the second
_MOUNTED = 2.0  # times the stated size, rms
# Sizes of a mounting over the stated one, m, as likely beforehand as 1 / m^3: rms 1.08. A machined block is square to 0.1 deg,
# a device mounted by hand to 0.3 deg [assumed]
MOUNT_SIZES = np.geomspace(0.6, 3.0, 25)
_SMALL_ANGLE = 1e-3  # rad: what every case lies off by, however well it is mounted
_LEAST_TILT_VARIANCE = 1e-12  # variance of block means of the direction of gravity, rad2: 1 ug, and sound arithmetic


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TableAxes:
    """The rates of the dwells over the stated ones, and what stays unknown of them."""

    axis_b: FloatArray  # (N, 3), mean rate over the stated one: the axis, of length 1 + rho
    spread: FloatArray  # (3N, 3N), its covariance, dwell by dwell
    apart: FloatArray  # (N, 3), variance that each dwell has on its own, on the diagonal of ``spread``
    covariance: FloatArray  # (9, 9), of D row by row, without ``spread``
    off: FloatArray  # (N,), measured angle between case axis and table axis, rad; NaN where gravity did not show it
    mounted: float  # Size of the mountings by what is felt, over the stated one; 0 where nothing is felt
    uneven: FloatArray  # (3,), standard uncertainty of the mean rate about x, y, z by ripple and settling, relative
    size: FloatArray  # (3,), rms of ripple once, twice a turn and of settling, relative; 0 where they do not show
    # of ``covariance``, by the session's temperature
    creep: FloatArray = field(default_factory=lambda: np.zeros((9, 9)))

    def shares(self, axis: IntArray, square: FloatArray, *, alone: bool) -> dict[str, FloatArray]:
        """Return the covariances (9, 9) of D by source of a budget, where dwells (N,) about ``axis`` weigh by ``square`` (N, 3).

        ``alone`` counts also what each dwell has on its own; a fit whose noise holds that leaves it out.
        """
        share, rows = np.zeros((9, 3 * len(axis))), np.arange(len(axis))
        for a in range(3):
            total = np.bincount(axis, square[:, a], minlength=3)
            share[3 * a + axis, 3 * rows + a] = square[:, a] / np.maximum(total, 1e-300)[axis]
        spread = share @ (self.spread - (0.0 if alone else np.diag(self.apart.ravel()))) @ share.T
        along = np.outer(np.eye(3), np.eye(3)) > 0.0
        ripple, mounting = np.where(along, spread, 0.0), np.where(along, 0.0, spread)
        return {"rate": self.covariance - self.creep, "ripple": ripple, "mounting": mounting, "temperature": self.creep}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Mounted:
    """One mounting as gravity shows it."""

    rows: list[int]  # Its n dwells
    tilt: FloatArray  # (2n,), d + e of each as felt
    covariance: FloatArray  # (2n, 2n), without that of the accelerometers
    of_accel: FloatArray  # (2, 12), what errors of the accelerometers' matrix and offset make of d


def mountings(pieces: Sequence[Still | Turn]) -> IntArray:
    """Return the number of the mounting on a rate table of each piece (P,), -1 off the table.

    Turns about one axis at stated rates and rests with that axis up belong together as long as nothing else comes between.
    """
    runs: list[list[int]] = [[]]
    axis: TurnAxis | None = None
    face: MountedFace | None = None
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
    """Return the axes about which the dwells turned the case, and at what part of the stated rates."""
    axis, lines, count = dwells.own, dwells.lines, len(dwells.own)
    axis_b, off, spread = np.eye(3)[axis], np.full(count, np.nan), np.zeros((3 * count, 3 * count))
    apart, mounted = np.zeros((count, 3)), 0.0
    wobble, mount = (np.square(deg * RADIAN_PER_DEGREE) for deg in (table.wobble_deg, table.mount_tilt_deg))
    codes = np.zeros(3) if accel is None else dwells.codes(rate=False)
    seen: list[_Mounted] = []
    blocks: dict[tuple[int, int, float], list[int]] = {}
    for n in sorted(range(count), key=lambda n: dwells.turns[n].recording):
        blocks.setdefault((int(dwells.mounting[n]), int(axis[n]), float(dwells.up[n])), []).append(n)
    for (_, k, up), rows in blocks.items():
        across = [(k + 1) % 3, (k + 2) % 3]
        felt = None if accel is None or up == 0.0 else _felt(dwells, rows, lines[k], table, accel, gravity_m_s2)
        if felt is None or accel is None:
            for a in across:
                spread[np.ix_(*[[3 * n + a for n in rows]] * 2)] = mount + wobble * np.eye(len(rows))
                apart[rows, a] = wobble
            continue
        # df = dM s - M do, s = M^-1 g k: what an error of the accelerometers makes of the axis
        at_rest = np.linalg.solve(accel.matrix, np.eye(3)[k])
        jacobian = np.hstack((np.kron(np.eye(3), at_rest), -up / gravity_m_s2 * accel.matrix))[across]
        # all dwells feel the same gravity, and so read the same codes
        rounding = accel.matrix[across] / gravity_m_s2
        whole = felt[1] + np.kron(np.ones((len(rows), len(rows))), (rounding * codes) @ rounding.T)
        seen.append(_Mounted(rows=rows, tilt=felt[0], covariance=whole, of_accel=jacobian))
    if seen and accel is not None:
        tilts, found, mounted = _with_prior(seen, accel, mount)
        axes = [np.array([3 * n + (axis[n] + c) % 3 for n in one.rows for c in (1, 2)]) for one in seen]
        places = np.concatenate(axes)
        axis_b.reshape(-1)[places] = tilts
        spread[np.ix_(places, places)] = found
        for one, place in zip(seen, axes, strict=True):
            off[one.rows] = np.hypot(*one.tilt.reshape(-1, 2).mean(axis=0))
            for c in (0, 1):
                apart.reshape(-1)[place[c::2]] = _alone(spread[np.ix_(place[c::2], place[c::2])])
    axis_b /= np.linalg.norm(axis_b, axis=1)[:, None]
    rate = uneven_rate(dwells)
    along = 3 * np.arange(count) + axis
    spread[np.ix_(along, along)] = rate.covariance
    for k in range(3):
        apart.reshape(-1)[along[axis == k]] = _alone(rate.covariance[np.ix_(axis == k, axis == k)])
    share = np.where(axis == np.arange(3)[:, None], dwells.turn_rate**2, 0.0)
    share /= np.maximum(share.sum(axis=1), 1e-300)[:, None]
    return TableAxes(
        axis_b=axis_b * (1.0 + rate.ratio)[:, None],
        spread=spread,
        apart=apart,
        covariance=table.rate_uncertainty**2 * np.outer(np.eye(3), np.eye(3)),  # of all rates in common
        off=off,
        mounted=mounted,
        uneven=np.sqrt(np.diag(share @ rate.covariance @ share.T)),
        size=rate.size,
    )


def _alone(covariance: FloatArray) -> FloatArray:
    """Return the variance (n,) of each of n errors beyond what all have in common."""
    count, variance = len(covariance), np.diag(covariance)
    if count < 2:
        return np.zeros(count)
    common = (covariance.sum() - variance.sum()) / (count * (count - 1))
    return np.asarray(variance - np.clip(common, 0.0, variance))


def _with_prior(seen: list[_Mounted], accel: TriadModel, mount: float) -> tuple[FloatArray, FloatArray, float]:
    """Return the axes across k of all dwells (2N,), their covariance, and the size of the mounting over the stated one."""
    felt = np.concatenate([one.tilt for one in seen])
    jacobian = np.vstack([np.tile(one.of_accel, (len(one.rows), 1)) for one in seen])
    spread = jacobian @ accel.covariance[:12, :12] @ jacobian.T
    mean, start = np.zeros((2 * len(seen), len(felt))), 0
    for number, one in enumerate(seen):
        own = slice(start, start + len(one.tilt))
        spread[own, own] += one.covariance
        mean[2 * number : 2 * number + 2, own] = np.tile(np.eye(2), len(one.rows)) / len(one.rows)
        start = own.stop
    variance, basis = np.linalg.eigh(mean @ spread @ mean.T)
    gain, off = spread @ mean.T @ basis, basis.T @ (mean @ felt)
    total = variance.clip(1e-24) + mount * MOUNT_SIZES[:, None] ** 2  # (T, 2 mountings), of off: N(0, C + m^2 I)
    likelihood = -0.5 * (np.log(total) + off**2 / total).sum(axis=1) - 2.0 * np.log(MOUNT_SIZES)
    share = np.exp(likelihood - likelihood.max())
    share /= share.sum()
    correction = share @ (off / total)
    apart = off / total - correction
    left = (apart.T * share) @ apart - np.diag(share @ (1.0 / total))
    return felt - gain @ correction, spread + gain @ left @ gain.T, float(share @ MOUNT_SIZES**2) ** 0.5


def _felt(
    dwells: Dwells, rows: list[int], line: FloatArray, table: RateTable, accel: TriadModel, gravity_m_s2: float
) -> tuple[FloatArray, FloatArray] | None:
    """Return d + e (2n,) of the dwells of one mounting and its covariance, without that of the accelerometers; None unseen."""
    up = float(dwells.up[rows[0]])
    recordings = sorted({dwells.turns[n].recording for n in rows})
    parts: list[FloatArray] = []  # of each dwell, its block means: cos psi, sin psi, the two components felt
    for recording in recordings:
        own = [n for n in rows if dwells.turns[n].recording == recording]
        parts += _across(dwells, own, line, accel, up / gravity_m_s2) or [np.empty((0, 4))]
    if any(len(block) == 0 for block in parts):
        return None
    designs, across, wobbles = [], [], 4 + 2 * len(recordings)
    for number, (n, block) in enumerate(zip(rows, parts, strict=True)):
        square, place = dwells.turn_rate[n] ** 2 / gravity_m_s2, 4 + 2 * recordings.index(dwells.turns[n].recording)
        design = np.zeros((len(block), 2, wobbles + 4 * len(rows)))
        design[:, [0, 1], [0, 1]], design[:, [0, 1], [2, 3]] = 1.0, square
        e = wobbles + 4 * number
        design[:, [0, 1], [e, e + 1]] = 1.0
        for level in (place, e + 2):
            design[:, [0, 1], [level, level + 1]] = block[:, :1]
            design[:, 0, level + 1], design[:, 1, level] = block[:, 1], -block[:, 1]
        designs.append(design.reshape(-1, design.shape[2]))
        across.append(block[:, 2:].ravel())
    off_level = max(table.table_level_deg * RADIAN_PER_DEGREE, 1e-9)
    precision = np.zeros(wobbles + 4 * len(rows))
    precision[2:wobbles] = [ARM_SD_M**-2] * 2 + [off_level**-2] * 2 * len(recordings)
    stated = (table.wobble_deg * RADIAN_PER_DEGREE) ** 2
    theta, covariance = _posterior(np.vstack(designs), np.concatenate(across), precision, wobbles, stated)
    tilt = np.zeros((2 * len(rows), len(theta)))
    for number in range(len(rows)):
        for c in (0, 1):
            tilt[2 * number + c, [c, wobbles + 4 * number + c]] = 1.0
    return tilt @ theta, tilt @ covariance @ tilt.T


def _across(
    dwells: Dwells, rows: list[int], line: FloatArray, accel: TriadModel, gain: float
) -> list[FloatArray] | None:
    """Return block means (E, 4) of the dwells of one recording: cosine and sine of the azimuth, what is felt across the axis."""
    k, record = int(dwells.own[rows[0]]), dwells.records[dwells.turns[rows[0]].recording]
    angles = azimuths(dwells, rows, line)
    if record.accel is None or angles is None:
        return None
    blocks, sizes = [], dwells.sizes
    for n, angle in zip(rows, angles, strict=True):
        force = gain * (np.asarray(record.accel[dwells.settled(n)]) - accel.offset) @ accel.matrix.T
        parts = np.column_stack((np.cos(angle), np.sin(angle), force[:, [(k + 1) % 3, (k + 2) % 3]]))
        means = block_means(parts, sizes[n])
        blocks.append(means[~np.isnan(means).any(axis=1)])
    return blocks


def _posterior(
    design: FloatArray, reading: FloatArray, precision: FloatArray, wobbles: int, stated: float
) -> tuple[FloatArray, FloatArray]:
    """Return parameters and covariance: block means (E,) whose noise is not known, wobble from a place on."""
    square, product = design.T @ design, design.T @ reading
    group = np.arange(wobbles, design.shape[1])
    plain = design[:, :wobbles]
    residual = reading - plain @ np.linalg.lstsq(plain, reading, rcond=None)[0]
    noise = max(float(residual @ residual) / max(len(residual) - wobbles, 1), _LEAST_TILT_VARIANCE)
    for _ in range(_PASSES):
        found = fit_components(square / noise, product / noise, precision, [group], np.array([stated]), _FIRST)
        residual = reading - design @ found.theta
        fitted = float((square * found.covariance).sum()) / noise  # parameters that the readings determine
        noise = max(float(residual @ residual) / max(len(residual) - fitted, 1.0), _LEAST_TILT_VARIANCE)
    return found.theta, found.covariance


def table_findings(axes: TableAxes, mount_tilt: float) -> Iterator[Finding]:
    """Yield what the axes of a table show that a user can act on."""
    if np.isfinite(axes.off).any():
        off = float(np.nanmax(axes.off))
        beyond = axes.mounted > _MOUNTED and off > _SMALL_ANGLE
        degrees, stated = off / RADIAN_PER_DEGREE, mount_tilt / RADIAN_PER_DEGREE
        yield finding("rate_table.mounting", "warn" if beyond else "info", angle_deg=degrees, stated_deg=stated)
    if axes.size.any():
        ripple, settle = 100.0 * float(np.hypot(*axes.size[:2])), 100.0 * float(axes.size[2])
        yield finding("rate_table.ripple", "info", ripple_percent=ripple, settle_percent=settle)
    worst, axis = 100.0 * float(axes.uneven.max()), AXES[int(axes.uneven.argmax())]
    yield from above("rate_table.uneven_rate", worst, UNEVEN_PERCENT, axis=axis, uncertainty_percent=worst)


def table_term(model: TriadModel, covariance: FloatArray) -> FloatArray:
    """Return what multiplies every rate, with its covariance (9, 9), as a term of that of a model."""
    jacobian = np.zeros((len(model.covariance), 9))
    jacobian[:9] = np.kron(np.eye(3), model.matrix.T)
    if model.g_sensitivity is not None:
        jacobian[12:21] = np.kron(np.eye(3), model.g_sensitivity.T)
    return np.asarray(jacobian @ covariance @ jacobian.T)


_LEAST_SAMPLES = 8


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DwellMeans:
    """Mean readings at steady rates."""

    reading: FloatArray  # (N, 3), mean of each dwell, ``unit``
    turn_rate: FloatArray  # (N,), achieved rate about +axis, rad/s
    axis: tuple[TurnAxis, ...]  # Axis of each dwell
    noise: FloatArray | None = None  # (N, 3), standard deviation of each mean; None when it is not known
    # (N,), 1 where +axis points up, -1 where it points down, 0 where it is not vertical; all 1 by default
    up: FloatArray = field(default_factory=lambda: np.ones(1))
    unit: str = "rad/s"  # Unit of the readings
    # (N,), middle of each dwell on one clock, s: recordings follow each other. None when it is not known
    time: FloatArray | None = None
    # (3,), step of the codes, 0 or NaN for none, and the variance that they leave in a mean, which is in ``noise`` too
    step: FloatArray = field(default_factory=lambda: np.zeros(3))
    codes: FloatArray = field(default_factory=lambda: np.zeros(3))
    axes: TableAxes | None = None  # About which axes the table turned the case; None takes ``axis`` as true
    mount_tilt: float = 0.0  # Standard uncertainty of the mounting, rad; used with ``axes`` alone

    def __post_init__(self) -> None:
        n = len(self.axis)
        if self.reading.shape != (n, 3) or self.turn_rate.shape != (n,):
            raise InputError(
                f"dwells: wanted readings (N, 3) and rates (N,) for {n} axes, got {self.reading.shape} and {self.turn_rate.shape}"
            )


def dwell_means(
    records: Sequence[Record], turns: Sequence[Turn], *, settle_s: float = 0.3, cutoff_hz: float | None = None
) -> DwellMeans:
    """Average the steady turns of a session.

    The first ``settle_s`` of each dwell are discarded: a second-order filter at 11 Hz settles to 0.1 % in 0.15 s. The note's
    smoothing spline halves the signal at ``cutoff_hz``; None leaves it out, which changes no mean.
    """
    used = [t for t in turns if t.axis is not None and t.turn_rate is not None]
    unit = records[used[0].recording].gyro_unit if used else "rad/s"
    blocks = {k: block_size(records[k].sample_rate_hz) for k in {t.recording for t in used}}
    parts = [_settled(records[t.recording], t, unit, settle_s) for t in used]
    windows = [np.asarray(record.gyro) for record in parts]
    smooth = [
        w if cutoff_hz is None else spline_filter(record.time, w, cutoff_hz)
        for record, w in zip(parts, windows, strict=True)
    ]
    about = [-1 if t.axis == "xyz" else AXES.index(t.axis or "x") for t in used]
    noise = _noise(windows, [blocks[t.recording] for t in used], about)
    step = code_steps([records[k] for k in blocks], rate=True)
    codes = code_variance(step, np.median([w.var(axis=0) for w in windows], axis=0)) if used else np.zeros(3)
    return DwellMeans(
        reading=np.array([w.mean(axis=0) for w in smooth]).reshape(-1, 3),
        turn_rate=np.array([t.turn_rate for t in used], float),
        axis=tuple(t.axis for t in used if t.axis is not None),
        noise=None if noise is None else np.hypot(noise, np.sqrt(codes)),
        up=np.array([_points_up(record, axis) for record, axis in zip(parts, about, strict=True)]),
        unit=unit,
        time=middles(records, used),
        step=step,
        codes=codes,
    )


def _noise(windows: list[FloatArray], sizes: list[int], own: list[int]) -> FloatArray | None:
    """Return the noise of each mean; a sensor whose own dwells scatter more, since the rate ripples, by its other dwells."""
    noise = noise_of_means(windows, sizes)
    for k in range(3):
        rows = [n for n, axis in enumerate(own) if axis not in (k, -1)]
        others = noise_of_means([windows[n] for n in rows], [sizes[n] for n in rows])
        if noise is None or others is None:
            continue
        spare = sum(len(windows[n]) // sizes[n] - 1 for n in rows)
        ratio = float((others[:, k] ** 2).sum() / max(float((noise[rows, k] ** 2).sum()), 1e-300))
        if ratio * (1.0 + SHOWS * (2.0 / spare) ** 0.5) < 1.0:
            noise[:, k] *= ratio**0.5
    return noise


def spline_filter(time: FloatArray, values: FloatArray, cutoff_hz: float) -> FloatArray:
    """Smooth each column of values (N, 3) with the note's cubic smoothing spline.

    It minimises sum (y - f)^2 + lambda integral f''^2: a low-pass of fourth order that halves the signal at the frequency w with
    lambda dt w^4 = 1. It keeps straight lines, so the mean over its samples is the mean of the readings, to rounding.
    """
    from scipy.interpolate import make_smoothing_spline

    stiffness = 1.0 / (float(np.median(np.diff(time))) * (2.0 * np.pi * cutoff_hz) ** 4)
    own = time - time[0]
    return np.column_stack([make_smoothing_spline(own, column, lam=stiffness)(own) for column in values.T])


def _settled(record: Record, turn: Turn, unit: str, settle_s: float) -> Record:
    if record.gyro is None or record.gyro_unit != unit:
        raise InputError(
            f"rate table: wanted gyroscope readings in {unit} in every recording, got "
            f"{'none' if record.gyro is None else record.gyro_unit} in recording {turn.recording}; map the columns alike"
        )
    dwell = record.part(turn.start, turn.stop)
    dwell = dwell.part(int(np.searchsorted(dwell.time, dwell.time[0] + settle_s)), len(dwell))
    if len(dwell) < _LEAST_SAMPLES:
        raise InputError(
            f"dwell [{turn.start}, {turn.stop}): wanted {_LEAST_SAMPLES} samples or more after {settle_s:g} s of settling, got "
            f"{len(dwell)}; dwell longer"
        )
    values = np.asarray(dwell.gyro)
    gaps = int(np.isnan(values).any(axis=1).sum())
    if gaps:
        raise InputError(f"dwell [{turn.start}, {turn.stop}): wanted readings without gaps, got {gaps}; shorten it")
    check_saturation(values, f"gyroscope at {turn.turn_rate:.4g} rad/s about {turn.axis}")
    return dwell


def _points_up(part: Record, axis: int) -> float:
    if part.accel is None or part.accel_unit in ("count", "v"):
        return 1.0
    mean = np.nanmean(part.accel, axis=0)
    share = float(mean[axis] / np.linalg.norm(mean)) if np.linalg.norm(mean) > 0.0 else 0.0
    return float(np.sign(share)) if abs(share) > 0.9 else 0.0


def imposed_rates(dwells: DwellMeans, latitude_deg: float | None) -> FloatArray:
    """Return the true rate of each dwell in b (N, 3), rad/s: L of eq. 4, transposed."""
    earth = 0.0 if latitude_deg is None else EARTH_RATE * np.sin(latitude_deg * RADIAN_PER_DEGREE)
    axis_b = axis_vectors(dwells.axis) if dwells.axes is None else dwells.axes.axis_b
    return np.asarray(axis_b * (dwells.turn_rate + earth * dwells.up)[:, None])


def table_errors(model: TriadModel, dwells: DwellMeans, sigma: FloatArray | None = None) -> dict[str, FloatArray]:
    """Return, by source, the covariance of a model that the scatter of the readings does not show: table, mounting, creep.

    sigma (N, 3) are the standard deviations that weighed the dwells, with the errors that each has on its own; None without.
    """
    if dwells.axes is None:
        return {}
    weight = np.ones((len(dwells.axis), 3)) if sigma is None else sigma**-2
    own = np.array([AXES.index(axis) for axis in dwells.axis])
    shares = dwells.axes.shares(own, weight * dwells.turn_rate[:, None] ** 2, alone=sigma is None)
    return {name: table_term(model, part) for name, part in shares.items()}


def with_errors(model: TriadModel, errors: Mapping[str, FloatArray]) -> TriadModel:
    """Return a model whose covariance also holds errors by source."""
    return replace(model, covariance=model.covariance + sum(errors.values()))


# ---- linearity of one axis (IEEE Std 1431, clause 12 terms)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Linearity:
    """Table of one axis: imposed rate, and how far the reading is from the line."""

    axis: Axis  # x, y or z
    turn_rate: FloatArray  # (N,), imposed, rad/s, increasing
    error: FloatArray  # (N,), reading less line, in rad/s of input
    scale_factor: float  # Slope of the line, reading per rad/s
    offset: float  # Reading of the line at zero rate
    scale_factor_nonlinearity: float  # Largest departure from the line, rad/s
    scale_factor_nonlinearity_percent: float  # The same in per cent of the largest imposed rate
    # 2 (S+ - S-) / (S+ + S-) of reading = o + S+ max(w, 0) + S- min(w, 0); NaN for one sign
    scale_factor_asymmetry: float


def linearity(reading: FloatArray, turn_rate: FloatArray, axis: Axis) -> Linearity:
    """Compare readings (N,) of one axis at rates (N,) with their least-squares line, reading = o + S w."""
    if len(np.unique(turn_rate)) < 2:
        raise NotObservable(
            f"rate axis {axis}: wanted dwells at two different rates or more, got {len(np.unique(turn_rate))}; "
            "record both signs of several rates"
        )
    order = np.argsort(turn_rate)
    rate, value = turn_rate[order], reading[order]
    offset, slope = np.linalg.lstsq(np.column_stack((np.ones_like(rate), rate)), value, rcond=None)[0]
    error = (value - offset - slope * rate) / slope
    worst, asymmetry = float(np.abs(error).max()), float("nan")
    if len(np.unique(rate)) > 2 and rate[0] < 0.0 < rate[-1]:
        bent = np.column_stack((np.ones_like(rate), np.maximum(rate, 0.0), np.minimum(rate, 0.0)))
        _, plus, minus = np.linalg.lstsq(bent, value, rcond=None)[0]
        asymmetry = float(2.0 * (plus - minus) / (plus + minus))
    return Linearity(
        axis=axis,
        turn_rate=rate,
        error=error,
        scale_factor=float(slope),
        offset=float(offset),
        scale_factor_nonlinearity=worst,
        scale_factor_nonlinearity_percent=100.0 * worst / float(np.abs(rate).max()),
        scale_factor_asymmetry=asymmetry,
    )
