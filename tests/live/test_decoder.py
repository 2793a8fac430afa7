"""Decoders: what is whole and sound becomes rows, whatever the pieces it comes in; the rest is counted."""

import struct

import numpy as np
import pytest

from undrift.errors import InputError
from undrift.live.decoder import CHECKSUMS, FrameDecoder, LineDecoder, StreamDescription

CHANNELS = ("count", "gyro_x", "gyro_y", "gyro_z")


def lines(**options: object) -> LineDecoder:
    return LineDecoder(StreamDescription(channels=CHANNELS, rate=100.0, **options))


def frames(**options: object) -> FrameDecoder:
    given = {"channels": CHANNELS, "rate": 100.0, "format": "frame", "pack": "<H3h", "checksum": "crc16"} | options
    return FrameDecoder(StreamDescription(**given))


def frame(count: int, checksum: str = "crc16", order: str = "little") -> bytes:
    body = struct.pack(("<" if order == "little" else ">") + "H3h", count, 1, -2, 3 * count)
    checksum_of, size = CHECKSUMS[checksum]
    return b"\xaa\x55" + body + checksum_of(body).to_bytes(size, order)


@pytest.mark.parametrize(("name", "wanted"), [("none", 0), ("xor", 0x31), ("crc16", 0x29B1)])
def test_checksums_of_the_nine_digits_are_the_published_ones(name, wanted):
    assert CHECKSUMS[name][0](b"123456789") == wanted


def test_lines_come_whole_out_of_pieces_of_any_size():
    text = b"".join(b"%d,%d,0.5,-1e-3\r\n" % (k, 2 * k) for k in range(50))
    for size in (1, 7, 1000):
        decoder = lines()
        rows = np.vstack([decoder.feed(text[a : a + size]) for a in range(0, len(text), size)])
        assert np.array_equal(rows, [[k, 2 * k, 0.5, -1e-3] for k in range(50)])
        assert decoder.errors == 0


@pytest.mark.parametrize(
    "bad", [b"1,2,3", b"1,2,3,4,5", b"1,2,x,4", b"\xff\xfe\x00", b"1,2,3,inf", b"1,2,3,1_0", b"x" * 5000]
)
def test_a_bad_line_is_counted_and_the_next_one_is_read(bad):
    decoder = lines()
    rows = decoder.feed(b"0,0,0,0\n" + bad + b"\n7,8,9,10\n")
    assert rows.tolist() == [[0, 0, 0, 0], [7, 8, 9, 10]]
    assert decoder.errors == 1


def test_a_line_without_end_is_thrown_away():
    decoder = lines()
    for _ in range(10):
        assert not len(decoder.feed(b"9" * 1000))
    assert decoder.errors == 2


def test_a_line_with_a_wrong_checksum_is_left_out():
    text = b"1,2,3,4"
    good = b"$%s*%02X\n" % (text, CHECKSUMS["xor"][0](text))
    decoder = lines(checksum="xor")
    rows = decoder.feed(good + good.replace(b"2", b"6") + b"1,2,3,4*ZZ\n1,2,3,4\n" + good.lower())
    assert rows.tolist() == [[1, 2, 3, 4]] * 2
    assert decoder.errors == 3


@pytest.mark.parametrize(
    ("checksum", "order"), [("crc16", "little"), ("crc16", "big"), ("xor", "big"), ("none", "little")]
)
def test_frames_come_whole_out_of_pieces_of_any_size(checksum, order):
    data = b"".join(frame(k, checksum, order) for k in range(50))
    for size in (1, 5, 1000):
        decoder = frames(checksum=checksum, pack="<H3h" if order == "little" else ">H3h")
        rows = np.vstack([decoder.feed(data[a : a + size]) for a in range(0, len(data), size)])
        assert np.array_equal(rows, [[k, 1, -2, 3 * k] for k in range(50)])
        assert decoder.errors == 0


def test_after_a_spoilt_frame_the_next_one_is_found():
    spoilt = bytearray(frame(2))
    spoilt[5] ^= 1
    decoder = frames()
    rows = decoder.feed(
        frame(1) + bytes(spoilt) + frame(3) + b"rubbish" + frame(4) + frame(5)[:6] + frame(6) + frame(7)
    )
    assert rows[:, 0].tolist() == [1, 3, 4, 6, 7]
    assert decoder.errors == 3


def test_a_cut_datagram_is_an_error_and_not_the_start_of_the_next():
    decoder = frames()
    assert not len(decoder.feed(frame(1)[:7], whole=True))
    assert len(decoder.feed(frame(2), whole=True)) == 1
    assert decoder.errors == 1


def test_random_bytes_never_raise():
    rng = np.random.default_rng(5)
    for decoder in (frames(), lines(), lines(checksum="crc16")):
        for _ in range(300):
            decoder.feed(rng.integers(0, 256, rng.integers(0, 200), dtype=np.uint8).tobytes())


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"sync": "xy"}, r"hex bytes, got 'xy'"),
        ({"sync": ""}, r"require sync bytes"),
        ({"pack": "H3h"}, r"pack .*got 'H3h'"),
        ({"pack": "<H2h"}, r"each of 4 channels, got 3 in '<H2h'"),
    ],
)
def test_frames_that_cannot_be_are_refused(options, text):
    with pytest.raises(InputError, match=text):
        frames(**options)
