"""plot() and the tables of notebooks: what each result shows of itself."""

from html.parser import HTMLParser

import numpy as np
import pytest

import undrift
from undrift.base.summary import (
    DRAWN_BY,
    SUMMARISED_BY,
    Section,
    Shown,
    Summary,
    as_html,
    at,
    plain,
    without_signed_zeros,
)
from undrift.errors import InputError
from undrift.model import Calibration
from undrift.record import Record


class Cells(HTMLParser):
    """The texts of a table, and whether every tag is closed."""

    def __init__(self, text):
        super().__init__()
        self.open, self.texts = [], []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.texts.append(data)


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
def test_every_kind_that_has_a_picture_is_tried_here(shown):
    assert shown.keys() == DRAWN_BY.keys()
    assert all(isinstance(value, Shown) for value in shown.values())


@pytest.mark.parametrize("kind", DRAWN_BY)
def test_each_draws_a_figure_with_curves_and_units(shown, kind, tmp_path):
    figure = shown[kind].plot()
    figure.savefig(tmp_path / "a.png")
    assert (tmp_path / "a.png").stat().st_size > 5000
    assert figure._repr_png_().startswith(b"\x89PNG")  # a notebook shows it without pyplot
    labels = " ".join(axes.get_xlabel() + axes.get_ylabel() for axes in figure.axes)
    assert "(" in labels
    assert any(axes.lines or axes.patches or axes.collections for axes in figure.axes)


@pytest.mark.parametrize("kind", SUMMARISED_BY)
def test_calibrations_and_tables_show_what_their_command_shows(shown, kind):
    text, summary = shown[kind]._repr_html_(), at(SUMMARISED_BY[kind])(shown[kind])
    cells = Cells(text)
    assert text == as_html(summary)
    assert cells.open == []
    assert cells.texts[:2] == [summary.title, summary.answer]
    assert {cell for section in summary.sections for row in section.rows for cell in row} <= {*cells.texts}
    assert f"Verdict: {summary.verdict.status}" in cells.texts
    assert len(text) < 8000


@pytest.mark.parametrize("kind", sorted(DRAWN_BY.keys() - SUMMARISED_BY.keys()))
def test_each_other_is_a_small_closed_table_in_a_notebook(shown, kind):
    text = shown[kind]._repr_html_()
    cells = Cells(text)
    assert cells.open == []
    assert cells.texts[0] == kind
    assert 5 <= len(cells.texts) <= 25
    assert len(text) < 4000


def test_what_the_tables_say_is_what_the_values_hold(shown):
    record, validation = shown["Record"], shown["Validation"]
    assert f"{len(record)}, {record.duration_s:.4g} s at {record.sample_rate_hz:.4g} Hz" in record._repr_html_()
    assert f"{validation.mean.rmse_total_deg:.2f} deg" in validation._repr_html_()
    assert "sit &lt;1&gt;" in validation._repr_html_()  # names are text, not tags
    walk = shown["NoiseFit"].gyro[0].angle_random_walk
    assert f"{walk.value:.3g}" in shown["NoiseFit"]._repr_html_()
    assert shown["Calibration"].verdict.status in shown["Calibration"]._repr_html_()
    assert "deg" in shown["Orientation"]._repr_html_()


def test_the_bars_of_a_calibration_are_its_matrix_over_the_mean_gain(shown):
    calibration = shown["Calibration"]
    (drawn,) = (line for line in calibration.plot().axes[0].lines if line.get_marker() == "o")
    heights = drawn.get_ydata()
    gain = calibration.gyro.scale_factor.mean()
    np.testing.assert_allclose(
        heights, 100.0 * (gain * calibration.gyro.matrix - np.eye(3)).ravel(), rtol=1e-12, atol=1e-12
    )


def test_what_has_nothing_to_draw_is_refused():
    nothing = Calibration(device="", reference_temp_c=25.0, gravity_m_s2=9.81)
    with pytest.raises(InputError, match="plot: expected a calibrated gyroscope or accelerometer, got neither"):
        nothing.plot()
    with pytest.raises(InputError, match="plot: expected offsets over temperature, got none"):
        at("undrift.report.drift:draw_drift")(type("Fit", (), {"calibration": nothing}))


# ---- zeros


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("-0.0000", "0.0000"),
        ("offset -0.00(3) deg/s, -0", "offset 0.00(3) deg/s, 0"),
        ("[-0.000, 0.012]", "[0.000, 0.012]"),
        ("-0.0001", "-0.0001"),
        ("-0.5 and -0e-3", "-0.5 and -0e-3"),
        ("2026-01-0 a-0.csv +-0.0 walk/-0", "2026-01-0 a-0.csv +-0.0 walk/-0"),
    ],
)
def test_a_zero_has_no_sign_and_nothing_else_loses_one(text, shown):
    assert without_signed_zeros(text) == shown


def test_no_renderer_is_given_a_signed_zero():
    section = Section(title="t", text=("drift -0.0 deg",), columns=("a", "b"), rows=(("x", "-0.000"),))
    made = Summary(title="t", answer="It drifts by -0.00 deg.", notes=("-0.0 K",), sections=(section,))
    assert (made.answer, made.notes) == ("It drifts by 0.00 deg.", ("0.0 K",))
    assert (section.text, section.rows) == (("drift 0.0 deg",), (("x", "0.000"),))
    assert "-0" not in as_html(made)
    assert str(plain({"drift_deg": -0.0})) == "{'drift_deg': 0.0}"
