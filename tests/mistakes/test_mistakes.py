"""Each mistake is named, or comes out as the catalogue says; none is silent, and sound input raises no alarm."""

import pytest

from mistakes.cases import CASES, case_of
from mistakes.catalogue import MISTAKES
from mistakes.planting import false_alarms, judge


def test_none_is_silent_and_nine_of_ten_are_named() -> None:
    outcomes = [mistake.outcome for mistake in MISTAKES]
    assert "silent" not in outcomes
    assert outcomes.count("named") >= 0.9 * len(outcomes)


@pytest.mark.parametrize("mistake", MISTAKES, ids=lambda mistake: mistake.label)
def test_a_mistake_comes_out_as_listed(mistake) -> None:
    outcome, line = judge(mistake, case_of(mistake.sound))
    assert outcome == mistake.outcome, line


@pytest.mark.parametrize("sound", CASES)
def test_sound_input_raises_no_alarm(sound) -> None:
    assert false_alarms(case_of(sound), [mistake.says for mistake in MISTAKES if mistake.sound == sound]) == []
