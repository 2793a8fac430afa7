"""``undrift rig``: run a protocol on a rate table, stop it from another shell, check a table, or emulate one."""

import sys
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from undrift.base.options import Flag, Json, Output, Report
from undrift.cli import examples
from undrift.cli.common import group, say, say_over, show_verdict, write_json
from undrift.commands.files import check_report, device_at, origin_of
from undrift.commands.register import Registration, registered_lines
from undrift.errors import InputError
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

if TYPE_CHECKING:
    from undrift.rig.check import CheckSettings, RigCheck
    from undrift.rig.programme import Programme
    from undrift.rig.rig import Limits, RigSettings
    from undrift.rig.run import Progress, RigBench, RunResult, Watch
    from undrift.sim.rig.emulator import EmulatedBench, PlannedFault
    from undrift.sim.rig.hand_held import HandHeld

rig = group(
    "rig",
    "Run a protocol on a rate table, stop it from another shell, check a table, or emulate one; each takes --json.",
)


@rig.command(help_epilogue=examples("rig run"))
def run(
    protocol: Path,
    /,
    *,
    rig: str,
    device: str,
    output: Output,
    chamber: str | None = None,
    operator: str | None = None,
    serial: str = "",
    gravity_m_s2: float | None = None,
    highest_turn_rate_dps: float = 360.0,
    highest_acceleration_dps2: float = 5000.0,
    travel_deg: float | None = None,
    device_lag_s: float = 120.0,
    card_watchdog: bool = False,
    resume: bool = False,
    yes: bool = False,
    progress: Path | None = None,
    registering: Registration = Registration(),
    report: Report = None,
    json: Json = False,
) -> int:
    """Run a protocol; the folder is a session for calibrate and drift, after every dwell.

    Parameters
    ----------
    protocol : Path
        protocol.toml.
    rig : str
        Address of the table: galil:tcp://host:port?encoder_lines=10000, grbl:serial:///dev/ttyUSB0, manual:
    device : str
        Address of the device: tcp://host:port?..., serial:///dev/ttyUSB0?baud=115200, udp://:port, lsl:name, ble:id
    output : Path
        Folder of the run.
    chamber : str or None
        Address of the thermal chamber, where the protocol has temperatures: tcp://host:port, serial:///dev/ttyUSB0,
        modbus-tcp://host:502?model=watlow-f4 (or watlow-ez-zone, eurotherm), modbus-rtu:///dev/ttyUSB0?model=...; manual:
        asks a person to set it, and the device's thermometer shows when it has soaked.
    operator : str or None
        Address of an emulated operator, who mounts the device; a person is asked where not given.
    serial : str
        Of the device; what its address says where not given.
    gravity_m_s2 : float or None
        Local gravity, m/s2; session.toml states none, and standard gravity is assumed, where it is not given.
    highest_turn_rate_dps : float
        Nothing faster is ever asked of the table, deg/s.
    highest_acceleration_dps2 : float
        Likewise, deg/s2.
    travel_deg : float or None
        How far the table may turn either way, deg; without end where not given.
    device_lag_s : float
        Time constant with which a device without thermometer follows the chamber's air, s; a soak waits five of them.
    card_watchdog : bool
        Upload a program to a Galil card that stops the axis when this computer has been silent for 5 s; cleared at the end.
    resume : bool
        Go on in a folder in which a run was interrupted.
    yes : bool
        Start without asking.
    progress : Path or None
        File to append the run's progress to, a JSON object in a line, for a program that shows it; questions to the operator
        stand there too, with a number, and are answered by "NUMBER ANSWER" on the standard input.
    """
    from undrift.rig.folder import RunFolder
    from undrift.rig.judge import RunSettings
    from undrift.rig.programme import ProgrammeSettings, programme_of, read_protocol
    from undrift.rig.rig import RigSettings, check_programme, parse_address
    from undrift.rig.run import Watch, run_programme
    from undrift.rig.watch import Guard, StopWatch, one_run, stopping_on_signals

    check_report(report, reads=(protocol,))
    registering.check()
    asked, limits = read_protocol(protocol), _limits(highest_turn_rate_dps, highest_acceleration_dps2, travel_deg)
    shown, judge = _Shown(progress), RunSettings(device_lag_s=device_lag_s)
    settings = RigSettings(limits=limits, ask=shown.ask, card_watchdog=(lambda: True) if card_watchdog else None)
    options = parse_address(rig, settings)[2]
    programme = programme_of(asked, ProgrammeSettings(encoder_lines=options.encoder_lines))
    by_hand = rig.startswith("manual:")
    if not resume:
        check_programme(programme, limits, by_hand=by_hand)  # before there is a folder
    with ExitStack() as stack:
        stack.enter_context(one_run(rig, f"undrift rig run into {output}"))
        folder = stack.enter_context(RunFolder(output, asked, resume=resume))
        check_programme(programme, limits, folder.done, by_hand=by_hand)
        shown.plan(programme, folder.done, yes, options.clock_speed)
        stack.enter_context(stopping_on_signals())
        watched = ["" if place.startswith("manual:") else place for place in (rig, chamber or "")]
        guard = stack.enter_context(Guard(*watched)) if any(watched) else None  # before they are opened: it goes last
        shown.watch = watch = Watch(StopWatch(rig), guard, programme)
        settings = replace(settings, card_watchdog=guard.promise_holds) if card_watchdog and guard else settings
        bench, called = _bench(stack, (rig, device, chamber, operator), settings, programme)
        registering.check(serial or called)
        watch.arm()
        result = run_programme(
            programme, bench, folder, report=shown, serial=serial or called, gravity_m_s2=gravity_m_s2, settings=judge
        )
    _finish(result, output, report, protocol, registering.add(output), json)
    return 0


