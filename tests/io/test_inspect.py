"""describe answers for every kind of file, in one line, without reading what it must not guess."""

import json

import numpy as np
import pytest

from testkit.column_maps import column_map
from testkit.trc_text import trc
from undrift.io.column_map import TextLayout
from undrift.io.columns import ReadResult
from undrift.io.inspect import describe, describe_record
from undrift.io.parquet import write_parquet
from undrift.io.reference import write_reference
from undrift.io.session import write_session
from undrift.io.symptoms import find_symptoms, gaps_of
from undrift.record import Record, Reference, Session, Still

CALIBRATION = json.dumps({"kind": "undrift.calibration", "format": 1, "device": "A1"})
MAP = 'sample_rate_hz = 1\ncolumns = { gyro = [0, 1, 2] }\nunits = { gyro = "dps" }'


def still(n=300):
    rng = np.random.default_rng(2)
    return Record(
        time=np.arange(n) / 100,
        gyro=rng.normal(0, 0.001, (n, 3)),
        accel=rng.normal([0, 0, 9.8], 0.01, (n, 3)),
        temp_c=20 + 0.01 * np.arange(n),
        device="A1",
    )


def put(tmp_path, name, content):
    (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    return tmp_path / name


def test_a_recording_is_described_by_its_figures(tmp_path):
    write_parquet(still(), tmp_path / "r.parquet")
    found = describe(tmp_path / "r.parquet")
    assert (found.kind, found.format, found.rows, found.gaps, found.problems) == ("recording", "parquet", 300, 0, ())
    assert found.sample_rate_hz == pytest.approx(100.0)
    assert found.duration_s == pytest.approx(2.99)
    assert found.temp_c == pytest.approx((20.0, 22.99))
    assert found.units == (("time", "s"), ("gyro", "rad/s"), ("accel", "m/s2"), ("temp", "degC"))
    assert found.columns[:2] == ("time_s", "gyro_x_rad_s")
    assert found.summary == "300 samples at 100 Hz, 2.99 s, A1"
    assert describe_record(ReadResult(record=still())).problems == ()


def test_a_session_a_reference_and_markers_are_told_apart(tmp_path):
    session = Session(
        kind="static", serial="7", gravity_m_s2=9.81, records=(still(),), stills=(Still(start=0, stop=9),)
    )
    write_session(session, tmp_path / "run")
    for path in (tmp_path / "run", tmp_path / "run" / "session.toml"):
        found = describe(path)
        assert (found.kind, found.summary) == ("session", "static of 7: 1 recording, 1 still, 0 turns")
    q = np.tile([1.0, 0, 0, 0], (50, 1))
    q[7] = np.nan
    for name in ("q.csv", "q.parquet"):
        write_reference(Reference(time=np.arange(50) / 50, q_nb=q), tmp_path / name)
        found = describe(tmp_path / name)
        assert (found.kind, found.rows, found.gaps) == ("reference", 50, 1)
    points = np.ones((5, 2, 3))
    points[:, 1] = np.nan
    found = describe(put(tmp_path, "m.trc", trc(points, ("A", "B"))))
    assert (found.kind, found.columns, found.gaps) == ("markers", ("A", "B"), 5)
    assert [item.code for item in found.findings] == ["recording.up_axis"]
    assert "(B never seen)" in found.summary


@pytest.mark.parametrize(
    ("name", "content", "kind", "words"),
    [
        ("c.json", CALIBRATION, "calibration", "calibration of A1, format 1"),
        ("o.json", '{"x_p": 1, "y_p": 2}', "settings", "JSON, not a recording: x_p, y_p"),
        ("l.json", "[1, 2]", "settings", "JSON, not a recording: list"),
        ("m.toml", MAP, "settings", "a column map of gyro"),
        ("s.toml", "a = 1", "settings", "TOML settings, not a column map"),
        ("a.md", "\n# Words\n\nmore\n", "text", "prose, not a table: # Words"),
        ("f.txt", "Time[s]\tFx[N]\tFy[N]\tFz[N]\n0\t1\t2\t3\n1\t1\t2\t3\n", "table", "a table of other quantities"),
        ("p.csv", "Time,COG_X,COG_Y,COG_Z\n0,1,2,3\n1,1,2,3\n", "table", "a table of other quantities"),
        ("q.csv", "t,W,X,Y,Z\n0,1,0,0,0\n1,1,0,0,0\n", "table", "a table of orientations"),
        ("w.csv", "name,place,colour\na,b,c\nd,e,f\n", "table", "a table of text (3 columns"),
        ("b.csv", "Time (s),Voltage (V)\n0,4\n1,4\n", "table", "a table without names of three axes"),
        ("n.csv", "t,X (a.u.),Y (a.u.),Z (a.u.)\n0,4,4,4\n1,4,4,4\n", "table", "a table of other quantities"),
        ("x.csv", "ax,ay,az,gx,gy,gz\n" + "0,0,1,0,0,0\n" * 2, "table", 'gyro = ["gx", "gy", "gz"], accel = ["ax", "ay", "az"]'),
        ("y.log", "0.1 0 0 1\n0.2 0 0 1\n0.3 0 0 1\n", "table", 'accel = [1, 2, 3]'),
        ("z.csv", "put\n" + "20.1,0,0,1,0,0,0\n20,0,0,1,0,0,0\n" * 2, "table", "temp = 0, accel = [1, 2, 3], gyro = [4, 5, 6]"),
        ("u.txt", "gx\tgy\tgz\tq\n0\t0\t1\t4\n0\t0\t1\t4\n", "table", 'delimiter = "\\t"'),
    ],
)  # fmt: skip
def test_every_other_file_says_in_one_line_what_it_is_or_needs(tmp_path, name, content, kind, words):
    found = describe(put(tmp_path, name, content))
    assert found.kind == kind
    assert words in "; ".join((found.summary, *found.example))
    assert "\n" not in found.summary
    if kind == "table":
        assert found.problems == (found.summary,)


def test_with_a_map_a_foreign_table_is_described_with_its_problems(tmp_path):
    path = put(tmp_path, "x.csv", "ax,ay,az\n" + "0,0,0.25\n0,0.01,0.25\n" * 50 + "0,0\n")
    layout = TextLayout(drop_bad_rows=True)
    columns = column_map(accel=("ax", "ay", "az"), accel_unit="g", sample_rate_hz=50.0, layout=layout)
    found = describe(path, columns)
    assert (found.kind, found.rows) == ("recording", 100)
    left_out, gravity = found.findings[:2]
    assert (left_out.code, left_out.values) == ("recording.rows_left_out", {"count": 1})
    assert (gravity.code, gravity.values["direction"]) == ("recording.gravity", "small")
    assert gravity.values["median_g"] == pytest.approx(0.25, rel=0.01)


# ---- each thing that is wrong in a recording is one finding with its numbers; a sound one has none


def sound(n=2000, **change):
    rng = np.random.default_rng(8)
    keys = {
        "time": np.arange(n) / 100,
        "gyro": rng.normal(0.0, 0.1, (n, 3)),
        "accel": rng.normal([0, 0, 1], 0.002, (n, 3)),
        "temp_c": 25 + 0.1 * rng.normal(size=n),
        "gyro_unit": "dps",
        "accel_unit": "g",
    }
    return Record(**(keys | change))


def test_a_sound_recording_has_no_symptoms():
    assert find_symptoms(sound()) == ()
    counts = sound(accel=sound().accel * 4000, accel_unit="count", gyro=sound().gyro * 131, gyro_unit="count")
    assert find_symptoms(counts) == ()


def spiked(values, row, value):
    out = np.array(values)
    out[row] = value
    return out


CASES = [
    (
        "quarter g", {"accel": sound().accel / 4}, "recording.gravity", {"median_g": 0.25, "direction": "small"},
    ),
    (
        "m/s2 as g", {"accel": sound().accel * 9.81}, "recording.gravity",
        {"median_g": 9.81, "direction": "large"},
    ),
    (
        "rad/s for dps", {"gyro": sound().gyro + np.array([0, 40, 0])}, "recording.rest_rate", {"turn_rate_dps": 40.0},
    ),
    (
        "processor", {"temp_c": sound().temp_c + 28}, "recording.temperature", {"low_c": 52.65, "high_c": 53.35},
    ),
    (
        "jump", {"temp_c": spiked(sound().temp_c, 100, 147.7)}, "recording.temperature",
        {"count": 2, "first_sample": 99},
    ),
    ("no temperature", {"temp_c": np.full(2000, np.nan)}, "recording.temperature", {}),
    (
        "uneven", {"time": np.cumsum(np.random.default_rng(1).uniform(0.008, 0.012, 2000))}, "recording.uneven_sampling",
        {},
    ),
    (
        "drop-out", {"time": np.arange(2000) / 100 + 3.0 * (np.arange(2000) > 700)}, "recording.uneven_sampling",
        {"count": 1, "longest_s": 3.01},
    ),
    (
        "dead axis", {"gyro": sound().gyro * [1, 0, 1]}, "recording.dead_axis", {"channel": "gyro", "axis": "y"},
    ),
    (
        "saturated", {"gyro": spiked(sound().gyro, slice(50, 62), [0, 0, 250.0])}, "recording.saturated",
        {"channel": "gyro", "axis": "z", "count": 12},
    ),
]  # fmt: skip


@pytest.mark.parametrize(("change", "code", "values"), [case[1:] for case in CASES], ids=[case[0] for case in CASES])
def test_each_symptom_is_one_finding(change, code, values):
    (found,) = find_symptoms(sound(**change))
    assert found.code == code
    for name, value in values.items():
        assert found.values[name] == (value if isinstance(value, str) else pytest.approx(value, rel=0.02))


def test_gaps_are_counted_by_sample():
    gyro = np.array(sound().gyro)
    gyro[[3, 7]] = np.nan
    assert gaps_of(sound(gyro=gyro, temp_c=spiked(sound().temp_c, [7, 9], np.nan))) == 3
    assert gaps_of(sound()) == 0
    assert find_symptoms(sound(gyro=np.full((2000, 3), np.nan))) == ()
    assert find_symptoms(sound(n=20, temp_c=None)) == ()
