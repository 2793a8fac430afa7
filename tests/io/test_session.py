"""session.toml: reads what DESIGN says, names line and entry of what is wrong, and comes back as it was written."""

import errno
import os
from dataclasses import replace

import numpy as np
import pyarrow.parquet as pq
import pytest

from testkit.column_maps import column_map
from testkit.strategies import assert_same, one_line
from undrift.errors import FileFormatError, InputError
from undrift.files import sha256_of
from undrift.io.column_map import ChannelScale, ColumnMap, file_map_of, read_map
from undrift.io.parquet import write_parquet
from undrift.io.session import read_session, sealed, session_from_files, write_session
from undrift.io.text import write_csv
from undrift.record import RateTable, Record, Session, Still, TemperatureSensitivity, Turn
from undrift.units import gravity_at

HEAD = '[session]\nkind = "calibration"\nserial = "MTi-1"\ngravity_m_s2 = 9.81\n'
FULL = """[session]
kind = "calibration"                # calibration | thermal | static
serial = "MTi-1"
gravity_m_s2 = 9.80665
[[recording]]
file = "session.csv"
sample_rate_hz = 100.0
columns = { time = "t", gyro = ["gx", "gy", "gz"], accel = ["ax", "ay", "az"], temp = "T" }
units = { time = "s", gyro = "dps", accel = "m/s2", temp = "degC" }
[[still]]
recording = 0
face = "+x"
start_s = 1.0
stop_s = 1.6
[[turn]]
axis = "z"
turn_rate_dps = 90.0
start_s = 2.0
stop_s = 2.5
temp_c = 25.0
[[turn]]
angle_deg = -360.0
start_s = 3
stop_s = 4
"""


def folder(tmp_path, text=FULL, n=500):
    lines = ["t,gx,gy,gz,ax,ay,az,T", *(f"{k / 100:.2f},1,2,3,0,0,9.8,25" for k in range(n))]
    (tmp_path / "session.csv").write_text("\n".join(lines) + "\n")
    (tmp_path / "session.toml").write_text(text)
    return tmp_path


def test_the_session_of_the_design_reads_as_it_says(tmp_path):
    session = read_session(folder(tmp_path))
    assert (session.kind, session.serial, session.gravity_m_s2) == ("calibration", "MTi-1", 9.80665)
    assert session.stills == (Still(start=100, stop=160, face="+x"),)
    steady, known = session.turns
    assert (steady.start, steady.stop, steady.axis, steady.temp_c) == (200, 250, "z", 25.0)
    assert steady.turn_rate == pytest.approx(np.pi / 2)
    assert (known.start, known.stop, known.axis, known.turn_rate) == (300, 400, None, None)
    assert known.angle == pytest.approx(-2 * np.pi)
    assert session.inputs == tuple((name, sha256_of(tmp_path / name)) for name in ("session.toml", "session.csv"))
    assert_same(read_session(tmp_path / "session.toml").records[0], session.records[0])


def test_gravity_that_nobody_stated_is_assumed_and_is_not_stated_by_writing_it_down(tmp_path):
    session = read_session(folder(tmp_path, FULL.replace("gravity_m_s2 = 9.80665\n", "")))
    assert (session.gravity_m_s2, session.gravity_source) == (9.80665, "standard")
    write_session(session, tmp_path / "again")
    assert "gravity" not in (tmp_path / "again" / "session.toml").read_text()
    assert read_session(tmp_path / "again").gravity_source == "standard"


def test_gravity_comes_from_latitude_and_height(tmp_path):
    text = FULL.replace("gravity_m_s2 = 9.80665", "latitude_deg = 41.9\nheight_m = 50")
    assert read_session(folder(tmp_path, text)).gravity_m_s2 == gravity_at(41.9, 50.0)