@rig.command(help_epilogue=examples("rig emulate"))
def emulate(
    *,
    device: str = "",
    kind: Literal["galil", "grbl"] = "galil",
    speed: float = 1.0,
    port: int = 0,
    hand_held: Flag = False,
    sample_rate_hz: float = 100.0,
    room_c: float = 25.0,
    mount_tilt_deg: float | None = None,
    heating_c_per_min: float = 3.0,
    gravity_m_s2: float = STANDARD_GRAVITY,
    fault: tuple[str, ...] = (),
    pty: Flag = False,
    save_device: Path | None = None,
    seed: int = 0,
    json: Json = False,
) -> int:
    """Emulate a table, a chamber, a device and an operator on loopback ports; print their addresses and go on until Ctrl-C.

    Parameters
    ----------
    device : str
        A preset, such as mpu6050 or enc03j_3031, or a device.json; a device of consumer grade drawn by the seed where not
        given.
    kind : str
        Servo card or stepper board.
    speed : float
        Emulated seconds in one of the host's.
    port : int
        Of the table; 0 takes a free one.
    hand_held : bool
        A device in an operator's hands instead, without a table: the operator's port takes lines such as "face +x" and
        "turn z 360".
    sample_rate_hz : float
        Readings of the device a second.
    room_c : float
        Temperature around, degC.
    mount_tilt_deg : float or None
        Mounting error of the operator: standard deviation about each axis, deg; 0 where not given, 0.3 if hand-held.
    heating_c_per_min : float
        How fast the chamber changes its temperature, K/min.
    gravity_m_s2 : float
        Local gravity, m/s2.
    fault : tuple of str
        NAME, NAME:AFTER_S or NAME:AFTER_S:FOR_S, seconds of the emulated clock: a part of the link, the table or the chamber
        breaks then and for so long; any number of them. "list" names them.
    pty : bool
        Open a pseudo terminal too, for clients that speak over a serial port; --rig of it is printed as pty.
    save_device : Path or None
        Write the device there, as device.json: the truth that a calibration should find.
    seed : int
        Of every random draw.
    """
    import numpy as np

    from undrift.sim.device.presets import PRESETS
    from undrift.sim.rig.emulator import (
        ALL_FAULTS,
        AirSettings,
        EmulatedBenchSettings,
        EmulatorSettings,
        planned_fault,
        start_bench,
    )
    from undrift.sim.rig.hand_held import HandSettings, start_hand_held
    from undrift.sim.rig.stream import StreamSettings

    faults = [planned_fault(text) for text in fault if text != "list"]
    if "list" in fault:
        say(*(f"{name:22}{what}" for name, what in ALL_FAULTS.items()))
        return 0
    tilt = (0.3 * hand_held if mount_tilt_deg is None else mount_tilt_deg) * RADIAN_PER_DEGREE
    stream = StreamSettings(sample_rate_hz=sample_rate_hz, mount_tilt_sd=tilt, gravity_m_s2=gravity_m_s2, seed=seed)
    drawn = device_at(device, np.random.default_rng(seed), draw=device in PRESETS) if device else None
    if hand_held:
        if faults or pty or port or kind != "galil":
            raise InputError(
                "--hand-held: wanted no table, got options of one; leave --kind, --port, --pty and --fault out"
            )
        hands = HandSettings(tilt_sd=tilt, temp_c=room_c)
        start = partial(start_hand_held, seed=seed, device=drawn, hands=hands, stream=stream, speed=speed)
        _emulate(start, [], save_device, json)
        return 0
    settings = EmulatedBenchSettings(
        rig=EmulatorSettings(kind=kind, speed=speed, port=port, with_pty=pty),
        air=AirSettings(room_c=room_c, ramp_c_per_min=heating_c_per_min),
        stream=stream,
        device=drawn,
    )
    _emulate(partial(start_bench, settings), faults, save_device, json)
    return 0


