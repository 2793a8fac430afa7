"""A parser that crashes, hangs or takes all memory ends as one line; what it reads comes back bit by bit."""

import ctypes
import gzip
import os
import time
import zipfile
from contextvars import copy_context

import numpy as np
import pytest

import undrift
from testkit.data import data_path
from undrift.errors import FileFormatError, InputError
from undrift.files import LIMITS, WATCH, read_bytes, read_so_far
from undrift.io import box
from undrift.io.box import boxed, boxed_parts, one_box
from undrift.io.columns import ReadSettings
from undrift.io.formats import read_counted, read_markers, read_record
from undrift.io.inspect import describe
from undrift.io.session import read_map
from undrift.io.store import read_calibration

needs_fork = pytest.mark.skipif(not hasattr(os, "fork"), reason="this system cannot fork: files are read without a box")


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "file.bin"
    path.write_bytes(b"content")
    return path


@pytest.fixture
def limits(monkeypatch):
    for name in ("memory_gb", "trust", "start_s", "megabyte_s"):
        monkeypatch.setattr(LIMITS, name, getattr(LIMITS, name))
    return LIMITS


@boxed()
def crash(path):
    ctypes.string_at(0)


@boxed()
def leave(path):
    os._exit(3)


@boxed()
def swell(path):
    return np.ones(8 * 10**7).sum()


@boxed()
def hang(path):
    while True:
        pass


@boxed()
def fail(path, error):
    raise error


@boxed()
def whose(path):
    return os.getpid()


@boxed()
def busy(path, seconds):
    start = time.process_time()
    while time.process_time() - start < seconds:
        pass
    return os.getpid()


@boxed()
def crash_beside(path, process):
    if os.getpid() == process:
        ctypes.string_at(0)
    return np.arange(3.0)


@boxed()
def swell_beside(path, process):
    return np.ones(10**8 if os.getpid() == process else 10).sum()


@boxed_parts()
def arrays(path, sizes):
    for size in sizes:
        yield {"pid": os.getpid(), "array": np.arange(float(size)), "text": path.read_text()}


@needs_fork
def test_a_crash_is_one_line(file):
    with pytest.raises(FileFormatError, match=r"file.bin: wanted .* makes its parser crash \(SIGSEGV\); copy it again"):
        crash(file)
    with pytest.raises(FileFormatError, match=r"crash \(exit 3\)"):
        leave(file)


@pytest.mark.slow
@needs_fork
def test_too_much_memory_is_one_line_and_the_setting_raises_it(file, limits):
    limits.memory_gb = 0.5
    with pytest.raises(
        FileFormatError, match=r"within 0.5 GB of memory, got one that takes more.*`memory_limit_gb` 1$"
    ):
        swell(file)
    limits.memory_gb = 4.0
    assert swell(file) == 8e7


@pytest.mark.slow
@needs_fork
def test_a_parser_without_end_is_stopped(file, limits):
    limits.start_s = 1.0
    start = time.process_time()
    with pytest.raises(FileFormatError, match="does not come to an end"):
        hang(file)
    assert time.process_time() - start < 1.0  # waiting costs the caller nothing


def test_errors_come_back_as_they_were_and_unforeseen_ones_as_a_damaged_file(file, monkeypatch):
    monkeypatch.delenv("UNDRIFT_TRACEBACK", raising=False)
    with pytest.raises(InputError) as caught:
        fail(file, InputError("wanted this, got that", names=("a", "b")))
    assert str(caught.value) == "wanted this, got that"
    assert caught.value.names == ("a", "b")
    with pytest.raises(FileFormatError, match=r"file.bin: wanted a sound file, got a damaged one \(KeyError: 'x'\)"):
        fail(file, KeyError("x"))


@needs_fork
def test_arrays_come_in_parts_from_another_process_and_it_ends_with_the_caller(file):
    found = list(arrays(file, (3, 0, 10**6)))
    assert [len(part["array"]) for part in found] == [3, 0, 10**6]
    assert all(np.array_equal(part["array"], np.arange(float(len(part["array"])))) for part in found)
    child = found[0]["pid"]
    assert child != os.getpid()
    assert found[0]["text"] == "content"
    with pytest.raises(ProcessLookupError):
        os.kill(child, 0)
    parts = arrays(file, [1] * 10**6)
    child = next(parts)["pid"]
    os.kill(child, 0)
    parts.close()
    with pytest.raises(ProcessLookupError):
        os.kill(child, 0)


@boxed()
def by_thirds(path):
    for third in range(1, 4):
        read_so_far(path, third / 3)
    return os.getpid()


