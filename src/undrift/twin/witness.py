"""A third witness: accelerometers and optical positions split the difference of gyroscopes and optics.

Orientations of the optics, R_O = exp(e_O) R, and of the gyroscopes integrated from them, R_G = exp(e_G) R, differ by ::

    d = log(R_O R_G^T) = e_O - e_G                                     frame n, 0.4 to 3 Hz

Specific force turned by the optics' orientation, against gravity and the acceleration of the optical position, errs by e_O alone::

    R_O (M u - c - L r) - (p'' + g z) = e_O x F + noise               F = p'' + g z

With errors of optics and gyroscopes that are independent of each other and of that noise, as in a three-cornered hat, the
regression ::

    y = b (d x F) + nuisance + noise        gives        b = var e_O / (var e_O + var e_G)

the optics' share of the difference, and 1 - b the gyroscopes'. Tilt alone is split: d along F, the heading, turns no force.
Nuisance are the accelerometers' own matrix, offset, lever arm and delay, so that no error that follows the motion counts as a
share. Below 0.4 Hz gyroscopes drift, above 3 Hz positions differentiated twice are noise.

The variance of b is the sandwich over blocks of 5 s, longer than the slowest period, and one more term: where the optical origin
lies k away from the markers' middle, an error of orientation is one of position too, e_O'' x k, and b errs by that column's
regression on d x F. The files do not state k; 1 cm per axis is taken.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray
from undrift.findings import Finding, finding
from undrift.frames import integrate_strapdown, quaternion_conjugate, quaternion_product, rotation, rotation_vector
from undrift.twin.accel import Match, force_columns, lever_matrix, stretches
from undrift.twin.fit import Prepared, Twin
from undrift.units import RADIAN_PER_DEGREE

BAND_HZ = (0.4, 3.0)
BLOCK_S = 5.0
_EDGE = 1.5  # periods of the lower end left out at each end of a stretch
_SAMPLES_HZ = 12.0  # kept of what is filtered
ORIGIN_M = 0.01  # standard deviation of the optical origin from the markers' middle, each axis
_LEAST_BLOCKS = 10
_ORDER = 4  # of the band-pass, each way: what gyroscopes drift below the band is many times what is in it


Gyro = tuple[FloatArray, FloatArray, float]  # Matrix (3, 3), offset in motion (3,) rad/s, delay s


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OpticsSplit:
    """Difference of optics and gyroscopes, tilt per horizontal axis, 0.4 to 3 Hz."""

    tilt: float  # Root mean square, rad
    optics_share: float  # Of its square; not held within 0 and 1
    standard_error: float  # Of the share
    blocks: int  # Of 5 s

    @property
    def optics(self) -> float:
        """Tilt error of the optics, rms, rad."""
        return self.tilt * float(np.sqrt(np.clip(self.optics_share, 0.0, 1.0)))

    @property
    def gyro(self) -> float:
        """Tilt error of the integrated gyroscopes, rms, rad."""
        return self.tilt * float(np.sqrt(np.clip(1.0 - self.optics_share, 0.0, 1.0)))

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of the optics' share, within 0 and 1."""
        low, high = self.optics_share + 1.96 * self.standard_error * np.array([-1.0, 1.0])
        return float(np.clip(low, 0.0, 1.0)), float(np.clip(high, 0.0, 1.0))

    def row(self) -> dict[str, object]:
        """Return the figures under the names of the JSON report."""
        return {
            "band_hz": BAND_HZ,
            "tilt_rms_deg": self.tilt / RADIAN_PER_DEGREE,
            "optics_share": self.optics_share,
            "standard_error": self.standard_error,
            "optics_share_95": self.interval,
            "optics_rms_deg": self.optics / RADIAN_PER_DEGREE,
            "gyro_rms_deg": self.gyro / RADIAN_PER_DEGREE,
        }

    @property
    def text(self) -> str:
        """The figures in one line."""
        tilt, optics, gyro = (value / RADIAN_PER_DEGREE for value in (self.tilt, self.optics, self.gyro))
        share, error, low, high = (100.0 * one for one in (self.optics_share, self.standard_error, *self.interval))
        return (
            f"optics and gyroscopes differ by {tilt:.3f} deg rms of tilt per axis, {BAND_HZ[0]:g} to {BAND_HZ[1]:g} Hz; by the "
            f"accelerometers {share:.0f} +- {error:.1f} % of its square, {low:.0f} to {high:.0f} % (95 %), is the optics': "
            f"optics {optics:.3f}, gyroscopes {gyro:.3f} deg"
        )


def split_twin(prepared: Prepared, twin: Twin) -> OpticsSplit | Finding:
    """Split the difference over the recordings that a twin was fitted to."""
    gyro, accel = twin.gyro, twin.accel
    if accel is None:
        return finding("twin.no_witness", "info", seconds=0.0, wanted_s=BLOCK_S * _LEAST_BLOCKS)
    return split_difference(
        prepared.matches,
        [
            (gyro.triad.model.matrix, gyro.model_at_rest_offset(m.rest_offset).offset, m.lag.seconds)
            for m in prepared.matches
        ],
        accel_delay=accel.delay,
        gravity_m_s2=twin.settings.gravity_m_s2,
    )


