"""undrift registry: from a calibration to the recording that it corrects by serial number; answers for people and as JSON."""

import json
import re
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from testkit.command_line import contents
from undrift.cli import EXAMPLES
from undrift.errors import RegistryError
from undrift.io.formats import read_record, write_record
from undrift.io.store import calibration_json, content_hash, hash_of, read_calibration, write_calibration
from undrift.model import MATRIX_NAMES, OFFSET_NAMES
from undrift.record import Record
from undrift.registry.registry import Registry

SERIAL, NOW = "A17", datetime.now(UTC)


@pytest.fixture(autouse=True)
def place(monkeypatch, tmp_path_factory):
    """A registry of the test's own, in no folder that the test looks at."""
    path = tmp_path_factory.mktemp("place") / "registry.sqlite"
    monkeypatch.setenv("UNDRIFT_REGISTRY", str(path))
    return path


@pytest.fixture
def made(bench, tmp_path):
    """Write the bench's calibration as if it were made some days ago, its gyroscopes changed by a gain."""

    def make(name, days_ago=0, *, gain=1.0, serial=SERIAL, temp_c=25.0, **changes):
        c = read_calibration(bench / "calibration.json")
        at = replace(c.provenance, created=(NOW - timedelta(days=days_ago)).isoformat(), inputs=((name, name),))
        model = replace(
            c, device=serial, reference_temp_c=temp_c, provenance=at, gyro=replace(c.gyro, matrix=gain * c.gyro.matrix)
        )
        write_calibration(replace(model, **changes), tmp_path / name)
        return tmp_path / name

    return make


def added(undrift, *words):
    """Add; return the numbers of the entries."""
    return [row["entry"] for row in undrift.good("registry", "add", *words, "--json").json()["entries"]]


def test_add_list_show_and_find_give_the_file_back(undrift, made, place, tmp_path):
    path = made("c.json", 10)
    first = undrift.good("registry", "add", path)
    due = (NOW - timedelta(days=10)).replace(year=(NOW - timedelta(days=10)).year + 1)
    follows = "Next: undrift registry list --serial=A17\n"
    assert first.out == f"Registered as entry 1: calibration of A17, due {due:%Y-%m-%d}\n{follows}"
    assert undrift.good("registry", "add", path).out == f"Already registered as entry 1: calibration of A17\n{follows}"
    listed = undrift.good("registry", "list", "--json").json()
    assert listed["registry"] == str(place)
    (device,) = listed["devices"]
    assert (device["serial"], device["entries"], device["state"], device["calibration"]["entry"]) == (
        SERIAL,
        1,
        "valid",
        1,
    )
    assert 354 <= device["days_left"] <= 356
    (entry,) = undrift.good("registry", "list", "--serial", SERIAL, "--json").json()["entries"]
    assert (entry["valid_temp_c"], entry["superseded_by"], entry["sha256"]) == (
        [20.0, 30.0],
        None,
        content_hash(read_calibration(path)),
    )
    assert undrift.good("registry", "list", "--kind", "run", "--json").json()["entries"] == []
    for words in (("show", "1"), ("find", "--serial", SERIAL, "--temp-c", "21.5")):
        undrift.good("registry", *words, "-o", tmp_path / "back.json")
        assert (tmp_path / "back.json").read_bytes() == path.read_bytes()
    shown = undrift.good("registry", "show", "1", "--json").json()
    assert shown["document"] == json.loads(path.read_text())
    table = undrift.good("registry", "list", "--serial", SERIAL).out
    assert "calibration" in table
    assert "20.0 to 30.0" in table
    assert f"sha256         {entry['sha256']}" in undrift.good("registry", "show", "1").out
    assert "valid" in undrift.good("registry", "list").out


