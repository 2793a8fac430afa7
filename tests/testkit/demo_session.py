"""A small complete example: a device, a session of it and a trial."""

from dataclasses import dataclass, replace

import numpy as np

from undrift.model import Calibration
from undrift.record import Session
from undrift.sim.device.effects import Thermometer
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.presets import grade_of, random_device
from undrift.sim.device.truth import nominal_calibration
from undrift.sim.motion.bench import BenchErrors, BenchSettings
from undrift.sim.motion.poses import OpticsSettings
from undrift.sim.sessions import SimulatedTrial, simulate_session, simulate_trial
from undrift.units import RADIAN_PER_DEGREE


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Demo:
    device: DeviceModel  # The truth
    nominal: Calibration  # from the data sheet only
    session: Session  # Six faces and rate-table steps
    trial: SimulatedTrial  # a sit-to-stand task with its reference


def demo_session(rng: np.random.Generator, *, quick: bool = False) -> Demo:
    """Return a small complete example: device, calibration session of three minutes, and a sit-to-stand task with
    optics.
    """
    lm335 = Thermometer(trim_error_c=0.8, lag_s=20.0, noise_c=0.03, step_c=5.0 / 4096 / 0.010)
    device = replace(random_device(rng, grade="consumer"), thermometer=lm335)
    rates = tuple(
        rate * RADIAN_PER_DEGREE for rate in ((45.0, 90.0) if quick else (15.0, 30.0, 45.0, 60.0, 75.0, 90.0))
    )
    settings = BenchSettings(
        errors=BenchErrors(face_tilt=0.1 * RADIAN_PER_DEGREE), turn_rates=rates, ramp_s=0.4, dwell_s=2.0
    )
    session = simulate_session("bench", device, rng=rng, settings=settings, temp_c=(24.8, 25.2))
    optics = OpticsSettings(delay_s=0.030)
    return Demo(
        device=device,
        nominal=nominal_calibration(grade_of("consumer")),
        session=session,
        trial=simulate_trial("sit_to_stand", device, rng=rng, optics=optics, temp_c=25.0),
    )
