"""C3D: points come back, gaps as NaN; cut files never reach the parser."""

import ezc3d
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from testkit.data import data_path
from testkit.strategies import few, one_line
from undrift.errors import FileFormatError, InputError
from undrift.io.mocap import is_c3d, read_c3d


def write(path, points, labels, *, rate=100.0, unit="mm", screen="+Z"):
    """Points (N, M, 3) as C3D; NaN rows become points that were not seen."""
    made = ezc3d.c3d()
    made["parameters"]["POINT"]["RATE"]["value"] = [rate]
    made["parameters"]["POINT"]["LABELS"]["value"] = list(labels)
    made["parameters"]["POINT"]["UNITS"]["value"] = [unit]
    if screen:
        made.add_parameter("POINT", "Y_SCREEN", [screen])
    n, m = points.shape[:2]
    xyz1 = np.ones((4, m, n))
    xyz1[:3] = np.moveaxis(points, 2, 0).transpose(0, 2, 1)
    made["data"]["points"] = xyz1
    made.write(str(path))


@pytest.mark.slow
@few
@given(seed=st.integers(0, 9999), n=st.integers(2, 30), lost=st.floats(0.0, 0.5))
def test_points_come_back_with_their_gaps(tmp_path_factory, seed, n, lost):
    rng = np.random.default_rng(seed)
    points = rng.uniform(-2000, 2000, size=(n, 3, 3))
    points[rng.random((n, 3)) < lost] = np.nan
    path = tmp_path_factory.mktemp("c3d") / "m.c3d"
    write(path, points, ("A", "B", "A"))
    found = read_c3d(path)
    # the file stores single precision
    np.testing.assert_allclose(found.points, points / 1000, rtol=1e-6)
    assert found.labels == ("A", "B", "A#2")
    assert found.sample_rate_hz == pytest.approx(100.0)


def test_the_axis_that_points_up_comes_from_the_file_or_from_the_caller(tmp_path):
    points = np.tile([1.0, 2.0, 3.0], (3, 1, 1))
    for screen, up, wanted in (
        ("+Z", None, [1, 2, 3]),
        ("+Y", None, [1, -3, 2]),
        ("", "y", [1, -3, 2]),
        ("+Z", "y", [1, -3, 2]),
    ):
        write(tmp_path / "m.c3d", points, ("A",), unit="m", screen=screen)
        np.testing.assert_allclose(read_c3d(tmp_path / "m.c3d", up=up).points[0, 0], wanted)
    write(tmp_path / "m.c3d", points, ("A",), screen="")
    with pytest.raises(InputError, match=r"expected the axis that points up, got none. POINT:Y_SCREEN does not"):
        read_c3d(tmp_path / "m.c3d")


def test_a_file_longer_than_its_header_promises_is_refused(tmp_path):
    path = tmp_path / "m.c3d"
    write(path, np.arange(60.0).reshape(5, 4, 3), ("A", "B", "C", "D"))
    whole = path.read_bytes()
    for count in (1, 511, 512):  # bytes that came in among the points shift all that follow
        path.write_bytes(whole[:-300] + bytes(count) + whole[-300:])
        with pytest.raises(FileFormatError, match=r"bytes as its header promises, got \d+"):
            read_c3d(path)


def test_points_farther_than_a_laboratory_and_parameters_against_the_header_are_refused(tmp_path):
    path = tmp_path / "m.c3d"
    write(path, np.full((5, 3, 3), 2e6), ("A", "B", "C"))
    with pytest.raises(FileFormatError, match=r"expected positions up to 1e\+06, got 2e\+06. The file is damaged"):
        read_c3d(path)
    content = bytearray(data_path("c3d", "dec_int.c3d").read_bytes())
    content[5632:5774] = bytes(142)  # the end of its parameters: ANALOG:USED
    path.write_bytes(content)
    with pytest.raises(FileFormatError, match="64 analog values per frame"):
        read_c3d(path, up="z")


def test_cut_empty_and_foreign_files_are_refused(tmp_path):
    path = tmp_path / "m.c3d"
    write(path, np.ones((200, 3, 3)), ("A", "B", "C"))
    whole = path.read_bytes()
    for keep, words in (
        (len(whole) // 2, "bytes as its header promises"),
        (600, "promises, got 600"),
        (514, "truncated before its parameters"),
    ):
        path.write_bytes(whole[:keep])
        with pytest.raises(FileFormatError, match=words) as caught:
            read_c3d(path)
        one_line(caught)
    path.write_text("Frame,X,Y,Z\n" * 100)
    with pytest.raises(FileFormatError, match="expected a C3D file, got other content"):
        read_c3d(path)
    assert not is_c3d(b"\x02\x50")
    damaged = bytearray(whole)
    damaged[512:1024] = b"\xff" * 512
    path.write_bytes(damaged)
    with pytest.raises(InputError):
        read_c3d(path)
