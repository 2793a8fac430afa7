"""The temperature of a recording from a separate file with its own rate, interpolated onto the samples and constant
beyond the ends.
"""

from dataclasses import replace

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError
from undrift.io.columns import TempFile, in_seconds, naming
from undrift.io.text import open_text, parse_text
from undrift.record import Record
from undrift.units import canonical_unit, si_factor, temp_offset


def with_temperature(record: Record, time: FloatArray, temp_c: FloatArray) -> Record:
    """Return a record with temperatures (M,), degC, at times (M,), s, interpolated onto its samples and constant beyond
    the ends.
    """
    finite = np.isfinite(time) & np.isfinite(temp_c)
    if not finite.any():
        raise InputError("temperature: expected one reading or more, got none. Omit the temperature file.")
    order = np.argsort(time[finite], kind="stable")
    return replace(record, temp_c=np.interp(record.time, time[finite][order], temp_c[finite][order]))


def with_thermometer(record: Record, thermometer: TempFile) -> Record:
    """Return the record with the temperature of a thermometer's own file."""
    dated = canonical_unit(thermometer.time_unit, "time") == "date"
    wanted = (thermometer.temp,) if dated else (thermometer.time, thermometer.temp)
    table = parse_text(open_text(thermometer.path, thermometer.layout), wanted)
    table = in_seconds(table, thermometer.time) if dated else table
    time = table.numbers(thermometer.time) * si_factor(thermometer.time_unit, "time") + thermometer.shift_s
    unit = canonical_unit(thermometer.temp_unit, "temp")
    temp_c = table.numbers(thermometer.temp) * si_factor(unit, "temp") + temp_offset(unit)
    valid_time = time[np.isfinite(time) & np.isfinite(temp_c)]
    if len(valid_time) and (valid_time.max() < record.time[0] or valid_time.min() > record.time[-1]):
        raise InputError(
            f"{thermometer.path}: expected temperatures from {record.time[0]:.6g} to {record.time[-1]:.6g} s, the "
            f"recording's clock, "
            f"got {valid_time.min():.6g} to {valid_time.max():.6g} s. Set temp_file.shift_s, in s."
        )
    with naming(thermometer.path):
        return with_temperature(record, time, temp_c)
