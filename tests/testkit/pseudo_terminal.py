"""A pseudo-terminal as a serial line. Its tests are skipped on systems without pseudo-terminals, such as Windows."""

import os

import pytest


def open_pseudo_terminal() -> tuple[int, int]:
    """Return the device's end and the computer's end, both as raw bytes."""
    if not hasattr(os, "openpty"):
        pytest.skip("this system has no pseudo-terminals")
    import tty

    near, far = os.openpty()
    tty.setraw(far)
    return near, far
