"""undrift mount: the mounting kept in the calibration and used by orient and validate."""

import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from testkit.walking import misplaced, perfect_calibration, walk
from undrift.frames import quaternion_conjugate, quaternion_product, rotation
from undrift.io.formats import read_record, read_reference, write_record
from undrift.io.store import read_calibration, write_calibration

Q_AB = misplaced(np.random.default_rng(1), 20.0, np.array([0.0, 1.0, 0.0, 0.0]))  # upside down, and 20 deg off


@pytest.fixture(scope="module")
def worn(tmp_path_factory):
    """Return a folder with a walk, bare.json, and worn.json as mount writes it."""
    folder = tmp_path_factory.mktemp("worn")
    write_record(walk(np.random.default_rng(2), q_ab=Q_AB, bouts=3), folder / "walk.parquet")
    write_calibration(perfect_calibration(), folder / "bare.json")
    return folder


def mounted(undrift, worn):
    """Return the answer of mount, which wrote worn.json."""
    words = ("--worn", "lower-back", "--calibration", worn / "bare.json", "-o", worn / "worn.json")
    return undrift.good("mount", worn / "walk.parquet", *words)


@pytest.mark.slow
def test_the_mounting_is_kept_in_the_calibration_and_said_in_words(undrift, worn):
    said = mounted(undrift, worn).out
    assert "Lower back: side" in said
    assert "upside down" in said
    assert "left and right swapped" in said
    kept = read_calibration(worn / "worn.json").mounting
    off = Rotation.from_matrix(kept.matrix @ rotation(Q_AB).as_matrix().T).magnitude()
    assert off < 3.0 * kept.uncertainty
    assert np.degrees(kept.uncertainty) < 2.5
    answer = undrift.good("mount", worn / "walk.parquet", "--worn", "lower-back", "--json").json()
    np.testing.assert_allclose(answer["data"]["mounting"]["matrix"], kept.matrix)
    axes = answer["tables"]["body_axes_in_the_device"]
    assert [row["turn"] for row in axes] == ["roll", "pitch", "heading"]
    assert (axes[0]["side"], axes[2]["side"]) == ("+x", "-z")
    assert answer["answer"] in undrift.good("info", worn / "worn.json").out.replace("\n", " ")


def test_orient_gives_the_segment_by_the_mounting_unless_sides_are_stated(undrift, worn, tmp_path):
    mounted(undrift, worn)
    made = {}
    for name, words in {
        "body": ("worn.json",), "case": ("bare.json",), "stated": ("worn.json", "--forward", "+x", "--up", "-z"),
    }.items():  # fmt: skip
        words = ("--calibration", worn / words[0], *words[1:], "-o", tmp_path / f"{name}.csv", "--method", "vqf")
        said = undrift.good("orient", worn / "walk.parquet", *words).out
        assert ("The calibration's mounting" in said) == (name == "body")
        made[name] = read_reference(tmp_path / f"{name}.csv")
    kept = read_calibration(worn / "worn.json").mounting
    turn = quaternion_product(made["body"].q_nb, quaternion_conjugate(kept.of_body(made["case"].q_nb)))
    np.testing.assert_allclose(turn[:, 1:3], 0.0, atol=1e-6)  # about the vertical alone: the heading is the segment's
    np.testing.assert_allclose(made["stated"].q_nb, made["case"].q_nb, atol=1e-9)
    pitch = np.genfromtxt(tmp_path / "body.csv", delimiter=",", names=True)["pitch_deg"]
    assert abs(np.median(pitch[20:300])) < 4.0  # the wearer stands upright


def test_what_is_not_shown_writes_nothing_and_fails(undrift, worn, tmp_path):
    write_record(read_record(worn / "walk.parquet").between(0.0, 3.9), tmp_path / "stand.parquet")
    words = ("--worn", "lower-back", "--calibration", worn / "bare.json", "-o", tmp_path / "no.json")
    answer = undrift("mount", tmp_path / "stand.parquet", *words)
    assert answer.code == 1
    assert "Forward is not determined" in answer.out
    assert not (tmp_path / "no.json").exists()


@pytest.mark.parametrize(
    ("words", "wanted"),
    [
        ((), "--worn"),
        (("--worn", "thigh", "-o", "no.json"), "expected a calibration to which the mounting is added, got none"),
        (("--worn", "thigh", "-o", "no.csv"), r"expected a name ending in \.json"),
        (("--worn", "foot", "--movement", "bow"), "in a bow, the foot does not move"),
    ],
)
def test_a_call_that_does_not_fit_is_refused_in_a_line(undrift, worn, words, wanted):
    assert re.search(wanted, undrift.refused("mount", worn / "walk.parquet", *words))
