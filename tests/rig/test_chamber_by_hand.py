"""A chamber that a person sets when asked: the device's own thermometer shows when it has soaked."""

import re
from dataclasses import replace

import pytest

from testkit.rig_bench import SHORT, Device, at_rest, simulated
from testkit.rig_bench import run as run_on
from undrift.errors import InputError, RigFault
from undrift.io.session import read_session
from undrift.rig.chamber import ChamberSetup, open_chamber
from undrift.rig.simulated import AirSettings

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
            run_on(bench, path, replace(SHORT, temperatures_c=temperatures), chamber=by_hand, readings=readings)
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