def test_a_certificate_and_a_session_come_with_it_and_go_back_out(undrift, made, bench, tmp_path):
    path = made("c.json")
    undrift("certificate", path, "-o", tmp_path / "c.pdf")
    assert added(undrift, tmp_path / "c.pdf", bench / "session", path) == [1, 2, 3]
    kinds = {
        kind: undrift.good("registry", "list", "--kind", kind, "--json").json()["entries"][0]["entry"]
        for kind in ("calibration", "certificate", "session")
    }
    assert kinds["calibration"] < kinds["certificate"]
    undrift.good("registry", "show", kinds["certificate"], "-o", tmp_path / "back.pdf")
    assert (tmp_path / "back.pdf").read_bytes() == (tmp_path / "c.pdf").read_bytes()
    undrift.good("registry", "show", kinds["session"], "-o", tmp_path / "session.json")
    assert json.loads((tmp_path / "session.json").read_text())["recordings"] >= 1


def test_a_correction_names_what_it_corrects_and_why(undrift, made):
    path = made("c.json", 10)
    added(undrift, path)
    assert "wanted one file, and --note with the reason" in undrift.refused(
        "registry", "add", path, "--supersedes", "1"
    )
    words = (path, "--supersedes", "1", "--valid-temp-c", "-5:40", "--note", "soaked to the ends")
    assert added(undrift, *words) == [2]
    table = undrift.good("registry", "list", "--serial", SERIAL).out
    assert "superseded by 2" in table
    assert "soaked to the ends" in table
    assert undrift.good("registry", "find", "--serial", SERIAL, "--temp-c", "-4", "--json").json()["entry"] == 2


def test_due_lists_what_is_overdue_soon_due_or_never_calibrated(undrift, made, bench):
    assert undrift.good("registry", "due").out.startswith("nothing is due within 30 days")
    added(
        undrift,
        made("a.json", 400, serial="late"),
        made("b.json", 350, serial="soon"),
        made("c.json", 1, serial="fresh"),
    )
    rows = undrift.good("registry", "due", "--json").json()["devices"]
    assert [(row["serial"], row["state"]) for row in rows] == [("late", "overdue"), ("soon", "valid")]
    assert rows[0]["days_left"] < 0 < rows[1]["days_left"] < 17
    assert [
        row["serial"] for row in undrift.good("registry", "due", "--within-days", "0", "--json").json()["devices"]
    ] == ["late"]
    assert "overdue" in undrift.good("registry", "due").out


@pytest.mark.slow
def test_trend_says_what_moved_since_when_with_table_picture_and_page(undrift, made, tmp_path):
    added(undrift, made("a.json", 200), made("b.json", 100, gain=1.03), made("c.json", 1, gain=1.03))
    since = NOW - timedelta(days=200)
    answer = undrift.good(
        "registry", "trend", "--serial", SERIAL, "--figure", tmp_path / "t.svg", "--report", tmp_path / "t.html"
    )
    headline, *lines = (line.strip() for line in answer.out.splitlines())
    assert headline.startswith(f"{SERIAL}: ")
    moved = [line for line in lines if "scale of gyro" in line and " moved by" in line and "nothing" not in line]
    assert [line.partition(":")[0] for line in moved] == [f"{NOW - timedelta(days=100):%Y-%m-%d}"] * 3 + [
        "since the first"
    ] * 3
    assert all(f"sigma since {since:%Y-%m-%d}: +3 %" in line for line in moved)
    assert "nothing moved by 3 sigma since" in answer.out
    assert f"since the first: {moved[0].partition(': ')[2].partition(' moved')[0]} moved by " in answer.out
    told = undrift.good("registry", "trend", "--serial", SERIAL, "--json").json()
    assert [(step["since"]["entry"], step["until"]["entry"]) for step in told["steps"]] == [(1, 2), (2, 3)]
    change = {one["parameter"]: one for one in told["steps"][0]["changes"] if one["sensor"] == "gyro"}
    assert change["scale y"]["change"] == pytest.approx(3.0)
    assert change["scale y"]["sigmas"] == pytest.approx(change["scale y"]["change"] / change["scale y"]["uncertainty"])
    assert (tmp_path / "t.svg").read_text().count("<svg") == 1
    assert "moved by" in (tmp_path / "t.html").read_text()
    assert "cross-axis xy" in undrift.good("registry", "trend", "--serial", SERIAL, "--details").out


