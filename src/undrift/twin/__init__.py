"""twin: the device model fitted to a real device, and how well it speaks for it on a motion that it has not seen.

Beside studies this is the only place where simulation and estimation meet.
"""

from undrift.twin.accel import AccelFit, fit_accel
from undrift.twin.device import device_of, drawn_gyro
from undrift.twin.fit import Prepared, Twin, TwinSettings, fit_prepared, fit_twin, prepare_twin
from undrift.twin.heldout import HeldOutTrial, WindowErrors, compare_held_out
from undrift.twin.match import Match, match
from undrift.twin.parameters import TwinParameter

__all__ = [
    "AccelFit",
    "HeldOutTrial",
    "Match",
    "Prepared",
    "Twin",
    "TwinParameter",
    "TwinSettings",
    "WindowErrors",
    "compare_held_out",
    "device_of",
    "drawn_gyro",
    "fit_accel",
    "fit_prepared",
    "fit_twin",
    "match",
    "prepare_twin",
]
