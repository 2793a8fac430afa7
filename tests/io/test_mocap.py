"""C3D: points come back, gaps as NaN; cut files never reach the parser."""

import gzip

import ezc3d
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from testkit.data import data_path
from testkit.strategies import few, numbers, one_line
from testkit.trc_text import trc
from undrift.errors import FileFormatError, InputError
from undrift.io.inspect import describe
from undrift.io.mocap import Markers, fit_cluster, is_c3d, level_from, pose_from_cluster, read_c3d, read_trc


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
        with pytest.raises(FileFormatError, match=r"bytes according to its header, got \d+"):
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
        (len(whole) // 2, "bytes according to its header"),
        (600, "header, got 600"),
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


# ---- a rigid cluster gives back the pose that made it; gaps stay gaps; a line of markers is refused

SHAPE = np.array([[0.0, 0.0, 0.0], [0.12, 0.0, 0.01], [0.03, 0.09, -0.02], [-0.05, 0.04, 0.06]])
LABELS = ("A", "B", "C", "D")


def moving(n=50, seed=0, noise=0.0, shape=SHAPE):
    """A body that tumbles and travels: markers, true rotations and the true path of the centroid."""
    rng = np.random.default_rng(seed)
    turn = Rotation.from_rotvec(np.cumsum(rng.normal(size=(n, 3)) * 0.2, axis=0))
    path = np.cumsum(rng.normal(size=(n, 3)) * 0.01, axis=0)
    centred = shape - shape.mean(axis=0)
    points = np.stack([turn.apply(c) for c in centred], axis=1) + path[:, None]
    points += rng.normal(size=points.shape) * noise
    labels = tuple("ABCDEFG"[: len(shape)])
    return Markers(labels=labels, time=np.arange(n) / 100, points=points), turn, path


def turn_error(reference, turn):
    """Angle in rad between the pose and the truth, both taken from the first frame."""
    seen = reference.valid
    got = Rotation.from_quat(reference.q_nb[seen], scalar_first=True)
    true = turn[np.flatnonzero(seen)]
    return (got * (true * true[0].inv() * got[0]).inv()).magnitude()


@few
@given(seed=st.integers(0, 10_000))
def test_without_noise_the_pose_comes_back_exactly(seed):
    markers, turn, path = moving(seed=seed)
    found = fit_cluster(markers, LABELS)
    # 1e-7 rad: quaternions from matrices lose half of the digits near the identity
    assert turn_error(found.reference, turn).max() < 1e-7
    np.testing.assert_allclose(found.reference.position, path, atol=1e-12)
    assert found.rms < 1e-12
    np.testing.assert_allclose(found.reference.q_nb[0], [1, 0, 0, 0], atol=1e-9)


def test_noise_moves_the_pose_as_much_as_theory_says_and_shows_in_the_residual():
    sigma = 2e-4
    markers, turn, _ = moving(n=4000, noise=sigma)
    found = fit_cluster(markers, LABELS)
    centred = SHAPE - SHAPE.mean(axis=0)
    inertia = np.trace(centred.T @ centred) * np.eye(3) - centred.T @ centred
    # least squares: covariance of the small rotation is sigma^2 times the inverse of the cluster's inertia; the first
    # frame's own error adds a constant, so the spread about the mean is compared
    got = Rotation.from_quat(found.reference.q_nb, scalar_first=True)
    error = (turn.inv() * got).mean().inv() * (turn.inv() * got)
    expected = sigma * np.sqrt(np.trace(np.linalg.inv(inertia)))
    assert np.sqrt((error.as_rotvec() ** 2).sum(axis=1).mean()) == pytest.approx(expected, rel=0.05)
    # 12 coordinates, 6 of them spent on the pose: the rms over 4 markers is sigma sqrt(6 / 4)
    assert found.rms == pytest.approx(sigma * np.sqrt(6 / 4), rel=0.03)


def test_two_visible_markers_are_a_gap_and_three_are_a_pose():
    markers, turn, path = moving()
    points = np.array(markers.points)
    points[10, 0] = np.nan
    points[20, :2] = np.nan
    points[30] = np.nan
    found = fit_cluster(Markers(labels=LABELS, time=markers.time, points=points), LABELS)
    assert np.flatnonzero(~found.reference.valid).tolist() == [20, 30]
    assert np.flatnonzero(np.isnan(found.reference.position[:, 0])).tolist() == [20, 30]
    np.testing.assert_allclose(found.reference.position[10], path[10], atol=1e-9)
    assert turn_error(found.reference, turn).max() < 1e-7


def test_a_mirror_image_is_never_the_answer_for_a_flat_cluster():
    flat = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0]])
    markers, turn, _ = moving(shape=flat)
    assert turn_error(pose_from_cluster(markers, ("A", "B", "C")), turn).max() < 1e-7


def test_clusters_that_give_no_pose_are_refused():
    markers, _, _ = moving()
    with pytest.raises(InputError, match="expected three different markers or more, got A, B"):
        fit_cluster(markers, ("A", "B"))
    with pytest.raises(InputError, match="expected three different markers or more, got A, A, B"):
        fit_cluster(markers, ("A", "A", "B"))
    with pytest.raises(InputError, match="marker 'Q', got A, B, C,"):
        fit_cluster(markers, ("A", "B", "Q"))
    line, _, _ = moving(shape=np.array([[0.0, 0, 0], [0.1, 0, 0], [0.2, 0, 0]]))
    with pytest.raises(InputError, match="expected markers that span a plane, got A, B, C on one line"):
        fit_cluster(line, ("A", "B", "C"))
    points = np.array(markers.points)
    points[:25, 0], points[25:, 1] = np.nan, np.nan
    never = Markers(labels=LABELS, time=markers.time, points=points)
    with pytest.raises(InputError, match=r"expected a frame with all of A, B, C, D, got none. Omit [AB]"):
        fit_cluster(never, LABELS)


def test_a_y_up_laboratory_turns_about_x_and_stays_right_handed():
    np.testing.assert_array_equal(level_from(np.eye(3), "y"), [[1, 0, 0], [0, 0, 1], [0, -1, 0]])
    assert np.linalg.det(level_from(np.eye(3), "y")) == pytest.approx(1.0)
    np.testing.assert_array_equal(level_from(np.eye(3), "z"), np.eye(3))
    with pytest.raises(InputError, match='up: expected "y" or "z", got \'x\''):
        level_from(np.eye(3), "x")


# ---- tRC


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
        (lambda t: t.replace("0.01\t1.0", "0.01\tlost"), "expected numbers in line 8, got 'lost'"),
        (lambda t: t.replace("0.01\t1.0", "0.01\t1_0"), "expected numbers in line 8, got '1_0'"),
        (lambda t: t.replace("0.01\t1.0", "0.01\t1.0\x1f"), "expected numbers in line 8, got '1.0"),
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
