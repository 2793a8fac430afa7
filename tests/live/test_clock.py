"""Clocks and counters: the promptest packets carry the time, wraps and losses are told apart."""

from dataclasses import replace

import numpy as np
import pytest

from undrift.live.clock import DeviceClock, GapMarker
from undrift.live.decoder import Arrivals, Counter


def packets(count=20_000, period=0.01, rate_error=50e-6, latency=0.003, seed=1):
    """Device times, and host times with a delay that is exponential, now and then a whole tenth of a second."""
    rng = np.random.default_rng(seed)
    device = np.arange(count) * period
    delay = latency + rng.exponential(0.004, count) + 0.1 * (rng.random(count) < 0.02)
    return device, np.maximum.accumulate(1000.0 + device / (1.0 + rate_error) + delay)


def add(clock, device, host):
    for device_time, host_time in zip(device, host, strict=True):
        clock.add(device_time, host_time)


def test_offset_and_rate_come_from_the_promptest_packets():
    device, host = packets()
    clock = DeviceClock()
    add(clock, device, host)
    fit = clock.fit()
    assert 1.0 / fit.rate - 1.0 == pytest.approx(50e-6, abs=1e-6)  # 0.1 ms at the ends of the 200 s that it rests on
    assert fit.host_time(100.0) == pytest.approx(1000.0 + 100.0 / (1 + 50e-6) + 0.003, abs=2e-4)
    assert fit.device_time(fit.host_time(123.4)) == pytest.approx(123.4, abs=1e-9)
    assert replace(fit, device_zero=2.0, host_zero=10.0, rate=1.5).host_time(4.0) == 13.0
    assert 0.008 < fit.jitter_s < 0.1


def test_a_clock_that_drifts_is_followed_since_the_old_is_forgotten():
    first = np.arange(0.0, 1000.0, 0.1)
    second = np.arange(1000.0, 2000.0, 0.1)
    clock = DeviceClock(memory_s=100.0)
    add(clock, first, first)
    add(clock, second, 1000.0 + (second - 1000.0) * 1.001)
    assert clock.fit().host_time(2000.0) == pytest.approx(2001.0, abs=1e-6)


def test_a_backlog_that_drains_does_not_settle_the_clock_and_is_no_jitter():
    clock = DeviceClock()
    backlog = np.linspace(0.1, 10.0, 100)  # 10 s of readings, delivered within 2 s
    for device in backlog:
        clock.add(device, 10.0 + 0.2 * device)
        assert not clock.fit().settled
    settled = []
    for device in np.arange(12.0, 13.0, 0.03):  # prompt from now on, up to 10 ms late
        late = 0.01 * (device * 1000.0 % 7.0) / 7.0
        clock.add(device, device + late)
        settled.append(clock.fit().settled)
    assert settled.index(True) == 8  # 8 packets and 0.2 s after the first prompt one
    assert all(settled[8:])
    assert clock.fit().jitter_s < 0.01


def test_few_packets_or_a_short_while_do_not_settle_a_clock():
    few, brief = DeviceClock(), DeviceClock()
    add(few, np.arange(8) * 0.5, 5.0 + np.arange(8) * 0.5)
    add(brief, np.arange(100) * 0.001, 5.0 + np.arange(100) * 0.001)
    assert not few.fit().settled
    assert not brief.fit().settled


def test_counter_continues_where_it_wraps():
    true = np.arange(1000)
    counter = Counter(bits=8, tick_s=0.01)
    counts = [counter.unwrap((part % 256).astype(float), part[-1] * 0.01) for part in np.array_split(true, 37)]
    assert np.array_equal(np.concatenate(counts), true)


def test_wraps_in_a_silence_are_counted_by_the_hosts_clock():
    counter = Counter(bits=8, tick_s=0.01)
    counter.unwrap(np.array([10.0]), 0.0)
    assert counter.unwrap(np.array([(10 + 1000) % 256.0]), 10.03).tolist() == [1000.0]


def test_late_and_repeated_readings_are_left_out():
    count = Counter(bits=16, tick_s=0.01).unwrap(np.array([0, 1, 2, 2, 4, 3, 5.0]), 0.05)
    assert count[np.isfinite(count)].tolist() == [0, 1, 2, 4, 5]


@pytest.mark.parametrize("bits", [0, 32])
def test_restarted_device_continues_by_the_hosts_clock(bits):
    counter = Counter(bits=bits, tick_s=0.01)
    counter.unwrap(np.arange(90_000, 90_010.0), 0.09)
    assert [*counter.unwrap(np.array([0.0]), 3.09), *counter.unwrap(np.array([1.0]), 3.10)] == [309.0, 310.0]


def test_readings_without_a_counter_are_counted():
    arrivals = Arrivals(rate=100.0)
    assert arrivals.count(10, 0.1).tolist() == list(range(10))
    assert arrivals.count(95, 1.1)[0] == 10  # a second late, all of them there
    assert arrivals.count(5, 2.1).tolist() == [200, 201, 202, 203, 204]  # a second of silence, then five


def test_missing_readings_become_rows_of_nan():
    marker = GapMarker(0.1)
    time, values = marker.mark(np.array([0.0, 0.1, 0.4, 0.5]), np.arange(4.0)[:, None])
    assert time == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4, 0.5])
    assert np.isnan(values[2:4]).all()
    assert values[[0, 1, 4, 5], 0].tolist() == [0, 1, 2, 3]
    assert marker.missing == 2


def test_a_long_gap_is_marked_by_one_row():
    marker = GapMarker(0.01, longest_fill_s=1.0)
    time, values = marker.mark(np.array([0.0, 3600.0]), np.ones((2, 1)))
    assert time == pytest.approx([0.0, 0.01, 3600.0])
    assert np.isnan(values[:, 0]).tolist() == [False, True, False]
    assert marker.missing == 359_999
