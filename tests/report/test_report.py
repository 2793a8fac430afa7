"""A report shows the same numbers on a terminal, on a page and in JSON."""

import json
import re

import numpy as np
import pytest

from testkit.pages import faults_of
from testkit.terminal import Terminal, on
from undrift.findings import finding
from undrift.report import Estimate, Report, Table
from undrift.report.page import Origin, page_text
from undrift.report.report import as_json
from undrift.report.terminal import show

WARNING = finding("a.warning", "warn", "The rate is 3 deg/s.", "Rest longer.", rate_dps=np.float64(3.0))
FACT = finding("a.fact", "info", "The session lasts 60 s.")
ANGLES = Table(
    title="Angles (deg)",
    columns=("angle", "minimum", "count", "sure", "slope"),
    rows=[("pitch", -1.2345, 3, True, Estimate(0.99643, 0.00011)), ("roll", float("nan"), None, False, None)],
    form=".2f",
    note="Two rows.",
)


def report(**changes):
    parts = {"title": "A title", "answer": "It is 3 deg.", "tables": [ANGLES], "findings": [FACT, WARNING]}
    return Report(**(parts | changes))


def terminal_text(shown, *, details=False):
    with on(place := Terminal(), 100):
        show(shown, details=details)
    return re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", place.getvalue())


def test_cells_are_numbers_in_json_and_text_elsewhere():
    told = as_json(report(), "orient")
    assert told["tables"]["angles_deg"][0] == {
        "angle": "pitch", "minimum": -1.2345, "count": 3, "sure": True,
        "slope": {"value": 0.99643, "uncertainty": 0.00011},
    }  # fmt: skip
    assert told["tables"]["angles_deg"][1]["minimum"] is None
    json.dumps(told, allow_nan=False)
    for text in (terminal_text(report()), page_text(report())):
        for cell in ("-1.23", "3", "yes", "0.99643 ± 0.00011", "–", "Two rows."):
            assert cell in text


def test_a_page_has_its_parts():
    origin = Origin(command="undrift orient", inputs=(("walk.csv", "0" * 64),))
    shown = report(answer="The pitch is within 3 deg after 60 s.", notes=["A note."])
    assert faults_of(page_text(shown, origin)) == []
    assert "undrift info &#39;a b.csv&#39;" in page_text(report(next_command=("info", "a b.csv")))


@pytest.mark.parametrize(
    ("levels", "judged", "verdict", "code"),
    [
        ((), False, None, 0),
        ((), True, "good", 0),
        (("warn",), False, "marginal", 0),
        (("warn", "fail"), False, "bad", 1),
    ],
)
def test_verdict_and_exit_code_follow_from_the_findings(levels, judged, verdict, code):
    findings = [finding("a.code", level, f"A sentence of level {level}.") for level in levels]
    shown = report(findings=findings, judged=judged)
    assert (as_json(shown, "info")["verdict"], shown.exit_code) == (verdict, code)
    assert (f"verdict: {verdict}" in terminal_text(shown)) is (verdict is not None)
    assert (f"Verdict: {verdict}" in page_text(shown)) is (verdict is not None)


def test_a_terminal_shows_warnings_first_and_the_rest_with_details():
    hidden = Table(title="Hidden", columns=("a",), rows=[(7.125,)], form="g")
    facts = [finding(f"a.fact_{k}", "info", f"Fact {k} is known.") for k in range(3)]
    shown = report(details=[hidden], findings=[*facts, WARNING])
    short, long = (terminal_text(shown, details=details) for details in (False, True))
    assert short.index("The rate is 3 deg/s. Rest longer.") < short.index("Fact 0") < short.index("1 more: --details")
    assert "(Hidden): --details" in short
    assert "7.125" not in short
    assert "7.125" in long
    assert "Fact 2 is known." not in short
    assert "Fact 2 is known." in long


def test_a_zero_has_no_sign():
    table = Table(title="Zero", columns=("a",), rows=[(-1e-9,)], form=".3f")
    assert table.cells == [["0.000"]]
