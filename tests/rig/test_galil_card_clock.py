"""The card's clock: which tick it counts is found out, and positions are timed by it whatever the link does."""

import math

import numpy as np
import pytest

from undrift.rig.link import CardClock


def answers(tick_s, count, rng, *, step_s=0.1, late_s=0.02, speed=1.0, start_s=1000.0):
    """Yield ticks, the host's clock before and after, and when it was: the answer is true somewhere between the two."""
    asked = start_s
    for _ in range(count):
        wait, back = rng.exponential(late_s, 2)
        true = asked + wait
        yield math.floor((true - 17.3) / tick_s), speed * asked, speed * (true + back), true
        asked = true + back + step_s


@pytest.mark.parametrize("tick_s", [1e-3, 1e-3 * 1000.0 / 1024.0])
@pytest.mark.parametrize("seed", range(5))
def test_either_millisecond_is_told_from_the_other_and_times_are_then_true_to_half_a_tick(tick_s, seed):
    clock = CardClock(1000.0)
    off = []
    for ticks, asked, answered, true in answers(tick_s, 300, np.random.default_rng(seed)):
        time, within_s = clock.when(ticks, asked, answered)
        if clock.tick_s is None:
            assert abs(time - true) <= within_s
        else:
            off.append(time - true)
            assert within_s == 0.5 * clock.tick_s
    assert clock.tick_s == pytest.approx(tick_s, rel=1e-9)
    assert len(off) > 150
    assert np.ptp(off) <= tick_s * (1.0 + 1e-9)  # one offset for all, and a tick of rounding


def test_samples_of_another_length_are_a_candidate_too():
    clock = CardClock(250.0)
    for ticks, asked, answered, _ in answers(250e-6 * 1000.0 / 1024.0, 200, np.random.default_rng(3)):
        clock.when(ticks, asked, answered)
    assert clock.tick_s == pytest.approx(250e-6 * 1000.0 / 1024.0, rel=1e-9)


def test_crystals_that_differ_by_100_ppm_stay_believed_for_hours():
    clock = CardClock(1000.0)
    for ticks, asked, answered, _ in answers(1e-3 * (1.0 + 1e-4), 2000, np.random.default_rng(4), step_s=5.0):
        clock.when(ticks, asked, answered)
    assert clock.tick_s == 1e-3


def test_a_clock_that_fits_no_candidate_leaves_the_middle_between_question_and_answer():
    clock = CardClock(1000.0)
    for ticks, asked, answered, _ in answers(1e-3, 300, np.random.default_rng(5), speed=0.9):
        found = clock.when(ticks, asked, answered)
    assert clock.tick_s is None
    assert found == (0.5 * (asked + answered), 0.5 * (answered - asked))


def test_a_card_that_was_restarted_is_learnt_anew():
    clock = CardClock(1000.0)
    for ticks, asked, answered, _ in answers(1e-3, 300, np.random.default_rng(6)):
        clock.when(ticks, asked, answered)
    assert clock.tick_s is not None
    assert clock.when(5, 5000.0, 5000.5) == (5000.25, 0.25)
    assert clock.tick_s is None
