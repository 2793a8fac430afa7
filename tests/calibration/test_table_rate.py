"""Uneven rates of a table: ripple and settling are found within the dwells, and the mean rates follow."""

from dataclasses import replace

import numpy as np
import pytest

from undrift.calibration.dwells import Dwells, uneven_rate
from undrift.record import Record, Turn

NOISE = 1e-4  # rad/s, of a sample at 100 Hz: a hundredth of a deg/s in a block of 0.5 s would be 1.7e-4


def rippled(theta, terms, *, noise=0.0, seed=1, n=600):
    """Return dwells about x, y, z that turn both ways by theta and half of it (rad) in 6 s, and their mean rates over the stated.

    ``terms`` is r(psi, t), relative; psi runs on from dwell to dwell.
    """
    time, rng = np.arange(n) / 100.0, np.random.default_rng(seed)
    pieces, turns, ratio = [], [], []
    for k, axis in enumerate("xyz"):
        for stated in (theta / 6.0, -theta / 6.0, theta / 12.0, -theta / 12.0):
            r = terms((0.0 if stated > 0.0 else 6.0 * abs(stated)) + stated * time, time)
            gyro = noise * rng.standard_normal((n, 3))
            gyro[:, k] += stated * (1.0 + r)
            turns.append(Turn(start=len(pieces) * n, stop=(len(pieces) + 1) * n, axis=axis, turn_rate=stated))
            pieces.append(gyro)
            ratio.append(r.mean())
    record = Record(time=np.arange(n * 12) / 100.0, gyro=np.vstack(pieces))
    reading = np.array([piece.mean(axis=0) for piece in pieces])
    dwells = Dwells(
        records=(record,), turns=turns, mounting=np.repeat([0, 1, 2], 4), reading=reading, up=np.ones(12), settle_s=0.0
    )
    return dwells, np.array(ratio)


@pytest.mark.parametrize("harmonic", [1, 2])
def test_a_ripple_once_or_twice_a_turn_gives_the_mean_rate_of_every_dwell(harmonic):
    dwells, true = rippled(0.7 * 2.0 * np.pi, lambda psi, _: 0.004 * np.sin(0.7 + harmonic * psi), noise=NOISE)
    found = uneven_rate(dwells)
    assert np.abs(true).max() > 0.0005
    sigma = np.sqrt(np.diag(found.covariance))
    # 4 standard uncertainties, and the second order of 0.4 %: the angle that the gyroscope shows ripples too.
    assert np.all(np.abs(found.ratio - true) < 4.0 * sigma + 0.004**2)
    assert sigma.max() < 0.2 * np.abs(true).max()
    assert found.size[harmonic - 1] > 0.0
    assert found.size[2 - harmonic] == 0.0


@pytest.mark.parametrize("settle_s", [0.2, 0.45, 1.0])
def test_a_rate_that_settles_late_is_a_sum_of_time_constants_within_its_uncertainty(settle_s):
    dwells, true = rippled(4.0 * np.pi, lambda _, time: 0.003 * np.exp(-time / settle_s), noise=NOISE)
    found = uneven_rate(dwells)
    sigma = np.sqrt(np.diag(found.covariance))
    # Sums of half octaves miss a time constant near the longest by 1 % of the mean
    assert np.all(np.abs(found.ratio - true) < 4.0 * sigma + 0.01 * np.abs(true))
    assert np.all(sigma < 0.5 * np.abs(true))
    assert found.size[2] > 0.0


def test_an_even_rate_is_left_as_it_is():
    rng = range(20)
    shown = [uneven_rate(rippled(4.0, lambda psi, _: 0.0 * psi, noise=NOISE, seed=n)[0]) for n in rng]
    # Each of three groups appears by chance once in a thousand: two of twenty sessions once in 600.
    assert sum(bool(one.size.any()) for one in shown) <= 1
    assert sum(bool(one.ratio.any()) for one in shown) <= 1


def test_a_ripple_has_a_phase_of_its_own_in_each_dwell_where_a_gap_hides_the_angle():
    dwells, true = rippled(0.7 * 2.0 * np.pi, lambda psi, _: 0.004 * np.sin(0.7 + psi), noise=NOISE)
    record = dwells.records[0]
    n = len(record.time) // 12
    keep = np.ones(len(record.time), bool)
    gyro = np.array(record.gyro)
    turns = [replace(turn, start=turn.start + 5) for turn in dwells.turns]
    gyro[np.arange(12) * n] = np.nan  # before every dwell
    gap = replace(dwells, records=(Record(time=record.time[keep], gyro=gyro),), turns=turns)
    found, whole = uneven_rate(gap), uneven_rate(dwells)
    sigma = np.sqrt(np.diag(found.covariance))
    assert np.all(np.abs(found.ratio - true) < 4.0 * sigma + 0.01 * np.abs(true).max())
    assert sigma.mean() > np.sqrt(np.diag(whole.covariance)).mean()


def test_measured_mean_rates_hold_the_ripple_already():
    dwells, true = rippled(0.7 * 2.0 * np.pi, lambda psi, _: 0.004 * np.sin(0.7 + psi), noise=NOISE)
    turns = [replace(turn, turn_rate=turn.turn_rate * (1.0 + r)) for turn, r in zip(dwells.turns, true, strict=True)]
    found = uneven_rate(replace(dwells, turns=turns))
    np.testing.assert_array_equal(found.ratio, 0.0)
    np.testing.assert_array_equal(found.size, 0.0)


def test_a_rate_that_jumps_about_leaves_white_noise_in_every_mean():
    rng = np.random.default_rng(3)
    dwells, _ = rippled(4.0 * np.pi, lambda _, time: 0.003 * np.repeat(rng.standard_normal(12), 50), noise=NOISE)
    sigma = np.sqrt(np.diag(uneven_rate(dwells).covariance))
    # 0.003 of each of 12 blocks: 0.003 / sqrt(12) of the mean; all dwells of a sensor have one variance, that of 0.003 times
    # sqrt((1 + 1 / 4) / 2) of the larger rate, and 44 squares know it within a third
    assert sigma[::4] == pytest.approx(0.003 * (5.0 / 8.0) ** 0.5 / 12.0**0.5, rel=0.33)
