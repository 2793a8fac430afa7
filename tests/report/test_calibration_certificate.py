"""The certificate: shares that sum to the covariance, GTC's combination, coverage of simulated truth, the same bytes twice."""

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.certificate import BEYOND, LEAST, MOST, drawn, held

from testkit.cohorts import COHORTS
from testkit.data import show
from testkit.full_calibration import with_magnetometer
from testkit.plain_triad import plain_triad
from undrift.calibration.expanded import expand
from undrift.errors import InputError
from undrift.io.store import read_calibration, write_calibration
from undrift.model import SOURCES, Budget, Calibration
from undrift.report.calibration import calibration_report
from undrift.report.certificate import SOURCE_ROWS, certificate_report, write_certificate


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    return drawn(np.random.default_rng(5))[0]


# ---- shares


@pytest.mark.parametrize("name", ["gyro", "accel"])
def test_the_shares_combine_to_the_covariance(calibration: Calibration, name: str) -> None:
    triad = getattr(calibration, name)
    assert triad.budget is not None
    assert set(triad.budget.sources) <= set(SOURCES)
    assert len(triad.budget.sources) >= 4
    np.testing.assert_allclose((triad.budget.uncertainty**2).sum(axis=0), np.diag(triad.covariance), rtol=1e-12)
    made = expand(triad)  # beyond the covariance: opposite faces read a quadratic term of a data sheet's size as offset
    bent = np.array([2e-4 * 9.80665**2] * 3) * triad.scale_factor * (name == "accel")
    np.testing.assert_allclose(made.standard[:9], triad.standard_uncertainty[:9], rtol=1e-12)
    np.testing.assert_allclose(made.standard[9:12], np.hypot(triad.standard_uncertainty[9:12], bent), rtol=1e-12)


def test_the_stated_rate_is_that_of_the_table(calibration: Calibration) -> None:
    # A relative error of all rates, 1e-4, moves the elements of the diagonal by just that.
    gyro = calibration.gyro
    rate = gyro.budget.uncertainty[gyro.budget.sources.index("rate")][[0, 4, 8]]
    np.testing.assert_allclose(rate, 1e-4 * np.diag(gyro.matrix), rtol=1e-3)


def test_what_a_part_exceeds_is_not_separated() -> None:
    whole = np.diag([4.0, 9.0])
    made = Budget.of(whole, {"noise": np.array([1.0, -0.5]), "adc": np.array([2.0, 1.0])}, "level")
    assert made.sources == ("level", "noise", "adc")
    np.testing.assert_allclose(made.uncertainty**2, [[1.0, 8.0], [1.0, 0.0], [2.0, 1.0]])
    one = Budget.of(whole, {"noise": np.array([5.0, 1.0])}, "level")
    assert one.sources == ("fit",)
    np.testing.assert_allclose(one.uncertainty, [[2.0, 3.0]])


def test_shares_that_do_not_sum_up_are_refused(calibration: Calibration) -> None:
    with pytest.raises(InputError, match="budget: the squares must sum"):
        replace(calibration.accel, covariance=2.0 * calibration.accel.covariance)


# ---- combination and expansion


def test_the_budget_equals_gtcs(calibration: Calibration) -> None:
    gtc = pytest.importorskip("GTC")
    for triad in (calibration.gyro, calibration.accel):
        made = expand(triad)
        for n in range(len(made.names)):
            total = gtc.constant(0.0)
            for share in made.shares.values():
                total = total + gtc.ureal(0.0, float(share[n]))
            assert made.standard[n] == pytest.approx(total.u, rel=1e-6)
            assert made.expanded[n] == pytest.approx(2.0 * total.u, rel=1e-6)


LEAST_OF_A_KIND = (
    90.0  # percent, the promise of intervals on a bench that errs; too wide is printed, too narrow refused
)


def coverage(devices: int) -> float:
    found: dict[str, list[bool]] = {}
    for kind, inside in held(devices):
        found.setdefault(kind, []).append(inside)
    for kind, each in found.items():
        show(f"truth inside U, {kind}, %", 100.0 * np.mean(each), f">= {LEAST_OF_A_KIND:g}")
        assert 100.0 * np.mean(each) >= LEAST_OF_A_KIND, kind
    share = 100.0 * float(np.mean([inside for kind, each in found.items() if kind != BEYOND for inside in each]))
    show(f"truth inside U, {devices} devices", f"{share:.1f} %", f"{LEAST:g} to {MOST:g} %")
    return share


@pytest.mark.slow
@pytest.mark.parametrize("devices", COHORTS)
def test_the_truth_lies_inside_the_expanded_uncertainty(devices: int) -> None:
    assert LEAST <= coverage(devices) <= MOST


