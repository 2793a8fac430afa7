"""The note's Discussion as an experiment: what each way to calibrate sees, and what that is worth in a task."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.data import show
from undrift.errors import InputError
from undrift.sim.bench_errors import BenchErrors
from undrift.sim.device.presets import random_device_of
from undrift.study import rivals
from undrift.study.rivals import (
    METHODS,
    Method,
    RivalPlan,
    RivalRow,
    Rivals,
    Spread,
    calibrate_by,
    compare_rivals,
    rate_table_minutes,
)

UNITS = 3


@pytest.fixture(scope="module")
def compared() -> Rivals:
    """All methods on three units of the note's device."""
    return compare_rivals(RivalPlan(units=UNITS))


@pytest.fixture(scope="module")
def rows(compared: Rivals) -> dict[tuple[str, str], RivalRow]:
    """The same by task and method."""
    return {(row.task, row.method): row for row in compared.rows}


def told(spread: Spread) -> str:
    """Return median and range."""
    return f"{spread.median:.2f} ({spread.least:.2f}-{spread.greatest:.2f})"


@pytest.mark.slow
def test_every_method_has_the_rate_tables_time_and_a_row_in_both_tasks(rows: dict[tuple[str, str], RivalRow]) -> None:
    for (task, method), row in rows.items():
        show(
            f"{task}, {method}, {row.minutes:.1f} min, sees {' and '.join(row.observable) or 'nothing'}: rms, max, change, deg",
            f"{told(row.error_rms_deg)}, {told(row.error_max_deg)}, {told(row.change_max_deg)}; refused {row.refused}",
        )
        if method != "data_sheet":
            assert row.minutes == pytest.approx(rate_table_minutes(), rel=0.1)  # whole recordings and whole stills
    assert len(rows) == 2 * len(METHODS)


@pytest.mark.slow
def test_the_rate_table_leaves_less_than_all_that_cannot_turn_the_device(rows: dict[tuple[str, str], RivalRow]) -> None:
    table = rows["sit_to_stand", "rate_table"]
    for method in ("data_sheet", "inclined_plane", "trolley", "piston"):
        other = rows["sit_to_stand", method]
        # A scale 20 % off in tolerance costs some per cent of 30 to 40 deg of lean.
        assert other.error_max_deg.median > 5.0 * table.error_max_deg.median
        assert "gyro" not in other.observable
    assert table.error_max_deg.median < 0.1


@pytest.mark.slow
def test_poses_with_positions_calibrate_both_triads(rows: dict[tuple[str, str], RivalRow], compared: Rivals) -> None:
    triads = {(row.triad, row.method): row for row in compared.triads}
    for method in ("mocap", "robot_arm"):
        assert rows["sit_to_stand", method].observable == ("gyro", "accel")
        assert rows["sit_to_stand", method].change_max_deg.median < 0.2
        accel = triads["accel", method]
        assert accel.calibrated == UNITS
        # Mounted 0.1 deg off about three axes and 0.05 deg off level: 0.15 deg of tilt rms, three times that at most.
        assert accel.worth[0].error_deg.greatest < 0.5
        assert accel.scale_percent.greatest < 0.2
    assert triads["accel", "data_sheet"].calibrated == 0
    assert triads["accel", "data_sheet"].worth[0].error_deg.least > 1.0


@pytest.mark.slow
def test_each_triad_is_judged_against_the_rate_table(compared: Rivals) -> None:
    assert [(row.triad, row.method) for row in compared.triads] == [
        (triad, method) for triad in ("gyro", "accel") for method in METHODS
    ]
    for row in compared.triads:
        assert [worth.figure for worth in row.worth] == (
            ["sit_to_stand", "posturography"] if row.triad == "gyro" else ["tilt"]
        )
        for worth in row.worth:
            assert (worth.decision is None) == (row.method == "rate_table")
            if worth.decision is not None:
                assert worth.decision.margin == 0.15
                assert worth.decision.tests == (len(METHODS) - 1) * len(row.worth)
    for name in ("inclined_plane", "trolley", "piston"):
        (gyro,) = (row for row in compared.triads if (row.triad, row.method) == ("gyro", name))
        assert gyro.calibrated == 0


@pytest.mark.slow
@pytest.mark.parametrize(("planted", "verdict"), [("trolley", "better"), ("rate_table", "worse")])
def test_a_perfect_bench_for_one_method_is_seen(monkeypatch: pytest.MonkeyPatch, planted: Method, verdict: str) -> None:
    how = rivals._HOW[planted]
    monkeypatch.setitem(
        rivals._HOW, planted, lambda bench: how(replace(bench, errors=BenchErrors()))
    )  # and no drive that errs
    tilt = 1.5 * np.pi / 180.0
    errors = BenchErrors(face_tilt=tilt, mount_tilt=tilt)
    plan = RivalPlan(units=3, minutes=3.0, methods=("rate_table", "trolley"), tasks=("sit_to_stand",), errors=errors)
    (decision,) = (
        worth.decision
        for row in compare_rivals(plan).triads
        if (row.triad, row.method) == ("accel", "trolley")
        for worth in row.worth
    )
    assert decision is not None
    show("tilt by the trolley against six faces, deg", (decision.difference, decision.interval))
    assert decision.verdict == verdict


@pytest.mark.slow
def test_optics_and_an_arm_are_mounted_alike_by_one_state() -> None:
    device = random_device_of("enc03j_3031", np.random.default_rng(4))
    crooked = BenchErrors(mount_tilt=1.0 * np.pi / 180.0)
    found = []
    for method, seed in (("mocap", 5), ("robot_arm", 5), ("mocap", 6)):
        words = {"kind": "enc03j_3031", "rng": np.random.default_rng(seed), "minutes": 3.0, "errors": crooked}
        gyro = calibrate_by(method, device, **words).calibration.gyro  # type: ignore[arg-type]
        assert gyro is not None
        found.append(gyro.matrix / np.linalg.norm(gyro.matrix, 2))
    assert np.abs(found[0] - found[1]).max() < 3e-3  # rad; 0.05 deg that lasts 5 s, over three minutes
    assert np.abs(found[0] - found[2]).max() > 5e-3  # two draws of 17 mrad about three axes


@pytest.mark.slow
def test_what_a_method_cannot_see_is_a_finding_of_its_own_fit(rows: dict[tuple[str, str], RivalRow]) -> None:
    words = {method: " ".join(rows["sit_to_stand", method].notes) for method in METHODS}
    for method in METHODS:
        for word in rows["sit_to_stand", method].notes:
            show(method, word)
    assert "Gyroscope not observable" in words["inclined_plane"]
    assert "none that can be used" in words["trolley"]
    assert "none that can be used" in words["piston"]
    assert "nothing was recorded" in words["data_sheet"]


def test_a_wrong_call_is_told() -> None:
    device = random_device_of("enc03j_3031", np.random.default_rng(4))
    rng = np.random.default_rng(5)
    with pytest.raises(InputError, match=r"wanted a method of data_sheet, rate_table, .*, got 'pendulum'"):
        calibrate_by("pendulum", device, kind="enc03j_3031", rng=rng)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="wanted 2 s or more for each still or run"):
        calibrate_by("inclined_plane", device, kind="enc03j_3031", rng=rng, minutes=1.0)
    with pytest.raises(InputError, match="wanted a unit, a method and a task or more, got 0"):
        RivalPlan(units=0)
