"""Poses: from what a camera system saw to what an ideal sensor at the body's origin would feel.

Stretch by stretch between long gaps: short gaps bridged by a cubic, low-pass without delay in n (quaternions without jumps of
sign; position; rotation into b comes last), then one quintic spline through each::

    w_b, w_b', q_nb     from the spline of the quaternions, exact derivatives of one another
    f_b = R_nb^T (p'' + g z)

so that integrating the rate gives the pose back. A pose sequence that is drawn on straight lines between the frames that the
cameras took must be brought back to those frames first.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError
from undrift.frames import quaternion_conjugate, rotate
from undrift.record import Reference
from undrift.sim.motion.gaps import find_stretches
from undrift.sim.motion.lowpass import ORDER, zero_phase
from undrift.sim.motion.motion import Motion, mean_rate
from undrift.sim.motion.spline import quintic, turning

if TYPE_CHECKING:
    from scipy.interpolate import BSpline

_EVEN = 0.02  # of a step: poses further off their even grid are drawn to it before filtering


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseSettings:
    """How poses become a motion.

    Parameters
    ----------
    cutoff_hz : float or None
        Low-pass of the orientation, Hz; lower takes camera noise and fast motion away. None leaves it unfiltered.
    position_cutoff_hz : float or None
        Low-pass of the position, Hz; acceleration multiplies noise by the square of frequency, so it is the lower one.
    order : int
        Of the Butterworth low-pass in each direction; higher is sharper and rings longer.
    gap_s : float
        Longest gap that is bridged, s.
    trim_s : float
        Not believed beside a longer gap, s.
    end_trim_s : float
        Not believed at the ends of the recording, s.
    """

    cutoff_hz: float | None = 20.0
    position_cutoff_hz: float | None = 10.0
    order: int = ORDER
    gap_s: float = 0.1
    trim_s: float = 0.2
    end_trim_s: float = 0.1


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PosePiece:
    """One stretch as splines.

    Parameters
    ----------
    start_s, stop_s : float
        Where it is believed, s.
    quaternion : BSpline
        Four columns over time, 1.
    position : BSpline or None
        Three columns over time, m, frame n.
    """

    start_s: float
    stop_s: float
    quaternion: "BSpline"
    position: "BSpline | None"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PoseSpline:
    """A motion that can be asked at any instants: splines through the poses, one for each stretch between long gaps.

    Parameters
    ----------
    pieces : tuple of PosePiece
        In order of time.
    moving_time, moving : array, shape (K,)
        The author's marks of motion and when, s; all 1 where there were none.
    """

    pieces: tuple[PosePiece, ...]
    moving_time: FloatArray
    moving: FloatArray

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last instant that is known, s."""
        return self.pieces[0].start_s, self.pieces[-1].stop_s

    def at(self, time: FloatArray, gravity_m_s2: float) -> Motion:
        """Return the motion at given instants.

        Parameters
        ----------
        time : array, shape (N,)
            s, increasing.
        gravity_m_s2 : float
            m/s2.

        Returns
        -------
        Motion
            NaN, and ``valid`` 0, where the poses do not tell; specific force NaN throughout without positions.
        """
        n = len(time)
        q, rate, swing, force = (np.full((n, width), np.nan) for width in (4, 3, 3, 3))
        valid = np.zeros(n)
        for piece in self.pieces:
            rows = np.flatnonzero((time >= piece.start_s) & (time <= piece.stop_s))
            turn = turning(piece.quaternion, time[rows])
            q[rows], rate[rows], swing[rows], valid[rows] = turn.q_nb, turn.rate_b, turn.acceleration_b, 1.0
            if piece.position is not None:
                push = piece.position(time[rows], nu=2) + np.array([0.0, 0.0, gravity_m_s2])
                force[rows] = rotate(quaternion_conjugate(turn.q_nb), push)
        mean = mean_rate(time, q, rate[0])
        first = np.flatnonzero((valid[1:] > 0.0) & (valid[:-1] == 0.0)) + 1  # no step leads to the first after a gap
        mean[first] = rate[first]
        nearest = np.searchsorted(0.5 * (self.moving_time[1:] + self.moving_time[:-1]), time)
        return Motion(
            time=time,
            q_nb=q,
            rate_b=rate,
            mean_rate_b=mean,
            force_b=force,
            gravity_m_s2=gravity_m_s2,
            moving=self.moving[nearest] * valid,
            angular_acceleration_b=swing,
            valid=valid,
        )

    def position(self, time: FloatArray) -> FloatArray:
        """Return where the body's origin is.

        Parameters
        ----------
        time : array, shape (N,)
            s.

        Returns
        -------
        array, shape (N, 3)
            m, frame n; NaN where the poses do not tell.
        """
        out = np.full((len(time), 3), np.nan)
        for piece in self.pieces:
            if piece.position is not None:
                rows = np.flatnonzero((time >= piece.start_s) & (time <= piece.stop_s))
                out[rows] = piece.position(time[rows])
        return out


