"""Average dwells on a rate table, and measure the axis of the case about which the table actually turned.

``dwell_means`` averages the steady turns of a session. ``table_axes`` measures the axis of each turn in the case with gravity.
``imposed_rates`` returns the rates that a fit uses as its input.

The start of a dwell, in which the table settles, is omitted. If the remainder contains a whole turn, whole turns are averaged. Then
a ripple of the rate and the Earth's horizontal rate average out.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.calibration.codes import code_steps, code_variance, mean_rounding
from undrift.calibration.plausibility import check_range
from undrift.calibration.quality import steady
from undrift.calibration.session import spans_of
from undrift.errors import InputError
from undrift.fit.gls import Prior, block_size, noise_of_means, solve
from undrift.fit.priors import ACCEL_FLICKER, SETTLE_S, TABLE_ARM, TABLE_MOUNTING
from undrift.model import AXES, TriadModel
from undrift.record import Axis, Face, RateTable, Record, Still, Turn
from undrift.units import EARTH_RATE, RADIAN_PER_DEGREE

LEAST_SAMPLES = 8
NOTE_CUTOFF_HZ = 5.0  # cut-off of the note's spline filter in mode paper, Hz; the note gives no value. Assumed.
FILTER_S = 0.3  # start of a dwell that gravity means omit: settling of a second-order filter at 11 Hz to 1e-6
MOST_BLOCKS = 12  # number of means of the specific force in one dwell
MIN_TILT_SD = 1e-6  # smallest error of block means of the direction of gravity, for sound arithmetic, rad

# ---- mean readings of the dwells


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TableAxes:
    """Axes of the case about which the dwells turned, with the errors of these axes and of their rates."""

    direction: FloatArray  # (N, 3), axis of each dwell
    columns: FloatArray  # (N, 3, C), errors of ``direction`` from C independent causes, one standard deviation each
    rate: float  # relative standard uncertainty common to all given rates


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DwellMeans:
    """Mean readings at steady rates and at rest."""

    reading: FloatArray  # (N, 3), mean reading in each dwell, ``unit``
    turn_rate: FloatArray  # (N,), achieved rate about +axis, rad/s
    axis: tuple[Axis | None, ...]  # axis of each dwell, None at rest
    noise: FloatArray | None = None  # (N, 3), standard deviation of each mean, or None if unknown
    # (N,), 1 if +axis points up, -1 if it points down, 0 if it is not vertical (default 1)
    up: FloatArray = field(default_factory=lambda: np.ones(1))
    unit: str = "rad/s"  # unit of the readings
    span: FloatArray | None = None  # (N, 2), start and stop of each dwell on a common clock, s, or None if unknown
    # (3,), step of the codes, 0 or NaN for none, and the variance of a mean due to the codes, included in ``noise``
    step: FloatArray = field(default_factory=lambda: np.zeros(3))
    codes: FloatArray = field(default_factory=lambda: np.zeros(3))
    axes: TableAxes | None = None  # axes of the case about which the table turned, or None if ``axis`` is exact
    force: FloatArray | None = None  # (N, 3), specific force, from accelerometers or along the labelled faces, m/s2
    felt: bool = True  # False without accelerometers: a g-sensitivity is then fitted, but cannot be corrected

    @property
    def axis_b(self) -> FloatArray:
        """Axis of each dwell in the case, (N, 3), 0 at rest."""
        return np.array([np.zeros(3) if axis is None else np.eye(3)[AXES.index(axis)] for axis in self.axis])

    def with_rests(
        self, reading: FloatArray, *, noise: FloatArray, span: FloatArray, force: FloatArray
    ) -> "DwellMeans":
        """Return the dwells followed by rests (P, 3), and the specific force (N + P, 3) of both."""
        count, axes = len(reading), self.axes
        if axes is not None:
            axes = replace(
                axes,
                direction=np.pad(axes.direction, ((0, count), (0, 0))),
                columns=np.pad(axes.columns, ((0, count), (0, 0), (0, 0))),
            )
        return replace(
            self,
            reading=np.vstack((self.reading, reading)),
            turn_rate=np.pad(self.turn_rate, (0, count)),
            axis=(*self.axis, *[None] * count),
            noise=None if self.noise is None else np.vstack((self.noise, noise)),
            up=np.pad(np.broadcast_to(self.up, len(self.axis)), (0, count)),
            span=None if self.span is None else np.vstack((self.span, span)),
            axes=axes,
            force=force,
        )


def dwell_means(
    records: Sequence[Record], turns: Sequence[Turn], *, settle_s: float = SETTLE_S, cutoff_hz: float | None = None
) -> DwellMeans:
    """Average turns at known rates.

    The first ``settle_s`` of each dwell are omitted, but at most half of the dwell. The note's smoothing spline halves the signal
    at ``cutoff_hz``. It is not applied if ``cutoff_hz`` is None, which leaves the means unchanged.
    """
    parts = [_discard_settling(records[t.recording], t, settle_s) for t in turns]
    windows = smooth = [np.asarray(record.gyro) for record in parts]
    if cutoff_hz is not None:
        smooth = [spline_filter(record.time, w, cutoff_hz) for record, w in zip(parts, windows, strict=True)]
    sizes = [block_size(record.sample_rate_hz) for record in records]
    noise = noise_of_means(windows, [sizes[t.recording] for t in turns])
    step = code_steps([records[k] for k in {t.recording for t in turns}], rate=True)
    # half the variance of successive differences is the variance of a single reading
    codes = code_variance(step, np.mean([0.5 * np.diff(window, axis=0).var(axis=0) for window in windows], axis=0))
    return DwellMeans(
        reading=np.array([w.mean(axis=0) for w in smooth]),
        turn_rate=np.array([t.turn_rate for t in turns], float),
        axis=tuple(t.axis for t in turns),
        noise=None if noise is None else np.hypot(noise, np.sqrt(codes)),
        up=np.array([_points_up(record, AXES.index(t.axis or "x")) for record, t in zip(parts, turns, strict=True)]),
        unit=parts[0].gyro_unit,
        span=spans_of(records, turns),
        step=step,
        codes=codes,
    )


def spline_filter(time: FloatArray, values: FloatArray, cutoff_hz: float) -> FloatArray:
    """Smooth each column of values (N, 3) with the note's cubic smoothing spline.

    It minimises sum (y - f)^2 + lambda integral f''^2, a low-pass filter of fourth order that halves the signal at the frequency w
    with lambda dt w^4 = 1. It keeps straight lines, so the mean of its samples equals the mean of the readings to rounding.
    """
    from scipy.interpolate import make_smoothing_spline

    stiffness = 1.0 / (float(np.median(np.diff(time))) * (2.0 * np.pi * cutoff_hz) ** 4)
    elapsed = time - time[0]
    return np.asarray(make_smoothing_spline(elapsed, values, lam=stiffness)(elapsed))


def _discard_settling(record: Record, turn: Turn, settle_s: float) -> Record:
    used = steady(record, turn, settle_s)
    dwell = record.part(used.start, used.stop)
    if len(dwell) < LEAST_SAMPLES:
        raise InputError(
            f"dwell [{turn.start}, {turn.stop}): expected {LEAST_SAMPLES} samples or more after the start in which the table "
            f"settles, got {len(dwell)}. Dwell longer."
        )
    values = np.asarray(dwell.gyro)
    gaps = int(np.isnan(values).any(axis=1).sum())
    if gaps:
        raise InputError(f"dwell [{turn.start}, {turn.stop}): the readings have gaps ({gaps}). Shorten the dwell.")
    check_range([values], f"gyroscope at {turn.turn_rate:.4g} rad/s about {turn.axis}")
    return dwell


def _points_up(stretch: Record, axis: int) -> float:
    if stretch.accel is None or stretch.accel_unit in ("count", "v"):
        return 1.0
    mean = np.nanmean(stretch.accel, axis=0)
    share = float(mean[axis] / np.linalg.norm(mean)) if np.linalg.norm(mean) > 0.0 else 0.0
    return float(np.sign(share)) if abs(share) > 0.9 else 0.0


def imposed_rates(dwells: DwellMeans, latitude_deg: float | None) -> FloatArray:
    """Return the true rate of each dwell in b (N, 3), rad/s: L of eq. 4, transposed."""
    earth = 0.0 if latitude_deg is None else EARTH_RATE * np.sin(latitude_deg * RADIAN_PER_DEGREE)
    axis_b = dwells.axis_b if dwells.axes is None else dwells.axes.direction
    return np.asarray(axis_b * (dwells.turn_rate + earth * dwells.up)[:, None])


# ---- axis of the table in the case, from gravity as the accelerometers measure it
#
# In a mounting, axis k of the case is along the axis of the table. The device turns about k + d: d is small, across k, and common
# to the mounting. The accelerometers are at a distance r from the axis, which leaves the vertical by l_i in dwell i, in the frame
# of the table at the start of the dwell. e_i and e'_i are the wobble. Block means of the specific force across k, at the rate w_i
# and the angle psi since the start:
#
#     f / g = d + e_i + R_k(-psi) (l_i + e'_i) - r w_i^2 / g + noise
#
# d and r have priors, l has a given size, and noise and wobble have excess variances. Over whole turns the level averages out. The
# errors of the accelerometers are common to all mountings: df = dM s - M do. Without accelerometers, d is zero, with the given
# uncertainty of the mounting.


def mountings(pieces: Sequence[Still | Turn]) -> IntArray:
    """Return the number of the mounting on a rate table of each piece (P,), or -1 off the table.

    Turns about the same axis at known rates, and rests with that axis up, belong together until another piece follows.
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


