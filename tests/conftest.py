"""Settings of the whole suite: the same examples in every run; `pytest --hypothesis-profile=hunt` looks for new ones.

Tests of one module run in one process, so that what they share is made once (`--dist loadgroup`); modules that share more name a
group of their own with ``pytest.mark.xdist_group``.
"""

from collections.abc import Callable, Iterator

import pytest
from hypothesis import settings

settings.register_profile("same", deadline=None, derandomize=True)
settings.register_profile("hunt", deadline=None, max_examples=3000)
settings.load_profile("same")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if item.get_closest_marker("xdist_group") is None:
            item.add_marker(pytest.mark.xdist_group(item.path.stem))


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
    """Compute once in a process what modules with this fixture share; those that share with others are the group ``shared``."""
    from testkit.remembered import put_everywhere

    with pytest.MonkeyPatch.context() as patch:
        for function, once in shared:
            put_everywhere(patch, function, once)
        yield
