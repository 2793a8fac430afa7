"""protocol.toml: what a calibration session is to do.

[protocol]
name = "sit-to-stand"
cutoff_hz = 11.1                    # the device's low-pass: how long it settles
[faces]                             # leave out for none
order = ["+x", "-x", "+y", "-y", "+z", "-z"]
seconds = 6.0
[rates]                             # leave out for none
turn_rate_min_dps = 5.0
turn_rate_max_dps = 90.0
turn_rate_step_dps = 5.0
grid = "paper"                      # paper leaves the least rate out | inclusive
axes = ["x", "y", "z"]
order = "alternating"               # or random, with seed
seconds = 6.0                       # of a dwell, or turn_rate_uncertainty_dps
bracket_s = 6.0                     # rest before and after each block
whole_turns = false
acceleration_dps2 = 2300.0
[temperatures]                      # leave out for room temperature
set_points_c = [18.0, 30.0, 45.0, 60.0, 75.0]
soak_c_per_min = 0.1
"""

from pathlib import Path
from typing import Annotated

from pydantic import Field

from undrift.errors import FileFormatError, InputError
from undrift.files import write_whole
from undrift.io.toml import Entry, read_toml
from undrift.protocol import AXES, GridRule, Order, Protocol, rate_grid
from undrift.session import FACES, Axis, Face
from undrift.units import RADIAN_PER_DEGREE

Finite = Annotated[float, Field(allow_inf_nan=False)]
DEFAULTS = Protocol()


class HeadEntry(Entry):
    """[protocol].

    Parameters
    ----------
    name : str
        For people.
    cutoff_hz : float
        Bandwidth of the device's low-pass, Hz.
    """

    name: str = ""
    cutoff_hz: Finite = DEFAULTS.cutoff_hz


class FacesEntry(Entry):
    """[faces].

    Parameters
    ----------
    order : list of str
        Sensor axis that points up, one after the other.
    seconds : float
        Rest on each, s.
    """

    order: list[Face] = Field(default_factory=lambda: list(FACES))
    seconds: Finite = DEFAULTS.face_s


class RatesEntry(Entry):
    """[rates].

    Parameters
    ----------
    turn_rate_min_dps, turn_rate_max_dps, turn_rate_step_dps : float
        Least and greatest rate and the step, deg/s.
    grid : str
        paper or inclusive.
    axes : list of str
        Axes to turn about.
    order : str
        alternating or random.
    seed : int
        Of the random order.
    seconds : float or None
        Of a dwell, s.
    turn_rate_uncertainty_dps : float or None
        Wanted standard uncertainty of a dwell, deg/s.
    bracket_s : float
        Rest before and after each block, s.
    whole_turns : bool
        Lengthen dwells to whole turns.
    acceleration_dps2 : float
        Of the table, deg/s2.
    """

    turn_rate_min_dps: Finite
    turn_rate_max_dps: Finite
    turn_rate_step_dps: Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
    grid: GridRule = DEFAULTS.grid
    axes: list[Axis] = Field(default_factory=lambda: list(AXES), min_length=1)
    order: Order = DEFAULTS.order
    seed: int = 0
    seconds: Finite | None = None
    turn_rate_uncertainty_dps: Finite | None = None
    bracket_s: Finite = DEFAULTS.bracket_s
    whole_turns: bool = False
    acceleration_dps2: Finite = DEFAULTS.acceleration / RADIAN_PER_DEGREE


class TemperaturesEntry(Entry):
    """[temperatures].

    Parameters
    ----------
    set_points_c : list of float
        degC, rising.
    soak_c_per_min : float
        Slope below which a set-point counts as reached, K/min.
    """

    set_points_c: list[Finite] = Field(min_length=1)
    soak_c_per_min: Finite = DEFAULTS.soak_c_per_min


class ProtocolFile(Entry):
    """The whole file.

    Parameters
    ----------
    protocol : HeadEntry
        Name and filter.
    faces : FacesEntry or None
        For the accelerometers.
    rates : RatesEntry or None
        For the gyroscopes.
    temperatures : TemperaturesEntry or None
        For the drift tables.
    """

    protocol: HeadEntry = HeadEntry()
    faces: FacesEntry | None = None
    rates: RatesEntry | None = None
    temperatures: TemperaturesEntry | None = None