def table_axes(
    records: Sequence[Record],
    turns: Sequence[Turn],
    dwells: DwellMeans,
    mounting: IntArray,
    *,
    table: RateTable,
    accel: TriadModel | None,
    gravity_m_s2: float,
    settle_s: float,
) -> TableAxes:
    """Return the axes about which dwells turned the case, measured by accelerometers if there are any.

    ``turns`` (N,) and ``mounting`` (N,) describe the turn and the mounting of each dwell.
    """
    axis, count = np.array([AXES.index(name) for name in dwells.axis], int), len(dwells.axis)
    up, direction, columns = np.broadcast_to(dwells.up, count), np.eye(3)[axis], list[FloatArray]()
    accel_columns = np.zeros((count, 3, 12))
    for number in np.unique(mounting):
        rows: list[int] = np.flatnonzero(mounting == number).tolist()
        k, gravity = int(axis[rows[0]]), float(gravity_m_s2 * up[rows].mean())
        level_axes = [(k + 1) % 3, (k + 2) % 3]
        place, root = np.ix_(rows, level_axes), table.mount_tilt_deg * RADIAN_PER_DEGREE * np.eye(2)
        wobble = table.wobble_deg * RADIAN_PER_DEGREE * np.eye(len(rows))
        if accel is not None and abs(gravity) == gravity_m_s2:
            parts = [_force_in_dwell(records[turns[n].recording], turns[n], accel, level_axes, settle_s) for n in rows]
            if all(len(part) for part in parts):
                tilt, covariance = _tilt_by_gravity(parts, dwells.turn_rate[rows], table, gravity)
                readings = [np.asarray(record.accel) for record in records]
                windows = [readings[turns[n].recording][turns[n].start : turns[n].stop] for n in rows]
                # all dwells measure the same gravity, with the same rounding error
                codes = accel.matrix[level_axes] / gravity * np.nan_to_num(mean_rounding(readings, windows))
                direction[place], root = tilt, np.hstack((np.linalg.cholesky(covariance), codes))
                wobble -= wobble.mean(axis=0)  # the tilt is the mean over these dwells, including wobble
                reading = np.linalg.solve(accel.matrix, np.eye(3)[k])  # in g, minus the offset
                slopes = np.hstack((np.kron(np.eye(3), reading), -accel.matrix / gravity))
                accel_columns[place] = slopes[level_axes]
        columns.append(np.zeros((count, 3, root.shape[1])))
        columns[-1][place] = root
        columns.append(np.zeros((count, 3, 2 * len(rows))))
        columns[-1][place] = np.kron(np.eye(2), wobble).reshape(2, len(rows), -1).transpose(1, 0, 2)
    if accel is not None:
        variance, vectors = np.linalg.eigh(accel.covariance[:12, :12])
        columns.append(accel_columns @ (vectors * np.sqrt(variance.clip(0.0))))
    return TableAxes(
        direction=direction / np.linalg.norm(direction, axis=1)[:, None],
        columns=np.concatenate(columns, axis=2),
        rate=table.rate_uncertainty,
    )


