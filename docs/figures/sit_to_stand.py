"""A person stands up and sits down: pitch by readings as the data sheet has them, and corrected with calibration and thermal tables.

The device is one of the simulator's consumer parts, calibrated on its own bench and chamber at 25 degC and worn 12.5 K warmer.
"""

import sys
from pathlib import Path

import numpy as np

import undrift
from undrift.orientation import OrientSettings, sagittal_pitch
from undrift.report.figures import DEVICE, ERROR, OPTICS, new_figure, save_figure
from undrift.sim.device.presets import preset, random_device
from undrift.sim.motion.tasks import draw_task
from undrift.sim.thermal import ThermalSettings
from undrift.study.figure3 import worn_record
from undrift.units import STANDARD_GRAVITY


def draw(folder: Path) -> None:
    """Draw it into a folder."""
    rng = np.random.default_rng(5)
    device = random_device(rng, grade="mpu6050")
    calibration = undrift.calibrate(undrift.simulate_session("bench", device, rng=rng))
    soaks = ThermalSettings(set_points_c=(18.0, 25.0, 32.0, 40.0, 32.0, 25.0, 18.0))
    fit = undrift.fit_drift([undrift.simulate_thermal_session("soak", device, rng=rng, settings=soaks)], calibration)
    task = draw_task("sit_to_stand", rng=rng)
    record = worn_record(device, task, rng=rng)
    sheet = {name: getattr(preset("mpu6050"), name).scale.nominal_sensitivity for name in ("gyro", "accel")}
    raw = undrift.Record(time=record.time, gyro=record.gyro / sheet["gyro"], accel=record.accel / sheet["accel"])
    corrected = undrift.correct(record, fit.calibration)
    truth = task.at(record.time, STANDARD_GRAVITY)
    figure, (axes,) = new_figure("trunk pitch (deg)", x="time (s)", height=2.7)
    true_deg = np.degrees(sagittal_pitch(truth.q_nb))
    axes.plot(record.time, true_deg, color=OPTICS, linewidth=3.0, alpha=0.35, label="truth")
    at_rest = OrientSettings(offset="rest")
    for name, one, settings, colour in (
        ("data sheet", raw, OrientSettings(), "#5c5c5c"),
        ("and rest offset", raw, at_rest, ERROR),
        ("calibrated, with tables", corrected, OrientSettings(), DEVICE),
    ):
        pitch_deg = np.degrees(undrift.orient(one, settings=settings).pitch)
        error_deg = np.abs(pitch_deg - true_deg)[-1]
        axes.plot(
            record.time, pitch_deg, color=colour, linewidth=1.4, label=f"{name}: {error_deg:.1f} deg off at the end"
        )
    axes.set(xlim=(0.0, record.time[-1]), ylim=(-40.0, 110.0))
    axes.legend(frameon=False, fontsize=8, loc="upper left")
    save_figure(figure, folder / "sit-to-stand.svg")


if __name__ == "__main__":
    draw(Path(sys.argv[1]))
