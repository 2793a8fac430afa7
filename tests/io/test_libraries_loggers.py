"""Axivity, GENEActiv and ActiGraph binaries: the makers' example files and figures, and a log after the maker's document."""

import struct
import zipfile

import numpy as np
import pytest

from testkit.data import data_path
from undrift.errors import FileFormatError
from undrift.io.column_map import ColumnMap
from undrift.io.formats import detect, read_counted, read_record

WHOLE = ColumnMap(drop_bad_rows=True)


def at_rest(accel, values, size=200):
    """Return the mean over the `size` samples in a row in which the accelerometer varies least."""
    spread = [accel[k : k + size].std(axis=0).sum() for k in range(0, len(accel) - size, size // 4)]
    start = int(np.argmin(spread)) * (size // 4)
    return values[start : start + size].mean(axis=0)


# ---- Axivity: figures of makers/axivity_cwa/SOURCE.md


def test_an_ax3_reads_its_17400_samples():
    read = read_counted(data_path("makers", "axivity_cwa", "ax3_testfile.cwa"))
    record = read.record
    assert (len(record), record.device, record.accel_unit, record.gyro) == (17400, "AX3 39434", "g", None)
    assert (len(record) - 1) / record.duration_s == pytest.approx(98.87, abs=0.02)  # effective; SOURCE rounds the ends
    assert np.linalg.norm(at_rest(record.accel, record.accel)) == pytest.approx(0.988, abs=0.001)
    assert (record.temp_c.min(), record.temp_c.max()) == pytest.approx((25.59, 26.46), abs=0.005)
    assert np.diff(record.time).max() < 0.0103  # no gap
    assert read.notes[0].startswith("time 0 is 2019-02-26T10:55:06.000 by the logger's clock")


def test_an_ax6_reads_its_gyroscope_too():
    record = read_record(data_path("wearable_formats", "ggirread_ax6_testfile.cwa"))
    assert (len(record), record.device, record.gyro_unit) == (11320, "AX6 6011834", "dps")  # 91 * 65536 + 48058
    assert (len(record) - 1) / record.duration_s == pytest.approx(99.04, abs=0.02)
    assert at_rest(record.accel, record.gyro) == pytest.approx(
        (-0.07, 1.08, 0.11), abs=0.05
    )  # SOURCE does not say which seconds
    assert np.linalg.norm(at_rest(record.accel, record.accel)) == pytest.approx(1.0106, abs=0.01)
    assert (record.temp_c.min(), record.temp_c.max()) == pytest.approx((27.05, 28.22), abs=0.005)


def test_a_cut_cwa_file_is_refused_or_read_to_its_last_whole_sector(tmp_path):
    whole = data_path("makers", "axivity_cwa", "ax3_testfile.cwa").read_bytes()
    (tmp_path / "a.cwa").write_bytes(whole[: 1024 + 512 * 10 + 100])
    with pytest.raises(FileFormatError, match="ends within a sector"):
        read_record(tmp_path / "a.cwa")
    assert len(read_record(tmp_path / "a.cwa", WHOLE)) == 1200


# ---- GENEActiv: figures of makers/geneactiv_bin/SOURCE.md


def test_a_geneactiv_reads_its_900_samples():
    record = read_record(data_path("makers", "geneactiv_bin", "gnactv_sample.bin"))
    assert (len(record), record.device, record.accel_unit) == (900, "GENEActiv 051386", "g")
    assert record.sample_rate_hz == pytest.approx(50.0)
    np.testing.assert_allclose(np.diff(record.time), 0.02, rtol=1e-6)
    assert np.median(np.linalg.norm(record.accel, axis=1)) == pytest.approx(1.003, abs=0.0005)
    assert (record.temp_c.min(), record.temp_c.max()) == pytest.approx((28.1, 29.1), abs=1e-4)
    # the first words of the first page, F22 027 00B, by the header's gains and offsets
    assert record.accel[0] == pytest.approx(
        [(-222 * 100 - 272) / 25522, (39 * 100 + 1129) / 25457, (11 * 100 - 101) / 24829], rel=1e-5
    )


def test_a_cut_geneactiv_file_is_refused_or_read_as_far_as_it_goes():
    path = data_path("makers", "geneactiv_bin", "GENEActiv_testfile.bin")
    with pytest.raises(FileFormatError, match="222048 pages are missing"):
        read_record(path)
    record = read_record(path, WHOLE)
    assert len(record) >= 4800
    assert record.sample_rate_hz == pytest.approx(85.7, rel=1e-3)


# ---- ActiGraph: records after the maker's documents

EXAMPLE = bytes.fromhex("006008EBD007009EBF007008EBF0")  # activity.bin.md: three samples
SAMPLES = np.array([[8, 6, -323], [9, 7, -321], [8, 7, -321]]) / 341.0  # x, y, z


SCALE = 9 << 24 | 341 << 14  # ACCEL_SCALE: 341/512 of 2^9 counts/g, a fraction of 24 bits and an exponent of 8


def entry(kind, payload, when=1_000):
    body = struct.pack("<BBIH", 0x1E, kind, when, len(payload)) + payload
    return body + bytes([0xFF ^ int(np.bitwise_xor.reduce(np.frombuffer(body, np.uint8)))])


def test_the_log_of_a_gt3x_reads_its_accelerometer(tmp_path):
    path = tmp_path / "a.gt3x"
    with zipfile.ZipFile(path, "w") as held:
        held.writestr("info.txt", "Serial Number: NEO1\r\nSample Rate: 30\r\n")
        scale = entry(21, struct.pack("<HHI", 0, 55, SCALE))
        held.writestr("log.bin", scale + entry(0, EXAMPLE))
    assert detect(path) == "gt3x"
    record = read_record(path)
    assert record.device.endswith("NEO1")
    np.testing.assert_allclose(record.accel, SAMPLES, atol=2e-3)  # actfast rounds to 0.001 g