def test_devices_of_a_part_are_the_prior_of_the_next_one_that_is_moved(undrift, made, tmp_path):
    physical = {"unit_in": "rad/s", "method": "affine", "offset": np.zeros(3), "budget": None}
    for k, gain in enumerate((1.01, 1.012, 1.011)):
        path = made(f"{k}.json", serial=f"U{k}")
        c = read_calibration(path)
        gyro = replace(
            c.gyro,
            **physical,
            matrix=gain * np.eye(3),
            covariance=1e-8 * np.eye(12),
            parameters=(*MATRIX_NAMES, *OFFSET_NAMES),
        )
        accel = replace(c.accel, **physical | {"unit_in": "m/s2"}, matrix=np.eye(3), covariance=1e-6 * np.eye(12))
        write_calibration(replace(c, gyro=gyro, accel=accel), path)
        undrift.good("registry", "add", path)
    undrift.good("registry", "add", made("counts.json", serial="C0"))
    shown = undrift.good("registry", "prior", "-o", tmp_path / "prior.json")
    assert "from 3 devices" in shown.out
    assert re.search(r"C0: wanted both triads in physical units", shown.out)
    answer = undrift.good("registry", "prior", "U0", "U1", "U2", "--json").json()
    assert answer["gyro_scale"]["mean"] == pytest.approx(
        [0.0083, 0.0083, 0.0083], abs=3e-4
    )  # 3/4 of it: it is one device more
    assert answer["devices"] == 3
    time = np.arange(2000) / 50.0
    angle = 1.5 * np.tanh(4.0 * np.sin(0.35 * time))
    rates = np.gradient(angle, time)[:, None] * [0.0, 1.0, 0.0] + 1e-3 * np.sin(time)[:, None]
    force = 9.80665 * np.stack((-np.sin(angle), 0.0 * angle, np.cos(angle)), axis=1)
    write_record(
        Record(time=time, gyro=rates, accel=force + 0.01 * np.sin(3.0 * time)[:, None]), tmp_path / "moved.csv"
    )
    words = ("calibrate", tmp_path / "moved.csv", "--prior", tmp_path / "prior.json")
    calibrated = undrift.good(*words, "--from", "motion", "--json").json()
    (named,) = (one for one in calibrated["verdict"]["findings"] if one["code"] == "motion.prior")
    assert named["values"]["source"] == "registry, 3 devices"
    assert dict(calibrated["provenance"]["settings"])["prior"] == "registry, 3 devices"
    assert calibrated["gyro"]["matrix"][2][2] == pytest.approx(
        1.0083, abs=1e-3
    )  # about z it was not turned: what the part has
    assert "--prior and --magnetometer are for --calibrate-from motion" in undrift.refused(*words)
    assert "wanted calibrated devices of a part, got none (C0: wanted both" in undrift.refused(
        "registry", "prior", "C0"
    )


def test_import_adds_a_folder_and_lists_what_it_refuses(undrift, made, bench, tmp_path):
    made("a.json", 3)
    made("b.json", 2, serial="")
    told = undrift.good("registry", "import", tmp_path, "--json").json()
    assert [(row["serial"], row["new"]) for row in told["entries"]] == [(SERIAL, True)]
    assert [(one["file"], one["why"].partition(": ")[2][:32]) for one in told["refused"]] == [
        (str(tmp_path / "b.json"), "wanted the serial number of the ")
    ]
    again = undrift.good("registry", "import", tmp_path, "--serial", SERIAL)
    assert "Already registered as entry 1" in again.out
    assert "Registered as entry 2" in again.out
    (tmp_path / "empty").mkdir()
    assert "got none; name another folder" in undrift.refused("registry", "import", tmp_path / "empty")


def recording(bench, folder, temp_c=25.0, name="2026-trial.parquet"):
    raw = read_record(bench / "trial.parquet")
    write_record(replace(raw, temp_c=None if temp_c is None else np.full(len(raw), temp_c)), folder / name)
    return folder / name


