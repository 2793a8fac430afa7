"""Pure functions that are computed once in a process: what several tests need is made for all of them."""

import pickle
import sys
from collections.abc import Callable
from functools import wraps
from hashlib import blake2b
from typing import TypeVar

import pytest

T = TypeVar("T")


def remembered(function: Callable[..., T]) -> Callable[..., T]:
    """Return a function that computes once for equal arguments.

    Only for pure functions whose results are not written to; a generator among the arguments may not be used afterwards.
    """
    held: dict[bytes, T] = {}

    @wraps(function)
    def once(*args: object, **words: object) -> T:
        key = blake2b(pickle.dumps((args, sorted(words.items())))).digest()
        if key not in held:
            held[key] = function(*args, **words)
        return held[key]

    return once


def put_everywhere(patch: pytest.MonkeyPatch, function: Callable[..., T], instead: Callable[..., T]) -> None:
    """Put a function in the place of another in every module of undrift that has it by name."""
    for name, module in list(sys.modules.items()):
        if name.partition(".")[0] == "undrift":
            for attribute, value in list(vars(module).items()):
                if value is function:
                    patch.setattr(module, attribute, instead)
