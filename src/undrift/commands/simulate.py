"""``undrift simulate``: simulate the readings of a device in recorded poses or in a task."""

from pathlib import Path
from typing import get_args

import numpy as np

from undrift.arrays import FloatArray
from undrift.base.options import Flag, Output, Up
from undrift.commands.files import labels_of
from undrift.errors import InputError
from undrift.io.formats import read_reference, write_record
from undrift.io.reference import write_reference
from undrift.record import Reference
from undrift.report import Report, Table
from undrift.report.figures import draw_record
from undrift.screen import progress
from undrift.sim.device.model import DeviceModel, read_device, write_device
from undrift.sim.device.presets import PRESETS, preset, random_device
from undrift.sim.device.simulate import Simulated, simulate_device
from undrift.sim.motion.motion import Motion
from undrift.sim.motion.poses import fit_pose_spline
from undrift.sim.motion.tasks import TaskName, draw_task
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY


def simulate(
    motion: str,
    /,
    *,
    device: str,
    output: Output,
    draw: Flag = False,
    sample_rate_hz: float = 100.0,
    temp_c: float | None = None,
    markers: str | None = None,
    reference_up: Up = None,
    truth: Path | None = None,
    save_device: Path | None = None,
    seed: int = 0,
) -> Report:
    """Simulate the readings of a device in a motion.

    Parameters
    ----------
    motion : str
        A file of poses or markers, or a task: sit_to_stand, step, posturography, free.
    device : str
        A preset (enc03j_3031, mpu6050, icm20948, bmi160, bmi270, bmi088, lsm6dso, xsens_mti1, shimmer3) or a device.json.
    output : Path
        Recording to write: .parquet, .csv or .csv.gz.
    draw : bool
        Draw a unit of the preset within its tolerances. Otherwise the unit is typical.
    sample_rate_hz : float
        Samples per second.
    temp_c : float or None
        Temperature of the board, degC. By default the reference temperature of the device.
    markers : str or None
        Labels of one rigid cluster, separated by commas, for TRC or C3D.
    truth : Path or None
        File for the true orientation, and for the position if the motion has one: .parquet or .csv. It is a motion
        for this command and a reference for validate.
    save_device : Path or None
        File for the device, device.json.
    seed : int
        Seed of every random draw. The same seed gives the same file.
    """
    if not sample_rate_hz > 0.0:
        raise InputError(
            f"`sample_rate_hz`: expected more than 0 Hz, got {sample_rate_hz:g}. Give the rate of the device."
        )
    rng = np.random.default_rng(seed)
    model = device_at(device, rng, draw=draw)
    progress(f"simulating {motion}", 0.0)
    moved, position = _motion(motion, sample_rate_hz, markers, reference_up, rng)
    simulated = simulate_device(model, moved, rng=rng, temp_c=temp_c)
    record = simulated.record
    write_record(record, output)
    if truth is not None:
        write_reference(Reference(time=moved.time, q_nb=moved.q_nb, position=position, moving=moved.moving), truth)
    if save_device is not None:
        write_device(model, save_device)
    gaps = 0 if record.gyro is None else int(np.isnan(record.gyro[:, 0]).sum())
    answer = f"{len(record)} samples at {record.sample_rate_hz:.6g} Hz over {record.duration_s:.1f} s."
    if gaps:
        answer += f" {gaps} samples are gaps, because their poses are unknown."
    if record.accel is None:
        answer += " There are no accelerometers, because these poses have no positions."
    return Report(
        title=f"Simulated {motion.replace('_', ' ')} of {model.name} {model.serial}",
        answer=answer,
        tables=[_effects(simulated)],
        figures=[lambda: draw_record(record)],
        written=[path for path in (output, truth, save_device) if path is not None],
        data={
            "motion": motion,
            "device": {key: getattr(model, key) for key in ("name", "serial", "source_tag")},
            "samples": len(record),
            "gaps": gaps,
        },
    )


def device_at(name: str, rng: np.random.Generator, *, draw: bool) -> DeviceModel:
    """Return the typical unit of a preset, a unit drawn within its tolerances, or the device in a file."""
    if name in PRESETS:
        return random_device(rng, grade=name) if draw else preset(name)
    if not Path(name).exists():
        raise InputError(
            f"device: expected a device.json or one of {', '.join(PRESETS)}, got '{name}'. Choose one of them."
        )
    if draw:
        raise InputError(
            f"`draw`: expected a preset from which a device is drawn, got {name}. Omit `draw` with a device.json."
        )
    return read_device(Path(name))


def _motion(
    name: str, sample_rate_hz: float, markers: str | None, up: Up, rng: np.random.Generator
) -> tuple[Motion, FloatArray | None]:
    """Return the motion of a task or of a file of poses, and its positions, m, if it has any."""
    for task in get_args(TaskName):
        if name == task:
            performed = draw_task(task, rng=rng)
            time = np.arange(round(performed.duration_s * sample_rate_hz)) / sample_rate_hz
            return performed.at(time, STANDARD_GRAVITY), performed.position(time)
    if not Path(name).exists():
        tasks = ", ".join(get_args(TaskName))
        raise InputError(f"motion: expected a file of poses or markers, or one of {tasks}, got '{name}'. Choose one.")
    reference = read_reference(Path(name), labels=labels_of(markers), up=up)
    spline = fit_pose_spline(reference)
    start, stop = spline.span_s
    time = start + np.arange(int((stop - start) * sample_rate_hz + 1e-6) + 1) / sample_rate_hz
    time = np.minimum(time, stop)  # rounding can move the last sample beyond the last pose
    return spline.at(time, STANDARD_GRAVITY), None if reference.position is None else spline.position(time)


def _effects(simulated: Simulated) -> Table:
    """Return the size of each effect of the device."""
    rows = [
        (effect.replace("_", " "), unit, *(np.sqrt(np.nanmean(value**2, axis=0)) / factor).tolist())
        for unit, factor, triad in (
            ("deg/s", RADIAN_PER_DEGREE, simulated.gyro),
            ("m/s2", 1.0, simulated.accel),
        )
        for effect, value in triad.contributions.items()
    ]
    saturated = [int(triad.saturated.any(axis=1).sum()) for triad in (simulated.gyro, simulated.accel)]
    note = f"Saturated samples: {saturated[0]} of the gyroscopes, {saturated[1]} of the accelerometers."
    columns = ("effect", "unit", "x", "y", "z")
    return Table(title="Contribution of each effect (rms)", columns=columns, rows=rows, form=".4g", note=note)
