"""Error over temperature after days of use, against a chamber calibration of the same device.

``python -m benchmarks.learning [--devices 4] [--preset mpu6050] [--lag-s S] [--seed 1]`` draws devices with turn-on shifts and
ageing, calibrates each at one temperature and in a chamber (a ramp from 0 to 40 degC and back, in another switch-on), and learns
from simulated days of use. The error is the table's less the true offset of that day (the mean over switch-ons), rms over axes and
over the devices whose table reaches there.
"""

import argparse
import sys
from dataclasses import replace

import numpy as np

from benchmarks.erring_bench.learn import POOL, USE, calibrated, drawn_device, learnt, true_offset
from undrift.arrays import FloatArray
from undrift.drift.learn import LearnFit
from undrift.sim.daily_use import draw_day, simulate_daily_use
from undrift.sim.device.model import DeviceModel
from undrift.sim.thermal import RampSettings
from undrift.units import RADIAN_PER_DEGREE as DPS

AT_C = np.array([2.5, 7.5, 12.5, 17.5, 22.5, 27.5, 32.5, 37.5])
DAYS = (1, 10, 50)
CHAMBERS = {"no chamber": None, "chamber": RampSettings(low_c=0.0, high_c=40.0, hold_s=120.0)}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--devices", type=int, default=4)
    parser.add_argument("--preset", default="mpu6050", help="mpu6050 drifts in a straight line, enc03j_3031 in a curve")
    parser.add_argument(
        "--lag-s", type=float, help="of the thermometer; by default that of the preset, ten times shorter"
    )
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    rng = np.random.default_rng(given.seed)
    use = replace(USE, days=DAYS[-1])
    pool = [draw_day(rng, use) for _ in range(POOL)]
    errors: dict[str, list[FloatArray]] = {}
    for _ in range(given.devices):
        device = drawn_device(given.preset, rng, hysteresis=False)
        if given.lag_s is not None:
            device = replace(device, thermometer=replace(device.thermometer, lag_s=given.lag_s))
        days = list(simulate_daily_use(device, rng=rng, settings=use, motions=pool))
        models = {name: calibrated(device, rng, use, chamber=ramp) for name, ramp in CHAMBERS.items()}
        for name, model in models.items():
            before = 0
            for count in DAYS:
                fit = learnt(model, days[before:count])  # each time the days since
                model, before = fit.calibration, count
                aged = days[count - 1].aged
                for state, value in (("before", fit.before), ("learnt", fit.after)):
                    errors.setdefault(f"{name}, {state}, {count} days", []).append(error_at(device, fit, value, aged))
    print(f"{'rms error, deg/s, at degC':32}" + "".join(f"{temp:8.1f}" for temp in AT_C))
    for name, held in sorted(errors.items(), key=lambda item: (item[0].split(", ")[:2], int(item[0].split()[-2]))):
        square = np.square(held)
        seen = np.isfinite(square).sum(axis=(0, 2))
        rms = np.sqrt(np.nansum(square, axis=(0, 2)) / np.maximum(seen, 1))
        cells = [f"{value:8.4f}" if count else f"{'-':>8}" for value, count in zip(rms, seen, strict=True)]
        print(f"{name:32}" + "".join(cells))
    return 0


def error_at(device: DeviceModel, fit: LearnFit, value: FloatArray, aged: FloatArray) -> FloatArray:
    """Return the error at the temperatures of the table, (8, 3) deg/s; NaN beyond the nodes."""
    off = (value - true_offset(device, fit, aged)) / DPS
    return np.stack([np.interp(AT_C, fit.temp_c, column, left=np.nan, right=np.nan) for column in off.T], axis=1)


if __name__ == "__main__":
    sys.exit(main())
