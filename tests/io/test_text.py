"""CSV: what was written comes back to the bit, and each kind of bad input is one clear line."""

import gzip
import json

import numpy as np
import pytest

from testkit.column_maps import column_map
from testkit.strategies import assert_same, one_line
from undrift.errors import FileFormatError, InputError
from undrift.io import text
from undrift.io.column_map import READ_SETTINGS, ChannelScale, TextLayout
from undrift.io.columns import ReadResult, build_record
from undrift.io.text import Appender, read_csv, write_csv
from undrift.record import Record


def read_text(path, how=READ_SETTINGS) -> ReadResult:
    return build_record(read_csv(path, how), how)


XYZ = column_map(time="t", time_unit="s", accel=("x", "y", "z"), accel_unit="g")


def put(tmp_path, text, name="r.csv"):
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def rows(n=8, step=0.01):
    return [f"{k * step:.3f},0.1,{0.01 * k:.2f},1.0" for k in range(n)]


def table(lines, header="t,x,y,z"):
    return "\n".join([header, *lines]) + "\n"


def test_a_first_row_of_readings_is_no_header_and_is_not_lost(tmp_path):
    by_position = column_map(time=0, time_unit="s", accel=(1, 2, 3), accel_unit="g")
    for lines in (rows(34), [f"{row},2026-01-31 10:00:00" for row in rows(34)]):  # a date is no name either
        assert len(read_text(put(tmp_path, "\n".join(lines)), by_position).record) == 34
    numbered = read_text(
        put(tmp_path, table(rows(34), header="0,1,2,3")), by_position
    )  # as arrays are saved with a header
    assert len(numbered.record) == 34
    with pytest.raises(InputError, match="column 't', got '0', '1', '2', '3'"):
        read_text(put(tmp_path, "\n".join(rows())), XYZ)


@pytest.fixture
def pieces(monkeypatch):
    """Texts are parsed 64 bytes at a time; the sizes of the pieces."""
    sizes, parsed = [], text._parse_rows
    monkeypatch.setattr(text, "_PIECE", 64)
    monkeypatch.setattr(
        text, "_parse_rows", lambda *given, **how: sizes.append(len(bytes(given[1]))) or parsed(*given, **how)
    )
    return sizes


@pytest.mark.parametrize("name", ["r.csv", "r.csv.gz"])
def test_a_text_in_pieces_reads_as_in_one(tmp_path, pieces, monkeypatch, name):
    lines = [f'"{row}"'.replace(",", '","') if k % 3 else row for k, row in enumerate(rows(40))]
    content = "\n".join(["\ufefft,x,y,z", *lines[:20], *[""] * 100, *lines[20:]]).encode()
    path = put(tmp_path, gzip.compress(content) if name.endswith("gz") else content, name)
    several = read_text(path, XYZ).record
    assert len(pieces) > 10
    assert max(pieces) <= 64
    monkeypatch.setattr(text, "_PIECE", 1 << 24)
    assert_same(read_text(path, XYZ).record, several)
    assert len(several) == 40


@pytest.mark.parametrize("bad", ["0.2,0.1,0.1", '0.2,"0.1,0.1,0.1', "0.2,0.1,?,0.1"])
def test_a_bad_row_of_a_later_piece_is_named_by_its_place(tmp_path, pieces, bad):
    path = put(tmp_path, table([*rows(30), bad, *rows(40)[31:]]))
    with pytest.raises(FileFormatError, match="in data row 31 "):
        read_text(path, XYZ)
    assert read_text(path, XYZ.but(drop_bad_rows=True)).dropped_rows == 1


CORRECTED = Record(time=[0.0, 1.0], gyro=np.zeros((2, 3)), state="corrected", frame="b", device="A;\n1")


def test_a_corrected_file_is_a_plain_table_and_says_so_beside_it(tmp_path):
    write_csv(CORRECTED, tmp_path / "r.csv")
    assert (tmp_path / "r.csv").read_text().splitlines()[0] == "time_s,gyro_x_rad_s,gyro_y_rad_s,gyro_z_rad_s"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["r.csv", "r.csv.json"]
    back = read_text(tmp_path / "r.csv").record
    assert (back.state, back.frame, back.device) == ("corrected", "b", "A;\n1")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"format": 2}, r"undrift\.record format 1, got format"),
        ({"state": "cooked"}, "frame, state and device of a recording, got other"),
        ({"columns": {"time_s": "s"}}, "belongs to another table"),
    ],
)
def test_a_statement_beside_a_table_that_does_not_fit_it_is_refused(tmp_path, change, said):
    write_csv(CORRECTED, tmp_path / "r.csv")
    beside = tmp_path / "r.csv.json"
    beside.write_text(json.dumps(json.loads(beside.read_text()) | change))
    with pytest.raises(FileFormatError, match=said):
        read_text(tmp_path / "r.csv")


