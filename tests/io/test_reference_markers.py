"""Markers and orientations under any names, read through a map as they were written."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from testkit.column_maps import reference_map
from undrift.frames import quaternion_conjugate, quaternion_product, rotate
from undrift.io.formats import read_reference

RATE_HZ, FRAMES = 100.0, 300
CLUSTER = np.array([[0.0, 0.0, 0.0], [0.09, 0.01, 0.0], [0.02, 0.07, 0.01], [0.05, 0.05, 0.04]])  # m
TIME = np.arange(FRAMES) / RATE_HZ
TURNS = Rotation.from_rotvec(np.column_stack((0.4 * np.sin(3 * TIME), 0.6 * TIME, 0.3 * np.sin(2 * TIME))))
PLACE = np.column_stack((0.4 + 0.2 * np.sin(TIME), 1.1 + 0.1 * TIME, -0.3 + 0.05 * TIME))
Y_UP = np.stack([TURNS.apply(one) + PLACE for one in CLUSTER], axis=1)


def write(path, heads, points, *, gap=None, time=TIME):
    points = points.copy()
    if gap is not None:
        points[gap] = np.nan
    lines = [",".join(row) for row in heads]
    for t, row in zip(time, points.reshape(len(points), -1), strict=True):
        lines.append(",".join([f"{t:.6f}", *("" if np.isnan(x) else f"{x:.7f}" for x in row)]))
    path.write_text("\n".join(lines) + "\n")
    return path


def named(stems, axes="xyz", joint="_"):
    return [f"{stem}{joint}{axis}" for stem in stems for axis in axes]


def test_markers_in_a_table_are_read_as_the_body_turned(tmp_path):
    stems = ("LASI", "RASI", "LPSI", "RPSI")
    heads = [["Time", *named(stems, "XYZ", " ")]]
    file = write(tmp_path / "optics.csv", heads, Y_UP * 1e3, gap=(slice(40, 60), 2))
    columns = reference_map(
        time="Time",
        time_unit="s",
        markers=tuple(tuple(named((stem,), "XYZ", " ")) for stem in stems),
        markers_unit="mm",
        up="y",
    )
    reference = read_reference(file, columns)
    assert reference.valid.all()
    true = TURNS.as_quat(scalar_first=True)  # from the first frame on, in a laboratory with y up
    levelled = quaternion_product(np.array([2.0**-0.5, 2.0**-0.5, 0.0, 0.0]), true)
    turn = quaternion_product(quaternion_conjugate(levelled), reference.q_nb)
    np.testing.assert_allclose(np.abs(turn @ turn[0]), 1.0, atol=1e-9)  # one body-fixed turn lies between them
    (moved,) = rotate(np.array([2.0**-0.5, 2.0**-0.5, 0.0, 0.0]), (Y_UP[-1].mean(axis=0) - Y_UP[0].mean(axis=0))[None])
    np.testing.assert_allclose(reference.position[-1] - reference.position[0], moved, atol=1e-6)


@pytest.mark.parametrize("up", ["x", "y", "z", "-x", "-y", "-z"])
def test_the_stated_axis_of_a_laboratory_points_up(tmp_path, up):
    axis = np.zeros(3)
    axis["xyz".index(up[-1])] = -1.0 if up[0] == "-" else 1.0
    lines = ["t,qw,qx,qy,qz,px,py,pz"] + [f"{k / 100},1,0,0,0,{','.join(map(str, k * axis))}" for k in range(20)]
    (tmp_path / "q.csv").write_text("\n".join(lines) + "\n")
    columns = reference_map(
        quaternion=("qw", "qx", "qy", "qz"),
        time="t",
        time_unit="s",
        position=("px", "py", "pz"),
        position_unit="m",
        up=up,
    )
    reference = read_reference(tmp_path / "q.csv", columns)
    np.testing.assert_allclose(rotate(reference.q_nb[0], axis[None])[0], [0.0, 0.0, 1.0], atol=1e-12)
    np.testing.assert_allclose(reference.position[-1], [0.0, 0.0, 19.0], atol=1e-12)
