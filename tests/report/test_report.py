"""A report shows the same numbers on a terminal, on a page and in JSON."""

import json
import re

import numpy as np
import pytest
from matplotlib.figure import Figure

from testkit.pages import faults_of
from testkit.terminal import Terminal, on
from undrift import __version__
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


@pytest.mark.parametrize(
    ("value", "uncertainty", "shown"),
    [
        (1.0034567, 0.00123, "1.0035 ± 0.0012"),
        (-0.061, 0.0021, "-0.0610 ± 0.0021"),
        (43.491, 0.35, "43.49 ± 0.35"),
        (1.06427e-9, 3.4e-13, "(1.06427 ± 0.00034)e-9"),
        (2.5, 0.0, "2.5"),
    ],
)
def test_values_are_rounded_to_their_uncertainty(value: float, uncertainty: float, shown: str) -> None:
    assert str(Estimate(value, uncertainty)) == shown


# ---- the page


def test_a_page_shows_verdict_tables_and_figures_in_order():
    second = Table(title="Second", figure=lambda: Figure(figsize=(1.0, 1.0)))
    text = page_text(report(tables=[ANGLES, second, Table.of("Nothing", [], note="Not shown.")]))
    assert text.startswith("<!doctype html>")
    order = r'class="verdict marginal".*3 deg/s.*lasts 60.*<th scope=.col.>minimum</th>.*-1.23.*<p>Two rows.</p>.*Second.*<svg'
    assert re.search(order, text, re.S)
    assert "Nothing" not in text
    assert f"undrift {__version__}" in text
    assert "Verdict" not in page_text(report(findings=[]))


def test_what_users_named_is_escaped():
    text = page_text(Report(title="A <title>", answer="Lead & more", tables=[Table(title="<script>", note="a < b")]))
    assert "<script" not in text
    assert "A &lt;title&gt;" in text
    assert "Lead &amp; more" in text
