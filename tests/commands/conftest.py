"""The bench, the command line and the hand-held device of these tests."""

import pytest

from testkit.bench_and_commands import bench, undrift
from testkit.guided import HandFeed

__all__ = ["bench", "undrift"]


@pytest.fixture
def feed():
    with HandFeed(seed=5) as made:
        yield made
