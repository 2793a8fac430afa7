"""ThermalSettings: how a thermal session is performed, and what of it is written down."""

from dataclasses import dataclass
from typing import Literal

from undrift.errors import InputError
from undrift.session import Face
from undrift.sim.motion.bench import BenchSettings
from undrift.sim.thermal.chamber import ChamberSettings, RampSettings, WarmUpSettings
from undrift.units import RADIAN_PER_DEGREE

ThermalKind = Literal["soak", "ramp", "warm_up", "multi_position"]
Recorded = Literal["soaked", "throughout"]

SET_POINTS_C = (18.0, *(float(temp) for temp in range(25, 76, 5)))  # the note's range, every 5 K from 25 degC on
INCLUSIVE_RATES = tuple(rate * RADIAN_PER_DEGREE for rate in range(5, 91, 5))  # sit-to-stand, both ends: 36 both ways
CHAMBER, RAMP, WARM_UP = ChamberSettings(), RampSettings(), WarmUpSettings()
BENCH = BenchSettings(sample_rate_hz=50.0, turn_rates=INCLUSIVE_RATES)


@dataclass(frozen=True, slots=True, kw_only=True)
class ThermalSettings:
    """How a thermal session is performed.

    Parameters
    ----------
    bench : BenchSettings
        Motion at a set-point: sample rate (50 Hz), gravity, still_s (6 s a face), rates of the table (5 to 90 deg/s by 5, each
        both ways; none leaves the table out), ramp_s and dwell_s (0.5 and 3 s), tilt of the faces (0), poses and first still of
        a multi-position session (24 poses, 20 s).
    chamber : ChamberSettings
        How fast temperatures follow, and when the board counts as soaked.
    set_points_c : tuple of float
        Of soaks and multi-position sessions, degC, in the order of the visits.
    back : bool
        Visit them once more in the opposite order: shows hysteresis, takes twice as long.
    faces : str
        "one" rests with +z up at each set-point, "six" with each axis up and down: shows accelerometer scale over temperature.
    recorded : str
        "soaked" records at the set-points alone, "throughout" on the way between them too.
    one_record : bool
        One long record; else one for each set-point. The clock is that of the programme in either case.
    ramp : RampSettings
        Of a ramp.
    warm_up : WarmUpSettings
        Of a warm-up.
    rest_face : str
        What points up in a ramp and a warm-up.
    power_on_s : float
        Time since power-on when the programme begins, s: an hour, so that what the device owes to its age has gone. A warm-up
        begins at power-on whatever this says.
    drop_temperature : bool
        True leaves the temperature column out and writes the set-points to stills and turns; what was recorded on the way, a
        ramp and a warm-up then tell no temperature at all.
    labelled : bool
        False leaves stills and turns, and with them the set-points, to be found in the data.
    """

    bench: BenchSettings = BENCH
    chamber: ChamberSettings = CHAMBER
    set_points_c: tuple[float, ...] = SET_POINTS_C
    back: bool = False
    faces: Literal["one", "six"] = "one"
    recorded: Recorded = "soaked"
    one_record: bool = True
    ramp: RampSettings = RAMP
    warm_up: WarmUpSettings = WARM_UP
    rest_face: Face = "+z"
    power_on_s: float = 3600.0
    drop_temperature: bool = False
    labelled: bool = True

    def __post_init__(self) -> None:
        if self.power_on_s < 0.0:
            raise InputError(
                f"thermal: wanted power_on_s of 0 or more, got {self.power_on_s:g} s; correct the settings"
            )