def _emulate(
    start: "Callable[[], EmulatedBench | HandHeld]", faults: "list[PlannedFault]", save: Path | None, json: bool
) -> None:
    """Run what is emulated until Ctrl-C, its device written and its addresses printed first."""
    import threading

    from undrift.rig.watch import stopping_on_signals
    from undrift.sim.device.model import write_device
    from undrift.sim.rig.hand_held import HandHeld

    with stopping_on_signals(), start() as held, suppress(KeyboardInterrupt):
        if save is not None:
            write_device(held.device, save)
        if isinstance(held, HandHeld):
            addresses, more = {"device": held.address, "operator": held.operator_address}, dict[str, str]()
        else:
            addresses = {"rig": held.rig_address, "device": held.device_address}
            addresses |= {"chamber": held.chamber_address, "operator": held.hands_address}
            addresses |= {} if held.pty_address is None else {"pty": held.pty_address}
            more = {"hands": held.hands_address}  # its name in earlier releases
            for planned in faults:
                threading.Thread(target=held.break_as, args=(planned,), name=planned.name, daemon=True).start()
        if json:
            write_json(addresses | more, "rig emulate")
        else:
            sys.stdout.write("".join(f"--{name} '{address}'\n" for name, address in addresses.items()))
        sys.stdout.flush()
        threading.Event().wait()


@rig.command(help_epilogue=examples("rig stop"))
def stop(*, rig: str, json: Json = False) -> int:
    """Stop the table and switch its motor off, whoever drives it.

    Parameters
    ----------
    rig : str
        Address of the table.
    """
    from undrift.rig.watch import mark_stop, stop_rig

    mark_stop(rig)  # first, so that a run that mounts or soaks ends even where the table does not answer
    stop_rig(rig)
    if json:
        write_json({"rig": rig, "stopped": True, "motor_on": False}, "rig stop")
    else:
        say(f"{rig}: at rest, motor off")
    return 0


@rig.command(help_epilogue=examples("rig status"))
def status(*, rig: str, json: Json = False) -> int:
    """Say where a Galil table stands and what is wrong with it; whoever drives it is not disturbed.

    Parameters
    ----------
    rig : str
        Address of the table.
    """
    from undrift.rig.galil import read_status

    found = read_status(rig)
    angle_deg = found.angle / RADIAN_PER_DEGREE
    if json:
        made = {"rig": rig, "identity": found.identity, "moving": found.moving, "motor_on": found.motor_on}
        error_deg = found.following_error / RADIAN_PER_DEGREE
        write_json(
            made | {"angle_deg": angle_deg, "following_error_deg": error_deg, "fault": found.fault}, "rig status"
        )
        return 0
    words = f"{'moves' if found.moving else 'at rest'}, motor {'on' if found.motor_on else 'off'}"
    say(f"{found.identity}: {words}, at {angle_deg:.3f} deg, {found.fault or 'no fault'}")
    return 0


