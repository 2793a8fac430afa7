"""Chambers whose controllers speak Modbus: the driver against pymodbus's own server on loopback, one table of registers each."""

import socket
import subprocess
import sys
import time

import pytest

from testkit.modbus_server import Controller
from undrift.base.clock import Clock
from undrift.errors import InputError, LimitError, LinkError, RigFault
from undrift.rig.chamber import ChamberSetup, SoakSettings, open_chamber
from undrift.rig.modbus import models
from undrift.rig.watch import stop_chamber

F4 = {"read": 100, "wanted": 300, "kind": "int16", "gain": 0.1, "held": {0: 5270, 606: 1}}
EZ_ZONE = {"read": 360, "wanted": 2160, "kind": "float32", "low_first": True, "on": (1880, 10)}
EUROTHERM = {"read": 32770, "wanted": 32772, "kind": "float32", "on": (273, 0), "held": {273: 1}}
KINDS = {"watlow-f4": F4, "watlow-ez-zone": EZ_ZONE, "eurotherm": EUROTHERM}
SETTINGS = ChamberSetup(clock=Clock(200.0), soak=SoakSettings(window_s=20.0))


def address(controller, model, more=""):
    return f"modbus-tcp://127.0.0.1:{controller.port}?model={model}{more}"


def test_every_table_is_tried_here_and_states_its_source():
    assert set(models()) == set(KINDS)
    assert all(len(model.source) > 40 for model in models().values())


@pytest.mark.parametrize("model", KINDS)
def test_a_controller_is_switched_on_set_read_until_soaked_and_switched_off(model):
    with Controller(**KINDS[model]) as controller:
        with open_chamber(address(controller, model), SETTINGS) as chamber:
            assert chamber.read() == pytest.approx(20.0, abs=0.05)
            assert chamber.set(40.5) == pytest.approx(40.5, abs=1e-4)
            assert controller.number(KINDS[model]["wanted"]) == pytest.approx(40.5, abs=1e-4)
            last = time.monotonic() + 10.0
            while not chamber.soaked():
                assert time.monotonic() < last
                time.sleep(0.01)
            assert chamber.read() == pytest.approx(40.5, abs=0.05)
        if controller.on is None:  # no register for that: it goes to a temperature that does no harm
            assert controller.number(300) == pytest.approx(25.0)
        else:
            assert controller.registers[controller.on[0]] != controller.on[1]
        assert controller.registers.get(32774, 0) == 0


def test_temperatures_below_zero_pass_as_whole_numbers():
    with (
        Controller(**F4) as controller,
        open_chamber(address(controller, "watlow-f4"), ChamberSetup(lowest_c=-40.0)) as chamber,
    ):
        assert chamber.set(-22.1) == pytest.approx(-22.1)
        assert controller.registers[300] == 65_536 - 221


def test_a_controller_in_fahrenheit_is_read_and_set_in_it():
    with Controller(**F4) as controller:
        with open_chamber(address(controller, "watlow-f4", "&unit=degF"), SETTINGS) as chamber:
            assert chamber.set(40.0) == pytest.approx(40.0)
            assert controller.number(300) == pytest.approx(104.0)
        assert controller.number(300) == pytest.approx(77.0)


def test_a_serial_line_carries_the_same_messages_as_rtu_frames():
    with Controller(**F4, rtu=True) as controller:
        place = f"modbus-rtu:socket://127.0.0.1:{controller.port}?model=watlow-f4&baud=19200"
        with open_chamber(place, SETTINGS) as chamber:
            assert chamber.set(31.0) == pytest.approx(31.0)
        assert controller.number(300) == pytest.approx(25.0)


def test_the_guard_switches_it_off_from_a_connection_of_its_own():
    with Controller(**EZ_ZONE, held={1880: 10}) as controller:
        stop_chamber(address(controller, "watlow-ez-zone"))
        assert controller.registers[1880] == 62


def test_words_in_the_other_order_are_no_temperature():
    with Controller(**(EZ_ZONE | {"low_first": False})) as controller:
        with (
            open_chamber(address(controller, "watlow-ez-zone"), SETTINGS) as chamber,
            pytest.raises(LinkError, match=r"wanted a temperature in register 360, got .*options words and unit"),
        ):
            chamber.read()
        with open_chamber(address(controller, "watlow-ez-zone", "&words=high-first"), SETTINGS) as chamber:
            assert chamber.read() == pytest.approx(20.0)


