"""Accelerometers updated by the rests of daily recordings: length of gravity in held-out rests, and coverage.

``python -m benchmarks.accel_in_use [--devices 64] [--days 10] [--seed 1]``. The three MPU-9150 sessions ($UNDRIFT_DATA), from a
data sheet: rests left out a direction at a time, and every second rest left out. Then simulated people with a device each, whose
accelerometers age, shift at each switch-on, creep by 1 mg (a first-order process of a minute, so noise is coloured), are rounded to
codes and follow the temperature: from a data sheet, and from a calibration that is half a year old. Truth is the device in a
switch-on to come.
"""

import argparse
import gzip
import os
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
from scipy.linalg import polar
from scipy.signal import lfilter

from benchmarks.erring_bench.learn import POOL, START, USE, drawn_device
from undrift.arrays import FloatArray
from undrift.calibration.norm import MG
from undrift.drift.accel_in_use import AccelUseFit, learn_accel, rest_forces, with_accel_in_use
from undrift.drift.learn import learn_drift
from undrift.model import Calibration, TriadModel
from undrift.record import Record, Session
from undrift.segments import StillSettings, find_still
from undrift.sim.daily_use import board_temperature, draw_day
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.simulate import simulate_device
from undrift.sim.device.truth import true_calibration
from undrift.sim.motion.motion import Motion

CREEP, CREEP_S = 1.0 * MG, 60.0  # of the readings at rest, m/s2, and its time constant, s
TURN_ON, AGEING = 0.5 * MG, 0.5 * MG  # from switch-on to switch-on, and in 30 days, m/s2
OLD = timedelta(days=180)
KNOWN = np.array(
    [1e-3] * 3 + [5e-4] * 3 + [1.0 * MG] * 3
)  # standard uncertainty of a fresh calibration: scale, across, offset
INSIDE = 1.96


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--devices", type=int, default=64)
    parser.add_argument("--days", type=int, default=10)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    for unit in range(3) if os.environ.get("UNDRIFT_DATA") else ():
        print(f"MPU-9150 unit {unit}: " + of_session(unit))
    rng = np.random.default_rng(given.seed)
    pool = [draw_day(rng, USE) for _ in range(POOL)]
    for name in ("data sheet", "calibration of half a year ago"):
        trials = list(devices(given.devices, given.days, name, rng, pool))
        changed = [trial for trial in trials if trial.fit.changed]
        print(f"{name}: {len(changed)} of {len(trials)} devices updated")
        for label, part in (("scale", slice(0, 3)), ("cross-axis", slice(3, 6)), ("offset", slice(6, 9))):
            error = np.array([trial.error[part] for trial in changed])
            sigma = np.array([np.sqrt(np.diag(trial.fit.covariance))[part] for trial in changed])
            inside = 100.0 * float(np.mean(np.abs(error) <= INSIDE * sigma))
            unit_of = MG if label == "offset" else 1e-3
            rmse, stated = (float(np.sqrt(np.mean(x**2))) / unit_of for x in (error, sigma))
            print(
                f"  {label:10} inside {inside:5.1f} %, rmse {rmse:6.3f}, stated {stated:6.3f} {'mg' * (unit_of == MG) or '1e-3'}"
            )
        before, after = (np.array([getattr(trial, side) for trial in changed]) / MG for side in ("before", "after"))
        grew = 100.0 * float(np.mean(after > before))
        medians = f"{np.median(before):.2f} to {np.median(after):.2f} mg"
        print(f"  a new day in all directions: median rms {medians}, worst {after.max():.2f} mg, grew in {grew:.1f} %")
        growth = max(0.0, float((after - before).max()))
        print(f"  largest growth {growth:.2f} mg; of the length in rests left out: " + held_out(changed))
    return 0


def held_out(trials: "list[Trial]") -> str:
    before, after = (np.median([trial.fit.held_out[k] for trial in trials]) / MG for k in (0, 1))
    return f"{before:.2f} to {after:.2f} mg"


# ---- real sessions


