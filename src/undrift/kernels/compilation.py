"""Compilation of kernels with numba, if it is installed. Without numba, as in a browser, they run as Python."""

from collections.abc import Callable
from contextlib import suppress
from typing import Any, TypeVar

njit: Any = None
with suppress(ImportError):
    from numba import njit

COMPILED = njit is not None
T = TypeVar("T", bound=Callable[..., Any])


def compiled(kernel: T) -> T:
    """Return a kernel as machine code. A product and a sum may be rounded once, as ``fma`` does."""
    return njit(cache=True, fastmath={"contract"}, nogil=True, error_model="numpy")(kernel) if COMPILED else kernel


def compiled_to_the_bit(kernel: T) -> T:
    """Return a kernel as machine code that gives the same bits on any machine."""
    return njit(cache=True, nogil=True, error_model="numpy")(kernel) if COMPILED else kernel
