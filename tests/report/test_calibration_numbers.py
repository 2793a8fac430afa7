"""Numbers with their uncertainty, and the tables of a calibration."""

import numpy as np
import pytest

from undrift.base.summary import concise


@pytest.mark.parametrize(
    ("value", "uncertainty", "text"),
    [
        (0.99643, 0.00011, "0.99643(11)"),
        (1.0, 0.0123, "1.000(12)"),
        (100.02147, 0.00035, "100.02147(35)"),  # GUM, 7.2.2: 100.021 47(35) g
        (-489.82, 0.14, "-489.82(14)"),
        (0.5371, 0.00996, "0.5371(100)"),
        (33123.8, 0.24, "33123.80(24)"),
        (1234.5, 12.0, "1234(12)"),
        (1234.5, 120.0, "1234(120)"),
        (0.0, 0.001, "0.0000(10)"),
        (1.0, 0.0, "1"),
        (0.25, float("nan"), "0.25"),
        (0.25, float("inf"), "0.25"),
        (2.0, 1e-12, "2(1e-12)"),
    ],
)
def test_the_uncertainty_stands_in_brackets_in_units_of_the_last_digits(value, uncertainty, text):
    assert concise(value, uncertainty) == text


def read_back(text):
    value, _, rest = text.partition("(")
    places = len(value.partition(".")[2])
    return float(value), float(rest.rstrip(")")) * 10.0**-places


def test_what_is_printed_reads_back_to_half_a_digit():
    rng = np.random.default_rng(1)
    for value, size in zip(rng.normal(0.0, 10.0, 500), 10.0 ** rng.uniform(-7.0, 1.9, 500), strict=True):
        shown, sigma = read_back(concise(value, size))
        assert abs(sigma / size - 1.0) <= 0.051  # two digits, the second rounded
        assert abs(shown - value) <= 0.051 * size + 0.5 * (size >= 10.0)