@rig.command(help_epilogue=examples("rig check"))
def check(
    *,
    rig: str,
    seconds: float = 60.0,
    turn_rate_dps: float = 90.0,
    acceleration_dps2: float = 2300.0,
    limit_deg: float = 0.012,
    travel_deg: float | None = None,
    set_gains: bool = False,
    card_watchdog: bool = False,
    json: Json = False,
) -> int:
    """Accept a table: following error in a step wave, crossover and phase margin of its servo loop. The table turns.

    Parameters
    ----------
    rig : str
        Address of the table: galil:tcp://host:port?encoder_lines=10000, grbl:serial:///dev/ttyUSB0
    seconds : float
        Length of the step wave, s of the table.
    turn_rate_dps : float
        Rate of the wave either way, deg/s; nothing faster is commanded.
    acceleration_dps2 : float
        Of the run-ups, deg/s2.
    limit_deg : float
        Largest following error at steady rate, deg; beyond it the exit code is 1.
    travel_deg : float or None
        How far the table may turn either way, deg; without end where not given.
    set_gains : bool
        Set the suggested gains, until the controller is switched off.
    card_watchdog : bool
        Upload a program to a Galil card that stops the axis when this computer has been silent for 5 s; cleared at the end.
    """
    from undrift.rig.check import CheckSettings, check_rig
    from undrift.rig.rig import WATCHED, RigSettings, open_rig, parse_address
    from undrift.rig.watch import Guard, StopWatch, check_free, one_run, stopping_on_signals

    limits = _limits(turn_rate_dps, acceleration_dps2, travel_deg)
    settings = CheckSettings(
        turn_rate=limits.turn_rate,
        duration_s=seconds,
        acceleration=limits.acceleration,
        limit=limit_deg * RADIAN_PER_DEGREE,
        set_gains=set_gains,
    )
    asked = RigSettings(limits=limits, card_watchdog=(lambda: True) if card_watchdog else None)
    if parse_address(rig, asked)[0] == "manual":
        raise InputError("rig check: wanted a table with a motor, got manual:; name the address of a table")
    with ExitStack() as stack:
        stack.enter_context(one_run(rig, "undrift rig check"))
        stack.enter_context(stopping_on_signals())
        stops, guard = StopWatch(rig), stack.enter_context(Guard(rig))

        def report(line: str) -> None:
            stops.check()
            guard.check()
            guard.expect(WATCHED["progress"].limit)  # longer: it hangs, and the guard stops the table
            if sys.stderr.isatty():
                say_over(line)

        check_free(rig, motor_on=True)
        table = open_rig(rig, replace(asked, card_watchdog=guard.promise_holds if card_watchdog else None))
        stack.callback(table.close)
        guard.arm()
        found = check_rig(table, parse_address(rig)[2].timing, settings, report)
    _show_check(found, rig, settings, json)
    return 1 if found.passed is False else 0


def _limits(turn_rate_dps: float, acceleration_dps2: float, travel_deg: float | None) -> "Limits":
    from undrift.rig.rig import Limits

    dps = RADIAN_PER_DEGREE
    travel = None if travel_deg is None else travel_deg * dps
    return Limits(turn_rate=turn_rate_dps * dps, acceleration=acceleration_dps2 * dps, travel=travel)