@needs_fork
def test_how_far_a_box_has_read_is_heard_outside(file):
    heard = []

    def read():
        WATCH.set(lambda path, share: heard.append((os.getpid(), path, share)))
        with one_box():
            return [by_thirds(file), by_thirds(file)]

    read_by = copy_context().run(read)
    assert os.getpid() not in read_by
    assert heard == [(os.getpid(), file, third / 3) for third in (1, 2, 3)] * 2


@needs_fork
def test_one_box_reads_file_after_file_and_ends_with_its_block(file):
    with one_box():
        first = whose(file)
        assert [whose(file), *(part["pid"] != first for part in arrays(file, (1, 2)))] == [first, True, True]
        with one_box():
            assert whose(file) == first
        with pytest.raises(InputError, match=r"^wanted this$"):
            fail(file, InputError("wanted this"))
        assert whose(file) == first
        os.kill(first, 0)
    assert first != os.getpid()
    with pytest.raises(ProcessLookupError):
        os.kill(first, 0)
    assert whose(file) != whose(file)


@pytest.mark.slow
@needs_fork
def test_one_box_keeps_the_limits_of_each_file_and_names_the_one_that_breaks_them(tmp_path, limits):
    limits.start_s, limits.memory_gb = 1.0, 0.5
    files = [tmp_path / f"{name}.bin" for name in ("sound", "crash", "leave", "swell", "hang")]
    for file in files:
        file.write_bytes(b"content")
    with one_box():
        for reader, file, text in zip(
            (crash, leave, swell, hang),
            files[1:],
            ("crash (SIGSEGV)", "crash (exit 3)", "within 0.5 GB of memory", "does not come to an end"),
            strict=True,
        ):
            assert whose(files[0]) == whose(files[0])
            with pytest.raises(FileFormatError) as caught:
                reader(file)
            assert str(caught.value).startswith(f"{file}: wanted ")
            assert text in str(caught.value)


@needs_fork
def test_a_file_that_fails_beside_others_is_read_again_in_a_box_of_its_own(file, limits):
    limits.memory_gb = 0.1
    with one_box():
        first = whose(file)
        assert crash_beside(file, first).tolist() == [0.0, 1.0, 2.0]
        second = whose(file)
        assert second != first
        assert swell_beside(file, second) == 10.0


@pytest.mark.slow
@needs_fork
def test_the_time_of_one_box_is_that_of_each_file(file, limits):
    limits.start_s = 1.0
    with one_box():
        first = whose(file)
        assert [busy(file, 0.4) for _ in range(4)] == [first] * 4


@needs_fork
def test_a_session_is_read_in_one_box_and_a_damaged_recording_is_named(tmp_path, monkeypatch, capsys):
    from undrift.cli.app import run

    record = undrift.Record(time=np.arange(99) / 10.0, gyro=np.zeros((99, 3)), gyro_unit="dps")
    session = undrift.Session(kind="static", serial="A", gravity_m_s2=9.81, records=(record,) * 6)
    undrift.write_session(session, tmp_path)
    forks, fork = [], os.fork
    monkeypatch.setattr(os, "fork", lambda: forks.append(1) or fork())
    read = undrift.read_session(tmp_path)
    assert len(forks) == 1
    assert all(np.array_equal(other.time, record.time) for other in read.records)
    damaged = tmp_path / "recording_3.parquet"
    damaged.write_bytes(damaged.read_bytes()[:-40])
    assert run(["info", str(tmp_path)]) == 2
    assert str(damaged) in (line := capsys.readouterr().err)
    assert line.count("\n") == 1


def test_trusted_files_are_read_in_the_callers_process(file, limits):
    limits.trust = True
    assert next(arrays(file, (1,)))["pid"] == os.getpid()


def test_a_packed_file_that_swells_is_refused(tmp_path, limits):
    path = tmp_path / "zeros.csv.gz"
    with gzip.open(path, "wb", compresslevel=1) as packed:
        for _ in range(120):
            packed.write(bytes(10**6))
    with pytest.raises(FileFormatError, match="more than 200 times its size"):
        read_bytes(path)
    assert read_bytes(path, 10) == bytes(10)
    limits.memory_gb = 0.05
    with pytest.raises(FileFormatError, match=r"`memory_limit_gb` 0\.1$"):
        read_bytes(path)
    limits.trust = True
    assert len(read_bytes(path)) == 120 * 10**6


