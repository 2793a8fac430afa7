"""The worked example of CONTRIBUTING.md runs as it stands there: a format is added from outside and read."""

import re
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

import undrift
from undrift.cli.app import run
from undrift.io import formats

TEXT = (Path(__file__).parents[2] / "CONTRIBUTING.md").read_text()


def block(language: str) -> str:
    """Return the only code block of a language."""
    (found,) = re.findall(rf"```{language}\n(.*?)```", TEXT, re.S)
    return found


def test_a_format_is_added_by_one_file_and_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    site, walk = tmp_path / "site", tmp_path / "walk.log"
    points = tomllib.loads(block("toml"))["project"]["entry-points"]
    info = site / "plain_logger-1.0.dist-info"
    info.mkdir(parents=True)
    (site / "plain_logger.py").write_text(block("python"))
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: plain-logger\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        "".join(f"[{group}]\n" + "".join(f"{n} = {v}\n" for n, v in rows.items()) for group, rows in points.items())
    )
    rows = np.random.default_rng(1).normal(size=(200, 6))
    walk.write_text("PLAIN 50\n" + "\n".join(" ".join(f"{x:.6f}" for x in row) for row in rows))

    monkeypatch.syspath_prepend(str(site))
    formats.outside_formats.cache_clear()
    try:
        record = undrift.read_record(walk)
        assert record.sample_rate_hz == pytest.approx(50.0)
        np.testing.assert_allclose(record.gyro, rows[:, :3], atol=1e-6)
        assert run(["info", str(walk), "--json"]) == 0
        assert '"sample_rate_hz"' in capsys.readouterr().out
    finally:
        formats.outside_formats.cache_clear()
        sys.modules.pop("plain_logger", None)
    for group in re.findall(r"\| `(undrift\.\w+)` \|", TEXT):
        assert group in {"undrift.formats", "undrift.rigs"}
