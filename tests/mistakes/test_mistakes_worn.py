"""Mistakes with a recording of a worn device: none is silent, nine of ten are named, and sound input raises no alarm."""

import pytest

from mistakes.planting import NEVER, check_all, false_alarms, judged
from mistakes.routes import WORN

SOUND = tuple(dict.fromkeys(one.sound for one in WORN))


@pytest.mark.parametrize("one", WORN, ids=lambda one: f"{one.route}, {one.sound.__name__}: a person {one.name}")
def test_a_mistake_is_not_silent(one):
    result = judged(one)
    assert result.outcome not in NEVER, result


def test_nine_of_ten_mistakes_are_named():
    check_all(WORN)


@pytest.mark.parametrize("sound", SOUND, ids=lambda sound: f"{sound.__module__}.{sound.__name__}")
def test_sound_input_raises_no_alarm(sound):
    assert false_alarms(sound, WORN) == []
