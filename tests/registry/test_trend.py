"""Changes between calibrations: what was planted is found, its uncertainty is that of draws, what cannot be compared is named."""

from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest

from testkit.data import show
from testkit.guided import HandFeed, capture_faces, capture_turns
from testkit.pictures import cut_texts
from undrift.base.summary import Origin, Summary
from undrift.calibration.calibrate import calibrate
from undrift.commands.bench.capture import Capture
from undrift.commands.bench.guides import SixFaces, Turns
from undrift.commands.registry import step_section
from undrift.model import Calibration, Provenance, TriadModel
from undrift.registry.trend import MOVED, UNKNOWN_K, Dated, compare, course, headline, trend
from undrift.report.drift import draw_trend
from undrift.report.figures import svg_of
from undrift.report.page import write_page
from undrift.sim.device.presets import random_device
from undrift.units import RADIAN_PER_DEGREE

SIGMA = np.array([2e-4] * 9 + [0.5] * 3)  # of m relative to the scale; of the offset, counts
SCALE = RADIAN_PER_DEGREE / 16.4  # rad/s per count


def triad(matrix, offset, *, unit_in="count", sigma=SIGMA, rng=None):
    """A fit of that truth, its covariance correlated; drawn around it where there is an rng."""
    mix = np.eye(12) + 0.3 * np.eye(12, k=1)
    wide = np.concatenate((sigma[:9] * SCALE, sigma[9:]))
    covariance = mix @ mix.T * np.outer(wide, wide)
    if rng is not None:
        draw = wide * (mix @ rng.normal(size=12))
        matrix, offset = matrix + draw[:9].reshape(3, 3), offset + draw[9:]
    return TriadModel(
        method="rate-table", unit_in=unit_in, unit_out="rad/s", matrix=matrix, offset=offset, covariance=covariance,
        rms_residual=1e-4, count=40, rank=12, condition=3.0, valid_range=(-6.0, 6.0),
    )  # fmt: skip


def dated(number, gyro, *, accel=None, temp_c=25.0, inputs=None):
    made = Provenance(inputs=inputs or ((f"{number}.csv", str(number)),))
    model = Calibration(
        device="A17", reference_temp_c=temp_c, gravity_m_s2=9.81, gyro=gyro, accel=accel, provenance=made
    )
    return Dated(entry=number, made_at=datetime(2026, 1 + number, 2, tzinfo=UTC), model=model)


MATRIX = SCALE * (np.eye(3) + 0.02 * np.array([[0.0, 1.0, -0.5], [0.4, 0.0, 0.7], [-0.2, 0.3, 0.0]]))
OFFSET = np.array([30.0, -12.0, 5.0])


def found(step):
    return {one.parameter: one for one in step.changes if one.sensor == "gyro"}


def test_a_planted_change_is_found_to_its_value_and_said_in_plain_words():
    gain = np.eye(3)
    gain[1, 1], gain[0, 2] = 1.005, 0.003
    step = compare(dated(1, triad(MATRIX, OFFSET)), dated(2, triad(gain @ MATRIX, OFFSET + np.array([0.0, 0.0, 8.0]))))
    held = found(step)
    assert held["scale y"].change == pytest.approx(0.5, rel=1e-9)
    assert held["cross-axis xz"].change == pytest.approx(0.3, rel=1e-9)
    assert held["scale x"].change == pytest.approx(0.0, abs=1e-9)
    shift = MATRIX @ np.array([0.0, 0.0, 8.0]) / RADIAN_PER_DEGREE
    assert [held[f"offset {axis}"].change for axis in "xyz"] == pytest.approx(shift, rel=1e-9, abs=1e-12)
    first, *others = step.sentences
    assert first == f"scale of gyro y moved by {held['scale y'].sigmas:.1f} sigma since 2026-02-02: +0.5 %"
    assert any(text.startswith("cross-axis of gyro xz moved by ") for text in others)
    assert {one.name for one in step.changes if one.sigmas >= MOVED} == {
        text.partition(" moved")[0] for text in step.sentences
    }
    assert step.not_compared == ("accel: not calibrated in both",)


