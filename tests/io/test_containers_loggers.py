"""Axivity, GENEActiv and ActiGraph binaries: the makers' example files and figures, and files written after their documents."""

import struct
import zipfile

import numpy as np
import pytest

from testkit.data import data_path
from undrift.errors import FileFormatError, InputError
from undrift.io.columns import ReadSettings
from undrift.io.formats import detect, read_counted, read_record

WHOLE = ReadSettings(drop_bad_rows=True)


def at_rest(accel, values, size=200):
    """Return the mean over the `size` samples in a row in which the accelerometer varies least."""
    spread = [accel[k : k + size].std(axis=0).sum() for k in range(0, len(accel) - size, size // 4)]
    start = int(np.argmin(spread)) * (size // 4)
    return values[start : start + size].mean(axis=0)


# ---- Axivity: figures of makers/axivity_cwa/SOURCE.md


def test_an_ax3_reads_its_17400_samples_and_states_the_formula_of_its_temperature():
    read = read_counted(data_path("makers", "axivity_cwa", "ax3_testfile.cwa"))
    record = read.record
    assert (len(record), record.device, record.accel_unit, record.gyro) == (17400, "AX3 39434", "g", None)
    assert (len(record) - 1) / record.duration_s == pytest.approx(98.87, abs=0.02)  # effective; SOURCE rounds the ends
    assert np.linalg.norm(at_rest(record.accel, record.accel)) == pytest.approx(0.988, abs=0.001)
    assert (record.temp_c.min(), record.temp_c.max()) == pytest.approx((25.59, 26.46), abs=0.005)
    assert np.diff(record.time).max() < 0.0103  # no gap
    assert read.notes == (
        "time 0 is 2019-02-26 10:55:06.000 by the logger's clock (local time, no zone)",
        "temp_c = raw * 75 / 256 - 50 (Open Movement, cwa.h), one value a sector, raw 258 to 261",
    )


def test_an_ax6_reads_its_gyroscope_too():
    record = read_record(data_path("wearable_formats", "ggirread_ax6_testfile.cwa"))
    assert (len(record), record.device, record.gyro_unit) == (11320, "AX6 6011834", "dps")  # 91 * 65536 + 48058
    assert (len(record) - 1) / record.duration_s == pytest.approx(99.04, abs=0.02)
    assert at_rest(record.accel, record.gyro) == pytest.approx(
        (-0.07, 1.08, 0.11), abs=0.05
    )  # SOURCE does not say which seconds
    assert np.linalg.norm(at_rest(record.accel, record.accel)) == pytest.approx(1.0106, abs=0.01)
    assert (record.temp_c.min(), record.temp_c.max()) == pytest.approx((27.05, 28.22), abs=0.005)


def sector(words, *, layout, number=0, second=0, fraction=0, at=0, count=None, scale=0, rate=0x4A, raw=256):
    """Return a data block after cwa.h, 2020-01-01 00:00:00 and some seconds."""
    stamp = 20 << 26 | 1 << 22 | 1 << 17 | second // 60 << 6 | second % 60
    count = len(words) if count is None else count
    data = np.asarray(words).tobytes().ljust(480, b"\0")
    head = struct.pack(
        "<HHHIIIHHBBBBhH", 0x5841, 508, fraction, 1, number, stamp, scale, raw, 0, 0, rate, layout, at, count
    )
    block = head + data
    return block + struct.pack("<H", -int(np.frombuffer(block, "<u2").sum()) & 0xFFFF)


HEADER = (struct.pack("<HHBH", 0x444D, 1020, 0x17, 7) + b"\0" * 4 + b"\xff\xff").ljust(1024, b"\0")


def packed(x, y, z, e):
    return (x & 0x3FF) | (y & 0x3FF) << 10 | (z & 0x3FF) << 20 | e << 30


def test_packed_samples_of_10_bits_are_shifted_by_their_exponent(tmp_path):
    words = np.array([packed(-512, 511, 1, 0), packed(-1, 3, 64, 3)] * 60, dtype="<u4")
    (tmp_path / "a.cwa").write_bytes(HEADER + sector(words, layout=0x30))
    record = read_record(tmp_path / "a.cwa")
    assert (len(record), record.device, record.sample_rate_hz) == (120, "AX3 7", pytest.approx(100.0))
    np.testing.assert_array_equal(record.accel[:2] * 256, [[-512, 511, 1], [-8, 24, 512]])
    assert record.temp_c[0] == 256 * 75 / 256 - 50


def test_samples_of_16_bits_take_the_range_of_the_sector(tmp_path):
    values = np.tile(np.array([8192, 0, -4096], dtype="<i2"), (80, 1))
    (tmp_path / "a.cwa").write_bytes(HEADER + sector(values, layout=0x32, scale=5 << 13))
    assert read_record(tmp_path / "a.cwa").accel[0].tolist() == [1.0, 0.0, -0.5]
    values = np.tile(np.array([16384, 0, -16384, 0, 0, 2048], dtype="<i2"), (40, 1))
    (tmp_path / "b.cwa").write_bytes(HEADER + sector(values, layout=0x62, scale=3 << 13 | 2 << 10))
    record = read_record(tmp_path / "b.cwa")
    assert (record.gyro[0].tolist(), record.accel[0].tolist()) == ([1000.0, 0.0, -1000.0], [0.0, 0.0, 1.0])


def test_a_fraction_of_a_second_places_the_sector_and_a_pause_stays_a_gap(tmp_path):
    words = np.full(100, packed(0, 0, 256, 0), dtype="<u4")
    half = 0x8000 | 0x4000  # 0.5 s: the firmware took 50 samples off the offset
    blocks = [
        sector(words, layout=0x30, number=0, second=10, fraction=half, at=-50),
        sector(words, layout=0x30, number=1, second=11, fraction=half, at=-50),
        sector(words, layout=0x30, number=2, second=30),
    ]
    (tmp_path / "a.cwa").write_bytes(HEADER + b"".join(blocks))
    read = read_counted(tmp_path / "a.cwa")
    assert read.record.time[[0, 99, 100, 199, 200, 299]] == pytest.approx([0, 0.99, 1, 1.99, 19.5, 20.49])
    assert read.notes[0].startswith("time 0 is 2020-01-01 00:00:10.500")


def test_a_damaged_sector_ends_reading_or_is_left_out_and_counted(tmp_path):
    words = np.full(120, packed(0, 0, 256, 0), dtype="<u4")
    blocks = [sector(words, layout=0x30, number=k, second=k, at=0) for k in range(3)]
    broken = HEADER + blocks[0] + blocks[1][:100] + b"\x55" + blocks[1][101:] + blocks[2]
    (tmp_path / "a.cwa").write_bytes(broken)
    with pytest.raises(
        FileFormatError, match=r"wanted whole sectors, got 1 of 3 damaged, first sector 2; copy the file"
    ):
        read_record(tmp_path / "a.cwa")
    read = read_counted(tmp_path / "a.cwa", settings=WHOLE)
    assert (len(read.record), read.dropped_rows) == (240, 120)
    (tmp_path / "b.cwa").write_bytes(HEADER + blocks[0] + blocks[1][:300])
    with pytest.raises(
        FileFormatError, match=r"wanted a header of 1024 bytes and whole sectors of 512, got 1836 bytes"
    ):
        read_record(tmp_path / "b.cwa")
    assert len(read_record(tmp_path / "b.cwa", settings=WHOLE)) == 120


@pytest.mark.parametrize(
    ("blocks", "words"),
    [
        (
            [(0x30, 120), (0x32, 80)],
            "wanted sectors of one known layout, got rate 0x4a layout 0x30, rate 0x4a layout 0x32",
        ),
        ([(0x12, 120)], "wanted sectors of one known layout, got rate 0x4a layout 0x12"),
        ([(0x30, 121)], "wanted up to 120 samples a sector, got 121; it is damaged"),
    ],
)
def test_a_layout_that_cwa_h_does_not_know_is_refused(tmp_path, blocks, words):
    data = np.zeros(120, dtype="<u4")
    made = [sector(data, layout=layout, count=count, number=k) for k, (layout, count) in enumerate(blocks)]
    (tmp_path / "a.cwa").write_bytes(HEADER + b"".join(made))
    with pytest.raises(FileFormatError, match=words):
        read_record(tmp_path / "a.cwa")


# ---- GENEActiv: figures of makers/geneactiv_bin/SOURCE.md


def test_a_geneactiv_reads_its_900_samples():
    read = read_counted(data_path("makers", "geneactiv_bin", "gnactv_sample.bin"))
    record = read.record
    assert (len(record), record.device, record.accel_unit) == (900, "GENEActiv 051386", "g")
    assert record.sample_rate_hz == pytest.approx(50.0)
    assert np.median(np.linalg.norm(record.accel, axis=1)) == pytest.approx(1.003, abs=0.0005)
    assert (record.temp_c.min(), record.temp_c.max()) == (28.1, 29.1)
    # the first words of the first page, F22 027 00B, by the header's gains and offsets
    assert record.accel[0] == pytest.approx(
        [(-222 * 100 - 272) / 25522, (39 * 100 + 1129) / 25457, (11 * 100 - 101) / 24829]
    )
    assert "sample times by the stated 50 Hz (page stamps have 0.5 s)" in read.notes


def test_a_cut_geneactiv_file_is_refused_or_read_to_its_last_whole_page():
    path = data_path("makers", "geneactiv_bin", "GENEActiv_testfile.bin")
    with pytest.raises(FileFormatError, match=r"wanted whole pages, got 1 of 17 damaged, first page 17; copy the file"):
        read_record(path)
    read = read_counted(path, settings=WHOLE)
    assert (len(read.record), read.dropped_rows) == (4800, 300)
    assert read.record.sample_rate_hz == pytest.approx(85.7)
    assert (read.record.temp_c.min(), read.record.temp_c.max()) == (21.5, 23.1)
    assert "222031 of 222048 pages are missing: the file is cut" in read.notes


def pages(count, *, announced=None, rate="50.0", step_s=6.0, temp="21.5", skip=()):
    """Return a GENEActiv file; stamps of 0.5 s, as its own are."""
    text = "Device Identity\nDevice Unique Serial Code:000001\nCalibration Data\n"
    text += "".join(f"{axis} gain:25600\n{axis} offset:0\n" for axis in "xyz")
    text += f"Memory Status\nNumber of Pages:{count - len(skip) if announced is None else announced}\n\n"
    for k in range(count):
        if k in skip:
            continue
        seconds = round(2 * k * step_s) / 2
        stamp = np.datetime64("2020-01-01T00:00:00.000") + np.timedelta64(int(1000 * seconds), "ms")
        text += f"Recorded Data\nSequence Number:{k}\nPage Time:{str(stamp).replace('T', ' ')[:19]}:{str(stamp)[20:]}\n"
        text += f"Temperature:{temp}\nMeasurement Frequency:{rate}\n" + "100" + "0" * 9 + "0FF000F01000" * 299 + "\n"
    return text


def test_many_pages_give_the_true_rate_of_the_clock(tmp_path):
    (tmp_path / "a.bin").write_text(pages(200, step_s=6.06))
    read = read_counted(tmp_path / "a.bin")
    assert (len(read.record) - 1) / read.record.duration_s == pytest.approx(300 / 6.06, rel=2e-4)  # stamps of 0.5 s
    assert read.record.accel[:2].tolist() == [[1.0, 0.0, 0.0], [255 / 256, 0.0, -255 / 256]]
    assert "sample times by page stamps of 200 pages" in read.notes


def test_a_missing_page_stays_a_gap_and_a_decimal_comma_is_read(tmp_path):
    (tmp_path / "a.bin").write_text(pages(4, rate="50,0", temp="21,5", skip=(1,)).replace("\n", "\r\n"))
    record = read_record(tmp_path / "a.bin")
    assert (len(record), record.temp_c[0]) == (900, 21.5)
    assert np.diff(record.time).max() == pytest.approx(6.02)
    assert "1 pages missing by their numbers, seen as gaps in time" in read_counted(tmp_path / "a.bin").notes


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (pages(2, announced=9), "wanted 9 pages as its header states, got 2; the file is cut"),
        (pages(2).replace("y gain:25600\n", ""), "wanted GENEActiv's fields .*, got 'y gain'"),
        (pages(2).replace("Page Time:2020-01-01", "Page Time:2020-31-01"), "wanted GENEActiv's fields"),
        (pages(2).replace("50.0", "25.0", 1), r"wanted one sample rate and gains other than 0, got \[25.0, 50.0\] Hz"),
        (pages(2).replace("x gain:25600", "x gain:0"), "wanted one sample rate and gains other than 0"),
        ("Device Identity\n\0", "wanted whole pages, got none"),
        (pages(4).replace("Number:1", "Number:5"), "wanted pages in order, .*, got page 0 at 0 s and then 5 at 6 s"),
        (pages(4).replace("00:00:06", "00:40:06"), "wanted pages in order, .*, got page 0 at 0 s and then 1 at 2406 s"),
    ],
)
def test_a_geneactiv_header_that_disagrees_is_refused(tmp_path, text, words):
    (tmp_path / "a.bin").write_text(text)
    with pytest.raises(FileFormatError, match=words):
        read_record(tmp_path / "a.bin")


# ---- ActiGraph: figures of makers/actigraph_gt3x/SOURCE.md, and records after the maker's documents

EXAMPLE = bytes.fromhex("006008EBD007009EBF007008EBF0")  # activity.bin.md: three samples
SAMPLES = np.array([[8, 6, -323], [9, 7, -321], [8, 7, -321]]) / 341.0  # x, y, z


def test_a_gt3x_of_the_old_layout_leaves_its_idle_samples_out_and_says_so():
    read = read_counted(data_path("makers", "actigraph_gt3x", "sample.gt3x"))
    record, size = read.record, np.linalg.norm(read.record.accel, axis=1)
    assert (record.device, record.accel_unit, record.sample_rate_hz) == ("NEO1B34100019", "g", pytest.approx(30.0))
    assert len(record) == 2536
    assert np.median(size) == pytest.approx(1.032, abs=0.0005)
    assert (size[:300].mean(), size[:300].std()) == pytest.approx((1.020, 0.007), abs=0.0005)
    assert read.notes == (
        "time 0 is 2010-10-26 13:30:00 by the logger's clock (local time, no zone)",
        "7931 of 10467 samples left out: exactly 0, 0, 0 for a second or more (no data)",
    )


def gt3x(path, name, content, *, serial="NEO1", rate="30"):
    with zipfile.ZipFile(path, "w") as held:
        held.writestr("info.txt", f"Serial Number: {serial}\r\nSample Rate: {rate}\r\n")
        held.writestr(name, content)
    return path


def entry(kind, payload, when=1_000):
    body = struct.pack("<BBIH", 0x1E, kind, when, len(payload)) + payload
    return body + bytes([0xFF ^ int(np.bitwise_xor.reduce(np.frombuffer(body, np.uint8)))])


def ssp(value):
    power = int(np.floor(np.log2(abs(value)))) + 1
    return (power & 0xFF) << 24 | int(value / 2.0**power * 8388608) & 0xFFFFFF


PARAMETERS = entry(21, struct.pack("<HHIHHI", 0, 55, ssp(128.0), 0, 58, ssp(20.5)) + b"\1\0")


def test_the_example_of_the_makers_document_reads_as_printed(tmp_path):
    path = gt3x(tmp_path / "a.gt3x", "activity.bin", EXAMPLE)
    assert detect(path) == "gt3x"
    np.testing.assert_allclose(read_record(path).accel, SAMPLES, rtol=1e-15)


@pytest.mark.parametrize("words", [b"", b"2010-10-26 13:30 started\r\n"])
def test_a_log_without_records_beside_activity_is_passed_over(tmp_path, words):
    path = gt3x(tmp_path / "a.gt3x", "activity.bin", EXAMPLE)
    with zipfile.ZipFile(path, "a") as held:
        held.writestr("log.txt", words)
    np.testing.assert_allclose(read_record(path).accel, SAMPLES, rtol=1e-15)


def test_records_of_a_second_each_keep_their_second_and_the_stated_scale(tmp_path):
    shorts = np.array([[0, 128, 0], [0, 0, -256]], dtype="<i2").tobytes()
    log = entry(6, b"{}") + entry(0, EXAMPLE, 1_000) + b"\0\0" + entry(26, shorts, 1_005) + entry(26, b"\1", 1_006)
    record = read_record(gt3x(tmp_path / "a.gt3x", "log.bin", PARAMETERS + log))
    assert record.time == pytest.approx([0, 1 / 3, 2 / 3, 5, 5.5])
    np.testing.assert_allclose(record.accel[:3], SAMPLES * 341 / 128)
    assert record.accel[3:].tolist() == [[0, 1, 0], [0, 0, -2]]
    mos = read_record(gt3x(tmp_path / "b.gt3x", "log.bin", entry(26, shorts), serial="MOS2"))
    assert mos.accel[0, 1] == 0.5  # 256 counts/g
    with pytest.raises(FileFormatError, match=r"wanted ACCEL_SCALE or a serial number NEO, CLE or MOS, got 'TAS1'"):
        read_record(gt3x(tmp_path / "c.gt3x", "log.bin", log, serial="TAS1"))


def schema(columns, samples=2):
    body = struct.pack("<HHH", 3, len(columns), samples)
    return entry(
        24, body + b"".join(struct.pack("<BBBI16s", f, 0, b, ssp(s), n.ljust(16).encode()) for f, b, s, n in columns)
    )


IMU = [
    *((2, 16, 2048.0, f"Accelerometer {a}") for a in "XYZ"),
    (2, 16, 333.87, "Temperature"),
    *((3, 16, 16.384, f"Gyroscope {a}") for a in "XYZ"),
    *((2, 16, 6.827, f"Magnetometer {a}") for a in "XYZ"),
]


def test_the_imu_of_a_link_is_read_by_its_schema_and_its_temperature_by_the_stated_offset(tmp_path):
    row = struct.pack("<hhhh", 0, 2048, -1024, 334) + struct.pack(">hhh", 164, -328, 0) + struct.pack("<hhh", 68, 0, 0)
    log = PARAMETERS + schema(IMU) + entry(25, struct.pack("<H", 3) + 2 * row)
    path = gt3x(tmp_path / "a.gt3x", "log.bin", log, serial="TAS1")
    record = read_record(path)
    assert (record.accel_unit, record.gyro_unit, record.time.tolist()) == ("g", "dps", [0.0, 0.5])
    assert record.accel[0].tolist() == [0.0, 1.0, -0.5]
    assert record.gyro[0] == pytest.approx([164 / 16.384, -328 / 16.384, 0.0], rel=1e-6)
    assert record.temp_c[0] == pytest.approx(20.5 + 334 / 333.87, rel=1e-6)
    assert record.mag_ut[0, 0] == pytest.approx(68 / 6.827, rel=1e-6)
    both = gt3x(tmp_path / "b.gt3x", "log.bin", log + entry(0, EXAMPLE))
    with pytest.raises(
        InputError, match=r"wanted the name of one sensor, got a file with accelerometer, imu; name one"
    ):
        read_record(both)
    assert read_record(both, settings=ReadSettings(sensor="accelerometer")).gyro is None
    assert read_record(both, settings=ReadSettings(sensor="imu")).gyro is not None


@pytest.mark.parametrize(
    ("log", "words"),
    [
        (entry(0, EXAMPLE)[:-4], "wanted whole records in the log, got a damaged one at byte 0"),
        (entry(0, EXAMPLE) + b"\x1e\1", "got a damaged one at byte 23"),
        (entry(0, EXAMPLE)[:-1] + b"\0", "got a damaged one at byte 0"),
        (entry(25, b"\3\0" + b"\0" * 40), "wanted a schema of the IMU's records, got none"),
        (schema(IMU) + entry(25, b"\3\0" + b"\0" * 20), "wanted IMU records as their schema states, got others"),
        (
            schema([(2, 24, 1.0, "Gyroscope X")]) + entry(25, b"\3\0" + b"\0" * 20),
            "wanted IMU records as their schema states",
        ),
        (schema(IMU) + entry(25, b"\4\0" + b"\0" * 40), "wanted IMU records as their schema states"),
        (entry(6, b"{}"), "wanted a sensor with readings, got none; the file holds no recording"),
    ],
)
def test_a_damaged_log_is_refused(tmp_path, log, words):
    with pytest.raises(FileFormatError, match=words):
        read_record(gt3x(tmp_path / "a.gt3x", "log.bin", log))


def test_a_gt3x_without_readings_or_rate_is_refused(tmp_path):
    with pytest.raises(FileFormatError, match=r"wanted activity.bin or log.bin and a Sample Rate, got none"):
        read_record(gt3x(tmp_path / "a.gt3x", "lux.bin", b"1"))
    with pytest.raises(FileFormatError, match=r"wanted activity.bin or log.bin and a Sample Rate, got none"):
        read_record(gt3x(tmp_path / "b.gt3x", "activity.bin", EXAMPLE, rate=""))
    content = bytearray(data_path("makers", "actigraph_gt3x", "sample.gt3x").read_bytes())
    content[200:220] = b"\x55" * 20
    (tmp_path / "c.gt3x").write_bytes(content)
    with pytest.raises(FileFormatError, match=r"wanted a sound .gt3x file, got a damaged or cut one"):
        read_record(tmp_path / "c.gt3x")


@pytest.mark.parametrize(
    "name",
    [
        "makers/axivity_cwa/ax3_testfile.cwa",
        "makers/geneactiv_bin/gnactv_sample.bin",
        "makers/actigraph_gt3x/sample.gt3x",
    ],
)
@pytest.mark.parametrize("part", [0.3, 0.9])
def test_a_cut_or_overwritten_file_of_a_logger_ends_in_one_line(tmp_path, name, part):
    whole = data_path(*name.split("/")).read_bytes()
    cut = int(part * len(whole))
    noise = np.random.default_rng(1).bytes(len(whole) - 600)
    for content in (whole[:cut], whole[:600] + noise):
        (tmp_path / name.split("/")[-1]).write_bytes(content)
        with pytest.raises(FileFormatError, match=r"wanted .*, got .*; .*copy"):
            read_record(tmp_path / name.split("/")[-1])
