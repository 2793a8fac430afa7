"""A simulated rate table with its own log (another clock, coarse steps, gaps), and the device on it."""

import numpy as np

from undrift.record import Record

GAIN = np.diag([1.02, 0.97, 1.01]) + 0.005
OFFSET = np.array([1.5, -0.8, 0.4])  # dps
RATES = (10.0, -10.0, 35.0, -35.0, 60.0, -60.0)
SCALE = {"+x": 1.0, "+y": 1.1, "+z": 1.25}  # of the rates in each mounting, so that no two are alike
RAMP_S, DWELL_S, REST_S, MOUNT_S = 0.5, 5.0, 1.0, 12.0


def programme():
    """Corners of the true rate about the table's axis, s and dps, with the mounting of each dwell."""
    time, rate, dwells, now = [0.0], [0.0], [], 5.0
    for up, scale in SCALE.items():
        for nominal in RATES:
            value = nominal * scale
            time += [now, now + RAMP_S, now + RAMP_S + DWELL_S, now + 2 * RAMP_S + DWELL_S]
            rate += [0.0, value, value, 0.0]
            dwells.append((now + RAMP_S, now + RAMP_S + DWELL_S, up, value))
            now += 2 * RAMP_S + DWELL_S + REST_S
        now += MOUNT_S
    return np.array([*time, now]), np.array([*rate, 0.0]), dwells


def bench(
    folder, *, offset_s=1234.5, drift=2e-4, step_s=0.05, resolution_deg=0.01, gaps=0.0, column="angle_deg", seed=1
):
    """Write the log of the table, and return the recording of the device on it, the true dwells and the log's path."""
    rng = np.random.default_rng(seed)
    corner, rate, dwells = programme()
    true = np.arange(0.0, corner[-1], 0.01)
    ups = np.zeros((len(true), 3))
    for k, up in enumerate(SCALE):
        first = next(start for start, _, where, _ in dwells if where == up) - RAMP_S - 4.0
        ups[true >= first] = np.eye(3)["xyz".index(up[1])] if k >= 0 else 0.0
    ups[~ups.any(axis=1)] = np.eye(3)[0]
    turning = np.interp(true, corner, rate)
    gyro = (turning[:, None] * ups) @ GAIN.T + OFFSET + 0.05 * rng.normal(size=(len(true), 3))
    accel = 9.81 * ups + 0.01 * rng.normal(size=(len(true), 3))
    record = Record(time=true * (1.0 + drift) + offset_s, gyro=gyro, accel=accel, gyro_unit="dps", accel_unit="m/s2")
    at = np.arange(0.0, corner[-1], step_s)
    at = at[rng.random(len(at)) >= gaps]
    fine = np.linspace(0.0, corner[-1], 400_000)
    angle = np.interp(at, fine, np.concatenate(([0.0], np.cumsum(np.diff(fine) * np.interp(fine[1:], corner, rate)))))
    value = angle if column == "angle_deg" else np.interp(at, corner, rate)
    value = np.round(value / resolution_deg) * resolution_deg
    path = folder / "rates.csv"
    path.write_text(f"time_s,{column}\n" + "".join(f"{t:.6f},{v:.6f}\n" for t, v in zip(at, value, strict=True)))
    return record, dwells, path
