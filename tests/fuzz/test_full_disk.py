"""Commands on a disk that is full at any write: one clear line, no half file, nothing lost; and a full place of results."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from testkit.data import needs_data, show

TESTS = Path(__file__).parents[1]
REST = Path(__file__).parents[2] / "src" / "undrift" / "sample_data" / "rest.parquet"


@pytest.mark.slow
@needs_data
@pytest.mark.parametrize("few", [True, False])
def test_a_disk_that_is_full_at_any_write_is_one_clear_line_and_costs_nothing(few):
    words = [sys.executable, "-m", "fuzz.full_disk", *(["--few"] if few else [])]
    done = subprocess.run(
        words, cwd=TESTS, capture_output=True, text=True, timeout=60.0 if few else 7200.0, check=False
    )
    show("a full disk", done.stdout.splitlines()[-1])
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="a device of Linux")
@pytest.mark.parametrize("more", [[], ["--json"]])
def test_an_answer_that_does_not_fit_on_the_disk_is_one_line(more):
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "undrift", "info", REST, *more], stdout=full, stderr=subprocess.PIPE, text=True, timeout=60,
            check=False,
        )  # fmt: skip
    assert (done.returncode, done.stderr) == (
        2,
        "undrift: file: No space left on device. Free disk space and run it again.\n",
    )
