"""References come back from every table format, and from markers; what is missing is named."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from testkit.column_maps import reference_map
from testkit.strategies import few, references
from testkit.trc_text import trc
from undrift.errors import FileFormatError, InputError
from undrift.frames import quaternion_conjugate, quaternion_of, quaternion_product, rotate, rotation_vector
from undrift.io.formats import read_markers, read_reference
from undrift.io.mocap import Markers
from undrift.io.reference import L5_OFFSET, device_on, find_body, find_label, read_reference_map, write_reference


@pytest.mark.slow
@few
@given(reference=references(), suffix=st.sampled_from(["csv", "parquet"]))
def test_a_reference_comes_back_from_the_files_it_is_written_to(tmp_path_factory, reference, suffix):
    path = tmp_path_factory.mktemp("reference") / f"r.{suffix}"
    write_reference(reference, path)
    back = read_reference(path)
    np.testing.assert_array_equal(back.time, reference.time)
    # the value makes quaternions unit again: one rounding
    np.testing.assert_allclose(back.q_nb, reference.q_nb, rtol=1e-15)
    for name in ("position", "moving"):
        if getattr(reference, name) is None:
            assert getattr(back, name) is None
        else:
            np.testing.assert_array_equal(getattr(back, name), getattr(reference, name))


def test_a_foreign_table_reads_through_a_map_and_an_inverse_is_turned_round(tmp_path):
    q = np.array([[0.5, 0.5, 0.5, 0.5], [1.0, 0.0, 0.0, 0.0], [0.6, 0.8, 0.0, 0.0]])
    rows = [f"{10 * k},{v[1]},{v[2]},{v[3]},{v[0]},{1000 * k},0,5" for k, v in enumerate(q)]
    (tmp_path / "q.csv").write_text("\n".join(["ms,x,y,z,w,px,py,pz", *rows]) + "\n")
    keys = {"time": "ms", "time_unit": "ms", "quaternion": ("w", "x", "y", "z")}
    found = read_reference(tmp_path / "q.csv", reference_map(**keys, position=("px", "py", "pz"), position_unit="mm"))
    np.testing.assert_allclose(found.q_nb, q)
    np.testing.assert_allclose(found.position[:, 0], [0.0, 1.0, 2.0])
    np.testing.assert_allclose(found.time, [0.0, 0.01, 0.02])
    inverse = read_reference(tmp_path / "q.csv", reference_map(**keys, turns="level_to_body"))
    np.testing.assert_allclose(inverse.q_nb, quaternion_conjugate(q))
    counted = read_reference(tmp_path / "q.csv", reference_map(quaternion=("w", "x", "y", "z"), sample_rate_hz=50.0))
    np.testing.assert_allclose(counted.time, [0.0, 0.02, 0.04])


def test_marker_files_need_labels_and_the_axis_that_is_up(tmp_path):
    points = np.array([[0.0, 0.1, 0.2], [0.1, 0.1, 0.2], [0.0, 0.2, 0.3]]) + np.zeros((5, 1, 1))
    (tmp_path / "m.trc").write_text(trc(points, ("A", "B", "C")))
    found = read_reference(tmp_path / "m.trc", labels=("A", "B", "C"), up="y")
    np.testing.assert_allclose(found.q_nb, np.tile([1.0, 0, 0, 0], (5, 1)), atol=1e-9)
    np.testing.assert_allclose(found.position[0], points[0].mean(axis=0)[[0, 2, 1]] * [1, -1, 1])
    assert "rigid within 0.00 mm rms" in found.name
    with pytest.raises(InputError, match="expected the labels of one rigid cluster, got none"):
        read_reference(tmp_path / "m.trc", up="y")
    with pytest.raises(InputError, match="TRC does not contain it"):
        read_reference(tmp_path / "m.trc", labels=("A", "B", "C"))


def test_other_files_are_no_reference(tmp_path):
    (tmp_path / "a.md").write_text("# words\n\nmore words\n")
    with pytest.raises(FileFormatError, match="got text"):
        read_reference(tmp_path / "a.md")
    with pytest.raises(FileFormatError, match=r"expected markers .C3D or TRC., got text"):
        read_markers(tmp_path / "a.md")


def test_a_map_in_toml_reads_a_table_of_foreign_names_and_repairs_its_time(tmp_path):
    q = np.array([[1.0, 0.0, 0.0, 0.0], [0.8, 0.6, 0.0, 0.0], [0.8, 0.6, 0.0, 0.0], [0.6, 0.8, 0.0, 0.0]])
    rows = "".join(f"{t};{';'.join(map(str, one))}\n" for t, one in zip((0, 10, 10, 20), q, strict=True))
    (tmp_path / "optics.csv").write_text(f"t;Orientation;;;\nms;W;X;Y;Z\n{rows}")
    text = 'columns = { time = 0, quaternion = [1, 2, 3, 4] }\nunits = { time = "ms" }\n'
    text += 'layout = { delimiter = ";", header = false, skip_rows = 2 }\n'
    (tmp_path / "map.toml").write_text(text)
    with pytest.raises(InputError, match="got 1 steps that go back or repeat, first in data row 3"):
        read_reference(tmp_path / "optics.csv", read_reference_map(tmp_path / "map.toml"))
    (tmp_path / "map.toml").write_text(text + "repair_time = true\n")
    back = read_reference(tmp_path / "optics.csv", read_reference_map(tmp_path / "map.toml"))
    np.testing.assert_allclose(back.time, [0.0, 0.01, 0.02])
    np.testing.assert_allclose(back.q_nb, q[[0, 1, 3]])
    (tmp_path / "map.toml").write_text(text.replace("time = 0", "time = 3") + "repair_time = true\n")
    with pytest.raises(InputError, match="time that mostly increases, got 3 of 4 rows"):
        read_reference(tmp_path / "optics.csv", read_reference_map(tmp_path / "map.toml"))
    (tmp_path / "map.toml").write_text(text.replace("time = 0", "tme = 0"))
    with pytest.raises(InputError, match="nearest known key: time"):
        read_reference_map(tmp_path / "map.toml")


# ---- anatomical bodies from markers

# Spines of a pelvis and markers of a thorax, standing: x forward, y left, z up, m.
STANDING = {
    "LASI": (0.10, 0.12, 0.0),
    "RASI": (0.10, -0.12, 0.0),
    "LPSI": (-0.05, 0.04, 0.0),
    "RPSI": (-0.05, -0.04, 0.0),
    "C7": (-0.05, 0.0, 0.50),
    "T10": (-0.06, 0.0, 0.25),
    "CLAV": (0.06, 0.0, 0.46),
    "STRN": (0.10, 0.0, 0.29),
}


def walked(rename=None, turn=(0.0, 0.4, 0.0), frames=50):
    """The body above, bent forward step by step and carried along."""
    share = np.linspace(0.0, 1.0, frames)
    q = quaternion_of(share[:, None] * np.array(turn))
    points = np.stack([rotate(q, np.array(p)) for p in STANDING.values()], axis=1) + share[:, None, None]
    labels = tuple((rename or (lambda label: label))(label) for label in STANDING)
    return Markers(labels=labels, time=np.arange(frames) / 100.0, points=points, name="made"), share


def pitch_of(reference):
    return rotation_vector(reference.q_nb)[:, 1]


@pytest.mark.parametrize("name", ["pelvis", "trunk"])
def test_a_body_bent_forward_pitches_about_its_left_axis(name):
    markers, share = walked()
    body = find_body(markers, name)
    pitch = pitch_of(body.reference)
    assert pitch - pitch[0] == pytest.approx(0.4 * share, abs=1e-9)
    assert rotation_vector(body.reference.q_nb)[:, [0, 2]] == pytest.approx(0.0, abs=1e-9)  # markers are symmetric
    assert body.residual < 1e-9


def test_the_axes_of_a_standing_pelvis_are_those_of_the_laboratory_and_its_origin_lies_between_the_rear_spines():
    markers, _ = walked()
    reference = find_body(markers, "pelvis").reference
    assert reference.q_nb[0] == pytest.approx([1.0, 0.0, 0.0, 0.0], abs=1e-9)
    assert reference.position[0] == pytest.approx([-0.05, 0.0, 0.0], abs=1e-12)


def test_a_device_sits_at_its_stated_offset_and_keeps_it():
    markers, _ = walked(turn=(0.2, 0.5, -0.8))
    body = find_body(markers, "pelvis")
    device = device_on(body)
    seen_from_body = rotate(body.reference.q_nb * np.array([1, -1, -1, -1]), device.position - body.reference.position)
    assert seen_from_body == pytest.approx(np.tile(L5_OFFSET, (50, 1)), abs=1e-12)
    assert "device at (-20, 0, 35) mm" in device.name


@pytest.mark.parametrize(
    "spelling",
    [
        lambda label: f"SehoonVSK35:{label}",
        lambda label: {"LASI": "L.ASIS", "RASI": "r.ASIS", "LPSI": "L.PSIS", "RPSI": "r.PSIS"}.get(label, label),
        lambda label: label.lower(),
    ],
)
def test_labels_of_other_laboratories_are_known(spelling):
    markers, _ = walked(spelling)
    assert find_label(markers, "RPSI") == spelling("RPSI")
    assert len(find_body(markers, "pelvis").labels) == 4


@pytest.mark.parametrize(("name", "lost"), [("pelvis", "LASI"), ("trunk", "C7")])
def test_a_frame_without_one_of_the_markers_is_a_gap(name, lost):
    markers, _ = walked()
    points = np.array(markers.points)
    points[10:13, markers.labels.index(lost)] = np.nan
    body = find_body(Markers(labels=markers.labels, time=markers.time, points=points), name)
    assert np.flatnonzero(~body.reference.valid).tolist() == [10, 11, 12]
    assert np.isnan(device_on(body).position[10:13]).all()


# ---- markers and orientations under any names, read through a map as they were written

RATE_HZ, FRAMES = 100.0, 300
CLUSTER = np.array([[0.0, 0.0, 0.0], [0.09, 0.01, 0.0], [0.02, 0.07, 0.01], [0.05, 0.05, 0.04]])  # m
TIME = np.arange(FRAMES) / RATE_HZ
TURNS = Rotation.from_rotvec(np.column_stack((0.4 * np.sin(3 * TIME), 0.6 * TIME, 0.3 * np.sin(2 * TIME))))
PLACE = np.column_stack((0.4 + 0.2 * np.sin(TIME), 1.1 + 0.1 * TIME, -0.3 + 0.05 * TIME))
Y_UP = np.stack([TURNS.apply(one) + PLACE for one in CLUSTER], axis=1)


def test_markers_in_a_table_are_read_as_the_body_turned(tmp_path):
    names = tuple(tuple(f"{stem} {axis}" for axis in "XYZ") for stem in ("LASI", "RASI", "LPSI", "RPSI"))
    points = Y_UP * 1e3
    points[40:60, 2] = np.nan  # an empty cell
    table = pd.DataFrame(points.reshape(FRAMES, 12), index=pd.Index(TIME, name="Time"), columns=sum(names, ()))
    table.to_csv(tmp_path / "optics.csv")
    columns = reference_map(
        time="Time",
        time_unit="s",
        markers=names,
        markers_unit="mm",
        up="y",
    )
    reference = read_reference(tmp_path / "optics.csv", columns)
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
