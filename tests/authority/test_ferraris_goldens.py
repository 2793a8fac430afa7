"""Known rotation and six faces on two public Ferraris sessions of a wearable foot sensor (NilsPod).

Expected numbers: printed by the open program imucal for these two sessions (its example session and its stored snapshot,
repository state of 2025-04-25; MIT). The angles, signs and sample rates are those that program was given.
"""

import csv
import json

import numpy as np
import pytest

from testkit.data import data_path, show
from testkit.recordings import nilspod
from undrift.calibration.known_rotation import fit_known_rotation, rotation_rows
from undrift.calibration.plausibility import face_vectors
from undrift.calibration.six_face import FaceMeans, fit_six_face, solve_faces
from undrift.record import Record, Still, Turn

G = 9.81
TOLERANCE = 1e-9  # relative to the largest element; numbers that are printed to ten digits carry 5e-11 of rounding

EXAMPLE = {
    "K_a": np.diag([0.9967458651, 1.0024376186, 1.0233953475]),
    "R_a": [
        [0.9998620292, -0.0148305710, -0.0074817631],
        [0.0085767404, 0.9999615197, 0.0018435180],
        [0.0133311877, 0.0020036179, 0.9999091283],
    ],
    "b_a": [0.5371174244, -0.6162029931, 0.3988673424],
    "K_g": np.diag([1.0279243264, 0.9824277738, 0.9983104874]),
    "R_g": [
        [0.9999793425, -0.0004542136, -0.0064115682],
        [-0.0002222054, 0.9999961010, -0.0027836495],
        [0.0097140045, 0.0076410933, 0.9999236230],
    ],
    "b_g": [-0.5996686297, -0.3698431347, 0.0587739355],
    "K_ga": [
        [0.0003896111, -0.0004581554, -0.0000298448],
        [0.0004320123, 0.0004871100, 0.0006178602],
        [0.0000996655, -0.0000911069, 0.0002356474],
    ],
}
ANNOTATED = {
    "K_a": np.diag([208.54567263762615, 208.0011341167055, 214.78455364603022]),
    "R_a": [
        [0.9999125214, 0.0071220561, -0.0111456629],
        [-0.0079473785, 0.9996887358, 0.0236489034],
        [0.0213429007, -0.0107818795, 0.9997140750],
    ],
    "b_a": [-6.018868019671572, -48.287874016760156, -28.96636637224333],
    "K_g": np.diag([16.67769558952488, 16.187895200550262, 16.253362639451936]),
    "R_g": -np.array(
        [
            [-0.9999143757, -0.0006142301, 0.0130714988],
            [0.0055057031, -0.9992594967, -0.0380807747],
            [-0.0131465091, 0.0365074525, -0.9992469040],
        ]
    ),  # printed for turns of -360 deg; the device was turned the other way
    "b_g": [1.960686204431737, -4.472837741243746, -3.6511794138670477],
    "K_ga": [
        [0.0022926499, -0.0161346324, 0.0184654357],
        [0.0138737050, 0.0054436103, -0.0088124809],
        [-0.0092591057, 0.0085063065, -0.0039353822],
    ],
}


def example():
    ranges = json.loads(data_path("ferraris_nilspod", "example_ferraris_session_list.json").read_text())
    return nilspod(), {name: (part["start"], part["end"]) for name, part in ranges.items()}


def annotated():
    with open(data_path("ferraris_nilspod", "annotated_session.csv")) as file:
        rows = list(csv.DictReader(file))
    part = np.array([row["part"] for row in rows])
    values = {s: np.array([[float(row[f"{s}_{a}"]) for a in "xyz"] for row in rows]) for s in ("acc", "gyr")}
    record = Record(
        time=np.arange(len(rows)) / 204.8,
        gyro=values["gyr"],
        accel=values["acc"],
        gyro_unit="count",
        accel_unit="count",
    )
    names = sorted(set(part.tolist()))
    return record, {n: (int(np.argmax(part == n)), int(np.argmax(part == n) + (part == n).sum())) for n in names}


def pieces(ranges, angle_deg):
    stills = [
        Still(start=start, stop=stop, face=("+" if name[2] == "p" else "-") + name[0])
        for name, (start, stop) in ranges.items()
        if not name.endswith("rot")
    ]
    turns = [
        Turn(start=start, stop=stop, axis=name[0], angle=np.radians(angle_deg))
        for name, (start, stop) in ranges.items()
        if name.endswith("rot")
    ]
    return stills, turns


