"""Logs of serial ports: the shapes that firmware prints are read right, or with the one question that they leave open."""

import json

import numpy as np
import pytest

from testkit.firmware import Motion, Shape, motion, shapes
from undrift.errors import InputError
from undrift.io.column_map import ColumnMap, read_map
from undrift.io.columns import ReadResult
from undrift.io.formats import format_of, read_counted
from undrift.io.inspect import describe
from undrift.io.log import find_readings, names_of
from undrift.units import si_factor

SHAPES = shapes()
REFUSED = {"header_again": "drop_bad_rows"}  # and the mend that the refusal names
DIGITS = {"rate": 0.006, "accel": 0.006}  # rad/s, m/s2: half of the last digit that the coarsest shape prints


def read_as_proposed(path) -> tuple[ReadResult, set[str]]:
    """Read a file by what info proposes, and answer the rate where it asks; return what it asked too."""
    found = describe(path)
    if found.kind == "recording":
        return read_counted(path), set()
    if not found.example:
        assert "sample rate" in found.summary, found.summary
        return read_counted(path, ColumnMap(sample_rate_hz=100.0)), {"rate"}
    asks = {"rate"} if "sample_rate_hz = ?" in found.example else set()
    text = found.proposal.text(found.path, sample_rate_hz=100.0)
    where = path.with_name("map.toml")
    where.write_text(text)
    return read_counted(path, read_map(where)), asks | ({"units"} if '"?"' in text else set())


@pytest.mark.parametrize("shape", [one for one in SHAPES if one.name not in REFUSED], ids=lambda one: one.name)
def test_a_shape_is_read_right_with_one_question_at_most(shape: Shape, tmp_path):
    path = tmp_path / "capture.log"
    path.write_bytes(shape.text.encode())
    read, asks = read_as_proposed(path)
    assert asks == {"rate"} & set(shape.asks.split())
    made, record = motion(), read.record
    assert record.device == ""
    assert np.median(np.diff(record.time)) == pytest.approx(0.01, abs=1e-6)
    assert np.ptp(record.time) == pytest.approx(19.99, abs=0.011)
    rows = np.round((record.time - record.time[0]) / 0.01).astype(int)
    assert len(record) + read.dropped_rows == len(made.time)
    for quantity, unit, values, true in _triads(record, made):
        if unit == "count":
            assert "scale" in shape.asks
            factor = float((values * true[rows]).sum() / (values * values).sum())
        else:
            factor = si_factor(unit, quantity)
        np.testing.assert_allclose(values * factor, true[rows], atol=DIGITS[quantity])
    if record.temp_c is not None:
        np.testing.assert_allclose(record.temp_c, made.temp[rows], atol=0.0051)


def _triads(record, made: Motion):
    assert record.gyro is not None
    assert record.accel is not None
    yield "rate", record.gyro_unit, record.gyro, made.gyro
    yield "accel", record.accel_unit, record.accel, made.accel


@pytest.mark.parametrize("name", REFUSED)
def test_a_shape_that_is_refused_names_the_mend(name: str, tmp_path):
    path = tmp_path / "capture.txt"
    path.write_bytes(next(one.text for one in SHAPES if one.name == name).encode())
    with pytest.raises(InputError, match=REFUSED[name]):
        read_as_proposed(path)


@pytest.mark.parametrize(
    "text",
    [
        "# undrift\n\nMeasured 2 devices in 3 rooms.\nIt took 5 days.\n" * 4,
        "2026-11-27 10:00:01,0.1,0.2,9.8\n" * 40,
        "time,ax,ay,az,label\n" + "".join(f"{k},0.1,0.2,9.8,walk\n" for k in range(40)),
        "1,2,3\n" * 3,
        "0.1,0.2,9.8\n" * 20 + "0.1,0.x,9.8\n" + "0.1,0.2,9.8\n" * 20,
    ],
    ids=["prose", "dates", "labels", "short", "damaged"],
)
def test_what_is_no_log_is_none(text: str, tmp_path):
    path = tmp_path / "other.txt"
    path.write_text(text)
    assert format_of(path)[0] != "log"


def test_lines_that_are_lost_are_counted_and_a_last_line_without_end_is_left_out():
    lines = [f"a/g:\t{k}\t2\t3\t4\t5\t6\n" for k in range(20)]
    lines[7] = "a/g:\t7\t2\n"
    log = find_readings(("boot 5\n" + "".join(lines))[:-2].encode())
    assert log is not None
    assert (log.before, log.lost, log.content.count(b"\n")) == (1, 2, 18)


@pytest.mark.parametrize(("damage", "lost"), [("", 0), ("at the end of each line", 0), ("over an end of line", 1)])
def test_zeros_over_readings_are_lost_readings_and_zeros_behind_lines_are_none(damage: str, lost: int):
    end = "\0\n" if damage == "at the end of each line" else "\n"
    lines = [f"{k}.5 -{k}.25 9.81{end}" for k in range(20)]
    if damage == "over an end of line":
        lines[7] = "7.5" + "\0" * 12
    log = find_readings("".join(lines).encode())
    assert (log.lost, log.content.count(b"\n")) == (lost, 20 - 2 * lost)


def test_a_clock_goes_on_past_midnight():
    def line(k: int) -> str:
        s = 86399.8 + 0.1 * k
        return f"{int(s // 3600) % 24:02d}:{int(s // 60) % 60:02d}:{s % 60:06.3f} -> 0.1 0.2 9.8\n"

    log = find_readings("".join(map(line, range(12))).encode())
    assert log is not None
    times = [float(row.split(b",")[0]) for row in log.content.splitlines()]
    np.testing.assert_allclose(np.diff(times), 0.1, atol=1e-6)


@pytest.mark.parametrize(
    ("shape", "names"),
    [
        (
            ("", "Acceleration X:", ", Y:", ", Z:", "m/s^2"),
            ["Acceleration x (m/s^2)", "Acceleration y (m/s^2)", "Acceleration z (m/s^2)"],
        ),
        (("", "a/g:", "", "", "", "", "", ""), ["acc x", "acc y", "acc z", "gyr x", "gyr y", "gyr z"]),
        (("", '{"acc": [', ",", ",", '], "t":', "}"), ["acc x", "acc y", "acc z", "t"]),
        (("Accelerometer", "X =", ""), ["Accelerometer x"]),
        (("Thermometer", "Degrees C =", ""), ["Thermometer (Degrees C)"]),
        (("", "IMU,", ",", ",", ",", ""), ["", "", "", ""]),
        (("", "q0:", "q1:", ""), ["q0", "q1"]),
    ],
)
def test_words_around_numbers_name_them(shape, names):
    assert names_of(shape) == names


def test_lines_of_json_are_a_log_by_any_name_and_a_document_is_none(tmp_path):
    lines = [
        json.dumps({"t_ms": 10 * k, "ax": 0.01, "ay": 0.02, "az": 9.81, "gx": 0.1, "gy": 0.2, "gz": 0.3})
        for k in range(50)
    ]
    for name in ("log.json", "log.jsonl", "log.txt"):
        (tmp_path / name).write_text("\n".join(lines) + "\n")
        assert format_of(tmp_path / name)[0] == "log", name
    (tmp_path / "one.json").write_text("{}\n")
    (tmp_path / "whole.json").write_text('{"a": {"b": 1},\n"c": 2}\n')
    assert {format_of(tmp_path / name)[0] for name in ("one.json", "whole.json")} == {"json"}
