"""Each mistake is named, or comes out as listed, and sound input raises no alarm."""

import pytest

from mistakes.planting import expected_of, false_alarms, judged, label_of
from mistakes.routes import MISTAKES

SOUND = tuple(dict.fromkeys(one.sound for one in MISTAKES))


@pytest.mark.parametrize("one", MISTAKES, ids=lambda one: f"{label_of(one.sound)}: a person {one.name}")
def test_a_mistake_is_named_or_comes_out_as_listed(one):
    result = judged(one)
    assert result.outcome == expected_of(one), result


@pytest.mark.parametrize("sound", SOUND, ids=label_of)
def test_sound_input_raises_no_alarm(sound):
    assert false_alarms(sound, MISTAKES) == []
