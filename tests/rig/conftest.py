"""What tests of rigs share."""

import pytest

from undrift.files import LIMITS


@pytest.fixture(scope="package", autouse=True)
def own_pieces_are_trusted():
    """Read the pieces of runs without a box for each, which tests/io/test_box.py tries: a run writes dozens of them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(LIMITS, "trust", True)
        yield
