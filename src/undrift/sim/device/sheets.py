"""Data sheets: figures of devices in the units of data sheets, one row a triad, each with a tag that says how far to trust it.

note: the 2007 technical note; found: read in a public source; calc: computed from such; known: recalled; known-low: recalled with
doubt; assumed: a choice. A tolerance is the bound of the units' spread, two standard deviations.
"""

from dataclasses import dataclass
from typing import NamedTuple


class GyroSheet(NamedTuple):
    """Gyroscopes, a unit behind each name: deg/s, deg/s/K, %, %/K, % of range, deg/s/sqrt(Hz), deg/h, deg/s/g."""

    range_dps: float
    counts_per_dps: float
    offset_dps: float
    offset_dps_per_k: float
    scale_percent: float
    scale_percent_per_k: float
    nonlinearity_percent: float
    cross_percent: float
    noise_dps_per_sqrt_hz: float
    instability_deg_per_h: float
    g_dps_per_g: float
    tag: str


class AccelSheet(NamedTuple):
    """Accelerometers, a unit behind each name: g, counts per g, mg, mg/K, %, %/K, % of range, micro-g/sqrt(Hz), mg."""

    range_g: float
    counts_per_g: float
    offset_mg: float
    offset_mg_per_k: float
    scale_percent: float
    scale_percent_per_k: float
    nonlinearity_percent: float
    cross_percent: float
    noise_ug_per_sqrt_hz: float
    instability_mg: float
    tag: str


@dataclass(frozen=True, slots=True)
class Sheet:
    """A device with digital outputs of 16 bits; counts per unit of 0 stand for readings in rad/s and m/s2.

    Parameters
    ----------
    name : str
        Name of the preset.
    gyro : GyroSheet
        Gyroscopes.
    accel : AccelSheet
        Accelerometers.
    """

    name: str
    gyro: GyroSheet
    accel: AccelSheet


# Ranges and counts are the common setting of each part [known]; instabilities of accelerometers are [assumed] throughout.
SHEETS = (
    Sheet(
        "mpu6050",
        GyroSheet(
            2000.0, 16.4, 20.0, 0.05, 3.0, 0.03, 0.2, 2.0, 0.005, 8.0, 0.1, "found; offset drift assumed, in-run known"
        ),
        AccelSheet(
            8.0,
            4096.0,
            50.0,
            0.8,
            3.0,
            0.02,
            0.5,
            2.0,
            400.0,
            0.05,
            "found; z-axis figures of offset and drift left out",
        ),
    ),
    Sheet(
        "icm20948",
        GyroSheet(2000.0, 16.4, 5.0, 0.05, 1.5, 0.05, 0.1, 2.0, 0.015, 8.0, 0.1, "known"),
        AccelSheet(8.0, 4096.0, 25.0, 0.8, 0.5, 0.026, 0.5, 2.0, 230.0, 0.05, "found"),
    ),
    Sheet(
        "bmi160",
        GyroSheet(2000.0, 16.4, 3.0, 0.05, 3.0, 0.02, 0.1, 2.0, 0.007, 6.0, 0.1, "known; noise found"),
        AccelSheet(8.0, 4096.0, 40.0, 1.0, 3.0, 0.03, 0.5, 1.0, 180.0, 0.04, "known"),
    ),
    Sheet(
        "bmi270",
        GyroSheet(2000.0, 16.4, 0.5, 0.02, 0.4, 0.02, 0.05, 0.2, 0.007, 5.0, 0.1, "known; offset and noise found"),
        AccelSheet(8.0, 4096.0, 20.0, 0.25, 0.4, 0.004, 0.5, 0.2, 160.0, 0.04, "known; noise found"),
    ),
    Sheet(
        "bmi088",
        GyroSheet(2000.0, 16.384, 1.0, 0.015, 1.0, 0.03, 0.05, 1.0, 0.014, 2.0, 0.1, "known"),
        AccelSheet(6.0, 5460.0, 20.0, 0.2, 1.0, 0.002, 0.5, 0.5, 160.0, 0.03, "known"),
    ),
    Sheet(
        "lsm6dso",
        GyroSheet(2000.0, 1.0 / 0.07, 1.0, 0.01, 1.0, 0.007, 0.1, 1.0, 0.0038, 3.0, 0.1, "known"),
        AccelSheet(8.0, 1.0 / 0.000244, 20.0, 0.1, 1.0, 0.01, 0.5, 1.0, 70.0, 0.03, "known"),
    ),
    Sheet(
        "xsens_mti1",
        GyroSheet(
            2000.0,
            0.0,
            0.1,
            0.003,
            0.1,
            0.003,
            0.1,
            0.1,
            0.007,
            10.0,
            0.001,
            "found; residual offset and drift assumed",
        ),
        AccelSheet(16.0, 0.0, 2.0, 0.03, 0.1, 0.002, 0.5, 0.1, 120.0, 0.03, "found; residual offset and drift assumed"),
    ),
    Sheet(
        "shimmer3",
        GyroSheet(500.0, 65.5, 20.0, 0.05, 3.0, 0.03, 0.2, 2.0, 0.005, 8.0, 0.1, "known"),
        AccelSheet(2.0, 815.0, 50.0, 0.7, 3.0, 0.01, 0.5, 2.0, 125.0, 0.05, "known-low"),
    ),
)
