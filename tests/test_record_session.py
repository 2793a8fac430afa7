"""Session, Still and Turn: ranges lie inside their recordings, gravity is a gravity."""

import numpy as np
import pytest

from undrift.errors import InputError
from undrift.record import FACES, Record, Session, Still, Turn

RECORD = Record(time=np.arange(100) / 100, gyro=np.zeros((100, 3)))
KEYS = {"kind": "calibration", "serial": "A1", "gravity_m_s2": 9.81, "records": (RECORD,)}


def test_a_session_holds_what_it_was_given():
    still, turn = Still(start=0, stop=10, face="+x"), Turn(start=10, stop=100, axis="z", angle=-6.28)
    session = Session(**KEYS, stills=(still,), turns=(turn,))
    assert session.stills == (still,)
    assert session.turns == (turn,)
    assert session.inputs == ()
    assert len(FACES) == 6


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"records": ()}, "session: expected one recording"),
        ({"gravity_m_s2": 1.0}, "between 9.7 and 9.9 m/s2, got 1"),
        ({"gravity_m_s2": float("nan")}, "expected local gravity"),
        (
            {"stills": (Still(start=50, stop=101),)},
            r"expected samples inside a recording, got \[50, 101\) of recording 0",
        ),
        ({"turns": (Turn(start=0, stop=5, recording=1),)}, r"got \[0, 5\) of recording 1"),
    ],
)
def test_a_session_that_does_not_fit_together_is_refused(change, words):
    with pytest.raises(InputError, match=words):
        Session(**(KEYS | change))


@pytest.mark.parametrize("piece", [Still, Turn])
@pytest.mark.parametrize(("start", "stop"), [(5, 5), (6, 5), (-1, 5)])
def test_an_empty_or_negative_range_is_refused(piece, start, stop):
    with pytest.raises(InputError, match=rf"(still|turn): expected samples 0 <= start < stop, got \[{start}, {stop}\)"):
        piece(start=start, stop=stop)
