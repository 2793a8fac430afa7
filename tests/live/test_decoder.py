"""Decoders: what is whole and sound becomes rows, whatever the pieces it comes in; the rest is counted."""

import numpy as np
import pytest

from undrift.errors import InputError
from undrift.live.decoder import LineDecoder, StreamDescription, decoder_for

CHANNELS = ("count", "gyro_x", "gyro_y", "gyro_z")


def lines(**options: object) -> LineDecoder:
    return LineDecoder(StreamDescription(channels=CHANNELS, rate=100.0, **options))


def test_lines_come_whole_out_of_pieces_of_any_size():
    text = b"".join(b"%d,%d,0.5,-1e-3\r\n" % (k, 2 * k) for k in range(50))
    for size in (1, 7, 1000):
        decoder = lines()
        rows = np.vstack([decoder.feed(text[a : a + size]) for a in range(0, len(text), size)])
        assert np.array_equal(rows, [[k, 2 * k, 0.5, -1e-3] for k in range(50)])
        assert decoder.errors == 0


def test_the_line_that_is_under_way_at_the_start_is_no_error():
    decoder = lines()
    assert decoder.feed(b"5,0.3\n1,2,3,4\n").tolist() == [[1, 2, 3, 4]]
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


def test_nan_in_a_line_is_a_gap_and_stays():
    assert np.isnan(lines().feed(b"1,nan,2,3\n")[0, 1])


def test_a_line_with_a_wrong_checksum_is_left_out():
    text = b"1,2,3,4"
    good = b"$%s*%02X\n" % (text, 0x28)  # 0x31 ^ 0x2C ^ 0x32 ^ 0x2C ^ 0x33 ^ 0x2C ^ 0x34
    decoder = lines(checksum="xor")
    rows = decoder.feed(good + good.replace(b"2", b"6") + b"1,2,3,4*ZZ\n1,2,3,4\n" + good.lower())
    assert rows.tolist() == [[1, 2, 3, 4]] * 2
    assert decoder.errors == 3


def test_a_datagram_ends_its_line():
    assert lines().feed(b"1,2,3,4", whole=True).tolist() == [[1, 2, 3, 4]]


def test_random_bytes_never_raise():
    rng = np.random.default_rng(5)
    for decoder in (lines(), lines(checksum="xor")):
        for _ in range(300):
            decoder.feed(rng.integers(0, 256, rng.integers(0, 200), dtype=np.uint8).tobytes())


def test_a_line_needs_a_separator():
    with pytest.raises(InputError, match=r"no separator"):
        lines(separator="")


def test_the_decoder_follows_the_format():
    assert isinstance(decoder_for(StreamDescription(channels=CHANNELS, rate=1.0)), LineDecoder)
