"""A device that prints text is described by listening: the shapes of public firmware, in pieces as a port brings them."""

import numpy as np
import pytest

from testkit.byte_sender import Sender
from testkit.firmware import RATE_HZ, Shape, motion, shapes
from undrift.errors import InputError, RigTimeout
from undrift.live.decoder import StreamDescription, decoder_for, described
from undrift.live.log import LogDecoder, described_address, description_of
from undrift.units import si_factor

LENGTH_S, LISTENED = 20.0, (6.0, 9.0)  # s; the device turns meanwhile
ALL = shapes()
HEADED = {
    "header",
    "noisy",
    "header_again",
}  # named above the numbers once, when a board starts
REFUSED = {  # numbers without names, a damaged header, decimal commas; the last comes through no port
    "tabs_without_names", "commas_with_millis", "blanks_with_micros_codes", "quoted_numbers", "monitor_stamps",
    "bracket_stamps", "bracket_seconds", "esp_idf_colours", "zephyr_log", "tagged", "tagged_rates_first",
    "stamped_counter", "semicolons_with_commas", "noisy",
}  # fmt: skip


def pieces_of(shape: Shape) -> list[tuple[float, bytes]]:
    """Return the text as a port brings it: some hundred bytes at a time, each reading when it was printed."""
    raw = shape.text.encode()
    step = max(len(raw) // 1500, 1)
    return [((k + step) * LENGTH_S / len(raw), raw[k : k + step]) for k in range(0, len(raw), step)]


def listened(shape: Shape) -> list[tuple[float, bytes]]:
    start = 0.0 if shape.name in HEADED else LISTENED[0]
    return [piece for piece in pieces_of(shape) if start < piece[0] < LISTENED[1]]


@pytest.mark.parametrize("shape", [one for one in ALL if one.name not in REFUSED], ids=lambda one: one.name)
def test_a_shape_is_described_by_three_seconds_of_it_and_read_right(shape: Shape):
    options, _ = description_of(listened(shape), "board", {})
    sent = described(options)
    decoder, made = decoder_for(sent), motion()
    rows = np.concatenate([decoder.feed(data) for _, data in pieces_of(shape)])
    lost = len(made.time) - len(rows)
    assert 0 <= lost <= 2
    assert sent.rate == pytest.approx(
        RATE_HZ, rel=0.06
    )  # boot messages and lines of other lengths: bytes come evenly here
    counter, values = sent.split(rows)
    record = sent.record(np.arange(len(values)) / RATE_HZ, values)
    true = slice(lost, None)
    for quantity, unit, readings, wanted in (
        ("rate", record.gyro_unit, record.gyro, made.gyro),
        ("accel", record.accel_unit, record.accel, made.accel),
    ):
        assert readings is not None
        if unit == "count":
            assert "scale" in shape.asks
            continue
        np.testing.assert_allclose(readings[200:] * si_factor(unit, quantity), wanted[true][200:], atol=0.02)  # type: ignore[arg-type]
    if counter is not None:
        np.testing.assert_allclose(np.diff(counter) * sent.tick_s, 0.01, atol=2e-3 + 0.02 * (lost > 1))


@pytest.mark.parametrize("name", sorted(REFUSED))
def test_a_shape_that_is_not_described_asks_for_it(name: str):
    shape = next(one for one in ALL if one.name == name)
    with pytest.raises(InputError, match=r"board: .*Describe it"):
        description_of(listened(shape), "board", {})


def lines(text: str, count: int = 300) -> list[tuple[float, bytes]]:
    return [(0.01 * k, text.format(k=k, n=(k * 7) % 5).encode()) for k in range(count)]


def test_a_unit_that_nothing_shows_is_asked_for_and_taken_from_the_address():
    resting = lines("ax:0.0{n},ay:0.02,az:9.81,gx:0.0{n},gy:0.02,gz:0.01\n")
    with pytest.raises(InputError, match=r"unit of its gyro .*board\?gyro_unit=dps"):
        description_of(resting, "board", {})
    options, notes = description_of(resting, "board", {"gyro_unit": "dps"})
    assert (options["gyro_unit"], options["accel_unit"]) == ("dps", "m/s2")
    assert notes == (
        "the device prints no time, so times are from this computer's clock",
        "the names do not contain the units, so these are proposed: accel in m/s2 (accel by the median |a| 9.81)",
    )


def test_a_header_names_plain_numbers_and_a_counter_counts():
    header = [(0.0, b"boot\r\nn,ax [g],ay [g],az [g],gx [mdps],gy [mdps],gz [mdps]\r\n")]
    options, _ = description_of([*header, *lines("{k},0.0{n},0.02,0.98,1.{n},2,3\r\n")], "board", {})
    assert options["channels"] == "count,accel_x,accel_y,accel_z,gyro_x,gyro_y,gyro_z"
    assert (options["gyro_unit"], options["gyro_gain"], options["accel_unit"]) == ("dps", "0.001", "g")
    assert "tick" not in options
    assert float(options["rate"]) == pytest.approx(100.0, rel=0.01)


def test_damaged_and_torn_lines_are_left_out_and_counted_and_equal_lines_count_each():
    sent = StreamDescription(channels=("accel_x", "accel_y", "accel_z"), rate=100.0, format="log", separator="acc:")
    decoder = decoder_for(sent)
    assert isinstance(decoder, LogDecoder)
    text = b"cc:1,2,3\n" + b"acc:1,2,3\n" * 20 + b"acc:1,2\nacc:4,5\xff,6\n" + b"acc:1,2,3\nacc:7,"
    rows = np.concatenate([decoder.feed(text[k : k + 7]) for k in range(0, len(text), 7)])
    assert (len(rows), decoder.errors) == (21, 2)
    assert decoder.feed(b"8,9\n").tolist() == [[7.0, 8.0, 9.0]]


def test_lines_of_a_reading_stay_together_wherever_the_port_cuts_them():
    sent = StreamDescription(
        channels=("accel_x", "accel_y", "accel_z", "gyro_x", "gyro_y", "gyro_z"),
        rate=100.0,
        format="log",
        separator="acc:",
    )
    text = b"gyr:9,9,9\n" + b"".join(b"acc:%d,2,3\ngyr:%d,5,6\n" % (k, k) for k in range(30))
    for step in (1, 5, 11, 1000):
        decoder = decoder_for(sent)
        rows = np.concatenate([decoder.feed(text[k : k + step]) for k in range(0, len(text), step)])
        np.testing.assert_array_equal(rows[:, 0], np.arange(30.0))
        np.testing.assert_array_equal(rows[:, 0], rows[:, 3])


def test_silence_and_other_bytes_are_refused(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("undrift.live.log.SILENCE_S", 0.3)
    with Sender([]) as silent, pytest.raises(RigTimeout, match=r"no text within 0\.3 s"):
        described_address(f"tcp://127.0.0.1:{silent.port}")
    with (
        Sender([bytes(range(128, 256)) * 10]) as binary,
        pytest.raises(InputError, match="not lines of text"),
    ):
        described_address(f"tcp://127.0.0.1:{binary.port}")
