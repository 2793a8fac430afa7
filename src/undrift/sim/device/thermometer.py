"""Board thermometer, an LM335 for one: 10 mV/K, trimmed once, slow, warmed by its own current.

::

    felt'    = (T + s (1 - exp(-t / lag)) - felt) / lag     lag; s self-heating, t time since power-on
    reading  = felt + trim error + slope error (felt - 25 degC) + noise
    code     = round((reading - zero) / step)               zero = -273.15 degC for a sensor that counts kelvins

The lag is solved exactly for a temperature that is straight between samples.
"""

import math
from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray
from undrift.sim.device.adc import Rounding, rounded
from undrift.sim.device.fields import quantity, settle
from undrift.sim.device.scene import Scene, check_even

TRIM_TEMP_C = 25.0
LM335_V_PER_K = 0.010
KELVIN_ZERO_C = -273.15


@dataclass(frozen=True, slots=True, kw_only=True)
class Thermometer:
    """A board thermometer.

    Parameters
    ----------
    trim_error_c : float
        Reading minus truth at 25 degC, K.
    slope_error : float
        Relative error of the slope.
    lag_s : float
        Time constant, s; 0 for none.
    self_heating_c : float
        Own warmth once settled, K.
    noise_c : float
        Standard deviation of a sample, K.
    step_c : float
        Step of the reading, K; 0 for none.
    zero_c : float
        Temperature of code 0, degC.
    rounding : str
        nearest, floor or toward_zero.
    """

    trim_error_c: float = quantity("", None, 0.0)
    slope_error: float = quantity("", None, 0.0)
    lag_s: float = quantity("", None, 0.0, least=0.0)
    self_heating_c: float = quantity("", None, 0.0)
    noise_c: float = quantity("", None, 0.0, least=0.0)
    step_c: float = quantity("", None, 0.0, least=0.0)
    zero_c: float = quantity("", None, 0.0)
    rounding: Rounding = quantity("", None, "nearest")

    def __post_init__(self) -> None:
        settle(self)


def lm335(*, bits: int = 12, reference_v: float = 5.0, lag_s: float = 80.0, self_heating_c: float = 0.6) -> Thermometer:
    """Return an LM335 behind a converter, trimmed without error.

    Parameters
    ----------
    bits : int
        Of the converter.
    reference_v : float
        Of the converter, V.
    lag_s : float
        80 s in still air, 10 s in moving air.
    self_heating_c : float
        1 mA and 200 K/W make 0.6 K.

    Returns
    -------
    Thermometer
        Counts kelvins.
    """
    step = reference_v / 2**bits / LM335_V_PER_K
    return Thermometer(lag_s=lag_s, self_heating_c=self_heating_c, step_c=step, zero_c=KELVIN_ZERO_C)


def thermometer_reading(effect: Thermometer, scene: Scene, rng: np.random.Generator) -> FloatArray:
    """Return what the thermometer says.

    Parameters
    ----------
    effect : Thermometer
        The sensor; it had settled at the first temperature, but for its self-heating.
    scene : Scene
        With temperature and age.
    rng : Generator
        Stream of its noise.

    Returns
    -------
    array, shape (N,)
        degC.
    """
    felt = _felt(effect, scene)
    said: FloatArray = felt + effect.trim_error_c + effect.slope_error * (felt - TRIM_TEMP_C)
    if effect.noise_c > 0.0:
        said = said + rng.normal(0.0, effect.noise_c, len(said))
    if effect.step_c == 0.0:
        return said
    code: FloatArray = rounded((said - effect.zero_c) / effect.step_c, effect.rounding)
    return code * effect.step_c + effect.zero_c


def _felt(effect: Thermometer, scene: Scene) -> FloatArray:
    if effect.lag_s == 0.0:
        return scene.temp_c + effect.self_heating_c
    own: FloatArray = effect.self_heating_c * -np.expm1(-scene.age_s / effect.lag_s)
    if np.ptp(scene.temp_c) == 0.0:
        return scene.temp_c + own
    from scipy.signal import lfilter

    check_even(scene, "thermometer")
    ratio = scene.step_s / effect.lag_s
    keep = math.exp(-ratio)
    mean = -math.expm1(-ratio) / ratio  # of the weight over a step
    b = [1.0 - mean, mean - keep]
    lagging = lfilter(b, [1.0, -keep], scene.temp_c, zi=[keep * scene.temp_c[0] + b[1] * scene.temp_c[0]])[0]
    return np.asarray(lagging) + own
