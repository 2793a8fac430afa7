"""The kernels as Python, which is what a debugger sees and what the source says."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

TESTS = Path(__file__).parents[1]
CALLERS = (
    "correction/test_correct.py",
    "correction/test_correct_conditions.py",
    "test_orientation.py",
)
# Every kernel and its corners once; the rest of the callers' tests says nothing more of the source.
CHOSEN = (
    "kernels or every_step_agrees and -g-truncated or long_records and 257 or gap or hold_keeps or on_each_side "
    "or seconds_of_a_stream or ideal_readings or not_depend_on_the_length"
)


@pytest.mark.slow
def test_kernels_that_are_not_compiled_pass_their_tests():
    modules = [path for path in sorted(TESTS.glob("kernels/test_*.py")) if path != Path(__file__)]
    words = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", *modules, *(TESTS / name for name in CALLERS)]
    words += ["-k", CHOSEN]
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("PYTEST_", "TEST_POOL"))}
    environment["NUMBA_DISABLE_JIT"] = "1"
    done = subprocess.run(words, cwd=TESTS.parent, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
    assert " passed" in done.stdout
