"""Presets: kinds of devices by name, as grades whose tolerance is two standard deviations and the end of the spread.

``enc03j_3031`` is the note's device: three Murata ENC-03J gyroscopes and three ICSensors 3031 accelerometers, a gain stage and
a second-order low-pass for each channel, 12 bits at 5 V, an LM335 on the board. The others are digital parts of
``sim/device/presets.py``.

Grades: how the devices of a production run spread, as standard deviations about what the data sheet says.

Every property of a unit is drawn from a normal distribution, cut off at ``limit_sd`` standard deviations. Noise is typical,
the same in every unit.

Data sheets: figures of devices in the units of data sheets, one row a triad, each with a tag that says how far to trust it.

note: the 2007 technical note; found: read in a public source; calc: computed from such; known: recalled; known-low: recalled with
doubt; assumed: a choice. A tolerance is the bound of the units' spread, two standard deviations.

Random devices: units of a production run, drawn from a grade.

The figures of the named grades are those of consumer and industrial parts as their datasheets and users state them; "wearable"
is a body-worn logger that writes deg/s and g, truncated. The presets of ``sim/device/presets.py`` are grades too.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple, get_args

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError
from undrift.sim.device.effects import (
    Adc,
    Amplifier,
    BiasInstability,
    GSensitivity,
    Hysteresis,
    LeverArm,
    LowPass,
    Nonlinearity,
    Offset,
    RandomWalk,
    RateDrift,
    Sampling,
    Scale,
    SensorChain,
    ThermalScale,
    Thermometer,
    WarmUp,
    WhiteNoise,
    lm335,
    sallen_key,
)
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.simulate import draw_streams
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

# ---- Grades: how the devices of a production run spread, as standard deviations about what the data sheet says.


@dataclass(frozen=True, slots=True, kw_only=True)
class TriadGrade:
    """How the sensors of one kind spread over units."""

    unit: str  # Unit of the reading
    sensitivity: float  # Nominal, of the sensor, its output unit per rad/s or m/s2
    sensitivity_sd: float  # Relative standard deviation of it
    misalignment_sd: float  # Of each axis about each axis across it, rad
    cross_axis_sd: float = 0.0  # Of each crosstalk term, relative
    nonlinearity_sd: float = 0.0  # Of the quadratic departure at full scale, relative to full scale
    asymmetry_sd: float = 0.0  # Of the asymmetry of the scale factor, relative
    offset_sd: float  # rad/s or m/s2
    offset_per_k_sd: float  # rad/s/K or m/s2/K
    offset_per_k2_sd: float = 0.0  # rad/s/K2 or m/s2/K2
    scale_per_k_sd: float = 0.0  # Relative, per K
    # Of the rate-dependent drift at full scale, relative to full scale, per K: ``e = c x^3 D``
    rate_drift_sd: float = 0.0
    g_sensitivity_sd: float = 0.0  # rad/s per m/s2
    warm_up_sd: float = 0.0  # Of the amplitude, rad/s or m/s2
    warm_up_s: float = 600.0  # Time constant, s
    hysteresis_sd: float = 0.0  # Of the amplitude, rad/s or m/s2
    lever_arm_sd: float = 0.0  # Of each coordinate of each sensor, m
    random_walk: float  # White noise, rad/s/sqrt(Hz) or m/s2/sqrt(Hz)
    instability: float = 0.0  # B, rad/s or m/s2
    bias_walk: float = 0.0  # rad/s/sqrt(s) or m/s2/sqrt(s)
    full_scale: float = math.inf  # Range, rad/s or m/s2; non-linearity and rate drift refer to it
    amplifier: Amplifier | None = None  # The same in every unit
    cutoff_hz: float | None = None  # Of the Sallen-Key low-pass; None for none
    part_sd: float = 0.0  # Relative standard deviation of its resistors and capacitors
    adc: Adc | None = None  # The same in every unit


@dataclass(frozen=True, slots=True, kw_only=True)
class Grade:
    """How devices spread over units."""

    gyro: TriadGrade  # The sensors
    accel: TriadGrade  # The sensors
    # The same in every unit, but for its trim error
    thermometer: Thermometer = field(default_factory=lambda: Thermometer(noise_c=0.05, step_c=0.125))
    trim_error_sd: float = 0.0  # Of the thermometer, K
    sampling: Sampling = field(default_factory=Sampling)  # The same in every unit
    limit_sd: float = math.inf  # Where the spread ends, standard deviations
    name: str = ""  # Kind of device
    source_tag: str = "assumed"  # How far its figures are to be trusted


# ---- Data sheets: figures of devices in the units of data sheets, one row a triad, each with a tag that says how far to trust it.


class GyroSheet(NamedTuple):
    """Gyroscopes, a unit behind each name: deg/s, deg/s/K, %, %/K, % of range, deg/s/sqrt(Hz), deg/h, deg/s/g."""

    range_dps: float
    counts_per_dps: float
    offset_dps: float
    offset_dps_per_k: float
    scale_percent: float
    scale_percent_per_k: float
    nonlinearity_percent: float
    cross_percent: float
    noise_dps_per_sqrt_hz: float
    instability_deg_per_h: float
    g_dps_per_g: float
    tag: str


class AccelSheet(NamedTuple):
    """Accelerometers, a unit behind each name: g, counts per g, mg, mg/K, %, %/K, % of range, micro-g/sqrt(Hz), mg."""

    range_g: float
    counts_per_g: float
    offset_mg: float
    offset_mg_per_k: float
    scale_percent: float
    scale_percent_per_k: float
    nonlinearity_percent: float
    cross_percent: float
    noise_ug_per_sqrt_hz: float
    instability_mg: float
    tag: str


@dataclass(frozen=True, slots=True)
class Sheet:
    """A device with digital outputs of 16 bits; counts per unit of 0 stand for readings in rad/s and m/s2."""

    name: str  # Name of the preset
    gyro: GyroSheet  # Gyroscopes
    accel: AccelSheet  # Accelerometers


# Ranges and counts are the common setting of each part [known]; instabilities of accelerometers are [assumed] throughout.
SHEETS = (
    Sheet(
        "mpu6050",
        GyroSheet(
            2000.0, 16.4, 20.0, 0.05, 3.0, 0.03, 0.2, 2.0, 0.005, 8.0, 0.1, "found; offset drift assumed, in-run known"
        ),
        AccelSheet(
            8.0,
            4096.0,
            50.0,
            0.8,
            3.0,
            0.02,
            0.5,
            2.0,
            400.0,
            0.05,
            "found; z-axis figures of offset and drift left out",
        ),
    ),
    Sheet(
        "icm20948",
        GyroSheet(2000.0, 16.4, 5.0, 0.05, 1.5, 0.05, 0.1, 2.0, 0.015, 8.0, 0.1, "known"),
        AccelSheet(8.0, 4096.0, 25.0, 0.8, 0.5, 0.026, 0.5, 2.0, 230.0, 0.05, "found"),
    ),
    Sheet(
        "bmi160",
        GyroSheet(2000.0, 16.4, 3.0, 0.05, 3.0, 0.02, 0.1, 2.0, 0.007, 6.0, 0.1, "known; noise found"),
        AccelSheet(8.0, 4096.0, 40.0, 1.0, 3.0, 0.03, 0.5, 1.0, 180.0, 0.04, "known"),
    ),
    Sheet(
        "bmi270",
        GyroSheet(2000.0, 16.4, 0.5, 0.02, 0.4, 0.02, 0.05, 0.2, 0.007, 5.0, 0.1, "known; offset and noise found"),
        AccelSheet(8.0, 4096.0, 20.0, 0.25, 0.4, 0.004, 0.5, 0.2, 160.0, 0.04, "known; noise found"),
    ),
    Sheet(
        "bmi088",
        GyroSheet(2000.0, 16.384, 1.0, 0.015, 1.0, 0.03, 0.05, 1.0, 0.014, 2.0, 0.1, "known"),
        AccelSheet(6.0, 5460.0, 20.0, 0.2, 1.0, 0.002, 0.5, 0.5, 160.0, 0.03, "known"),
    ),
    Sheet(
        "lsm6dso",
        GyroSheet(2000.0, 1.0 / 0.07, 1.0, 0.01, 1.0, 0.007, 0.1, 1.0, 0.0038, 3.0, 0.1, "known"),
        AccelSheet(8.0, 1.0 / 0.000244, 20.0, 0.1, 1.0, 0.01, 0.5, 1.0, 70.0, 0.03, "known"),
    ),
    Sheet(
        "xsens_mti1",
        GyroSheet(
            2000.0,
            0.0,
            0.1,
            0.003,
            0.1,
            0.003,
            0.1,
            0.1,
            0.007,
            10.0,
            0.001,
            "found; residual offset and drift assumed",
        ),
        AccelSheet(16.0, 0.0, 2.0, 0.03, 0.1, 0.002, 0.5, 0.1, 120.0, 0.03, "found; residual offset and drift assumed"),
    ),
    Sheet(
        "shimmer3",
        GyroSheet(500.0, 65.5, 20.0, 0.05, 3.0, 0.03, 0.2, 2.0, 0.005, 8.0, 0.1, "known"),
        AccelSheet(2.0, 815.0, 50.0, 0.7, 3.0, 0.01, 0.5, 2.0, 125.0, 0.05, "known-low"),
    ),
)


# ---- Random devices: units of a production run, drawn from a grade.

DPS = RADIAN_PER_DEGREE
MG = 1e-3 * STANDARD_GRAVITY

GradeName = Literal["consumer", "industrial", "wearable"]
Draw = Callable[[str, float, tuple[int, ...]], FloatArray]  # effect, standard deviation, shape
CODES_16 = Adc(bits=16, reference=2.0**15)


def grade_named(name: GradeName) -> Grade:
    """Return a named grade."""
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

    Examples
    --------
    >>> import numpy as np, undrift
    >>> device = undrift.random_device(np.random.default_rng(7), grade="industrial")
    >>> device.gyro.unit
    'count'
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

    from undrift.sim.device.model import device_json

    text = json.dumps(device_json(device), sort_keys=True)
    return f"SIM-{hashlib.sha256(text.encode()).hexdigest()[:12].upper()}"


def typical_device(grade: Grade, *, serial: str = "typical") -> DeviceModel:
    """Return a device each of whose errors has the size of its standard deviation, with signs that alternate by axis."""

    def draw(effect: str, sd: float, shape: tuple[int, ...]) -> FloatArray:
        signs: FloatArray = (-1.0) ** np.indices(shape).sum(axis=0)
        return sd * signs

    return device_of(grade, draw, serial)


def device_of(grade: Grade, draw: Draw, serial: str) -> DeviceModel:
    """Return a device whose errors come from a function."""
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


# ---- presets

PresetName = Literal[
    "enc03j_3031", "mpu6050", "icm20948", "bmi160", "bmi270", "bmi088", "lsm6dso", "xsens_mti1", "shimmer3"
]
PRESETS: tuple[str, ...] = get_args(PresetName)
LIMIT_SD = 2.0
G = STANDARD_GRAVITY
FLOOR = math.sqrt(2.0 * math.log(2.0) / math.pi)  # of the Allan deviation over B: data sheets state the floor
ONE_SIDED = math.sqrt(2.0)  # a data sheet's density over the random walk


def preset(name: str) -> DeviceModel:
    """Return the typical device of a kind: every error at half its tolerance, with signs that alternate by axis."""
    return typical_device(preset_grade(name), serial=f"{name}-typical")


def random_device_of(name: str, rng: np.random.Generator, *, serial: str = "") -> DeviceModel:
    """Draw a unit of a kind within its tolerances."""
    return random_device(rng, grade=preset_grade(name), serial=serial)


def preset_grade(name: str) -> Grade:
    """Return how the units of a kind spread."""
    if name == "enc03j_3031":
        return _enc03j_3031()
    for sheet in SHEETS:
        if sheet.name == name:
            return _digital(sheet)
    raise InputError(
        f"preset: wanted one of {', '.join(PRESETS)}, got '{name}'; name one of them or give a device.json"
    )


def _digital(sheet: Sheet) -> Grade:
    return Grade(
        name=sheet.name,
        gyro=_gyro(sheet.gyro),
        accel=_accel(sheet.accel),
        thermometer=Thermometer(noise_c=0.05, step_c=0.125),
        trim_error_sd=0.5,
        sampling=Sampling(gyro_averaging="interval", accel_averaging="interval"),
        limit_sd=LIMIT_SD,
        source_tag=f"gyro {sheet.gyro.tag}; accel {sheet.accel.tag}",
    )


def _gyro(sheet: GyroSheet) -> TriadGrade:
    return TriadGrade(
        unit="count" if sheet.counts_per_dps else "rad/s",
        sensitivity=sheet.counts_per_dps / DPS or 1.0,
        sensitivity_sd=0.01 * sheet.scale_percent / LIMIT_SD,
        misalignment_sd=0.01 * sheet.cross_percent / LIMIT_SD,
        nonlinearity_sd=0.01 * sheet.nonlinearity_percent / LIMIT_SD,
        offset_sd=sheet.offset_dps * DPS / LIMIT_SD,
        offset_per_k_sd=sheet.offset_dps_per_k * DPS / LIMIT_SD,
        scale_per_k_sd=0.01 * sheet.scale_percent_per_k / LIMIT_SD,
        g_sensitivity_sd=sheet.g_dps_per_g * DPS / G / LIMIT_SD,
        random_walk=sheet.noise_dps_per_sqrt_hz * DPS / ONE_SIDED,
        instability=sheet.instability_deg_per_h * DPS / 3600.0 / FLOOR,
        full_scale=sheet.range_dps * DPS,
        adc=Adc(bits=16, reference=2.0**15) if sheet.counts_per_dps else None,
    )


def _accel(sheet: AccelSheet) -> TriadGrade:
    return TriadGrade(
        unit="count" if sheet.counts_per_g else "m/s2",
        sensitivity=sheet.counts_per_g / G or 1.0,
        sensitivity_sd=0.01 * sheet.scale_percent / LIMIT_SD,
        misalignment_sd=0.01 * sheet.cross_percent / LIMIT_SD,
        nonlinearity_sd=0.01 * sheet.nonlinearity_percent / LIMIT_SD,
        offset_sd=1e-3 * G * sheet.offset_mg / LIMIT_SD,
        offset_per_k_sd=1e-3 * G * sheet.offset_mg_per_k / LIMIT_SD,
        scale_per_k_sd=0.01 * sheet.scale_percent_per_k / LIMIT_SD,
        random_walk=1e-6 * G * sheet.noise_ug_per_sqrt_hz / ONE_SIDED,
        instability=1e-3 * G * sheet.instability_mg / FLOOR,
        full_scale=sheet.range_g * G,
        adc=Adc(bits=16, reference=2.0**15) if sheet.counts_per_g else None,
    )


def _enc03j_3031() -> Grade:
    """Return the note's device. Tags stand beside the figures; what the note leaves unsaid is assumed."""
    board = Adc(bits=12, reference=5.0, signed=False)  # assumed
    gyro = TriadGrade(
        unit="count",
        sensitivity=0.67e-3 / DPS,  # V per deg/s, found
        sensitivity_sd=0.20 / LIMIT_SD,  # known
        misalignment_sd=0.01 / LIMIT_SD,  # assumed
        nonlinearity_sd=0.001 / LIMIT_SD,  # found, after calibration; 5 % by specification
        offset_sd=5.0 * DPS / LIMIT_SD,  # assumed: what trimming leaves
        offset_per_k_sd=0.07 * DPS,  # assumed, inferred from the note
        offset_per_k2_sd=1.5e-3 * DPS,  # assumed
        scale_per_k_sd=0.002,  # assumed
        rate_drift_sd=2e-4 / LIMIT_SD,  # assumed
        g_sensitivity_sd=0.02 * DPS / G,  # assumed
        warm_up_sd=0.15 * DPS,  # found on the sister type: 0.05 to 0.25 deg/s
        warm_up_s=600.0,  # assumed
        hysteresis_sd=0.05 * DPS,  # assumed
        random_walk=0.011 * DPS / ONE_SIDED,  # calc
        instability=10.0 * DPS / 3600.0 / FLOOR,  # assumed
        full_scale=300.0 * DPS,  # found
        amplifier=Amplifier(gain=20.0, null=2.5, low=0.0, high=5.0),  # assumed
        cutoff_hz=11.1,  # note, Table 1: sit-to-stand
        part_sd=0.01 / LIMIT_SD,  # assumed
        adc=board,
    )
    accel = TriadGrade(
        unit="count",
        sensitivity=10e-3 / G,  # V per g, assumed
        sensitivity_sd=0.30 / LIMIT_SD,  # assumed
        misalignment_sd=0.01 / LIMIT_SD,  # assumed
        nonlinearity_sd=0.002 / LIMIT_SD,  # assumed
        offset_sd=0.2 * G / LIMIT_SD,  # assumed: what trimming leaves of 2.5 g
        offset_per_k_sd=0.4e-3 * G / LIMIT_SD,  # assumed
        scale_per_k_sd=0.0002 / LIMIT_SD,  # assumed
        lever_arm_sd=0.5e-3,  # found: positioning error of the authors' simulation
        random_walk=100e-6 * G / ONE_SIDED,  # assumed
        instability=0.02e-3 * G / FLOOR,  # assumed
        full_scale=2.0 * G,  # assumed
        amplifier=Amplifier(gain=75.0, null=2.5, low=0.0, high=5.0),  # assumed
        cutoff_hz=11.1,
        part_sd=0.01 / LIMIT_SD,
        adc=board,
    )
    return Grade(
        name="enc03j_3031",
        gyro=gyro,
        accel=accel,
        thermometer=replace(lm335(), noise_c=0.05),
        trim_error_sd=1.0,  # known: after a one-point trim, 2 at most
        sampling=Sampling(gyro_averaging="instant", accel_averaging="instant"),
        limit_sd=LIMIT_SD,
        source_tag="note, found, calc, known and assumed: see sim/device/presets.py",
    )
