"""Findings in words: every number beside a limit shows in its digits on which side of it it is."""

import string
from dataclasses import replace

import numpy as np
import pytest

from undrift.calibration.calibrate import calibrate
from undrift.errors import UndriftError
from undrift.findings import Finding, catalogue, told_apart
from undrift.sim.bench_errors import BenchErrors
from undrift.sim.device.presets import random_device
from undrift.sim.motion.bench import BenchSettings
from undrift.sim.sessions import simulate_session
from undrift.units import RADIAN_PER_DEGREE

LIMIT_NAMES = ("wanted", "limit_k", "limit_percent", "limit_deg", "limit_mg", "limit_c", "limit", "least_deg", "span_c")
COUNTS = {
    "study.too_few_for_agreement",
}
# "over 5 K"; spans that are no limits
NO_VALUE = {"drift.accel_one_pose", "orient.pitch_axes"}


def fields_of(text):
    return [(name, spec) for _, name, spec, _ in string.Formatter().parse(text) if name]


def pairs_of(code):
    """Return value, limit (a name or a number) and form of every number of a finding that is printed beside its limit."""
    entry = catalogue()[code]
    found = []
    for name, spec in fields_of(f"{entry.headline} {entry.detail}"):
        form, bar, limit = spec.partition("|")
        if bar:
            found.append((name, limit.strip("{}"), form))
    return found


@pytest.mark.parametrize(
    ("value", "form", "limit", "text"),
    [
        (2.04, ".1f", 2.0, "2.04"),
        (2.3, ".1f", 2.0, "2.3"),
        (0.20001, ".2g", 0.2, "0.20001"),
        (-1.0004, "+.3g", 1.0, "-1.0004"),
        (0.99996, ".3g", 1.0, "0.99996"),
        (5.0, ".2g", 5.0, "5"),
        (0.0122, ".3g", float("nan"), "0.0122"),
    ],
)
def test_a_number_has_the_digits_that_tell_it_from_its_limit(value, form, limit, text):
    assert told_apart(value, form, limit) == text


def test_every_sentence_with_a_limit_prints_its_value_beside_it():
    lacking = []
    for code, entry in catalogue().items():
        names = {name for name, _ in fields_of(f"{entry.headline} {entry.detail}")}
        if names & set(LIMIT_NAMES) and code not in COUNTS | NO_VALUE and not pairs_of(code):
            lacking.append(code)
    assert lacking == []


@pytest.mark.parametrize("code", [code for code in catalogue() if pairs_of(code)])
def test_a_value_just_over_its_limit_is_printed_over_it(code):
    entry = catalogue()[code]
    for name, limit, form in pairs_of(code):
        bound = 0.0122173 if limit.isidentifier() else float(limit)
        every = {field: 1.0 for field, _ in fields_of(f"{entry.headline} {entry.detail} {entry.action}")}
        every |= {name: bound * 1.0001, **({limit: bound} if limit.isidentifier() else {})}
        shown = Finding(code, "warn", every).text  # fills in
        assert format(bound, form) == format(bound * 1.0001, form)  # that form alone prints both alike
        assert told_apart(bound * 1.0001, form, bound).lstrip("+") in shown
        assert float(told_apart(bound * 1.0001, form, bound)) > bound


def sessions():
    """Yield sessions of many kinds, some far from ideal."""
    errors = BenchErrors(mount_tilt=0.01, wobble=0.003, ripple=0.02, excess=0.05)
    for seed, kind in enumerate(("bench", "ferraris", "multi_position", "six_face") * 3):
        rng = np.random.default_rng(seed)
        device = (random_device if seed % 3 else lambda g: random_device(g, grade="enc03j_3031"))(rng)
        settings = BenchSettings(
            errors=replace(
                errors if seed > 4 else BenchErrors(),
                face_tilt=(0.0, 0.3, 0.8)[seed // 4] * RADIAN_PER_DEGREE,
                hand_axis=0.03,
            )
        )
        span = (None, (24.5, 25.5), (22.0, 24.1), (20.0, 30.0))[seed % 4]
        session = simulate_session(kind, device, rng=rng, settings=settings, temp_c=span)
        yield session
        yield replace(session, records=tuple(replace(r, temp_c=None) for r in session.records))


@pytest.mark.slow
def test_no_finding_of_a_session_meets_the_limit_that_it_states():
    judged = 0
    for session in sessions():
        try:
            verdict = calibrate(session).verdict
        except UndriftError:
            continue
        for item in verdict.findings:
            for name, limit, _ in pairs_of(item.code):
                bound = item.values[limit] if limit.isidentifier() else float(limit)
                judged += 1
                over = float(np.abs(item.values[name]).max()) > bound
                assert over == (item.level != "info"), item.text
    assert judged >= 2  # few findings state a limit