def split_difference(
    matches: Sequence[Match], gyros: Sequence[Gyro], *, accel_delay: float, gravity_m_s2: float
) -> OpticsSplit | Finding:
    """Split the difference of optics and gyroscopes over recordings, with the gyroscope model of each.

    accel_delay is that of the accelerometers beyond the gyroscopes', s. Returns a finding where too little can be judged.
    """
    tables, block = list[FloatArray](), list[FloatArray]()
    for number, (match, gyro) in enumerate(zip(matches, gyros, strict=True)):
        for table, time in _rows(match, gyro, accel_delay, gravity_m_s2):
            tables.append(table)
            block.append(np.floor(time / BLOCK_S) + 1e6 * number)
    labels = np.unique(np.concatenate(block), return_inverse=True)[1] if block else np.zeros(0, int)
    count = int(labels.max()) + 1 if len(labels) else 0
    if count < _LEAST_BLOCKS:
        return finding("twin.no_witness", "info", seconds=BLOCK_S * count, wanted_s=BLOCK_S * _LEAST_BLOCKS)
    table = np.concatenate(tables)
    left = _without(table[:, :, 5:].reshape(3 * len(table), -1), table[:, :, :5].reshape(-1, 5)).reshape(-1, 3, 5)
    seen, felt = left[:, :, 0], left[:, :, 1]
    power = float((seen**2).sum())
    share = float((seen * felt).sum()) / power
    sums = np.bincount(labels, ((felt - share * seen) * seen).sum(axis=1))
    moved = share * ORIGIN_M * np.einsum("na,nak->k", seen, left[:, :, 2:]) / power
    error = float(np.sqrt((sums**2).sum() * count / (count - 1) / power**2 + moved @ moved))
    tilt = float(np.sqrt((seen**2).sum(axis=1).mean() / 2.0)) / gravity_m_s2
    return OpticsSplit(tilt=tilt, optics_share=share, standard_error=error, blocks=count)


def _without(nuisance: FloatArray, values: FloatArray) -> FloatArray:
    """Return values (n, 2) less what nuisance columns (n, p) explain."""
    size = np.linalg.norm(nuisance, axis=0)
    kept = nuisance[:, size > 0.0] / size[size > 0.0]
    return np.asarray(values - kept @ np.linalg.lstsq(kept, values, rcond=1e-9)[0])


def _rows(match: Match, gyro: Gyro, accel_delay: float, gravity_m_s2: float) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yield for each stretch d x F, the force's error, d'' x k for three k, and the nuisance, (K, 3, 21), and times (K,)."""
    (matrix, offset, delay), readings = gyro, match.record.accel
    if readings is None or match.reference.position is None:
        return
    rate = match.record.sample_rate_hz
    gyro_at = match.at(delay - 0.5 / rate, gravity_m_s2)  # a reading is held over the step before its stamp
    felt_at = match.at(delay + accel_delay, gravity_m_s2)
    turn_rate = (match.gyro - offset) @ matrix.T
    lever, edge = lever_matrix(felt_at), int(np.ceil(_EDGE / BAND_HZ[0] * rate))
    for rows in stretches(match, felt_at, np.hstack((match.gyro, readings))):
        time = match.record.time[rows]
        if len(time) < 3 * edge:
            continue
        q = gyro_at.q_nb[rows]
        turned = integrate_strapdown(turn_rate[rows], time, q[0])
        apart = _band(rotation_vector(quaternion_product(q, quaternion_conjugate(turned))), rate)
        columns = force_columns(readings[rows], felt_at, lever, rows, np.gradient(readings[rows], axis=0) * rate)
        force = columns[:, :, 16]
        felt = columns[:, :, [0, 4, 8]].sum(axis=2) - force
        second = np.gradient(np.gradient(apart, axis=0), axis=0) * rate**2
        shift = np.cross(second[:, None, :], np.swapaxes(rotation(q).as_matrix(), 1, 2)).swapaxes(1, 2)
        seen = (np.cross(apart, force)[:, :, None], felt[:, :, None], shift)
        table = np.concatenate((*seen, columns[:, :, :16]), axis=2)
        kept = slice(edge, len(time) - edge, max(1, int(rate / _SAMPLES_HZ)))
        yield _band(table.reshape(len(time), -1), rate).reshape(table.shape)[kept], time[kept]


def _band(values: FloatArray, rate_hz: float) -> FloatArray:
    """Return columns (N, C) within the band, without delay."""
    from scipy.signal import butter, sosfiltfilt

    return np.asarray(sosfiltfilt(butter(_ORDER, BAND_HZ, "bandpass", fs=rate_hz, output="sos"), values, axis=0))
