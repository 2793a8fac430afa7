"""Allan deviations against their definitions, their confidence against simulation."""

import numpy as np
import pytest

from undrift.calibration.noise import Estimator, allan_deviation
from undrift.errors import InputError


def test_overlapping_deviation_is_its_definition_sum_by_sum() -> None:
    y = np.random.default_rng(0).normal(size=200) + 5.0
    for m in (1, 3, 20):
        means = np.convolve(y, np.ones(m) / m, mode="valid")
        expected = np.sqrt(0.5 * np.mean((means[m:] - means[:-m]) ** 2))
        got = allan_deviation(y, 10.0, taus=[m / 10.0])
        assert got.deviation[0] == pytest.approx(expected, rel=1e-10)
        assert got.taus_s[0] == pytest.approx(m / 10.0)


def test_non_overlapping_deviation_is_the_textbook_mean_of_squared_steps() -> None:
    y = np.random.default_rng(1).normal(size=120)
    means = y.reshape(-1, 6).mean(axis=1)
    got = allan_deviation(y, 1.0, taus=[6.0], estimator="adev").deviation[0]
    assert got == pytest.approx(np.sqrt(0.5 * np.mean(np.diff(means) ** 2)), rel=1e-10)


@pytest.mark.parametrize("estimator", ["adev", "oadev", "mdev", "hdev", "ohdev", "totdev"])
@pytest.mark.parametrize(("kind", "power"), [("white", 0), ("walk", -2)])
def test_degrees_of_freedom_are_those_of_repeated_records(estimator: str, kind: str, power: int) -> None:
    rng = np.random.default_rng(2)
    draws = rng.normal(size=(250, 512))
    records = draws if kind == "white" else np.cumsum(draws, axis=1)
    fits = [allan_deviation(r, 1.0, taus=[8.0, 32.0], estimator=estimator) for r in records]  # type: ignore[arg-type]
    square = np.array([f.deviation**2 for f in fits])
    counted = 2.0 * square.mean(axis=0) ** 2 / square.var(axis=0)
    stated = np.median([f.edf for f in fits], axis=0)
    # 250 records: a variance is known to 9 %, that of a skewed chi-square to 20 %; kinds taken wrong at tau 32 add some
    np.testing.assert_allclose(stated / counted, 1.0, atol=0.45)
    assert np.median([f.noise[0] for f in fits]) == power


def test_limits_enclose_the_truth_as_often_as_they_say() -> None:
    rng = np.random.default_rng(3)
    inside = []
    for _ in range(300):
        fit = allan_deviation(rng.normal(size=1024), 1.0, taus=[1.0, 16.0, 128.0], confidence=0.9)
        truth = 1.0 / np.sqrt(fit.taus_s)
        inside.append((fit.lower < truth) & (truth < fit.upper))
    covered = np.mean(inside, axis=0)
    print(f"  90 % limits at 1, 16, 128 s cover {np.round(100 * covered, 1)} %")
    np.testing.assert_allclose(covered, 0.9, atol=0.06)  # 300 records: 1.7 % one sigma, and kinds taken wrong


def test_grids_of_averaging_times() -> None:
    y = np.random.default_rng(4).normal(size=100)
    assert list(allan_deviation(y, 1.0).taus_s) == [1, 2, 4, 8, 16]
    assert list(allan_deviation(y, 1.0, taus="decade").taus_s) == [1, 2, 4, 10, 20]
    assert len(allan_deviation(y, 1.0, taus="all").taus_s) == 25


def test_what_cannot_be_averaged_is_refused() -> None:
    y = np.ones(100)
    with pytest.raises(InputError, match=r"got 1 gaps.* 'mdev'; cut the record at its gaps, or use oadev"):
        allan_deviation(np.append(y, np.nan), 1.0, estimator="mdev")
    every_third = np.where(np.arange(100) % 2 == 0, y, np.nan)
    with pytest.raises(
        InputError, match="wanted averaging times of which whole windows are left, got none between 50 gaps"
    ):
        allan_deviation(every_third, 1.0)
    with pytest.raises(InputError, match="'sigma'"):
        allan_deviation(y, 1.0, estimator="sigma")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="wanted averaging times from 1 s to under 50 s, got 60 to 60 s"):
        allan_deviation(y, 1.0, taus=[60.0])
    with pytest.raises(InputError, match="wanted octave, decade, all"):
        allan_deviation(y, 1.0, taus="octaves")  # type: ignore[arg-type]


@pytest.mark.parametrize("estimator", ["adev", "oadev", "hdev", "ohdev"])
def test_terms_that_are_whole_are_those_of_the_pieces(estimator: Estimator) -> None:
    rng = np.random.default_rng(11)
    one, two = rng.normal(size=(2, 2000))
    parts = [
        allan_deviation(part - np.mean((one, two)), 1.0, taus=[1, 4, 16], estimator=estimator) for part in (one, two)
    ]
    # Pieces of 2000 with a gap that keeps whole averages in step: the means of the squares are those of both pieces.
    joined = allan_deviation(np.concatenate((one, np.full(16, np.nan), two)), 1.0, taus=[1, 4, 16], estimator=estimator)
    both = np.sqrt(np.mean([part.deviation**2 for part in parts], axis=0))
    np.testing.assert_allclose(joined.deviation, both, rtol=1e-9)
    assert (joined.lower < both).all()
    assert (joined.upper > both).all()
    assert (joined.edf > parts[0].edf).all()  # twice the terms
    assert list(joined.noise) == [0, 0, 0]


def test_limits_with_gaps_cover_the_true_deviation() -> None:
    covered, true = [], 1.0 / np.sqrt([1.0, 8.0, 64.0])
    for seed in range(200):
        rng = np.random.default_rng(seed)
        y = rng.normal(size=4000)
        for start in rng.integers(0, 3990, 12):
            y[start : start + 10] = np.nan
        found = allan_deviation(y, 1.0, taus=[1, 8, 64], confidence=0.9)
        covered.append((found.lower < true) & (true < found.upper))
    share = np.mean(covered, axis=0)
    print(f"  with gaps 90 % limits at 1, 8, 64 s cover {np.round(100 * share, 1)} %")
    np.testing.assert_allclose(share, 0.9, atol=0.07)  # 200 records: 2.1 % one sigma, and kinds taken wrong
