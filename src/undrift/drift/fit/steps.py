"""Rate steps made ready for the fits: usable rows, soaks and mountings by number, noise where it was not told.

A mounting is a stretch of one soak in which the device turned about one direction of its case: its rows share what the offset
table leaves (hysteresis, g-sensitivity of that pose).
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray
from undrift.calibration.model import Calibration, ScaleDrift, StaticDrift, TriadModel, Verdict
from undrift.drift.observe.observations import RateSteps, RestBlocks
from undrift.errors import InputError
from undrift.units import si_factor

_SAME_DIRECTION = 0.98  # cosine
_SAME_POSE = 0.2  # of the largest difference between two poses
_SAME_TEMPERATURE_C = 1.5


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Steps:
    """Usable rate steps, n rows.

    Parameters
    ----------
    session, soak, mounting : array of int, shape (n,)
        Numbers from 0: session as given, soak over all sessions, mounting over all soaks.
    temp_c : array, shape (n,)
        degC.
    rate_b : array, shape (n, 3)
        Imposed rate, rad/s.
    along : array, shape (n,)
        The same along the direction of its mounting, rad/s.
    gyro, accel : array, shape (n, 3)
        Mean reading, raw unit; accel may be NaN.
    variance : array, shape (n, 3)
        Of the gyro means, raw unit squared; the median where it was not told.
    verdict : Verdict
        What was left out.
    """

    session: IntArray
    soak: IntArray
    mounting: IntArray
    temp_c: FloatArray
    rate_b: FloatArray
    along: FloatArray
    gyro: FloatArray
    accel: FloatArray
    variance: FloatArray
    verdict: Verdict

    def __len__(self) -> int:
        return len(self.temp_c)

    def taken(self, rows: BoolArray | IntArray) -> "Steps":
        """Return some of the rows, numbers unchanged.

        Parameters
        ----------
        rows : array
            Mask or row numbers.

        Returns
        -------
        Steps
            Those rows.
        """
        names = [name for name in self.__dataclass_fields__ if name != "verdict"]
        return Steps(**{name: getattr(self, name)[rows] for name in names}, verdict=self.verdict)


def steps_of(steps: RateSteps | Steps) -> Steps:
    """Return the usable rows of rate steps.

    Parameters
    ----------
    steps : RateSteps or Steps
        Steps that are ready already pass.

    Returns
    -------
    Steps
        Without gaps and without rows at rest.

    Raises
    ------
    InputError
        No usable row.
    """
    if isinstance(steps, Steps):
        return steps
    told = np.isfinite(steps.gyro).all(axis=1) & np.isfinite(steps.rate_b).all(axis=1) & np.isfinite(steps.temp_c)
    rows = np.flatnonzero(told & (np.abs(steps.rate_b).max(axis=1, initial=0.0) > 0.0))
    if not len(rows):
        raise InputError(
            f"rate steps: wanted dwells with rate, reading and temperature, got {len(steps)} rows and none of them usable; "
            "check turn_rate_dps, temp_c and gaps in the recording"
        )
    kept = steps.taken(rows)
    soak = np.unique(np.column_stack((kept.session, kept.soak)), axis=0, return_inverse=True)[1].reshape(-1)
    direction, along = _directions(kept.rate_b)
    mounting = np.unique(np.column_stack((soak, direction)), axis=0, return_inverse=True)[1].reshape(-1)
    lost = len(steps) - int(told.sum())
    reason = f"{lost} of {len(steps)} rate steps have gaps in rate, reading or temperature and were left out"
    return Steps(
        session=kept.session,
        soak=soak,
        mounting=mounting,
        temp_c=kept.temp_c,
        rate_b=kept.rate_b,
        along=along,
        gyro=kept.gyro,
        accel=kept.accel,
        variance=_variance(kept.gyro_variance, kept.gyro),
        verdict=Verdict(status="marginal", reasons=(reason,)) if lost else Verdict(),
    )


def gyro_model(calibration: Calibration) -> TriadModel:
    """Return the gyroscopes' constant model.

    Parameters
    ----------
    calibration : Calibration
        The device's.

    Returns
    -------
    TriadModel
        Raw unit to rate.

    Raises
    ------
    InputError
        A calibration without gyroscopes.
    """
    if calibration.gyro is None:
        raise InputError(
            "rate steps: wanted a calibration with gyroscopes, got one without; calibrate on a rate table first"
        )
    return calibration.gyro


def offset_at(temp_c: FloatArray, calibration: Calibration, static: StaticDrift | None) -> FloatArray:
    """Return the gyroscopes' offset at some temperatures: from the table, else the constant.

    Parameters
    ----------
    temp_c : array, shape (n,)
        degC; held at the table's ends.
    calibration : Calibration
        The device's constant model.
    static : StaticDrift or None
        Offset table.

    Returns
    -------
    array, shape (n, 3)
        Raw unit.
    """
    if static is None or static.gyro_offset is None:
        return np.tile(gyro_model(calibration).offset, (len(temp_c), 1))
    return np.column_stack([np.interp(temp_c, static.temp_c, column) for column in static.gyro_offset.T])


def measured_rate(
    gyro: FloatArray,
    temp_c: FloatArray,
    calibration: Calibration,
    *,
    static: StaticDrift | None,
    scale: ScaleDrift | None,
) -> FloatArray:
    """Return the rate that offset(T) and M(T) make of mean readings: M(T) (u - offset(T)).

    Parameters
    ----------
    gyro : array, shape (n, 3)
        Mean readings, raw unit.
    temp_c : array, shape (n,)
        degC.
    calibration : Calibration
        The device's constant model.
    static : StaticDrift or None
        Offset table.
    scale : ScaleDrift or None
        Matrix table; the constant matrix where there is none.

    Returns
    -------
    array, shape (n, 3)
        rad/s, frame b.
    """
    model = gyro_model(calibration)
    matrix = np.tile(model.matrix, (len(temp_c), 1, 1))
    if scale is not None and scale.gyro_matrix is not None:
        flat = scale.gyro_matrix.reshape(-1, 9)
        matrix = np.column_stack([np.interp(temp_c, scale.temp_c, column) for column in flat.T]).reshape(-1, 3, 3)
    rate: FloatArray = np.einsum("nij,nj->ni", matrix, gyro - offset_at(temp_c, calibration, static))
    return rate * si_factor(model.unit_out, "rate")


def rests_of(steps: Steps, blocks: RestBlocks | None) -> tuple[IntArray, IntArray]:
    """Find the blocks of rest that lay as the device turned: same session, temperature and pose as a mounting.

    Parameters
    ----------
    steps : Steps
        With accelerometer readings, which tell the pose; without them no block is taken.
    blocks : RestBlocks or None
        Blocks of rest.

    Returns
    -------
    block : array of int, shape (k,)
        Rows of the blocks.
    step : array of int, shape (k,)
        A row of ``steps`` of the mounting that each belongs to.
    """
    nothing = np.empty(0, dtype=np.int64)
    if blocks is None or not len(blocks):
        return nothing, nothing
    firsts = np.unique(steps.mounting, return_index=True)[1]
    means = np.array([steps.accel[steps.mounting == steps.mounting[k]].mean(axis=0) for k in firsts])
    temps = np.array([steps.temp_c[steps.mounting == steps.mounting[k]].mean() for k in firsts])
    span = np.linalg.norm(means[:, None] - means[None], axis=2).max()
    if not np.isfinite(span) or span == 0.0:
        return nothing, nothing
    found, of = [], []
    usable = np.isfinite(blocks.gyro).all(axis=1) & np.isfinite(blocks.accel).all(axis=1) & np.isfinite(blocks.temp_c)
    for b in np.flatnonzero(usable):
        off = np.linalg.norm(means - blocks.accel[b], axis=1) / span
        apart = np.abs(temps - blocks.temp_c[b])
        fits = (off < _SAME_POSE) & (apart < _SAME_TEMPERATURE_C) & (steps.session[firsts] == blocks.session[b])
        if fits.any():
            found.append(b)
            of.append(firsts[np.flatnonzero(fits)[apart[fits].argmin()]])
    return np.array(found, dtype=np.int64), np.array(of, dtype=np.int64)


def _directions(rate_b: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return which direction each row turns about, up to its sign, and the rate along it."""
    length = np.linalg.norm(rate_b, axis=1)
    unit = rate_b / length[:, None]
    found: list[FloatArray] = []
    number, sign = np.empty(len(rate_b), dtype=np.int64), np.empty(len(rate_b))
    for k, direction in enumerate(unit):
        cosine = np.array([direction @ other for other in found])
        near = np.flatnonzero(np.abs(cosine) > _SAME_DIRECTION)
        if not len(near):
            axis = int(np.abs(direction).argmax())
            found.append(direction * np.sign(direction[axis]))
            near, cosine = np.array([len(found) - 1]), np.append(cosine, np.sign(direction[axis]))
        number[k], sign[k] = near[0], np.sign(cosine[near[0]])
    return number, length * sign


def _variance(variance: FloatArray, reading: FloatArray) -> FloatArray:
    """Return variances that are told and above zero; the median of the others, or the last digit, where they are not."""
    told = np.isfinite(variance) & (variance > 0.0)
    least = (1e-9 * np.maximum(np.abs(reading).max(axis=0), 1e-30)) ** 2
    middle = np.array([np.median(v[ok]) if ok.any() else 0.0 for v, ok in zip(variance.T, told.T, strict=True)])
    filled: FloatArray = np.maximum(np.where(told, variance, middle), least)
    return filled
