"""Settings of the whole suite: the same examples in every run; `pytest --hypothesis-profile=hunt` looks for new ones.

What modules share is computed once in a run, whichever processes run them; see ``testkit.remembered``.
"""

import os
import shutil
from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

from testkit.data import DATA
from testkit.remembered import put_everywhere, remembered, run_folder

settings.register_profile("same", deadline=None, derandomize=True)
settings.register_profile("hunt", deadline=None, max_examples=3000)
settings.load_profile("same")


@pytest.hookimpl(wrapper=True)
def pytest_pyfunc_call() -> Generator[None, object, object]:
    return (yield from skipped_without_gcc())


@pytest.hookimpl(wrapper=True)
def pytest_fixture_setup() -> Generator[None, object, object]:
    return (yield from skipped_without_gcc())


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say how many tests did not run because the real recordings are absent. GitHub shows it beside a green job."""
    if not DATA.is_dir():
        skipped = terminalreporter.stats.get("skipped", [])
        count = sum("UNDRIFT_DATA" in str(report.longrepr) for report in skipped)
        mark = "::warning::" if "GITHUB_ACTIONS" in os.environ else ""
        terminalreporter.write_line(f"{mark}{count} tests were skipped: the real recordings are absent (UNDRIFT_DATA).")


def skipped_without_gcc() -> Generator[None, object, object]:
    """Skip a test that compiles C if this machine has no gcc."""
    try:
        return (yield)
    except FileNotFoundError as error:
        if error.filename == "gcc" and shutil.which("gcc") is None:
            pytest.skip("this machine has no gcc")
        raise


@pytest.fixture(scope="session")
def shared(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[Callable[..., object], Callable[..., object]]]:
    """Pure functions whose results tests share, each with one that remembers."""
    from undrift.calibration.reference import align
    from undrift.study.figure3 import calibrated, figure3
    from undrift.sync import find_lag, in_step, native_poses
    from undrift.twin.fit import fit_prepared
    from undrift.validation.agreement import validate_leave_one_out
    from undrift.validation.trial import validate_trial

    poses = native_poses, find_lag, in_step, align
    fits = fit_prepared, calibrated
    folder = run_folder(tmp_path_factory)
    return [
        (pure, remembered(pure, folder)) for pure in (*poses, *fits, figure3, validate_trial, validate_leave_one_out)
    ]


@pytest.fixture(scope="module")
def computed_once(shared: list[tuple[Callable[..., object], Callable[..., object]]]) -> Iterator[None]:
    """Compute once in a run of the suite what modules with this fixture share."""
    with pytest.MonkeyPatch.context() as patch:
        for function, once in shared:
            put_everywhere(patch, function, once)
        yield


@pytest.fixture(scope="module")
def described_once(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Read, describe and search each public file once in a run of the suite, for modules with this fixture."""
    from undrift.calibration.triads import find_disagreement
    from undrift.io.inspect import Description, describe
    from undrift.segments import find_poses

    folder = run_folder(tmp_path_factory)
    once = remembered(describe, folder)

    def description(path: Path, *args: Any, **words: Any) -> Description:
        return (once if Path(path).is_relative_to(DATA) else describe)(path, *args, **words)

    with pytest.MonkeyPatch.context() as patch:
        put_everywhere(patch, describe, description)
        for search in (find_disagreement, find_poses):
            put_everywhere(patch, search, remembered(search, folder))
        yield
