"""The smooth surface over rate and temperature."""

from dataclasses import replace

import numpy as np
import pytest

from undrift.drift.rates import SurfacePoints, fit_surface
from undrift.fit.curve import Cubics

TEMPS = np.arange(20.0, 71.0, 10.0)
RATES = np.concatenate((-np.linspace(0.2, 1.6, 8)[::-1], np.linspace(0.2, 1.6, 8)))


def shape(w, t):
    return 0.01 * w**3 * (t - 40.0) / 30.0 + 0.004 * w * (t - 40.0) / 30.0 + 0.002 * w**2


def points(noise=1e-4, temps=TEMPS, rates=RATES, offset=0.0, seed=0):
    w, t = np.tile(rates, len(temps)), np.repeat(temps, len(rates))
    soak = np.repeat(np.arange(len(temps)), len(rates))
    rng = np.random.default_rng(seed)
    return SurfacePoints(
        turn_rate=w,
        temp_c=t,
        value=shape(w, t) + offset * (1.0 + soak) + rng.normal(0.0, noise, len(w)),
        variance=np.full(len(w), max(noise, 1e-9) ** 2),
        soak=soak,
        mounting=soak,
    )


def fitted(given):
    return fit_surface(given, rate_span=(-1.6, 1.6), temp_span=(20.0, 70.0))


def left(given, surface=None):
    """Return what a surface leaves of its points, each mounting about its mean."""
    rest = given.value - (surface or fitted(given)).at(given.turn_rate, given.temp_c)
    return rest - (np.bincount(given.mounting, rest) / np.bincount(given.mounting))[given.mounting]


def test_the_splines_reproduce_a_cubic_and_its_roughness():
    basis = Cubics(low=-2.0, high=3.0, intervals=5)
    x = np.linspace(-2.0, 3.0, 40)
    c = np.linalg.lstsq(basis.at(x), x**3 - x, rcond=None)[0]
    assert np.allclose(basis.at(x) @ c, x**3 - x, atol=1e-12)
    # d2/dz2 of x^3 is 6 x 25 with z in spans of 5: the integral over z of its square, by hand.
    assert np.isclose(c @ basis.products(2) @ c, 150.0**2 * (27.0 + 8.0) / 3.0 / 5.0)


def test_a_smooth_surface_comes_back_without_noise():
    surface = fitted(points(noise=0.0))
    w, t = np.meshgrid(np.linspace(-1.6, 1.6, 33), np.linspace(20.0, 70.0, 21))
    # Even knots every 0.4 rad/s hold a cubic exactly; the smoothing that is left costs 1e-3 of the surface.
    assert np.abs(surface.at(w.ravel(), t.ravel()) - shape(w, t).ravel()).max() < 1e-3 * 0.04


@pytest.mark.parametrize(("variance", "of"), [(1e-30, 1.0), (0.0, 1.0), (0.0, 0.0)])
def test_values_without_any_noise_are_fitted(variance, of):
    given = points(noise=0.0)
    given = replace(given, value=of * given.value, variance=np.full(len(given), variance))
    assert np.abs(left(given)).max() <= 1e-3 * 0.04 * of


def test_rate_zero_has_no_error_and_no_uncertainty():
    surface = fitted(points(offset=0.01))
    assert np.abs(surface.at(np.zeros(5), np.linspace(20.0, 70.0, 5))).max() < 1e-12
    assert np.abs(surface.uncertainty(np.zeros(5), np.linspace(20.0, 70.0, 5))).max() < 1e-9


def test_mounting_offset_is_told_apart_from_the_rate():
    plain, shifted = fitted(points()), fitted(points(offset=0.01))
    w, t = np.tile(RATES, 6), np.repeat(TEMPS, 16)
    assert np.abs(plain.at(w, t) - shifted.at(w, t)).max() < 1e-6


def test_bend_over_temperature_is_found_only_if_present():
    straight = fitted(points(noise=1e-3))
    given = points(noise=1e-4)
    wave = replace(given, value=given.value + 0.01 * given.turn_rate * np.sin(given.temp_c / 8.0))
    bent = fitted(wave)
    assert straight.softness[1] < bent.softness[1]
    assert np.abs(left(wave, bent)).max() < 1e-3  # of a wave of 16e-3


def test_intervals_hold_the_surface_in_about_95_of_100_cases():
    inside = []
    for seed in range(8):
        surface = fitted(points(noise=1e-3, seed=seed))
        w, t = np.tile(RATES[::3], 6), np.repeat(TEMPS, 6)
        inside.append(np.abs(surface.at(w, t) - shape(w, t)) < 1.96 * surface.uncertainty(w, t))
    # Eight surfaces of some ten free parameters: standard error about 2.5 %.
    assert np.mean(inside) > 0.88


def test_scatter_beyond_the_stated_noise_counts():
    given = points(noise=1e-3)
    told, known = fitted(replace(given, variance=np.full(len(given), 1e-8))), fitted(given)
    at = np.array([1.0]), np.array([45.0])
    assert told.uncertainty(*at) == pytest.approx(known.uncertainty(*at), rel=0.3)
