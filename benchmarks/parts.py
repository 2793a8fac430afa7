"""What to expect of a part, from its preset: writes docs/parts.md.

``python -m benchmarks.parts [KIND ...] [--devices 20] [--measured]`` lets simulated people stand up and sit down for 15 minutes
with simulated devices, and compares the pitch of the gyroscopes with the true pitch, without correction and after short
calibrations. The board is 10 to 15 K warmer than the room. docs/parts/ has measured parts; ``--measured`` writes only their table.
"""

import argparse
import sys
import tomllib
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np

from undrift.arrays import FloatArray
from undrift.base.workers import executor
from undrift.correction.correct import correct_checked
from undrift.frames import (
    integrate_strapdown,
    quaternion_conjugate,
    quaternion_product,
    rotate,
    rotation_vector,
    signed,
)
from undrift.orientation import sagittal_pitch, shortest_rotation_up
from undrift.sim.device.presets import PRESETS
from undrift.sim.device.simulate import simulate_device
from undrift.sim.motion.motion import Motion
from undrift.sim.motion.tasks import Task
from undrift.study.case import WORN_S, stream
from undrift.study.methods import fit_rival
from undrift.study.plan import Study, StudyTask
from undrift.study.run import StudyDevice, perform
from undrift.study.sessions import ROOM_TEMP_C, SESSIONS
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

PAGE = Path(__file__).parents[1] / "docs" / "parts.md"
MEASURED = PAGE.with_suffix("")  # a file for each measured part
RATE_HZ, REST_S, TIMES_S = 100.0, 10.0, (60.0, 900.0)
TURNS_OF = "hand", "hand, warm"
COLUMNS = "raw", "rest offset", "by hand", "by hand, warm"


def repeated(task: Task) -> Motion:
    """Return a rest, and then the task forward and backward until the last of the times."""
    time = np.arange(round((REST_S + TIMES_S[-1]) * RATE_HZ) + 1) / RATE_HZ
    start, stop = task.moving_s
    phase = np.pi * np.maximum(time - REST_S, 0.0) / (stop - start)
    place = start + 0.5 * (stop - start) * (1.0 - np.cos(phase))
    speed = np.where(time < REST_S, 0.0, 0.5 * np.pi * np.sin(phase))
    once = task.at(np.arange(start, stop + 1e-3, 1e-3), STANDARD_GRAVITY)
    q = np.stack([np.interp(place, once.time, column) for column in signed(once.q_nb).T], axis=1)
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    rate = np.stack([np.interp(place, once.time, column) for column in once.rate_b.T], axis=1) * speed[:, None]
    step = np.zeros_like(rate)
    step[1:] = rotation_vector(quaternion_product(quaternion_conjugate(q[:-1]), q[1:])) * RATE_HZ
    force = rotate(quaternion_conjugate(q), np.array([0.0, 0.0, STANDARD_GRAVITY]))
    return Motion(
        time=time, q_nb=q, rate_b=rate, mean_rate_b=step, angular_acceleration_b=np.gradient(rate, time, axis=0),
        force_b=force, gravity_m_s2=STANDARD_GRAVITY, moving=(time >= REST_S).astype(float),
    )  # fmt: skip


def errors_of(study: Study, number: int) -> FloatArray:
    """Return the largest pitch error of the last ten seconds before each time, deg, for each column: (T, C)."""
    device = StudyDevice(study, number)
    (task,) = perform(study, study.tasks[0], number)
    assert isinstance(task, Task)
    motion, rng = repeated(task), stream(study.seed, "parts", number)
    record = simulate_device(device.worn, motion, rng=rng, temp_c=ROOM_TEMP_C + device.rise_k, power_on_s=WORN_S).record
    sheet = fit_rival("data sheet", device)
    own = [device.calibration(SESSIONS[name]) for name in TURNS_OF]
    errors = np.full((len(TIMES_S), len(COLUMNS)), np.nan)
    rest = slice(0, round(REST_S * RATE_HZ) - 1)
    for column, (calibration, of_rest) in enumerate(zip((sheet, sheet, *own), (False, True, True, True), strict=True)):
        if calibration is None:
            continue
        corrected = correct_checked(record, calibration, policy="hold", threads=1, check=False).record
        rates, force = np.asarray(corrected.gyro), np.asarray(corrected.accel)
        if of_rest:
            rates = rates - rates[rest].mean(axis=0)
        start = shortest_rotation_up(force[rest].mean(axis=0))
        pitch = sagittal_pitch(integrate_strapdown(rates[rest.stop :], record.time[rest.stop :], start))
        error = np.abs((pitch - sagittal_pitch(motion.q_nb)[rest.stop :] + np.pi) % (2.0 * np.pi) - np.pi)
        for row, end in enumerate(TIMES_S):
            last = slice(round((end - 10.0) * RATE_HZ), round(end * RATE_HZ))
            errors[row, column] = np.nanmax(error[last]) / RADIAN_PER_DEGREE
    return errors


