"""The examples in the docstrings of exported names run, and print what they say."""

import doctest
import inspect

import pytest

import undrift

WITH = {name: text for name in undrift.__all__ if ">>>" in (text := inspect.getdoc(getattr(undrift, name)) or "")}
# They want a reference, a twin's many trials or a file of another program: more than a few lines can show.
WITHOUT = {
    "read_reference", "write_session", "read_calibration", "calibrate_to_references", "NoiseFit", "DriftSettings", "DriftFit",
    "Corrected", "Orientation", "validate_leave_one_out", "fit_twin", "Twin",
    "Validation", "Trial", "OrientationError", "OrientSettings",
    "StillSearch", "TurnSearch", "DeviceModel", "Simulated", "SimulatedTrial", "ExportedC",
}  # fmt: skip


def test_exported_name_has_an_example_or_a_reason() -> None:
    errors = {
        name
        for name in undrift.__all__
        if isinstance(kind := getattr(undrift, name), type) and issubclass(kind, Exception)
    }
    assert {*undrift.__all__} == {*WITH} | WITHOUT | errors
    assert not {*WITH} & WITHOUT


@pytest.mark.parametrize("name", WITH)
def test_the_example_prints_what_it_says(name: str) -> None:
    example = doctest.DocTestParser().get_doctest(WITH[name], {}, name, None, 0)
    result = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE).run(example)
    assert result.attempted >= 2
    assert result.failed == 0