def _force_in_dwell(
    record: Record, turn: Turn, accel: TriadModel, level_axes: list[int], settle_s: float
) -> FloatArray:
    """Return block means (B, 4) of cosine and sine of psi and of the force across the axis, without blocks with gaps."""
    window = steady(record, turn, min(settle_s, FILTER_S))
    angle = (turn.turn_rate or 0.0) * (record.time[window] - record.time[window.start])
    force = (np.asarray(record.accel)[window] - accel.offset) @ accel.matrix[level_axes].T
    values = np.column_stack((np.cos(angle), np.sin(angle), force))
    size = max(block_size(record.sample_rate_hz), len(values) // MOST_BLOCKS)
    means = values[: len(values) // size * size].reshape(-1, size, 4).mean(axis=1)
    return np.asarray(means[~np.isnan(means).any(axis=1)])


def _tilt_by_gravity(
    parts: list[FloatArray], turn_rate: FloatArray, table: RateTable, gravity: float
) -> tuple[FloatArray, FloatArray]:
    """Return d (2,) of a mounting from the blocks of each dwell, and its covariance (2, 2) without the mean of their wobble."""
    from scipy.linalg import block_diag

    designs, axes, plates = list[FloatArray](), list[FloatArray](), list[FloatArray]()
    for part, rate in zip(parts, turn_rate, strict=True):
        turned = np.stack((part[:, [0, 1]], part[:, [1, 0]] * [-1.0, 1.0]), axis=1).reshape(-1, 2)  # R_k(-psi)
        ones = np.tile(np.eye(2), (len(part), 1))
        designs.append(np.hstack((ones, rate**2 / gravity * ones)))
        axes.append(ones @ ones.T)  # the axis in the case
        plates.append(turned @ turned.T)  # and the tilt of the plate in the frame of the table
    force = np.concatenate([part[:, 2:].ravel() for part in parts]) / gravity
    wobble, level = table.wobble_deg * RADIAN_PER_DEGREE, table.table_level_deg * RADIAN_PER_DEGREE
    axis, plate = block_diag(*axes), block_diag(*plates)
    fit = solve(
        np.vstack(designs),
        force,
        {
            "noise": np.full(len(force), MIN_TILT_SD**2),
            "axis": wobble**2 * axis,
            "plate": (wobble**2 + level**2) * plate,
        },
        excess={"noise": np.ones(len(force)), "plate wobble": axis + plate},
        prior=Prior(mean=np.zeros(4), precision=np.diag(np.repeat([TABLE_MOUNTING, TABLE_ARM], 2) ** -2)),
    )
    covariance = (fit.covariance - fit.budget["axis"])[:2, :2]
    return fit.theta[:2], covariance + (ACCEL_FLICKER / gravity) ** 2 * np.eye(2)
