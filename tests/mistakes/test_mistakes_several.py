"""Mistakes with mountings, clocks, folders and other programs: each is named, or comes out as listed; no alarm without."""

import pytest

from mistakes.planting import expected_of, false_alarms, judged, label_of
from mistakes.routes import SEVERAL

SOUND = tuple(dict.fromkeys(one.sound for one in SEVERAL))


@pytest.mark.parametrize("one", SEVERAL, ids=lambda one: f"{label_of(one.sound)}: a person {one.name}")
def test_a_mistake_is_named_or_comes_out_as_listed(one):
    result = judged(one)
    assert result.outcome == expected_of(one), result


@pytest.mark.parametrize("sound", SOUND, ids=label_of)
def test_sound_input_raises_no_alarm(sound):
    assert false_alarms(sound, SEVERAL) == []