@needs_fork
def test_a_large_table_of_text_with_a_bad_row_is_read_in_a_box_and_bit_by_bit(tmp_path, limits, monkeypatch):
    head = "time_s,gyro_x_dps,gyro_y_dps,gyro_z_dps\n"
    path, settings = tmp_path / "r.csv", ReadSettings(drop_bad_rows=True)
    path.write_text(head + "".join(f"{k / 100},{k / 7},2,3\n" for k in range(2000)) + "20,1,2\n")
    made = []
    monkeypatch.setattr(box, "_Box", lambda *given, kind=box._Box: made.append(given) or kind(*given))
    small = read_counted(path, settings=settings)
    assert not made
    limits.memory_gb = 31.9 * path.stat().st_size / 1e9
    monkeypatch.setattr(box, "_set_limits", lambda *given: None)
    large = read_counted(path, settings=settings)
    assert len(made) == 1
    assert small.dropped_rows == large.dropped_rows == 1
    assert np.array_equal(small.record.gyro, large.record.gyro)
    assert np.array_equal(small.record.time, large.record.time)


def test_a_table_of_text_that_takes_more_memory_than_it_may_is_refused(tmp_path, limits):
    path = tmp_path / "r.csv"
    path.write_text("time_s,gyro_x_dps,gyro_y_dps,gyro_z_dps\n" + "".join(f"{k},1,2,3\n" for k in range(10_000)))
    limits.memory_gb = (
        32e4 / 1e9
    )  # of four columns of 8 bytes, and less than half of what any text of this size might take
    assert len(read_record(path)) == 10_000
    limits.memory_gb = 31e4 / 1e9
    with pytest.raises(FileFormatError, match=r"r.csv: wanted a file that reads within 0.00031 GB of memory"):
        read_record(path)
    limits.trust = True
    assert len(read_record(path)) == 10_000


@pytest.mark.parametrize(
    ("name", "start", "read"),
    [("a.json", "[", describe), ("a.toml", "a = [", read_map), ("calibration.json", "[", read_calibration)],
)
def test_json_and_toml_that_might_take_too_much_memory_are_refused(tmp_path, limits, name, start, read):
    (tmp_path / name).write_text(start + "[], " * 30_000 + "[]]")
    limits.memory_gb = 0.001
    with pytest.raises(FileFormatError, match=rf"{name}: wanted a file that reads within 0.001 GB of memory"):
        read(tmp_path / name)


def test_a_file_larger_than_the_memory_is_not_begun(tmp_path, limits):
    (tmp_path / "a.txt").write_bytes(bytes(2000))
    limits.memory_gb = 1e-6
    with pytest.raises(FileFormatError, match="wanted a file that reads within 1e-06 GB of memory"):
        read_bytes(tmp_path / "a.txt")
    limits.trust = True
    assert len(read_bytes(tmp_path / "a.txt")) == 2000


@pytest.mark.slow
@needs_fork
def test_a_zip_that_swells_is_refused(tmp_path, limits):
    path = tmp_path / "bomb.npz"
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as packed,
        packed.open("gyro.npy", "w", force_zip64=True) as held,
    ):
        np.lib.format.write_array_header_1_0(held, {"descr": "<f8", "fortran_order": False, "shape": (5 * 10**7, 3)})
        for _ in range(120):
            held.write(bytes(10**7))
    limits.memory_gb = 0.5
    with pytest.raises(FileFormatError, match=r"bomb\.npz"):
        read_record(path)


@needs_fork
def test_a_marker_file_that_crashes_its_library_is_refused(tmp_path):
    content = bytearray(data_path("c3d", "dec_int.c3d").read_bytes())
    for at, value in ((537, 255), (1864, 0), (2324, 51), (3755, 129)):
        content[at] = value
    path = tmp_path / "damaged.c3d"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"damaged.c3d: .* makes its parser crash \(SIG"):
        read_markers(path, up="z")


def test_the_command_line_sets_the_limits_and_refuses_a_word(tmp_path, limits, capsys):
    from undrift.cli.app import run

    path = tmp_path / "r.parquet"
    undrift.write_record(undrift.Record(time=np.arange(9) / 10.0, gyro=np.zeros((9, 3)), gyro_unit="dps"), path)
    assert run(["info", str(path), "--memory-limit-gb", "3", "--trust"]) == 0
    assert (limits.memory_gb, limits.trust) == (3.0, True)
    assert run(["info", str(path), "--memory-limit-gb=1.5"]) == 0
    assert (limits.memory_gb, limits.trust) == (1.5, False)
    capsys.readouterr()
    assert run(["info", str(path), "--memory-limit-gb", "many"]) == 2
    assert capsys.readouterr().err == (
        "undrift: --memory-limit-gb: wanted gigabytes above 0, got 'many'; write it as --memory-limit-gb 4\n"
    )


@pytest.mark.parametrize("place", ["os:system", "undrift.files:write_whole", "undrift.errors:InputError"])
def test_a_child_can_name_no_other_value_than_data_of_undrift(place):
    with pytest.raises(FileFormatError, match=f"wanted a value of undrift, got {place}; copy the file again"):
        box._value({"value": place, "fields": {}}, [])
