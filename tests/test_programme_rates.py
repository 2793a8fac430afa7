"""Protocol: the note's grids, and what cannot be done is refused."""

from dataclasses import replace

import numpy as np
import pytest

from undrift.errors import InputError
from undrift.programme import Protocol, rate_grid

DPS = np.pi / 180.0
SIT_TO_STAND = Protocol(turn_rate_min=5 * DPS, turn_rate_max=90 * DPS, turn_rate_step=5 * DPS, grid="paper")


@pytest.mark.parametrize(
    ("limits", "paper", "inclusive"),
    [((5.0, 90.0, 5.0), 102, 108), ((3.0, 45.0, 3.0), 84, 90), ((0.1, 5.0, 0.1), 294, 300)],
)
def test_the_grid_counts_the_columns_as_the_note_does(
    limits: tuple[float, float, float], paper: int, inclusive: int
) -> None:
    assert 3 * len(rate_grid(*limits, rule="paper")) == paper
    assert 3 * len(rate_grid(*limits, rule="inclusive")) == inclusive
    assert rate_grid(*limits, rule="inclusive").max() == pytest.approx(limits[1])
    assert np.abs(rate_grid(*limits, rule="paper")).min() == pytest.approx(limits[0] + limits[2])


def test_the_note_lists_34_rates_an_axis_from_ten_to_ninety() -> None:
    np.testing.assert_allclose(rate_grid(5.0, 90.0, 5.0, rule="paper")[17:], np.arange(10.0, 91.0, 5.0))


def test_a_grid_that_cannot_be_is_refused() -> None:
    with pytest.raises(InputError, match=r"must divide 85, got 4.* 4\.04"):
        rate_grid(5.0, 90.0, 4.0)
    with pytest.raises(InputError, match=r"positive step .*got 5, 3, 1"):
        rate_grid(5.0, 3.0, 1.0)


def test_a_protocol_gives_its_rates_in_radians() -> None:
    rates = SIT_TO_STAND.turn_rates()
    assert len(rates) == 34
    assert rates[-1] == pytest.approx(np.pi / 2.0)
    assert len(replace(SIT_TO_STAND, turn_rate_step=0.0).turn_rates()) == 0


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"faces": (), "turn_rate_step": 0.0}, "faces, rates and turns"),
        ({"dwell_s": None}, "dwell_s and turn_rate_uncertainty"),
        ({"dwell_s": 0.0}, "`dwell_s` must be above 0"),
        ({"temperatures_c": (30.0, 20.0)}, "temperatures must increase"),
        ({"acceleration": -1.0}, "`acceleration` must be above 0"),
        ({"face_s": float("nan")}, "face_s .*got nan"),
    ],
)
def test_what_cannot_be_done_is_refused(change: dict[str, object], text: str) -> None:
    with pytest.raises(InputError, match=text):
        replace(SIT_TO_STAND, **change)  # type: ignore[arg-type]
