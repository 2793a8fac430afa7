"""What an error is made of, and which effect hides a parameter: known parts, then benches on which the answer is planted."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from testkit.data import show
from undrift.errors import InputError
from undrift.programme import Protocol
from undrift.sim.bench_errors import BenchErrors
from undrift.sim.device.effects import Nonlinearity, Offset
from undrift.sim.device.model import device_json
from undrift.sim.device.presets import preset
from undrift.study.case import EFFECTS
from undrift.study.judge import Optimum, find_optimum
from undrift.study.outcome import ErrorBreakdown, split_error, split_findings, split_study, units_without
from undrift.study.plan import Aim, Space, Study, StudyTask, Timing
from undrift.study.run import InProcess, TaskSurface, run_study
from undrift.units import STANDARD_GRAVITY

DPS = np.pi / 180.0
SIZES = dict(zip(EFFECTS, (0.05, 0.8, 0.02, 0.1, 0.05, 0.05, 0.0, 0.02), strict=True))  # deg: an offset drowns the rest
VALUES = np.array([0.6, 0.2, 0.05])  # deg: what the parameter leaves, at each of its values


def planted(without: str = "", *, subjects: int = 40, values: np.ndarray = VALUES) -> np.ndarray:
    """Rms errors (S, 3) of effects that are independent over the subjects, one of them switched off; the same draws."""
    rng, square = np.random.default_rng(7), np.zeros((subjects, 3))
    for effect, size in SIZES.items():
        drawn = size * rng.normal(0.0, 1.0, (subjects, 1))
        square += 0.0 if effect == without else drawn**2
    square += (values * np.abs(1.0 + 0.2 * rng.normal(0.0, 1.0, (subjects, 3)))) ** 2
    return np.sqrt(square)


def split(values: np.ndarray = VALUES, margin_deg: float = 0.15) -> ErrorBreakdown:
    without = {each: planted(each, values=values) for each in EFFECTS}
    return split_error(
        "turn_rate_max_dps",
        np.array([50.0, 70.0, 90.0]),
        planted(values=values),
        without,
        at=2,
        aim=Aim(margin_deg=margin_deg),
    )


def test_parts_of_independent_effects_are_their_mean_squares_and_leave_the_rest() -> None:
    found = split()
    assert [term.effect for term in found.terms][:2] == ["gyroscope offset", "scale"]
    total = float((planted()[:, 2] ** 2).mean())
    for term in found.terms:
        lost = float((planted()[:, 2] ** 2 - planted(term.effect)[:, 2] ** 2).mean())
        assert term.share == pytest.approx(lost / total, rel=1e-9)
        assert term.share_interval[0] <= term.share <= term.share_interval[1]
        assert term.rms_deg**2 == pytest.approx(max(lost, 0.0), abs=1e-12)
    delay = next(term for term in found.terms if term.effect == "delay")
    assert delay.share == 0.0
    rest = 1.0 - sum(term.share for term in found.terms)
    assert found.together == pytest.approx(rest)
    assert 0.0 < found.together < 0.05  # what the parameter itself leaves
    assert found.rms_deg == pytest.approx(total**0.5)


def test_the_effect_that_hides_a_parameter_is_named() -> None:
    # without the offset 0.6 against 0.1 deg decides; with it both drown in 0.8
    found = split(margin_deg=0.3)
    assert found.judged.verdict != "better"
    assert [term.effect for term in found.covering] == ["gyroscope offset"]
    (term,) = found.covering
    assert term.best == 2
    show("p without the offset", term.judged.p_better, "< 0.05")
    first, second = split_findings((found,))
    assert first.code == "study.error_split"
    assert first.text.startswith("What the error is made of: 0.")
    assert (second.code, second.level) == ("study.covered", "warn")
    assert "it decides the error without gyroscope offset (best to worst 0." in second.text
    # a parameter that decides over all protocols is not said to be hidden about one of them
    assert [each.code for each in split_findings((found,), {found.parameter})] == ["study.error_split"]


def test_a_parameter_that_does_nothing_is_hidden_by_nothing() -> None:
    found = split(np.full(3, 0.1))
    assert found.judged.verdict == "equivalent"
    assert found.covering == ()
    assert [each.code for each in split_findings((found,))] == ["study.error_split", "study.not_covered"]


def test_a_parameter_that_decides_needs_no_cover() -> None:
    found = split(np.array([3.0, 1.5, 0.05]))
    assert found.judged.verdict == "better"
    assert found.covering == ()
    assert [each.code for each in split_findings((found,))] == ["study.error_split"]


@pytest.mark.slow
def test_shares_are_covered_by_their_intervals() -> None:
    """Errors are normal, so their squares are skewed: the interval of 100 subjects may hold a little less than 95 %."""
    inside, true = 0, 0.8**2 / (0.8**2 + 0.3**2)
    for seed in range(500):
        rng = np.random.default_rng(seed)
        with_it, rest = (rng.normal(0.0, size, (100, 1)) ** 2 for size in (0.8, 0.3))
        error = np.sqrt(with_it + rest) * np.ones(2)
        found = split_error("cutoff_hz", np.arange(2.0), error, {"noise": np.sqrt(rest) * np.ones(2)}, at=0)
        low, high = found.terms[0].share_interval
        inside += low <= true <= high
    show("intervals of a share that hold it", inside / 500, "0.90 to 0.97")
    assert 0.90 <= inside / 500 <= 0.97


def test_tables_that_do_not_belong_together_are_refused() -> None:
    for error, without, text in (
        (np.ones((5, 3)), {"noise": np.ones((4, 3))}, "got noise"),
        (np.ones((5, 1)), {"noise": np.ones((5, 1))}, r"got \(5, 1\) of 1 effects"),
        (np.ones((5, 3)), {}, "of 0 effects"),
    ):
        with pytest.raises(InputError, match=text):
            split_error("cutoff_hz", np.arange(3.0), error, without, at=0)  # type: ignore[arg-type]


# ---- benches on which the answer is planted; limits were set before anything was run

QUIET = dict.fromkeys(
    ("white_noise", "instability", "adc", "warm_up", "hysteresis", "g_sensitivity", "nonlinearity", "rate_drift")
)


def device(*, bend: float = 0.0, accel_per_k: float = 0.0) -> str:
    """A unit with nothing wrong but its filter, a bend (of full scale) and the accelerometers' zero over temperature."""
    made, chains = preset("enc03j_3031"), {}
    for name in ("gyro", "accel"):
        chain = replace(getattr(made, name), **QUIET, thermal_scale=None, lever_arm=None)
        per_k = np.full((1, 3), accel_per_k if name == "accel" else 0.0)
        chains[name] = replace(chain, offset=Offset(constant=np.full(3, 0.01), per_k=per_k))
    if bend:
        quadratic = np.full(3, bend / (300.0 * DPS))  # the range of the data sheet
        chains["gyro"] = replace(chains["gyro"], nonlinearity=Nonlinearity(quadratic=quadratic))
    return json.dumps(device_json(replace(made, **chains)))  # type: ignore[arg-type]


