"""Hysteresis: the position in a loop, followed and estimated, on loops of the model's shape and of others."""

from dataclasses import astuple, replace
from itertools import pairwise

import numpy as np
import pytest

from drift.test_static import NODES, blocks
from undrift.drift.hysteresis import LoopState, follow_loop, positions, state_of, uncertain_share
from undrift.drift.static import StaticSettings, fit_static
from undrift.errors import InputError
from undrift.model import Hysteresis


def course(*turns, step=0.25):
    parts = [np.linspace(a, b, int(abs(b - a) / step) + 1)[:-1] for a, b in pairwise(turns)]
    return np.concatenate((*parts, [turns[-1]]))


def friction(temp_c, length):
    """A loop that is approached exponentially (Dahl): neither straight nor ever closed."""
    position, found = 0.0, np.empty(len(temp_c))
    for k, change in enumerate(np.diff(temp_c, prepend=temp_c[0])):
        side = -np.sign(change) if change else np.sign(position)
        position = side + (position - side) * np.exp(-abs(change) / length)
        found[k] = position
    return found


def relays(temp_c, spread):
    """The mean of many plays of different width (Prandtl, Ishlinskii): crossed fast at first, then ever more slowly."""
    widths, found = spread * np.linspace(0.3, 2.0, 12), np.zeros(len(temp_c))
    for width in widths:
        at = temp_c[0]
        for k, temp in enumerate(temp_c):
            at = min(max(at, temp - width), temp + width)
            found[k] += (at - temp) / width / len(widths)
    return found


SHAPES = [(friction, 0.8), (friction, 2.5), (relays, 1.0), (relays, 2.5)]
HALF = np.array([0.05, -0.03, 0.02])


def offsets(temp_c, position, noise, rng, growth=0.0):
    half = HALF * (1.0 + growth * (temp_c[:, None] - 40.0) / 20.0)
    middle = np.outer(temp_c - 25.0, [0.01, -0.02, 0.005]) + np.outer((temp_c - 25.0) ** 2, [1e-4, 2e-4, -1e-4])
    return middle + half * position[:, None] + noise * rng.normal(size=(len(temp_c), 3))


def swept(shape, size, growth=0.0):
    rng, temp = np.random.default_rng(3), course(25.0, 20.0, 60.0, 20.0, step=1.0)
    made = blocks(temp, offsets(temp, shape(temp, size), 2e-3, rng, growth), noise=2e-3)
    return fit_static(made.taken(slice(5, None)), nodes=NODES)  # the first 5 K bring the device to the cold end


def left(fit, shape, size, growth=0.0):
    """Return rms errors of the middle of the loop and of the model, on a course with turns inside the loop."""
    temp = course(25.0, 50.0, 35.0, 57.0, 41.0, 43.0, 30.0)
    true = offsets(temp, shape(temp, size), 0.0, np.random.default_rng(0), growth)
    loop = fit.table.hysteresis
    position, _ = follow_loop(temp, 60.0 * np.arange(len(temp)), state=state_of(None, loop.crossing_k))
    middle, half = (
        np.column_stack([np.interp(temp, at, column) for column in values.T])
        for at, values in ((NODES, fit.table.gyro_offset), (loop.temp_c, loop.gyro_half_width))
    )
    return (np.sqrt(((true - middle - part) ** 2).mean()) for part in (0.0, half * position[:, None]))


@pytest.mark.parametrize(("shape", "size"), SHAPES, ids=[f"{shape.__name__} {size}" for shape, size in SHAPES])
def test_loops_of_other_shapes_are_corrected_to_less_than_half(shape, size):
    fit = swept(shape, size)
    middle, modelled = left(fit, shape, size)
    assert modelled < 0.5 * middle
    codes = {found.code for found in fit.verdict.findings}
    assert "drift.hysteresis_corrected" in codes
    assert not codes & {"drift.hysteresis", "drift.no_hysteresis"}
    choice = fit.gyro.curve.choice
    assert np.log(choice.left_out / choice.left_out_middle).mean() < np.log(0.98)


