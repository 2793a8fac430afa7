"""Runner for the blocks of a page, controlled by comments above the blocks.

A comment of Markdown stands just above the fence, where no reader sees it:

    <!-- needs: NAME, NAME -->         files that a reader has; made here by FILES
    <!-- file: NAME -->                the block is written to that file
    <!-- quick: REASON | COMMANDS -->  these run in place of the block, whose own lines are parsed
    <!-- parsed: REASON -->            lines are parsed as commands with their options, not run: a rig, another program
    <!-- exit: N -->                   the last command of the block ends with that code; 0 otherwise

Blocks of sh, python, toml, csv and text have a meaning. A text block right below another shows what that prints, digit by digit:
of a command each line must be there, blanks apart; of Python the text is the same. A line "..." stands for what is left out, as
times and versions.
"""

import contextlib
import glob
import io
import re
import shlex
import tomllib
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import undrift
from testkit.command_line import check_call
from testkit.daily_use import DailyUseSettings, simulate_daily_use
from testkit.printing_board import sketch_line
from testkit.walking import walk
from undrift.cli.app import run
from undrift.io.reference import write_reference
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.truth import true_calibration
from undrift.sim.motion.bench import BenchKind, BenchSettings
from undrift.sim.motion.tasks import draw_task
from undrift.sim.thermal import BENCH, ThermalSettings
from undrift.units import STANDARD_GRAVITY, si_factor

SAMPLE = "undrift sample"  # the line that names the source of the data on the pages
BLOCK = re.compile(r"((?:^<!--[^\n]*-->\n)*)^```(sh|python|toml|csv|text)\n(.*?)^```$", re.M | re.S)
RATES = (0.2, 1.0)  # rad/s, of a short session over temperature
ELSEWHERE = ("cd", "gcc", "make", "pip", "python", "python3", "source")


@dataclass(frozen=True)
class Block:
    """A fenced block of a page, and the comments above it."""

    kind: str
    text: str
    line: int
    marks: dict[str, str]
    follows: bool  # True if the block directly follows the previous block


def blocks_of(text: str) -> list[Block]:
    """Return the blocks of a page that have a meaning."""
    results, end = [], 0
    for match in BLOCK.finditer(text):
        marks = dict(re.findall(r"^<!-- ([a-z]+): *(.*?) *-->$", match.group(1), re.M))
        follows = not text[end : match.start()].strip()
        results.append(Block(match.group(2), match.group(3), text.count("\n", 0, match.start(2)) + 1, marks, follows))
        end = match.end()
    return results


def lines_of(text: str) -> list[str]:
    """Return the commands of a sh block, continued lines joined."""
    return [
        line.strip()
        for line in text.replace("\\\n", " ").splitlines()
        if line.strip() and not line.strip().startswith("#")
    ]


def run_page(text: str, folder: Path) -> int:
    """Run the blocks of a page in a folder, in order, and return their number. An AssertionError names the line."""
    names: dict[str, object] = {}
    ran, printed, by_python = 0, "", False
    with contextlib.chdir(folder):
        for block in blocks_of(text):
            at = f"line {block.line}"
            for name in block.marks.get("needs", "").replace(" ", "").split(","):
                if name and not Path(name).exists():
                    FILES[name](Path(name))
            if "file" in block.marks:
                Path(block.marks["file"]).write_text(block.text, encoding="utf-8")
            if block.kind == "toml":
                tomllib.loads(block.text)
            elif block.kind == "python":
                out = io.StringIO()
                with contextlib.redirect_stdout(out):
                    exec(compile(block.text, at, "exec"), names)
                printed, by_python, ran = out.getvalue(), True, ran + 1
            elif block.kind == "sh":
                printed, by_python = _run_commands(block, at), False
                ran += 1
            elif block.kind == "text" and block.follows and printed:
                _check_printed(block.text, printed, at, exact=by_python)
    return ran