def planted_study(worn: str, *, timing: Timing, cutoffs: tuple[float, ...], tops_dps: tuple[float, ...]) -> Study:
    space = Space(
        cutoff_hz=cutoffs,
        turn_rate_step=(10.0 * DPS,),
        turn_rate_min=(10.0 * DPS,),
        turn_rate_max=tuple(top * DPS for top in tops_dps),
    )
    base = Protocol(grid="paper", dwell_s=2.0, bracket_s=6.0, temperatures_c=(5.0, 20.0, 35.0, 50.0))
    return Study(
        name="planted",
        device="quiet",
        worn=worn,
        tasks=(StudyTask(name="sit_to_stand", space=space, base=base),),
        subjects=16,
        excursion_k=(-15.0, 15.0),
        bench=BenchErrors(),
        timing=timing,
        margin_deg=0.03,
    )


def found_in(study: Study, folder: Path) -> tuple[TaskSurface, Optimum]:
    (surface,) = run_study(study, InProcess(), folder)
    return surface, find_optimum(surface, study)


def effect_of(optimum: Optimum, name: str):  # type: ignore[no-untyped-def]
    return next(effect for effect in optimum.effects if effect.name == name)


@pytest.mark.slow
def test_a_filter_decides_in_real_time_and_is_better_the_higher_its_cut_off(tmp_path: Path) -> None:
    study = planted_study(device(), timing="real time", cutoffs=(5.0, 11.1, 20.0, 40.0), tops_dps=(90.0,))
    study = replace(study, subjects=10)
    surface, optimum = found_in(study, tmp_path)
    mean = surface.error(timing="real time").mean(axis=0)
    judged = effect_of(optimum, "cutoff_hz").judged
    show("rms at 5, 11.1, 20, 40 Hz in real time, deg", mean, "falls as the delay")
    show("p that 40 Hz is better by more than 0.03 deg", judged.p_better, "< 1e-4")
    assert (optimum.deciding, optimum.best) == (("cutoff_hz",), 3)
    assert judged.verdict == "better"
    assert judged.p_better < 1e-4
    assert all(decision.verdict == "better" for decision in judged.decisions)
    # delays of 45.0, 20.3, 11.3 and 5.6 ms less half a sample: the error of a turn is its rate times these; what the filter bends
    # beside its delay is of second order
    delays = np.sqrt(2.0) / (2.0 * np.pi * surface.cutoff_hz) - 0.005
    np.testing.assert_allclose(mean[:3] / mean[1], delays[:3] / delays[1], rtol=0.15)
    assert mean[3] < 0.2 * mean[2]
    # as soon as the delay is taken out, it decides no more by the margin of the note
    offline = find_optimum(surface, Aim(timing="offline"))
    assert offline.deciding == ()
    assert offline.error_rms_deg < 0.2 * mean[1]
    assert units_without(study, study.tasks[0], surface, optimum)[0].without == EFFECTS[0]
    ((split,),), _ = split_study(study, (surface,), (optimum,), InProcess())
    delay = next(term for term in split.terms if term.effect == "delay")
    assert delay.judged.verdict != "better"  # nothing else makes a cut-off worth choosing
    assert delay.span_deg < 0.2 * float(np.ptp(mean))


