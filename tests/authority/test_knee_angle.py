"""Knee angle of two misplaced sensors on people who were filmed, with and without their axes (benchmarks/knee_angle.py)."""

import pytest
from benchmarks.knee_angle import TRIALS, judged

from testkit.data import data_path, show

LARGEST_DEG, WITHOUT_DEG = 2.0, 10.0  # rms: with axes at most, without at least, of devices that are 20 deg off


@pytest.mark.slow
@pytest.mark.parametrize(("name", "side"), TRIALS)
def test_the_knee_of_a_filmed_person_is_right_with_axes_and_not_without(name, side):
    data_path("mocap_sit_to_stand", "SOURCE.md")
    row = judged(name, side, 20.0)
    show(f"{name} {side}: rms error with axes, deg", f"{row.found:.2f}", LARGEST_DEG)
    show(f"{name} {side}: rms error without, deg", f"{row.plain:.2f}", WITHOUT_DEG)
    show(f"{name} {side}: stated, deg", f"{row.stated:.2f}")
    assert row.found < LARGEST_DEG
    assert row.found < 2.0 * row.stated
    assert row.plain > WITHOUT_DEG
    assert row.off < 2.0 * row.stated_off
