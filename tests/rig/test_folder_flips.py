"""A finished run in which one bit was flipped: refused, or the session that it was."""

import random

import numpy as np
import pytest

from testkit.data import show
from testkit.rig_bench import SHORT, run, simulated
from undrift.errors import UndriftError
from undrift.io.session import read_session
from undrift.rig.folder import RunFolder

FLIPS = 200


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    path = tmp_path_factory.mktemp("flips") / "run"
    run(simulated(), path)
    return path


def read(path):
    """Return the session of a finished run, and its dwells as a resume reads them."""
    session = read_session(path)
    with RunFolder(path, SHORT, resume=True) as folder:
        return session, folder.head, folder.pieces


def same(one, other):
    (a, *rest), (b, *more) = one, other
    arrays = all(
        np.array_equal(getattr(x, name), getattr(y, name), equal_nan=True)
        for x, y in zip(a.records, b.records, strict=True)
        for name in ("time", "gyro", "accel", "temp_c")
        if getattr(x, name) is not None
    )
    return arrays and rest == more and (a.stills, a.turns, a.serial, a.gravity_m_s2) == (
        b.stills, b.turns, b.serial, b.gravity_m_s2,
    )  # fmt: skip


@pytest.mark.slow
def test_a_flipped_bit_in_a_finished_run_is_refused_or_changes_nothing(finished):
    sound, rng = read(finished), random.Random(16)
    files = sorted(p for p in finished.rglob("*") if p.is_file() and p.suffix in (".parquet", ".toml"))
    silent, refused = [], 0
    for k in range(FLIPS):
        path = files[k % len(files)]
        whole = path.read_bytes()
        place = rng.randrange(8 * len(whole))
        changed = bytearray(whole)
        changed[place // 8] ^= 1 << place % 8
        path.write_bytes(changed)
        try:
            if not same(sound, read(finished)):
                silent.append((path.name, place))
        except UndriftError:
            refused += 1
        finally:
            path.write_bytes(whole)
            for aside in finished.glob("aside/*"):
                aside.unlink()
    show(f"of {FLIPS} flips, silent and different", len(silent), 0)
    show("refused", refused)
    assert silent == []
    assert refused > FLIPS // 2
