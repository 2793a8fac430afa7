"""``undrift bench``: calls that are refused; the pages have tests of their own (tests/web, tests/web_browser)."""

import re
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["--token", "short"], "--token: expected 16 characters or more, got 5"),
        (["--port", "70000"], "--port: expected 0 to 65535, got 70000"),
        (["--upload-mb", "0"], "--upload-mb: expected more than 0, got 0"),
    ],
)
def test_a_call_that_would_open_the_bench_by_mistake_is_refused(undrift, words: list[str], text: str, tmp_path: Path):
    assert text in undrift.refused("bench", "--folder", tmp_path / "held", *words)
    assert not (tmp_path / "held").exists()


@pytest.mark.slow
def test_a_port_in_use_is_named(undrift, tmp_path: Path) -> None:
    called = [sys.executable, "-m", "undrift", "bench", "--port", "0", "--no-browser", "--token", "none"]
    with subprocess.Popen(
        [*called, "--folder", tmp_path / "bench"], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as server:
        assert server.stdout is not None
        port = re.findall(r":(\d+)/", server.stdout.readline())[0]
        try:
            line = undrift.refused("bench", "--folder", tmp_path / "other", "--port", port, "--no-browser")
        finally:
            server.terminate()
            assert "The bench has ended." in server.stdout.read()
            assert server.wait(20.0) == 0
    assert f"bench: cannot listen at 127.0.0.1:{port} (Address already in use)" in line
