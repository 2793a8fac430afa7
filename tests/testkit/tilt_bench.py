"""Devices calibrated on an imperfect bench and worn later: the tilt uncertainty of `orient`, and the true tilt.

Later the offset has moved with temperature (0 to 10 K, the device's own slopes) and age (0 to 12 months and a switch-on, drawn
here: 30 mm/s2 in a year and 0.5 mg); every second device has 10 bits over +-2 g. It lies in a free pose, and it is worn by a
person who stands, whose sway is that of the task ``posturography``. The forward model is the simulator's own.
"""

from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta

import numpy as np

from undrift.calibration.calibrate import calibrate
from undrift.correction.correct import correct_checked
from undrift.frames import quaternion_conjugate, rotate
from undrift.orientation import initial_tilt
from undrift.record import Session, Still
from undrift.sim.bench_errors import BenchErrors
from undrift.sim.device.effects import Adc, ThermalScale
from undrift.sim.device.presets import random_device
from undrift.sim.device.simulate import draw_streams, simulate_device
from undrift.sim.device.truth import true_calibration
from undrift.sim.motion.bench import BenchSettings, bench_motion
from undrift.sim.motion.motion import Script
from undrift.sim.motion.tasks import Subject, draw_task

DEG, G = np.pi / 180.0, 9.80665
HZ = 50.0
ROWS = {  # kind of session, standard deviation of a face off level about each horizontal axis, rad
    "level faces": ("six_face", 0.0),
    "faces tilted 0.3 deg": ("six_face", 0.3 * DEG),
    "by hand": ("ferraris", 0.5 * DEG),
    "free poses": ("multi_position", 0.0),
}
WORN = ("lying", "standing")


@dataclass(frozen=True)
class Seen:
    """One tilt, deg."""

    worn: str
    error: float
    scatter: float
    expanded: float


def drawn(row: str, rng: np.random.Generator, number: int) -> list[Seen]:
    """Draw one device, calibrate it, and take its tilt later, lying and worn."""
    kind, tilt_sd = ROWS[row]
    device = random_device(rng)
    accel = replace(device.accel, thermal_scale=ThermalScale(per_k=rng.normal(0.0, 2e-4, (1, 3))))
    if number % 2:
        accel = replace(accel, adc=Adc(bits=10, reference=2.0 * G * accel.gain, codes=False))
    device = replace(device, accel=accel)
    settings = BenchSettings(
        sample_rate_hz=HZ, errors=BenchErrors(face_tilt=tilt_sd, hand_axis=0.5 * DEG), poses=18, still_s=4.0
    )
    motion = bench_motion(kind, rng=rng, settings=settings)
    temp_c = np.linspace(24.5, 25.5, len(motion))
    record = replace(simulate_device(device, motion, rng=rng, temp_c=temp_c).record, gyro=None)
    session = Session(kind="calibration", serial=device.serial, gravity_m_s2=G, records=(record,), stills=motion.stills)
    made = calibrate(session)
    days, warmth = rng.uniform(0.0, 365.0), rng.uniform(-10.0, 10.0)
    when = (datetime.fromtimestamp(RECORDED_S, UTC) - timedelta(days=days)).isoformat()
    made = replace(made, provenance=replace(made.provenance, created=when))
    moved = rng.normal(0.0, np.hypot(5e-4 * G, 0.03 * np.sqrt(days / 365.25)), 3)
    offset = replace(device.accel.offset, constant=device.accel.offset.constant + moved)
    later = replace(device, accel=replace(device.accel, offset=offset))
    frame = np.eye(3)  # from the case to the axes of the fit
    if kind == "multi_position":  # z is the accelerometer's z, and y is in the plane of y and z
        turned, upper = np.linalg.qr(true_calibration(device, temp_c=25.0).accel.matrix)
        frame = (turned * np.sign(np.diag(upper))).T
    found = []
    for worn in WORN:
        course, still = _lying(rng) if worn == "lying" else _standing(rng)
        readings = replace(simulate_device(later, course, rng=rng, temp_c=25.0 + warmth).record, gyro=None)
        readings = replace(readings, time=RECORDED_S + np.asarray(readings.time))
        tilt = initial_tilt(correct_checked(readings, made).record, still)
        up = frame @ rotate(quaternion_conjugate(course.q_nb[still.stop - 1]), np.array([0.0, 0.0, 1.0]))
        force = tilt.specific_force / np.linalg.norm(tilt.specific_force)
        off = np.arctan2(np.linalg.norm(np.cross(force, up)), force @ up)
        found.append(
            Seen(worn, *(float(a) / DEG for a in (off, dict(tilt.parts)["scatter"], tilt.expanded_uncertainty)))
        )
    return found


RECORDED_S = 1.79e9  # When the later recordings begin, of a clock that counts from 1970


def _lying(rng):
    script = Script(HZ, rng.standard_normal(3))
    script.still(8.0)
    return script.motion(G, lever_arm_b=np.zeros(3), earth_rate_n=np.zeros(3)), Still(start=25, stop=375)


def _standing(rng):
    person = Subject(number=1, group="testing", age_years=28.0, height=1.73, habits=draw_streams(rng), category="young")
    task = draw_task("posturography", rng=rng, subject=person)
    stands_s = rng.uniform(3.0, 10.0)
    time = task.moving_s[0] + 5.0 + np.arange(round(stands_s * HZ)) / HZ
    return replace(task.at(time, G)), Still(start=0, stop=len(time))
