"""TRC: points come back in z-up metres, gaps as NaN, whatever the header's tabs look like."""

import gzip

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from testkit.strategies import few, numbers, one_line
from testkit.trc_text import trc
from undrift.errors import InputError
from undrift.io.inspect import describe
from undrift.io.mocap import read_trc


@few
@given(points=st.integers(2, 12).flatmap(lambda n: numbers((n, 4, 3), size=5.0, gaps=True)), tabs=st.integers(1, 3))
def test_points_come_back_whatever_the_tabs(tmp_path_factory, points, tabs):
    path = tmp_path_factory.mktemp("trc") / "m.trc"
    path.write_text(trc(points, ("A", "B", "C", "D"), tabs=tabs))
    found = read_trc(path, up="z")
    lost = np.isnan(points).any(axis=2) | (points == 0.0).all(axis=2)
    np.testing.assert_array_equal(found.points, np.where(lost[..., None], np.nan, points))
    assert found.labels == ("A", "B", "C", "D")
    assert found.sample_rate_hz == pytest.approx(100.0)


def test_millimetres_and_y_up_become_metres_and_z_up(tmp_path):
    (tmp_path / "m.trc.gz").write_bytes(
        gzip.compress(trc(np.tile([1000.0, 2000.0, 3000.0], (3, 2, 1)), ("A", "A"), unit="mm").encode())
    )
    found = read_trc(tmp_path / "m.trc.gz", up="y")
    np.testing.assert_allclose(found.points[0, 0], [1.0, -3.0, 2.0])
    assert found.labels == ("A", "A#2")


def test_a_row_that_ends_early_is_a_gap(tmp_path):
    lines = trc(np.ones((4, 2, 3)), ("A", "B")).splitlines()
    lines[7] = "\t".join(lines[7].split("\t")[:5])
    (tmp_path / "m.trc").write_text("\n".join(lines))
    found = read_trc(tmp_path / "m.trc", up="z")
    assert np.isnan(found.points[1, 1]).all()
    assert np.isfinite(found.points[1, 0]).all()
    assert found.short_rows == 1
    (finding,) = describe(tmp_path / "m.trc").findings[1:]
    assert (finding.code, finding.values["count"]) == ("recording.rows_left_out", 1)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t: t.replace("PathFileType", "Something"), "expected a TRC file .first word PathFileType."),
        (lambda t: t.replace("NumMarkers", "Number"), "DataRate, NumMarkers, Units in lines 2 and"),
        (lambda t: t.replace("\t3\t2\tm", "\t3\t7\tm"), "7 marker labels in line 4"),
        (lambda t: t.replace("\t3\t2\tm", "\t3\tmany\tm"), "expected NumMarkers of 1 or more in line 3, got 'many'"),
        (lambda t: t.replace("\tm\t", "\tfurlong\t"), "unit of length:"),
        (lambda t: t.replace("0.01\t1.0", "0.01\tlost"), "expected numbers in line 8, got text"),
        (
            lambda t: t.replace("0.01\t1.0", "0.01\t1.0\t1.0"),
            "expected 8 columns in line 8, got 9",
        ),
        (lambda t: t.replace("\t0.01\t", "\t0.0\t"), "strictly increasing seconds"),
        (
            lambda t: "\n".join(t.splitlines()[:7]),
            "expected 3 frames .NumFrames in line 3., got 1. The file is truncated",
        ),
    ],
)
def test_a_file_that_is_not_what_it_says_is_refused_in_one_line(tmp_path, change, words):
    (tmp_path / "m.trc").write_text(change(trc(np.ones((3, 2, 3)), ("A", "B"))))
    with pytest.raises(InputError, match=words) as caught:
        read_trc(tmp_path / "m.trc", up="z")
    one_line(caught)
