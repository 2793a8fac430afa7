"""protocol.toml reads back as it was written; what is wrong is named."""

from pathlib import Path

import numpy as np
import pytest

from undrift.errors import FileFormatError
from undrift.programme import Protocol, read_protocol, write_protocol
from undrift.rig.folder import protocol_digest

DPS = np.pi / 180.0


def test_a_protocol_reads_back_as_it_was(tmp_path: Path) -> None:
    wanted = Protocol(
        name='so "called"',
        faces=("+x", "-z"),
        faces_at="room",
        damping=0.8,
        turn_rate_min=3 * DPS,
        turn_rate_max=45 * DPS,
        turn_rate_step=3 * DPS,
        grid="paper",
        axes=("z",),
        order="random",
        seed=4,
        dwell_s=None,
        turn_rate_uncertainty=0.01 * DPS,
        temperatures_c=(18.0, 75.0),
    )
    write_protocol(wanted, tmp_path / "protocol.toml")
    read = read_protocol(tmp_path / "protocol.toml")
    for name in Protocol.__dataclass_fields__:
        value = getattr(wanted, name)
        assert getattr(read, name) == (pytest.approx(value, rel=1e-12) if isinstance(value, float) else value), name


def test_tables_that_are_left_out_are_not_done(tmp_path: Path) -> None:
    (tmp_path / "p.toml").write_text("[faces]\nseconds = 3.0\n")
    read = read_protocol(tmp_path / "p.toml")
    assert (len(read.faces), read.face_s, len(read.turn_rates()), read.temperatures_c) == (6, 3.0, 0, ())


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (
            "[rates]\nturn_rate_min_dps = 5.0\nturn_rate_max_dps = 90.0\nturn_rate_step_dps = 4.0\n",
            "must divide 85, got 4",
        ),
        ("[protocol]\nname = 'x'\n", "faces, rates and turns"),
        ("[faces]\nsecond = 3.0\n", "second"),
        ("[temperatures]\nset_points_c = []\n", "set_points_c"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, text: str, told: str) -> None:
    (tmp_path / "p.toml").write_text(text)
    with pytest.raises(FileFormatError, match=told):
        read_protocol(tmp_path / "p.toml")


def test_what_came_later_is_written_and_counts_only_where_it_is_stated(tmp_path: Path) -> None:
    write_protocol(Protocol(), tmp_path / "p.toml")
    assert "damping" not in (text := (tmp_path / "p.toml").read_text())
    assert "at =" not in text
    changed = {protocol_digest(Protocol(faces_at="first")), protocol_digest(Protocol(damping=0.8))}
    assert len(changed | {protocol_digest(Protocol())}) == 3