def test_units_and_scales_are_applied_as_the_map_says(tmp_path):
    path = put(tmp_path, "ms,a,b,c,T\n1000,16384,0,-16384,-8884\n1010,0,0,0,-2614\n")
    columns = column_map(
        time="ms",
        time_unit="ms",
        accel=("a", "b", "c"),
        accel_unit="g",
        accel_scale=ChannelScale((1 / 16384, 1 / 16384, -1 / 16384), (0.0, 0.5, 0.0)),
        temp="T",
        temp_unit="degC",
        temp_scale=ChannelScale(1 / 340, 36.53),
    )
    record = read_text(path, columns).record
    np.testing.assert_allclose(record.time, [1.0, 1.01])
    np.testing.assert_allclose(record.accel, [[1.0, 0.5, 1.0], [0.0, 0.5, 0.0]])
    np.testing.assert_allclose(record.temp_c, [10.40058824, 28.84176471])


def test_positions_blanks_tabs_and_decimal_commas_are_read(tmp_path):
    blanks = put(tmp_path, "  0.00   1e0  2 \t 3 \r\n  0.01   4.  5   6\r\n", "b.txt")
    record = read_text(
        blanks,
        column_map(time=0, time_unit="s", gyro=(1, 2, 3), gyro_unit="dps", delimiter=" ", header=False),
    ).record
    np.testing.assert_array_equal(record.gyro, [[1, 2, 3], [4, 5, 6]])
    commas = put(tmp_path, "t;x;y;z\n0,0;1,5;2,5;3,5\n0,1;1;2;3\n", "c.csv")
    layout = TextLayout(delimiter=";", decimal=",")
    record = read_text(
        commas, column_map(time="t", time_unit="s", accel=("x", "y", "z"), accel_unit="g", layout=layout)
    ).record
    np.testing.assert_array_equal(record.accel, [[1.5, 2.5, 3.5], [1, 2, 3]])


def test_broken_rows_are_dropped_on_request_and_counted_and_their_time_is_kept(tmp_path):
    text = "log started\n0,0,1\n0,0,1,5\n0,0,bad,5\n0,0,1,5\n0,0\n"
    path = put(tmp_path, text)
    layout = TextLayout(header=False, drop_bad_rows=True)
    columns = column_map(gyro=(0, 1, 2), gyro_unit="dps", temp=3, temp_unit="degC", sample_rate_hz=10.0, layout=layout)
    built = read_text(put(tmp_path, text + "0,0,1,5\n" * 9), columns)
    assert built.dropped_rows == 4
    assert len(built.record) == 11
    # rows 3 and 5 of the file are good, row 4 is not: their distance is two samples
    assert built.record.time[:2].tolist() == pytest.approx([0.0, 0.2])
    with pytest.raises(FileFormatError, match="4 columns in every row, got 1 in data row 1"):
        read_text(path, column_map(gyro=(0, 1, 2), gyro_unit="dps", sample_rate_hz=10.0, header=False))


def test_a_last_row_without_a_line_end_is_read_and_noted(tmp_path):
    lines = [f"{k * 0.01:.3f},0.125,0.250,{k:.3f}" for k in range(20)]
    whole = table(lines).rstrip("\n")
    for content in (whole, whole[:-1]):  # trailing zeros may be stripped on purpose
        found = read_text(put(tmp_path, content), XYZ)
        assert len(found.record) == 20
        assert found.notes == ("the last row has no line end: it may be cut",)
    assert read_text(put(tmp_path, whole + "\n"), XYZ).notes == ()
    with pytest.raises(FileFormatError, match="columns in every row"):
        read_text(put(tmp_path, whole[: -len("0.250,19.000") - 1]), XYZ)


def test_time_that_goes_back_is_repaired_on_request_and_counted(tmp_path):
    lines = rows(40)
    lines[7] = "0.000" + lines[7][5:]
    lines[20] = lines[19]
    path = put(tmp_path, table(lines))
    with pytest.raises(InputError, match=r"2 steps that go back or repeat, first in data row 8 \(back") as caught:
        read_text(path, XYZ)
    one_line(caught)
    repaired = column_map(time="t", time_unit="s", accel=("x", "y", "z"), accel_unit="g", repair_time=True)
    built = read_text(path, repaired)
    assert built.repaired_rows == 2
    assert len(built.record) == 38
    assert (np.diff(built.record.time) > 0).all()


