"""Presets and random devices: kinds of devices by name, and random units of a production run.

The numbers are in ``presets.toml``, in the units of data sheets. ``enc03j_3031`` is the device of the note, with three Murata
ENC-03J gyroscopes and three ICSensors 3031 accelerometers. Each channel has a gain stage, a second-order low-pass and 12 bits at 5
V. The board has an LM335. The other presets are digital parts. Every property of a unit is drawn from a normal distribution about
the value in the data sheet, truncated at ``limit_sd`` standard deviations. Noise is typical and equal for all units.
"""

import math
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError, check_type
from undrift.record import TemperatureSensitivity
from undrift.sim.device.effects import (
    Adc,
    Amplifier,
    BiasInstability,
    GSensitivity,
    LeverArm,
    Nonlinearity,
    Offset,
    PowerOnTransient,
    RandomWalk,
    RateDrift,
    Sampling,
    Scale,
    SensorChain,
    ThermalHysteresis,
    ThermalScale,
    Thermometer,
    WhiteNoise,
    sallen_key,
)
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.simulate import draw_streams
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

# ---- Grades: spread of a production run, as standard deviations about the values in the data sheet.


@dataclass(frozen=True, slots=True, kw_only=True)
class TriadGrade:
    """Spread of a triad's properties over units. Names in ``_sd`` are standard deviations."""

    unit: str  # unit of the reading
    sensitivity: float  # nominal sensitivity of the sensor, output unit per rad/s or m/s2
    sensitivity_sd: float  # relative error of the sensitivity
    misalignment_sd: float  # angle of each axis about each perpendicular axis, rad
    nonlinearity_sd: float = 0.0  # quadratic deviation at full scale, relative to full scale
    offset_sd: float  # rad/s or m/s2
    offset_per_k_sd: float  # rad/s/K or m/s2/K
    offset_per_k2_sd: float = 0.0  # rad/s/K2 or m/s2/K2
    scale_per_k_sd: float = 0.0  # relative, per K
    # rate-dependent drift at full scale, relative to full scale, per K: ``e = c x^3 D``
    rate_drift_sd: float = 0.0
    g_sensitivity_sd: float = 0.0  # rad/s per m/s2
    warm_up_sd: float = 0.0  # amplitude of the warm-up, rad/s or m/s2
    warm_up_s: float = 600.0  # time constant of the warm-up, s
    hysteresis_sd: float = 0.0  # amplitude of the hysteresis, rad/s or m/s2
    lever_arm_sd: float = 0.0  # coordinate of each sensor along each axis, m
    random_walk: float  # white noise, rad/s/sqrt(Hz) or m/s2/sqrt(Hz)
    instability: float = 0.0  # B, rad/s or m/s2
    bias_walk: float = 0.0  # rad/s/sqrt(s) or m/s2/sqrt(s)
    full_scale: float = math.inf  # range, rad/s or m/s2, to which non-linearity and rate drift are relative
    amplifier: Amplifier | None = None  # equal for all units
    cutoff_hz: float | None = None  # cut-off of the Sallen-Key low-pass, or None without low-pass
    part_sd: float = 0.0  # relative errors of resistors and capacitors of the low-pass
    adc: Adc | None = None  # equal for all units


@dataclass(frozen=True, slots=True, kw_only=True)
class Grade:
    """Spread of a device's properties over units."""

    gyro: TriadGrade  # gyroscopes
    accel: TriadGrade  # accelerometers
    # thermometer, equal for all units except for its trim error
    thermometer: Thermometer = field(default_factory=lambda: Thermometer(noise_c=0.05, step_c=0.125))
    trim_error_sd: float = 0.0  # standard deviation of the thermometer's trim error, K
    sampling: Sampling = field(default_factory=Sampling)  # equal for all units
    limit_sd: float = math.inf  # limit of the spread, in standard deviations
    name: str = ""  # kind of device
    source_tag: str = "assumed"  # reliability of the numbers


# ---- Conversion of the numbers from the units of data sheets.

DPS, G, MG = RADIAN_PER_DEGREE, STANDARD_GRAVITY, 1e-3 * STANDARD_GRAVITY
FLOOR = math.sqrt(2.0 * math.log(2.0) / math.pi)  # ratio of the Allan deviation's floor (in data sheets) to B
ONE_SIDED = math.sqrt(2.0)  # ratio of a data sheet's density to the random walk (see WhiteNoise.random_walk)

