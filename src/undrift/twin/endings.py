"""End errors: what many devices that the twin allows would be off by after a motion, beside what the real one was.

Each draw has a matrix and an in-motion offset from the covariance of the fit, an offset at rest that differs from the mean of
the other recordings as much as recordings of a device differ, and noise and codes of its own. The held-out motion is the rate
between its poses, the corrected real rate where the poses are missing, and nothing at rest. The readings go through the
protocol of ``validation.trial``: (a) as they come, (b) less their mean over the first rest. The poses are smoothed further
than for windows: pose noise of 1 deg/s would carry codes of a device that pauses to both sides of zero, and a code that
changes sign loses nothing on average to truncation, while one that does not loses half a step.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from undrift.arrays import FloatArray
from undrift.frames import quaternion_of, quaternion_product, rotate
from undrift.orientation.strapdown import integrate_strapdown
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.offset import Offset
from undrift.sim.device.simulate import simulate_device
from undrift.sim.motion.motion import Motion
from undrift.sim.motion.poses import PoseSettings, fit_pose_spline
from undrift.twin.device import chain_of
from undrift.twin.fit import Prepared, Twin
from undrift.twin.heldout import Stage, hold_out
from undrift.twin.parameters import spread_of
from undrift.units import RADIAN_PER_DEGREE
from undrift.validation import TrialSettings, validate_trial
from undrift.validation.errors import compare_orientations

Row = Literal["raw", "rest"]
ROWS: tuple[Row, ...] = ("raw", "rest")
SLOW_SETTINGS = PoseSettings(cutoff_hz=5.0)
_LEAD_S, _END_S, _EVERY_S = 0.5, 3.0, 0.25
_WITHIN = (2.5, 97.5)  # per cent of the draws


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ending:
    """End errors of one recording.

    Parameters
    ----------
    recording : str
        Name.
    row : str
        "raw": no offset taken off. "rest": less the mean of the first rest.
    real : array, shape (2,)
        Total and inclination, rad.
    simulated : array, shape (D, 2)
        The same of every draw.
    """

    recording: str
    row: Row
    real: FloatArray
    simulated: FloatArray

    @property
    def interval(self) -> FloatArray:
        """Central 95 % of the draws, shape (2, 2): low and high of total and inclination, rad."""
        interval: FloatArray = np.percentile(self.simulated, _WITHIN, axis=0).T
        return interval

    @property
    def covered(self) -> tuple[bool, bool]:
        """Whether the real total and inclination lie within the central 95 % of the draws."""
        inside = (self.real >= self.interval[:, 0]) & (self.real <= self.interval[:, 1])
        return bool(inside[0]), bool(inside[1])


def end_errors(prepared: Prepared, *, rng: np.random.Generator, draws: int = 60) -> tuple[Ending, ...]:
    """Compare simulated and real end errors of every recording, each against the twin of the others.

    Parameters
    ----------
    prepared : Prepared
        Two recordings of a device or more.
    rng : Generator
        Draws devices and noise.
    draws : int
        Simulated devices for each recording.

    Returns
    -------
    tuple of Ending
        Two rows for each recording.

    Raises
    ------
    InputError
        One recording alone.
    """
    found: list[Ending] = []
    for number in range(len(prepared.records)):
        stage = hold_out(prepared, number)
        simulated = _simulated(stage, rng, draws)
        for k, row in enumerate(ROWS):
            settings = TrialSettings(offset="none" if row == "raw" else "rest", adc="none")
            figures = validate_trial(prepared.records[number], prepared.references[number], settings=settings).figures
            real = np.array([figures.end_total_deg, figures.end_inclination_deg]) * RADIAN_PER_DEGREE
            found.append(Ending(recording=stage.match.name, row=row, real=real, simulated=simulated[k]))
    return tuple(found)


def _simulated(stage: Stage, rng: np.random.Generator, draws: int) -> FloatArray:
    match, twin, span = stage.match, stage.twin, stage.match.span
    last = int(np.searchsorted(match.record.time, span.stop_s + _END_S)) + 1
    time = match.record.time[:last]
    slow = fit_pose_spline(replace(match.reference, position=None), SLOW_SETTINGS)
    motion = slow.at(stage.motion.time[:last], twin.settings.gravity_m_s2)
    inside = (time >= span.start_s) & (time < span.stop_s)
    known = (np.asarray(motion.valid) > 0.0)[:, None]
    rate = np.where(known, np.nan_to_num(motion.mean_rate_b), stage.corrected(match.gyro[:last], stage.offset))
    rate = rate * inside[:, None]
    first = int(np.searchsorted(time, span.start_s - _LEAD_S))
    seen = motion.q_nb[:first][known[:first, 0]]
    start = seen[-1] if len(seen) else np.array([1.0, 0.0, 0.0, 0.0])
    truth = integrate_strapdown(rate[first:], time[first:], start)
    ends = np.searchsorted(time[first:], np.arange(span.stop_s, min(span.stop_s + _END_S, time[-1]), _EVERY_S))
    tilted = _tilted(start, twin)
    out = np.empty((2, draws, 2))
    for d in range(draws):
        device, change = _drawn(stage, rng)
        fed = rate + inside[:, None] * change
        said = np.asarray(simulate_device(device, _turning(time, fed), rng=rng).record.gyro, dtype=np.float64)
        rest = said[:first].mean(axis=0)
        for k, offset in enumerate((np.zeros(3), rest)):
            q = integrate_strapdown(said[first:] - offset, time[first:], tilted)
            error = compare_orientations(q[ends], truth[ends])
            out[k, d] = np.median(error.total), np.median(error.inclination)
    return out


def _drawn(stage: Stage, rng: np.random.Generator) -> tuple[DeviceModel, FloatArray]:
    """Return a device with its offset at rest, and the rate that its change of offset in motion feigns."""
    twin, gyro = stage.twin, stage.twin.gyro
    step = rng.multivariate_normal(np.zeros(12), gyro.triad.model.covariance[:12, :12], method="eigh")
    matrix = gyro.triad.model.matrix + step[:9].reshape(3, 3)
    n = len(gyro.rest_offsets)
    again = np.sqrt(1.0 + 1.0 / n)  # the mean of n and one more recording
    spread = spread_of(gyro.rest_offsets, twin.settings.offset_spread)
    rest = gyro.rest_offsets.mean(axis=0) + again * spread * rng.standard_normal(3)
    wander = again * twin.settings.motion_offset_spread * rng.standard_normal(3)
    change = matrix @ (gyro.motion_offset + step[9:] + wander)
    chain = chain_of(matrix, rest, None, "rad/s")
    device = replace(stage.device, gyro=replace(stage.device.gyro, scale=chain.scale, offset=Offset(constant=rest)))
    return device, change


def _turning(time: FloatArray, rate: FloatArray) -> Motion:
    # Rates alone: nothing here asks for orientation or force.
    n = len(time)
    return Motion(
        time=time,
        q_nb=np.tile((1.0, 0.0, 0.0, 0.0), (n, 1)),
        rate_b=rate,
        mean_rate_b=rate,
        force_b=np.full((n, 3), np.nan),
        gravity_m_s2=0.0,
        moving=np.ones(n),
    )


def _tilted(q_nb: FloatArray, twin: Twin) -> FloatArray:
    # What a start from the raw accelerometer at rest gets wrong.
    if twin.accel is None:
        return q_nb
    up = rotate(q_nb * np.array([1.0, -1.0, -1.0, -1.0]), np.array([0.0, 0.0, twin.settings.gravity_m_s2]))
    said = np.linalg.solve(twin.accel.model.matrix, up) + twin.accel.model.offset
    turn = np.cross(said / np.linalg.norm(said), up / np.linalg.norm(up))
    return quaternion_product(q_nb, quaternion_of(turn))