def test_without_a_change_the_sigmas_are_those_of_independent_draws():
    rng, sigmas = np.random.default_rng(5), []
    for _ in range(400):
        one, other = (triad(MATRIX, OFFSET, rng=rng) for _ in range(2))
        sigmas.append(
            [change.change / change.uncertainty for change in compare(dated(1, one), dated(2, other)).changes]
        )
    spread = np.std(sigmas, axis=0)
    show("spread of change / uncertainty, least and greatest of 12", (float(spread.min()), float(spread.max())))
    # 400 draws give a spread to 1 / sqrt(800) = 0.035; 4 of those
    assert np.abs(spread - 1.0).max() < 0.15
    assert np.abs(np.mean(sigmas, axis=0)).max() < 4.0 / np.sqrt(400)


def by_hand(device, seed, folder):
    """Calibrate a device as the bench guides it: faces off level, turns that err, a board that warms, flicker, codes."""
    with HandFeed(seed=seed, device=device) as feed:
        capture = Capture(folder, device.serial)
        capture_faces(feed, SixFaces(capture))
        capture_turns(feed, Turns(capture))
        return calibrate(capture.session())


def since(before, after):
    return compare(
        *(
            Dated(entry=k, made_at=datetime(2026, k, 2, tzinfo=UTC), model=model)
            for k, model in enumerate((before, after), 1)
        )
    )


@pytest.mark.slow
@pytest.mark.parametrize("devices", [2, 4])
def test_on_a_bench_that_errs_a_device_that_did_not_change_is_not_said_to_and_one_that_did_is(devices, tmp_path):
    sigmas = []
    for k in range(devices):
        device = random_device(np.random.default_rng(k), grade="consumer")
        first, second = (by_hand(device, 100 * k + session, tmp_path) for session in range(2))
        sigmas += [change.sigmas for change in since(first, second).changes]
    assert len(sigmas) == 24 * devices
    inside, moved = np.mean(np.array(sigmas) < 1.96), int(np.sum(np.array(sigmas) >= MOVED))
    show("changes of unchanged devices inside 95 %", f"{100.0 * inside:.1f} % of {len(sigmas)}", "90 % or more")
    show("reported as moved", moved, "2 at most")
    # exact intervals report 0.3 of 96 changes, and 3 or more in 1 % of such runs
    assert inside >= 0.90
    assert moved <= 2
    scale = device.gyro.scale
    error = (1.0 + scale.error) * np.array([1.0, 1.02, 1.0]) - 1.0
    aged = replace(device, gyro=replace(device.gyro, scale=replace(scale, error=error)))
    step = since(first, by_hand(aged, 999, tmp_path))
    (change,) = (one for one in step.changes if one.name == "scale of gyro y")
    show(
        "scale of gyro y, 2 % more sensitive",
        f"{change.change:+.2f} +- {change.uncertainty:.2f} %, {change.sigmas:.1f} sigma",
    )
    assert step.sentences[0].startswith("scale of gyro y moved by ")
    assert abs(change.change + 100.0 * (1.0 - 1.0 / 1.02)) < 3.0 * change.uncertainty


def test_temperatures_apart_widen_the_uncertainty_by_what_consumer_parts_drift():
    same = found(compare(dated(1, triad(MATRIX, OFFSET)), dated(2, triad(MATRIX, OFFSET))))
    apart = found(compare(dated(1, triad(MATRIX, OFFSET)), dated(2, triad(MATRIX, OFFSET), temp_c=29.0)))
    assert apart["scale x"].uncertainty ** 2 - same["scale x"].uncertainty ** 2 == pytest.approx((4.0 * 0.02) ** 2)
    assert apart["offset x"].uncertainty ** 2 - same["offset x"].uncertainty ** 2 == pytest.approx((4.0 * 0.05) ** 2)
    assert apart["cross-axis xy"].uncertainty == same["cross-axis xy"].uncertainty
    unknown = compare(dated(1, triad(MATRIX, OFFSET)), dated(2, triad(MATRIX, OFFSET), temp_c=np.nan))
    assert unknown.not_compared[0] == f"temperature is not recorded in both: a difference of {UNKNOWN_K:g} K is assumed"
    assert found(unknown)["scale x"].uncertainty > apart["scale x"].uncertainty


G = np.zeros((3, 3))


