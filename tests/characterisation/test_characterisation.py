"""Every call gives the numbers that were recorded of it. How numbers are compared stands in compare.py.

A difference that is meant: ``python -m tests.characterisation --diff NAME``, look, then ``--record NAME`` and say why.
"""

import numpy as np
import pytest

from characterisation import calls
from characterisation.compare import RECORDED, compare, flatten, read_recorded, tolerance
from testkit.data import DATA

pytestmark = pytest.mark.usefixtures("computed_once", "described_once")
NAMES = sorted(calls.CALLS)


@pytest.mark.skipif(not DATA.is_dir(), reason="the public recordings are not there: set UNDRIFT_DATA")
@pytest.mark.parametrize("name", NAMES, ids=[calls.CALLS[name][0].replace(" ", "_") for name in NAMES])
def test_gives_the_recorded_numbers(name: str) -> None:
    r = tolerance()
    wrong = compare(name, read_recorded(name), calls.leaves_of(name), r)
    shown = "\n".join(map(str, wrong[:40]))
    assert not wrong, f"{name}: {len(wrong)} differences beyond {r:g} relative\n{shown}"


def test_every_recording_has_its_call_and_every_call_its_recording() -> None:
    assert sorted({path.stem for path in RECORDED.glob("*.json")} - {"machine"}) == NAMES


def test_a_number_that_moves_is_found() -> None:
    rng = np.random.default_rng(0)
    value = {"a": 1.0, "status": "good", "long": rng.normal(size=(500, 3)), "covariance": np.diag([1.0, 1e-12])}
    held = flatten(value)
    assert compare("x", held, flatten(value), 1e-12) == []
    moved = value["long"].copy()
    moved[137, 1] += 1e-8
    small = np.diag([1.0, 1e-12 * (1.0 + 1e-9)])
    for changed in (
        {"a": 1.0 + 1e-11},
        {"status": "bad"},
        {"long": moved},
        {"covariance": small},
        {"a": None},
    ):
        (found,) = compare("x", held, flatten(value | changed), 1e-12)
        assert found.path == next(iter(changed))
    residue = value["long"].copy()
    residue[0, 0] += 1e-16
    assert compare("x", held, flatten(value | {"long": residue}), 1e-12) == []


def test_a_missing_and_a_new_path_are_found() -> None:
    held = flatten({"a": 1.0, "b": {"c": 2.0}, "reasons": ["text"]})
    missing, new = compare("x", held, flatten({"a": 1.0, "d": 3.0}), 1e-12)
    assert (missing.path, new.path) == ("b.c", "d")
    assert "is missing" in missing.what
    assert "is new" in new.what