def test_another_controller_than_the_one_named_is_refused():
    with (
        Controller(**(F4 | {"held": {0: 2500, 606: 1}})) as controller,
        pytest.raises(LinkError, match=r"wanted 5270 in register 0 of a watlow-f4, got 2500"),
    ):
        open_chamber(address(controller, "watlow-f4"), SETTINGS)
    with (
        Controller(**(F4 | {"held": {0: 5270, 606: 9}})) as controller,
        pytest.raises(LinkError, match=r"wanted 0 to 2 decimal places in register 606, got 9"),
    ):
        open_chamber(address(controller, "watlow-f4"), SETTINGS)


def test_a_set_point_is_within_limits_and_held_by_the_controller():
    with Controller(**F4) as controller, open_chamber(address(controller, "watlow-f4"), SETTINGS) as chamber:
        with pytest.raises(LimitError, match=r"wanted a set-point from 0 to 80 degC, got 120"):
            chamber.set(120.0)
        assert controller.number(300) == pytest.approx(20.0)  # nothing was sent
        controller.registers[606] = 0
    whole = F4 | {"gain": 1.0, "held": {0: 5270, 606: 0}}
    with (
        Controller(**whole) as controller,
        open_chamber(address(controller, "watlow-f4"), SETTINGS) as chamber,
        pytest.raises(RigFault, match=r"wanted a set-point of 40.4 degC, got 40"),
    ):
        chamber.set(40.4)


def test_a_refusal_and_silence_are_one_line():
    quick = ChamberSetup(reply_timeout_s=0.2)
    with Controller(**EZ_ZONE) as controller:
        with open_chamber(address(controller, "watlow-ez-zone"), quick) as chamber:
            controller.refuse.add(360)
            with pytest.raises(LinkError, match=r"wanted register 360, got the controller's refusal 2"):
                chamber.read()
            controller.refuse.clear()
        port = controller.port
    with (
        socket.create_server(("127.0.0.1", 0)) as silent,
        pytest.raises(LinkError, match=r"wanted an answer of the chamber, got .*device number"),
    ):
        open_chamber(f"modbus-tcp://127.0.0.1:{silent.getsockname()[1]}?model=watlow-f4", quick)
    with pytest.raises(LinkError, match=r"wanted a connection, got none; check power, cable and address"):
        open_chamber(f"modbus-tcp://127.0.0.1:{port}?model=watlow-f4", quick)


@pytest.mark.parametrize(
    ("place", "complaint"),
    [
        ("modbus-tcp://h:502", r"wanted model=watlow-f4 or watlow-ez-zone or eurotherm, got ''"),
        ("modbus-tcp://h?model=watlow-f4", r"wanted modbus-tcp://host:502, got 'h'"),
        ("modbus-rtu:?model=watlow-f4", r"wanted modbus-rtu:///dev/name, got no name"),
        ("modbus-tcp://h:502?model=watlow-f4&speed=3", r"wanted options out of model, .*, got 'speed'"),
        ("modbus-tcp://h:502?model=watlow-f4&device=x", r"wanted a whole number for device, got 'x'"),
        ("modbus-tcp://h:502?model=watlow-f4&unit=K", r"wanted unit out of degC, degF, got 'K'"),
        ("modbus-tcp://h:502?model=eurotherm&words=mixed", r"wanted words out of high-first, low-first, got 'mixed'"),
        ("modbus-rtu:///dev/x?model=eurotherm&parity=odd", r"wanted parity out of N, E, O, got 'odd'"),
    ],
)
def test_an_address_that_cannot_be_right_names_what_is_wrong(place, complaint):
    with pytest.raises(InputError, match=complaint):
        open_chamber(place)


def test_without_the_package_the_message_names_the_extra():
    code = (
        "import sys; sys.modules['pymodbus'] = sys.modules['pymodbus.client'] = None\n"
        "from undrift.errors import LinkError\nfrom undrift.rig.chamber import open_chamber\n"
        "try:\n    open_chamber('modbus-tcp://127.0.0.1:1?model=watlow-f4')\nexcept LinkError as error:\n    print(error)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "chamber: wanted the package pymodbus, got none; pip install undrift[modbus]\n"
