"""Library of tasks: 200 performances by the 60 subjects keep to what is known of such tasks.

Bounds that are measured or stand in the note's Table 1 are held strictly; medians are held to ranges that are
assumed, which guards the generators and proves nothing about people.
"""

import functools
from dataclasses import dataclass

import numpy as np
import pytest

from testkit.data import show
from undrift.frames import rotate
from undrift.sim.motion.motion import Motion
from undrift.sim.motion.tasks import Task, TaskName, cohort, draw_task

DRAWS, STANCES = 200, 60


@dataclass(frozen=True)
class Drawn:
    task: Task
    motion: Motion
    pitch: np.ndarray
    roll: np.ndarray
    push_n: np.ndarray


@functools.cache
def drawn(name: TaskName) -> tuple[Drawn, ...]:
    rng = np.random.default_rng(10)
    people = cohort("simulation", rng=rng) + cohort("testing", rng=rng)
    found = []
    for index in range(STANCES if name == "posturography" else DRAWS):
        task = draw_task(name, rng=rng, subject=people[index % len(people)])
        motion = task.at(np.arange(task.moving_s[0], task.moving_s[1], 0.01), 9.81)
        down = rotate(motion.q_nb * [1.0, -1.0, -1.0, -1.0], np.broadcast_to([0.0, 0.0, 1.0], (len(motion), 3)))
        pitch, roll = np.degrees(np.arcsin(-down[:, 0])), np.degrees(np.arctan2(down[:, 1], down[:, 2]))
        found.append(Drawn(task, motion, pitch, roll, rotate(motion.q_nb, motion.force_b) - [0.0, 0.0, 9.81]))
    return tuple(found)


def table(name: TaskName, label: str, values: list[float], limit: str) -> np.ndarray:
    array = np.array(values)
    low, middle, high = np.percentile(array, (0, 50, 100))
    show(f"{name}, {label}: least, median, most; mean (sd)", f"{low:.3g} {middle:.3g} {high:.3g}; "
         f"{array.mean():.3g} ({array.std():.2g})", limit)  # fmt: skip
    return array


def share_below(x: np.ndarray, limit_hz: float) -> float:
    power = np.abs(np.fft.rfft(x - x.mean())) ** 2
    return float(power[np.fft.rfftfreq(len(x), 0.01) <= limit_hz].sum() / power.sum())


@pytest.mark.slow
def test_sitting_to_standing_keeps_its_bounds() -> None:
    name: TaskName = "sit_to_stand"
    all_of = drawn(name)
    lasts = table(
        name, "duration with 0.5-1.5 s sway, s", [d.motion.time[-1] - d.motion.time[0] for d in all_of], "2-6"
    )
    assert lasts.min() >= 2.0
    assert lasts.max() <= 6.0
    rates = np.degrees([np.abs(d.motion.rate_b).max() for d in all_of])
    table(name, "largest rate about any axis, deg/s", list(rates), "90: Table 1")
    assert rates.max() <= 90.0 + 0.1  # looked at every 20 ms when drawn: the peak may lie between
    forward = table(
        name, "peak flexion rate, deg/s", [np.degrees(d.motion.rate_b[:, 1].max()) for d in all_of], "65 (15)"
    )
    assert 50.0 < np.median(forward) < 80.0
    back = table(
        name, "peak extension rate, deg/s", [-np.degrees(d.motion.rate_b[:, 1].min()) for d in all_of], "55 (15)"
    )
    assert 40.0 < np.median(back) < 70.0
    push = [np.degrees(np.abs(d.motion.angular_acceleration_b[:, 1]).max()) for d in all_of]  # type: ignore[index]
    assert 200.0 < np.median(table(name, "peak angular acceleration, deg/s2", push, "250-400")) < 400.0
    lean = table(name, "pitch excursion, deg", [d.pitch.max() - d.pitch[0] for d in all_of], "32 (7)")
    assert np.mean(lean) == pytest.approx(32.0, abs=2.0)
    assert np.std(lean) == pytest.approx(7.0, abs=2.0)
    when = [float(np.argmax(d.pitch)) / (len(d.pitch) - 100) for d in all_of]
    assert 0.33 < np.median(table(name, "instant of the turn over duration", when, "0.40")) < 0.47
    up = table(name, "upward acceleration, m/s2", [np.abs(d.push_n[:, 2]).max() for d in all_of], "2-3")
    assert 1.8 < np.median(up) < 3.2
    on = table(name, "forward acceleration, m/s2", [np.abs(d.push_n[:, 0]).max() for d in all_of], "1-2")
    assert 1.0 < np.median(on) < 2.0
    low = table(name, "share of pitch power below 3 Hz", [share_below(d.pitch, 3.0) for d in all_of], "0.95")
    assert low.min() > 0.95
    assert max(np.abs(d.roll - d.roll[0]).max() for d in all_of) < 5.0  # 3 deg and the sway


