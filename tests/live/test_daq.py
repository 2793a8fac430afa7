"""Analogue sensors on a board: against a stand-in for the driver's package, in a folder of its own."""

import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import testkit
from undrift.errors import InputError, LinkError
from undrift.live.daq import sensors
from undrift.live.recorder import Recorder
from undrift.live.transports import source_at

CHANNELS = "channels=gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z,temp"
PLACE = f"daq:Dev1/ai0:6?{CHANNELS}&rate=100"
VOLTS = (1.417, 1.35, 1.283, 2.5, 2.188, 2.812, 2.982)  # +100, 0, -100 deg/s; 0, -1, +1 g of an ADXL202; 25.05 degC


@pytest.fixture
def board(monkeypatch):
    monkeypatch.syspath_prepend(str(Path(testkit.__file__).parent / "fake_driver"))
    for name in [name for name in sys.modules if name.partition(".")[0] == "nidaqmx"]:
        monkeypatch.delitem(sys.modules, name)
    import nidaqmx

    nidaqmx.BOARD["volts"] = lambda channel, count: VOLTS[channel] + 1e-3 * (count % 2)
    yield nidaqmx
    assert nidaqmx.OPEN == [], "a task was left open"
    for name in [name for name in sys.modules if name.partition(".")[0] == "nidaqmx"]:
        del sys.modules[name]


def recorded(address, seconds=0.3):
    with Recorder(source_at(address)) as recorder:
        start = recorder.now()
        time.sleep(seconds)
        return recorder.between(start, recorder.now())


def test_volts_stay_volts_and_an_lm335_becomes_degrees(board):
    record = recorded(f"{PLACE}&temp_sensor=lm335&terminal=diff&range_v=0:5")
    assert (record.gyro_unit, record.accel_unit) == ("v", "v")
    np.testing.assert_allclose(np.diff(record.time), 0.01, rtol=1e-3)
    np.testing.assert_allclose(record.gyro.mean(axis=0), np.array(VOLTS[:3]) + 5e-4, atol=1e-4)
    np.testing.assert_allclose(record.temp_c.mean(), 298.25 - 273.15, atol=0.01)
    assert {round(float(x), 4) for x in np.ptp(record.accel, axis=0)} == {1e-3}


def test_a_named_sensor_and_a_stated_scale_make_units(board):
    record = recorded(f"{PLACE}&temp_sensor=lm335&gyro_sensor=enc03j&accel_sensor=adxl202")
    assert (record.gyro_unit, record.accel_unit) == ("dps", "g")
    np.testing.assert_allclose(record.gyro.mean(axis=0), [100.7, 0.7, -99.3], atol=0.15)
    np.testing.assert_allclose(record.accel.mean(axis=0), [0.0016, -0.9984, 1.0016], atol=1e-3)
    behind = recorded(f"{PLACE}&temp_scale=50&temp_zero=-100&gyro_v_per_unit=0.0134&gyro_zero_v=1.35")
    np.testing.assert_allclose(behind.gyro.mean(axis=0), [5.04, 0.04, -4.96], atol=0.01)
    assert behind.accel_unit == "v"
    bridge = recorded(f"{PLACE}&temp_sensor=lm335&accel_sensor=icsensors_3031")
    np.testing.assert_allclose(bridge.accel.mean(axis=0) * 10e-3, [2.5005, 2.1885, 2.8125], atol=1e-3)  # volts, from 0
    np.testing.assert_allclose(behind.temp_c.mean(), 49.1, atol=0.1)


def test_the_settings_of_the_address_reach_the_board(board):
    source = source_at(f"{PLACE}&temp_sensor=lm335&terminal=nrse&range_v=2.5")
    source.open()
    (task,) = board.OPEN
    assert (task.setting[0].name, *task.setting[1:]) == ("NRSE", -2.5, 2.5)
    assert task.number_of_channels == 7
    source.close()
    source.close()


def test_a_buffer_that_ran_over_is_an_error_and_not_a_gap(board, monkeypatch):
    source = source_at(f"{PLACE}&temp_sensor=lm335")
    source.open()
    assert len(source.read(2.0).values) >= 1
    monkeypatch.setitem(board.BOARD, "buffer", 3)
    time.sleep(0.1)
    with pytest.raises(
        LinkError, match=r"daq:Dev1/ai0:6: wanted readings, got 'The application is not able to keep up"
    ):
        source.read(1.0)
    source.close()


def test_a_board_that_is_not_there_or_has_another_rate_is_refused(board):
    for place, kind, complaint in (
        (
            PLACE.replace("Dev1", "Dev9"),
            LinkError,
            r"wanted a connection, got 'Physical channel specified does not exist",
        ),
        (PLACE.replace("ai0:6", "ai0:5"), LinkError, r"wanted 7 inputs for 7 channels, got 6 in 'Dev1/ai0:5'"),
        (
            PLACE.replace("rate=100", "rate=123"),
            InputError,
            r"wanted 123 samples/s, got 100 as the nearest .* state rate=100",
        ),
    ):
        with pytest.raises(kind, match=complaint):
            source_at(f"{place}&temp_sensor=lm335").open()


@pytest.mark.parametrize(
    ("more", "complaint"),
    [
        ("", r"wanted the thermometer's scale, got none; state temp_sensor=lm335"),
        ("&temp_sensor=pt100", r"wanted temp_sensor=lm335, got 'pt100'"),
        ("&temp_sensor=lm335&gyro_sensor=x", r"wanted gyro_sensor out of enc03j, got 'x'"),
        ("&temp_sensor=lm335&gyro_zero_v=1", r"wanted gyro_v_per_unit and gyro_zero_v, got one of them"),
        ("&temp_sensor=lm335&accel_v_per_unit=0&accel_zero_v=1", r"wanted accel_v_per_unit other than 0, got 0"),
        ("&temp_sensor=lm335&accel_v_per_unit=a&accel_zero_v=1", r"wanted a number for accel_v_per_unit, got 'a'"),
        ("&temp_sensor=lm335&range_v=5:1", r"wanted range_v as 5 or 0:5, the lower first, got '5:1'"),
        ("&temp_sensor=lm335&terminal=both", r"wanted terminal out of default, .*, got 'both'"),
    ],
)
def test_an_address_that_cannot_be_right_names_what_is_wrong(more, complaint):
    with pytest.raises(InputError, match=complaint):
        source_at(PLACE + more)


def test_inputs_must_be_named_and_are_counted_by_themselves():
    with pytest.raises(InputError, match="got no input; name the board"):
        source_at(f"daq:?{CHANNELS}&rate=100&temp_sensor=lm335")
    with pytest.raises(InputError, match="got 'count' among them"):
        source_at("daq:Dev1/ai0:3?channels=count,gyro_x,gyro_y,gyro_z&rate=100")


def test_every_named_sensor_states_its_source():
    assert all(held["source"] and held["triad"] in ("gyro", "accel") for held in sensors().values())


def test_without_the_package_the_message_names_the_extra():
    code = (
        "import sys; sys.modules['nidaqmx'] = None\nfrom undrift.errors import LinkError\n"
        f"from undrift.live.transports import source_at\ntry:\n    source_at('{PLACE}&temp_sensor=lm335').open()\n"
        "except LinkError as error:\n    print(error)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "daq: wanted the package nidaqmx, got none; pip install undrift[daq]\n"
