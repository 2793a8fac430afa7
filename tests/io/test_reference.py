"""References come back from every table format, and from markers; what is missing is named."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from testkit.column_maps import reference_map
from testkit.strategies import few, references
from testkit.trc_text import trc
from undrift.errors import FileFormatError, InputError
from undrift.frames import quaternion_conjugate
from undrift.io.formats import read_markers, read_reference
from undrift.io.reference import read_reference_map, write_reference


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
    with pytest.raises(InputError, match="strictly increasing time, got 1 steps back or doubled, first in data row 3"):
        read_reference(tmp_path / "optics.csv", read_reference_map(tmp_path / "map.toml"))
    (tmp_path / "map.toml").write_text(text + "repair_time = true\n")
    back = read_reference(tmp_path / "optics.csv", read_reference_map(tmp_path / "map.toml"))
    np.testing.assert_allclose(back.time, [0.0, 0.01, 0.02])
    np.testing.assert_allclose(back.q_nb, q[[0, 1, 3]])
    (tmp_path / "map.toml").write_text(text.replace("time = 0", "time = 3") + "repair_time = true\n")
    with pytest.raises(InputError, match="time that mostly goes forward, got 3 of 4 rows"):
        read_reference(tmp_path / "optics.csv", read_reference_map(tmp_path / "map.toml"))
    (tmp_path / "map.toml").write_text(text.replace("time = 0", "tme = 0"))
    with pytest.raises(InputError, match="nearest known key: time"):
        read_reference_map(tmp_path / "map.toml")
