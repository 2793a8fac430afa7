"""Markers and orientations under any names: proposed as a reference, never as accelerations, and read as they were written."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from undrift.commands.info import info
from undrift.errors import InputError
from undrift.frames import quaternion_conjugate, quaternion_product, rotate
from undrift.io.formats import read_reference
from undrift.io.guess import reference_map, sniff
from undrift.io.reference import ReferenceMap, read_reference_map

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


@pytest.mark.parametrize(
    ("heads", "length_per_m", "unit"),
    [
        ([["time", *named(("M1", "M2", "M3", "M4"))]], 1.0, "m"),
        ([["Time", *named(("LASI", "RASI", "LPSI", "RPSI"), "XYZ", " ")]], 1e3, "mm"),
        ([["t", *named(("seg.marker1", "seg.marker2", "seg.marker3", "seg.marker4"), joint=".")]], 1.0, "m"),
        ([["time", *[f"{axis}{k}" for k in range(1, 5) for axis in "xyz"]]], 1e3, "mm"),
        ([["time", *[f"Traj{k} {axis} (mm)" for k in range(4) for axis in "XYZ"]]], 1e3, "mm"),
    ],
    ids=["M1_x", "LASI X", "seg.marker1.x", "x1", "with a unit"],
)
def test_markers_of_any_name_are_proposed_with_their_unit_and_read_as_the_body_turned(
    tmp_path, heads, length_per_m, unit
):
    file = write(tmp_path / "optics.csv", heads, Y_UP * length_per_m, gap=(slice(40, 60), 2))
    shown = info(file, write_map=tmp_path / "map.toml")
    text = (tmp_path / "map.toml").read_text()
    assert f'markers = "{unit}"' in text
    assert 'up = "?"' in text
    assert "accel" not in text
    assert not shown.data["complete"]
    (tmp_path / "map.toml").write_text(text.replace('up = "?"', 'up = "y"').replace('time = "?"', 'time = "s"'))
    reference = read_reference(file, read_reference_map(tmp_path / "map.toml"))
    assert reference.valid.all()
    true = TURNS.as_quat(scalar_first=True)  # from the first frame on, in a laboratory with y up
    levelled = quaternion_product(np.array([2.0**-0.5, 2.0**-0.5, 0.0, 0.0]), true)
    turn = quaternion_product(quaternion_conjugate(levelled), reference.q_nb)
    np.testing.assert_allclose(np.abs(turn @ turn[0]), 1.0, atol=1e-9)  # one body-fixed turn lies between them
    (moved,) = rotate(np.array([2.0**-0.5, 2.0**-0.5, 0.0, 0.0]), (Y_UP[-1].mean(axis=0) - Y_UP[0].mean(axis=0))[None])
    np.testing.assert_allclose(reference.position[-1] - reference.position[0], moved, atol=1e-6)


def test_the_rigid_body_is_found_among_markers_of_others_and_still_accelerometers_are_none(tmp_path):
    rng = np.random.default_rng(3)
    other = np.cumsum(rng.normal(0.0, 0.01, (FRAMES, 2, 3)), axis=0)
    stems = ("head", "arm", "P1", "P2", "P3", "P4")
    file = write(tmp_path / "all.csv", [["time", *named(stems)]], np.concatenate((other, Y_UP), axis=1))
    (line, *_) = reference_map(sniff(file), sniff(file).names)
    assert all(f"P{k}_x" in line for k in range(1, 5))
    assert "head" not in line
    still = np.tile([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]], (FRAMES, 1, 1)) + rng.normal(
        0.0, 1e-3, (FRAMES, 3, 3)
    )
    bare = write(tmp_path / "still.csv", [["time", *named(("s1", "s2", "s3"))]], still)
    assert reference_map(sniff(bare), sniff(bare).names) == ()


def test_rows_whose_time_goes_back_are_refused_or_left_out_with_their_number(tmp_path):
    time = TIME.copy()
    time[[50, 51, 200]] -= 0.03
    file = write(tmp_path / "optics.csv", [["time", *named("abcd")]], Y_UP, time=time)
    columns = ReferenceMap(
        time="time", time_unit="s", markers=tuple(tuple(named(one)) for one in "abcd"), markers_unit="m", up="y"
    )
    with pytest.raises(InputError, match=r"got 3 rows that do not, first row 51; state repair_time = true"):
        read_reference(file, columns)
    reference = read_reference(file, replace(columns, repair_time=True))
    assert len(reference) == FRAMES - 3
    assert "3 rows left out" in reference.name


@pytest.mark.parametrize("up", ["x", "y", "z", "-x", "-y", "-z"])
def test_the_stated_axis_of_a_laboratory_points_up(tmp_path, up):
    axis = np.zeros(3)
    axis["xyz".index(up[-1])] = -1.0 if up[0] == "-" else 1.0
    lines = ["t,qw,qx,qy,qz,px,py,pz"] + [f"{k / 100},1,0,0,0,{','.join(map(str, k * axis))}" for k in range(20)]
    (tmp_path / "q.csv").write_text("\n".join(lines) + "\n")
    columns = ReferenceMap(
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
    with pytest.raises(InputError, match="up: wanted the axis"):
        replace(columns, up="upwards")
