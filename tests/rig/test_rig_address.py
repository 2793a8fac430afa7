"""Addresses of rigs."""

import pytest

from testkit.cards import Card
from testkit.scripted_server import Scripted
from undrift.errors import InputError, LimitError
from undrift.rig.galil import GalilRig
from undrift.rig.manual import ManualRig
from undrift.rig.rig import Limits, RigSettings, open_rig, parse_address


def test_an_address_names_the_rig_its_link_and_its_options():
    kind, url, settings = parse_address("galil:serial:///dev/ttyUSB0?baud=9600&encoder_lines=2500&axis=b")
    assert (kind, url) == ("galil", "serial:///dev/ttyUSB0")
    assert (settings.baud, settings.encoder_lines, settings.axis) == (9600, 2500, "B")


def test_an_option_of_the_address_wins_over_the_settings():
    _, _, settings = parse_address("grbl:/dev/pts/3?clock_speed=20", RigSettings(clock_speed=2.0, reply_timeout_s=7.0))
    assert (settings.clock_speed, settings.reply_timeout_s) == (20.0, 7.0)


@pytest.mark.parametrize("address", ["", "galil", "lathe:tcp://host:1", "tcp://host:1"])
def test_a_rig_that_is_none_of_ours_is_refused(address):
    with pytest.raises(InputError, match=r"rig: expected one of galil:..., grbl:..., manual:..., simulated:..., got"):
        open_rig(address)


@pytest.mark.parametrize(
    ("query", "text"),
    [
        ("limits=9", "unknown option 'limits'"),
        ("baud=fast", "'fast' is not a value for baud"),
        ("baud", "expected options as name=value"),
    ],
)
def test_an_option_that_is_none_is_refused(query, text):
    with pytest.raises(InputError, match=text):
        open_rig(f"galil:tcp://127.0.0.1:1?{query}")


def test_the_factory_opens_each_kind():
    with Scripted(Card()) as server:
        rig = open_rig(f"galil:{server.url}?encoder_lines=2500")
        assert isinstance(rig, GalilRig)
        rig.close()
    assert isinstance(open_rig("manual:", RigSettings(ask=lambda line: "")), ManualRig)


@pytest.mark.parametrize("name", ["turn_rate", "acceleration", "travel"])
def test_limits_that_are_none_are_refused(name):
    with pytest.raises(InputError, match=f"limits: `{name}` must be above 0, got 0"):
        Limits(**{name: 0.0})


def test_limits_refuse_what_goes_beyond_and_allow_what_meets_them():
    limits = Limits(turn_rate=1.0, acceleration=2.0, travel=3.0)
    limits.check_turn_rate(-1.0)
    limits.check_acceleration(2.0)
    limits.check_travel(-3.0)
    with pytest.raises(LimitError, match=r"at most 57.2958 deg/s .*, got -63"):
        limits.check_turn_rate(-1.1)
    with pytest.raises(LimitError, match=r"acceleration: at most 114.592 deg/s2 .*, got 0"):
        limits.check_acceleration(0.0)
    with pytest.raises(LimitError, match=r"travel: at most 171.887 deg .*177"):
        limits.check_travel(3.1)
    with pytest.raises(LimitError, match="turn rate"):
        limits.check_turn_rate(float("nan"))