def of_session(unit: int) -> str:
    """Return what the rests of one MPU-9150 session show, held out in two ways."""
    with gzip.open(Path(os.environ["UNDRIFT_DATA"]) / "multipos_mpu9150" / f"imu{unit}.log.gz", "rt") as file:
        log = np.loadtxt(file)
    record = Record(time=np.arange(len(log)) / 100.0, accel=log[:, :3], gyro=log[:, 3:])
    stills = find_still(record, StillSettings(min_duration_s=2.0)).stills
    base = Calibration(device="", reference_temp_c=25.0, gravity_m_s2=9.81, accel=plain())  # as its publication has it
    course = [np.full(len(record), 25.0)]  # not recorded
    session = Session(kind="thermal", serial="", records=(record,), gravity_m_s2=9.81)

    def rests(some: object) -> object:
        chosen = tuple(still for k, still in enumerate(stills) if some is None or k % 2 == some)
        return rest_forces(session, chosen, np.zeros(len(chosen), bool), course, base)

    every = rests(None)
    fit = learn_accel(base, every, np.zeros(1))
    text = f"{len(fit.temp_c)} rests in {fit.directions} directions, changed {fit.changed}; a direction left out "
    text += f"{fit.held_out[0] / MG:.2f} to {fit.held_out[1] / MG:.2f} mg rms; every second rest left out"
    for number in (0, 1):
        half = learn_accel(base, rests(number), np.zeros(1))
        made = with_accel_in_use(base, replace(half, changed=True)).accel
        other = rests(1 - number).force
        after = np.linalg.norm((other - made.offset) @ made.matrix.T, axis=1) - 9.81
        before = np.linalg.norm(other, axis=1) - 9.81
        text += f" {rms(before) / MG:.2f} to {rms(after) / MG:.2f} mg" + (" refused" if not half.changed else "")
    return text


def plain() -> TriadModel:
    return TriadModel(
        method="nominal", unit_in="m/s2", unit_out="m/s2", matrix=np.eye(3), offset=np.zeros(3),
        covariance=np.zeros((12, 12)), rms_residual=0.0, count=1, rank=12, condition=1.0, valid_range=(-20.0, 20.0),
    )  # fmt: skip


def rms(x: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(x))))


# ---- simulated people


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Trial:
    """One device."""

    fit: AccelUseFit
    error: FloatArray  # (9,), of E and d in a switch-on to come
    before: float  # rms error of the length of gravity over all directions on a new day, m/s2
    after: float


def devices(count: int, days: int, kind: str, rng: np.random.Generator, pool: list[Motion]) -> Iterator[Trial]:
    """Yield devices after days of use."""
    for _ in range(count):
        device = drawn_device("mpu6050", rng, hysteresis=False)
        at_c = device.reference_temp_c - device.thermometer.trim_error_c - device.thermometer.self_heating_c
        sheet = kind == "data sheet"
        base = calibration_of(device, at_c, rng, sheet=sheet)
        age = (OLD.days if not sheet else 0) + np.zeros(3)
        aged = AGEING * np.sqrt(age / 30.0) * rng.standard_normal(3)
        sessions, dates = list[Session](), list[datetime]()
        for day in range(days):
            aged = aged + AGEING / 30.0**0.5 * rng.standard_normal(3)
            sessions.append(a_day(device, aged + TURN_ON * rng.standard_normal(3), rng, pool))
            dates.append(START + timedelta(days=day))
        fit = learn_drift(sessions, base, dates=dates).accel
        shifted = device.accel.shifted(aged + TURN_ON * rng.standard_normal(3))
        true = true_calibration(replace(device, accel=shifted), temp_c=at_c).accel
        away = away_from(base.accel, true)
        up = rng.standard_normal((500, 3))
        force = 9.80665 * up / np.linalg.norm(up, axis=1)[:, None]
        reading = true.offset + force @ np.linalg.inv(true.matrix).T
        made = with_accel_in_use(base, fit).accel
        errors = [rms(np.linalg.norm((reading - m.offset) @ m.matrix.T, axis=1) - 9.80665) for m in (base.accel, made)]
        yield Trial(fit=fit, error=fit.change[:9] - away, before=errors[0], after=errors[1])


