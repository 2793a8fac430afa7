"""Counts of an encoder, and how a card rounds."""

import math

import pytest

from undrift.errors import InputError, LimitError
from undrift.rig.rig import ACCELERATION, MOVE, SLEW, RigSettings

DEGREE = math.pi / 180.0
COUNT = RigSettings(encoder_lines=10_000).count  # 111 counts a degree, as on the rig of the note


@pytest.mark.parametrize(
    ("wanted_dps", "counts", "achieved_dps"),
    [(90, 10_000, 90.0), (45, 5000, 45.0), (5, 556, 5.004), (3, 334, 3.006), (0.1, 12, 0.108), (-0.1, -12, -0.108)],
)
def test_rates_of_the_note_become_even_counts_per_second(wanted_dps, counts, achieved_dps):
    assert SLEW.round(wanted_dps * DEGREE / COUNT) == counts
    assert counts * COUNT / DEGREE == pytest.approx(achieved_dps, rel=1e-12)


@pytest.mark.parametrize(
    ("grid", "counts", "held"),
    [(ACCELERATION, 256_000, 256_000), (ACCELERATION, 1500, 1024), (ACCELERATION, 1600, 2048), (SLEW, 25_001, 25_002)],
)
def test_accelerations_are_multiples_of_1024_and_slew_speeds_even(grid, counts, held):
    assert grid.round(counts) == held


@pytest.mark.parametrize(
    ("grid", "counts"), [(SLEW, 0.4), (SLEW, 2e7), (ACCELERATION, 500.0), (MOVE, 3e9), (SLEW, -0.1)]
)
def test_what_the_card_cannot_hold_is_refused_with_its_range(grid, counts):
    with pytest.raises(LimitError, match=rf"{grid.name}: .* {grid.smallest} to {grid.largest} in steps of {grid.step}"):
        grid.round(counts)


def test_an_encoder_without_lines_is_refused():
    with pytest.raises(InputError, match=r"`encoder_lines` must be above 0"):
        RigSettings(encoder_lines=0)
