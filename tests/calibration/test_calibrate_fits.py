"""The registry of the fits: another package adds one by an entry point; settings that reach a fit change it as they say."""

import sys
from pathlib import Path

import numpy as np
import pytest

from undrift.calibration.calibrate import FITS, calibrate, calibrate_to_references, find_fit
from undrift.calibration.observe import CalibrateSettings
from undrift.errors import InputError
from undrift.sim.device.presets import random_device
from undrift.sim.sessions import simulate_session

DEVICE = random_device(np.random.default_rng(21), grade="consumer")

OTHER_PACKAGE = '''
from dataclasses import replace

from undrift.calibration.calibrate import FITS, FitMethod


def doubled(seen, mode, accel):
    """Six faces, with twice the matrix: no other fit gives that."""
    found = FITS["six-face"].accel(seen, mode, accel)
    model = replace(found.fit.model, matrix=2.0 * found.fit.model.matrix, method="doubled")
    return replace(found, fit=replace(found.fit, model=model), method="doubled")


METHOD = FitMethod(accel=doubled)
NO_METHOD = doubled
'''


@pytest.fixture
def other_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """An installed package that adds two entries to the group, one of them of the wrong kind."""
    (tmp_path / "doubled_fit.py").write_text(OTHER_PACKAGE)
    info = tmp_path / "doubled_fit-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: doubled-fit\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        "[undrift.fits]\ndoubled = doubled_fit:METHOD\nfaulty = doubled_fit:NO_METHOD\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    yield
    sys.modules.pop("doubled_fit", None)


@pytest.fixture(scope="module")
def faces():
    return simulate_session("six_face", DEVICE, rng=np.random.default_rng(22), temp_c=25.0)


@pytest.fixture(scope="module")
def bench():
    return simulate_session("bench", DEVICE, rng=np.random.default_rng(22), temp_c=25.0)


@pytest.mark.usefixtures("other_package")
def test_a_fit_of_another_package_calibrates(faces):
    own, other = calibrate(faces, accel="six-face"), calibrate(faces, accel="doubled")
    np.testing.assert_array_equal(other.accel.matrix, 2.0 * own.accel.matrix)
    assert other.accel.method == "doubled"
    assert dict(other.provenance.settings)["accel"] == "doubled"
    assert "doubled" not in FITS


@pytest.mark.usefixtures("other_package")
def test_other_packages_are_loaded_when_asked_for_alone(faces):
    calibrate(faces, accel="six-face")
    assert "doubled_fit" not in sys.modules


@pytest.mark.usefixtures("other_package")
def test_an_entry_of_the_wrong_kind_is_named(faces):
    with pytest.raises(
        InputError, match="wanted a FitMethod from doubled_fit:NO_METHOD, got function; correct the entry"
    ):
        calibrate(faces, accel="faulty")


@pytest.mark.usefixtures("other_package")
def test_an_unknown_name_is_answered_with_all_that_there_are(faces):
    with pytest.raises(InputError) as caught:
        calibrate(faces, accel="best")
    assert str(caught.value) == (
        "calibrate: wanted accel one of six-face, multi-position, doubled, faulty, got 'best'; name one of them"
    )


@pytest.mark.parametrize(
    ("kind", "names"),
    [
        ("accel", "six-face, multi-position"),
        ("gyro", "multi-position, rate-table, known-rotation, rest"),
        ("reference", "reference"),
    ],
)
def test_each_kind_of_fit_is_listed_apart(kind, names):
    with pytest.raises(InputError, match=f"wanted {kind} one of {names}, got 'x'; name one of them"):
        find_fit("x", kind)


def test_a_fit_of_the_other_triad_is_no_fit_of_this_one(faces):
    with pytest.raises(InputError, match=r"wanted gyro one of .*, got 'six-face'"):
        calibrate(faces, gyro="six-face")
    with pytest.raises(InputError, match="wanted reference one of reference, got 'rate-table'"):
        calibrate_to_references(faces.records, (), method="rate-table")


def test_the_spline_filter_leaves_the_means_and_the_settling_time_does_not(bench):
    plain = calibrate(bench)
    splined = calibrate(bench, settings=CalibrateSettings(spline_cutoff_hz=5.0))
    # The smoothing spline keeps the mean of its samples, to the rounding of its solver.
    np.testing.assert_allclose(splined.gyro.matrix, plain.gyro.matrix, rtol=1e-7, atol=1e-12)
    assert not np.array_equal(splined.gyro.matrix, plain.gyro.matrix)
    assert dict(splined.provenance.settings)["spline_cutoff_hz"] == "5"
    later = calibrate(bench, settings=CalibrateSettings(settle_s=1.0))
    assert np.abs(later.gyro.matrix - plain.gyro.matrix).max() > 1e-9 * np.abs(plain.gyro.matrix).max()


def test_window_and_polynomial_of_the_faces_reach_the_fit(faces):
    plain = calibrate(faces)
    short = calibrate(faces, settings=CalibrateSettings(window_s=2.0))
    assert not np.array_equal(short.accel.offset, plain.accel.offset)
    cubic = calibrate(faces, settings=CalibrateSettings(polynomial_degree=3))
    # A polynomial leaves the mean of its window alone; the noise of the means, and so the weights, come from what it leaves.
    np.testing.assert_allclose(cubic.accel.matrix, plain.accel.matrix, rtol=1e-3)
    assert not np.array_equal(cubic.accel.covariance, plain.accel.covariance)
    assert dict(cubic.provenance.settings)["polynomial_degree"] == "3"


@pytest.mark.parametrize(
    ("settings", "wanted"),
    [
        (
            {"window_s": 0.0},
            r"wanted window_s above 0 s, polynomial_degree and settle_s of 0 or more, got 0, 1 and 0\.3",
        ),
        ({"polynomial_degree": -1}, r"got 6, -1 and 0\.3; correct them"),
        ({"settle_s": float("nan")}, "got 6, 1 and nan; correct them"),
        ({"spline_cutoff_hz": 0.0}, "wanted spline_cutoff_hz above 0 Hz, got 0; None leaves the filter out"),
    ],
)
def test_settings_that_are_none_are_refused(settings, wanted):
    with pytest.raises(InputError, match=wanted):
        CalibrateSettings(**settings)
