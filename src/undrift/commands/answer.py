"""Uncertainty of a calibration in sentences that several commands print."""

import math

import numpy as np

from undrift.arrays import FloatArray
from undrift.base.summary import Section
from undrift.commands.expanded import COVERAGE, expand, gravity_uncertainty
from undrift.correction.rest import IN_MOTION, moved_by
from undrift.model import Calibration, TriadModel
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, is_physical

ANSWERED_S, MG_PER_PERCENT = 60.0, 10.0  # time of the answer, s; mg per per cent of scale factor at 1 g
ANSWERED = (
    "The pitch error after 60 s includes the tilt from gravity, the offset, and the change of the offset from rest "
    "to motion "
    "(without a fit, 0.02 deg/s per axis is assumed). Turns, heat and ageing add further errors."
)
NAMES = {"gyro": "Gyroscopes", "accel": "Accelerometers"}
OFFSETS = {"gyro": "zero-rate output", "accel": "zero-g offset"}
SHOWN = {  # unit, and how many are one SI
    "gyro": ("deg/s", 1.0 / RADIAN_PER_DEGREE),
    "accel": ("mg", 1e3 / STANDARD_GRAVITY),
}
BLOCKS = {
    "scale": "scale factor", "cross": "cross-axis sensitivity", "offset": "offset", "g": "g-sensitivity",
    "moving": "offset in motion minus offset at rest", "code": "offset of codes",
}  # fmt: skip


def answer_sentence(calibration: Calibration) -> str:
    """Return the uncertainty of the calibration in a sentence, at 95 % on the worst axis: pitch after a minute, offset
    and gravity.
    """
    worst = dict[tuple[str, str], float]()  # expanded uncertainty by triad and block: mg or deg/s, and per cent
    for name in ("accel", "gyro"):
        if (triad := getattr(calibration, name)) is not None:
            table, (per, _) = expand(triad, gravity_uncertainty(calibration, name)), budget_units(name, triad)
            for block in ("scale", "cross", "offset"):
                expanded = np.abs(per[block] * table.expanded[table.of_block(block)])
                worst[name, block] = float(expanded.max(initial=0.0))
    drift, zero = (worst.get((name, "offset"), 0.0) for name in ("gyro", "accel"))
    scale, cross = (MG_PER_PERCENT * worst.get(("accel", block), 0.0) for block in ("scale", "cross"))
    gravity, level, gyro = math.hypot(zero, scale), math.hypot(zero, cross), calibration.gyro
    # the offset of these methods is that in motion
    still = gyro is None or (gyro.method in IN_MOTION and gyro.moving_offset is None)
    moved = 0.0 if still else COVERAGE * moved_by(gyro) / math.sqrt(3.0) / RADIAN_PER_DEGREE
    pitch = math.hypot(ANSWERED_S * drift, ANSWERED_S * moved, level / 1e3 / RADIAN_PER_DEGREE)
    size, where = two_digits, "at the temperature of the calibration, 95 %"
    if not math.isfinite(pitch + gravity) or not drift + gravity:
        return "This calibration has no uncertainty."
    if not drift:
        return f"Gravity is within {size(gravity)} mg ({where})."
    if not gravity:
        basis = f"offset at rest {size(drift)} deg/s"
        return f"After {ANSWERED_S:g} s the pitch drifts by {size(pitch)} deg at most ({where}): {basis}."
    basis = f"offset at rest {size(drift)} deg/s, gravity within {size(gravity)} mg"
    return f"After {ANSWERED_S:g} s the pitch is good to {size(pitch)} deg ({where}): {basis}."


def uncertainty_section(calibration: Calibration) -> Section:
    """Return the expanded uncertainty of each kind of parameter, and the components of the answer."""
    return Section(title="Expanded uncertainty", text=(uncertainty_sentence(calibration), ANSWERED))


def uncertainty_sentence(calibration: Calibration) -> str:
    """Return the largest expanded uncertainty of each block of parameters in a sentence."""
    triads = [(name, triad) for name in ("accel", "gyro") if (triad := getattr(calibration, name)) is not None]
    text = "; ".join(expanded_words(*pair, gravity_uncertainty(calibration, pair[0])) for pair in triads)
    return f"Expanded uncertainty (95 %) at the temperature of the calibration: {text}."


def expanded_words(name: str, triad: TriadModel, gravity: float = 0.0) -> str:
    """Return the largest expanded uncertainty of each block in words."""
    table, (per, units) = expand(triad, gravity), budget_units(name, triad)
    largest = {block: np.abs(per[block] * table.expanded[table.of_block(block)]).max(initial=0.0) for block in units}
    if not 0.0 < sum(largest.values()) < math.inf:
        return f"{NAMES[name].lower()} not known"
    parts = [f"{two_digits(largest['offset'])} {units['offset']} of {OFFSETS[name]}"] if largest["offset"] else []
    parts += [f"{two_digits(largest[block])} % of {BLOCKS[block]}" for block in ("scale", "cross") if largest[block]]
    fixed = [BLOCKS[block] for block in ("scale", "cross") if not largest[block]]
    return f"{NAMES[name].lower()} up to {', '.join(parts)}" + f" ({' and '.join(fixed)} not calibrated)" * bool(fixed)


def budget_units(name: str, triad: TriadModel) -> tuple[dict[str, float], dict[str, str]]:
    """Return how many units of the budget are one of the triad's, and the unit, by block."""
    scale = float(np.diag(triad.matrix).mean())
    unit, factor = SHOWN[name]
    per = dict.fromkeys(("scale", "cross"), 100.0 / scale) | dict.fromkeys(("offset", "code"), abs(scale) * factor)
    per |= {"g": factor * STANDARD_GRAVITY, "moving": factor}
    units = {"scale": "%", "cross": "%", "offset": unit, "g": f"{unit} per g", "moving": unit, "code": unit}
    return per, units


def departures_words(name: str, triad: TriadModel) -> str:
    """Return the reference of the departures that ``draw_calibration`` shows."""
    if is_physical(triad.unit_in):
        ideal = f"departures from the unit of the readings, {triad.unit_in}: the errors without calibration."
    else:
        ideal = f"departures from the mean scale factor of the three axes. For readings in {triad.unit_in} there is no nominal one."
    return f"{NAMES[name]}: {ideal}"


def two_digits(value: float) -> str:
    """Return a size to two digits, a dash for none."""
    mantissa, _, power = f"{value:#.2g}".partition("e")
    return f"{mantissa.removesuffix('.')}{power and f'e{int(power)}'}" if value > 0.0 else "–"


def rms_of(values: FloatArray) -> float:
    """Return the root mean square."""
    return math.sqrt(float((values**2).mean()))