BAD = [
    ("text", table([*rows(), "0.080,0.1,abc,1.0"]), FileFormatError, "column 'y': expected numbers, got 'abc' in data row 9"),
    ("short row", table([*rows(), "0.080,0.1"]), FileFormatError, "4 columns in every row, got 2 in data row 9"),
    (
        "wild value", table([*rows(), "0.080,1e9,0,1"]), FileFormatError,
        "expected readings up to 2000 g, got 1e\\+09 in data row 9",
    ),
    ("wrong column", table(rows(), "t,x,y,q"), InputError, "column 'z', got 't', 'x', 'y', 'q'"),
    ("doubled name", table([f"{r},1" for r in rows()], "t,x,y,z,z"), InputError, "expected one column 'z', got 2"),
    ("empty file", "", FileFormatError, "got an empty file"),
    ("header only", "t,x,y,z\n", FileFormatError, "expected two rows or more, got 0"),
    ("no time", table(["0,1,2,3", ",1,2,3", "2,1,2,3"]), InputError, "time column 't': .* got 1 empty or NaN cells"),
    ("text time", table(["0,1,2,3", "noon,1,2,3"]), FileFormatError, "column 't': expected numbers, got 'noon' in data row 2"),
    (
        "not utf-8", "t,x,y,z\xb0\n0,1,2,3\n".encode("latin-1"), FileFormatError,
        "expected UTF-8 text, got byte 0xb0 in the header",
    ),
    ("utf-16", table(rows()).encode("utf-16"), FileFormatError, "got binary data or UTF-16"),
    ("bytes in a cell", b"t,x,y,z\n0,1,\xb0,3\n1,1,2,3\n", FileFormatError, "column 'y':"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "kind", "words"), [case[1:] for case in BAD], ids=[case[0] for case in BAD])
def test_bad_input_is_one_clear_line_that_names_file_column_and_row(tmp_path, text, kind, words):
    path = put(tmp_path, text)
    with pytest.raises(kind, match=words) as caught:
        read_text(path, XYZ)
    assert str(path) in one_line(caught)


def test_two_rates_in_one_file_are_refused_however_they_show(tmp_path):
    time = np.concatenate((np.arange(200) * 0.01, 2.0 + np.arange(200) * 0.02))
    path = put(tmp_path, table([f"{t:.3f},0,0,1" for t in time]))
    with pytest.raises(InputError, match="expected one sample rate, got 100 Hz and then 50 Hz from 2"):
        read_text(path, XYZ)
    half = put(tmp_path, table([f"{0.01 * k:.3f},{k if k % 2 == 0 else ''},0,1" for k in range(40)]), "h.csv")
    with pytest.raises(InputError, match="filled in every 2th row only: two rates in one file"):
        read_text(half, XYZ)


def test_jitter_and_drop_outs_are_not_two_rates(tmp_path):
    rng = np.random.default_rng(3)
    time = np.cumsum(0.017 + 0.001 * rng.integers(-1, 2, 600) + 2.8 * (np.arange(600) % 170 == 169))
    record = read_text(put(tmp_path, table([f"{t:.4f},0,0,1" for t in time])), XYZ).record
    assert len(record) == 600


def test_an_appended_table_is_whole_after_each_piece_and_never_written_over(tmp_path):
    rng = np.random.default_rng(4)
    record = Record(
        time=np.arange(30) / 10.0, gyro=rng.normal(size=(30, 3)), accel=rng.normal(size=(30, 3)), gyro_unit="dps"
    )
    path = tmp_path / "a.csv"
    with Appender(path) as file:
        assert not path.exists()
        for start in (0, 7, 19):
            file.write(record.part(start, {0: 7, 7: 19, 19: 30}[start]))
            assert len(read_text(path).record) == {0: 7, 7: 19, 19: 30}[start]
    made = read_text(path).record
    np.testing.assert_array_equal(made.gyro, record.gyro)
    np.testing.assert_array_equal(made.accel, record.accel)
    with Appender(path) as again, pytest.raises(InputError, match="File exists"):
        again.write(record)
    assert len(read_text(path).record) == 30


# ---- what a map leaves unused is reported


def test_a_row_of_readings_that_a_map_skips_is_reported(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("0.01,0.02,9.81\n" * 4)
    how = column_map(accel=(0, 1, 2), accel_unit="m/s2", sample_rate_hz=100.0, header=False, skip_rows=1)
    assert read_text(path, how).notes == ("line 1 is left out by skip_rows and looks like a row of readings",)
    path.write_text("log of 3 March, 10:00\n" + "0.01,0.02,9.81\n" * 4)
    assert read_text(path, how).notes == ()


@pytest.mark.parametrize("name", ["a.csv", "a.csv.gz"])
def test_a_time_column_that_a_map_does_not_name_is_reported(tmp_path, name):
    content = b"t_ms,ax,ay,az\n" + b"".join(b"%d,0,0,1\n" % (20 * k) for k in range(4))
    (tmp_path / name).write_bytes(gzip.compress(content) if name.endswith(".gz") else content)
    keys = {"accel": ("ax", "ay", "az"), "accel_unit": "g", "sample_rate_hz": 100.0}
    (note,) = read_text(tmp_path / name, column_map(**keys)).notes
    assert "'t_ms'" in note
    assert (
        read_text(tmp_path / name, column_map(**keys | {"sample_rate_hz": 50.0}, time="t_ms", time_unit="ms")).notes
        == ()
    )
