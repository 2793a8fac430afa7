"""Turns about one or two axes: what they show is a finding, and what they contradict is refused."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.findings import only
from undrift.calibration.rate_table import DwellMeans, axis_finding, fit_rate_axes, scale_verdict
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


def test_scale_line_and_asymmetry_are_a_finding():
    (fit,) = fit_rate_axes(turned(1.02))
    shown = axis_finding(fit)
    assert (shown.code, shown.level, shown.values["axis"]) == ("rate_table.axis", "info", "y")
    assert shown.values["scale"] == pytest.approx(1.02, rel=1e-12)
    assert shown.headline == "Turns about y: scale factor 1.02 of the nominal scale"
    assert shown.values["nonlinearity_dps"] == pytest.approx(0.0, abs=1e-9)
    bent = turned()
    bent = replace(bent, reading=np.where(bent.reading > 1.0, 1.1 * bent.reading, bent.reading))
    asymmetry = axis_finding(fit_rate_axes(bent)[0]).values["asymmetry_percent"]
    assert asymmetry == pytest.approx(9.5, abs=0.05)  # 2 (1.1 - 1) / (1.1 + 1), less the offset of 0.3
    counts = axis_finding(fit_rate_axes(turned(16.4, unit="count"))[0])
    assert counts.headline == "Turns about y: scale factor 16.4 count per deg/s"


def test_two_axes_are_fitted_each_and_one_rate_is_not():
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
    off = only(verdict.findings, "gyro.scale_factor")
    assert (off.level, off.values["axis"]) == ("warn", "y")
    assert off.values["off_percent"] == pytest.approx(-14.7)
    with pytest.raises(Implausible, match=r"within 3 % of the stated sensitivity, got 0\.8530"):
        fit_rate_axes(turned(0.853), scale_tolerance=0.03)
    assert scale_verdict(np.array([1.03, 0.97, 1.0]) / DPS, "dps").status == "good"
    assert scale_verdict(np.array([12.0]), "count").status == "good"
