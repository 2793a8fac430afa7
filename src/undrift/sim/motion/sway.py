"""Sway of quiet stance: an inverted pendulum held up by a delayed controller and shaken by filtered noise.

Linear, so that the angle is a Gaussian process with a known spectrum. With the controller's gains in units of m g h and
J / (m g h) = 1.147 h / g, the torque noise white through a first-order low-pass of time constant tau_n::

    theta / noise = 1 / ((1.147 h/g) s^2 - 1 + (kp + kd s + ki / s) exp(-s tau)) / (1 + tau_n s),   s = 2 pi j f

The process is written as sinusoids in geometric bands, one in each, with that spectrum's power, Rayleigh amplitudes and
random phases; every derivative is then exact, and the sum is scaled to the wanted rms.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray
from undrift.sim.motion.course import Sway
from undrift.units import STANDARD_GRAVITY

BAND_HZ = (0.015, 2.5)
LINES = 48
SWELL_S = 2.5
GYRATION = 1.147  # J / (m h^2) of 66 kg m2, 76 kg, 0.87 m [known-low]


@dataclass(frozen=True, slots=True, kw_only=True)
class Balance:
    """A controller of stance.

    Parameters
    ----------
    centre_height : float
        Height of the body's centre over the ankles, m.
    kp : float
        Stiffness, 1 (of m g h); it falls when less than 1.
    kd : float
        Damping, s.
    ki : float
        Integral gain, 1/s.
    delay_s : float
        From the angle to the torque, s.
    noise_s : float
        Time constant of the torque noise, s.
    """

    centre_height: float
    kp: float = 1.45  # [known-low] 1.1-1.7
    kd: float = 0.40  # [known-low] 4-5 Nm s/deg over 649 Nm
    ki: float = 0.05  # [assumed]
    delay_s: float = 0.17  # [known-low]
    noise_s: float = 1.5  # [assumed] so that rate over angle comes out as 1.2 / 0.9 rad/s


def sway_spectrum(balance: Balance, frequency_hz: FloatArray) -> FloatArray:
    """Return the power spectral density of the angle, up to a constant.

    Parameters
    ----------
    balance : Balance
        The controller.
    frequency_hz : array, shape (N,)
        Hz.

    Returns
    -------
    array, shape (N,)
        1/Hz, to be scaled.
    """
    s = 2.0j * math.pi * frequency_hz
    torque = (balance.kp + balance.kd * s + balance.ki / s) * np.exp(-s * balance.delay_s)
    pendulum = GYRATION * balance.centre_height / STANDARD_GRAVITY * s * s - 1.0
    return np.asarray(np.abs((pendulum + torque) * (1.0 + balance.noise_s * s)) ** -2)


def draw_sway(draw: np.random.Generator, balance: Balance, *, rms: float, span: tuple[float, float]) -> Sway:
    """Draw a stretch of sway.

    Parameters
    ----------
    draw : Generator
        Amplitudes, frequencies within their bands, phases.
    balance : Balance
        The controller.
    rms : float
        About the mean, over the span, rad.
    span : (float, float)
        First and last instant, s; it swells and ebbs within it.

    Returns
    -------
    Sway
        Sum of sinusoids.
    """
    return draw_lines(draw, lambda f: sway_spectrum(balance, f), band_hz=BAND_HZ, rms=rms, span=span)


def draw_lines(
    draw: np.random.Generator,
    spectrum: Callable[[FloatArray], FloatArray],
    *,
    band_hz: tuple[float, float],
    rms: float,
    span: tuple[float, float],
) -> Sway:
    """Draw a stretch of Gaussian noise with a given spectrum, as sinusoids.

    Parameters
    ----------
    draw : Generator
        Amplitudes, frequencies within their bands, phases.
    spectrum : callable
        Power spectral density at frequencies in Hz, up to a constant.
    band_hz : (float, float)
        Lowest and highest frequency, Hz.
    rms : float
        About the mean, over the span, rad or m.
    span : (float, float)
        First and last instant, s; it swells and ebbs within it.

    Returns
    -------
    Sway
        48 sinusoids.
    """
    edges = np.geomspace(*band_hz, LINES + 1)
    frequencies = edges[:-1] + np.diff(edges) * draw.uniform(size=LINES)
    amplitudes = np.sqrt(spectrum(frequencies) * np.diff(edges)) * draw.rayleigh(size=LINES)
    phases = draw.uniform(0.0, 2.0 * math.pi, LINES)
    time = np.arange(span[0], span[1], 0.1 / band_hz[1])
    plain = Sway(_floats(amplitudes), _floats(frequencies), _floats(phases), *span, SWELL_S)
    scale = rms / float(np.std(plain.at(time)[0]))
    return Sway(_floats(scale * amplitudes), plain.frequencies_hz, plain.phases, *span, SWELL_S)


def _floats(values: FloatArray) -> tuple[float, ...]:
    return tuple(float(value) for value in values)