def face_readings(record, stills):
    return FaceMeans(
        reading=np.array([record.accel[s.start : s.stop].mean(axis=0) for s in stills]),
        faces=tuple(s.face for s in stills),
        unit=record.accel_unit,
    )


def accel_closed_form(poses):
    """Offset from the own axis of each sensor, K R from half differences: the published accelerometer procedure."""
    up = face_vectors(poses.faces)
    plus = np.array([poses.reading[up[:, k] > 0.0].mean(axis=0) for k in range(3)])
    minus = np.array([poses.reading[up[:, k] < 0.0].mean(axis=0) for k in range(3)])
    return ((plus - minus) / (2.0 * G)).T, np.diag(plus + minus) / 2.0


def assert_equal(label, found, golden):
    error = float(np.abs(np.asarray(found) - np.asarray(golden)).max() / np.abs(np.asarray(golden)).max())
    show(f"{label}: relative error", f"{error:.1e}", TOLERANCE)
    assert error <= TOLERANCE, label


def split(forward):
    """K R with unit rows of R."""
    length = np.linalg.norm(forward, axis=1)
    return np.diag(length), forward / length[:, None]


@pytest.mark.parametrize(
    ("read", "angle_deg", "golden"),
    [(example, -360.0, EXAMPLE), (annotated, 360.0, ANNOTATED)],
    ids=["example", "annotated"],
)
def test_the_closed_form_gives_the_published_numbers(read, angle_deg, golden):
    record, ranges = read()
    stills, turns = pieces(ranges, angle_deg)
    poses = face_readings(record, stills)
    forward, offset = accel_closed_form(poses)
    data = rotation_rows([record], stills, turns, matrix=np.linalg.inv(forward), offset=offset)
    model = fit_known_rotation(data, gravity=G, mode="paper").model
    gain, axes = split(model.forward_matrix * np.pi / 180.0)
    assert_equal("K_g", gain, golden["K_g"])
    assert_equal("R_g", axes, golden["R_g"])
    assert_equal("b_g", model.offset, golden["b_g"])
    # ten decimals of elements near 0.0006: rounding alone is 1e-7 of them
    k_ga = model.forward_matrix @ model.g_sensitivity
    show("K_ga: largest difference", np.abs(k_ga - golden["K_ga"]).max(), 6e-11)
    np.testing.assert_allclose(k_ga, golden["K_ga"], atol=6e-11, rtol=0.0)


@pytest.mark.parametrize(("read", "golden"), [(example, EXAMPLE), (annotated, ANNOTATED)], ids=["example", "annotated"])
def test_six_faces_give_the_same_matrix_and_offset_to_the_noise(read, golden):
    record, ranges = read()
    poses = face_readings(record, pieces(ranges, 360.0)[0])
    affine = fit_six_face(poses, gravity=G, mode="affine").model
    gain, axes = split(affine.forward_matrix)
    assert_equal("K_a", gain, golden["K_a"])
    assert_equal("R_a", axes, golden["R_a"])
    _, own_axis = accel_closed_form(poses)
    assert_equal("b_a", own_axis, golden["b_a"])
    # With noise far below the tilt the affine offset leans on the own-axis pairs alone, as the closed form does.
    quiet = FaceMeans(
        reading=poses.reading, faces=poses.faces, noise=np.full((6, 3), 1e-5 * gain.max()), unit=poses.unit
    )
    fit, tilt = fit_six_face(quiet, gravity=G), solve_faces(quiet, G).excess["level"] ** 0.5
    difference = np.abs(fit.model.offset - golden["b_a"]).max() / gain.max()
    show("affine offset less closed form, m/s2", difference, 1e-3)
    show("tilt of the faces, deg", np.degrees(tilt), "imucal's own residuals imply 0.13 rms on the example")
    assert difference < 1e-3
    assert 0.05 < np.degrees(tilt) < 1.5


def test_the_affine_offset_of_the_example_session():
    record, ranges = example()
    fit = fit_six_face(face_readings(record, pieces(ranges, 360.0)[0]), gravity=G, mode="affine")
    np.testing.assert_allclose(fit.model.offset, [0.55113924, -0.61972667, 0.38564410], atol=5e-9)
    show("affine: rms residual on an axis, m/s2", fit.model.rms_residual, "0.01308 (in sample, all samples pooled)")
    assert fit.model.rms_residual < 0.0131
