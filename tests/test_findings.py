"""Findings: numbers next to limits, order, and files."""

import math

import pytest

from undrift.base.codec import tree_of, value_of
from undrift.errors import FileFormatError
from undrift.findings import Finding, Verdict, above, finding, most_consequential_first, told_apart


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


def test_findings_are_sorted_by_level_only_and_each_text_appears_once():
    items = [
        finding(code, level, f"{code}.") for code, level in (("a", "info"), ("b", "warn"), ("c", "fail"), ("d", "warn"))
    ]
    assert [item.code for item in most_consequential_first([*items, items[0]])] == ["c", "b", "d", "a"]


def test_a_value_above_the_first_limit_warns_and_above_the_second_fails():
    levels = [[item.level for item in above("a.b", value, (1.0, 2.0), "It is large.", "")] for value in (1.0, 1.5, 2.5)]
    assert levels == [[], ["warn"], ["fail"]]


def test_a_finding_reads_back_from_its_keys():
    item = finding("a.b", "warn", "It is large.", "Make it small.", size=1.5, count=3, axes=("x", "y"))
    tree = tree_of(item)
    assert list(tree) == ["code", "level", "values", "text", "action"]
    assert tree["text"] == "It is large."
    assert item.text == "It is large. Make it small."
    assert value_of(Finding, tree, "file") == item
    unknown = value_of(Finding, tree | {"values": {"size": None}}, "file")
    assert math.isnan(unknown.values["size"])


@pytest.mark.parametrize(
    "change", [{"code": 1}, {"level": "bad"}, {"values": []}, {"text": None}, {"action": 2}, {"rank": 1}]
)
def test_a_finding_with_a_wrong_key_is_refused_in_one_line(change):
    tree = tree_of(Verdict.of(finding("a.b", "warn", "It is large.")))
    tree["findings"][0] |= change
    with pytest.raises(FileFormatError, match=r"^file: .*findings") as refused:
        value_of(Verdict, tree, "file")
    assert "\n" not in str(refused.value)
