"""Uploads and addresses that nobody should send: no answer of 500, no file outside the folder, the bench goes on."""

import http.client
import json
import random
import socket
import string
from contextlib import closing
from pathlib import Path
from urllib.parse import quote

import pytest

from testkit.bench import BenchServer, bench_process
from undrift.errors import UndriftError
from undrift.io.inspect import describe
from undrift.web.uploads import ENDINGS, safe_name

UPLOADS, ROUTES = 1000, 400
LIMIT_MB = 0.05
EVIL = (
    *(
        "../../evil.csv",
        "..\\..\\evil.csv",
        "/etc/evil.csv",
        "a/../../b.csv",
        ".hidden.csv",
        "con.csv",
        "a\x00.csv",
        "a\n.csv",
        ".csv",
    ),
    *(
        "",
        " ",
        "x" * 4000 + ".csv",
        "%2e%2e%2fevil.csv",
        "\u202egnp.csv",
        "a.csv/",
        "evil.exe",
        "a.csv.sh",
        "~root.csv",
        "$(id).csv",
    ),
)
STARTS = (
    b"",
    b"PAR1",
    b"\x89HDF\r\n\x1a\n",
    b"PK\x03\x04",
    b"\x1f\x8b",
    b"{",
    b"[session]\n",
    b"time_s,gyro_x_dps\n",
    b"MD\xfc\x03",
    b"ULog\x01\x12",
)


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> BenchServer:
    folder = tmp_path_factory.mktemp("fuzzed") / "bench"
    with bench_process(folder, "--upload-mb", str(LIMIT_MB)) as made:
        yield made


def status_of(server: BenchServer, data: bytes, *, hang_up: bool = False) -> int:
    """Send bytes as they are, and hang up half-way where asked; return the status of the answer, 0 where none came."""
    with socket.create_connection(("127.0.0.1", server.port), timeout=20.0) as connection:
        connection.sendall(data)
        if hang_up:
            connection.shutdown(socket.SHUT_WR)
        answer = http.client.HTTPResponse(connection)
        try:
            answer.begin()
        except (http.client.HTTPException, OSError):
            return 0
        return answer.status


def request_of(rng: random.Random, k: int) -> tuple[bytes, bool]:
    """Return an upload that is wrong in its name, its length, its coding, its size or its content, and whether it is cut off."""
    name = rng.choice(EVIL) if k % 3 == 0 else "".join(rng.choices(string.printable, k=8)) + rng.choice(ENDINGS)
    body = rng.choice(STARTS) + rng.randbytes(rng.choice((0, 1, 100, 5000)))
    if k % 50 == 0:
        body = rng.randbytes(int(LIMIT_MB * 1e6) + rng.choice((1, 10_000)))
    length = rng.choice((str(len(body)), str(len(body)), str(len(body) + 100), "-1", "1e3", "", "9" * 30))
    heads = [
        f"POST /upload?name={quote(name) if k % 7 else name.encode('ascii', 'replace').decode()} HTTP/1.1",
        "Host: localhost",
    ]
    if k % 11 == 0:
        heads += ["Transfer-Encoding: chunked"]
        body = rng.choice((b"%x\r\n" % len(body) + body + b"\r\n0\r\n\r\n", b"zz\r\n" + body, b"ffffffffff\r\n" + body))
    else:
        heads += [f"Content-Length: {length}"]
    cut = k % 11 == 0 or length not in ("", str(len(body)))
    return ("\r\n".join([*heads, "Connection: close"]) + "\r\n\r\n").encode("latin-1", "replace") + body, cut


