"""Clocks: the host's runs at its speed; on a paced one, time passes in waits; a virtual one of tests also does what is due."""

import threading
import time

import pytest

from testkit.virtual_clock import VirtualClock
from undrift.base.clock import HOST, Clock, PacedClock
from undrift.errors import InputError


@pytest.mark.parametrize("speed", [0.0, -1.0, 1e6, float("nan")])
def test_a_clock_that_stands_still_is_refused(speed):
    with pytest.raises(InputError, match="clock: expected a speed above 0, got"):
        Clock(speed)


def test_a_fast_clock_runs_ahead_and_waits_less():
    clock = Clock.started(100.0)
    assert 0.0 <= clock.now() < 500.0
    start = clock.now()
    clock.wait(1.0)
    clock.wait(-1.0)
    assert 1.0 <= clock.now() - start < 500.0
    assert Clock().connection("127.0.0.1", 9) is None


def test_asking_ends_with_the_first_answer_that_is_true_or_with_its_time():
    answers = iter([None, 0, "yes"])
    clock = VirtualClock()
    assert clock.until(lambda: next(answers), 1.0, every_s=0.25) == "yes"
    assert clock.now() == 0.5
    assert clock.until(lambda: False, 1.0) is None
    assert 1.5 <= clock.now() <= 1.52


def test_a_step_is_repeated_by_a_thread_until_it_is_ended_or_says_so():
    taken, enough = [], threading.Event()

    def step():
        taken.append(time.monotonic())
        if len(taken) == 3:
            enough.set()
        return 0.01

    repeat = HOST.repeat(step, "steps")
    assert enough.wait(20.0)
    repeat.end()
    count = len(taken)
    repeat.end()
    time.sleep(0.05)
    assert len(taken) == count
    over = threading.Event()
    HOST.repeat(over.set, "once")
    assert over.wait(20.0)
    assert not any(thread.name == "steps" for thread in threading.enumerate())


def test_on_a_paced_clock_only_waits_take_time():
    clock = PacedClock()
    clock.wait(3600.0)
    clock.wait(-1.0)
    assert clock.now() == 3600.0
    paced = PacedClock(100.0)
    start = time.monotonic()
    paced.wait(2.0)
    assert time.monotonic() - start >= 0.02
