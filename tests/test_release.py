"""Wheel and sdist: built without a network, the same from both, and working by themselves with the steps of the release."""

import os
import re
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
WORKFLOW = ROOT / ".github" / "workflows" / "publish.yml"


def run(*words: object, cwd: Path, **environment: str) -> str:
    done = subprocess.run(
        [sys.executable, *map(str, words)],
        cwd=cwd,
        env=os.environ | environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


def contents(wheel: Path) -> dict[str, int]:
    """Return the checksum of each file in a wheel, without the list of them."""
    with zipfile.ZipFile(wheel) as archive:
        return {item.filename: item.CRC for item in archive.infolist() if not item.filename.endswith("RECORD")}


@pytest.fixture(scope="module")
def dist(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("dist")
    run("-m", "hatchling", "build", "-d", folder, cwd=ROOT)
    return folder


def test_the_wheel_has_every_file_of_the_package(dist: Path) -> None:
    held = {name for name in contents(next(dist.glob("*.whl"))) if name.startswith("undrift/")}
    source = (
        path for path in (ROOT / "src" / "undrift").rglob("*") if path.is_file() and "__pycache__" not in path.parts
    )
    assert held == {path.relative_to(ROOT / "src").as_posix() for path in source}


def test_the_sdist_builds_the_same_wheel(dist: Path, tmp_path: Path) -> None:
    with tarfile.open(next(dist.glob("*.tar.gz"))) as archive:
        archive.extractall(tmp_path, filter="data")
    run("-m", "hatchling", "build", "-t", "wheel", "-d", tmp_path, cwd=next(tmp_path.glob("undrift-*")))
    assert contents(next(tmp_path.glob("*.whl"))) == contents(next(dist.glob("*.whl")))


@pytest.mark.slow
def test_the_installed_wheel_does_what_the_release_tries(dist: Path, tmp_path: Path) -> None:
    installed = tmp_path / "installed"
    run("-m", "pip", "install", "--quiet", "--no-deps", "--target", installed, next(dist.glob("*.whl")), cwd=tmp_path)
    path = {"PYTHONPATH": str(installed)}
    assert run("-c", "import undrift; print(undrift.__file__)", cwd=tmp_path, **path).startswith(str(installed))
    steps = re.findall(r"fresh/bin/undrift (.+)", WORKFLOW.read_text(encoding="utf-8"))
    for step in steps:
        run("-c", "from undrift.cli.app import main; main()", *step.split(), cwd=tmp_path, **path)
    assert "".join(steps).endswith("certificate.html")
    assert (tmp_path / "certificate.html").stat().st_size > 10_000
