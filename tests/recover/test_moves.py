"""Free poses and the turns between them give back the device; the error is the least that the noise allows.

The bound takes all readings together: mean accelerometer and gyroscope readings of each still, and what the turns say of
the directions of gravity before and after. Unknown directions are nuisance parameters. Axes: those in which the
accelerometer's matrix is upper triangular, as the method has no other.
"""

from dataclasses import dataclass

import numpy as np
import pytest

from testkit.cohorts import COHORTS
from testkit.cramer_rao import Array, Tally, information, jacobian, white_device
from testkit.poses import fit_poses
from testkit.quiet import without_noise
from testkit.twins import rotation_matrices
from undrift.calibration.moves import fit_moves
from undrift.frames import quaternion_product
from undrift.record import Record
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.simulate import simulate_device
from undrift.sim.motion.bench import BenchSettings, bench_motion
from undrift.sim.motion.motion import Motion, turn_quaternion
from undrift.units import STANDARD_GRAVITY

SETTINGS = BenchSettings(poses=24, still_s=1.0, first_still_s=1.0, move_s=1.0, sample_rate_hz=50.0)
POSES = SETTINGS.poses
UPPER = np.triu_indices(3)
SEEN = [0, 1, 2, 4, 5, 8, 9, 10, 11]  # of m_xx .. m_zz, offset_x ..: those that the length of gravity shows


@dataclass(frozen=True)
class Moves:
    """What one motion says of gains and offsets, device apart: derivatives in physical units, case axes."""

    up: Array  # (K, 3) direction of gravity in each still
    samples: Array  # (K,) of each still
    turned: Array  # (J, 3, 3) C_j: n in the end frame from n in the start frame
    by_gain: Array  # (J, 3, 3, 3) of the arrived direction by E in w = (1 + E) w_true
    by_rate: Array  # (J, 3, 3) of the arrived direction by e in w = w_true + e
    spread: Array  # (J, 3, 3, 3, 3) sum of C_i (x) C_i dt^2, C_i from sample i to the end frame


def moves_of(motion: Motion) -> Moves:
    up = np.array([motion.force_b[s.start] for s in motion.stills]) / motion.gravity_m_s2
    samples = np.array([s.stop - s.start for s in motion.stills])
    first = np.array([s.stop - 1 for s in motion.stills[:-1]])
    count = motion.stills[1].start - first[0]
    inside = first[:, None] + np.arange(1, count + 1)
    rate, dt = motion.mean_rate_b[inside], 1.0 / motion.sample_rate_hz

    def arrived(x: Array) -> Array:
        return np.einsum("jab,jb->ja", _end(rate @ (np.eye(3) + x[:9].reshape(3, 3)).T + x[9:], dt)[0], up[:-1])

    by = jacobian(arrived, np.zeros(12), 1e-4).reshape(len(first), 3, 12)
    turned, to_end = _end(rate, dt)
    spread = np.einsum("jiab,jicd->jacbd", to_end, to_end) * dt**2
    return Moves(up, samples, turned, by[:, :, :9].reshape(-1, 3, 3, 3), by[:, :, 9:], spread)


def _end(rate: Array, dt: float) -> tuple[Array, Array]:
    """Return C_j and, for each sample, the matrix from its frame to the end frame."""
    angle = np.linalg.norm(rate, axis=-1) * dt
    axis = rate * dt / np.where(angle > 0, angle, 1.0)[..., None]
    steps = np.concatenate((np.cos(angle / 2)[..., None], np.sin(angle / 2)[..., None] * axis), axis=-1)
    q = np.tile(turn_quaternion(np.array([1.0, 0, 0]), np.array(0.0)), (len(rate), 1))
    frames = []
    for k in range(rate.shape[1]):
        q = quaternion_product(q, steps[:, k])
        frames.append(rotation_matrices(q))
    to_start = np.stack(frames, axis=1)
    whole = to_start[:, -1].transpose(0, 2, 1)
    return whole, np.einsum("jab,jibc->jiac", whole, to_start)


def triangular_truth(device: DeviceModel) -> tuple[Array, Array, Array, Array]:
    """Return accelerometer p (m upper row by row, offset), gyroscope M and o, and the rotation from the case axes."""
    q, r = np.linalg.qr(np.linalg.inv(device.accel.forward_matrix))
    sign = np.sign(np.diag(r))
    turn = (q * sign).T
    p = np.concatenate(((sign[:, None] * r)[UPPER], device.accel.raw_offset))
    return p, turn @ np.linalg.inv(device.gyro.forward_matrix), device.gyro.raw_offset, turn


def directions(angles: Array) -> Array:
    """Return unit vectors of azimuths and heights (2 K)."""
    azimuth, height = angles[:POSES], angles[POSES:]
    return np.stack((np.cos(height) * np.cos(azimuth), np.cos(height) * np.sin(azimuth), np.sin(height)), axis=1)


def accel_means(theta: Array) -> Array:
    """Return mean readings for p (9) and azimuths and heights (2 K)."""
    m = np.zeros((3, 3))
    m[UPPER] = theta[:6]
    return np.linalg.solve(m, STANDARD_GRAVITY * directions(theta[9:]).T).T + theta[6:9]


