"""``undrift rig run | stop | check``: run a protocol on a rate table, stop the table, and check it.

A run shows its progress on the screen, and prompts its operator there.
"""

from contextlib import ExitStack, suppress
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import numpy as np
from cyclopts import Parameter

from undrift.base.options import Output
from undrift.commands.simulate import device_at
from undrift.errors import InputError
from undrift.findings import finding, told_apart
from undrift.live.recorder import DwellReadings, Recorder
from undrift.live.transports import device_address, source_at
from undrift.plugins import typed_options
from undrift.programme import Dwell, Mount, Programme, programme_of, read_protocol
from undrift.report import Estimate, Report, Table
from undrift.report.figures import draw_rig_run
from undrift.rig.chamber import ChamberSetup, Readings, open_chamber
from undrift.rig.check import ACCELERATION, check_rig
from undrift.rig.folder import RecordedDwell, RunFolder
from undrift.rig.lock import one_run, stop_rig, stopping_on_signals
from undrift.rig.manual import AskedOperator
from undrift.rig.rig import Limits, RigSettings, check_programme, open_rig, parse_address
from undrift.rig.run import Mounted, Progress, RigBench, RunResult, run_programme
from undrift.rig.simulated import SimulatedBench, SimulatedSettings
from undrift.screen import screen
from undrift.sim.device.presets import PRESETS, random_device
from undrift.units import RADIAN_PER_DEGREE as DPS

TableAddress: TypeAlias = Annotated[str, Parameter(help="Address of the table.")]

DWELL_COLUMNS = (
    "dwell", "purpose", "up", "samples", "missing", "nominal (deg/s)", "achieved (deg/s)", "temperature (degC)"
)  # fmt: skip
HIGHEST_DPS, HIGHEST_DPS2 = 360.0, 5000.0  # default limits for a table without other limits


def _limits(turn_rate_dps: float, acceleration_dps2: float, travel_deg: float | None) -> Limits:
    travel = None if travel_deg is None else travel_deg * DPS
    return Limits(turn_rate=turn_rate_dps * DPS, acceleration=acceleration_dps2 * DPS, travel=travel)


def run(
    protocol: Path,
    /,
    *,
    rig: str,
    device: tuple[str, ...],
    output: Output,
    chamber: str | None = None,
    serial: str = "",
    highest_turn_rate_dps: float = HIGHEST_DPS,
    highest_acceleration_dps2: float = HIGHEST_DPS2,
    travel_deg: float | None = None,
    resume: bool = False,
    yes: bool = False,
) -> Report:
    """Run a protocol. After every dwell, the folder is a session for calibrate and drift.

    Parameters
    ----------
    protocol : Path
        protocol.toml.
    rig : str
        Address of the table: galil:tcp://host:port?encoder_lines=10000, grbl:serial:///dev/ttyUSB0, manual: (a person). To simulate
        the whole bench, use simulated: or, faster, simulated:?clock_speed=100, also for `device` and `chamber`. A simulated
        `device` has the options seed, device (a preset or device.json) and tilt_deg of the mounting.
    device : tuple of str
        Address of the device: tcp://host:port?..., serial:///dev/ttyUSB0?baud=115200, udp://:port, lsl:name. Several
        devices that are mounted alike on one table are read in the same dwells. Repeat the option for each.
    output : Path
        Folder of the run. For several devices, it contains the folders device-1, device-2.
    chamber : str or None
        Address of the thermal chamber, if the protocol has temperatures: tcp://host:port or serial:///dev/ttyUSB0. With
        manual: a person sets the chamber, and the device's thermometer detects the end of the soak.
    serial : str
        Serial number of the device. The default is taken from its address.
    highest_turn_rate_dps : float
        Largest commanded rate, deg/s.
    highest_acceleration_dps2 : float
        Largest commanded acceleration, deg/s2.
    travel_deg : float or None
        Largest angle of the table in either direction, deg. Unlimited by default.
    resume : bool
        Continue in the folder of an interrupted run.
    yes : bool
        Start without asking.
    """

    plan = read_protocol(protocol)
    programme = programme_of(plan)
    limits = _limits(highest_turn_rate_dps, highest_acceleration_dps2, travel_deg)
    kind, _, settings = parse_address(rig, RigSettings(limits=limits, ask=screen().ask))
    simulated = _simulated_bench(device, (rig, chamber), settings)
    if not resume:
        check_programme(programme, limits, by_hand=kind == "manual")  # before there is a folder
    paths = _folders(output, device, serial)
    with ExitStack() as stack:
        stack.enter_context(one_run(rig, f"undrift rig run into {output}"))
        folders = [stack.enter_context(RunFolder(path, plan, resume=resume)) for path in paths]
        _confirm(programme, frozenset.intersection(*(folder.done for folder in folders)), yes)
        stack.enter_context(stopping_on_signals())
        devices: list[tuple[Readings, str]]
        if simulated is None:
            keep_s = max(600.0, 2.0 * max(dwell.duration_s for dwell in programme.dwells))  # at least two dwells
            live = [_connect(stack, url, keep_s) for url in device]
            devices = [(readings, readings.recorder.source.description.device) for readings in live]
            bench = _bench(stack, (rig, chamber), replace(settings, accept="on" if resume else "off"))
        else:
            oven = None if chamber is None else simulated.chamber
            bench = RigBench(rig=simulated.table, mounting=simulated, chamber=oven, clock=simulated.clock)
            devices = [(readings, readings.description.device) for readings in simulated.readings]
        mounted = [
            Mounted(readings=readings, folder=folder, serial=name)
            for (readings, name), folder in zip(devices, folders, strict=True)
        ]
        mounted[0].serial = serial or mounted[0].serial
        results = run_programme(programme, bench, *mounted, report=_show)
    return run_report(dict(zip(paths, results, strict=True)))


