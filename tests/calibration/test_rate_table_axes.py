"""Turns about one or two axes: what they show is a finding, and what they contradict is refused."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.findings import only
from undrift.calibration.dwells import DwellMeans
from undrift.calibration.rate_table import axis_finding, fit_rate_axes, fit_turned_axes, scale_verdict
from undrift.errors import Implausible, NotObservable

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
    assert verdict.status == "bad"
    off = only(verdict.findings, "gyro.scale_factor")
    assert (off.level, off.values["axis"]) == ("fail", "y")
    assert scale_verdict(np.array([0.93]) / DPS, "dps", "y").status == "marginal"
    assert off.values["off_percent"] == pytest.approx(-14.7)
    with pytest.raises(Implausible, match=r"within 3 % of the stated sensitivity, got 0\.8530"):
        fit_rate_axes(turned(0.853), scale_tolerance=0.03)
    assert scale_verdict(np.array([1.03, 0.97, 1.0]) / DPS, "dps").status == "good"
    assert scale_verdict(np.array([12.0]), "count").status == "good"


def test_one_axis_is_calibrated_and_the_others_keep_the_unit_s_scale_with_a_stated_uncertainty():
    rng = np.random.default_rng(5)
    one = turned(1.02)
    one = replace(one, reading=one.reading + 0.01 * rng.normal(size=(4, 3)), noise=np.full((4, 3), 0.01))
    fit = fit_turned_axes(one, cross_axis_prior=0.02)
    share = fit.model.standard_uncertainty[:9].reshape(3, 3) @ np.abs(fit.model.forward_matrix)
    np.testing.assert_allclose(fit.model.scale_factor * DPS, [1.0, 1.02, 1.0], atol=2e-4)  # 4 dwells, 0.01 of 300 deg/s
    np.testing.assert_allclose(fit.model.offset, 0.3, atol=0.03)  # 0.01 deg/s, four dwells, 3 sigma and more
    assert share[1, 1] < 1e-3
    np.testing.assert_allclose(np.diag(share)[[0, 2]], 0.03, rtol=0.05)
    cross = fit.model.standard_uncertainty.reshape(-1)[:9].reshape(3, 3)[[0, 2], [2, 0]] / DPS
    np.testing.assert_allclose(cross, 0.02, rtol=0.05)
    assert fit.verdict.status == "marginal"
    kept = only(fit.verdict.findings, "rate_table.nominal_kept")
    assert (kept.values["axes"], kept.values["scale_percent"], kept.values["cross_percent"]) == (("x", "z"), 3.0, 2.0)


def test_counts_take_the_scale_of_the_turned_axes_for_the_others_within_a_fifth():
    fit = fit_turned_axes(turned(16.4, unit="count"))
    np.testing.assert_allclose(fit.model.scale_factor, 16.4 / DPS, rtol=1e-9)
    kept = only(fit.verdict.findings, "rate_table.nominal_kept")
    assert (kept.values["source"], kept.values["scale_percent"]) == ("that of the turned axes", 20.0)


def test_a_dwell_at_one_rate_about_another_axis_is_left_out_of_the_fit():
    x, y = turned(axis="x"), turned(1.5, axis="y")
    both = replace(
        x,
        reading=np.vstack((x.reading, y.reading[:1])),
        turn_rate=np.concatenate((x.turn_rate, y.turn_rate[:1])),
        axis=("x",) * 4 + ("y",),
        time=np.arange(5.0),
    )
    np.testing.assert_allclose(fit_turned_axes(both).model.offset, 0.3, rtol=1e-9)
    still = replace(x, reading=x.reading[:1], turn_rate=x.turn_rate[:1], axis=("x",), time=np.zeros(1))
    with pytest.raises(NotObservable, match="wanted dwells at two different rates about an axis, got one"):
        fit_turned_axes(still)


def test_the_scatter_of_turned_axes_is_over_their_spare_dwells():
    rng = np.random.default_rng(5)
    rates = np.tile(RATES, 2)
    reading = np.column_stack((0.0 * rates, rates, 0.0 * rates)) + [0.1, 1.0, 5.0] * rng.standard_normal((8, 3))
    dwells = DwellMeans(reading=reading, turn_rate=rates * DPS, axis=("y",) * 8, unit="dps")
    model = fit_turned_axes(dwells).model
    design = np.column_stack((rates * DPS, np.ones(8)))
    for k, own in enumerate(np.sqrt(np.diag(model.covariance)[9:])):
        left = reading[:, k] - design @ np.linalg.lstsq(design, reading[:, k], rcond=None)[0]
        # eight dwells less two parameters, and Student's widening v / (v - 2): over four
        assert own == pytest.approx(
            np.sqrt(np.linalg.inv(design.T @ design)[1, 1] * float(left @ left) / 4.0), rel=1e-9
        )
