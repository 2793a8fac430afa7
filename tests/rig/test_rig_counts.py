"""Counts and angles, and how a card rounds."""

import math

import pytest

from undrift.errors import InputError, LimitError
from undrift.rig.rig import ACCELERATION, MOVE, SLEW, CountScale

DEGREE = math.pi / 180.0
NOTE = CountScale.from_lines(10_000)


def test_the_rig_of_the_note_has_111_counts_a_degree():
    assert NOTE.counts_per_turn == 40_000
    assert NOTE.counts(DEGREE) == pytest.approx(111.1111, abs=1e-4)
    assert NOTE.angle(1) / DEGREE == pytest.approx(0.009, rel=1e-12)


@pytest.mark.parametrize(
    ("wanted_dps", "counts", "achieved_dps"),
    [(90, 10_000, 90.0), (45, 5000, 45.0), (5, 556, 5.004), (3, 334, 3.006), (0.1, 12, 0.108), (-0.1, -12, -0.108)],
)
def test_rates_of_the_note_become_even_counts_per_second(wanted_dps, counts, achieved_dps):
    rounded = SLEW.round(NOTE.counts(wanted_dps * DEGREE))
    assert rounded == counts
    assert NOTE.angle(rounded) / DEGREE == pytest.approx(achieved_dps, rel=1e-12)


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
    with pytest.raises(
        LimitError, match=rf"{grid.name}: .* {grid.smallest} to {grid.largest} in steps of {grid.step}, got"
    ):
        grid.round(counts)


@pytest.mark.parametrize("angle", [math.nan, math.inf])
def test_what_is_no_number_is_refused(angle):
    with pytest.raises(InputError, match="must be finite"):
        NOTE.counts(angle)


def test_an_encoder_without_lines_is_refused():
    with pytest.raises(InputError, match=r"encoder: counts per turn .*got 0"):
        CountScale.from_lines(0)