def fit_pose_spline(reference: Reference, settings: PoseSettings = PoseSettings()) -> PoseSpline:
    """Return splines through the poses of a body.

    Parameters
    ----------
    reference : Reference
        Poses, gaps allowed; at the frames that the instrument took.
    settings : PoseSettings
        Cut-offs and gap policy.

    Returns
    -------
    PoseSpline
        One piece for each stretch between long gaps.

    Raises
    ------
    InputError
        No stretch is long enough, or a cut-off beyond half the sample rate.
    """
    time, seen = reference.time, reference.valid
    if reference.position is not None:
        seen = seen & np.isfinite(reference.position).all(axis=1)
    stretches = find_stretches(time, seen, gap_s=settings.gap_s, trim_s=settings.trim_s, end_trim_s=settings.end_trim_s)
    step = 1.0 / reference.sample_rate_hz
    pieces = []
    for stretch in stretches:
        t, q = time[stretch.rows], signed(reference.q_nb[stretch.rows])
        position = None
        if reference.position is not None:
            position = _smooth(t, reference.position[stretch.rows], step, settings.position_cutoff_hz, settings.order)
        pieces.append(
            PosePiece(
                start_s=stretch.start_s,
                stop_s=stretch.stop_s,
                quaternion=_smooth(t, q, step, settings.cutoff_hz, settings.order),
                position=position,
            )
        )
    moving = np.ones(len(time)) if reference.moving is None else reference.moving
    return PoseSpline(pieces=tuple(pieces), moving_time=time, moving=moving)


def motion_from_poses(
    reference: Reference,
    *,
    gravity_m_s2: float,
    sample_rate_hz: float | None = None,
    time: FloatArray | None = None,
    settings: PoseSettings = PoseSettings(),
) -> Motion:
    """Return what an ideal sensor at the body's origin would feel.

    Parameters
    ----------
    reference : Reference
        Poses, gaps allowed; at the frames that the instrument took.
    gravity_m_s2 : float
        m/s2.
    sample_rate_hz : float, optional
        Samples per second, from the first instant known to the last, Hz.
    time : array, shape (N,), optional
        Or the instants themselves, s.
    settings : PoseSettings
        Cut-offs and gap policy.

    Returns
    -------
    Motion
        Without Earth rate; NaN, and ``valid`` 0, where the poses do not tell.

    Raises
    ------
    InputError
        Neither or both of sample rate and instants; as :func:`fit_pose_spline`.
    """
    if (sample_rate_hz is None) == (time is None):
        raise InputError(
            "motion: wanted either a sample rate or the instants, got "
            f"{'neither' if time is None else 'both'}; give sample_rate_hz or time"
        )
    spline = fit_pose_spline(reference, settings)
    if time is not None:
        return spline.at(time, gravity_m_s2)
    start, stop = spline.span_s
    rate = float(sample_rate_hz or 0.0)
    return spline.at(start + np.arange(int((stop - start) * rate + 1e-6) + 1) / rate, gravity_m_s2)


def signed(q: FloatArray) -> FloatArray:
    """Return quaternions without jumps of sign.

    Parameters
    ----------
    q : array, shape (K, 4)
        Unit quaternions w-x-y-z, no gaps, less than a whole turn apart.

    Returns
    -------
    array, shape (K, 4)
        The same rotations.
    """
    flips = np.where((q[1:] * q[:-1]).sum(axis=1) < 0.0, -1.0, 1.0)
    same: FloatArray = q * np.append(1.0, np.cumprod(flips))[:, None]
    return same


def evenly(time: FloatArray, values: FloatArray, step: float) -> tuple[FloatArray, FloatArray]:
    """Return values on an even grid: as they are where they lie on one, else drawn to it by a cubic.

    Parameters
    ----------
    time : array, shape (K,)
        s, with short gaps or jitter.
    values : array, shape (K, C)
        Any unit.
    step : float
        Of the grid, about, s.

    Returns
    -------
    time : array, shape (L,)
        s, even.
    values : array, shape (L, C)
        As given.
    """
    count = round((time[-1] - time[0]) / step) + 1
    even = np.linspace(time[0], time[-1], count)
    if len(time) == count and np.abs(time - even).max() <= _EVEN * step:
        return even, values
    from scipy.interpolate import CubicSpline

    return even, CubicSpline(time, values)(even)


def _smooth(time: FloatArray, values: FloatArray, step: float, cutoff_hz: float | None, order: int) -> "BSpline":
    if cutoff_hz is None:
        return quintic(time, values)
    even, values = evenly(time, values, step)
    rate = float((len(even) - 1) / (even[-1] - even[0]))
    return quintic(even, zero_phase(values, cutoff_hz, sample_rate_hz=rate, order=order))
