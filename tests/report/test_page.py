"""A page is one whole file: text is escaped, pictures are not, nothing is fetched."""

import re
from html.parser import HTMLParser

from matplotlib.figure import Figure

from undrift import __version__
from undrift.findings import finding
from undrift.report import Report, Table
from undrift.report.page import page_text


class Balance(HTMLParser):
    """Follows the tags and holds what is open."""

    def __init__(self):
        super().__init__()
        self.open, self.wrong = [], []

    def handle_starttag(self, tag, attrs):
        if tag not in ("meta", "br", "use", "path"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        if tag in ("use", "path"):
            return
        if not self.open or self.open.pop() != tag:
            self.wrong.append(tag)


def page(**more):
    return page_text(Report(title="A <title>", answer="Lead & more", **more))


def test_tables_and_figures_are_shown_in_order():
    first = Table(title="First", columns=("axis", "m x"), rows=(("x", 1.0), ("y", 2.0)), form=".1f", note="One.")
    second = Table(title="Second", figure=lambda: Figure(figsize=(1.0, 1.0)))
    text = page(tables=[first, second])
    assert text.startswith("<!doctype html>")
    assert re.search(r"First.*<th scope=.col.>m x</th>.*2.0</td>.*<p>One.</p>.*Second.*<svg", text, re.S)
    assert f"undrift {__version__}" in text
    balance = Balance()
    balance.feed(re.sub(r"<svg.*?</svg>", "", text, flags=re.S))
    assert (balance.open, balance.wrong) == ([], [])


def test_what_users_named_is_escaped():
    text = page(tables=[Table(title="<script>alert(1)</script>", note="a < b")])
    assert "<script" not in text
    assert "A &lt;title&gt;" in text
    assert "Lead &amp; more" in text


def test_the_verdict_stands_first_with_its_reasons():
    findings = [finding("recording.how_read", "warn", text) for text in ("Too few poses.", "The table slipped.")]
    text = page(findings=findings, tables=[Table(title="Later", note="more")])
    places = [text.index(word) for word in ("Verdict: marginal", "Too few poses", "The table slipped", "Later")]
    assert places == sorted(places)
    assert 'class="verdict marginal"' in text
    assert "Verdict" not in page()