def shown(error: float) -> str:
    """Return an error with two digits, or whole degrees."""
    return f"{error:.0f}" if error >= 10.0 else f"{error:.2g}"


def rows_of(kind: str, devices: int) -> Iterator[str]:
    """Yield the row of a preset: median and, in brackets, the error that 95 % of the devices stay below."""
    study = Study(name=kind, device=kind, tasks=(StudyTask(name="sit_to_stand"),), shipped=True)
    with executor() as spread:
        errors = np.array([*spread(partial(errors_of, study), range(devices))])
    cells = [
        "–" if np.isnan(values).any() else f"{shown(np.median(values))} ({shown(np.quantile(values, 0.95))})"
        for values in errors.reshape(devices, -1).T
    ]
    yield f"| {kind} | {' | '.join(cells)} |"


HEAD = """# What to expect of a part

The table shows the pitch error of the gyroscopes without a filter, after one minute and after 15 minutes.
In the simulation, {devices} people stand up and sit down all the time.
Each person wears a different device, 10 to 15 K above room temperature.
Each cell contains the median error in deg, and in brackets the error that 95 % of the devices do not exceed.

- **raw**: only the gains of the data sheet are used.
- **rest offset**: the offset from a rest of ten seconds is subtracted.
- **by hand**: also calibrated once with six faces and three turns by hand, at room temperature.
- **by hand, warm**: the same calibration, made at the temperature at which the device is worn.

| part | {columns} |
| --- |{rules}
"""
TAIL = """
A dash means that some devices could not be calibrated.
The [device model](device-model.md) gives the source of each number.
For an orientation that does not drift, use `undrift orient --method vqf`, which needs accelerometers during the motion.
"""
MEASURED_HEAD = """
## Measured parts

The table shows the mean angle in deg between the gyroscope orientation and the true orientation at the end of real recordings.
"By motion" and "by optics" are calibrations from other recordings of the same device.
To add a part, copy the form below, replace every value, and open an issue with it.

| part | devices | recordings | length | motion | raw | rest offset | by hand | by motion | by optics | source |
| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |
"""
KINDS_OF_ERROR = "raw", "rest_offset", "by_hand", "by_motion", "by_optics"


def measured() -> str:
    """Return the table of measured parts."""
    lines = []
    for path in sorted(MEASURED.glob("*.toml")):
        part = tomllib.loads(path.read_text(encoding="utf-8"))
        errors = [f"{part['error_deg'][kind]:.3g}" if kind in part["error_deg"] else "–" for kind in KINDS_OF_ERROR]
        cells = [f"{part[key]}" for key in ("part", "devices", "recordings")]
        cells += [f"{part['seconds']:g} s", part["motion"]]
        lines.append(f"| {' | '.join([*cells, *errors, part['source']])} |\n")
    form = (MEASURED / "broad.toml").read_text(encoding="utf-8")
    return f"{MEASURED_HEAD}{''.join(lines)}\n```toml\n{form}```\n"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kinds", nargs="*", default=[*PRESETS])
    parser.add_argument("--devices", type=int, default=20)
    parser.add_argument("--measured", action="store_true", help="only the table of measured parts")
    given = parser.parse_args()
    if given.measured:
        PAGE.write_text(PAGE.read_text().partition(MEASURED_HEAD[:20])[0] + measured())
        return 0
    columns = " | ".join(f"{column}, {end / 60.0:g} min" for end in TIMES_S for column in COLUMNS)
    page = HEAD.format(devices=given.devices, columns=columns, rules=" --- |" * 8)
    for kind in given.kinds:
        for row in rows_of(kind, given.devices):
            print(row, flush=True)
            page += row + "\n"
    PAGE.write_text(page + TAIL + measured())
    return 0


if __name__ == "__main__":
    sys.exit(main())
