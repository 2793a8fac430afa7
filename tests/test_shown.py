"""plot() and the tables of notebooks: what each result shows of itself."""

import re
from html import unescape

import numpy as np
import pytest

import undrift
from undrift.errors import InputError
from undrift.model import Calibration
from undrift.record import Record
from undrift.report.drift import draw_drift
from undrift.shown import Shown

KINDS = ("Calibration", "DriftFit", "NoiseFit", "Orientation", "Record", "Trial", "Validation")


@pytest.fixture(scope="module")
def shown():
    """One value of each kind that draws itself, by the name of its kind."""
    rng = np.random.default_rng(7)
    device = undrift.random_device(rng)
    calibration = undrift.calibrate(undrift.simulate_session("bench", device, rng=rng))
    trial = undrift.simulate_trial("sit_to_stand", device, rng=rng)
    corrected = undrift.correct(trial.record, calibration)
    n = 20_000
    rest = Record(
        time=np.arange(n) / 100.0,
        gyro=rng.normal(0.0, 1e-3, (n, 3)),
        accel=rng.normal(0.0, 1e-2, (n, 3)) + np.array([0.0, 0.0, 9.80665]),
    )
    validation = undrift.validate_trials(
        [(trial.record, trial.reference)], calibrations=[calibration], names=["sit <1>"]
    )
    drift = undrift.fit_drift([undrift.simulate_thermal_session("warm_up", device, rng=rng)], calibration=calibration)
    values = (
        corrected,
        calibration,
        undrift.orient(corrected),
        undrift.fit_noise(rest),
        validation.trials[0],
        validation,
        drift,
    )
    return {type(value).__name__: value for value in values}


@pytest.mark.slow
def test_every_kind_that_shows_itself_is_tried_here(shown):
    assert shown.keys() == set(KINDS) == {kind.__name__ for kind in Shown.__subclasses__()}


@pytest.mark.parametrize("kind", KINDS)
def test_each_draws_a_figure_with_curves_and_units(shown, kind, tmp_path):
    figure = shown[kind].plot()
    figure.savefig(tmp_path / "a.png")
    assert (tmp_path / "a.png").stat().st_size > 5000
    assert figure._repr_png_().startswith(b"\x89PNG")  # a notebook shows it without pyplot
    labels = " ".join(axes.get_xlabel() + axes.get_ylabel() for axes in figure.axes)
    assert "(" in labels
    assert any(axes.lines or axes.patches or axes.collections for axes in figure.axes)


@pytest.mark.parametrize("kind", KINDS)
def test_each_has_a_report_which_a_notebook_and_print_show(shown, kind):
    value, report = shown[kind], shown[kind].summary()
    assert str(value).startswith(report.title)
    assert report.answer in str(value)
    page = value._repr_html_()
    assert len(page) < 8000
    texts = {unescape(text) for text in re.split(r"<[^>]+>", page)}
    assert {cell for table in report.tables for row in table.cells for cell in row if cell} <= texts


def test_what_has_nothing_to_draw_is_refused():
    nothing = Calibration(device="", reference_temp_c=25.0, gravity_m_s2=9.81)
    with pytest.raises(InputError, match="plot: expected a calibrated gyroscope or accelerometer, got neither"):
        nothing.plot()
    with pytest.raises(InputError, match="plot: expected offsets over temperature, got none"):
        draw_drift(type("Fit", (), {"calibration": nothing}))
