"""Clocks: the host's runs at its speed; a virtual one carries out what is due, in order, and is then later."""

import threading
import time

import pytest

from undrift.base.clock import HOST, Clock, VirtualClock
from undrift.errors import InputError


@pytest.mark.parametrize("speed", [0.0, -1.0, 1e6, float("nan")])
def test_a_clock_that_stands_still_is_refused(speed):
    with pytest.raises(InputError, match="clock: wanted a speed above 0, got"):
        Clock(speed)


def test_a_fast_clock_runs_ahead_and_waits_less():
    clock = Clock.started(100.0)
    assert 0.0 <= clock.now() < 500.0
    start = clock.now()
    clock.wait(1.0)
    clock.wait(-1.0)
    assert 1.0 <= clock.now() - start < 500.0
    assert clock.host is HOST
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


def test_what_is_due_while_someone_waits_is_done_in_order_at_its_time():
    clock, said = VirtualClock(), []

    def every(pause_s, name):
        return lambda: said.append((name, clock.now())) or pause_s

    fast = clock.repeat(every(0.5, "fast"), "fast")
    clock.repeat(every(None, "once"), "once")
    clock.repeat(every(0.75, "slow"), "slow")
    clock.wait(1.0)
    assert said == [("fast", 0.0), ("once", 0.0), ("slow", 0.0), ("fast", 0.5), ("slow", 0.75), ("fast", 1.0)]
    fast.end()
    clock.wait(1.0)
    assert said[6:] == [("slow", 1.5)]
    assert clock.now() == 2.0


def test_a_step_that_waits_makes_it_later_and_is_not_taken_within_itself():
    clock, said = VirtualClock(), []

    def step():
        said.append(clock.now())
        clock.wait(2.0)
        return 1.0

    clock.repeat(step, "slow")
    clock.wait(1.0)
    assert said == [0.0]
    assert clock.now() == 2.0


def test_a_condition_is_told_by_what_is_due_or_its_time_passes():
    clock = VirtualClock()
    news = clock.condition()

    def tell():
        if clock.now() < 1.0:
            return 0.25
        with news:
            news.notify_all()
        return None

    clock.repeat(tell, "teller")
    with news:
        assert news.wait(5.0)
        assert clock.now() == 1.0
        assert not news.wait(5.0)
        assert clock.now() == 6.0


def test_nobody_listens_but_who_says_so():
    clock = VirtualClock()
    assert clock.host is clock
    port = clock.listen("127.0.0.1", 0, lambda: "a way")
    assert clock.listen("127.0.0.1", 0, lambda: "another") != port
    assert clock.connection("127.0.0.1", port) == "a way"
    clock.forget("127.0.0.1", port)
    clock.forget("127.0.0.1", port)
    with pytest.raises(ConnectionRefusedError, match="nothing on this clock listens there"):
        clock.connection("127.0.0.1", port)