@pytest.mark.slow
def test_a_bend_decides_by_the_greatest_rate_and_is_hidden_by_the_accelerometers_drift(tmp_path: Path) -> None:
    words = {"timing": "offline", "cutoffs": (20.0,), "tops_dps": (30.0, 60.0, 90.0)}
    bent = planted_study(device(bend=0.05), **words)  # type: ignore[arg-type]
    surface, optimum = found_in(bent, tmp_path / "bent")
    mean = surface.error("rms", "offline").mean(axis=0)
    judged = effect_of(optimum, "turn_rate_max_dps").judged
    show("rms with omega_M of 30, 60, 90 deg/s, deg", mean, "falls")
    assert optimum.deciding == ("turn_rate_max_dps",)
    assert surface.turn_rate_max_dps[optimum.best] == pytest.approx(90.0)
    show("p that 90 deg/s is better by more than 0.03 deg", judged.p_better, "< 0.001")
    assert (judged.verdict, judged.p_better < 1e-3) == ("better", True)
    # 4 mg/K over up to 15 K: 2 deg of tilt of either sign, forty times the bend's
    drifting = replace(bent, worn=device(bend=0.05, accel_per_k=4e-3 * STANDARD_GRAVITY))
    surface, optimum = found_in(drifting, tmp_path / "drifting")
    assert optimum.deciding == ()
    ((split,),), _ = split_study(drifting, (surface,), (optimum,), InProcess())
    assert split.parameter == "turn_rate_max_dps"
    assert [term.effect for term in split.covering] == ["accelerometer offset"]
    assert split.terms[0].effect == "accelerometer offset"
    assert split.terms[0].share > 0.9
    # without it the bench is the one above, now one of nine tests: with all effects and without each of eight
    assert split.terms[0].judged.p_better == pytest.approx(9.0 * judged.p_better, rel=0.1)
    show(
        "shares of the mean square", [f"{term.effect} {term.share:.3f}" for term in split.terms], "accelerometers first"
    )
    covered = next(item for item in split_findings((split,)) if item.code == "study.covered")
    assert "it decides the error without accelerometer offset" in covered.text