@pytest.mark.slow
def test_correct_by_serial_takes_the_calibration_of_the_date_and_temperature(undrift, made, bench, tmp_path):
    added(
        undrift,
        made("cold.json", 20, temp_c=25.0),
        made("warm.json", 10, gain=1.5, temp_c=35.0),
        made("bad.json", 300, gain=3.0),
    )
    for temp_c, entry, name in ((25.0, 1, "cold"), (35.0, 2, "warm"), (None, 2, "warm")):
        path = recording(bench, tmp_path, temp_c)
        answer = undrift.good("correct", path, "--serial", SERIAL, "-o", tmp_path / "by.csv", "--json").json()
        assert answer["calibration"] == f"registry entry {entry}"
        undrift.good("correct", path, "--calibration", tmp_path / f"{name}.json", "-o", tmp_path / "file.csv")
        assert (tmp_path / "by.csv").read_text() == (tmp_path / "file.csv").read_text()
        stated = json.loads((tmp_path / "by.csv.json").read_text())["provenance"]["inputs"]
        digest = hash_of(calibration_json(read_calibration(tmp_path / f"{name}.json")))
        assert stated[-1] == {"file": f"registry entry {entry}", "sha256": digest}
    early = f"{NOW - timedelta(days=15):%Y-%m-%d}"
    answer = undrift.good(
        "correct", path, "--serial", SERIAL, "--date", early, "-o", tmp_path / "by.csv", "--json"
    ).json()
    assert answer["calibration"] == "registry entry 1"


def test_correct_by_serial_refuses_in_a_line_and_writes_nothing(undrift, made, bench, tmp_path):
    path = recording(bench, tmp_path, 60.0)
    added(undrift, made("cold.json", 20), made("warm.json", 10, temp_c=35.0))
    other, before = recording(bench, tmp_path, 25.0, "other.parquet"), contents(tmp_path)
    end = ("-o", tmp_path / "c.csv")
    assert "wanted --calibration FILE or --serial S, got neither" in undrift.refused("correct", path, *end)
    both = ("--calibration", tmp_path / "cold.json", "--serial", SERIAL)
    assert "wanted --calibration FILE or --serial S, got both" in undrift.refused("correct", path, *both, *end)
    assert "wanted a calibration valid at 60.0 degC, got entry 2: 30.0 to 40.0 degC" in undrift.refused(
        "correct", path, "--serial", SERIAL, *end
    )
    assert "got serial 'B2'; known: A17" in undrift.refused("correct", path, "--serial", "B2", *end)
    assert "valid on 2020-01-01, got a first one of" in undrift.refused(
        "correct", path, "--serial", SERIAL, "--date", "2020-01-01", *end
    )
    third = recording(bench, tmp_path, 35.0, "third.parquet")
    (tmp_path / "out").mkdir()
    text = undrift.refused("correct", other, third, "--serial", SERIAL, "-o", tmp_path / "out")
    assert (
        "wanted one calibration for all recordings, got several (other.parquet: entry 1, third.parquet: entry 2)"
        in text
    )
    assert {name for name in contents(tmp_path) if name not in before} == {"third.parquet", "out"}


def test_calibrate_drift_and_certificate_register_what_they_make(undrift, made, bench, tmp_path):
    told = undrift("calibrate", bench / "session", "-o", tmp_path / "new.json", "--register", "--json").json()
    (row,) = told["registered"]
    assert (row["kind"], row["new"], row["source"]) == ("calibration", True, str(tmp_path / "new.json"))
    model = read_calibration(tmp_path / "new.json")
    assert (row["serial"], row["sha256"]) == (model.device, content_hash(model))
    (tmp_path / "answer.json").write_text(json.dumps(told))
    read_calibration(tmp_path / "answer.json")  # the answer is a calibration still
    shown = undrift("certificate", tmp_path / "new.json", "-o", tmp_path / "new.pdf", "--register").out
    assert f"Already registered as entry {row['entry']}: calibration of {model.device}" in shown
    assert f"Registered as entry {row['entry'] + 1}: certificate of {model.device}" in shown
    words = (
        "drift",
        bench / "session",
        "--calibration",
        made("old.json", 5),
        "-o",
        tmp_path / "tables.json",
        "--register",
        "--json",
    )
    answer = undrift(*words)
    if answer.code in (0, 1):
        assert answer.json()["registered"][0]["serial"] == SERIAL