def _bench(
    stack: "ExitStack",
    addresses: tuple[str, str, str | None, str | None],
    settings: "RigSettings",
    programme: "Programme",
) -> "tuple[RigBench, str]":
    """Connect device, chamber, operator and, last, the table; return them and what the device is called."""
    from undrift.live.recorder import DwellReadings, Recorder, RecorderSettings
    from undrift.live.transports import source_at
    from undrift.rig.chamber import ChamberSetup, SoakSettings, open_chamber
    from undrift.rig.manual import AskedOperator
    from undrift.rig.programme import Soak
    from undrift.rig.rig import open_rig, parse_address
    from undrift.rig.run import RigBench
    from undrift.rig.watch import check_free
    from undrift.sim.rig.emulator import BenchHands

    rig, device, chamber, operator = addresses
    source = source_at(device)
    clock = parse_address(rig, settings)[2].timing
    longest_s = max(dwell.duration_s for dwell in programme.dwells)
    recorder = Recorder(source, RecorderSettings(keep_s=max(600.0, 2.0 * longest_s)))
    recorder.start()
    readings = DwellReadings(recorder)
    stack.callback(readings.close)
    oven = None
    if chamber is not None:
        slopes = [step.slope_c_per_min for step in programme.steps if isinstance(step, Soak)]
        soak = SoakSettings(slope_c_per_min=min(slopes, default=SoakSettings().slope_c_per_min))
        oven = open_chamber(chamber, ChamberSetup(soak=soak, clock=clock), ask=settings.ask)
        stack.callback(oven.close)
    mounting = AskedOperator(settings.ask or _asked) if operator is None else BenchHands(operator)
    check_free(rig)
    table = open_rig(rig, settings)
    stack.callback(table.close)
    made = RigBench(rig=table, readings=readings, mounting=mounting, chamber=oven, clock=clock)
    return made, source.description.device


def _forecast(programme: "Programme", done: frozenset[int], yes: bool) -> None:
    """Say on stderr how long each step and the whole takes, and ask whether to start."""
    from undrift.rig.programme import forecast_of

    left = forecast_of(programme, done)
    steps = ((number, step) for number, step in enumerate(programme.steps) if number not in done)
    say(
        *(f"{number:5d}  {_clock(step.duration_s)}  {step}" for number, step in steps),
        f"{left.dwells} dwells, {_clock(left.rig_s)} of rig time; with {left.mountings} mountings and the chamber about "
        f"{_clock(left.total_s)}",
        *([f"{len(done)} dwells are on the disk already"] if done else []),
        err=True,
    )
    if yes:
        return
    try:
        answer = _asked("Start? (y/N) ").strip().lower()
    except EOFError:
        answer = ""
    if answer not in ("y", "yes"):
        raise InputError("rig run: wanted a yes to start, got none; nothing moved, say y or --yes")


class _Shown:
    """Watches a run and shows where it is, in a file and on stderr: on a terminal one line, elsewhere one for each step."""

    def __init__(self, file: Path | None) -> None:
        from undrift.rig.run import ProgressFile

        self.watch: Watch | None = None
        self._file, self._live = None if file is None else ProgressFile(file), sys.stderr.isatty()
        self.ask = _asked if self._file is None else self._file.ask
        self._last: int | None = None

    def plan(self, programme: "Programme", done: frozenset[int], yes: bool, speed: float) -> None:
        _forecast(programme, done, yes)
        if self._file is not None:
            self._file.plan(programme, done, speed)

    def __call__(self, progress: "Progress") -> None:
        if self.watch is not None:
            self.watch(progress)
        if self._file is not None:
            self._file(progress)
        line = f"[{progress.number + 1}/{progress.steps}] {_clock(progress.left_s)} left  {progress.step}, {progress.phase}"
        if self._live:
            say_over(f"{line}  {progress.live}")
            sys.stderr.write("\n" * (progress.phase == "closing"))
        elif progress.number != self._last and (progress.live or progress.phase in ("mounting", "closing")):
            self._last = progress.number
            sys.stderr.write(f"{line}  {progress.live}".rstrip() + "\n")


