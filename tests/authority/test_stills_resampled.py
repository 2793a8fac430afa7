"""The same poses are found at 25, 50 and 100 Hz and with ten times the noise: three MPU-9150, an Xsens MTi, a bicycle's MPU-6050.

The poses of a session are those found in it as recorded; neighbours that point alike within 5 deg are one. A pose is found again
where a still overlaps it in time and points the same way within 3 deg. A still without such a pose is extra. Readings are averaged
over each step, or one in each step is picked, which keeps the noise of a sample. The noise at rest is measured in the quietest
twentieth of the seconds, and white noise is added that makes it ten times as large.
"""

from dataclasses import replace

import numpy as np
import pytest

from testkit.data import data_path, show
from testkit.faces import still_means
from testkit.recordings import bicycle, mpu9150
from undrift.record import Record
from undrift.segments import find_poses, sphere_of

SESSIONS = {"mpu9150-0": 100, "mpu9150-1": 100, "mpu9150-2": 100, "xsens": 100, "bicycle": 200}
SAME_DEG, AGAIN_DEG = 5.0, 3.0


def read(name):
    if name.startswith("mpu9150"):
        return [mpu9150(int(name[-1]))]
    if name == "xsens":
        parts = [np.loadtxt(data_path("multipos_xsens", f"xsens_{what}.txt.gz")) for what in ("acc", "gyro")]
        time = np.arange(len(parts[0])) / 100.0
        return [Record(time=time, accel=parts[0][:, 1:], gyro=parts[1][:, 1:], accel_unit="count", gyro_unit="count")]
    return [replace(record, time=np.arange(len(record)) / 200.0) for record in bicycle()]


def rest_noise(values, size=100):
    steps = np.diff(values, axis=0)
    level = np.array([steps[k : k + size].std(axis=0) for k in range(0, len(steps) - size, size)])
    return np.quantile(level, 0.05, axis=0) / np.sqrt(2.0)


def changed(record, step, how, times, rng):
    count = len(record) // step * step
    result = {}
    for name in ("gyro", "accel"):
        parts = getattr(record, name)[:count].reshape(-1, step, 3)
        values = parts[:, 0] if how == "pick" else parts.mean(axis=1)
        result[name] = values + rng.standard_normal(values.shape) * rest_noise(values) * np.sqrt(times**2 - 1.0)
    return Record(
        time=np.arange(count // step) * step / record.sample_rate_hz,
        gyro_unit=record.gyro_unit,
        accel_unit=record.accel_unit,
        **result,
    )


def poses_of(records, centre):
    """Return [recording, start s, stop s, direction] of each pose."""
    results = []
    for number, (record, search) in enumerate(zip(records, find_poses(records), strict=True)):
        for still, mean in zip(search.stills, still_means(record.accel, search.stills), strict=True):
            up = (mean - centre) / np.linalg.norm(mean - centre)
            span = [record.time[still.start], record.time[still.stop - 1]]
            if results and results[-1][0] == number and results[-1][3] @ up > np.cos(np.radians(SAME_DEG)):
                results[-1][2] = span[1]
            else:
                results.append([number, *span, up])
    return results


def alike(a, b):
    return a[0] == b[0] and a[1] < b[2] and b[1] < a[2] and a[3] @ b[3] > np.cos(np.radians(AGAIN_DEG))


@pytest.mark.parametrize("name", SESSIONS)
def test_same_poses_are_found_at_other_rates_and_noise(name):
    records, rng = read(name), np.random.default_rng(5)
    centre = np.zeros(3)
    if records[0].accel_unit == "count":
        stills = find_poses(records)
        centre = sphere_of(
            np.concatenate([still_means(r.accel, s.stills) for r, s in zip(records, stills, strict=True)])
        )[0]
    truth = poses_of(records, centre)
    assert len(truth) >= 11
    worst = [0, 0]
    for rate_hz in (100, 50, 25):
        step = SESSIONS[name] // rate_hz
        for how in ("mean", "pick") if step > 1 else ("all",):
            for times in (1, 10):
                held = poses_of([changed(record, step, how, times, rng) for record in records], centre)
                missed = sum(not any(alike(pose, other) for other in held) for pose in truth)
                extra = sum(not any(alike(pose, other) for other in truth) for pose in held)
                show(
                    f"{name:9} {rate_hz:3} Hz, {how:4}, noise x{times:<2}: poses {len(truth)}, found {len(truth) - missed}, extra",
                    extra,
                    1,
                )
                worst = [max(worst[0], missed), max(worst[1], extra)]
    show(f"{name}: most missed, most extra", worst, "1, 1")
    assert max(worst) <= 1