def test_native_files_need_no_columns_and_files_side_by_side_are_joined(tmp_path):
    record = Record(time=np.arange(50) / 100, gyro=np.ones((50, 3)), accel=np.full((50, 3), 2.0))
    write_csv(record, tmp_path / "native.csv")
    for name, value in (("acc.txt", 33000), ("gyro.txt", 32000)):
        (tmp_path / name).write_text(
            "".join(f"  {k / 100:.2f}   {value}  {value + 1}   {value + 2}\n" for k in range(50))
        )
    (tmp_path / "session.toml").write_text(
        HEAD
        + '[[recording]]\nfile = "native.csv"\n[[recording]]\nfile = ["acc.txt", "gyro.txt"]\ndelimiter = " "\nheader = false\n'
        "columns = [{ time = 0, accel = [1, 2, 3] }, { time = 0, gyro = [1, 2, 3] }]\n"
        'units = { time = "s", accel = "count", gyro = "count" }\n'
    )
    session = read_session(tmp_path)
    assert_same(session.records[0], record)
    both = session.records[1]
    assert (both.gyro_unit, both.accel_unit) == ("count", "count")
    assert both.accel[0].tolist() == [33000, 33001, 33002]
    assert both.gyro[0].tolist() == [32000, 32001, 32002]
    assert [name for name, _ in session.inputs] == ["session.toml", "native.csv", "acc.txt", "gyro.txt"]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('face = "+x"', 'fase = "+x"', r"line 12: \[\[still\]\] 1, fase: this key is unknown"),
        ('face = "+x"', 'face = "up"', r"line 12: \[\[still\]\] 1, face:"),
        (
            "angle_deg = -360.0", "angle_deg = 1\nturn_rate_dps = 2",
            r"line 21: \[\[turn\]\] 2: expected turn_rate_dps or angle_deg",
        ),
        ("angle_deg = -360.0", "angle_deg = 0", r"line 21: \[\[turn\]\] 2: expected angle_deg other than 0, got 0\."),
        ("temp_c = 25.0", "temp_c = -300.0", r"greater than or equal to -273\.15, got -300\.0"),
        ("gravity_m_s2 = 9.80665", "latitude_deg = 200.0\nheight_m = 0", "latitude_deg: expected -90 to 90 deg, got 200. South"),
        ("stop_s = 1.6\n", "", r"line 10: \[\[still\]\] 1, stop_s: this key is missing"),
        ("stop_s = 1.6", "stop_s = 99", "0 <= start_s < stop_s <= 5 s"),
        (
            "start_s = 1.0\nstop_s = 1.6",
            "start_s = 1.001\nstop_s = 1.005",
            "expected a sample between 1.001 and 1.005 s",
        ),
        ("recording = 0", "recording = 3", r"\[\[still\]\] 1: expected recording 0 to 0, got 3"),
        (
            'kind = "calibration" ', 'kind = "party"',
            "'calibration', 'thermal' or 'static'",
        ),
        ("gravity_m_s2 = 9.80665", "latitude_deg = 40.0", "got the latitude only"),
        ("gravity_m_s2 = 9.80665", "gravity_m_s2 = 980.665", "between 9.7 and 9.9"),
        ('gyro = "dps"', 'gyro = "dsp"', r"line 5: \[\[recording\]\] 1: unit of rate:"),
        ('temp = "T"', 'tmp = "T"', r"line 8: \[\[recording\]\] 1, columns, tmp: this key is unknown"),
        (
            "sample_rate_hz = 100.0", "sample_rate_hz = 50.0",
            r"\[\[recording\]\] 1: .*session.csv: expected the specified 50 Hz, got 100 Hz",
        ),
        ('"session.csv"', '"other.csv"', r"\[\[recording\]\] 1: .*other.csv: there is no file with this name"),
        ('"session.csv"', '["session.csv", "session.csv"]', "expected one table of columns for each file, got 1 for 2 files"),
        (
            "[[recording]]", "[rate_table]\nwobble_deg = 11\n[[recording]]",
            r"line 5: rate_table: .*expected wobble_deg from 0 to 10, got 11",
        ),
        (
            "[[recording]]", "[temperature]\nspan_limit_k = -1\n[[recording]]",
            r"line 5: temperature: .*expected span_limit_k from 0 to 100, got -1",
        ),
        ("[session]", "[session", "expected TOML, got .*line 1"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named_by_line_and_entry(tmp_path, old, new, words):
    assert old in FULL
    with pytest.raises(InputError, match=words) as caught:
        read_session(folder(tmp_path, FULL.replace(old, new, 1)))
    assert "session.toml" in one_line(caught)


def write_axes(folder, axes="xyz"):
    """Write a file for each axis of the gyroscope and one for the accelerometer, and the map that joins them."""
    for number, axis in enumerate(axes):
        lines = "".join(f"{k / 100:.2f},{k + 100 * number}\n" for k in range(50))
        (folder / f"{axis}.csv").write_text(f"t,rate\n{lines}")
    lines = "".join(f"{k / 100:.2f},0,0,1\n" for k in range(50))
    (folder / "a.csv").write_text(f"t,ax,ay,az\n{lines}")
    tables = [f'{{ time = "t", gyro = {{ {axis} = "rate" }} }}' for axis in axes]
    tables.append('{ time = "t", accel = ["ax", "ay", "az"] }')
    units = 'units = { time = "s", gyro = "dps", accel = "g" }\n'
    (folder / "map.toml").write_text(f"columns = [{', '.join(tables)}]\n{units}")
    return [folder / f"{name}.csv" for name in (*axes, "a")]


@pytest.mark.parametrize("kind", ["map", "session"])
def test_a_file_for_each_axis_is_one_recording(tmp_path, kind):
    files = write_axes(tmp_path)
    if kind == "map":
        session = session_from_files(files, file_map_of(read_map(tmp_path / "map.toml")))
    else:
        names = [file.name for file in files]
        text = f"{HEAD}[[recording]]\nfile = {names}\n{(tmp_path / 'map.toml').read_text()}"
        (tmp_path / "session.toml").write_text(text)
        session = read_session(tmp_path)
    (record,) = session.records
    np.testing.assert_array_equal(record.gyro, np.arange(50.0)[:, None] + [0.0, 100.0, 200.0])
    np.testing.assert_array_equal(record.accel[7], [0.0, 0.0, 1.0])
    assert record.gyro_unit == "dps"


@pytest.mark.parametrize(
    ("axes", "words"), [("xy", "got none of z"), ("xyy", "got y in several"), ("z", "got none of x, y")]
)
def test_axes_that_are_missing_or_mapped_twice_are_named(tmp_path, axes, words):
    write_axes(tmp_path, axes)
    with pytest.raises(InputError, match=words):
        read_map(tmp_path / "map.toml")


def test_files_side_by_side_need_one_time_base_and_different_channels(tmp_path):
    def put(name, n, step, channel):
        lines = [f"{k * step:.3f},1,2,3" for k in range(n)]
        (tmp_path / name).write_text(
            "\n".join([f"time_s,{','.join(f'{channel}_{a}' for a in ('x_g', 'y_g', 'z_g'))}", *lines])
        )

    put("a.csv", 50, 0.01, "accel")
    text = HEAD + '[[recording]]\nfile = ["a.csv", "b.csv"]\n'
    (tmp_path / "session.toml").write_text(text)
    put("b.csv", 50, 0.01, "accel")
    with pytest.raises(InputError, match=r"b.csv: expected channels that a.csv lacks, got accel again"):
        read_session(tmp_path)
    for n, step in ((49, 0.01), (50, 0.0111)):
        put("b.csv", n, step, "accel")
        with pytest.raises(InputError, match="need one time base"):
            read_session(tmp_path)


def test_a_session_comes_back_as_it_was_written(tmp_path):
    rng = np.random.default_rng(5)
    gyro = rng.normal(size=(40, 3))
    gyro[3:5] = np.nan
    held = tuple(
        Record(
            time=start + np.arange(40) / 7,
            gyro=gyro,
            accel=rng.normal(size=(40, 3)),
            temp_c=rng.normal(size=40),
            device="A",
        )
        for start in (0.0, 1.6e9)
    )
    session = Session(
        kind="thermal", serial='A "1"', gravity_m_s2=9.8123, records=held,
        stills=(Still(start=0, stop=40, face="-z", temp_c=-20.5), Still(start=39, stop=40, recording=1), Still(start=3, stop=4)),
        turns=(
            Turn(start=1, stop=2, axis="x", turn_rate=1.5, recording=1, temp_c=80.0), Turn(start=0, stop=9, angle=-6.2),
            Turn(start=5, stop=40, recording=1),
        ),
        rate_table=RateTable(table_level_deg=1.0, mount_tilt_deg=0.25, rate_uncertainty=1e-3, wobble_deg=0.0),
        sensitivity=TemperatureSensitivity(gyro_offset_dps_per_k=0.5, span_limit_k=9.0),
    )  # fmt: skip
    write_session(session, tmp_path / "run")
    back = read_session(tmp_path / "run")
    for name in ("kind", "serial", "gravity_m_s2", "rate_table", "sensitivity", "stills"):
        assert getattr(back, name) == getattr(session, name), name
    for a, b in zip(back.turns, session.turns, strict=True):
        assert (a.start, a.stop, a.axis, a.recording, a.temp_c) == (b.start, b.stop, b.axis, b.recording, b.temp_c)
        # degrees in the file: one rounding each way
        assert a.turn_rate == (None if b.turn_rate is None else pytest.approx(b.turn_rate, rel=1e-15))
        assert a.angle == (None if b.angle is None else pytest.approx(b.angle, rel=1e-15))
    for a, b in zip(back.records, session.records, strict=True):
        assert_same(a, b)


def test_readings_and_a_session_that_changed_since_they_were_written_are_refused(tmp_path):
    record = Record(time=np.arange(200) / 100.0, gyro=np.ones((200, 3)), gyro_unit="dps")
    still = Still(recording=0, start=0, stop=150)
    session = Session(kind="calibration", serial="", gravity_m_s2=9.81, records=(record,), stills=(still,))
    write_session(session, tmp_path)
    text = (tmp_path / "session.toml").read_text()
    digest = sha256_of(tmp_path / "recording_0.parquet")
    text = text.replace('recording_0.parquet"', f'recording_0.parquet"\nsha256 = "{digest}"')
    (tmp_path / "session.toml").write_text(sealed(text))
    assert len(read_session(tmp_path).records) == 1
    (tmp_path / "session.toml").write_text(sealed(text).replace("stop_s = 1.5", "stop_s = 1.4"))
    with pytest.raises(FileFormatError, match=r"session was changed .*sha256"):
        read_session(tmp_path)
    cut = sealed(text)[: sealed(text).index("[[still]]")]
    (tmp_path / "session.toml").write_text(cut)
    with pytest.raises(FileFormatError, match="session was changed"):
        read_session(tmp_path)
    (tmp_path / "session.toml").write_text(text)
    write_parquet(replace(record, gyro=np.full((200, 3), 1.001)), tmp_path / "recording_0.parquet")
    with pytest.raises(FileFormatError, match=r"recording_0.parquet: the readings were changed"):
        read_session(tmp_path)


@pytest.mark.parametrize("serial", ["A\n1", "\x1f", "x" * 201])
def test_a_serial_number_that_cannot_be_printed_is_refused(serial):
    record = Record(time=[0.0, 1.0], gyro=np.zeros((2, 3)))
    with pytest.raises(InputError, match="up to 200 printable characters, got"):
        Session(kind="static", serial=serial, gravity_m_s2=9.81, records=(record,))


def test_a_disk_that_fills_between_two_recordings_leaves_the_session_that_was_there(tmp_path, monkeypatch):
    def session(rate):
        records = tuple(Record(time=[0.0, 1.0], gyro=np.full((2, 3), rate)) for _ in range(2))
        return Session(kind="static", serial="", gravity_m_s2=9.81, records=records)

    write_session(session(1.0), tmp_path)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    real, calls = pq.ParquetWriter.write_table, iter((True, False))

    def full(*given):
        if not next(calls):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        real(*given)

    monkeypatch.setattr(pq.ParquetWriter, "write_table", full)
    with pytest.raises(InputError, match=r"recording_1\.parquet:"):
        write_session(session(2.0), tmp_path)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


# ---- column maps in TOML mean what they say, and a slip is named by its line

TEXT = """sample_rate_hz = 50
columns = { gyro = [3, 4, "gz"], accel = "acc", temp = 0 }
units = { gyro = "dps", accel = "g", temp = "degC" }
scale = { temp = { gain = 0.5, offset = 23 }, gyro = { gain = [1.0, 1.0, -1.0] } }
delimiter = "\\t"
header = false
skip_rows = 2
drop_bad_rows = true
gaps = "keep"
repair_time = true
frame = "b"
device = "A1"
"""


def test_a_map_in_toml_is_the_map_in_python(tmp_path):
    (tmp_path / "map.toml").write_text(TEXT)
    assert read_map(tmp_path / "map.toml") == column_map(
        gyro=[3, 4, "gz"],
        accel="acc",
        temp=0,
        gyro_unit="dps",
        accel_unit="g",
        temp_unit="degC",
        gyro_scale=ChannelScale((1.0, 1.0, -1.0), 0.0),
        temp_scale=ChannelScale(0.5, 23.0),
        sample_rate_hz=50.0,
        delimiter="\t",
        header=False,
        skip_rows=2,
        drop_bad_rows=True,
        gaps="keep",
        repair_time=True,
        frame="b",
        device="A1",
    )


@pytest.mark.parametrize(
    ("old", "new", "kind", "words"),
    [
        ("skip_rows", "skiprows", FileFormatError, "line 7: skiprows: this key is unknown"),
        ("header = false", 'header = "no"', FileFormatError, "a valid boolean, got 'no'"),
        (
            "sample_rate_hz = 50", 'sample_rate_hz = "50"', FileFormatError,
            "a valid number, got '50'",
        ),
        ("offset = 23", "ofset = 23", FileFormatError, r"line 4: \[scale\], temp, ofset: this key is unknown"),
        ("[1.0, 1.0, -1.0]", "[1.0, 1.0]", FileFormatError, r"line 4: \[scale\], gyro, gain:"),
        ("gain = 0.5", "gain = [1.0, 1.0, 1.0]", InputError, "scale.temp: expected one number"),
        ('columns = { gyro = [3, 4, "gz"], accel = "acc", temp = 0 }\n', "", InputError, "expected one table of columns, got 0"),
        ('gyro = "dps", ', "", InputError, "the unit of gyro"),
    ],
)  # fmt: skip
def test_a_slip_is_named(tmp_path, old, new, kind, words):
    (tmp_path / "map.toml").write_text(TEXT.replace(old, new))
    with pytest.raises(kind, match=words):
        read_map(tmp_path / "map.toml")


def test_a_map_without_columns_says_what_own_names_leave_unsaid(tmp_path):
    path = tmp_path / "map.toml"
    path.write_text("repair_time = true\n")
    assert read_map(path) == ColumnMap(repair_time=True)
    path.write_text('gaps = "keep"\nsample_rate_hz = 50.0\ndrop_bad_rows = true\n')
    assert read_map(path) == ColumnMap(gaps="keep", sample_rate_hz=50.0, drop_bad_rows=True)
    for text, got in (("skip_rows = 2", "skip_rows"), ("# nothing", "no key")):
        path.write_text(text)
        with pytest.raises(InputError, match=f"expected one table of columns, got 0 and {got}. Add columns"):
            read_map(path)