def test_what_cannot_be_registered_is_refused_before_anything_is_written(undrift, made, bench, tmp_path):
    nameless = made("nameless.json", serial="")
    before = contents(tmp_path)
    text = undrift.refused("certificate", nameless, "-o", tmp_path / "c.pdf", "--register")
    assert "--register: wanted the serial number of the device, got none" in text
    for words in (
        ("calibrate", bench / "session"),
        ("certificate", bench / "calibration.json"),
        ("drift", bench / "session"),
    ):
        ending = ".pdf" if words[0] == "certificate" else ".json"
        text = undrift.refused(
            *words, "-o", tmp_path / f"c{ending}", "--register", "--registry", tmp_path / "no" / "r.sqlite"
        )
        assert "wanted a file in a folder that exists, got none; make the folder first" in text
    address = (
        "--rig",
        "manual:",
        "--device",
        "tcp://127.0.0.1:9",
        "--register",
        "--registry",
        tmp_path / "no" / "r.sqlite",
    )
    text = undrift.refused("rig", "run", tmp_path / "p.toml", "-o", tmp_path / "run", *address)
    assert "make the folder first" in text
    assert contents(tmp_path) == before


def test_a_registry_that_fails_at_the_end_leaves_what_was_made_and_says_how_to_add_it(
    undrift, made, monkeypatch, tmp_path
):
    def full(self, *new):
        raise RegistryError("r.sqlite: wanted room for an entry, got a full disk; make room and add it again")

    path = made("c.json")
    monkeypatch.setattr(Registry, "add", full)
    text = undrift.refused("certificate", path, "-o", tmp_path / "c.pdf", "--register")
    assert f"what was made is there, register it later: undrift registry add {path} {tmp_path / 'c.pdf'}" in text
    assert (tmp_path / "c.pdf").read_bytes().startswith(b"%PDF-")


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("add", "nowhere.json"), "wanted a file, got nothing of that name"),
        (("add", "c.json", "--valid-temp-c", "30:20"), "--valid-temp-c: wanted LOW below HIGH in degC, got '30:20'"),
        (
            ("add", "c.json", "--valid-temp-c", "warm"),
            "--valid-temp-c: wanted LOW:HIGH in degC, got 'warm'; for example 15:35",
        ),
        (("add", "c.json", "--valid-months", "0"), "--valid-months: wanted 1 to 1200 months, got 0"),
        (("add", "c.json", "--date", "soon"), "wanted one as 2026-03-01 or 2026-03-01T08:30, got 'soon'"),
        (("due", "--within-days", "-1"), "--within-days: wanted 0 to 36500 days, got -1"),
        (("show", "7"), "wanted an entry of the registry, got 7; see undrift registry list"),
        (("list", "--registry", "nowhere.sqlite"), "nowhere.sqlite: wanted a registry, got no file of that name"),
        (("import", "nowhere"), "nowhere: wanted a folder, got none of that name"),
        (("trend", "--serial", SERIAL), "wanted two calibrations to compare, got 1; add another"),
        (("find", "--serial", SERIAL, "-o", "c.csv"), "wanted a name ending in .json"),
        (("list", "--registry", "oracle://a/b"), "got oracle://; name one of these"),
    ],
)
def test_what_is_wrong_is_one_line_and_nothing_is_written(undrift, made, monkeypatch, tmp_path, words, text):
    added(undrift, made("c.json", 10))
    monkeypatch.chdir(tmp_path)
    before = contents(tmp_path)
    assert text in undrift.refused("registry", *words)
    assert contents(tmp_path) == before


def test_every_command_of_the_group_has_examples():
    assert {name.split()[1] for name in EXAMPLES if name.startswith("registry ")} == {
        "add", "list", "show", "find", "due", "trend", "prior", "import"
    }  # fmt: skip
