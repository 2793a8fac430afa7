"""Content of a column from its name and unit: sensor, channel, axis, unit. A missing unit is never added here.

A_X [mg]    accX[g]    Gyroscope x (rad/s)    Shimmer_40AC_Accel_LN_X_CAL over m/(s^2)    ACC X (G)
"""

import re
from collections.abc import Mapping
from typing import NamedTuple

from undrift.errors import InputError
from undrift.io.column_map import QUANTITY
from undrift.units import DEVICE_UNITS, canonical_unit


class Label(NamedTuple):
    """Content of a column."""

    sensor: str  # "" if the file contains only one sensor
    channel: str  # time, gyro, accel, mag, temp, or "free": acceleration without gravity
    axis: str = ""  # axis x, y or z, or ""
    unit: str = ""  # canonical unit, or "" if it is missing or unknown
    gain: float = 1.0  # gain to that unit
    rate_hz: float | None = None  # name of this channel's time, if channels with several rates are side by side
    time: int | None = None  # position of its time column


_SPELLED = {
    "m/(s^2)": "m/s2", "m/s**2": "m/s2", "m.s-2": "m/s2", "m s-2": "m/s2", "degrees celsius": "degc", "deg_c": "degc",
    "degree/s": "dps", "°/sec": "dps", "deg/sec.": "dps", "mdps": "dps", "μt": "ut", "nt": "ut", "μs": "us",
    "no_units": "count", "ga": "gauss", "mga": "mgauss", "tesla": "t",
}  # fmt: skip
_GAIN = {"mdps": 1e-3, "nt": 1e-3}
_OTHER = {
    "mv", "uv", "us", "kohms", "ohm", "local_flux", "kpa", "hpa", "pa", "mbar", "bar", "deg", "rad", "%", "a.u.", "-", "m",
    "mm", "cm", "hz", "lux", "n", "nm", "unixtime", "n/a",
}  # fmt: skip
_KIND = tuple(
    (channel, re.compile(pattern, re.IGNORECASE))
    for channel, pattern in (
        ("free", r"linear|free_?acc|user_? ?acc|lin_acc|without.?g|no.?gravity"),
        (
            "gyro",
            r"gyr|angular.?(velocity|rate|speed)|turn.?rate|rotation.?rate|omega|^(gy|[gw])[ _.]*$",
        ),
        ("mag", r"magn|^mag|[ _.]mag|compass|^[bm][ _.]*$"),
        ("accel", r"acc|specific.?force|^(ac?|gF)[ _.]*$"),
        ("temp", r"temp(?!o\b|s\b)|^tmp$|thermo"),
        ("time", r"^(ts?|millis|micros)\s*$|time|seconds_elapsed"),
    )
)
_NATIVE = {"dps": "dps", "rad_s": "rad/s", "m_s2": "m/s2"} | {unit: unit for unit in ("g", "mg", "ut", "s", "ms", "us")}
_SUFFIX = re.compile(rf"(?i)_({'|'.join(_NATIVE)})$")
_AXIS = (
    re.compile(r"(?i)(?<![a-z])([xyz])(?![a-z])"),
    re.compile(r"(?<=[a-z])([XYZ])(?![A-Za-z])"),
    re.compile(r"(?i)^(?:a|w|g|gF|b|m|acc|accel|gyr|gyro|mag)_?([xyz])$"),
)
_WORDS = re.compile(  # words of a name that do not distinguish sensors
    r"(?i)^(acc\w*|gyr\w*|mag\w*|sensor|angular|velocity|rate|magnetic|field|un|cal|raw|noraxon|myomotion|segments|[agwm]|gf|"
    r"temp\w*|turn|rotation|specific|force|total|uncalibrated|imu)$"
)


def unit_for(text: str, channel: str) -> tuple[str, float] | None:
    """Return the canonical spelling of a unit and the gain to it, or None if the text is not a unit of this channel."""
    name = text.strip().lower()
    gain, name = _GAIN.get(name, 1.0), _SPELLED.get(name, name)
    if channel == "mag":
        name = {"g": "gauss", "mg": "mgauss"}.get(name, name)
    try:
        return canonical_unit(name, QUANTITY["accel" if channel == "free" else channel]), gain  # type: ignore[index]
    except InputError:
        return None


def is_unit(text: str) -> bool:
    """Return True if a cell is a unit."""
    return text.strip().lower() in _OTHER or any(unit_for(text, channel) for channel in QUANTITY)


def split_unit(name: str) -> tuple[str, str]:
    """Return a column's name without its unit, and the unit: "A_X [mg]", "Time (s)", "Accel X,mG", "Time in ms", "acc_x_g"."""
    match = re.fullmatch(r"(.*?)[\s_]*[\[(]([^\[\]()]*(?:\([^()]*\))?)[\])]\s*", name) or re.fullmatch(
        r"(.+?)(?:,| in (?=[mu]?s *$))\s*(\S*)\s*", name
    )
    if match and (is_unit(match.group(2)) or not re.search(r"\d\]$", name)):
        return match.group(1), match.group(2)
    suffix = _SUFFIX.search(name)
    stem = name[: suffix.start()] if suffix else ""
    if suffix and any(pattern.search(name) or pattern.search(stem) for _, pattern in _KIND):
        return stem, _NATIVE[suffix.group(1).lower()]
    return name, ""


def label_of(name: str, unit: str = "", assumed: Mapping[str, str] | None = None) -> Label | None:
    """Return the content of a column from its name and unit. The units ``assumed`` come from a maker's manual."""
    base, name_unit = split_unit(name)
    unit, axis, stem = unit or name_unit, "", base
    for pattern in _AXIS:
        if hits := list(pattern.finditer(base)):
            at = hits[-1]
            axis, stem = at.group(1).lower(), base[: at.start(1)] + base[at.end(1) :]
            break
    channel = next((channel for channel, pattern in _KIND if pattern.search(stem)), None)
    if channel is None and axis and unit:
        fits = [other for other in ("gyro", "accel", "mag") if unit_for(unit, other) and (other, unit) != ("mag", "g")]
        channel = fits[0] if len(fits) == 1 else None
    if channel == "time" and stem.strip() == "T" and not unit:
        return None  # this name is as often a temperature as a time
    if channel == "time" and unit and not unit_for(unit, "time") and unit_for(unit, "temp"):
        channel = "temp"  # "T" in degC is a temperature
    if channel is None or (not axis and channel not in ("time", "temp")):
        return None
    scaled_unit = unit_for(unit or (assumed or {}).get(channel, ""), channel)
    if unit and scaled_unit is None and channel in ("gyro", "accel") and is_unit(unit):
        return None  # the unit contradicts the name
    tokens = re.split(r"[\W_]+", stem) if channel not in ("time", "free") else []
    kind = dict(_KIND)[channel]
    tokens = [token for token in tokens if token and not _WORDS.match(token) and not kind.search(token)]
    if scaled_unit and scaled_unit[0] in DEVICE_UNITS and channel in ("mag", "temp"):
        scaled_unit = None  # counts need a scale from a map
    return Label(
        " ".join(tokens), channel, axis if channel not in ("time", "temp") else "", *(scaled_unit or ("", 1.0))
    )
