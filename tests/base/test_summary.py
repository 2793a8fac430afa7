"""Zeros in the texts of a summary."""

import pytest

from undrift.base.summary import Section, Summary, as_html, plain, without_signed_zeros


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
