"""Names, files and addresses that nobody should send: no answer of 500, no file outside the folder, the bench goes on."""

import asyncio
import http.client
import random
from contextlib import closing
from pathlib import Path

import pytest

pytest.importorskip("nicegui")

from nicegui.elements.upload_files import SmallFileUpload

from testkit.bench import bench_process
from undrift.web.bench import Bench, ServerSettings
from undrift.web.items import safe_name

EVIL = (
    "../../evil.csv", "..\\..\\evil.csv", "/etc/evil.csv", ".hidden.csv", "con.csv", "a\x00.csv", "a\n.csv", ".csv", "",
    " ", "x" * 4000 + ".csv", "%2e%2e%2fevil.csv", "\u202egnp.csv", "a.csv/", "~root.csv", "$(id).csv",
)  # fmt: skip


@pytest.mark.parametrize("text", EVIL)
def test_a_name_of_an_upload_is_never_a_path_or_hidden(text):
    name = safe_name(text, "otherwise")
    assert name == Path(name).name
    assert not name.startswith((".", "-", " ", "~"))
    assert len(name.encode()) <= 255
    assert name.partition(".")[0].lower() not in ("con", "nul")


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("走路.csv", "走路.csv"),
        ("Ma\u0308rz.csv", "M\u00e4rz.csv"),  # NFC
        ("चलना.parquet", "चलना.parquet"),  # marks are a part of the letters
        ("\U0001f600.csv", "recording.csv"),
        ("走" * 300 + ".csv.gz", "走" * 64 + ".csv.gz"),  # room for the endings of results
    ],
)
def test_a_name_keeps_the_letters_of_its_script(text, name):
    assert safe_name(text, "recording") == name


def test_a_file_is_stored_whole(tmp_path):
    bench = Bench(ServerSettings(folder=tmp_path))
    asyncio.run(bench.receive([SmallFileUpload("../a.csv", "", b"1,2\n")]))
    (path,) = tmp_path.glob("uploads/*/*.csv")
    assert (path.name, path.read_bytes()) == ("a.csv", b"1,2\n")


def test_an_incomplete_file_is_deleted_at_the_next_start(tmp_path):
    (tmp_path / "uploads" / "a1").mkdir(parents=True)
    (tmp_path / "uploads" / "a1" / "sent.part").write_bytes(b"1,2")
    assert Bench(ServerSettings(folder=tmp_path)).items == []
    assert list((tmp_path / "uploads").iterdir()) == []


@pytest.mark.slow
def test_wrong_addresses_break_nothing(tmp_path):
    rng, pieces = random.Random(17), ["../", "%2e%2e/", "%00", "a", "/", "jobs/", "?", "&", "%", "etc/passwd"]
    with bench_process(tmp_path / "bench") as server:
        for _ in range(200):
            method = rng.choice(("GET", "POST", "PUT", "HEAD", "OPTIONS", "BREW"))
            start = rng.choice(("/files/", "/static/", "/_nicegui/", "/_nicegui_ws/socket.io/?EIO=4", "/"))
            with closing(http.client.HTTPConnection("127.0.0.1", server.port, timeout=20.0)) as connection:
                connection.request(method, start + "".join(rng.choices(pieces, k=6)), b"abc")
                assert connection.getresponse().status < 500
        assert server.process.is_alive()
