"""Access to the real recordings, and printing of the figures that a test asserts."""

import os
from pathlib import Path

import pytest

DATA = Path(os.environ.get("UNDRIFT_DATA", Path(__file__).parents[2] / ".." / "shared" / "data")).resolve()

needs_data = pytest.mark.skipif(not DATA.is_dir(), reason="the folder of recordings is absent (UNDRIFT_DATA)")


def data_path(*parts: str) -> Path:
    """Return a file of the public recordings. Skip the test if the folder is missing."""
    if not DATA.is_dir():
        pytest.skip(f"no public recordings at {DATA}: set UNDRIFT_DATA")
    path = DATA.joinpath(*parts)
    if not path.exists():
        pytest.fail(f"{path} is missing from the public recordings")
    return path


def show(label: str, value: object, limit: object = None) -> None:
    """Print a figure and its limit. `pytest -s` or a failing test shows it."""
    print(f"  {label}: {value}" + ("" if limit is None else f"   (limit {limit})"))