def run_report(results: dict[Path, RunResult]) -> Report:
    """Return the report of a run: dwells, and the largest difference between achieved and nominal rates, for each device."""
    (folder, result), *others = results.items()
    turns = [piece for piece in result.pieces if piece.purpose == "rate"]
    difference = max((abs(turn.turn_rate - turn.nominal_turn_rate) for turn in turns), default=0.0)
    missing = sum(piece.missing for piece in result.pieces)
    answer = (
        f"{len(result.pieces)} dwells are in {folder}, {result.added} of them recorded now, in {_clock(result.duration_s)}. "
        f"Achieved rates differ from nominal rates by up to {difference / DPS:.3g} deg/s. "
        f"{missing} readings are missing."
    )
    tables = [
        Table(title="Dwells", columns=DWELL_COLUMNS, rows=[_dwell_row(piece) for piece in result.pieces], form=".2f")
    ]
    if others:
        rows = [(str(path), len(other.pieces)) for path, other in others]
        tables.append(Table(title="Other devices on the table", columns=("folder", "dwells"), rows=rows))
    return Report(
        title=f"Rig run: {folder.name}, on {result.rig}",
        answer=answer,
        tables=tables[1:],
        details=tables[:1],
        figures=[lambda: draw_rig_run(turns)] if turns else [],
        written=[path / "session.toml" for path in results],
        data={
            "rig": result.rig,
            "dwells": len(result.pieces),
            "added": result.added,
            "duration_s": result.duration_s,
            "missing_readings": missing,
        },
        next_command=("calibrate", folder, "-o", "calibration.json"),
    )


def _dwell_row(piece: RecordedDwell) -> tuple[Any, ...]:
    rates: tuple[Any, ...] = (None, None)
    if piece.purpose == "rate":
        achieved = Estimate(piece.turn_rate / DPS, piece.turn_rate_uncertainty / DPS)
        rates = (piece.nominal_turn_rate / DPS, achieved)
    temp_c = piece.temp_c if piece.device_c is None else piece.device_c
    return (piece.name, piece.purpose, piece.up, piece.samples, piece.missing, *rates, temp_c)


def _folders(output: Path, device: tuple[str, ...], serial: str) -> list[Path]:
    """Return the folder of each device."""
    if len(device) == 1:
        return [output]
    if serial or len({*device}) < len(device):
        raise InputError(
            "rig run: several devices need different addresses and no `serial`. Set each serial number in the "
            "address of its device."
        )
    return [output / f"device-{number}" for number in range(1, len(device) + 1)]


def _simulated_bench(
    devices: tuple[str, ...], addresses: tuple[str, str | None], options: RigSettings
) -> SimulatedBench | None:
    """Create a simulated bench if the table is simulated. All parts of a bench must be simulated, or none."""
    texts = [text for text in (*addresses, *devices) if text is not None]
    simulated = [text.startswith("simulated:") for text in texts]
    if not any(simulated):
        return None
    if not all(simulated):
        raise InputError(
            f"rig run: rig, chamber and devices must be either all simulated or all real, got {', '.join(texts)}. "
            f"Use simulated: for each."
        )
    models, settings = [], SimulatedSettings(limits=options.limits)
    for text in devices:
        values = typed_options(device_address(text)[2], {"seed": int, "tilt_deg": float, "device": str}, "device")
        seed, name = values.get("seed", 0), values.get("device", "")
        rng = np.random.default_rng(seed)
        models.append(device_at(name, rng, draw=name in PRESETS) if name else random_device(rng, grade="consumer"))
        settings = replace(settings, seed=seed, mount_tilt_sd=values.get("tilt_deg", 0.0) * DPS)
    return SimulatedBench(models, settings, options.clock)


def _connect(stack: ExitStack, address: str, keep_s: float) -> DwellReadings:
    """Connect a device whose readings are stored for a time."""
    readings = DwellReadings(Recorder(source_at(address), keep_s=keep_s))
    readings.recorder.start()
    stack.callback(readings.close)
    return readings