def test_a_half_width_that_grows_with_temperature_is_found_with_its_uncertainty():
    fit = swept(relays, 1.0, growth=0.6)
    loop = fit.table.hysteresis
    true = HALF * (1.0 + 0.6 * (loop.temp_c[:, None] - 40.0) / 20.0)
    # the far end of a loop of many widths is reached late: a tenth of the half-width beside what noise makes
    assert (np.abs(loop.gyro_half_width - true) < 3.0 * loop.gyro_uncertainty + 0.1 * np.abs(true)).all()
    assert (loop.gyro_uncertainty > 0.0).all()
    assert loop.crossing_uncertainty_k > 0.0
    middle, modelled = left(fit, relays, 1.0, growth=0.6)
    assert modelled < 0.5 * middle


@pytest.mark.parametrize("begin", [-1.0, 0.0, 1.0])
def test_where_the_loop_began_is_not_known_and_pulls_neither_table_nor_half_width(begin):
    rng, temp, crossing = np.random.default_rng(7), course(20.0, 60.0, 20.0, step=0.5), 10.0
    position, at = np.empty(len(temp)), begin
    for k, change in enumerate(np.diff(temp, prepend=temp[0])):
        at = min(max(at - 2.0 * change / crossing, -1.0), 1.0)
        position[k] = at
    fit = fit_static(blocks(temp, offsets(temp, position, 2e-3, rng), noise=2e-3), nodes=NODES)
    loop = fit.table.hysteresis
    error = np.abs(fit.table.gyro_offset - offsets(NODES, np.zeros(len(NODES)), 0.0, rng))
    stated = np.sqrt(fit.table.gyro_uncertainty**2 - fit.table.gyro_hysteresis**2)
    assert (error < 3.0 * stated).all()
    assert error.max() < 0.2 * np.abs(HALF).max()  # the middle of what is not known alone: 0.5 of it
    assert (np.abs(loop.gyro_half_width - HALF) < 3.0 * loop.gyro_uncertainty).all()
    assert abs(loop.crossing_k - crossing) < 3.0 * loop.crossing_uncertainty_k
    assert loop.crossing_uncertainty_k < 2.0


def test_a_doubt_about_the_thermometers_lag_is_in_the_half_widths():
    rng, temp = np.random.default_rng(3), course(20.0, 60.0, 20.0, step=1.0)
    slope = np.array([0.01, -0.02, 0.005])
    read = np.outer(temp, slope) + HALF * friction(temp, 0.8)[:, None] + 2e-3 * rng.normal(size=(len(temp), 3))
    made = replace(blocks(temp, read, noise=2e-3), ramp_c_per_min=np.where(np.arange(len(temp)) < 40, 1.0, -1.0))
    made = made.taken((np.arange(len(temp)) > 5) & (np.abs(np.arange(len(temp)) - 42.5) > 5))  # both loops are closed
    own = {}
    for doubt_s in (0.0, 60.0):
        fit = fit_static(made, nodes=NODES, settings=StaticSettings(lag_doubt_s=doubt_s))
        own[doubt_s] = fit.gyro.curve.loop.uncertainty
    # 60 s at 1 K/min are 1 K of a constant slope; what is left of the crossing tells a part of it from a half-width
    assert (own[60.0] > np.hypot(own[0.0], np.abs(slope) / 3.0)).all()
    assert (own[60.0] < 1.1 * np.hypot(own[0.0], slope)).all()


def test_a_device_without_hysteresis_gets_no_model():
    rng, temp = np.random.default_rng(5), course(20.0, 60.0, 20.0, step=1.0)
    fit = fit_static(blocks(temp, offsets(temp, np.zeros(len(temp)), 2e-3, rng), noise=2e-3), nodes=NODES)
    assert fit.table.hysteresis is None
    assert fit.gyro.curve.choice is None
    assert "drift.no_hysteresis" in {found.code for found in fit.verdict.findings}


