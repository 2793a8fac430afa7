"""How long a device settles after the rate changed, and how long a dwell must be.

settle   ln(1000) / (zeta omega_c), omega_c = 2 pi f_c, at least 0.3 s: the step response of a second-order low-pass is within 0.1 %
dwell    u^2 = (q / t)^2 + N^2 / t: one count q over the dwell, and white noise of density N
"""

import math

from undrift.errors import InputError

DAMPING = math.sqrt(0.5)  # Butterworth, as the note's filters
LEAST_SETTLE_S = 0.3  # also the table's own servo
REMAINDER = 1000.0


def settle_time(cutoff_hz: float, damping: float = DAMPING) -> float:
    """Return how long to wait after a change of rate.

    Parameters
    ----------
    cutoff_hz : float
        Bandwidth of the device's low-pass, Hz.
    damping : float
        zeta, 1.

    Returns
    -------
    float
        s.

    Raises
    ------
    InputError
        A bandwidth or damping that is not above zero.
    """
    if not (cutoff_hz > 0.0 and damping > 0.0):
        raise InputError(f"settle time: wanted cutoff_hz and damping above 0, got {cutoff_hz:g} and {damping:g}")
    return max(LEAST_SETTLE_S, math.log(REMAINDER) / (damping * 2.0 * math.pi * cutoff_hz))


def dwell_time(uncertainty: float, *, count: float, noise_density: float = 0.0) -> float:
    """Return how long a dwell must be for its mean rate to be known so well.

    The positive root of u^2 t^2 - N^2 t - q^2 = 0.

    Parameters
    ----------
    uncertainty : float
        u, wanted standard uncertainty, rad/s.
    count : float
        q, angle of one count of the encoder, rad.
    noise_density : float
        N of the device, rad/s/sqrt(Hz).

    Returns
    -------
    float
        t, s.

    Raises
    ------
    InputError
        An uncertainty that is not above zero.
    """
    if not uncertainty > 0.0:
        raise InputError(f"dwell time: wanted an uncertainty above 0 rad/s, got {uncertainty:g}")
    square = noise_density * noise_density
    return (square + math.hypot(square, 2.0 * uncertainty * count)) / (2.0 * uncertainty * uncertainty)


def whole_turns_time(turn_rate: float, least_s: float) -> float:
    """Return the shortest time of whole turns that is no shorter than asked for.

    Parameters
    ----------
    turn_rate : float
        rad/s, not zero.
    least_s : float
        s.

    Returns
    -------
    float
        s.
    """
    turn_s = 2.0 * math.pi / abs(turn_rate)
    return turn_s * max(1, math.ceil(least_s / turn_s - 1e-9))
