"""undrift calibrate --live: a device is calibrated while a person moves it, and nothing that it sent is lost."""

import json
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from testkit.guided_motion import guided_recording
from testkit.printing_board import ACCEL_LSB_PER_G, GYRO_LSB_PER_DPS, PrintingBoard, sketch_line
from testkit.talking_device import TalkingDevice
from testkit.terminal import Terminal, on
from testkit.waiting import eventually
from undrift.cli import common
from undrift.commands import live_motion
from undrift.io.formats import read_record
from undrift.io.store import read_calibration

SPEED = 10.0
MAIN = """
import signal
signal.signal(signal.SIGINT, signal.default_int_handler)  # whatever the shell of the tests ignores
from undrift.cli.app import main
main()
"""


class TurnedTalker(TalkingDevice):
    """Sends a recording of a device that a person turns, faster than it was made; then it rests where it was."""

    def __init__(self, rows: np.ndarray, speed: float = SPEED) -> None:
        rest = np.concatenate((rows[:400, :3].mean(axis=0), rows[-1, 3:]))
        lines = [",".join(f"{value:.6f}" for value in row) + ",25.0" for row in (*rows, rest)]
        self.speed = speed
        super().__init__(100.0 * speed, lambda k: lines[min(k, len(lines) - 1)])

    @property
    def address(self) -> str:
        """What to connect to, by the device's own rate."""
        stated = super().address.replace(f"rate={100.0 * self.speed:g}", "rate=100")
        return f"{stated}&clock_speed={self.speed:g}"


@pytest.fixture
def turned(request: pytest.FixtureRequest) -> Iterator[TurnedTalker]:
    record, _ = guided_recording(0, 5)
    readings = np.hstack((np.degrees(record.gyro), np.asarray(record.accel)))
    with TurnedTalker(readings, speed=getattr(request, "param", SPEED)) as device:
        yield device


@pytest.fixture(autouse=True)
def _quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live_motion, "LOOK_S", 0.5)


GRAVITY = ("--gravity-m-s2", "9.80665")


@pytest.mark.slow
def test_a_board_is_calibrated_without_a_word_about_it(undrift, tmp_path):
    record, _ = guided_recording(0, 5)
    gyro, accel = np.degrees(record.gyro) * GYRO_LSB_PER_DPS, np.asarray(record.accel) / 9.80665 * ACCEL_LSB_PER_G

    def line(k: int) -> bytes:
        k = min(k, len(gyro) - 1)
        return sketch_line(k, 10_000 * k, gyro[k], accel[k], 25.0)

    with PrintingBoard() as board:
        board.print_lines(line)
        answer = undrift("calibrate", "--live", board.port, "-o", tmp_path / "c.json", "--live-s", "4", "--json")
    printed = answer.json()
    made = read_record(tmp_path / "c.parquet")
    assert (made.gyro_unit, made.accel_unit, round(made.sample_rate_hz)) == ("count", "count", 100)
    assert made.duration_s > 3.0
    assert answer.code == 2, "4 s are too short for a fit"
    assert "wanted" in printed["error"]["text"]


@pytest.mark.slow
def test_collecting_stops_by_itself_and_the_calibration_is_that_of_the_readings(undrift, tmp_path, turned):
    made = tmp_path / "c.json"
    answer = undrift("calibrate", "--live", turned.address, "-o", made, *GRAVITY, "--live-s", "2000", "--json")
    printed = answer.json()
    assert (answer.code, printed["live"]["ended"]) == (0, "enough"), answer
    print(f"  stopped by itself after {printed['live']['seconds']:.0f} s of the device")
    assert printed["live"]["seconds"] > 40.0  # how soon depends on how busy the machine is
    lines = answer.err.splitlines()
    assert "s. First figures after 20 s; turn it slowly in the hand about every axis" in lines[0]
    assert any("of 18 elements known well enough. Next: " in line for line in lines)
    assert lines[-1] == f"Wrote {tmp_path / 'c.parquet'}"
    assert len(printed["elements"]) == 18
    assert all(one["uncertainty"] <= 1.2 * one["wanted"] for one in printed["elements"])  # at its last but one look
    recording = read_record(tmp_path / "c.parquet")
    assert recording.duration_s == pytest.approx(printed["live"]["seconds"], abs=20.0)
    again = undrift.good(
        "calibrate", tmp_path / "c.parquet", "--from", "motion", *GRAVITY, "-o", tmp_path / "d.json", "--json"
    )
    np.testing.assert_array_equal(read_calibration(made).gyro.matrix, read_calibration(tmp_path / "d.json").gyro.matrix)
    assert again.json()["elements"] == printed["elements"]
    assert "live" not in again.json()
    words = undrift.good("calibrate", tmp_path / "c.parquet", "--from", "motion", *GRAVITY, "--details").out
    assert "Known to, 95 %" in words
    assert "accelerometer cross-axis" in words


def test_ctrl_c_ends_collecting_and_the_readings_are_calibrated(undrift, tmp_path, turned, monkeypatch):
    slept: list[float] = []

    def sleep(seconds: float) -> None:
        slept.append(seconds)
        if len(slept) == 6:
            raise KeyboardInterrupt
        time.sleep(seconds)

    monkeypatch.setattr(live_motion, "time", type("Clock", (), {"sleep": sleep, "monotonic": time.monotonic}))
    answer = undrift("calibrate", "--live", turned.address, "-o", tmp_path / "c.json", *GRAVITY, "--json")
    assert (answer.code, answer.json()["live"]["ended"]) == (0, "stopped")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["c.json", "c.parquet"]