@pytest.mark.slow
def test_rising_a_step_keeps_its_bounds() -> None:
    name: TaskName = "step"
    all_of = drawn(name)
    rates = np.degrees([np.abs(d.motion.rate_b).max() for d in all_of])
    table(name, "largest rate about any axis, deg/s", list(rates), "45: Table 1")
    assert rates.max() <= 45.0 + 0.1
    lasts = table(
        name, "duration with 1 s after it, s", [d.motion.time[-1] - d.motion.time[0] for d in all_of], "3 (0.4)"
    )
    assert np.mean(lasts) == pytest.approx(3.0, abs=0.15)
    lean = table(name, "forward lean, deg", [d.pitch.max() - d.pitch[0] for d in all_of], "12 (4)")
    assert np.mean(lean) == pytest.approx(12.0, abs=1.5)
    pitching = table(
        name, "peak pitch rate, deg/s", [np.degrees(d.motion.rate_b[:, 1].max()) for d in all_of], "28 (8)"
    )
    assert np.mean(pitching) == pytest.approx(28.0, abs=8.0)
    rolling = table(
        name, "peak roll rate, deg/s", [np.degrees(np.abs(d.motion.rate_b[:, 0]).max()) for d in all_of], "20 (6)"
    )
    assert np.mean(rolling) == pytest.approx(20.0, abs=6.0)
    rises = [d.task.position(d.task.moving_s[1] * np.ones(1))[0, 2] for d in all_of]
    np.testing.assert_allclose(rises, 0.17, atol=1e-9)


@pytest.mark.slow
def test_each_foot_knocks_with_the_stated_acceleration_and_frequency() -> None:
    knocks, heard = [], []
    for d in drawn("step"):
        for part in d.task.up[1:]:
            time = part.start_s + np.arange(0.0, 1.0, 1e-3)  # type: ignore[attr-defined]
            ring = part.at(time)[2]
            knocks.append(float(np.abs(ring).max()))
            power = np.abs(np.fft.rfft(ring, 8192)) ** 2
            heard.append(float(np.fft.rfftfreq(8192, 1e-3)[np.argmax(power)]))
    assert table("step", "knock, m/s2", knocks, "1-2").min() + 1e-2 >= 1.0  # peaks read on a grid of 1 ms
    assert max(knocks) <= 2.0 + 1e-2
    loudest = table("step", "loudest frequency of a knock, Hz", heard, "5-15")
    assert loudest.min() > 4.9  # read on a grid of 0.12 Hz
    assert loudest.max() < 15.1


@pytest.mark.slow
def test_standing_on_foam_keeps_its_bounds() -> None:
    name: TaskName = "posturography"
    all_of = drawn(name)
    assert {d.task.moving_s[1] - d.task.moving_s[0] for d in all_of} == {50.0}
    rates = np.degrees([np.abs(d.motion.rate_b).max() for d in all_of])
    table(name, "largest rate about any axis, deg/s", list(rates), "5: Table 1; 3.5-5 assumed")
    assert rates.max() <= 5.0 + 0.01
    wanted = {  # mean of 60 people, assumed; tolerance half their sd, for the bound of 5 deg/s turns away the wildest
        "pitch rms, deg": ([d.pitch.std() for d in all_of], 0.9, 0.15),
        "pitch from end to end, deg": ([np.ptp(d.pitch) for d in all_of], 4.5, 0.75),
        "roll rms, deg": ([d.roll.std() for d in all_of], 0.6, 0.1),
        "roll from end to end, deg": ([np.ptp(d.roll) for d in all_of], 3.0, 0.5),
        "pitch rate rms, deg/s": ([np.degrees(d.motion.rate_b[:, 1].std()) for d in all_of], 1.2, 0.2),
        "roll rate rms, deg/s": ([np.degrees(d.motion.rate_b[:, 0].std()) for d in all_of], 0.9, 0.15),
        "mean frequency of pitch in 0.15-5 Hz, Hz": ([_mean_frequency(d.pitch) for d in all_of], 0.35, 0.1),
    }
    for label, (values, mean, tolerance) in wanted.items():
        assert np.mean(table(name, label, [float(v) for v in values], f"{mean} +- {tolerance}")) == pytest.approx(
            mean, abs=tolerance
        )
    low = table(name, "share of pitch power below 1.5 Hz", [share_below(d.pitch, 1.5) for d in all_of], "0.95")
    assert low.min() > 0.95
    wander = table(name, "share of pitch power below 0.1 Hz", [share_below(d.pitch, 0.1) for d in all_of], "there")
    assert np.median(wander) > 0.1


def _mean_frequency(x: np.ndarray) -> float:
    power, frequency = np.abs(np.fft.rfft(x - x.mean())) ** 2, np.fft.rfftfreq(len(x), 0.01)
    band = (frequency >= 0.15) & (frequency <= 5.0)
    return float((power * frequency)[band].sum() / power[band].sum())


@pytest.mark.parametrize("name", ["sit_to_stand", "step", "posturography"])
def test_the_same_seed_and_subject_perform_the_same_and_others_do_not(name: TaskName) -> None:
    one, other = cohort("testing", rng=np.random.default_rng(3))[:2]
    first = draw_task(name, rng=np.random.default_rng(4), subject=one)
    assert draw_task(name, rng=np.random.default_rng(4), subject=one) == first
    assert draw_task(name, rng=np.random.default_rng(5), subject=one) != first
    assert draw_task(name, rng=np.random.default_rng(4), subject=other) != first
    assert draw_task(name, rng=np.random.default_rng(4)) != first
