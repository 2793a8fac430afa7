"""A rate table with errors: what it imposes, what its encoder reads, and mean readings against those of samples."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.data import show
from testkit.simulated_device import motion_of, run
from undrift.programme import FacesTable, Protocol, RatesTable
from undrift.sim.device.effects import WhiteNoise
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.presets import random_device
from undrift.sim.kernels import add_drift
from undrift.sim.motion.bench import BenchErrors
from undrift.sim.table_sessions import (
    FACE,
    RATE,
    REST,
    BenchDraws,
    ImposedDwells,
    TableSession,
    impose_turns,
    lay_out,
    mean_readings,
    numbers_of_dwell,
)

DPS, G = np.pi / 180.0, 9.80665
PROTOCOL = Protocol(
    faces=FacesTable(),
    rates=RatesTable(
        turn_rate_min_dps=10.0,
        turn_rate_max_dps=50.0,
        turn_rate_step_dps=20.0,
        grid="paper",
        seconds=2.0,
        bracket_s=3.0,
    ),
)
LAID = lay_out(PROTOCOL)
SESSIONS = LAID[LAID.kind != FACE]
N = len(SESSIONS.kind)
ROWS = np.arange(N)


def draws(seed: int = 0) -> BenchDraws:
    made = BenchDraws(np.random.default_rng(seed), [np.random.default_rng([seed, k]) for k in range(N)])
    made.clock = 1.0
    return made


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
    once = SESSIONS.copy()
    once.duration_s = np.where(SESSIONS.kind == RATE, 2.0 * np.pi / np.abs(SESSIONS.rate.clip(DPS)), 3.0)
    dwells, _ = imposed(BenchErrors(level=0.01), session=once)
    across = np.linalg.norm(dwells.force_b - G * np.eye(3)[SESSIONS.axis], axis=1)
    whole = np.isclose(once.duration_s * np.abs(once.rate), 2.0 * np.pi)
    np.testing.assert_allclose(across[whole], 0.0, atol=1e-12)
    np.testing.assert_allclose(across[SESSIONS.kind == REST], 0.01 * G * np.hypot(*draws().level), rtol=1e-9)


def device(name: str, seed: int = 3) -> DeviceModel:
    return random_device(np.random.default_rng(seed), grade=name)


def dwells(n: int, *, duration_s: float = 2.0, seed: int = 4) -> ImposedDwells:
    draw = np.random.default_rng(seed)
    return ImposedDwells(
        start_s=600.0 + 5.0 * np.arange(n),
        duration_s=np.full(n, duration_s),
        rate_b=draw.uniform(-1.5, 1.5, (n, 3)),
        force_b=np.tile([0.0, 0.0, G], (n, 1)),
    )


def drawn(made: DeviceModel, imposed: ImposedDwells, seed: int = 0, name: str = "gyro") -> np.ndarray:
    chain = made.gyro if name == "gyro" else made.accel
    normals = np.random.default_rng(seed).standard_normal((len(imposed.start_s), 3, numbers_of_dwell(chain)))
    return mean_readings(made, name, imposed, normals, np.arange(len(imposed.start_s)))  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["enc03j_3031", "bmi270"])
def test_without_noise_a_dwell_is_the_mean_of_the_samples(name: str) -> None:
    quiet = device(name)
    bare = {"white_noise": None, "instability": None, "random_walk": None, "hysteresis": None, "adc": None}
    quiet = replace(quiet, gyro=replace(quiet.gyro, **bare), accel=replace(quiet.accel, **bare))
    imposed = dwells(3)
    gyro, accel = drawn(quiet, imposed), drawn(quiet, imposed, name="accel")
    for k, (start_s, rate) in enumerate(zip(imposed.start_s.tolist(), imposed.rate_b, strict=True)):
        force = np.tile([0.0, 0.0, G], (200, 1))
        motion = motion_of(np.arange(200) / 100.0, np.tile(rate, (200, 1)), force, angular_acceleration_b=0.0 * force)
        record = run(quiet, motion, temp_c=25.0, power_on_s=start_s).record
        # the warm-up dies away by 1e-7 of a reading over two seconds
        np.testing.assert_allclose(gyro[k], np.mean(record.gyro, axis=0), rtol=1e-6)  # type: ignore[arg-type]
        np.testing.assert_allclose(accel[k], np.mean(record.accel, axis=0), rtol=1e-9)  # type: ignore[arg-type]


@pytest.mark.parametrize("sd", [0.4, 1.5])
def test_scatter_of_the_mean_of_rounded_readings_is_that_of_samples(sd: float) -> None:
    n, runs, draw = 200, 2000, np.random.default_rng(8)
    exact = device("mpu6050")
    bare = {"instability": None, "random_walk": None, "warm_up": None}
    walk = np.full(3, sd / exact.gyro.gain / 10.0)  # sd codes at 100 Hz
    noisy = replace(exact, gyro=replace(exact.gyro, **bare, white_noise=WhiteNoise(random_walk=walk)))
    quiet = replace(noisy, gyro=replace(noisy.gyro, white_noise=None, adc=None))
    found = drawn(noisy, dwells(runs)) - drawn(quiet, dwells(runs)) * noisy.gyro.gain / quiet.gyro.gain
    level = draw.uniform(size=(runs, 1))
    of_samples = np.rint(level + sd * draw.standard_normal((runs, n))).mean(axis=1, keepdims=True) - level
    assert found.std() == pytest.approx(
        of_samples.std(), rel=0.08
    )  # 2000 draws: 1.6 % each way; bias of 0.013 codes at 0.4


def test_the_drift_between_dwells_has_the_covariance_of_its_processes() -> None:
    """One process and the walk: variances and covariances of means over dwells of unlike length and gap, from the integrals."""
    tau, sd, k, runs, rng = 30.0, 0.004, 2e-4, 4000, np.random.default_rng(6)
    start, length = np.array([0.0, 2.5, 40.0, 47.0]), np.array([2.0, 6.0, 2.0, 50.0])
    drift, numbers = np.zeros((4 * runs, 3)), rng.standard_normal((4 * runs, 3, 5))
    sessions, rows = np.arange(0, 4 * runs + 1, 4), np.arange(4 * runs)
    times = np.tile(start, runs) + 600.0, np.tile(length, runs)
    add_drift(numbers, rows, *times, sessions, np.array([tau]), np.full((1, 3), sd), np.full(3, k), drift)
    means = drift.reshape(runs, 4, 3)
    for i in range(4):
        for j in range(i + 1):
            s = start[i] + length[i] * (np.arange(400) + 0.5) / 400.0
            t = start[j] + length[j] * (np.arange(400) + 0.5) / 400.0
            apart = np.abs(s[:, None] - t[None, :])
            wanted = (sd * sd * np.exp(-apart / tau)).mean() + k * k * np.minimum(s[:, None], t[None, :]).mean()
            found = (means[:, i] * means[:, j]).mean()
            own = sd * sd + k * k * 100.0
            show(f"covariance of dwells {i} and {j}, of the process' variance", found / own, f"{wanted / own:.3f}")
            assert found == pytest.approx(wanted, abs=0.05 * own)  # 12,000 products: 1.3 % each way at most