def _run_commands(block: Block, at: str) -> str:
    lines, wanted = lines_of(block.text), int(block.marks.get("exit", "0"))
    for program, *words in map(words_of, lines):
        if program == "undrift":
            check_call(words)
        else:
            assert program in ELSEWHERE, f"{at}: {program}: unknown program"
    if "parsed" in block.marks:
        assert block.marks["parsed"], f"{at}: parsed wants its reason"
        return ""
    if "quick" in block.marks:
        reason, _, commands = block.marks["quick"].partition("|")
        assert "" not in (reason.strip(), commands.strip()), f"{at}: quick wants a reason and a command"
        lines = [line.strip() for line in commands.split(";")]
    out = io.StringIO()
    for k, line in enumerate(lines):
        words = words_of(line)
        assert words[0] == "undrift", f"{at}: {line}: not a command of undrift; mark it as parsed, with the reason"
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(out):
            code = run(words[1:])
        assert code == (wanted if k == len(lines) - 1 else 0), (
            f"{at}: {line} ended with {code}:\n{out.getvalue()[-1500:]}"
        )
    return out.getvalue()


def words_of(line: str) -> list[str]:
    """Return the words of a command, names of files completed."""
    words = []
    for word in shlex.split(line, comments=True):
        result = sorted(glob.glob(word)) if "*" in word else []
        words += result or [word]
    return words


def _check_printed(shown: str, printed: str, at: str, *, exact: bool) -> None:
    if exact:
        assert printed == shown, f"{at}: prints {printed!r}"
        return
    have = {" ".join(line.split()) for line in printed.splitlines()}
    for line in shown.splitlines():
        if line.strip() not in ("", "..."):
            assert " ".join(line.split()) in have, f"{at}: not printed: {line}\n{printed[-3000:]}"


# ---- files that a reader has, of one simulated device


def _device() -> tuple[DeviceModel, np.random.Generator]:
    rng = np.random.default_rng(7)
    return undrift.random_device(rng), rng


def _recording(kind: BenchKind, settings: BenchSettings = BenchSettings()) -> undrift.Record:
    device, rng = _device()
    return undrift.simulate_session(kind, device, rng=rng, settings=settings, labelled=False).records[0]


def _uncalibrated(record: undrift.Record) -> undrift.Record:
    """Return codes as a phone reads them: with a unit, not yet calibrated."""
    true = true_calibration(_device()[0], temp_c=25.0)
    gyro, accel = (
        np.asarray(raw) * np.trace(model.matrix) / 3.0  # type: ignore[union-attr]
        for raw, model in ((record.gyro, true.gyro), (record.accel, true.accel))
    )
    return replace(record, gyro=gyro, accel=accel, gyro_unit="rad/s", accel_unit="m/s2")


def _logger(path: Path) -> None:
    """Make a table with names of its own, in ms, deg/s and g."""
    record = _recording("ferraris")
    rows = np.column_stack((1e3 * record.time, record.gyro / 16.384, record.accel / 4096.0))  # type: ignore[operator]
    np.savetxt(path, rows, "%.6f", ",", header="Time,Gx,Gy,Gz,Ax,Ay,Az", comments="")


def _monitor(path: Path) -> None:
    """Make the text that a serial monitor saves of a board with a sketch of docs/firmware-logger."""
    record = _recording("ferraris")
    rows = zip(np.round(1e6 * record.time).astype(int).tolist(), record.gyro, record.accel, strict=True)  # type: ignore[arg-type]
    lines = (sketch_line(k, time_us, gyro, accel, 25.0) for k, (time_us, gyro, accel) in enumerate(rows))
    path.write_bytes(b"ets Jul 29 2019 12:21:46\r\nrst:0x1 (POWERON_RESET)\r\n" + b"".join(lines))


def _phone(path: Path) -> None:
    """Make the zip that phyphox exports of six faces and three turns."""
    record = _uncalibrated(_recording("ferraris"))
    with zipfile.ZipFile(path, "w") as files:
        for name, head, unit, values in (
            ("Gyroscope", "Gyroscope", "rad/s", record.gyro),
            ("Accelerometer", "Acceleration", "m/s^2", record.accel),
        ):
            names = ['"Time (s)"', *(f'"{head} {axis} ({unit})"' for axis in "xyz")]
            rows = (",".join(f"{x:.9E}" for x in row) for row in np.column_stack((record.time, values)).tolist())
            files.writestr(f"{name}.csv", "\n".join((",".join(names), *rows, "")))


