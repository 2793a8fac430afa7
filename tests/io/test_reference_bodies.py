import numpy as np
import pytest

from undrift.frames import quaternion_of, rotate, rotation_vector
from undrift.io.mocap import Markers
from undrift.io.reference import L5_OFFSET, device_on, find_body, find_label

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
