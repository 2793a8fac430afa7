"""The third witness: shares of optics and gyroscopes that are known come back, with errors that hold."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.data import show
from undrift.frames import quaternion_product, rotation
from undrift.record import Record
from undrift.sim.motion.poses import OpticsSettings, see
from undrift.sim.motion.tasks import draw_task
from undrift.twin.accel import Match, match
from undrift.twin.witness import BAND_HZ, OpticsSplit, split_difference
from undrift.units import STANDARD_GRAVITY

RATE_HZ = 200.0
SIZE = 1.5e-3  # rad, 0.09 deg: root mean square of both errors together, about each axis
LINES = 80


class Errors:
    """Small turns about the axes of n, lines within the band."""

    def __init__(self, size: float, rng: np.random.Generator) -> None:
        self.frequency = rng.uniform(*BAND_HZ, LINES)
        self.phase = rng.uniform(0.0, 2.0 * np.pi, (LINES, 3))
        self.size = size * np.sqrt(2.0 / LINES)

    def at(self, time: np.ndarray) -> np.ndarray:
        angle = 2.0 * np.pi * time[:, None] * self.frequency
        return self.size * np.sin(angle[:, :, None] + self.phase).sum(axis=1)

    def rate(self, time: np.ndarray) -> np.ndarray:
        turned = 2.0 * np.pi * self.frequency
        return self.size * (turned[:, None] * np.cos((time[:, None] * turned)[:, :, None] + self.phase)).sum(axis=1)


def seen(share: float, seed: int, *, scale: float = 1.0, origin_m: float = 0.0) -> Match:
    """Return a recording whose optics hold this share of the errors' square.

    The split does not know the ``scale`` of the accelerometers, nor how far along z the optical origin is from the markers' middle.
    """
    rng = np.random.default_rng(seed)
    task = draw_task("free", rng=rng, rest_s=12.0)
    optics, gyro = (Errors(SIZE * np.sqrt(part), rng) for part in (share, 1.0 - share))
    time = np.arange(round(task.duration_s * RATE_HZ)) / RATE_HZ
    motion = task.at(time, STANDARD_GRAVITY)
    extra = np.einsum("nji,nj->ni", rotation(motion.q_nb).as_matrix(), gyro.rate(time))
    reading = motion.mean_rate_b + extra + 1e-4 * rng.standard_normal(extra.shape)
    accel = scale * motion.force_b + 0.02 * rng.standard_normal(extra.shape)
    poses = see(task, rng=rng, settings=OpticsSettings(sample_rate_hz=120.0, angle_sd=1e-4, gaps=0))
    turn = optics.at(poses.time)
    q = quaternion_product(np.column_stack((np.ones(len(turn)), 0.5 * turn)), poses.q_nb)
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    middle = origin_m * rotation(poses.q_nb).as_matrix()[:, :, 2]
    poses = replace(poses, q_nb=q, position=poses.position + np.cross(turn, middle))
    return match(Record(time=time, gyro=reading, accel=accel), poses, name="drawn")


def split(found: Match) -> OpticsSplit:
    made = split_difference(
        [found],
        [(np.eye(3), np.zeros(3), found.lag.seconds)],
        accel_delay=-0.5 / RATE_HZ,
        gravity_m_s2=STANDARD_GRAVITY,
    )
    assert isinstance(made, OpticsSplit)
    return made


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
def test_shares_come_back_with_errors_that_hold(share: float) -> None:
    found = [split(seen(share, seed)) for seed in (1, 2)]
    for one in found:
        z = (one.optics_share - share) / one.standard_error
        show(
            "share of the optics",
            f"{one.optics_share:.3f} +- {one.standard_error:.3f}, {z:+.1f} standard errors",
            share,
        )
        assert abs(z) < 3.5  # six figures in all: one in 300 would fail by chance
        assert one.standard_error < 0.15
        # Lines at the ends of the band pass by a half: the tilt is a little less than what was put in.
        assert 0.8 * SIZE < one.tilt < 1.1 * SIZE
        assert np.hypot(one.optics, one.gyro) == pytest.approx(one.tilt, rel=1e-6)


@pytest.mark.slow
def test_an_accelerometer_that_is_wrong_by_two_per_cent_leaves_the_shares() -> None:
    right, wrong = split(seen(0.5, 1)), split(seen(0.5, 1, scale=1.02))
    assert abs(wrong.optics_share - right.optics_share) < 0.2 * right.standard_error


@pytest.mark.slow
def test_an_origin_away_from_the_markers_middle_is_in_the_standard_error() -> None:
    right, wrong = split(seen(0.9, 1)), split(seen(0.9, 1, origin_m=0.01))
    moved = abs(wrong.optics_share - right.optics_share)
    show(
        "1 cm moves the share by",
        f"{moved:.3f}, standard error {wrong.standard_error:.3f}",
        "one standard deviation of three",
    )
    assert (
        0.02 < moved < 2.0 * wrong.standard_error
    )  # more than the noise of five-second blocks; one axis of the three stated


def test_too_little_motion_gives_no_split() -> None:
    found = seen(0.5, 1)
    short = replace(found, span=replace(found.span, stop_s=found.span.start_s + 30.0))
    made = split_difference(
        [short], [(np.eye(3), np.zeros(3), found.lag.seconds)], accel_delay=0.0, gravity_m_s2=STANDARD_GRAVITY
    )
    assert not isinstance(made, OpticsSplit)
    assert made.code == "twin.no_witness"
    assert made.values["wanted_s"] == 50.0
