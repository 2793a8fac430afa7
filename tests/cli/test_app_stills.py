"""Rests on the command line: found in a hand, by another window or threshold, and drawn."""

import numpy as np
import pytest

from testkit.hand_held import Tremor, hand_held_log
from undrift.io.formats import write_record

STRONG = Tremor(rate_dps=3.0, sway_deg=1.0, accel=0.25)


@pytest.fixture
def session(tmp_path):
    """A folder with one hand-held recording."""
    record, _ = hand_held_log(np.random.default_rng(2), STRONG, poses=12)
    folder = tmp_path / "hand"
    folder.mkdir()
    write_record(record, folder / "log.parquet")
    head = '[session]\nkind = "calibration"\nserial = "S1"\ngravity_m_s2 = 9.81\n[[recording]]\nfile = "log.parquet"\n'
    (folder / "session.toml").write_text(head)
    return folder


def test_what_cannot_be_drawn_is_refused_before_anything_is_written(undrift, session, tmp_path):
    for words, message in (
        (
            ("info", tmp_path, "--figure", tmp_path / "a.svg"),
            "--figure: wanted a recording or a session, got the folder",
        ),
        (
            ("info", session / "session.toml", "--figure", tmp_path / "a.txt"),
            "wanted a name ending in .svg, .png or .pdf",
        ),
        (("calibrate", session, "--figure", tmp_path / "a.txt"), "wanted a name ending in .svg, .png or .pdf"),
    ):
        answer = undrift(*words)
        assert (answer.code, answer.out) == (2, "")
        assert message in answer.err
    c = tmp_path / "c.json"
    undrift.good("calibrate", session, "-o", c)
    answer = undrift("info", c, "--figure", tmp_path / "a.svg")
    assert "--figure: wanted a recording or a session, got calibration" in answer.err
    assert not (tmp_path / "a.svg").exists()