UNITS = {"dps": DPS, "g": G, "mg": MG, "ug": 1e-6 * G, "floor": FLOOR, "one_sided": ONE_SIDED}
GRADES = ("consumer", "industrial", "wearable")
_BOOK: dict[str, Any] = tomllib.loads(Path(__file__).with_name("presets.toml").read_text(encoding="utf-8"))
# numbers of the digital parts, each with its tag at the end, by part and triad
SHEETS: dict[str, dict[str, tuple[Any, ...]]] = {
    name: {side: tuple(_BOOK["sheets"][side][name]) for side in ("gyro", "accel")}
    for name in _BOOK["sheets"]["gyro"]
    if name != "columns"
}
PRESETS: tuple[str, ...] = ("enc03j_3031", *SHEETS)


def without_assumed(grade: Grade) -> Grade:
    """Return the spread of a preset without the errors whose size is assumed. The draws of all other errors do not change."""
    sides: dict[str, TriadGrade] = {}
    for side, triad in (("gyro", grade.gyro), ("accel", grade.accel)):
        figures = _BOOK["assumed"][side].get(grade.name, ())
        without: dict[str, Any] = {_BOOK["figures"].get(figure, (figure,))[0]: 0.0 for figure in figures}
        sides[side] = replace(triad, **without)
    return replace(grade, gyro=sides["gyro"], accel=sides["accel"])


def sensitivity_of(name: str) -> TemperatureSensitivity:
    """Return the temperature sensitivity of a kind of device. With a limit a, var = 1 - 2 a phi(a) / erf(a / sqrt 2)."""
    grade = grade_of(name)
    a = min(grade.limit_sd, 10.0)
    within = math.sqrt(1.0 - a * math.exp(-0.5 * a**2) * math.sqrt(2.0 / math.pi) / math.erf(a * math.sqrt(0.5)))
    return TemperatureSensitivity(
        gyro_offset_dps_per_k=within * grade.gyro.offset_per_k_sd / DPS,
        accel_offset_mg_per_k=within * grade.accel.offset_per_k_sd / MG,
        gyro_scale_percent_per_k=100.0 * within * grade.gyro.scale_per_k_sd,
        accel_scale_percent_per_k=100.0 * within * grade.accel.scale_per_k_sd,
        thermometer_lag_s=grade.thermometer.lag_s,
    )


@cache
def grade_of(name: str) -> Grade:
    """Return the spread of a named grade, or of a kind of device."""
    if name not in PRESETS and name not in GRADES:
        raise InputError(
            f"grade: unknown grade or preset '{name}'. Use one of {', '.join((*GRADES, *PRESETS))}, or a Grade."
        )
    figures: dict[str, Any] = _BOOK.get(name, _BOOK["sheets"]["device"])
    limit = figures.get("limit_sd", math.inf)
    divisor = 1.0 if math.isinf(limit) else limit
    if name in SHEETS:
        columns = {
            side: dict(zip(_BOOK["sheets"][side]["columns"], row, strict=True)) for side, row in SHEETS[name].items()
        }
        tag = "; ".join(f"{side} {column.pop('tag')}" for side, column in columns.items())
        figures = {**figures, **columns, "source_tag": tag}
    return Grade(
        name=name,
        gyro=_triad(figures["gyro"], "rad/s", divisor),
        accel=_triad(figures["accel"], "m/s2", divisor),
        thermometer=Thermometer(**figures.get("thermometer", {"noise_c": 0.05, "step_c": 0.125})),
        trim_error_sd=figures.get("trim_error_sd", 0.0) / divisor,
        sampling=Sampling(**figures.get("sampling", {})),
        limit_sd=limit,
        source_tag=figures.get("source_tag", "assumed"),
    )


def _triad(figures: Mapping[str, Any], si_unit: str, divisor: float) -> TriadGrade:
    fields: dict[str, Any] = {"unit": "count", "adc": {"bits": 16, "reference": 2.0**15}}
    for key, figure in figures.items():
        field_name, *scale = _BOOK["figures"].get(key, (key,))
        for k, number in enumerate(UNITS.get(unit, unit) for unit in scale):
            figure = figure / number if k else figure * number
        fields[field_name] = figure / divisor if field_name.endswith("_sd") else figure
    if not fields["sensitivity"]:
        fields |= {"unit": si_unit, "sensitivity": 1.0, "adc": None}
    for name, kind in (("adc", Adc), ("amplifier", Amplifier)):
        if fields.get(name):
            fields[name] = kind(**fields[name])
    return TriadGrade(**fields)


# ---- Random devices: units of a production run with a grade.

Draw = Callable[[str, float, tuple[int, ...]], FloatArray]  # effect, standard deviation, shape


def preset(name: str) -> DeviceModel:
    """Return the typical device of a kind, with every error at half its tolerance and signs that alternate with the axis."""
    return typical_device(grade_of(name), serial=f"{name}-typical")


