"""A rig that is a person: asked one line at a time."""

import math

import pytest

from undrift.errors import InputError, LimitError, LinkError, RigFault
from undrift.rig.manual import FACES, ManualRig
from undrift.rig.rig import Limits, RigSettings, open_rig

DEGREE = math.pi / 180.0


class Person:
    def __init__(self, *answers: str) -> None:
        self.answers = list(answers)
        self.lines: list[str] = []

    def __call__(self, line: str) -> str:
        self.lines.append(line)
        return self.answers.pop(0) if self.answers else ""


def test_a_person_is_led_through_the_six_faces():
    person = Person()
    rig = ManualRig(person)
    for face in FACES:
        rig.place(face)
    assert [line.split(" axis up")[0] for line in person.lines] == [
        f"Lay the device still with its {face}" for face in FACES
    ]
    with pytest.raises(InputError, match=r"wanted a face out of \+x, -x, \+y, -y, \+z, -z, got 'up'"):
        rig.place("up")


def test_a_turn_is_what_the_person_says_it_was():
    rig = ManualRig(Person("", "358,5", " -90 deg", "10"))
    assert rig.move_by(2 * math.pi) == pytest.approx(2 * math.pi)
    assert rig.move_by(2 * math.pi) / DEGREE == pytest.approx(358.5)
    assert rig.move_by(-90 * DEGREE) / DEGREE == pytest.approx(-90)
    assert rig.position().angle / DEGREE == pytest.approx(360 + 358.5 - 90)


def test_a_wrong_answer_is_asked_for_again_three_times():
    rig = ManualRig(Person("once", "nan", "355"))
    assert rig.move_by(2 * math.pi) / DEGREE == pytest.approx(355)
    with pytest.raises(InputError, match="wanted an angle in deg, got none in three answers"):
        ManualRig(Person("a", "b", "c")).move_by(1.0)


@pytest.mark.parametrize("said", ["q", "QUIT", "stop"])
def test_a_person_may_give_up(said):
    with pytest.raises(RigFault, match="the person gave up"):
        ManualRig(Person(said)).move_by(1.0)


def test_a_terminal_that_ends_is_a_person_who_gave_up():
    def ended(line: str) -> str:
        raise EOFError

    with pytest.raises(RigFault, match="the person gave up"):
        ManualRig(ended).place("+x")


def test_a_hand_holds_no_rate():
    rig = ManualRig(Person())
    assert rig.turn(0.0) == 0.0
    with pytest.raises(RigFault, match=r"wanted a steady rate, got a hand; plan turns through known angles"):
        rig.turn(1.0)


def test_what_a_person_cannot_know_is_nan():
    rig = ManualRig(Person())
    rig.enable(True)
    rig.stop()
    assert math.isnan(rig.following_error())
    assert math.isnan(rig.set_acceleration(1.0))
    assert rig.measured_turn_rate(0.001) == 0.0
    assert rig.fault() is None
    assert rig.identify() == "a person who turns the device by hand"


def test_the_travel_counts_for_a_hand_too():
    person = Person()
    with pytest.raises(LimitError, match="travel"):
        ManualRig(person, Limits(travel=1.0)).move_by(2.0)
    assert person.lines == []


def test_a_closed_rig_asks_nothing():
    rig = ManualRig(Person())
    rig.close()
    rig.close()
    with pytest.raises(LinkError, match="it is closed; open it again"):
        rig.move_by(1.0)


def test_nobody_to_ask_and_a_person_with_a_port_are_refused():
    with pytest.raises(InputError, match=r"wanted a way to ask a person, got none; give RigSettings\(ask=...\)"):
        open_rig("manual:")
    with pytest.raises(InputError, match="a person has no port"):
        open_rig("manual:tcp://host:1", RigSettings(ask=lambda line: ""))
