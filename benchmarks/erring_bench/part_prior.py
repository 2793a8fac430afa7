"""The note's gyroscope on a rate table whose room warms: a thermometer with steps and lag, the prior of the part or the default.

Units of the ENC-03J are drawn from its preset: 0.4 %/K at the limit, an LM335 that follows with 80 s and warms itself by 0.6 K. The
scale factor is compared with the unit's own where the settled thermometer reads the calibration's reference temperature. With
``default`` the session states nothing, so that the prior is that of consumer parts on whose die the thermometer is.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from benchmarks.erring_bench import Row, Tally
from benchmarks.erring_bench.rate_table import USUAL
from undrift.calibration.calibrate import calibrate
from undrift.record import TemperatureSensitivity
from undrift.sim.device.effects import TRIM_TEMP_C
from undrift.sim.device.presets import random_device_of
from undrift.sim.sessions import simulate_session
from undrift.study.figure3 import BENCH, on_the_clock

KIND = "enc03j_3031"
# Of the board over the 160 s of the session, degC, time since power-on, s, and noise of the thermometer, K
CASES: dict[str, tuple[float | tuple[float, float], float, float]] = {
    "settled": (25.0, 3600.0, 0.05),
    "settled, steps without noise": (25.0, 3600.0, 0.0),
    "warms by 0.1 K": ((25.0, 25.1), 3600.0, 0.05),
    "warms by 0.5 K": ((25.0, 25.5), 3600.0, 0.05),
    "warms by 2 K": ((25.0, 27.0), 3600.0, 0.05),
    "from power-on": (25.0, 0.0, 0.05),
}


def rows(devices: int, seed: int) -> Iterator[Row]:
    """Yield the scale factors of each case with the prior of the part, and with the default."""
    for name in CASES:
        tallies = Tally("rate table, prior of part", name), Tally("rate table, default prior", name)
        for number in range(devices):
            for tally, default in zip(tallies, (False, True), strict=True):
                _add(tally, name, np.random.default_rng([seed, number]), default=default)
        for tally in tallies:
            yield from tally.rows()


def _add(tally: Tally, name: str, rng: np.random.Generator, *, default: bool) -> None:
    temp_c, power_on_s, noise_c = CASES[name]
    unit = on_the_clock(random_device_of(KIND, rng))
    unit = replace(unit, thermometer=replace(unit.thermometer, noise_c=noise_c))
    bench = replace(BENCH, errors=USUAL)
    session = simulate_session("bench", unit, rng=rng, settings=bench, temp_c=temp_c, power_on_s=power_on_s)
    made = calibrate(replace(session, sensitivity=TemperatureSensitivity()) if default else session)
    meter, chain = unit.thermometer, unit.gyro
    assert made.gyro is not None
    assert chain.thermal_scale is not None
    felt_c = (made.reference_temp_c - meter.trim_error_c + meter.slope_error * TRIM_TEMP_C) / (1.0 + meter.slope_error)
    factor = chain.thermal_scale.factor(felt_c - meter.self_heating_c - unit.reference_temp_c)
    true = np.diag(np.linalg.inv(factor[:, None] * chain.forward_matrix))
    sigma = np.sqrt(np.diag(made.gyro.covariance)[[0, 4, 8]])
    tally.add(made.verdict, scale=(np.diag(made.gyro.matrix) / true - 1.0, sigma / true))