@pytest.mark.parametrize(
    ("after", "why"),
    [
        (dated(2, None), "gyro: not calibrated in both"),
        (dated(2, triad(MATRIX, OFFSET, unit_in="dps")), "gyro: units differ, rad/s per count and rad/s per dps"),
        (dated(2, triad(MATRIX, OFFSET), temp_c=36.0), "gyro: reference temperatures differ by 11.0 K, more than 10 K"),
        (dated(2, triad(MATRIX, OFFSET), inputs=(("a", "1"), ("b", "9"))), "gyro: both come from the same recordings (1 files)"),
        (dated(2, triad(MATRIX, OFFSET, sigma=np.full(12, np.nan))), "gyro: no uncertainty is stated"),
    ],
)  # fmt: skip
def test_what_cannot_be_compared_is_left_out_with_the_reason(after, why):
    step = compare(dated(1, triad(MATRIX, OFFSET)), after)
    assert (step.changes, step.sentences) == ((), ("nothing to compare since 2026-02-02",))
    assert why in step.not_compared


def test_a_parameter_that_was_held_in_a_fit_is_left_out_and_named():
    held = np.where(np.arange(12) < 9, 0.0, SIGMA)
    step = compare(dated(1, triad(MATRIX, OFFSET, sigma=held)), dated(2, triad(1.1 * MATRIX, OFFSET, sigma=held)))
    assert [one.parameter for one in step.changes] == ["offset x", "offset y", "offset z"]
    assert step.not_compared[0].startswith("gyro: scale x, cross-axis xy, ")
    assert step.not_compared[0].endswith("no uncertainty is stated")
    both = (
        dated(1, replace(triad(MATRIX, OFFSET), g_sensitivity=G)),
        dated(2, replace(triad(MATRIX, OFFSET), g_sensitivity=G)),
    )
    assert "gyro: g-sensitivity is not part of the trend" in compare(*both).not_compared


def test_steps_go_from_each_to_the_next_and_the_course_from_the_first():
    three = [dated(k, triad(MATRIX * (1.0 + 0.001 * k), OFFSET)) for k in (1, 2, 3)]
    assert [(step.since.entry, step.until.entry) for step in trend(three)] == [(1, 2), (2, 3)]
    assert [(step.since.entry, step.until.entry) for step in course(three)] == [(1, 2), (1, 3)]
    assert [round(found(step)["scale x"].change, 2) for step in course(three)] == [0.1, 0.2]
    assert trend(three[:1]) == course(three[:1]) == []


def test_a_slow_drift_shows_since_the_first_where_no_step_does():
    slow = [dated(k, triad(MATRIX * (1.0 + 0.0005 * k), OFFSET)) for k in range(1, 6)]
    steps = trend(slow)
    assert all(text.startswith("nothing moved") for step in steps for text in step.sentences)
    assert headline(steps, course(slow)).startswith("scale of gyro ")
    assert headline(steps, course(slow)).endswith("since 2026-02-02: +0.2 %")
    assert headline(steps[:1], course(slow[:2])) == steps[0].sentences[0]
    sudden = [*slow, dated(6, triad(MATRIX * 1.02, OFFSET))]
    assert "since 2026-06-02: +1.7 %" in headline(trend(sudden), course(sudden))  # the last step first


def test_picture_and_page_show_what_moved(tmp_path):
    three = [dated(k, triad(MATRIX * (1.0 + 0.001 * k), OFFSET, rng=np.random.default_rng(k))) for k in (1, 2, 3)]
    assert cut_texts(draw_trend("A17-of-the-third-batch-" * 5, three[0], course(three))) == []
    figure = draw_trend("A17", three[0], course(three))
    assert [axes.get_ylabel() for axes in figure.axes] == ["scale (%)", "offset (deg/s)"]
    drawn = [line.get_ydata() for line in figure.axes[0].get_lines() if len(line.get_ydata()) == 3]
    assert drawn[0].tolist() == [0.0, *(found(step)["scale x"].change for step in course(three))]
    assert "A17: change since 2026-02-02" in svg_of(figure)
    sections = tuple(step_section(step, every=every) for step in trend(three) for every in (False, True))
    write_page(tmp_path / "t.html", Summary(title="Trend of A17", answer="A17", sections=sections), Origin())
    text = (tmp_path / "t.html").read_text()
    for part in (
        *(f"{trend(three)[-1].until.made_at:%Y-%m-%d}: {words}" for words in trend(three)[-1].sentences),
        "2026-02-02 to 2026-03-02",
        "not compared: accel: not calibrated in both",
        "gyro scale x",
    ):
        assert part in text
    assert "A$\\frac$: change since" in svg_of(draw_trend("A$\\frac$", three[0], course(three)))  # no formula
    nothing = [dated(1, None), dated(2, None)]
    assert "no calibrations to compare" in svg_of(draw_trend("A17", nothing[0], course(nothing)))
