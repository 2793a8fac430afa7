"""Random devices spread as their grade says, and one property's draw does not move another's."""

from dataclasses import replace

import numpy as np
import pytest

from undrift.errors import InputError
from undrift.sim.device.presets import PRESETS, grade_of, random_device


def test_the_same_seed_gives_the_same_device() -> None:
    one, two = random_device(np.random.default_rng(5)), random_device(np.random.default_rng(5))
    assert one.serial == two.serial
    np.testing.assert_array_equal(one.gyro.forward_matrix, two.gyro.forward_matrix)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["consumer", "industrial", "wearable"])
def test_units_spread_as_the_grade_says(name: str) -> None:
    grade = grade_of(name).gyro
    rng = np.random.default_rng(6)
    units = [random_device(rng, grade=name).gyro for _ in range(400)]
    offsets = np.concatenate([unit.offset.constant for unit in units])  # type: ignore[union-attr]
    gains = np.concatenate([unit.scale.error for unit in units])
    error = 4.0 / np.sqrt(2.0 * 1200)  # four standard errors of a standard deviation
    assert np.std(offsets) == pytest.approx(grade.offset_sd, rel=error)
    assert np.std(gains) == pytest.approx(grade.sensitivity_sd, rel=error)
    leans = np.concatenate(
        [(unit.scale.axes / np.diag(unit.scale.axes)[:, None])[~np.eye(3, dtype=bool)] for unit in units]
    )
    assert np.std(leans) == pytest.approx(grade.misalignment_sd, rel=4.0 / np.sqrt(2.0 * 2400))


def test_a_wider_tolerance_of_one_property_leaves_the_others_as_they_were() -> None:
    grade = grade_of("consumer")
    wide = replace(grade, gyro=replace(grade.gyro, misalignment_sd=0.1))
    one, two = (random_device(np.random.default_rng(7), grade=g) for g in (grade, wide))
    np.testing.assert_array_equal(one.gyro.raw_offset, two.gyro.raw_offset)
    np.testing.assert_array_equal(one.accel.scale.axes, two.accel.scale.axes)
    assert not np.array_equal(one.gyro.scale.axes, two.gyro.scale.axes)


def test_a_grade_that_is_not_one_is_refused() -> None:
    with pytest.raises(InputError, match="unknown grade or preset 'gold'"):
        random_device(np.random.default_rng(1), grade="gold")


def test_devices_that_differ_in_anything_have_serial_numbers_of_their_own():
    """The same seed draws the same unit of a kind, and another serial of another kind."""
    kinds = [random_device(np.random.default_rng(0), grade=name).serial for name in PRESETS]
    grades = [
        random_device(np.random.default_rng(0), grade=name).serial for name in ("consumer", "industrial", "wearable")
    ]
    seeds = [random_device(np.random.default_rng(seed)).serial for seed in range(1, 4)]
    every = [*kinds, *grades, *seeds]
    assert len(set(every)) == len(every)
    changed = replace(grade_of("consumer"), trim_error_sd=0.5)
    assert random_device(np.random.default_rng(0), grade=changed).serial not in every
    assert random_device(np.random.default_rng(0)).serial == grades[0]
    assert random_device(np.random.default_rng(0), serial="A1").serial == "A1"