def _bench(stack: ExitStack, addresses: tuple[str, str | None], settings: RigSettings) -> RigBench:
    """Connect chamber, operator and, last, the table."""
    rig, chamber = addresses
    ask, oven = screen().ask, None
    if chamber is not None:
        oven = stack.enter_context(open_chamber(chamber, ChamberSetup(clock=settings.clock), ask=ask))
    table = open_rig(rig, settings)
    stack.callback(table.close)
    return RigBench(rig=table, mounting=AskedOperator(ask), chamber=oven, clock=settings.clock)


def _confirm(programme: Programme, done: frozenset[int], yes: bool) -> None:
    """Show the duration of each step and of the run, and ask whether to start."""
    steps = [(number, step) for number, step in enumerate(programme.steps) if number not in done]
    dwells_s = [step.duration_s for _, step in steps if isinstance(step, Dwell)]
    mountings = sum(isinstance(step, Mount) for _, step in steps)
    screen().say(
        *(f"{number:5d}  {_clock(step.duration_s)}  {step}" for number, step in steps),
        f"{len(dwells_s)} dwells, {_clock(sum(dwells_s))} of rig time. With {mountings} mountings and the chamber about "
        f"{_clock(sum(step.duration_s for _, step in steps))}",
        *([f"{len(done)} dwells are already on the disk"] if done else []),
    )
    with suppress(EOFError):
        yes = yes or screen().ask("Start? (y/N) ").strip().lower() in ("y", "yes")
    if not yes:
        raise InputError("rig run: the start was not confirmed, and nothing moved. Answer y, or use `yes`.")


def _show(progress: Progress) -> None:
    """Show the position of a run. In a log, a step is a single line, printed when it has readings."""
    line = f"[{progress.number + 1}/{progress.steps}] {_clock(progress.left_s)} left  {progress.step}, {progress.phase}"
    is_logged = bool(progress.live) or progress.phase in ("mounting", "closing")
    step = progress.number if is_logged else None
    screen().over(f"{line}  {progress.live}".rstrip(), step=step, last=progress.phase == "closing")


def stop(*, rig: TableAddress) -> Report:
    """End the run on this computer that drives a table, stop the table and switch its motor off."""
    stop_rig(rig)
    data = {"rig": rig, "stopped": True, "motor_on": False}
    return Report(title="A table stopped", answer=f"{rig}: at rest, motor off.", data=data)


def check(
    *,
    rig: str,
    seconds: float = 60.0,
    turn_rate_dps: float = 90.0,
    limit_deg: float = 0.012,
    travel_deg: float | None = None,
) -> Report:
    """Check a table with a servo: following error in a step wave, with gains and sample period. The table turns.

    Parameters
    ----------
    rig : str
        Address of the table: galil:tcp://host:port?encoder_lines=10000, or simulated:
    seconds : float
        Length of the step wave, s of the table.
    turn_rate_dps : float
        Rate of the wave in both directions, deg/s. Faster rates are never commanded.
    limit_deg : float
        Largest following error at steady rate, deg. If it is exceeded, the exit code is 1.
    travel_deg : float or None
        Largest angle of the table in either direction, deg. Unlimited by default.
    """
    limits = _limits(turn_rate_dps, ACCELERATION / DPS, travel_deg)
    kind, _, settings = parse_address(rig, RigSettings(limits=limits, accept="on"))
    if kind == "manual":
        raise InputError("rig check: expected a table with a motor, got manual:. Give the address of a table.")
    with ExitStack() as stack:
        stack.enter_context(one_run(rig, "undrift rig check"))
        stack.enter_context(stopping_on_signals())
        table = open_rig(rig, settings)
        stack.callback(table.close)
        result = check_rig(
            table, settings.clock, turn_rate=turn_rate_dps * DPS, duration_s=seconds, report=screen().over
        )
    servo, largest_deg = result.servo, result.largest / DPS
    failed = finding(
        "rig_check.error",
        "fail",
        f"The following error is up to {told_apart(largest_deg, '.4f', limit_deg)} deg at steady rate (limit {limit_deg:g} deg).",
        "Check friction, load and gains of the table.",
        largest_deg=largest_deg,
    )
    return Report(
        title="Acceptance of a table",
        answer=f"{result.identity}: the following error in a step wave of {turn_rate_dps:g} deg/s for {seconds:g} s is "
        f"{largest_deg:.4f} deg at most (limit {limit_deg:g} deg).",
        tables=[
            Table(
                title="Following error (deg)",
                columns=("rms", "largest at steady rate", "limit", "largest in the run-ups"),
                rows=[(result.rms / DPS, largest_deg, limit_deg, result.in_run_up / DPS)],
                form=".4f",
            )
        ],
        notes=[
            f"The servo has KP {servo.kp:g}, KI {servo.ki:g}, KD {servo.kd:g} and a sample period of {1e6 * servo.sample_s:g} us."
        ],
        findings=[failed] if largest_deg > limit_deg else [],
        judged=True,
        data={"rig": rig, "identity": result.identity, "achieved_dps": result.turn_rate / DPS, "servo": asdict(servo)},
    )


def _clock(seconds: float) -> str:
    total_s = round(max(seconds, 0.0))
    return f"{total_s // 3600:d}:{total_s // 60 % 60:02d}:{total_s % 60:02d}"