def read_protocol(path: str | Path) -> Protocol:
    """Read a protocol.

    Parameters
    ----------
    path : str or Path
        protocol.toml.

    Returns
    -------
    Protocol
        Rates in rad/s.

    Raises
    ------
    InputError
        No such file.
    FileFormatError
        Not TOML, an unknown, missing or wrong entry, or what cannot be done; names the file.
    """
    held = read_toml(path, ProtocolFile)
    faces, rates, heat = held.faces, held.rates, held.temperatures
    dps = RADIAN_PER_DEGREE
    try:
        if rates is not None:  # said in deg/s, as the file has it
            rate_grid(rates.turn_rate_min_dps, rates.turn_rate_max_dps, rates.turn_rate_step_dps)
        made = Protocol(
            name=held.protocol.name,
            cutoff_hz=held.protocol.cutoff_hz,
            faces=() if faces is None else tuple(faces.order),
            face_s=DEFAULTS.face_s if faces is None else faces.seconds,
            temperatures_c=() if heat is None else tuple(heat.set_points_c),
            soak_c_per_min=DEFAULTS.soak_c_per_min if heat is None else heat.soak_c_per_min,
            turn_rate_min=0.0 if rates is None else rates.turn_rate_min_dps * dps,
            turn_rate_max=0.0 if rates is None else rates.turn_rate_max_dps * dps,
            turn_rate_step=0.0 if rates is None else rates.turn_rate_step_dps * dps,
            grid=DEFAULTS.grid if rates is None else rates.grid,
            axes=AXES if rates is None else tuple(rates.axes),
            order=DEFAULTS.order if rates is None else rates.order,
            seed=0 if rates is None else rates.seed,
            dwell_s=_dwell_s(rates),
            turn_rate_uncertainty=None
            if rates is None or rates.turn_rate_uncertainty_dps is None
            else rates.turn_rate_uncertainty_dps * dps,
            bracket_s=DEFAULTS.bracket_s if rates is None else rates.bracket_s,
            whole_turns=False if rates is None else rates.whole_turns,
            acceleration=DEFAULTS.acceleration if rates is None else rates.acceleration_dps2 * dps,
        )
    except InputError as error:
        raise FileFormatError(f"{path}: {error}") from error
    return made


def write_protocol(protocol: Protocol, path: str | Path) -> None:
    """Write a protocol; it reads back as it was, to the rounding of rad/s in deg/s.

    Parameters
    ----------
    protocol : Protocol
        What to do.
    path : str or Path
        Where to.

    Raises
    ------
    InputError
        The file cannot be written.
    """
    import json

    p, dps = protocol, RADIAN_PER_DEGREE
    lines = ["[protocol]", f"name = {json.dumps(p.name)}", f"cutoff_hz = {p.cutoff_hz!r}"]
    if p.faces:
        lines += ["", "[faces]", f"order = {json.dumps(list(p.faces))}", f"seconds = {p.face_s!r}"]
    if p.turn_rate_step > 0.0:
        lines += ["", "[rates]"]
        for name in ("turn_rate_min", "turn_rate_max", "turn_rate_step"):
            lines.append(f"{name}_dps = {round(getattr(p, name) / dps, 12)!r}")
        lines += [
            f'grid = "{p.grid}"',
            f"axes = {json.dumps(list(p.axes))}",
            f'order = "{p.order}"',
            f"seed = {p.seed}",
        ]
        lines += [] if p.dwell_s is None else [f"seconds = {p.dwell_s!r}"]
        if p.turn_rate_uncertainty is not None:
            lines.append(f"turn_rate_uncertainty_dps = {p.turn_rate_uncertainty / dps!r}")
        lines += [f"bracket_s = {p.bracket_s!r}", f"whole_turns = {json.dumps(p.whole_turns)}"]
        lines.append(f"acceleration_dps2 = {p.acceleration / dps!r}")
    if p.temperatures_c:
        lines += ["", "[temperatures]", f"set_points_c = {json.dumps(list(p.temperatures_c))}"]
        lines.append(f"soak_c_per_min = {p.soak_c_per_min!r}")
    write_whole(Path(path), "\n".join(lines) + "\n")


def _dwell_s(rates: RatesEntry | None) -> float | None:
    if rates is None:
        return DEFAULTS.dwell_s
    if rates.seconds is None and rates.turn_rate_uncertainty_dps is None:
        return DEFAULTS.dwell_s
    return rates.seconds