# ---- the document


def test_without_a_thermometer_no_limit_is_at_the_temperature_of_the_calibration(calibration: Calibration) -> None:
    table = calibration_report(replace(calibration, reference_temp_c=np.nan)).tables[0]
    assert [row[0] for row in table.rows] == ["after a rest, within 5 K", "without a rest, within 5 K"]
    assert "not recorded" in table.note


def test_the_same_calibration_gives_the_same_bytes(calibration: Calibration, tmp_path) -> None:
    page(calibration, tmp_path / "a.html")
    write_calibration(calibration, tmp_path / "c.json")
    page(read_calibration(tmp_path / "c.json"), tmp_path / "b.html")
    first = (tmp_path / "a.html").read_bytes()
    assert first.startswith(b"<!doctype html>")
    assert (tmp_path / "b.html").read_bytes() == first
    page(replace(calibration, device="another"), tmp_path / "b.html")
    assert (tmp_path / "b.html").read_bytes() != first


def page(calibration, path):
    """Return the text of a certificate."""
    write_certificate(calibration, path, certificate_report(calibration, {}), {})
    return path.read_text(encoding="utf-8")


def budget_of(calibration, triad):
    """Return the sizes of a budget by the labels of its rows."""
    (table,) = (t for t in certificate_report(calibration, {}).details if t.key == f"{triad}_uncertainty_budget")
    return {row[0]: row[2:] for row in table.rows}


def test_the_page_states_results_sources_and_references(calibration: Calibration, tmp_path) -> None:
    gyro, text = budget_of(calibration, "gyroscopes"), page(calibration, tmp_path / "c.html")
    for source in calibration.gyro.budget.sources:
        assert SOURCE_ROWS[source][0] in gyro
    assert [*gyro][-2:] == ["Combined standard uncertainty", "Expanded uncertainty"]
    for part in (
        "rates in common 0.0001 (relative)",
        "does not claim accreditation",
        "Change with temperature is not included",
        "taken as exact",
    ):
        assert part in text
    # rms of a kind in per cent of the mean scale factor, by hand
    sigma = calibration.gyro.standard_uncertainty[[0, 4, 8]]
    percent = 100.0 * np.sqrt(np.mean(sigma**2)) / np.diag(calibration.gyro.matrix).mean()
    assert gyro["Combined standard uncertainty"][0] == pytest.approx(percent)


@pytest.mark.parametrize("separated", [True, False])
def test_gravity_that_nobody_stated_is_in_the_budget_and_is_not_called_exact(
    calibration: Calibration, tmp_path, separated: bool
) -> None:
    made = calibration.provenance
    assumed = replace(made, settings=tuple((key, "standard" if key == "gravity" else v) for key, v in made.settings))
    accel = calibration.accel if separated else replace(calibration.accel, budget=None)
    unstated = replace(calibration, accel=accel, provenance=assumed)
    rows, text = budget_of(unstated, "accelerometers"), page(unstated, tmp_path / "c.html")
    assert rows["Local gravity"][0] == pytest.approx(0.15, abs=0.01)  # %: a uniform distribution of +-0.027 m/s2
    assert rows["Local gravity"][2] is None  # no offset follows it
    assert rows["Expanded uncertainty"][0] >= 0.30
    assert "standard uncertainty 0.15 %" in text
    assert "taken as exact" not in text
    assert "Local gravity" not in budget_of(unstated, "gyroscopes")


def test_without_shares_one_line_states_all_sources(calibration: Calibration) -> None:
    rows = budget_of(replace(calibration, accel=replace(calibration.accel, budget=None)), "accelerometers")
    assert [*rows] == [
        "Quadratic terms of a data sheet's size", "Fit: sources not separated", "Combined standard uncertainty",
        "Expanded uncertainty",
    ]  # fmt: skip


def test_what_has_no_covariance_is_refused(calibration: Calibration) -> None:
    bare = replace(calibration, gyro=plain_triad("dps", "rad/s"))
    with pytest.raises(InputError, match="expected a covariance of the gyroscopes, got none"):
        certificate_report(bare, {})
    with pytest.raises(InputError, match="expected a calibrated gyroscope or accelerometer, got neither"):
        certificate_report(replace(calibration, gyro=None, accel=None), {})


# ---- what is beside the session


def test_a_magnetometer_is_named_as_left_out(calibration: Calibration, tmp_path) -> None:
    assert "magnetometer" not in page(calibration, tmp_path / "a.html")
    assert "magnetometer is not part" in page(with_magnetometer(calibration), tmp_path / "b.html")
