"""Offsets over temperature of a simulated device: soaks up and down, the fitted table and its uncertainty."""

import sys
from pathlib import Path

import numpy as np

import undrift
from undrift.report.figures import save_figure
from undrift.sim.device.presets import random_device
from undrift.sim.thermal import ThermalSettings


def draw(folder: Path) -> None:
    """Draw it into a folder."""
    rng = np.random.default_rng(3)
    device = random_device(rng, grade="enc03j_3031")
    session = undrift.simulate_thermal_session(
        "soak",
        device,
        rng=rng,
        settings=ThermalSettings(set_points_c=(18.0, 30.0, 45.0, 60.0, 75.0, 60.0, 45.0, 30.0, 18.0)),
    )
    calibration = undrift.calibrate(undrift.simulate_session("bench", device, rng=rng))
    fit = undrift.fit_drift([session], calibration)
    save_figure(fit.plot(), folder / "drift-table.svg")


if __name__ == "__main__":
    draw(Path(sys.argv[1]))
