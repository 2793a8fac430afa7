"""Streams: fresh per call, the same per seed, independent per effect."""

import numpy as np

from undrift.sim.device.simulate import draw_streams


def test_the_same_seed_gives_the_same_stream_and_the_next_call_another() -> None:
    first, again = draw_streams(np.random.default_rng(1)), draw_streams(np.random.default_rng(1))
    assert (first.of("white").normal(size=5) == again.of("white").normal(size=5)).all()
    rng = np.random.default_rng(1)
    assert draw_streams(rng).root != draw_streams(rng).root


def test_streams_of_two_effects_are_uncorrelated() -> None:
    streams = draw_streams(np.random.default_rng(2))
    a, b = streams.of("gyro_white").standard_normal(100_000), streams.of("accel_white").standard_normal(100_000)
    assert abs(np.corrcoef(a, b)[0, 1]) < 4.5 / np.sqrt(100_000)  # 4.5 standard errors of a correlation of zero
