"""Table axis: about which axis of the case a rate table really turned, by the gravity felt, and what stays unknown.

In one mounting, axis k of the case along the table's, dwell i turns the device about u_i = k + d + e_i, d and e small and across k,
e the wobble from dwell to dwell. The table's axis is off the vertical by l + h_i, the accelerometers off it by an arm r. The dwell,
at rate w_i and azimuth psi, feels across k::

    mean f_i / g = d + e_i + mean R_k(-psi) (l + h_i) - r w_i^2 / g          two components each, l anew for each recording

    minimise  sum |residual|^2 / s^2 + |l|^2 / level^2 + |r|^2 / arm^2 + (|e|^2 + |h|^2) / wobble^2

wobble is the stated one, or the larger one that the likelihood shows. psi is the integral of the gyroscope of the axis within a
recording, so dwells need no whole turns. All mountings share the accelerometers' errors; the mean axis of each is that felt and
k +- mount, by their covariances, and without accelerometers k +- mount. The mean rate is w_i (1 + rho_i) (table_rate.py). Errors
of axis and rate that are left are those of dwells, weighed as the fit weighs them, and multiply every rate: w_true = (I + D) w::

    dM = D M        dG = D G        D = sum_i c_i du_i k_i' + diag(relative error of the rate)
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.calibration.table_rate import Dwells, azimuths, block_means, uneven_rate
from undrift.findings import Finding, finding
from undrift.fit.least_squares import fit_components
from undrift.model import AXES, TriadModel, level_of
from undrift.record import Axis, Face, RateTable, Still, Turn
from undrift.units import RADIAN_PER_DEGREE

ARM_SD_M = 0.1  # m, of the accelerometers from the table's axis: half the plate of a small table
UNEVEN_PERCENT = (0.1, 2.0)  # of the scale factor, 1 sigma: marginal above the first, bad above the second
_MOUNTED = 4.0  # standard uncertainties: 6 components beyond it: once in 2,600 sessions
_SMALL_ANGLE = 1e-3  # rad: what every case lies off by, however well it is mounted
_FIRST = 1e-6  # variance of the wobble to begin with: 0.06 deg
_PASSES = 4  # of fit and noise
_LEAST_NOISE = 1e-12  # variance of block means of the direction of gravity, rad2: 1 ug, and sound arithmetic


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TableAxes:
    """The rates of the dwells over the stated ones, and what stays unknown of them."""

    axis_b: FloatArray  # (N, 3), mean rate over the stated one: the axis, of length 1 + rho
    spread: FloatArray  # (3N, 3N), its covariance, dwell by dwell
    apart: FloatArray  # (N, 3), variance that each dwell has on its own, on the diagonal of ``spread``
    covariance: FloatArray  # (9, 9), of D row by row, without ``spread``
    off: FloatArray  # (N,), measured angle between case axis and table axis, rad; NaN where gravity did not show it
    beyond: float  # Largest d as felt, in standard deviations of mounting and measurement; 0 where nothing is felt
    uneven: FloatArray  # (3,), standard uncertainty of the mean rate about x, y, z by ripple and settling, relative
    size: (
        FloatArray  # (3,), rms of ripple once a turn, twice a turn and of settling, relative; 0 where they do not show
    )
    creep: FloatArray = field(
        default_factory=lambda: np.zeros((9, 9))
    )  # of ``covariance``, by the session's temperature

    def shares(self, own: IntArray, square: FloatArray) -> dict[str, FloatArray]:
        """Return what ``of_rates`` sums, (9, 9) each, by source of a budget; arguments as there, without what is alone."""
        rate, spread = self.covariance - self.creep, self.of_rates(own, square, alone=False) - self.covariance
        along = np.eye(3, dtype=bool).ravel()
        along = along[:, None] & along[None, :]
        mounting, ripple = (np.where(along, 0.0, spread), np.where(along, spread, 0.0))
        return {"rate": rate, "ripple": ripple, "mounting": mounting, "temperature": self.creep}

    def of_rates(self, own: IntArray, square: FloatArray, *, alone: bool) -> FloatArray:
        """Return the covariance (9, 9) of D where dwells (N,) about axes ``own`` weigh by ``square`` (N, 3).

        ``alone`` counts also what each dwell has on its own; a fit whose noise holds that leaves it out.
        """
        share, rows = np.zeros((9, 3 * len(own))), np.arange(len(own))
        for a in range(3):
            total = np.bincount(own, square[:, a], minlength=3)
            share[3 * a + own, 3 * rows + a] = square[:, a] / np.maximum(total, 1e-300)[own]
        spread = self.spread - (0.0 if alone else np.diag(self.apart.ravel()))
        return self.covariance + share @ spread @ share.T


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
    """Return the axes about which the dwells turned the case, and at what part of the stated rates."""
    own, lines, count = dwells.own, dwells.lines, len(dwells.own)
    axis_b, off, spread = np.eye(3)[own], np.full(count, np.nan), np.zeros((3 * count, 3 * count))
    apart, beyond = np.zeros((count, 3)), 0.0
    wobble, mount = (np.square(deg * RADIAN_PER_DEGREE) for deg in (table.wobble_deg, table.mount_tilt_deg))
    codes = np.zeros(3) if accel is None else dwells.codes(rate=False)
    seen: list[_Mounted] = []
    blocks: dict[tuple[int, int, float], list[int]] = {}
    for n in sorted(range(count), key=lambda n: dwells.turns[n].recording):
        blocks.setdefault((int(dwells.mounting[n]), int(own[n]), float(dwells.up[n])), []).append(n)
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
        tilts, found, beyond = _with_prior(seen, accel, mount)
        axes = [np.array([3 * n + (own[n] + c) % 3 for n in one.rows for c in (1, 2)]) for one in seen]
        places = np.concatenate(axes)
        axis_b.reshape(-1)[places] = tilts
        spread[np.ix_(places, places)] = found
        for one, place in zip(seen, axes, strict=True):
            off[one.rows] = np.hypot(*one.tilt.reshape(-1, 2).mean(axis=0))
            for c in (0, 1):
                apart.reshape(-1)[place[c::2]] = _alone(spread[np.ix_(place[c::2], place[c::2])])
    axis_b /= np.linalg.norm(axis_b, axis=1)[:, None]
    rate = uneven_rate(dwells)
    along = 3 * np.arange(count) + own
    spread[np.ix_(along, along)] = rate.covariance
    for k in range(3):
        apart.reshape(-1)[along[own == k]] = _alone(rate.covariance[np.ix_(own == k, own == k)])
    share = np.where(own == np.arange(3)[:, None], dwells.turn_rate**2, 0.0)
    share /= np.maximum(share.sum(axis=1), 1e-300)[:, None]
    return TableAxes(
        axis_b=axis_b * (1.0 + rate.ratio)[:, None],
        spread=spread,
        apart=apart,
        covariance=_scales(np.full((3, 3), table.rate_uncertainty**2)),
        off=off,
        beyond=beyond,
        uneven=np.sqrt(np.diag(share @ rate.covariance @ share.T)),
        size=rate.size,
    )


def _scales(covariance: FloatArray) -> FloatArray:
    """Return the covariance (9, 9) of D of relative errors of the rates about x, y, z (3, 3)."""
    made = np.zeros((9, 9))
    made[np.ix_([0, 4, 8], [0, 4, 8])] = covariance
    return made


def _alone(covariance: FloatArray) -> FloatArray:
    """Return the variance (n,) of each of n errors beyond what all have in common."""
    count, variance = len(covariance), np.diag(covariance)
    if count < 2:
        return np.zeros(count)
    common = (covariance.sum() - variance.sum()) / (count * (count - 1))
    return np.asarray(variance - np.clip(common, 0.0, variance))


def _with_prior(seen: list[_Mounted], accel: TriadModel, mount: float) -> tuple[FloatArray, FloatArray, float]:
    """Return the axes across k of all dwells (2N,), their covariance, and the largest mean as felt in its standard deviations."""
    felt = np.concatenate([one.tilt for one in seen])
    jacobian = np.vstack([np.tile(one.of_accel, (len(one.rows), 1)) for one in seen])
    spread = jacobian @ accel.covariance[:12, :12] @ jacobian.T
    mean, start = np.zeros((2 * len(seen), len(felt))), 0
    for number, one in enumerate(seen):
        own = slice(start, start + len(one.tilt))
        spread[own, own] += one.covariance
        mean[2 * number : 2 * number + 2, own] = np.tile(np.eye(2), len(one.rows)) / len(one.rows)
        start = own.stop
    total = mean @ spread @ mean.T + mount * np.eye(len(mean))
    gain = np.linalg.solve(total, mean @ spread).T
    beyond = float((np.abs(mean @ felt) / np.sqrt(np.diag(total))).max())
    return felt - gain @ (mean @ felt), spread - gain @ mean @ spread, beyond


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
    if any(len(part) == 0 for part in parts):
        return None
    designs, across, wobbles = [], [], 4 + 2 * len(recordings)
    for number, (n, part) in enumerate(zip(rows, parts, strict=True)):
        square, place = dwells.turn_rate[n] ** 2 / gravity_m_s2, 4 + 2 * recordings.index(dwells.turns[n].recording)
        design = np.zeros((len(part), 2, wobbles + 4 * len(rows)))
        design[:, [0, 1], [0, 1]], design[:, [0, 1], [2, 3]] = 1.0, square
        e = wobbles + 4 * number
        design[:, [0, 1], [e, e + 1]] = 1.0
        for level in (place, e + 2):
            design[:, [0, 1], [level, level + 1]] = part[:, :1]
            design[:, 0, level + 1], design[:, 1, level] = part[:, 1], -part[:, 1]
        designs.append(design.reshape(-1, design.shape[2]))
        across.append(part[:, 2:].ravel())
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
    found, sizes = [], dwells.sizes
    for n, angle in zip(rows, angles, strict=True):
        force = gain * (np.asarray(record.accel[dwells.settled(n)]) - accel.offset) @ accel.matrix.T
        parts = np.column_stack((np.cos(angle), np.sin(angle), force[:, [(k + 1) % 3, (k + 2) % 3]]))
        means = block_means(parts, sizes[n])
        found.append(means[~np.isnan(means).any(axis=1)])
    return found


def _posterior(
    design: FloatArray, reading: FloatArray, precision: FloatArray, wobbles: int, stated: float
) -> tuple[FloatArray, FloatArray]:
    """Return parameters and covariance: block means (E,) whose noise is not known, wobble from a place on."""
    square, product = design.T @ design, design.T @ reading
    group = np.arange(wobbles, design.shape[1])
    plain = design[:, :wobbles]
    left = reading - plain @ np.linalg.lstsq(plain, reading, rcond=None)[0]
    noise = max(float(left @ left) / max(len(left) - wobbles, 1), _LEAST_NOISE)
    for _ in range(_PASSES):
        found = fit_components(square / noise, product / noise, precision, [group], np.array([stated]), _FIRST)
        left = reading - design @ found.theta
        fitted = float((square * found.covariance).sum()) / noise  # parameters that the readings determine
        noise = max(float(left @ left) / max(len(left) - fitted, 1.0), _LEAST_NOISE)
    return found.theta, found.covariance


def table_findings(axes: TableAxes, mount_tilt: float) -> Iterator[Finding]:
    """Yield what the axes of a table show that a user can act on."""
    if np.isfinite(axes.off).any():
        off = float(np.nanmax(axes.off))
        beyond = axes.beyond > _MOUNTED and off > _SMALL_ANGLE
        degrees, stated = off / RADIAN_PER_DEGREE, mount_tilt / RADIAN_PER_DEGREE
        yield finding("rate_table.mounting", "warn" if beyond else "info", angle_deg=degrees, stated_deg=stated)
    if axes.size.any():
        ripple, settle = 100.0 * float(np.hypot(*axes.size[:2])), 100.0 * float(axes.size[2])
        yield finding("rate_table.ripple", "info", ripple_percent=ripple, settle_percent=settle)
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
