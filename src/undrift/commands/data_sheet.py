"""What the data sheet of a part states, for what was measured to stand beside: nominal scale factor, limits, typical noise.

The part is the one that a person names, or that a calibration has kept so; it is never guessed. A digital part reads 0 at zero, and
its ranges differ by factors of two, so that the nominal counts are those of the nearest range. Behind an amplifier none is stated.
"""

import math
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from undrift.base.options import options
from undrift.base.summary import at
from undrift.errors import InputError
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, is_physical, si_factor

if TYPE_CHECKING:
    from undrift.model import TriadModel
    from undrift.sim.device.presets import Grade

SHOWN = {
    "gyro": ("deg/s", 1.0 / RADIAN_PER_DEGREE),
    "accel": ("mg", 1e3 / STANDARD_GRAVITY),
}  # unit, and how many are one SI
PART = "kind"  # setting of a calibration's origin
TRUST = {"found": "read in the sheet", "known": "recalled", "known-low": "recalled, uncertain", "calc": "computed"}


def sheet_of(kind: str) -> "Grade":
    """Return what the data sheet of a part states, by the name of its preset."""
    grade: Grade = at("undrift.sim.device.presets:preset_grade")(kind)
    return grade


def sheet_words(kind: str) -> str:
    """Return the name of a data sheet, and how far its figures are to be trusted."""
    trust = re.sub("known-low|known|found|calc", lambda tag: TRUST[tag[0]], sheet_of(kind).source_tag.partition(":")[0])
    return f"data sheet of {kind} as its preset states it ({trust}; compare with the sheet before judging by it)"


def nominal_of(name: str, triad: "TriadModel", kind: str) -> float:
    """Return the nominal scale factor, unit of the readings per SI; NaN where neither unit nor data sheet states one."""
    if is_physical(triad.unit_in):
        return 1.0 / si_factor(triad.unit_in, "rate" if name == "gyro" else "accel")
    stated = getattr(sheet_of(kind), name) if kind else None
    if stated is None or stated.amplifier is not None or triad.unit_in != stated.unit:
        return math.nan
    return float(stated.sensitivity * 2.0 ** round(math.log2(triad.scale_factor.mean() / stated.sensitivity)))


def sheet_limit(kind: str, name: str, block: str) -> float:
    """Return a limit of a data sheet: per cent of a scale factor or across axes, deg/s or mg of an offset."""
    grade = sheet_of(kind)
    triad = getattr(grade, name)
    size = {"scale": triad.sensitivity_sd, "cross": triad.misalignment_sd, "offset": triad.offset_sd}[block]
    return float(grade.limit_sd * size * (SHOWN[name][1] if block == "offset" else 100.0))


@options
@dataclass(frozen=True, kw_only=True)
class Specification:
    """What the readings are judged by, before correction.

    Parameters
    ----------
    kind : str or None
        Preset of the device's part, as mpu6050: the limits of its data sheet; those that are stated below go before.
    limit_gyro_scale_percent : float or None
        Limit for the scale factors of the gyroscopes, % from nominal.
    limit_gyro_cross_percent : float or None
        Limit for their cross-axis terms, %.
    limit_gyro_offset_dps : float or None
        Limit for their offsets, deg/s.
    limit_accel_scale_percent : float or None
        Limit for the scale factors of the accelerometers, % from nominal.
    limit_accel_cross_percent : float or None
        Limit for their cross-axis terms, %.
    limit_accel_offset_mg : float or None
        Limit for their offsets, mg.
    """

    kind: str | None = None
    limit_gyro_scale_percent: float | None = None
    limit_gyro_cross_percent: float | None = None
    limit_gyro_offset_dps: float | None = None
    limit_accel_scale_percent: float | None = None
    limit_accel_cross_percent: float | None = None
    limit_accel_offset_mg: float | None = None

    def of(self, name: str, block: str) -> float | None:
        """Return a limit, None where none is given."""
        unit = {"gyro": "dps", "accel": "mg"}[name] if block == "offset" else "percent"
        limit: float | None = getattr(self, option := f"limit_{name}_{block}_{unit}")
        if limit is not None and not 0.0 < limit < math.inf:
            raise InputError(f"`{option}`: wanted a limit above 0, got {limit:g}; state that of the specification")
        return sheet_limit(self.kind, name, block) if limit is None and self.kind else limit
