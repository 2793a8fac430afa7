"""A page is one whole file: text is escaped, pictures are not, nothing is fetched."""

import re
from html.parser import HTMLParser

import pytest

from undrift import __version__
from undrift.base.summary import Section, Summary, sentence
from undrift.findings import finding
from undrift.model import Verdict
from undrift.report.page import write_page


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


def page(tmp_path, **more):
    write_page(tmp_path / "p.html", Summary(title="A <title>", answer="Lead & more", **more))
    return (tmp_path / "p.html").read_text()


def test_sections_tables_and_pictures_are_shown_in_order(tmp_path):
    first = Section(title="First", text=("One", "two"), columns=("axis", "m x"), rows=(("x", "1.0"), ("y", "2.0")))
    second = Section(title="Second", pictures=("<svg><text>drawn</text></svg>",))
    text = page(tmp_path, sections=(first, second))
    assert text.startswith("<!doctype html>")
    assert re.search(
        r"First.*<p>One</p>.*<p>Two</p>.*<th scope=.col.>m x</th>.*<td>2.0</td>.*Second.*<svg><text>drawn", text, re.S
    )
    assert f"undrift {__version__}" in text
    assert text.count("<table>") == 1
    balance = Balance()
    balance.feed(text)
    assert (balance.open, balance.wrong) == ([], [])


def test_what_users_named_is_escaped(tmp_path):
    text = page(tmp_path, sections=(Section(title="<script>alert(1)</script>", text=("a < b",)),))
    assert "<script" not in text
    assert "A &lt;title&gt;" in text
    assert "Lead &amp; more" in text


def test_the_verdict_stands_first_with_its_reasons(tmp_path):
    findings = (finding("recording.how_read", "warn", text) for text in ("too few poses", "the table slipped"))
    verdict = Verdict(status="marginal", findings=tuple(findings))
    text = page(tmp_path, sections=(Section(title="Later", text=("more",)), Section(title="Empty")), verdict=verdict)
    assert (
        text.index("Verdict: marginal")
        < text.index("too few poses")
        < text.index("the table slipped")
        < text.index("Later")
    )
    assert "Empty" not in text
    assert 'class="verdict marginal"' in text
    assert "Verdict" not in page(tmp_path, sections=())


def test_a_page_fetches_nothing(tmp_path):
    assert not re.search(r"(src|href)=|https?:|@import|url\(", page(tmp_path, sections=(Section(title="t"),)))


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("record longer", "Record longer"),
        ("undrift calibrate walk.csv", "undrift calibrate walk.csv"),
        ("imu-17 was turned", "imu-17 was turned"),
        ("a17: no rest", "a17: no rest"),
        ("calibrate --from motion", "calibrate --from motion"),
        ("walk.csv has no time", "walk.csv has no time"),
    ],
)
def test_names_at_the_start_of_a_sentence_are_not_capitalised(text, shown):
    assert sentence(text) == shown