def _finish(
    result: "RunResult", folder: Path, report: Path | None, protocol: Path, kept: "list[dict[str, Any]]", json: bool
) -> None:
    """Write the page of a run and show what it came to."""
    if report is not None:
        from undrift.report.commands import write_rig_report

        write_rig_report(report, result, folder.name, origin=origin_of(protocol, folder / "session.toml"))
    turns = [piece for piece in result.pieces if piece.purpose == "rate"]
    missing = sum(piece.missing for piece in result.pieces)
    if json:
        rows = [
            {
                "axis": piece.axis,
                "nominal_dps": piece.nominal_turn_rate / RADIAN_PER_DEGREE,
                "achieved_dps": piece.turn_rate / RADIAN_PER_DEGREE,
                "standard_uncertainty_dps": piece.turn_rate_uncertainty / RADIAN_PER_DEGREE,
                "temp_c": piece.temp_c if piece.device_c is None else piece.device_c,
                "missing_readings": piece.missing,
            }
            for piece in turns
        ]
        made = {"folder": str(folder), "rig": result.rig, "dwells": len(result.pieces), "added": result.added}
        made |= {"registered": kept} if kept else {}
        write_json(made | {"duration_s": result.duration_s, "missing_readings": missing, "turns": rows}, "rig run")
        return
    off = max((abs(piece.turn_rate - piece.nominal_turn_rate) for piece in turns), default=0.0) / RADIAN_PER_DEGREE
    say(
        f"{folder}: {len(result.pieces)} dwells, {result.added} of them now, in {_clock(result.duration_s)}; achieved rates "
        f"differ from nominal ones by up to {off:.3g} deg/s and stand in session.toml; {missing} readings missing"
    )
    say(*registered_lines(kept))


def _show_check(found: "RigCheck", rig: str, settings: "CheckSettings", json: bool) -> None:
    from undrift.io.store import verdict_json

    dps, loop, error, gains = RADIAN_PER_DEGREE, found.loop, found.error, found.gains
    if json:
        verdict = verdict_json(found.verdict)
        wave = {"turn_rate": settings.turn_rate, "achieved": error.turn_rate}
        errors = {"rms": error.rms, "max": error.largest, "limit_deg": settings.limit}
        errors |= {"run_up_max": error.in_run_up, "link_delay": error.unknown}
        sets = {"read": gains, "suggested": found.suggested, "held": found.held}
        write_json(
            {
                "kind": "undrift.rig_check",
                "format": 1,
                "rig": rig,
                "identity": found.identity,
                "wave": {"seconds": settings.duration_s}
                | {f"{name}_dps": value / dps for name, value in wave.items()}
                | {"acceleration_dps2": settings.acceleration / dps},
                "error_deg": {name: value / dps for name, value in errors.items()} | {"pass": found.passed},
                "crossover_rad_s": loop and loop.crossover,
                "crossover_standard_uncertainty_rad_s": loop and loop.crossover_uncertainty,
                "phase_margin_deg": loop and loop.margin / dps,
                "phase_margin_standard_uncertainty_deg": loop and loop.margin_uncertainty / dps,
                "gains": {name: each and asdict(each) for name, each in sets.items()},
                "verdict": verdict,
                "findings": verdict["findings"],
            },
            "rig check",
        )
        return
    say(
        f"{found.identity}: step wave of {settings.turn_rate / dps:g} deg/s for {settings.duration_s:g} s",
        f"following error {error.rms / dps:.4f} deg rms, {error.largest / dps:.4f} deg at most at steady rate; limit "
        f"{settings.limit / dps:g} deg",
    )
    if loop is not None:
        say(
            f"crossover {loop.crossover:.1f} +- {loop.crossover_uncertainty:.1f} rad/s, phase margin {loop.margin / dps:.1f} "
            f"+- {loop.margin_uncertainty / dps:.1f} deg (standard uncertainties)"
        )
    if gains is not None:
        say(f"gains KP {gains.kp:g}, KD {gains.kd:g}, KI {gains.ki:g}")
    show_verdict(found.verdict, details=True)


def _asked(line: str) -> str:
    sys.stderr.write(line)
    sys.stderr.flush()
    answer = sys.stdin.readline()
    if not answer:
        raise EOFError
    return answer


def _clock(seconds: float) -> str:
    whole = round(max(seconds, 0.0))
    return f"{whole // 3600:d}:{whole // 60 % 60:02d}:{whole % 60:02d}"
