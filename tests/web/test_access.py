"""Who may use the bench."""

import http.client
import webbrowser
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from testkit.bench import bench_process
from undrift.cli.app import run
from undrift.web import app
from undrift.web.access import refused, too_large

TOKEN = "a-token-of-sixteen"


def scope(kind: str = "http", method: str = "GET", query: str = "", **headers: str) -> dict[str, Any]:
    sent = {"host": "127.0.0.1:8765"} | headers
    pairs = [(name.encode(), value.encode()) for name, value in sent.items()]
    return {"type": kind, "method": method, "path": "/", "query_string": query.encode(), "headers": pairs}


@pytest.mark.parametrize("host", ["127.0.0.1:8765", "localhost:1", "localhost", "[::1]:8765"])
def test_this_computer_needs_no_token(host: str) -> None:
    assert refused(scope(host=host), None) == ""


@pytest.mark.parametrize(
    "host", ["evil.example:8765", "192.168.1.4", "", "[::1", "127.0.0.1.evil.example", "localhost."]
)
def test_another_name_for_this_computer_is_refused(host: str) -> None:
    assert refused(scope(host=host), None).startswith("bench: this request names another computer")


@pytest.mark.parametrize(("kind", "method"), [("http", "POST"), ("http", "DELETE"), ("websocket", "GET")])
def test_a_page_of_another_site_cannot_change_anything(kind: str, method: str) -> None:
    assert "from another site" in refused(scope(kind, method, origin="http://evil.example"), None)
    assert "from another site" in refused(scope(kind, method, origin="null"), None)
    assert refused(scope(kind, method, origin="http://127.0.0.1:8765"), None) == ""


@pytest.mark.parametrize(
    ("query", "cookie", "passes"),
    [
        ("", "", False),
        (f"token={TOKEN}", "", True),
        ("token=another", "", False),
        ("", f"undrift_token={TOKEN}", True),
        ("token=another", f"undrift_token={TOKEN}", False),
        ("", "undrift_token=another", False),
        ("", "undrift_token", False),
        ("token=", "", False),
        ("token=\u00e9", "\u00e9=\u00e9", False),
    ],
)
def test_with_a_token_every_request_carries_it(query: str, cookie: str, passes: bool) -> None:
    assert (refused(scope(query=query, host="192.168.1.4", cookie=cookie), TOKEN) == "") is passes


@pytest.mark.parametrize(
    ("sent", "read"),
    [
        ({}, True),
        ({"content-length": "2000000"}, True),  # two files of 1 MB
        ({"content-length": "2100000"}, False),
        ({"content-length": "-1"}, False),
        ({"content-length": "\u0662"}, False),
        ({"content-length": "5", "transfer-encoding": "chunked"}, False),
    ],
)
def test_content_that_is_too_large_is_not_read(sent: dict[str, str], read: bool) -> None:
    assert (too_large(scope(method="POST", **sent), 2.0) == "") is read


def test_a_fresh_token_is_in_the_address_that_is_printed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    addresses, served = list[str](), list[str | None]()

    def serve(settings: Any, ready: Any) -> None:
        served.append(settings.token)
        ready(f"http://127.0.0.1:1/?token={settings.token}")

    monkeypatch.setattr(app, "serve", serve)
    monkeypatch.setattr(webbrowser, "open", addresses.append)
    for _ in range(2):
        assert run(["bench", "--folder", str(tmp_path / "b")]) == 0
    assert len(set(served)) == 2
    assert all(token is not None and len(token) >= 32 for token in served)
    assert [address.partition("=")[2] for address in addresses] == served


def test_bench_answers_nobody_without_its_token(tmp_path: Path) -> None:
    with bench_process(tmp_path / "bench", "--token", TOKEN) as server:
        assert server.address == f"http://127.0.0.1:{server.port}/?token={TOKEN}"

        def asked(path: str, method: str = "GET", **headers: str) -> tuple[int, http.client.HTTPMessage, bytes]:
            with closing(http.client.HTTPConnection("127.0.0.1", server.port, timeout=10.0)) as connection:
                connection.request(method, path, headers=headers)
                answer = connection.getresponse()
                return answer.status, answer.headers, answer.read()

        for path, method in (
            ("/", "GET"),
            ("/files/place.json", "GET"),
        ):
            status, _, body = asked(path, method)
            assert status == 403, path
            assert body.startswith(b"bench: the token is missing or wrong")
        status, headers, _ = asked(f"/?token={TOKEN}")
        assert (status, headers["location"]) == (303, "/")
        cookie = str(headers["set-cookie"])
        assert cookie.startswith(f"undrift_token_{server.port}=")  # of this bench, beside that of another port
        assert "HttpOnly" in cookie
        assert "samesite=strict" in cookie.lower()
        sent = {"cookie": cookie.partition(";")[0], "content-length": "5000000000"}  # 5 GB, of which nothing follows
        status, _, body = asked("/", "POST", **sent)
        assert status == 413
        assert body.startswith(b"upload: files that are sent together may have 500 MB in total.")
        status, headers, _ = asked("/", cookie=cookie.partition(";")[0])
        assert status == 200
        policy = headers["content-security-policy"]
        assert "frame-ancestors 'self'" in policy
        own = f"127.0.0.1:{server.port}"
        assert f"connect-src 'self' ws://{own} wss://{own};" in policy
