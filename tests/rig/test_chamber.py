"""The chamber's driver: against answers that are written down, then against the simulated chamber behind its language."""

import math
import re
from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pytest

from testkit.rig_bench import SHORT, Device, at_rest, simulated, with_set_points
from testkit.rig_bench import run as run_on
from testkit.scripted_server import Scripted
from undrift.errors import InputError, LimitError, LinkError, RigFault, RigTimeout
from undrift.io.session import read_session
from undrift.rig.chamber import ChamberSetup, Steadiness, open_chamber
from undrift.rig.simulated import AirSettings

SETTINGS = ChamberSetup(window_s=60.0)
SET = "TEMP:SPO 45.00;:OUTP ON;:TEMP:SPO?"
ANSWERS = {
    "*IDN?": b"maker,model,7,1.2\n",
    SET: b"45.0\n",
    "SYST:ERR?": b'0,"No error"\n',
    "MEAS:TEMP?": b"24.9\r\n",
    "OUTP OFF;:OUTP?": b"0\n",
}


def scripted(answers=MappingProxyType({})):
    """Return a chamber that gives these answers, and its server."""
    server = Scripted({**ANSWERS, **answers}.get, terminator=b"\n")
    return open_chamber(server.url, replace(SETTINGS, clock=server.clock)), server


def test_every_command_goes_out_as_written():
    chamber, server = scripted()
    with chamber:
        assert chamber.identity == "maker,model,7,1.2"
        assert chamber.set(45.0) == 45.0
        assert chamber.read() == 24.9
        assert chamber.soaked() is False
    assert server.heard == ["*IDN?", SET, "SYST:ERR?", "MEAS:TEMP?", "MEAS:TEMP?", "OUTP OFF;:OUTP?"]


@pytest.mark.parametrize("temp_c", [-0.1, math.nan])
def test_set_point_beyond_the_limits_sends_no_byte(temp_c):
    chamber, server = scripted()
    with pytest.raises(LimitError, match=r"must be 0 to 80 degC, got"):
        chamber.set(temp_c)
    assert server.heard == ["*IDN?"]


@pytest.mark.parametrize(
    ("command", "answer", "error", "text"),
    [
        (SET, b"40.0\n", RigFault, r"set 45 degC, .* reports 40"),
        (SET, b"warm\n", LinkError, r"a number .*, got 'warm'"),
        (SET, b"45", RigTimeout, r"got only b'45'"),
        ("SYST:ERR?", b'-222,"Data out of range"\n', RigFault, r"got error -222"),
        (SET, None, RigTimeout, "got nothing"),
        (SET, b"\xff\xfe\n", LinkError, "is not text"),
    ],
)
def test_wrong_answer_is_an_error_and_the_heater_is_off_at_the_end(command, answer, error, text):
    chamber, server = scripted({command: answer})
    with chamber, pytest.raises(error, match=text):
        chamber.set(45.0)
    assert server.heard[-1] == "OUTP OFF;:OUTP?"


def test_a_soak_ends_when_the_air_is_steady_at_its_set_point():
    bench = simulated(air=AirSettings(ramp_c_per_min=10.0, period_s=30.0), chamber=SETTINGS)
    bench.chamber.set(45.0)
    assert bench.clock.until(bench.chamber.soaked, 1200.0, 2.0)
    times = np.linspace(bench.now() - SETTINGS.window_s, bench.now(), 100)
    air = bench.air.at(times)[0]
    # the criterion sees readings rounded to 0.01 degC
    assert 60.0 * np.abs(np.polyfit(times - times[0], air, 1)[0]) < 0.12
    assert air[-1] == pytest.approx(45.0, abs=0.1)
    assert np.ptp(air) < 2.0 * SETTINGS.tolerance_c


def test_steady_is_a_full_window_of_little_slope_near_the_set_point():
    level, ramp, apart, early, hill = (Steadiness(100.0) for _ in range(5))
    for t in range(0, 121, 5):
        level.add(t, 45.0 + 0.01 * (-1) ** t)
        ramp.add(t, 44.8 + 0.12 / 60.0 * t)
        apart.add(t, 45.6)
        hill.add(t, 45.0 - 1e-4 * (t - 70.0) ** 2)  # over its top: the line through all is level
        if t <= 90:
            early.add(t, 45.0)
    assert level.slope_c_per_min() < 0.1
    assert level.error_c(45.0) == pytest.approx(0.01)
    assert ramp.slope_c_per_min() == pytest.approx(0.12)
    assert apart.error_c(45.0) > 0.5
    assert early.slope_c_per_min() == math.inf
    assert hill.slope_c_per_min() > 0.1


QUICK = AirSettings(ramp_c_per_min=300.0, period_s=1.0, board_lag_s=1.0)
RISE_C = 1.5  # of the board above the air, by its own power


class WithThermometer(Device):
    """The device of the bench, on a board in the chamber."""

    def stop(self):
        record = self.readings.stop()
        return replace(record, temp_c=record.temp_c + RISE_C)


def hand_run(path, temperatures, person, *, readings=WithThermometer):
    """Run a protocol at a bench whose chamber obeys nobody but the person at it."""
    bench = simulated(air=QUICK)
    settings = ChamberSetup(clock=bench.clock, window_s=10.0)
    try:
        with open_chamber("manual:", settings, ask=lambda line: person(line, bench.chamber)) as by_hand:
            run_on(bench, path, with_set_points(SHORT, *temperatures), chamber=by_hand, readings=readings)
    finally:
        assert at_rest(bench)


def test_the_run_asks_and_waits_for_the_device(tmp_path, caplog):
    asked = []

    def person(line, chamber):
        asked.append(line)
        chamber.set(float(re.search(r"to ([\d.]+) degC", line)[1]))
        return ""

    hand_run(tmp_path, (30.0, 42.0), person)
    assert asked == [f"Set the chamber to {t} degC, then press Enter (q gives up): " for t in (30, 42)]
    assert "still on" in caplog.text
    session = read_session(tmp_path)
    assert session.kind == "thermal"
    for turn in session.turns:  # what the board reads, 1.5 K above the air, and steady
        assert min(abs(turn.temp_c - 31.5), abs(turn.temp_c - 43.5)) < 0.5
    assert {round(turn.temp_c) for turn in session.turns} & {43, 44}


def test_a_chamber_that_was_set_wrong_ends_the_run(tmp_path):
    with pytest.raises(RigFault, match=r"expected 42 degC, but the device is steady at 3\d\.\d+ degC"):
        hand_run(tmp_path, (30.0, 42.0), lambda line, chamber: chamber.set(30.0) and "")


def test_a_device_without_a_thermometer_and_a_person_who_gives_up_end_the_run_in_one_line(tmp_path):
    with pytest.raises(InputError, match=r"requires a device with a thermometer"):
        hand_run(tmp_path / "a", (30.0, 42.0), lambda line, chamber: "", readings=Device)
    with pytest.raises(RigFault, match=r"not set to 30 degC, got 'q'"):
        hand_run(tmp_path / "b", (30.0, 42.0), lambda line, chamber: "q")
    with pytest.raises(InputError, match=r"requires a person"):
        open_chamber("manual:")


def test_device_that_is_no_chamber_is_not_opened():
    with pytest.raises(LinkError, match="is not maker"):
        scripted({"*IDN?": b"DMC1415\n"})


def test_chamber_that_stays_on_or_has_no_set_point_is_named():
    chamber, _ = scripted({"OUTP OFF;:OUTP?": b"1\n"})
    with pytest.raises(InputError, match="no set-point"):
        chamber.soaked()
    with pytest.raises(RigFault, match="are still on"):
        chamber.switch_off()
