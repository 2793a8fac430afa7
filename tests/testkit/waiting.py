"""Waiting for an event instead of for a while: a busy machine is late, and only what never comes is a failure."""

import time
from collections.abc import Callable

LONG_S = 60.0


def eventually(condition: Callable[[], object], what: str, within_s: float = LONG_S) -> None:
    """Return as soon as a condition holds; fail when it never does."""
    last = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < last, f"in {within_s:g} s never: {what}"
        time.sleep(0.005)