@pytest.mark.slow
@pytest.mark.parametrize("turned", [1.0], indirect=True)  # a busy computer hears of it seconds later
def test_ctrl_c_too_early_keeps_the_readings_and_says_what_is_missing(tmp_path, turned):
    words = ("calibrate", "--live", turned.address, "-o", "c.json")
    call = [sys.executable, "-c", MAIN, *words, "--json"]
    with subprocess.Popen(call, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as child:
        eventually((tmp_path / "c.parquet.part").exists, "a file of readings", 30.0)
        child.send_signal(signal.SIGINT)
        out, err = child.communicate(timeout=60)
    assert child.returncode == 2, err
    assert "wanted 20 s or more without gaps, got" in json.loads(out)["error"]["text"]
    assert "Wrote c.parquet" in err
    assert read_record(tmp_path / "c.parquet").duration_s < 20.0
    assert not (tmp_path / "c.json").exists()


@pytest.mark.slow
def test_the_time_ends_it_and_readings_are_never_written_over(undrift, tmp_path, turned):
    (tmp_path / "c.parquet").write_bytes(b"earlier")
    words = ("calibrate", "--live", turned.address, "-o", tmp_path / "c.json", "--live-s", "25", "--json")
    printed = undrift(*words).json()
    assert printed["live"]["ended"] == "time"
    assert 25.0 <= printed["live"]["seconds"] < 60.0
    assert printed["live"]["recording"] == str(tmp_path / "c-2.parquet")
    assert (tmp_path / "c.parquet").read_bytes() == b"earlier"


@pytest.mark.slow
def test_a_device_that_sends_codes_is_calibrated_with_gains_and_without(undrift, tmp_path):
    record, _ = guided_recording(0, 1)
    codes = np.round(np.hstack((np.degrees(record.gyro) / 0.061, np.asarray(record.accel) / 9.80665 * 4096.0)))
    without, with_gains = "gyro_unit=count&accel_unit=count", f"accel_unit=g&gyro_gain=0.061&accel_gain={1.0 / 4096.0}"
    for stated, instead, unit, scale in (
        ("gyro_unit=dps&accel_unit=m/s2", without, "count", np.radians(0.061)),
        ("accel_unit=m/s2", with_gains, "dps", np.radians(1.0)),
    ):
        with TurnedTalker(codes, speed=4.0) as device:  # no gaps on a busy machine
            address = device.address.replace(stated, instead)
            words = ("calibrate", "--live", address, "-o", tmp_path / f"{unit}.json", "--live-s", "40", "--json")
            gyro = undrift(*words).json()["gyro"]
            assert gyro["unit_in"] == unit
            assert gyro["matrix"][0][0] == pytest.approx(scale, rel=0.05)


@pytest.mark.parametrize(
    ("words", "wanted"),
    [
        ((), "calibrate: wanted recordings or a device, got neither; name files, or --live ADDRESS"),
        (("a.csv", "--live-s", "20"), "got settings of --live alone"),
        (("a.csv", "--live", "udp://:9", "-o", "c.json"), "--live: wanted a device alone and --output, got a.csv too"),
        (("--live", "udp://:9"), "--live: wanted a device alone and --output, got no name for what it makes"),
        (("--live", "udp://:9", "-o", "c.json", "--enough-percent", "0"), "got 300 s and 0 %"),
    ],
)
def test_what_cannot_be_collected_is_refused_before_a_device_is_opened(undrift, tmp_path, words, wanted):
    assert wanted in undrift.refused("calibrate", *(tmp_path / one if one == "c.json" else one for one in words))


def test_a_table_stays_on_a_terminal_and_a_log_has_its_head_once_a_step(capsys):
    place, screen = Terminal(), common.Terminal()
    with on(place, 60):
        screen.over("20 s\nNext: turn it\n\nx 0.5\ny 0.7", step=4)
        screen.over("25 s\nNext: turn it\n\nx 0.4", step=5, last=True)
        screen.over("over")
    first, second, third = place.getvalue().split("\x1b[J")[1:]
    assert first == "20 s\nNext: turn it\n\nx 0.5\ny 0.7\r\x1b[4A"
    assert second == "25 s\nNext: turn it\n\nx 0.4\n\r"
    assert third == "over"
    for step in (4, 4, 5):
        screen.over(f"{step} s\nNext: turn it\n\nx 0.4", step=step)
    assert capsys.readouterr().err == "4 s. Next: turn it\n5 s. Next: turn it\n"


def test_bars_are_full_where_an_element_is_known_well_enough() -> None:
    class Source:
        error = ""

        def updates(self, after: int = 0) -> list[object]:
            return []

        def write_to(self, path: Path) -> None:
            self.path = path

    from undrift.calibration.live_motion import ElementKnown

    watch = live_motion.MotionWatch(Source(), Path("c.parquet"), lambda _: None, live_motion.Place(), 0.5)  # type: ignore[arg-type, return-value]
    three = [
        ElementKnown(name="gyroscope scale", axis=axis, uncertainty=u, wanted=0.5, unit="%", movement=f"turn {axis}")
        for axis, u in (("x", 0.4), ("y", 0.7), ("z", 2.0))
    ]
    watch.elements, watch._words = tuple(three), ""
    assert watch.words == "0 s: 1 of 3 elements known well enough\nNext: turn z"
    (row,) = [*watch.table()][1:]
    assert row.split() == ["gyroscope", "scale", "0.5", "%", "x", "███", "0.4", "y", "██·", "0.7", "z", "···", "2"]
