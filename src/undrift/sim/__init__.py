"""sim: a device and a bench that do not exist, with forward equations of their own.

Nothing here is shared with the estimators: a wrong sign in one cannot hide in the other. ``rng`` is a required argument;
each effect draws from a stream of its own.
"""

from undrift.sim.device.grade import Grade, TriadGrade
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.random import random_device
from undrift.sim.device.simulate import Simulated, simulate_device
from undrift.sim.device.truth import largest_departure, nominal_calibration, true_calibration
from undrift.sim.motion.bench import BenchSettings, bench_motion
from undrift.sim.motion.library import draw_task
from undrift.sim.motion.rivals import RivalSettings, rival_motion
from undrift.sim.motion.subject import Subject, cohort
from undrift.sim.optics import OpticsSettings, see
from undrift.sim.session import Demo, SimulatedTrial, demo_session, simulate_session, simulate_trial

__all__ = [
    "BenchSettings",
    "DeviceModel",
    "Demo",
    "Grade",
    "OpticsSettings",
    "RivalSettings",
    "Simulated",
    "SimulatedTrial",
    "Subject",
    "TriadGrade",
    "bench_motion",
    "cohort",
    "demo_session",
    "draw_task",
    "largest_departure",
    "nominal_calibration",
    "random_device",
    "rival_motion",
    "see",
    "simulate_device",
    "simulate_session",
    "simulate_trial",
    "true_calibration",
]
