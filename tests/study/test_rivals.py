"""The note's Discussion as an experiment: what each way to calibrate sees, and what that is worth in a task."""

import numpy as np
import pytest

from testkit.data import show
from undrift.errors import InputError
from undrift.sim.device.presets import random_device_of
from undrift.study.rivals import METHODS, RivalRow, Spread, calibrate_by, compare_rivals, rate_table_minutes

UNITS = 3


@pytest.fixture(scope="module")
def rows() -> dict[tuple[str, str], RivalRow]:
    """All methods on three units of the note's device, by task and method."""
    return {(row.task, row.method): row for row in compare_rivals(units=UNITS)}


def told(spread: Spread) -> str:
    """Return median and range."""
    return f"{spread.median:.2f} ({spread.least:.2f}-{spread.greatest:.2f})"


def test_every_method_has_the_rate_tables_time_and_a_row_in_both_tasks(rows: dict[tuple[str, str], RivalRow]) -> None:
    for (task, method), row in rows.items():
        show(
            f"{task}, {method}, {row.minutes:.1f} min, sees {' and '.join(row.observable) or 'nothing'}: rms, max, change, deg",
            f"{told(row.error_rms_deg)}, {told(row.error_max_deg)}, {told(row.change_max_deg)}; refused {row.refused}",
        )
        if method != "data_sheet":
            assert row.minutes == pytest.approx(rate_table_minutes(), rel=0.1)  # whole recordings and whole stills
    assert len(rows) == 2 * len(METHODS)


def test_the_rate_table_leaves_less_than_all_that_cannot_turn_the_device(rows: dict[tuple[str, str], RivalRow]) -> None:
    table = rows["sit_to_stand", "rate_table"]
    for method in ("data_sheet", "inclined_plane", "trolley", "piston"):
        other = rows["sit_to_stand", method]
        # A scale 20 % off in tolerance costs some per cent of 30 to 40 deg of lean.
        assert other.error_max_deg.median > 5.0 * table.error_max_deg.median
        assert "gyro" not in other.observable
    assert table.error_max_deg.median < 0.1


def test_poses_alone_calibrate_gyroscopes_and_leave_the_tilt_at_the_start(
    rows: dict[tuple[str, str], RivalRow],
) -> None:
    for method in ("mocap", "robot_arm"):
        row = rows["sit_to_stand", method]
        assert row.observable == ("gyro",)
        assert row.change_max_deg.median < 0.2
        assert row.error_max_deg.median > 3.0 * row.change_max_deg.median
        assert any("accelerometers not observable" in word for word in row.notes)
    both = rows["sit_to_stand", "plane_and_mocap"]
    assert both.observable == ("gyro", "accel")
    assert both.error_max_deg.median < 0.3


def test_what_a_method_cannot_see_is_a_finding_of_its_own_fit(rows: dict[tuple[str, str], RivalRow]) -> None:
    words = {method: " ".join(rows["sit_to_stand", method].notes) for method in METHODS}
    for method in METHODS:
        for word in rows["sit_to_stand", method].notes:
            show(method, word)
    assert "Gyroscope not observable" in words["inclined_plane"]
    assert "none that can be used" in words["trolley"]
    assert "none that can be used" in words["piston"]
    assert "nothing was recorded" in words["data_sheet"]


def test_same_seed_same_bits() -> None:
    device = random_device_of("enc03j_3031", np.random.default_rng(4))
    one, two = (
        calibrate_by("plane_and_mocap", device, kind="enc03j_3031", rng=np.random.default_rng(5), minutes=6.0)
        for _ in range(2)
    )
    assert one.calibration.gyro is not None
    assert two.calibration.gyro is not None
    assert np.array_equal(one.calibration.gyro.matrix, two.calibration.gyro.matrix)


def test_a_wrong_call_is_told() -> None:
    device = random_device_of("enc03j_3031", np.random.default_rng(4))
    rng = np.random.default_rng(5)
    with pytest.raises(InputError, match=r"wanted a method of data_sheet, rate_table, .*, got 'pendulum'"):
        calibrate_by("pendulum", device, kind="enc03j_3031", rng=rng)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="wanted 2 s or more for each still or run"):
        calibrate_by("inclined_plane", device, kind="enc03j_3031", rng=rng, minutes=1.0)
    with pytest.raises(InputError, match="wanted a unit, a method and a task or more, got 0"):
        compare_rivals(units=0)
