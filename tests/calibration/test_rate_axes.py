"""Turns about one or two axes: what they show is said, and what they contradict is refused."""

from dataclasses import replace

import numpy as np
import pytest

from undrift.calibration.rate_table import DwellMeans, RateTableSettings, fit_rate_axes, scale_verdict, told_axis
from undrift.errors import Implausible

DPS = np.pi / 180.0
RATES = np.array([-300.0, -100.0, 100.0, 300.0])


def turned(gain=1.0, axis="y", unit="dps", column=None):
    """Four dwells about one axis, read by one column."""
    reading = np.zeros((4, 3))
    reading[:, "xyz".index(column or axis)] = gain * RATES
    return DwellMeans(
        reading=reading + 0.3, turn_rate=RATES * DPS, axis=(axis,) * 4, unit=unit, time=np.arange(4.0), noise=None
    )


def test_scale_line_and_asymmetry_are_told():
    (fit,) = fit_rate_axes(turned(1.02))
    said = told_axis(fit)
    assert said.startswith("turns about y: scale factor 1.0200 of the unit's own")
    assert "departure from a straight line up to" in said
    assert "asymmetry" in said
    bent = turned()
    bent = replace(bent, reading=np.where(bent.reading > 1.0, 1.1 * bent.reading, bent.reading))
    assert "asymmetry 9.5 %" in told_axis(fit_rate_axes(bent)[0])  # 2 (1.1 - 1) / (1.1 + 1)
    counts = told_axis(fit_rate_axes(turned(16.4, unit="count"))[0])
    assert "scale factor 16.4 count per deg/s" in counts


def test_two_axes_are_told_each_and_one_rate_is_not():
    x, y = turned(axis="x"), turned(axis="y")
    both = replace(
        x,
        reading=np.vstack((x.reading, y.reading[:1])),
        turn_rate=np.concatenate((x.turn_rate, y.turn_rate[:1])),
        axis=("x",) * 4 + ("y",),
        time=np.arange(5.0),
    )
    assert [fit.axis for fit in fit_rate_axes(both)] == ["x"]


@pytest.mark.parametrize(
    ("dwells", "reads"), [(turned(-1.0), "column y that reads them as -y"), (turned(column="z"), r"column z .* \+z")]
)
def test_a_reversed_or_foreign_column_is_refused_in_any_unit(dwells, reads):
    for unit in ("dps", "count"):
        with pytest.raises(Implausible, match=f"wanted the y gyroscope to read \\+ for turns about \\+y, got {reads}"):
            fit_rate_axes(replace(dwells, unit=unit))


def test_a_wrong_conversion_is_called_out_and_refused_where_a_tolerance_is_stated():
    (fit,) = fit_rate_axes(turned(0.853))
    verdict = scale_verdict(np.array([fit.scale_factor]), "dps", "y")
    assert verdict.status == "marginal"
    assert "the scale factor of y is -14.7 % off the unit's own scale: implausible for any sensor" in verdict.reasons[0]
    with pytest.raises(Implausible, match=r"within 3 % of the stated sensitivity, got 0\.8530"):
        fit_rate_axes(turned(0.853), RateTableSettings(scale_tolerance=0.03))
    assert scale_verdict(np.array([1.03, 0.97, 1.0]) / DPS, "dps").status == "good"
    assert scale_verdict(np.array([12.0]), "count").status == "good"