def calibration_of(device: DeviceModel, at_c: float, rng: np.random.Generator, *, sheet: bool) -> Calibration:
    """Return a calibration of the gyroscopes as they are, with accelerometers by a data sheet or by a fit of some time ago."""
    true = true_calibration(device, temp_c=at_c)
    created = (START - (timedelta(0) if sheet else OLD)).isoformat()
    true = replace(true, reference_temp_c=device.reference_temp_c, provenance=replace(true.provenance, created=created))
    model = true.accel
    if sheet:
        gain = float(np.median(np.diag(model.matrix)))
        nominal = replace(model, matrix=np.eye(3) * round(gain, 12), offset=np.zeros(3), covariance=np.zeros((12, 12)))
        return replace(true, accel=nominal)
    drawn = KNOWN * rng.standard_normal(9)
    row, column = np.array([0, 1, 2, 0, 0, 1]), np.array([0, 1, 2, 1, 2, 2])
    error = np.zeros((3, 3))
    error[row, column] = error[column, row] = drawn[:6]
    back = np.linalg.inv(model.matrix)
    covariance = np.diag(
        [*(KNOWN[3] ** 2 * np.diag(model.matrix).mean() ** 2 for _ in range(9)), *(KNOWN[6:] * np.diag(back)) ** 2]
    )
    covariance[range(0, 9, 4), range(0, 9, 4)] = (KNOWN[:3] * np.diag(model.matrix)) ** 2
    # symmetric errors have half the variance of an element each in E: state twice that of a drawn one
    off = [1, 2, 3, 5, 6, 7]
    covariance[off, off] *= 2.0
    old = replace(
        model, matrix=(np.eye(3) + error) @ model.matrix, offset=model.offset + back @ drawn[6:], covariance=covariance
    )
    return replace(true, accel=old)


def a_day(device: DeviceModel, shift: FloatArray, rng: np.random.Generator, pool: list[Motion]) -> Session:
    """Return the recording of a day with a shift of the accelerometers, whose readings creep."""
    motion = pool[int(rng.integers(len(pool)))]
    turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))  # another way to put it down and to wear it
    motion = turned(motion, turn)
    today = replace(device, accel=device.accel.shifted(shift))
    made = simulate_device(today, motion, rng=rng, temp_c=board_temperature(motion, rng, USE)).record
    keep = np.exp(-1.0 / made.sample_rate_hz / CREEP_S)
    noise = rng.standard_normal((len(made), 3)) * CREEP * np.sqrt(1.0 - keep**2)
    noise[0] = CREEP * rng.standard_normal(3)
    true = true_calibration(device).accel
    raw = lfilter([1.0], [1.0, -keep], noise, axis=0) @ np.linalg.inv(true.matrix).T
    step = np.nanmin(np.where(np.diff(np.sort(made.accel[:, 0])) > 0, np.diff(np.sort(made.accel[:, 0])), np.nan))
    accel = np.round((made.accel + raw) / step) * step
    return Session(
        kind="thermal", serial=device.serial, gravity_m_s2=motion.gravity_m_s2, records=(replace(made, accel=accel),)
    )


def turned(motion: Motion, turn: FloatArray) -> Motion:
    """Return a motion of a device that is fixed in another way: vectors in its case turn."""
    names = ("rate_b", "mean_rate_b", "angular_acceleration_b", "force_b")
    from scipy.spatial.transform import Rotation

    q = Rotation.from_quat(motion.q_nb, scalar_first=True) * Rotation.from_matrix(turn.T)
    return replace(
        motion, q_nb=q.as_quat(scalar_first=True), **{name: getattr(motion, name) @ turn.T for name in names}
    )


def away_from(model: TriadModel, true: TriadModel) -> FloatArray:
    """Return E and d (9,) that make a model's readings those of the true one, but for a rotation."""
    symmetric = polar(true.matrix @ np.linalg.inv(model.matrix))[1]
    e = symmetric - np.eye(3)
    return np.concatenate((e[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]], model.matrix @ (true.offset - model.offset)))


if __name__ == "__main__":
    sys.exit(main())
