"""Descriptions: what a device sends, from an address, checked before anything is opened."""

import numpy as np
import pytest

from undrift.errors import InputError
from undrift.live.decoder import StreamDescription
from undrift.live.transports import source_at

SIX = ("gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z")


def test_an_address_describes_its_stream():
    source = source_at(
        "tcp://127.0.0.1:9?channels=count,gyro_x,gyro_y,gyro_z,-,temp&rate=250&gyro_unit=dps&counter_bits=16&device=A7"
    )
    what = source.description
    assert what.measured == ("gyro_x", "gyro_y", "gyro_z", "temp")
    assert (what.rate, what.gyro_unit, what.counter_bits, what.device) == (250.0, "dps", 16, "A7")
    assert what.tick_s == 1 / 250
    assert source.name == "tcp://127.0.0.1:9"


def test_readings_become_a_record_in_the_units_stated():
    what = StreamDescription(
        channels=("temp", *SIX), rate=10.0, gyro_unit="dps", accel_unit="g", temp_scale=0.5, temp_zero=-5
    )
    record = what.record(np.arange(3.0), np.arange(21.0).reshape(3, 7))
    assert record.gyro_unit == "dps"
    assert record.temp_c.tolist() == [-5.0, -1.5, 2.0]
    assert record.accel[1].tolist() == [11, 12, 13]
    assert (record.state, record.frame, record.mag_ut) == ("raw", "s", None)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({}, r"`rate` must be above 0"),
        ({"rate": 1.0, "clock_speed": 0.0}, r"clock_speed"),
        ({"rate": 1.0, "channels": ("gyro_x", "gyro_y")}, r"gyro .*three axes, got 2"),
        ({"rate": 1.0, "channels": ("temp",)}, r"no channel of gyro"),
        ({"rate": 1.0, "channels": (*SIX, "x")}, r"count, -, .* got 'x'"),
        ({"rate": 1.0, "channels": (*SIX, "temp", "temp")}, r"got 'temp'"),
        ({"rate": 1.0, "gyro_unit": "m"}, r"unit of rate: expected one of"),
        ({"rate": 1.0, "format": "xml"}, r"format .*got 'xml'"),
        ({"rate": 1.0, "checksum": "md5"}, r"none, xor, crc16, got 'md5'"),
        ({"rate": 1.0, "counter_bits": 64}, r"counter_bits .*0 to 53 .*got 64 and 0"),
    ],
)
def test_a_description_that_cannot_be_is_refused(options, text):
    with pytest.raises(InputError, match=text):
        StreamDescription(**options)


@pytest.mark.parametrize(
    ("address", "text"),
    [
        (
            "tcp",
            r"expected one of tcp:..., udp:..., serial:..., lsl:..., simulated:..., got 'tcp'. Name how it is connected",
        ),
        ("can:0?rate=1", r"expected one of tcp"),
        ("tcp://h:1?rate", r"expected options as name=value&name=value, got 'rate'"),
        ("tcp://h:1?rate=fast", r"'fast' is not a number for rate"),
        ("tcp://h:1?rate=1&speed=2", r"unknown option 'speed'"),
        ("tcp://h?rate=1", r"tcp://host:port, got 'tcp://h'"),
        ("tcp://:80?rate=1", r"tcp://host:port, got no host"),
        ("udp://h:x?rate=1", r"udp://host:port, got 'udp://h:x'"),
        ("serial:?rate=1", r"serial:///dev/name\?baud=115200, got '' and baud '115200'"),
        ("serial:///dev/x?rate=1&baud=0", r"got '/dev/x' and baud '0'"),
        ("lsl:?rate=1", r"expected lsl:name"),
        ("lsl:imu?rate=1", r"channels contain 'count'"),
    ],
)
def test_an_address_that_is_none_is_refused_before_anything_is_opened(address, text):
    with pytest.raises(InputError, match=text):
        source_at(address).open()


def test_an_address_keeps_what_it_was_given():
    base = StreamDescription(channels=SIX, rate=7.0)
    assert source_at("udp://:1", base).description == base
    assert source_at("udp://:1?rate=9", base).description.rate == 9.0
