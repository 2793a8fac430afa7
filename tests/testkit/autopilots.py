"""PX4 and ArduPilot parameter files read back, as the firmware evaluates them: oracles of what ``undrift export`` writes."""

import re
from dataclasses import dataclass

import numpy as np

from undrift.export.autopilots import Cubic

NOTHING = np.full(3, np.nan)


@dataclass(frozen=True)
class Imported:
    """What an autopilot's parameters hold of one inertial sensor: None where they have none."""

    gyro: Cubic | None
    accel: Cubic | None
    accel_gain: np.ndarray


def read_parameters(text: str) -> dict[str, float]:
    """Return the parameters in a file of QGroundControl (five columns) or ArduPilot (two), each once."""
    rows = [re.split(r"[\s,]+", line.split("#")[0].strip()) for line in text.splitlines()]
    pairs = [row[2:4] if len(row) == 5 else row for row in rows if row != [""]]
    assert all(len(pair) == 2 for pair in pairs)
    found = {name: float(value) for name, value in pairs}
    assert len(found) == len(pairs)
    assert np.isfinite(list(found.values())).all()
    return found


def import_ardupilot(text: str, *, sensor: int = 0) -> Imported:
    """Return what ArduPilot makes of one inertial sensor."""
    found, n, number = read_parameters(text), sensor + 1, "" if sensor == 0 else str(sensor + 1)

    def cubic(group: str) -> Cubic | None:
        offset = np.array([found.get(f"INS_{group}{number}OFFS_{axis}", np.nan) for axis in "XYZ"])
        powers = np.zeros((4, 3))
        if found.get(f"INS_TCAL{n}_ENABLE", 0.0) != 1.0:
            powers[0] = offset
            made = Cubic(reference_c=35.0, coefficients=powers, low_c=35.0, high_c=35.0, misfit=NOTHING)
            return None if np.isnan(offset).any() else made
        for power in (1, 2, 3):
            powers[power] = [found[f"INS_TCAL{n}_{group}{power}_{axis}"] * 1e-6 for axis in "XYZ"]
        low, high = found[f"INS_TCAL{n}_TMIN"], found[f"INS_TCAL{n}_TMAX"]
        assert low < high
        bare = Cubic(reference_c=35.0, coefficients=powers, low_c=low, high_c=high, misfit=NOTHING)
        powers[0] = offset - bare.at(np.array([found[f"INS_{group}{n}_CALTEMP"]]))[0]
        return Cubic(reference_c=35.0, coefficients=powers, low_c=low, high_c=high, misfit=NOTHING)

    gain = np.array([found.get(f"INS_ACC{number}SCAL_{axis}", 1.0) for axis in "XYZ"])
    return Imported(cubic("GYR"), cubic("ACC"), gain)


def import_px4(text: str, *, sensor: int = 0) -> Imported:
    """Return what PX4 makes of one inertial sensor."""
    found = read_parameters(text)

    def cubic(letter: str, group: str) -> Cubic | None:
        names = [f"CAL_{group}{sensor}_{axis}OFF" for axis in "XYZ"]
        powers, prefix = np.zeros((4, 3)), f"TC_{letter}{sensor}"
        reference, low, high = 25.0, 25.0, 25.0
        if found.get(f"TC_{letter}_ENABLE", 0.0) == 1.0 and f"{prefix}_X0_0" in found:
            powers[:] = [[found[f"{prefix}_X{power}_{axis}"] for axis in range(3)] for power in range(4)]
            reference, low, high = (found[f"{prefix}_{name}"] for name in ("TREF", "TMIN", "TMAX"))
        elif names[0] not in found:
            return None
        powers[0] += [found.get(name, 0.0) for name in names]
        return Cubic(reference_c=reference, coefficients=powers, low_c=low, high_c=high, misfit=NOTHING)

    gain = np.array([found.get(f"CAL_ACC{sensor}_{axis}SCALE", 1.0) for axis in "XYZ"])
    return Imported(cubic("G", "GYRO"), cubic("A", "ACC"), gain)
