"""A library folder for the Arduino IDE: the C source of the correction, and a sketch that prints corrected readings.

::

    undrift_imu/library.properties, keywords.txt
    undrift_imu/src/undrift.h, undrift.c                   as for the target c, in float
    undrift_imu/examples/Corrected/Corrected.ino           for an MPU-6050 on I2C

The folder is copied into the folder "libraries" of the sketchbook. The sketch reads counts of an MPU-6050 at 250 deg/s and
2 g. It converts them to the unit of the calibration, and corrects them.
"""

from jinja2 import Environment, PackageLoader

from undrift import __version__
from undrift.errors import InputError
from undrift.export import Exported, ExportOptions
from undrift.export.c import export_c, utc_now
from undrift.model import Calibration
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

COUNTS_PER_DPS, COUNTS_PER_G = 131.0, 16384.0  # sensitivity of an MPU-6050 at 250 deg/s and 2 g (its data sheet)
UNITS = {
    "count": 1.0,
    "dps": 1.0 / COUNTS_PER_DPS,
    "rad/s": RADIAN_PER_DEGREE / COUNTS_PER_DPS,
    "g": 1.0 / COUNTS_PER_G,
    "m/s2": STANDARD_GRAVITY / COUNTS_PER_G,
}  # size of one count in the unit of a calibration


def write_arduino(calibration: Calibration, options: ExportOptions, name: str) -> Exported:
    """Return the files of the library by name in the folder."""
    header = f"{options.prefix}.h"
    exported = export_c(calibration, options, header_name=header, date=utc_now())
    gyro_unit = calibration.gyro.unit_in if calibration.gyro else "rad/s"
    accel_unit = calibration.accel.unit_in if calibration.accel else "m/s2"
    for unit in (gyro_unit, accel_unit):
        if unit not in UNITS:
            raise InputError(f"arduino: expected readings in {', '.join(UNITS)}, got {unit}. Use the target c.")
    environment = Environment(loader=PackageLoader("undrift", "export"), keep_trailing_newline=True)
    parts = {
        "name": name,
        "version": __version__,
        "device": " ".join((calibration.device or "a device").split()),
        "header": header,
        "prefix": options.prefix,
        "gyro_unit": gyro_unit,
        "accel_unit": accel_unit,
        "gyro_factor": f"{UNITS[gyro_unit]:.9g}",
        "accel_factor": f"{UNITS[accel_unit]:.9g}",
    }
    files = {
        "library.properties": environment.get_template("arduino.properties.j2").render(parts),
        "keywords.txt": f"{options.prefix}_correct\tKEYWORD2\n{options.prefix}_t\tKEYWORD1\n",
        f"src/{header}": exported.header,
        f"src/{options.prefix}.c": exported.source,
        "examples/Corrected/Corrected.ino": environment.get_template("arduino.ino.j2").render(parts),
    }
    return Exported(files=files, not_carried=exported.not_carried, notes=exported.notes)