@pytest.mark.slow
def test_a_thousand_malformed_uploads_and_fuzzed_routes_break_nothing(server: BenchServer) -> None:
    rng = random.Random(17)
    outside = {path for path in server.folder.parent.rglob("*") if server.folder not in path.parents}
    seen: dict[int, int] = {}
    for k in range(UPLOADS):
        data, cut = request_of(rng, k)
        status = status_of(server, data, hang_up=cut)
        seen[status] = seen.get(status, 0) + 1
    routes: dict[int, int] = {}
    starts = (
        "/files/",
        "/static/",
        "/upload",
        "/trace/",
        "/_nicegui/",
        "/_nicegui_ws/socket.io/?EIO=4&transport=polling",
        "/",
        "/result?",
    )
    for _ in range(ROUTES):
        tail = "".join(
            rng.choices(["../", "%2e%2e/", "%00", "a", "/", "jobs/", "\u00e9", "?", "&", "%", "etc/passwd"], k=6)
        )
        method = rng.choice(("GET", "POST", "PUT", "HEAD", "OPTIONS", "BREW", "get"))
        head = f"{method} {rng.choice(starts)}{tail} HTTP/1.1\r\nHost: localhost\r\nContent-Length: 3\r\nConnection: close\r\n\r\n"
        status = status_of(server, head.encode("utf-8") + b"abc")
        routes[status] = routes.get(status, 0) + 1
    kept = [path for path in (server.folder / "uploads").rglob("*") if path.is_file()]
    print(
        f"uploads by status {dict(sorted(seen.items()))}, routes {dict(sorted(routes.items()))}, {len(kept)} files kept"
    )
    assert max(*seen, *routes) < 500
    assert server.process.is_alive()
    assert {path for path in server.folder.parent.rglob("*") if server.folder not in path.parents} == outside
    assert {path.relative_to(server.folder).parts[0] for path in server.folder.rglob("*")} <= {
        ".lock",
        "jobs",
        "uploads",
    }
    assert all(path.stat().st_size <= LIMIT_MB * 1e6 and path.suffix in ENDINGS for path in kept)
    assert status_of(server, b"GET / HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n") == 200
    assert [line for line in map(refusal_of, kept) if "\n" in line] == []


def refusal_of(path: Path) -> str:
    """Read a file as `undrift info` does, whose parsers run in a box; return its refusal, "" where it has none."""
    try:
        describe(path)
    except (UndriftError, OSError) as error:
        return str(error)
    return ""


def test_a_half_sent_upload_is_not_kept(server: BenchServer) -> None:
    before = set((server.folder / "uploads").rglob("*"))
    head = b"POST /upload?name=a.csv HTTP/1.1\r\nHost: localhost\r\nContent-Length: 1000\r\n\r\n0,1,2\n"
    with socket.create_connection(("127.0.0.1", server.port), timeout=20.0) as connection:
        connection.sendall(head)
    assert status_of(server, b"GET / HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n") == 200
    assert set((server.folder / "uploads").rglob("*")) == before


@pytest.mark.parametrize("text", EVIL)
def test_a_name_of_an_upload_is_never_a_path_or_hidden(text: str) -> None:
    name = safe_name(text, "otherwise")
    assert name == Path(name).name
    assert not name.startswith((".", "-", " ", "~"))
    assert len(name.encode()) <= 255
    assert set(name) <= set(string.ascii_letters + string.digits + " ._-()")
    assert name.partition(".")[0].lower() not in ("con", "nul")


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("走路.csv", "走路.csv"),
        ("Ma\u0308rz.csv", "M\u00e4rz.csv"),  # NFC
        ("चलना.parquet", "चलना.parquet"),  # marks are a part of the letters
        ("مشي (2).csv.gz", "مشي (2).csv.gz"),
        ("\U0001f600.csv", "recording.csv"),
        ("\ufffd\udce4.csv", "recording.csv"),
        ("nul.csv", "_nul.csv"),
    ],
)
def test_a_name_keeps_the_letters_of_its_script(text: str, name: str) -> None:
    assert safe_name(text, "recording") == name


@pytest.mark.parametrize("letter", ["x", "走", "ä"])
def test_a_long_name_keeps_its_endings(letter: str) -> None:
    name = safe_name(letter * 300 + ".csv.gz", "recording")
    assert name.endswith(f"{letter}.csv.gz")
    assert 190 < len(name.encode()) <= 200  # room for the endings of results


@pytest.mark.parametrize("name", ["%E8%B5%B0%E8%B7%AF.csv", "%E4%F6.csv", "x" * 300 + ".csv", "%F0%9F%98%80.csv"])
def test_an_upload_in_any_script_is_taken_and_served_again(server: BenchServer, name: str) -> None:
    with closing(http.client.HTTPConnection("127.0.0.1", server.port, timeout=20.0)) as connection:
        connection.request("POST", f"/upload?name={name}", b"1,2\n")
        answer = connection.getresponse()
        kept = json.loads(answer.read())["file"]
        assert (answer.status, Path(kept).suffix) == (200, ".csv")
        connection.request("GET", f"/files/{quote(kept)}")
        assert connection.getresponse().read() == b"1,2\n"
