"""Poses as the instrument took them: undo a linear up-sampling of the reference.

Many files hold optics at the sensor's sample rate, drawn on straight lines (great arcs) between the frames that the cameras
took. Between frames such a pose cuts the corner: by a h^2 / 8 at an angular acceleration a and a frame interval h, always
towards less motion. At 2 Hz and 120 frames/s that is 0.1 % of the amplitude, which a fit would book as scale factor.

Straight lines betray themselves: the rate between neighbours repeats to the last digit within a frame interval and jumps
at the frames. The middles of the repeats lie on a comb of the frame rate; its frequency and phase come from the largest
Fourier sum, and each frame is the end of the straight line before it and the start of the line after it.
"""

import numpy as np

from undrift.arrays import BoolArray, FloatArray, IntArray
from undrift.frames import quaternion_of, quaternion_product
from undrift.record import Reference
from undrift.sync.rates import PoseRates, pose_rates

LEAST_REPEATS = 0.02  # share of neighbouring rates that repeat before up-sampling is suspected
COMB_SHARPNESS = 0.95  # of what a perfect comb gives
_SAME = 1e-4  # of the median change of rate: two rates are one
_NEAR_FRAME = 2e-5  # s; a sample this close to a frame may stand on either side


def native_poses(reference: Reference) -> Reference:
    """Return the frames that the instrument took, where the reference was drawn on straight lines between them.

    Parameters
    ----------
    reference : Reference
        Poses, up-sampled or not.

    Returns
    -------
    Reference
        Orientation, and position where there is one, at the frames; the same object where no up-sampling is found.
    """
    rates = pose_rates(reference)
    repeats, share = _repeats(rates)
    if share < LEAST_REPEATS:
        return reference
    interval = float(np.median(np.diff(reference.time)))
    frequency, phase, sharpness = _comb(rates.stop[:-1][repeats], (1.0 - share) / (2.0 * interval))
    if sharpness < COMB_SHARPNESS * np.sinc(share):
        return reference
    first = np.ceil(frequency * reference.time[0] - phase)
    last = np.floor(frequency * reference.time[-1] - phase)
    frames: FloatArray = (np.arange(first, last + 1.0) + phase) / frequency
    q, position = _poses_at(reference, rates, frames, 1.0 / frequency)
    moving = None
    if reference.moving is not None:
        nearest = np.clip(np.searchsorted(reference.time, frames), 0, len(reference) - 1)
        moving = reference.moving[nearest]
    return Reference(time=frames, q_nb=q, position=position, moving=moving, name=reference.name)


def _repeats(rates: PoseRates) -> tuple[BoolArray, float]:
    both = rates.valid[1:] & rates.valid[:-1]
    change = np.abs(np.diff(rates.rate, axis=0)).max(axis=1)
    moved = both & (np.abs(rates.rate[1:]).max(axis=1) > 0.0)
    if not moved.any():
        return moved, 0.0
    same = moved & (change <= _SAME * np.median(change[moved]))
    return same, float(same.sum() / moved.sum())


def _comb(t: FloatArray, guess: float) -> tuple[float, float, float]:
    # Frame times are (k + phase) / frequency; the middles of the repeats lie half a frame later. Longer and longer spans.
    if len(t) < 20:
        return guess, 0.0, 0.0
    t0, span, width = t[0], 200.0 / guess, 0.1 * guess
    frequency, total = guess, 0j
    while True:
        some = t[t <= t0 + span] - t0
        trial = frequency + np.linspace(-width, width, 161)
        sums = np.exp(2j * np.pi * np.outer(trial, some)).mean(axis=1)
        best = int(np.argmax(np.abs(sums)))
        frequency, total = float(trial[best]), sums[best]
        if some[-1] >= t[-1] - t0 and width * span < 2e-2:
            break
        width = min(width / 20.0, 2.0 / span)
        span = min(4.0 * span, float(t[-1] - t0) + 1e-9)
    phase = frequency * t0 + float(np.angle(total)) / (2.0 * np.pi) - 0.5
    return frequency, float(phase % 1.0), float(abs(total))


def _poses_at(
    reference: Reference, rates: PoseRates, frames: FloatArray, interval: float
) -> tuple[FloatArray, FloatArray | None]:
    after = np.searchsorted(reference.time, frames)
    left = _drawn_to(reference, rates, frames, after - 2, (frames - interval, frames))
    right = _drawn_to(reference, rates, frames, after, (frames, frames + interval))
    q = np.where(np.isfinite(left[0]), left[0], right[0])
    if left[1] is None or right[1] is None:
        return q, None
    return q, np.where(np.isfinite(left[1]), left[1], right[1])


def _drawn_to(
    reference: Reference, rates: PoseRates, frames: FloatArray, pair: IntArray, span: tuple[FloatArray, FloatArray]
) -> tuple[FloatArray, FloatArray | None]:
    # The line through samples pair, pair + 1, drawn to the frame; NaN unless both lie within the span between two frames.
    k = np.clip(pair, 0, len(rates.rate) - 1)
    inside = (pair == k) & rates.valid[k]
    inside &= (rates.start[k] >= span[0] - _NEAR_FRAME) & (rates.stop[k] <= span[1] + _NEAR_FRAME)
    ahead = (frames - rates.start[k])[:, None]
    q = np.where(inside[:, None], quaternion_product(reference.q_nb[k], quaternion_of(rates.rate[k] * ahead)), np.nan)
    if reference.position is None:
        return q, None
    velocity = (reference.position[k + 1] - reference.position[k]) / (rates.stop[k] - rates.start[k])[:, None]
    return q, np.where(inside[:, None], reference.position[k] + velocity * ahead, np.nan)