def _sit_to_stand() -> undrift.SimulatedTrial:
    device, rng = _device()
    return undrift.simulate_trial("sit_to_stand", device, rng=rng)


def _straight(path: Path) -> None:
    """Make a walk along a straight line, in the device's own codes."""
    device, rng = _device()
    true, record = true_calibration(device, temp_c=25.0), walk(rng)
    raw = {}
    for name, quantity, model in (("gyro", "rate", true.gyro), ("accel", "accel", true.accel)):
        values = getattr(record, name) / si_factor(model.unit_out, quantity)
        raw |= {name: values @ model.forward_matrix.T + model.offset, f"{name}_unit": model.unit_in}
    undrift.write_record(replace(record, temp_c=np.full(len(record), 25.0), device=device.serial, **raw), path)


def _turned(path: Path) -> None:
    device, rng = _device()
    motion = draw_task("free", rng=rng).at(np.arange(3600) / 50.0, STANDARD_GRAVITY)
    undrift.write_record(_uncalibrated(undrift.simulate_device(device, motion, rng=rng).record), path)


def _bench() -> undrift.Session:
    device, rng = _device()
    return undrift.simulate_session("bench", device, rng=rng)


def _thermal(path: Path) -> None:
    device, rng = _device()
    settings = ThermalSettings(set_points_c=(18.0, 40.0, 60.0), bench=replace(BENCH, turn_rates=RATES))
    undrift.write_session(undrift.simulate_thermal_session("soak", device, rng=rng, settings=settings), path)


def _warm_up(path: Path) -> None:
    device, rng = _device()
    undrift.write_record(undrift.simulate_thermal_session("warm_up", device, rng=rng).records[0], path)


def _days(path: Path) -> None:
    """Make the recordings of four days, and days.json, a calibration of their device."""
    device, rng = _device()
    path.mkdir()
    for day in simulate_daily_use(device, rng=rng, settings=DailyUseSettings(days=4)):
        undrift.write_record(day.session.records[0], path / f"2026-01-0{day.number + 1}.parquet")
    undrift.write_calibration(undrift.calibrate(undrift.simulate_session("bench", device, rng=rng)), "days.json")


def _rest(path: Path) -> None:
    """Make a corrected recording of nearly five minutes at rest."""
    device, rng = _device()
    calibration = undrift.calibrate(undrift.simulate_session("bench", device, rng=rng))
    settings = BenchSettings(first_still_s=300.0)
    record = undrift.simulate_session("multi_position", device, rng=rng, settings=settings).records[0]
    raw = replace(record.between(record.time[0], record.time[0] + 290.0), device="", temp_c=None)
    undrift.write_record(undrift.correct(raw, calibration), path)


STUDY = """[study]
subjects = 3
sessions = ["hand"]
[[task]]
name = "step"
"""
FILES: dict[str, Callable[[Path], object]] = {
    "poses.csv": lambda path: undrift.write_record(_recording("multi_position"), path),
    "turns.csv": lambda path: undrift.write_record(_recording("ferraris"), path),
    "logger.csv": _logger,
    "monitor.txt": _monitor,
    "phone.zip": _phone,
    "walk.csv": lambda path: undrift.write_record(_sit_to_stand().record, path),
    "straight.csv": _straight,
    "turned.csv": _turned,
    "optics.csv": lambda path: write_reference(_sit_to_stand().reference, path),
    "warm_up.csv": _warm_up,
    "rest.csv": _rest,
    "calibration.json": lambda path: undrift.write_calibration(undrift.calibrate(_bench()), path),
    "session": lambda path: undrift.write_session(_bench(), path),
    "thermal": _thermal,
    "days": _days,
    "study.toml": lambda path: path.write_text(STUDY, encoding="utf-8"),
}
