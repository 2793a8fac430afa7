"""What a rate table that errs truly imposes, and what its encoder reads."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from undrift.programme import Protocol
from undrift.record import FACES
from undrift.sim.bench_errors import BenchDraws, BenchErrors
from undrift.sim.motion.motion import unit_vector
from undrift.sim.table_sessions import (
    FACE,
    RATE,
    REST,
    ImposedDwells,
    TableSession,
    impose_faces,
    impose_turns,
    lay_out,
)

DPS, G = np.pi / 180.0, 9.80665
PROTOCOL = Protocol(
    grid="paper",
    dwell_s=2.0,
    bracket_s=3.0,
    turn_rate_min=10.0 * DPS,
    turn_rate_max=50.0 * DPS,
    turn_rate_step=20.0 * DPS,
)
LAID = lay_out(PROTOCOL)
SESSIONS = LAID.chosen(REST, RATE)
N = len(SESSIONS.kind)
ROWS = np.arange(N)


def draws(seed: int = 0, **change: Any) -> BenchDraws:
    rng = np.random.default_rng(seed)
    normal = {name: rng.standard_normal(shape) for name, shape in DRAWN.items()}
    return replace(BenchDraws(**normal, clock=1.0, start=rng.uniform(size=(N, 2))), **change)


DRAWN = {"mount": (3, 3), "level": 2, "face": (6, 3), "wobble": (N, 3), "servo": N}


def imposed(errors: BenchErrors, seed: int = 0, session: TableSession = SESSIONS) -> tuple[ImposedDwells, np.ndarray]:
    return impose_turns(session, errors, draws(seed), ROWS)


def test_an_ideal_bench_imposes_what_is_commanded() -> None:
    dwells, read = imposed(BenchErrors())
    np.testing.assert_allclose(dwells.rate_b, SESSIONS.rate[:, None] * np.eye(3)[SESSIONS.axis], atol=1e-15)
    np.testing.assert_allclose(dwells.force_b, G * np.eye(3)[SESSIONS.axis], atol=1e-12)
    np.testing.assert_allclose(read, SESSIONS.rate, rtol=1e-12)


def test_a_mounting_turns_all_dwells_of_its_axis_alike_and_a_wobble_each_by_itself() -> None:
    mounted, _ = imposed(BenchErrors(mount_tilt=0.01))
    turning = SESSIONS.kind == RATE
    about = mounted.rate_b[turning] / SESSIONS.rate[turning, None]
    for axis in range(3):
        own = about[SESSIONS.axis[turning] == axis]
        np.testing.assert_allclose(own, np.tile(own[0], (len(own), 1)), atol=1e-12)
        wanted = np.eye(3)[axis] + np.cross(0.01 * draws().mount[axis], np.eye(3)[axis])
        np.testing.assert_allclose(own[0], wanted / np.linalg.norm(wanted), atol=1e-12)
        assert np.linalg.norm(own[0] - np.eye(3)[axis]) > 1e-3
    sizes = []
    for seed in range(200):
        wobbling, _ = imposed(BenchErrors(wobble=0.01), seed)
        off = wobbling.rate_b[turning] / SESSIONS.rate[turning, None] - np.eye(3)[SESSIONS.axis[turning]]
        sizes.append((off**2).sum(axis=1))
    assert np.sqrt(np.mean(sizes) / 2.0) == pytest.approx(0.01, rel=0.05)  # two axes across; 4,800 dwells: 1 %


def test_the_encoder_reads_what_the_servo_makes_of_a_rate_to_a_count() -> None:
    count = 2.0 * np.pi / 40_000
    dwells, read = imposed(BenchErrors(servo=0.012 * DPS, encoder_lines=10_000))
    true = (dwells.rate_b * np.eye(3)[SESSIONS.axis]).sum(axis=1)
    turning = SESSIONS.kind == RATE
    assert np.abs(true - SESSIONS.rate)[turning].max() > 0.003 * DPS  # the servo errs by 0.006 deg/s over two seconds
    apart = (read - true)[turning] * 2.0 / count
    assert np.abs(apart).max() < 1.0
    assert np.abs(apart).std() > 0.1
    np.testing.assert_array_equal(true[~turning], 0.0)
    clocked, also = imposed(BenchErrors(table_rate=1e-3))
    np.testing.assert_allclose(also, SESSIONS.rate * (1.0 - 1e-3), rtol=1e-12)  # one draw of 1
    np.testing.assert_allclose((clocked.rate_b**2).sum(axis=1), SESSIONS.rate**2, rtol=1e-12)


def test_a_table_off_level_turns_gravity_about_a_whole_turn_averages_out() -> None:
    once = replace(
        SESSIONS, duration_s=np.where(SESSIONS.kind == RATE, 2.0 * np.pi / np.abs(SESSIONS.rate.clip(DPS)), 3.0)
    )
    dwells, _ = imposed(BenchErrors(level=0.01), session=once)
    across = np.linalg.norm(dwells.force_b - G * np.eye(3)[SESSIONS.axis], axis=1)
    whole = np.isclose(once.duration_s * np.abs(once.rate), 2.0 * np.pi)
    np.testing.assert_allclose(across[whole], 0.0, atol=1e-12)
    np.testing.assert_allclose(across[SESSIONS.kind == REST], 0.01 * G * np.hypot(*draws().level), rtol=1e-9)


def test_faces_lie_off_level_each_by_itself() -> None:
    faces = LAID.chosen(FACE)
    level = np.array([unit_vector(FACES[face]) for face in faces.face])
    up = impose_faces(faces, BenchErrors(face_tilt=0.01), draws()).force_b / G
    np.testing.assert_allclose(np.linalg.norm(up, axis=1), 1.0)
    off = np.linalg.norm(up - level, axis=1)
    assert len(np.unique(off.round(9))) == 6
    assert 1e-3 < off.mean() < 0.04
