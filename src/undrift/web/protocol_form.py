"""Protocol form: protocol.toml as fields that a person fills in, with defaults, and the forecast of what they ask for.

The file is written as typed and read by undrift's own reader, so that the page says of a field what the command says of the file.
"""

import json
import math
import re
import tempfile
from dataclasses import dataclass
from pathlib import Path

from undrift.errors import InputError
from undrift.rig.programme import Forecast, ProgrammeSettings, forecast_of, programme_of, read_protocol
from undrift.rig.rig import Limits, check_programme, parse_address
from undrift.units import RADIAN_PER_DEGREE

LIMITS = Limits(turn_rate=360.0 * RADIAN_PER_DEGREE, acceleration=5000.0 * RADIAN_PER_DEGREE)  # of the command
FACES = ("+x", "-x", "+y", "-y", "+z", "-z")


@dataclass(slots=True, kw_only=True)
class ProtocolForm:
    """What was typed; numbers are text until they are read."""

    name: str = "rate table"
    cutoff_hz: str = "11.1"  # of the device's low-pass
    faces: tuple[str, ...] = FACES
    face_s: str = "6"
    axes: tuple[str, ...] = ("x", "y", "z")  # none leaves the rates out
    turn_rate_min_dps: str = "15"
    turn_rate_max_dps: str = "90"
    turn_rate_step_dps: str = "15"
    order: str = "alternating"  # or random
    dwell_s: str = "6"
    bracket_s: str = "6"
    acceleration_dps2: str = "2300"
    temperatures_c: str = ""  # "18, 30, 45"; none stays at room temperature
    soak_c_per_min: str = "0.1"

    def toml(self) -> str:
        """Return protocol.toml."""
        lines = ["[protocol]", f"name = {json.dumps(self.name)}", f"cutoff_hz = {_typed(self.cutoff_hz)}"]
        if self.faces:
            lines += ["", "[faces]", f"order = {json.dumps(list(self.faces))}", f"seconds = {_typed(self.face_s)}"]
        if self.axes:
            lines += ["", "[rates]", f"axes = {json.dumps(list(self.axes))}", f"order = {json.dumps(self.order)}"]
            for name in ("turn_rate_min_dps", "turn_rate_max_dps", "turn_rate_step_dps", "bracket_s"):
                lines.append(f"{name} = {_typed(getattr(self, name))}")
            lines += [f"seconds = {_typed(self.dwell_s)}", f"acceleration_dps2 = {_typed(self.acceleration_dps2)}"]
        if points := [part for part in re.split(r"[,;\s]+", self.temperatures_c.strip()) if part]:
            lines += ["", "[temperatures]", f"set_points_c = [{', '.join(map(_typed, points))}]"]
            lines.append(f"soak_c_per_min = {_typed(self.soak_c_per_min)}")
        return "\n".join(lines) + "\n"

    def check(self, rig: str) -> Forecast:
        """Return what it takes on a table; InputError says which field is wrong, and why."""
        return forecast_of_text(self.toml(), rig)


def forecast_of_text(text: str, rig: str, limits: Limits = LIMITS) -> Forecast:
    """Return what a protocol takes on a table, by what ``rig run`` says before it asks whether to start."""
    lines = parse_address(rig)[2].encoder_lines
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "protocol.toml"
        path.write_text(text, encoding="utf-8")
        try:
            programme = programme_of(read_protocol(path), ProgrammeSettings(encoder_lines=lines))
        except InputError as error:
            text = str(error).removeprefix(f"{path}: ")
            raise InputError(re.sub(r"^line \d+: ", "", text)) from error  # of a file that nobody sees
    check_programme(programme, limits, by_hand=rig.startswith("manual:"))
    return forecast_of(programme)


def _typed(text: str) -> str:
    """Return what was typed as a value of TOML: a number where it is one, else a text that the reader refuses by name."""
    text = text.strip().replace(",", ".")
    try:
        value = float(text)
    except ValueError:
        return json.dumps(text)
    return repr(value) if math.isfinite(value) else json.dumps(text)