def test_the_position_is_known_once_the_temperature_has_moved_by_the_crossing():
    for turns, wanted, unknown in (
        ((25.0,), 0.0, 1.0),
        ((25.0, 27.0), -0.5, 0.5),
        ((25.0, 29.0), -1.0, 0.0),
        ((25.0, 29.0, 28.0), -0.5, 0.0),
        ((25.0, 29.0, 28.0, 28.5), -0.75, 0.0),  # a minor loop is as steep
        ((25.0, 60.0, 20.0), 1.0, 0.0),
    ):
        state = state_of(turns, 4.0)
        assert 0.5 * (state.low + state.high) == pytest.approx(wanted)
        assert state.unknown == pytest.approx(unknown)
    half_way = state_of((25.0, 27.0), 4.0)  # at -0.5 between -1 and 0, and a crossing that is known to 1 K of 4
    np.testing.assert_allclose(uncertain_share(half_way, 1.0), [-0.5, np.hypot(0.5, 0.75 * 0.25)])
    np.testing.assert_allclose(uncertain_share(state_of("cooling", 4.0), 1.0), [1.0, 0.0])
    assert state_of("warming", 4.0).low == state_of("warming", 4.0).high == -1.0
    assert state_of("cooling", 4.0).low == state_of("cooling", 4.0).high == 1.0
    for history, told in (("up", "got 'up'"), ((), "oldest first"), ((20.0, np.nan), "oldest first")):
        with pytest.raises(InputError, match=f"temperature history: wanted.*{told}"):
            state_of(history, 4.0)


def test_chunks_carry_the_position_to_the_bit():
    rng = np.random.default_rng(1)
    temp, time = course(25.0, 31.0, 28.0, step=0.001) + rng.normal(size=9001) * 0.1, np.arange(9001) * 0.1
    temp[40:60] = np.nan
    whole, end = follow_loop(temp, time, state=state_of(None, 4.0))
    state, parts = state_of(None, 4.0), []
    for rows in np.split(np.arange(9001), [1, 5, 9, 50, 51, 700, 6000]):
        position, state = follow_loop(temp[rows], time[rows], state=state)
        parts.append(position)
    assert np.concatenate(parts).tobytes() == whole.tobytes()
    assert astuple(state) == astuple(end)
    assert np.isfinite(whole).all()


def test_the_position_follows_a_noisy_course_as_it_follows_the_true_one():
    rng, smooth = np.random.default_rng(2), course(25.0, 40.0, 36.0, step=0.002)
    time = 0.5 * np.arange(len(smooth))
    clean, _ = follow_loop(smooth, time, state=state_of(None, 4.0))
    noisy, _ = follow_loop(
        np.round((smooth + 0.3 * rng.normal(size=len(smooth))) * 2.0) / 2.0, time, state=state_of(None, 4.0)
    )
    # means over 30 s of two readings a second: 0.3 K and steps of 0.5 K leave 0.05 K, five times that at most; 2 K for 1
    assert np.abs(noisy - clean).max() < 0.25 / 2.0
    whole = positions(smooth[::20], np.array([4.0])).mean(axis=0)[0]
    np.testing.assert_allclose(clean[::20][200:], whole[200:], atol=0.12)  # 30 s later at 0.24 K/min


def test_a_stated_history_reaches_a_short_recording_at_one_temperature():
    temp, time = np.full(500, 37.5), 0.01 * np.arange(500)
    known, state = follow_loop(temp, time, state=state_of((25.0,), 4.0))
    np.testing.assert_array_equal(known, -1.0)
    assert state.unknown == 0.0
    nothing, state = follow_loop(temp, time, state=state_of(None, 4.0))
    np.testing.assert_array_equal(nothing, 0.0)
    assert state == replace(state, low=-1.0, high=1.0)
    assert isinstance(state, LoopState)


def test_a_loop_of_no_width_is_refused():
    with pytest.raises(InputError, match="hysteresis: wanted crossing_k above 0 K, got 0"):
        Hysteresis(
            crossing_k=0.0,
            crossing_uncertainty_k=1.0,
            temp_c=[20.0, 60.0],
            gyro_half_width=np.ones((2, 3)),
            gyro_uncertainty=np.ones((2, 3)),
        )
