"""Settings of the whole suite: the same examples in every run; `pytest --hypothesis-profile=hunt` looks for new ones.

With `pytest -n`, tests of one module run in one process, so that what they share is made once; so do the modules of ``SHARING``.
"""

import os
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from hypothesis import settings
from xdist.scheduler.loadscope import LoadScopeScheduling

os.environ["UNDRIFT_REGISTRY"] = os.path.join(os.sep, "nowhere", "registry.sqlite")  # never that of a person

settings.register_profile("same", deadline=None, derandomize=True)
settings.register_profile("hunt", deadline=None, max_examples=3000)
settings.load_profile("same")

SHARING = (
    "tests/study/test_figure3.py",
    "tests/study/test_report.py",
    "tests/study/test_real.py",
    "tests/cli/test_study.py",
    "tests/authority/test_study_real.py",
    "tests/authority/test_broad_page.py",
    "tests/authority/test_broad_lag.py",
    "tests/authority/test_broad_twin.py",
    "tests/authority/test_broad_reference.py",
    "tests/authority/test_broad_rows.py",
    "tests/authority/test_poses_on_broad.py",
)
LONGEST = (
    *SHARING,
    "tests/recover/test_static_drift.py",
    "tests/recover/test_figure3.py",
    "tests/recover/test_dynamic_drift.py",
)


class Modules(LoadScopeScheduling):
    """Give each process whole modules."""

    def _split_scope(self, nodeid: str) -> str:
        module = nodeid.partition("::")[0]
        return SHARING[0] if module in SHARING else module


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> LoadScopeScheduling:
    return Modules(config, log)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Start what takes longest first."""
    rank = {module: -len(LONGEST) + i for i, module in enumerate(LONGEST)}
    items.sort(key=lambda item: rank.get(item.nodeid.partition("::")[0], 0))


@pytest.fixture(scope="session")
def shared() -> list[tuple[Callable[..., object], Callable[..., object]]]:
    """Pure functions whose results tests share, each with one that remembers."""
    from testkit.remembered import remembered
    from undrift.calibration.reference import prepare
    from undrift.drift.select import choose_tables
    from undrift.study.figure3 import calibrated
    from undrift.sync import find_lag, native_poses
    from undrift.twin.fit import fit_prepared
    from undrift.validation.agreement import validate_leave_one_out
    from undrift.validation.trial import validate_trial

    poses = native_poses, find_lag, prepare
    fits = choose_tables, fit_prepared, calibrated
    return [(pure, remembered(pure)) for pure in (*poses, *fits, validate_trial, validate_leave_one_out)]


@pytest.fixture(scope="module")
def computed_once(shared: list[tuple[Callable[..., object], Callable[..., object]]]) -> Iterator[None]:
    """Compute once in a process what modules with this fixture share; see ``SHARING``."""
    from testkit.remembered import put_everywhere

    with pytest.MonkeyPatch.context() as patch:
        for function, once in shared:
            put_everywhere(patch, function, once)
        yield
