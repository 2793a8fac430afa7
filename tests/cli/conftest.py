"""The bench and the command line of these tests."""

from testkit.bench_and_commands import bench, undrift

__all__ = ["bench", "undrift"]
