"""sim: a device and a bench that do not exist, with forward equations of their own.

Nothing here is shared with the estimators: a wrong sign in one cannot hide in the other. ``rng`` is a required argument;
each effect draws from a stream of its own.
"""

from undrift.sim.device.device import SimulatedDevice, SimulatedThermometer, SimulatedTriad
from undrift.sim.device.random import Grade, TriadGrade, random_device
from undrift.sim.device.read import Reading, read
from undrift.sim.device.truth import largest_departure, nominal_calibration, true_calibration
from undrift.sim.motion.bench import BenchSettings, bench_motion
from undrift.sim.motion.library import draw_task
from undrift.sim.optics import OpticsSettings, see
from undrift.sim.session import Demo, SimulatedTrial, demo_session, simulate_session, simulate_trial

__all__ = [
    "BenchSettings",
    "Demo",
    "Grade",
    "OpticsSettings",
    "Reading",
    "SimulatedDevice",
    "SimulatedThermometer",
    "SimulatedTriad",
    "SimulatedTrial",
    "TriadGrade",
    "bench_motion",
    "demo_session",
    "draw_task",
    "largest_departure",
    "nominal_calibration",
    "random_device",
    "read",
    "see",
    "simulate_session",
    "simulate_trial",
    "true_calibration",
]
