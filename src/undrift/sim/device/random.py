"""Random devices: units of a production run, drawn from a grade.

The figures of the named grades are those of consumer and industrial parts as their datasheets and users state them; "wearable"
is a body-worn logger that writes deg/s and g, truncated. The presets of ``presets.py`` are grades too.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Literal

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError
from undrift.sim.device.adc import Adc
from undrift.sim.device.chain import SensorChain
from undrift.sim.device.g_sensitivity import GSensitivity
from undrift.sim.device.grade import Grade, TriadGrade
from undrift.sim.device.hysteresis import Hysteresis
from undrift.sim.device.instability import BiasInstability
from undrift.sim.device.lever_arm import LeverArm
from undrift.sim.device.low_pass import LowPass, sallen_key
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.noise import RandomWalk, WhiteNoise
from undrift.sim.device.nonlinearity import Nonlinearity
from undrift.sim.device.offset import Offset
from undrift.sim.device.rate_drift import RateDrift
from undrift.sim.device.scale import Scale
from undrift.sim.device.thermal_scale import ThermalScale
from undrift.sim.device.warm_up import WarmUp
from undrift.sim.streams import draw_streams
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

DPS = RADIAN_PER_DEGREE
MG = 1e-3 * STANDARD_GRAVITY

GradeName = Literal["consumer", "industrial", "wearable"]
Draw = Callable[[str, float, tuple[int, ...]], FloatArray]  # effect, standard deviation, shape
CODES_16 = Adc(bits=16, reference=2.0**15)


def grade_named(name: GradeName) -> Grade:
    """Return a named grade.

    Parameters
    ----------
    name : str
        consumer: 16-bit counts, 2000 deg/s and 8 g. industrial: the same codes, an order quieter and truer. wearable:
        deg/s and g with a coarse step, cut off toward zero.

    Returns
    -------
    Grade
        How its units spread.

    Raises
    ------
    InputError
        A name that is not one.
    """
    if name == "consumer":
        return _CONSUMER
    if name == "industrial":
        return _INDUSTRIAL
    if name == "wearable":
        return _WEARABLE
    raise InputError(f"grade: wanted consumer, industrial or wearable, got '{name}'; name one of them or give a Grade")


def random_device(rng: np.random.Generator, *, grade: GradeName | Grade = "consumer", serial: str = "") -> DeviceModel:
    """Draw one unit of a production run.

    Parameters
    ----------
    rng : Generator
        Draws each property from a stream of its own.
    grade : str or Grade
        How units spread.
    serial : str
        Serial number; where not given it follows from the grade and all that is drawn.

    Returns
    -------
    DeviceModel
        Its true values are its fields.

    Raises
    ------
    InputError
        A grade that is not one.
    """
    chosen = grade_named(grade) if isinstance(grade, str) else grade
    streams = draw_streams(rng)

    def draw(effect: str, sd: float, shape: tuple[int, ...]) -> FloatArray:
        stream = streams.of(effect)
        if math.isinf(chosen.limit_sd):
            return stream.normal(0.0, sd, shape)
        return sd * _cut_normal(stream, chosen.limit_sd, shape)

    made = replace(device_of(chosen, draw, serial), source_tag="drawn")
    return made if serial else replace(made, serial=_serial_of(made))


def _serial_of(device: DeviceModel) -> str:
    """Return a serial number that tells every value of the device: two that differ in anything never share one."""
    import hashlib
    import json

    from undrift.sim.device.store import device_json

    text = json.dumps(device_json(device), sort_keys=True)
    return f"SIM-{hashlib.sha256(text.encode()).hexdigest()[:12].upper()}"


def typical_device(grade: Grade, *, serial: str = "typical") -> DeviceModel:
    """Return a device each of whose errors has the size of its standard deviation, with signs that alternate by axis.

    Parameters
    ----------
    grade : Grade
        How units spread.
    serial : str
        Serial number.

    Returns
    -------
    DeviceModel
        The same at every call.
    """

    def draw(effect: str, sd: float, shape: tuple[int, ...]) -> FloatArray:
        signs: FloatArray = (-1.0) ** np.indices(shape).sum(axis=0)
        return sd * signs

    return device_of(grade, draw, serial)


def device_of(grade: Grade, draw: Draw, serial: str) -> DeviceModel:
    """Return a device whose errors come from a function.

    Parameters
    ----------
    grade : Grade
        Sizes of the errors.
    draw : callable
        Effect, standard deviation and shape -> array of errors.
    serial : str
        Serial number.

    Returns
    -------
    DeviceModel
        Effects of size zero are switched off.
    """
    trim = float(draw("thermometer_trim", grade.trim_error_sd, (1,))[0]) if grade.trim_error_sd > 0.0 else 0.0
    thermometer = grade.thermometer
    return DeviceModel(
        serial=serial,
        gyro=_chain(grade.gyro, draw, "gyro"),
        accel=_chain(grade.accel, draw, "accel"),
        thermometer=replace(thermometer, trim_error_c=thermometer.trim_error_c + trim) if trim else thermometer,
        sampling=grade.sampling,
        name=grade.name,
        source_tag=grade.source_tag,
    )


def _chain(grade: TriadGrade, draw_named: Draw, name: str) -> SensorChain:
    def draw(effect: str, sd: float, shape: tuple[int, ...] = (3,)) -> FloatArray:
        return draw_named(f"{name}_{effect}", sd, shape)

    axes = np.where(np.eye(3, dtype=bool), 1.0, draw("axes", grade.misalignment_sd, (3, 3)))
    cross = (
        draw("cross_axis", grade.cross_axis_sd, (3, 3)) * (1.0 - np.eye(3)) if grade.cross_axis_sd else np.zeros((3, 3))
    )
    per_k = [draw("offset_per_k", grade.offset_per_k_sd)]
    if grade.offset_per_k2_sd:
        per_k.append(draw("offset_per_k2", grade.offset_per_k2_sd))
    plain = SensorChain(
        unit=grade.unit,
        scale=Scale(
            nominal_sensitivity=grade.sensitivity,
            error=draw("sensitivity", grade.sensitivity_sd),
            axes=axes / np.linalg.norm(axes, axis=1, keepdims=True),
            cross_axis=cross,
        ),
        g_sensitivity=GSensitivity(matrix=draw("g_sensitivity", grade.g_sensitivity_sd, (3, 3)))
        if grade.g_sensitivity_sd
        else None,
        offset=Offset(constant=draw("offset", grade.offset_sd), per_k=np.array(per_k)),
        white_noise=WhiteNoise(random_walk=np.full(3, grade.random_walk)) if grade.random_walk else None,
        instability=BiasInstability(instability=np.full(3, grade.instability)) if grade.instability else None,
        random_walk=RandomWalk(bias_walk=np.full(3, grade.bias_walk)) if grade.bias_walk else None,
        amplifier=grade.amplifier,
        low_pass=_low_pass(grade, draw_named, name),
        adc=grade.adc,
    )
    return _with_rarer_effects(plain, grade, draw_named, name)


def _with_rarer_effects(chain: SensorChain, grade: TriadGrade, draw_named: Draw, name: str) -> SensorChain:
    """Return a chain with the effects that only some grades state."""

    def draw(effect: str, sd: float, shape: tuple[int, ...] = (3,)) -> FloatArray:
        return draw_named(f"{name}_{effect}", sd, shape)

    if grade.lever_arm_sd:
        chain = replace(chain, lever_arm=LeverArm(arms=draw("lever_arm", grade.lever_arm_sd, (3, 3))))
    if grade.nonlinearity_sd or grade.asymmetry_sd:
        bow = draw("nonlinearity", grade.nonlinearity_sd) / grade.full_scale
        uneven = draw("asymmetry", grade.asymmetry_sd)
        chain = replace(chain, nonlinearity=Nonlinearity(quadratic=bow, asymmetry=uneven))
    if grade.scale_per_k_sd:
        chain = replace(chain, thermal_scale=ThermalScale(per_k=draw("scale_per_k", grade.scale_per_k_sd)[None, :]))
    if grade.rate_drift_sd:
        coefficients = np.zeros((3, 2, 3))
        coefficients[2, 1] = draw("rate_drift", grade.rate_drift_sd) / grade.full_scale**2
        chain = replace(chain, rate_drift=RateDrift(coefficients=coefficients))
    if grade.warm_up_sd:
        warm_up = WarmUp(amplitude=draw("warm_up", grade.warm_up_sd), time_constant_s=grade.warm_up_s)
        chain = replace(chain, warm_up=warm_up)
    if grade.hysteresis_sd:
        chain = replace(chain, hysteresis=Hysteresis(amplitude=draw("hysteresis", grade.hysteresis_sd)))
    return chain


def _low_pass(grade: TriadGrade, draw: Draw, name: str) -> LowPass | None:
    if grade.cutoff_hz is None:
        return None
    return sallen_key(grade.cutoff_hz, draw(f"{name}_low_pass", grade.part_sd, (3, 4)))


def _cut_normal(stream: np.random.Generator, limit: float, shape: tuple[int, ...]) -> FloatArray:
    """Return standard normal draws that lie within the limit, by the inverse of the distribution."""
    from scipy.special import ndtr, ndtri

    low = float(ndtr(-limit))
    return np.asarray(ndtri(stream.uniform(low, 1.0 - low, shape)))


# One-sided densities of datasheets are divided by sqrt(2): see WhiteNoise.random_walk.
_CONSUMER = Grade(
    name="consumer",
    gyro=TriadGrade(
        unit="count",
        sensitivity=16.4 / DPS,
        sensitivity_sd=0.01,
        misalignment_sd=0.01,
        offset_sd=3.0 * DPS,
        offset_per_k_sd=0.05 * DPS,
        g_sensitivity_sd=0.1 * DPS / STANDARD_GRAVITY,
        random_walk=0.007 * DPS / math.sqrt(2.0),
        bias_walk=3e-4 * DPS,
        adc=CODES_16,
    ),
    accel=TriadGrade(
        unit="count",
        sensitivity=4096.0 / STANDARD_GRAVITY,
        sensitivity_sd=0.01,
        misalignment_sd=0.01,
        offset_sd=40.0 * MG,
        offset_per_k_sd=0.5 * MG,
        random_walk=0.18 * MG / math.sqrt(2.0),
        bias_walk=2e-3 * MG,
        adc=CODES_16,
    ),
)
_INDUSTRIAL = Grade(
    name="industrial",
    gyro=TriadGrade(
        unit="count",
        sensitivity=4755.0,
        sensitivity_sd=0.002,
        misalignment_sd=0.002,
        offset_sd=0.5 * DPS,
        offset_per_k_sd=0.005 * DPS,
        g_sensitivity_sd=0.003 * DPS / STANDARD_GRAVITY,
        random_walk=0.003 * DPS / math.sqrt(2.0),
        bias_walk=1e-4 * DPS,
        adc=CODES_16,
    ),
    accel=TriadGrade(
        unit="count",
        sensitivity=415.0,
        sensitivity_sd=0.002,
        misalignment_sd=0.002,
        offset_sd=10.0 * MG,
        offset_per_k_sd=0.1 * MG,
        random_walk=0.08 * MG / math.sqrt(2.0),
        bias_walk=5e-4 * MG,
        adc=CODES_16,
    ),
)
_WEARABLE = Grade(
    name="wearable",
    gyro=TriadGrade(
        unit="dps",
        sensitivity=1.0 / DPS,
        sensitivity_sd=0.003,
        misalignment_sd=0.004,
        offset_sd=0.3 * DPS,
        offset_per_k_sd=0.02 * DPS,
        random_walk=0.006 * DPS,
        bias_walk=2e-4 * DPS,
        adc=Adc(bits=16, reference=0.061 * 2**15, rounding="toward_zero", codes=False),
    ),
    accel=TriadGrade(
        unit="g",
        sensitivity=1.0 / STANDARD_GRAVITY,
        sensitivity_sd=0.003,
        misalignment_sd=0.004,
        offset_sd=20.0 * MG,
        offset_per_k_sd=0.2 * MG,
        random_walk=0.3 * MG,
        bias_walk=1e-3 * MG,
        adc=Adc(bits=16, reference=0.0005 * 2**15, codes=False),
    ),
)