def bounds(device: DeviceModel, moves: Moves) -> tuple[Array, Array]:
    """Return the bound of p (9) from the stills alone and of M, o (12) from everything, standard deviations."""
    p, gyro, _, turn = triangular_truth(device)
    up = moves.up @ turn.T
    theta = np.concatenate((p, np.arctan2(up[:, 1], up[:, 0]), np.arcsin(up[:, 2])))
    steps = np.concatenate((np.full(6, 1e-4 * p[0]), np.full(3, 1e-2), np.full(2 * POSES, 1e-5)))
    variance = (device.accel.gain * device.accel.white_noise.random_walk) ** 2 * SETTINGS.sample_rate_hz
    accel = jacobian(accel_means, theta, steps)
    stills = information(accel, (variance / moves.samples[:, None]).ravel())
    alone = np.linalg.inv(stills[:9, :9] - stills[:9, 9:] @ np.linalg.solve(stills[9:, 9:], stills[9:, :9]))

    turned = turn @ moves.turned @ turn.T
    by_gain = np.einsum("pa,qb,rc,jabc->jpqr", turn, turn, turn, moves.by_gain)
    by_rate = turn @ moves.by_rate @ turn.T
    by_matrix = np.einsum("jpqr,sr->jpqs", by_gain, np.linalg.inv(gyro)).reshape(-1, 3, 9)  # E = dM K
    lean = jacobian(directions, theta[9:], 1e-5).reshape(POSES, 3, -1)
    design = np.concatenate((by_matrix, -by_rate @ gyro, turned @ lean[:-1] - lean[1:]), axis=2)
    across = np.linalg.svd(up[1:, None, :])[2][:, 1:]  # (J, 2, 3): two unit vectors across
    sigma = turn.T @ gyro * (device.gyro.gain * device.gyro.white_noise.random_walk) * np.sqrt(SETTINGS.sample_rate_hz)
    noise = np.einsum("jacbd,bd->jac", moves.spread, sigma @ sigma.T)
    covariance = across @ (turn @ noise @ turn.T) @ across.transpose(0, 2, 1)
    design = across @ design

    whole = np.zeros((21 + 2 * POSES, 21 + 2 * POSES))  # gyro 12, then accel 9 and directions
    whole[12:, 12:] = stills
    of_turns = np.einsum("jap,jaq->pq", design, np.linalg.solve(covariance, design))
    places = np.concatenate((np.arange(12), np.arange(21, 21 + 2 * POSES)))
    whole[np.ix_(places, places)] += of_turns
    rest = (device.gyro.gain * device.gyro.white_noise.random_walk) ** 2 * SETTINGS.sample_rate_hz / moves.samples.sum()
    whole[np.arange(9, 12), np.arange(9, 12)] += 1.0 / rest
    together = np.linalg.inv(whole[:12, :12] - whole[:12, 12:] @ np.linalg.solve(whole[12:, 12:], whole[12:, :12]))
    return np.sqrt(np.diag(alone)), np.sqrt(np.diag(together))


def still_means(record: Record, motion: Motion) -> Array:
    assert record.accel is not None
    return np.array([record.accel[s.start : s.stop].mean(axis=0) for s in motion.stills])


def test_poses_and_turns_give_back_the_device_without_noise() -> None:
    rng = np.random.default_rng(1)
    for _ in range(5):
        device = without_noise(white_device(rng))
        motion = bench_motion("multi_position", rng=rng, settings=SETTINGS)
        record = simulate_device(device, motion, rng=rng).record
        p, gyro, offset, _ = triangular_truth(device)
        accel = fit_poses(still_means(record, motion), gravity=STANDARD_GRAVITY).model
        np.testing.assert_allclose(accel.matrix[UPPER], p[:6], atol=1e-10 * p[0])  # rounding of 1e-16 times condition
        np.testing.assert_allclose(accel.offset, p[6:], atol=1e-6)  # counts; g is 4096
        model = fit_moves((record,), motion.stills, accel).model
        np.testing.assert_allclose(model.matrix, gyro, atol=1e-7 * gyro[0, 0])  # rounding through the iterations
        np.testing.assert_allclose(model.offset, offset, atol=1e-5)  # counts; 1 rad/s is 940


@pytest.mark.slow
@pytest.mark.parametrize("devices", COHORTS)
def test_errors_reach_the_bound_and_intervals_hold(devices: int) -> None:
    rng = np.random.default_rng(2)
    accel_tally, gyro_tally = Tally.of("multi-position accelerometer"), Tally.of("multi-position gyroscope")
    for number in range(devices):
        if number % (devices // 10) == 0:  # ten sessions of 24 poses, a tenth of the devices each
            motion = bench_motion("multi_position", rng=rng, settings=SETTINGS)
            moves = moves_of(motion)
        device = white_device(rng)
        record = simulate_device(device, motion, rng=rng).record
        sd = (device.accel.gain * device.accel.white_noise.random_walk) * np.sqrt(50.0 / moves.samples[:, None])
        p, matrix, offset, _ = triangular_truth(device)
        accel = fit_poses(still_means(record, motion), gravity=STANDARD_GRAVITY, standard_errors=sd).model
        gyro = fit_moves((record,), motion.stills, accel).model
        accel_bound, gyro_bound = bounds(device, moves)
        error = np.concatenate((accel.matrix[UPPER], accel.offset)) - p
        accel_tally.add(error, accel_bound, accel.standard_uncertainty[SEEN])
        error = np.concatenate(((gyro.matrix - matrix).ravel(), gyro.offset - offset))
        gyro_tally.add(error, gyro_bound, gyro.standard_uncertainty[:12])
    accel_tally.check(devices)
    gyro_tally.check(devices)