def random_device(rng: np.random.Generator, *, grade: str | Grade = "consumer", serial: str = "") -> DeviceModel:
    """Draw one unit of a production run at random.

    Parameters
    ----------
    rng : Generator
        Random generator. Each property has its own stream.
    grade : str or Grade
        Spread of the units: consumer, industrial, wearable, a preset, or a Grade.
    serial : str
        Serial number, by default a hash of all properties.

    Returns
    -------
    DeviceModel
        Device with the true values as its fields.

    Raises
    ------
    InputError
        If the grade is unknown.

    Examples
    --------
    >>> import numpy as np, undrift
    >>> device = undrift.random_device(np.random.default_rng(7), grade="industrial")
    >>> device.gyro.unit
    'count'
    """
    check_type(rng, np.random.Generator, "random_device: `rng`", "Pass for example numpy.random.default_rng(7).")
    from scipy.special import ndtr, ndtri

    chosen = grade_of(grade) if isinstance(grade, str) else grade
    streams = draw_streams(rng)

    def draw(effect: str, sd: float, shape: tuple[int, ...]) -> FloatArray:
        stream = streams.of(effect)
        if math.isinf(chosen.limit_sd):
            return stream.normal(0.0, sd, shape)
        low = float(ndtr(-chosen.limit_sd))  # draws within the limit, from the inverse of the distribution function
        return sd * np.asarray(ndtri(stream.uniform(low, 1.0 - low, shape)))

    device = replace(device_of(chosen, draw, serial), source_tag="drawn")
    return device if serial else replace(device, serial=_serial_of(device))


def _serial_of(device: DeviceModel) -> str:
    """Return a serial number from a hash of all values, so that different devices have different numbers."""
    import hashlib
    import json

    from undrift.sim.device.model import device_json

    return f"SIM-{hashlib.sha256(json.dumps(device_json(device), sort_keys=True).encode()).hexdigest()[:12].upper()}"


def typical_device(grade: Grade, *, serial: str = "typical") -> DeviceModel:
    """Return a device with errors of one standard deviation and signs that alternate with the axis."""

    def draw(effect: str, sd: float, shape: tuple[int, ...]) -> FloatArray:
        signs: FloatArray = (-1.0) ** np.indices(shape).sum(axis=0)
        return sd * signs

    return device_of(grade, draw, serial)


def device_of(grade: Grade, draw: Draw, serial: str) -> DeviceModel:
    """Return a device whose errors are returned by a function."""
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
    def draw(effect: str, shape: tuple[int, ...] = (3,), *, sd: float | None = None) -> FloatArray:
        return draw_named(f"{name}_{effect}", getattr(grade, f"{effect}_sd") if sd is None else sd, shape)

    axes = np.where(np.eye(3, dtype=bool), 1.0, draw("axes", (3, 3), sd=grade.misalignment_sd))
    scale = Scale(
        nominal_sensitivity=grade.sensitivity,
        error=draw("sensitivity"),
        axes=axes / np.linalg.norm(axes, axis=1, keepdims=True),
    )
    per_k = np.array([draw(power) for power in ("offset_per_k", "offset_per_k2")][: 2 if grade.offset_per_k2_sd else 1])
    bend = Nonlinearity(quadratic=draw("nonlinearity") / grade.full_scale)
    cubic = np.zeros((3, 2, 3))
    cubic[2, 1] = draw("rate_drift") / grade.full_scale**2
    effects = {
        "lever_arm": (grade.lever_arm_sd, LeverArm(arms=draw("lever_arm", (3, 3)))),
        "nonlinearity": (grade.nonlinearity_sd, bend),
        "g_sensitivity": (grade.g_sensitivity_sd, GSensitivity(matrix=draw("g_sensitivity", (3, 3)))),
        "thermal_scale": (grade.scale_per_k_sd, ThermalScale(per_k=draw("scale_per_k")[None, :])),
        "rate_drift": (grade.rate_drift_sd, RateDrift(coefficients=cubic)),
        "warm_up": (grade.warm_up_sd, PowerOnTransient(amplitude=draw("warm_up"), time_constant_s=grade.warm_up_s)),
        "hysteresis": (grade.hysteresis_sd, ThermalHysteresis(amplitude=draw("hysteresis"))),
        "white_noise": (grade.random_walk, WhiteNoise(random_walk=np.full(3, grade.random_walk))),
        "instability": (grade.instability, BiasInstability(instability=np.full(3, grade.instability))),
        "random_walk": (grade.bias_walk, RandomWalk(bias_walk=np.full(3, grade.bias_walk))),
    }
    return SensorChain(
        unit=grade.unit,
        scale=scale,
        offset=Offset(constant=draw("offset"), per_k=per_k),
        amplifier=grade.amplifier,
        low_pass=sallen_key(grade.cutoff_hz, draw("low_pass", (3, 4), sd=grade.part_sd)) if grade.cutoff_hz else None,
        adc=grade.adc,
        **{effect: value for effect, (size, value) in effects.items() if size},  # type: ignore[arg-type]
    )
