"""What live calibration shows: an element is known when it says so, and the movement it asks for shows it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from testkit.data import show
from testkit.guided_motion import GRAVITY, TurnedDevice, guided_recording
from undrift.calibration.calibrate import from_motion
from undrift.calibration.element_prior import ELEMENTS
from undrift.calibration.in_motion import InMotion
from undrift.calibration.live_motion import ElementKnown, elements_known
from undrift.model import Calibration
from undrift.record import Record, Session


def fitted(record: Record) -> tuple[Calibration, InMotion]:
    session = Session(kind="calibration", serial="A", gravity_m_s2=GRAVITY, gravity_source="stated", records=(record,))
    return from_motion(session, identify_adc=False)


def errors_of(made: Calibration, fit: InMotion, device: TurnedDevice) -> np.ndarray:
    """Return the errors of the elements in their order and units, by what the readings were made with."""
    assert made.gyro is not None
    assert made.accel is not None
    gyro, accel = (
        100.0 * ELEMENTS[:6, :9] @ (triad.matrix - np.linalg.inv(true)).ravel()
        for triad, true in ((made.gyro, device.gyro), (made.accel, device.accel))
    )
    offsets = np.degrees(fit.offsets[-1] - device.gyro_offset), made.accel.offset - device.accel_offset
    return np.concatenate((gyro, offsets[0], accel, offsets[1]))


@pytest.mark.slow
@pytest.mark.parametrize("devices", [3, 40])
def test_elements_are_within_what_is_shown_when_collecting_stops(devices: int) -> None:
    errors, expanded, stops = [], [], []
    for seed in range(devices):
        (record, device), before = guided_recording(seed, 4), False
        for seconds in np.arange(20.02, record.duration_s, 15.0):
            made, fit = fitted(record.between(0.0, seconds))
            known = elements_known(made, fit)
            now = all(one.enough for one in known)
            if now and before:
                break
            before = now
        else:
            raise AssertionError(f"device {seed} was never known")
        stops.append(seconds)
        errors.append(errors_of(made, fit, device))
        expanded.append([one.uncertainty for one in known])
    error, shown = np.array(errors), np.array(expanded)
    inside = float((np.abs(error) < 0.98 * shown).mean())
    ratio = np.sqrt((error**2).mean(axis=0) / (0.25 * shown**2).mean(axis=0)).reshape(6, 3).mean(axis=1)
    show("stop, s: least, median, most", np.percentile(stops, (0, 50, 100)))
    show("inside 95 %; rms error over stated of each group", (inside, np.round(ratio, 2).tolist()), ">= 0.90")
    assert inside >= 0.90
    assert np.median(stops) < 120.0


def test_limits_follow_the_percentage_and_a_raw_device_in_other_units_is_known_as_far() -> None:
    record, _ = guided_recording(1, 1)
    made, fit = fitted(record)
    one, twice = elements_known(made, fit), elements_known(made, fit, 1.0)
    assert [e.wanted for e in twice] == pytest.approx([2.0 * e.wanted for e in one])
    assert [(e.name, e.axis, e.unit) for e in one[::3]] == [
        ("gyroscope scale", "x", "%"), ("gyroscope cross-axis", "y-z", "%"), ("gyroscope offset", "x", "deg/s"),
        ("accelerometer scale", "x", "%"), ("accelerometer cross-axis", "y-z", "%"), ("accelerometer offset", "x", "m/s2"),
    ]  # fmt: skip
    assert [one[3 * k].wanted for k in range(6)] == pytest.approx([0.5, 0.5, 0.05, 0.5, 0.5, 0.005 * 9.80665])
    other = replace(
        record, gyro=np.degrees(record.gyro), accel=np.asarray(record.accel) / GRAVITY, gyro_unit="dps", accel_unit="g"
    )
    assert [e.uncertainty for e in elements_known(*fitted(other))] == pytest.approx(
        [e.uncertainty for e in one], rel=0.02
    )  # g is standard gravity there


def least(known: tuple[ElementKnown, ...]) -> ElementKnown:
    return max(known, key=lambda one: one.uncertainty / one.wanted)


@pytest.mark.slow
def test_the_movement_that_is_asked_for_shows_the_element() -> None:
    time = np.arange(4000) / 50.0
    rng = np.random.default_rng(3)

    def turned_about(axis: int, size: float, rate: float = 0.6) -> Record:
        """To and fro about x or y, both level while the device turns about one of them."""
        angle = size * np.sin(rate * time)
        gyro, force = np.zeros((2, 4000, 3))
        gyro[:, axis] = size * rate * np.cos(rate * time)
        other = 1 - axis
        force[:, other] = np.sin(angle) * (1.0 if axis == 0 else -1.0) * GRAVITY
        force[:, 2] = np.cos(angle) * GRAVITY
        noise = rng.normal(0.0, 1e-3, (4000, 3)), rng.normal(0.0, 0.05, (4000, 3))
        return Record(time=time, gyro=gyro + noise[0], accel=force + noise[1])

    known = elements_known(*fitted(turned_about(1, 3.0)))
    scales = {one.axis: one for one in known if one.name == "gyroscope scale"}
    show("gyroscope scale, % at 95 %", {axis: round(one.uncertainty, 2) for axis, one in scales.items()})
    assert scales["y"].enough
    assert not scales["x"].enough
    assert scales["x"].movement.startswith("level its x axis and turn it about that axis")
    session = Session(
        kind="calibration",
        serial="A",
        gravity_m_s2=GRAVITY,
        gravity_source="stated",
        records=(turned_about(1, 3.0), turned_about(0, 3.0)),
    )
    both = {one.axis: one for one in elements_known(*from_motion(session, identify_adc=False))[:3]}
    assert both["x"].uncertainty < 0.5 * scales["x"].uncertainty
    assert least(known).movement


@pytest.mark.slow
def test_gaps_part_a_recording_and_short_ones_are_bridged(tmp_path: Path) -> None:
    record, device = guided_recording(2, 2)
    gyro, accel = np.array(record.gyro), np.array(record.accel)
    gyro[3000:3003] = np.nan  # 0.03 s: a line
    gyro[6000:6200] = np.nan  # 2 s: another stretch
    accel[9000] = np.nan
    made, fit = fitted(replace(record, gyro=gyro, accel=accel))
    assert len(fit.offsets) == 2
    (gaps,) = [one for one in made.verdict.findings if one.code == "motion.gaps"]
    assert (gaps.values["missing"], gaps.values["stretches"]) == (200, 2)
    known = elements_known(made, fit)
    inside = np.abs(errors_of(made, fit, device)) < [one.uncertainty for one in known]
    assert inside.mean() >= 0.9
    whole, _ = fitted(record)
    assert whole.gyro is not None
    assert "motion.gaps" not in [one.code for one in whole.verdict.findings]
