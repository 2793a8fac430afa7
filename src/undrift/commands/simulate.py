"""``undrift simulate``: simulated sensor output for recorded poses, a task, or a thermal session."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

from undrift.base.options import Flag, Gravity, Output, Up, verb
from undrift.base.summary import Section, Summary, figure_of, plain_words, rows_section
from undrift.commands import Progress, silent
from undrift.commands.files import check_folder, device_at, labels_of
from undrift.errors import InputError
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

if TYPE_CHECKING:
    import numpy as np

    from undrift.arrays import FloatArray
    from undrift.record import Record
    from undrift.sim.device.model import DeviceModel
    from undrift.sim.device.simulate import Simulated
    from undrift.sim.motion.motion import Motion
    from undrift.sim.motion.poses import PoseSettings
    from undrift.sim.thermal import ThermalKind

THERMAL = "thermal_"  # before the kind of a thermal session


@verb
def simulate(
    motion: str,
    /,
    *,
    device: str,
    output: Output,
    draw: Flag = False,
    sample_rate_hz: float | None = None,
    temp_c: float | None = None,
    power_on_s: float | None = None,
    gravity_m_s2: Gravity = STANDARD_GRAVITY,
    markers: str | None = None,
    reference_up: Up = None,
    cutoff_hz: str | None = None,
    truth: Path | None = None,
    save_device: Path | None = None,
    seed: int = 0,
    progress: Progress = silent,
) -> Summary:
    """Simulate the readings of a device in a motion.

    Parameters
    ----------
    motion : str
        A file of poses or markers, or a task: sit_to_stand, step, posturography, free; or a thermal session: thermal_soak,
        thermal_ramp, thermal_warm_up.
    device : str
        A preset (enc03j_3031, mpu6050, icm20948, bmi160, bmi270, bmi088, lsm6dso, xsens_mti1, shimmer3) or a device.json.
    output : Path
        Recording to write: .parquet, .csv or .csv.gz; a folder for a thermal session.
    draw : bool
        Draw a unit of the preset within its tolerances; the typical one otherwise.
    sample_rate_hz : float
        Samples per second; 100 where not given, 50 in a thermal session.
    temp_c : float or None
        Temperature of the board, degC; the device's reference temperature where not given.
    power_on_s : float
        Time since power-on at the first sample, s; 0 where not given, an hour in a thermal session.
    markers : str or None
        Labels of one rigid cluster, comma between, for TRC or C3D.
    cutoff_hz : str or None
        Low-pass of recorded poses, Hz: a number for orientation and position, none to filter nothing; 20 Hz for orientation and
        10 Hz for position where not given.
    truth : Path or None
        Write the true orientation at the samples there, and the position where the motion has one, as a reference: .parquet or
        .csv, which this command takes for a motion again.
    save_device : Path or None
        Write the device there, as device.json.
    seed : int
        Seed of every random draw: the same seed gives the same file.
    """
    import numpy as np

    from undrift.io.reference import write_reference
    from undrift.record import Reference
    from undrift.sim.device.model import write_device
    from undrift.sim.device.simulate import simulate_device

    if sample_rate_hz is not None and not sample_rate_hz > 0.0:
        raise InputError(f"sample rate: wanted more than 0 Hz, got {sample_rate_hz:g}; give the rate of the device")
    rng = np.random.default_rng(seed)
    model, rate_hz = device_at(device, rng, draw=draw), sample_rate_hz or 100.0
    progress(f"simulating {motion}", 0.0)
    if motion.startswith(THERMAL):
        unused: dict[str, object] = {"temp_c": temp_c, "markers": markers, "reference_up": reference_up}
        unused |= {"cutoff_hz": cutoff_hz, "truth": truth}
        _check_unused(motion, [name for name, value in unused.items() if value is not None], power_on_s)
        answer = _thermal(motion, model, output, (sample_rate_hz, power_on_s, gravity_m_s2), rng)
    else:
        moved, where = _motion(motion, rate_hz, gravity_m_s2, (markers, reference_up, cutoff_hz), rng)
        simulated = simulate_device(model, moved, rng=rng, temp_c=temp_c, power_on_s=power_on_s or 0.0)
        if truth is not None:
            write_reference(Reference(time=moved.time, q_nb=moved.q_nb, position=where, moving=moved.moving), truth)
        answer = _moved(motion, model, output, simulated)
    if save_device is not None:
        write_device(model, save_device)
    return answer


def _check_unused(motion: str, stated: list[str], power_on_s: float | None) -> None:
    """Refuse options that a thermal session does not use; ``stated`` are their names."""
    from undrift.sim.thermal import ThermalKind

    kinds = [THERMAL + kind for kind in get_args(ThermalKind)]
    if motion not in kinds:
        raise InputError(f"motion: wanted one of {', '.join(kinds)}, got '{motion}'; name one")
    if stated:
        wrong = ", ".join(f"--{name.replace('_', '-')}" for name in stated)
        raise InputError(f"{motion}: wanted none of {wrong}, which a thermal session has no use for; leave out")
    if motion == f"{THERMAL}warm_up" and power_on_s is not None:
        raise InputError(
            f"{motion}: wanted no `power_on_s`, got {power_on_s:g}; this session begins at power-on, leave it out"
        )


def _thermal(
    motion: str,
    model: "DeviceModel",
    output: Path,
    given: tuple[float | None, float | None, float],
    rng: "np.random.Generator",
) -> Summary:
    """Simulate a thermal session and write it; given are the sample rate, the time since power-on and gravity."""
    from undrift.io.session import write_session
    from undrift.sim.thermal import ThermalSettings, simulate_thermal_session

    check_folder(output)
    sample_rate_hz, power_on_s, gravity_m_s2 = given
    bench = replace(ThermalSettings().bench, gravity_m_s2=gravity_m_s2)
    bench = bench if sample_rate_hz is None else replace(bench, sample_rate_hz=sample_rate_hz)
    settings = ThermalSettings(bench=bench)
    settings = settings if power_on_s is None else replace(settings, power_on_s=power_on_s)
    kind: ThermalKind = motion.removeprefix(THERMAL)  # type: ignore[assignment]
    session = simulate_thermal_session(kind, model, rng=rng, settings=settings)
    write_session(session, output)
    record, counts = session.records[0], {"stills": len(session.stills), "turns": len(session.turns)}
    figures = _of_record(model, record) | {"temp_c": _span(record), **counts}
    line = (
        "{samples} samples at {sample_rate_hz:.6g} Hz over {duration_s:.0f} s, {temp_c[0]:.1f} to {temp_c[1]:.1f} degC, "
        "{stills} stills, {turns} turns."
    )
    return _answer(motion, output, model, record, figures, line.format(**figures))


def _span(record: "Record") -> list[float] | None:
    """Return the lowest and the highest temperature, degC."""
    return None if record.temp_c is None else [float(record.temp_c.min()), float(record.temp_c.max())]


def _of_record(model: "DeviceModel", record: "Record") -> dict[str, Any]:
    return {
        "device": {key: getattr(model, key) for key in ("name", "serial", "source_tag")},
        "samples": len(record),
        "sample_rate_hz": record.sample_rate_hz,
        "duration_s": record.duration_s,
    }


def _motion(
    name: str,
    sample_rate_hz: float,
    gravity_m_s2: float,
    how: tuple[str | None, Up, str | None],
    rng: "np.random.Generator",
) -> tuple["Motion", "FloatArray | None"]:
    """Return the motion, and the positions of the device in m (None of poses without).

    How poses are read: markers, the axis that points up, the cut-off.
    """
    import numpy as np

    from undrift.io.formats import read_reference
    from undrift.sim.motion.poses import fit_pose_spline
    from undrift.sim.motion.tasks import TaskName, draw_task

    markers, up, cutoff_hz = how
    for task in get_args(TaskName):
        if name == task:
            if cutoff_hz is not None:
                raise InputError(f"{task}: wanted no `cutoff_hz`, got {cutoff_hz}; tasks have no camera noise")
            performed = draw_task(task, rng=rng)
            time = np.arange(round(performed.duration_s * sample_rate_hz)) / sample_rate_hz
            return performed.at(time, gravity_m_s2), performed.position(time)
    if not Path(name).exists():
        raise InputError(
            f"motion: wanted a file of poses or markers, or one of {', '.join(get_args(TaskName))}, got '{name}'; name one"
        )
    reference = read_reference(Path(name), labels=labels_of(markers), up=up)
    spline = fit_pose_spline(reference, _pose_settings(cutoff_hz))
    start, stop = spline.span_s
    time = start + np.arange(int((stop - start) * sample_rate_hz + 1e-6) + 1) / sample_rate_hz
    time = np.minimum(time, stop)  # the last instant may round to one just after the last pose, where nothing is known
    return spline.at(time, gravity_m_s2), None if reference.position is None else spline.position(time)


def _pose_settings(cutoff_hz: str | None) -> "PoseSettings":
    """Return how poses are filtered."""
    from undrift.sim.motion.poses import PoseSettings

    if cutoff_hz is None:
        return PoseSettings()
    if cutoff_hz == "none":
        return PoseSettings(cutoff_hz=None, position_cutoff_hz=None)
    try:
        stated = float(cutoff_hz)
    except ValueError:
        raise InputError(f"`cutoff_hz`: wanted a number in Hz or none, got '{cutoff_hz}'; give one of them") from None
    return PoseSettings(cutoff_hz=stated, position_cutoff_hz=stated)


def _moved(motion: str, model: "DeviceModel", output: Path, simulated: "Simulated") -> Summary:
    """Write a simulated motion, and return the size of each effect, saturation and gaps."""
    import numpy as np

    from undrift.io.formats import write_record

    record = simulated.record
    write_record(record, output)
    text = list[str]()
    gaps = 0 if record.gyro is None else int(np.isnan(record.gyro[:, 0]).sum())
    figures = _of_record(model, record) | {"gaps": gaps}
    rows = list[dict[str, str]]()
    for name, key, unit, factor, triad in (
        ("gyroscope", "gyro_rad_s", "deg/s", RADIAN_PER_DEGREE, simulated.gyro),
        ("accelerometer", "accel_m_s2", "m/s2", 1.0, simulated.accel),
    ):
        saturated = int(triad.saturated.any(axis=1).sum())
        rms = {effect: np.sqrt(np.nanmean(value**2, axis=0)) for effect, value in triad.contributions.items()}
        figures[key] = {"saturated_samples": saturated, "contribution_rms": rms}
        text += [f"warning: {name} saturated in {saturated} samples"] if saturated else []
        for effect, value in rms.items():
            cells = zip("xyz", (f"{axis:.4g}" for axis in value / factor), strict=True)
            rows.append({"effect": f"{plain_words(effect)}, {unit}", **dict(cells)})
    text += [f"warning: {gaps} samples are gaps, where the poses are not known"] if gaps else []
    text += ["no accelerometer: these poses hold no positions"] if record.accel is None else []
    effects = rows_section(f"{model.name} {model.serial}: contribution of each effect (rms)", rows)
    line = f"{len(record)} samples at {record.sample_rate_hz:.6g} Hz over {record.duration_s:.1f} s."
    return _answer(motion, output, model, record, figures, line, (effects, Section(title="Remarks", text=tuple(text))))


def _answer(
    motion: str,
    output: Path,
    model: "DeviceModel",
    record: "Record",
    figures: dict[str, Any],
    line: str,
    sections: tuple[Section, ...] = (),
) -> Summary:
    """Return what was simulated, with the last recording."""
    return Summary(
        title=f"Simulated {plain_words(motion)} of {model.name} {model.serial}",
        answer=f"{motion} -> {output}: {line}",
        data={"motion": motion, "output": str(output), **figures},
        pictures=(figure_of("figures:draw_record", record),),
        sections=sections,
    )
