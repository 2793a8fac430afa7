"""undrift data: the sample runs through the commands, sets come whole and checked from a server on the loopback, or not at all."""

import hashlib
import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from testkit.command_line import contents
from undrift.io import public_data

FILES = {"data/one 1.csv": b"time_s\n0\n", "data/two.csv": b"time_s\n1\n"}


class Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *args: object) -> None:
        """Leave stderr to what is tested."""


@pytest.fixture
def served(tmp_path_factory, monkeypatch):
    """A public set named tiny on a server of its own, without local copies; return its folder and the registry."""
    root = tmp_path_factory.mktemp("served")
    for name, content in FILES.items():
        (root / name).parent.mkdir(exist_ok=True)
        (root / name).write_bytes(content)
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(root)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    base = f"http://127.0.0.1:{server.server_address[1]}/"
    listed = "".join(
        f'  {{ path = "{name}", sha256 = "{hashlib.sha256(c).hexdigest()}" }},\n' for name, c in FILES.items()
    )
    registry = root / "registry.toml"
    registry.write_text(
        f'[[set]]\nname = "tiny"\nwhat = "two files"\nlicence = "CC0"\naddress = "{base}"\nbase = "{base}"\nbytes = 18\n'
        f"files = [\n{listed}]\n\n"
        f'[[set]]\nname = "bare"\nwhat = "no files"\nlicence = "MIT"\naddress = "{base}bare"\nwhy_not = "no checksum is known"\n'
    )
    monkeypatch.setattr(public_data, "REGISTRY", registry)
    monkeypatch.delenv("UNDRIFT_DATA", raising=False)
    yield root, server
    server.shutdown()
    server.server_close()


def test_a_set_comes_whole_and_checked(undrift, served, tmp_path):
    answer = undrift.good("data", "fetch", "tiny", "-o", tmp_path / "tiny", "--json").json()
    assert answer["folder"] == str(tmp_path / "tiny")
    assert contents(tmp_path) == {
        "tiny": None,
        "tiny/one 1.csv": FILES["data/one 1.csv"],
        "tiny/two.csv": FILES["data/two.csv"],
    }


def test_other_bytes_are_refused_and_nothing_is_left(undrift, served, tmp_path):
    (served[0] / "data" / "two.csv").write_bytes(b"changed")
    assert "with sha256" in undrift.refused("data", "fetch", "tiny", "-o", tmp_path / "tiny")
    assert contents(tmp_path) == {}


def test_a_file_that_is_gone_is_one_line(undrift, served, tmp_path):
    (served[0] / "data" / "two.csv").unlink()
    assert "got status 404" in undrift.refused("data", "fetch", "tiny", "-o", tmp_path / "tiny")
    assert contents(tmp_path) == {}


def test_without_a_network_one_line_says_what_to_do(undrift, served, tmp_path):
    served[1].shutdown()
    served[1].server_close()
    line = undrift.refused("data", "fetch", "tiny", "-o", tmp_path / "tiny", "--json")
    assert "got no connection; connect to the network, or let UNDRIFT_DATA name a local copy" in line
    assert contents(tmp_path) == {}


def test_a_set_without_checksum_is_listed_and_not_fetched(undrift, served, tmp_path):
    line = undrift.refused("data", "fetch", "bare", "-o", tmp_path / "bare")
    assert "no checksum is known; download it from http://127.0.0.1" in line
    rows = {row["name"]: row for row in undrift.good("data", "list", "--json").json()["sets"]}
    assert [rows[name]["fetch"] for name in ("sample", "tiny", "bare")] == ["package", "download", "no"]
    assert "bare: not fetched, no checksum is known" in undrift.good("data", "list").out


def test_a_local_copy_is_taken_first(undrift, served, tmp_path, monkeypatch):
    (tmp_path / "held" / "bare" / "in").mkdir(parents=True)
    (tmp_path / "held" / "bare" / "in" / "a.csv").write_text("x")
    monkeypatch.setenv("UNDRIFT_DATA", str(tmp_path / "held"))
    assert str(tmp_path / "held" / "bare") in undrift.good("data", "fetch", "bare", "-o", tmp_path / "b").out
    assert contents(tmp_path / "b") == {"in": None, "in/a.csv": b"x"}


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("nothing",), "wanted one of sample, tiny, bare, got 'nothing'"),
        (("tiny", "-o", "here"), "wanted a folder that does not exist yet"),
        (("tiny", "-o", "nowhere/here"), "wanted a folder that exists, got none named nowhere"),
    ],
)
def test_wrong_calls_are_refused(undrift, served, tmp_path, monkeypatch, words, text):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path)
    assert text in undrift.refused("data", "fetch", *words)
    assert contents(tmp_path) == {"here": None}


def test_the_registry_states_licence_and_address_of_each_set():
    sets = public_data.public_sets()
    assert sum(one.bytes for one in sets if one.name == public_data.SAMPLE) < 1_000_000
    assert len({one.name for one in sets}) == len(sets) > 10
    for one in sets[1:]:
        assert one.licence
        assert one.address.startswith("https://")
        assert bool(one.files) != bool(one.why_not)
        assert all(len(digest) == 64 for _, digest in one.files)


@pytest.mark.slow
def test_the_sample_runs_through_the_commands(undrift, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    undrift.good("data", "fetch", "sample")
    monkeypatch.chdir(tmp_path / "sample")
    made = undrift.good("calibrate", "bench", "-o", "calibration.json", "--json").json()
    assert made["gyro"]["method"] == "rate-table/affine"
    assert made["accel"]["method"] == "six-face/levelled"
    assert undrift.good("noise", "rest.parquet", "--calibration", "calibration.json", "--json").json()["gyro"]
    undrift.good("drift", "bench", "thermal", "--calibration", "calibration.json", "-o", "tables.json", "--json")
    undrift.good("correct", "sit_to_stand.parquet", "--calibration", "tables.json", "-o", "corrected.parquet", "--json")
    undrift.good("orient", "corrected.parquet", "-o", "angles.csv", "--json")
    words = ("--reference", "sit_to_stand_optics.parquet", "--calibration", "tables.json", "--json")
    trial = undrift.good("validate", "sit_to_stand.parquet", *words).json()["trials"][0]
    assert trial["max_abs_pitch_deg"] < 0.5  # three times what the first run showed: 0.12
    undrift.good("certificate", "tables.json", "-o", "certificate.pdf", "--json")
    assert Path("certificate.pdf").read_bytes().startswith(b"%PDF-")
