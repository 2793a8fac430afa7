"""Rival procedures: exact motions of a trolley, an inclined plane, a piston and a robot arm."""

import numpy as np
import pytest

from undrift.errors import InputError
from undrift.frames import integrate_strapdown, quaternion_conjugate, quaternion_product, rotate
from undrift.sim.bench_errors import BenchErrors
from undrift.sim.motion.bench import (
    BenchSettings,
    RivalKind,
    RivalSettings,
    bench_motion,
    rig_of,
    rival_motion,
)

KINDS: tuple[RivalKind, ...] = ("trolley", "inclined_plane", "piston", "robot_arm")
SHORT = RivalSettings(still_s=1.0, run_s=6.0, plane_angles=(-1.0, 0.0, 0.5))


@pytest.mark.parametrize("kind", KINDS)
def test_rates_belong_to_the_orientation_and_repeat_by_seed(kind: RivalKind) -> None:
    motion = rival_motion(kind, rng=np.random.default_rng(1), settings=SHORT)
    q = integrate_strapdown(motion.mean_rate_b, motion.time, motion.q_nb[0])
    sine = np.linalg.norm(quaternion_product(quaternion_conjugate(motion.q_nb), q)[:, 1:], axis=1)
    assert sine.max() < 1e-12  # rounding of some thousand products
    again = rival_motion(kind, rng=np.random.default_rng(1), settings=SHORT)
    assert np.array_equal(motion.force_b, again.force_b)
    assert motion.angular_acceleration_b is not None
    grown = np.cumsum(motion.angular_acceleration_b, axis=0) / motion.sample_rate_hz
    assert np.abs(motion.rate_b - grown).max() < 0.02 * np.abs(motion.rate_b).max()  # a rectangle rule at 100 Hz
    for still in motion.stills:
        assert np.abs(motion.rate_b[still.start : still.stop]).max() < 1e-12
        np.testing.assert_allclose(
            np.linalg.norm(motion.force_b[still.start : still.stop], axis=1), 9.80665, rtol=1e-12
        )


def test_a_trolley_shakes_each_axis_in_turn_by_a_sinusoid() -> None:
    settings = RivalSettings(shake=0.0)
    motion = rival_motion("trolley", rng=np.random.default_rng(1), settings=settings)
    peak = settings.trolley_stroke * (2.0 * np.pi * 0.8) ** 2  # A w^2
    for axis in range(3):
        force = motion.force_b[:, axis]
        swinging = (np.abs(motion.rate_b).max(axis=1) == 0.0) & (motion.moving == 1.0)
        across = np.abs(motion.force_b[:, (axis + 1) % 3] - 9.80665) < 1e-9  # this axis lies along the rail
        assert np.abs(force[swinging & across]).max() == pytest.approx(
            peak, rel=0.02
        )  # nearest sample; the swell helps
    rough = rival_motion(
        "trolley", rng=np.random.default_rng(1), settings=RivalSettings(errors=BenchErrors(mount_tilt=0.01))
    )
    assert np.std(rough.force_b - motion.force_b) > 0.05


def test_a_piston_adds_its_acceleration_to_gravity_on_the_upright_axis_alone() -> None:
    motion = rival_motion("piston", rng=np.random.default_rng(1))
    lifted = (np.abs(motion.rate_b).max(axis=1) == 0.0) & (motion.moving == 1.0)
    upright = rotate(motion.q_nb[lifted], motion.force_b[lifted])
    assert np.abs(upright[:, :2]).max() < 1e-9
    assert np.abs(upright[:, 2] - 9.80665).max() == pytest.approx(0.02 * (8.0 * np.pi) ** 2, rel=0.02)
    for axis in range(3):
        assert motion.force_b[lifted, axis].max() > 20.0


def test_an_inclined_plane_shows_gravity_at_each_angle() -> None:
    motion = rival_motion("inclined_plane", rng=np.random.default_rng(1), settings=SHORT)
    assert len(motion.stills) == 9
    seen = np.array([motion.force_b[still.start] for still in motion.stills]) / 9.80665
    wanted = [
        np.cos(angle) * np.eye(3)[(axis + 2) % 3] + np.sin(angle) * np.eye(3)[(axis + 1) % 3]
        for axis in range(3)
        for angle in SHORT.plane_angles
    ]
    np.testing.assert_allclose(seen, wanted, atol=1e-12)
    inclined = RivalSettings(errors=BenchErrors(inclination=0.01), still_s=0.5)
    tilted = rival_motion("inclined_plane", rng=np.random.default_rng(1), settings=inclined)
    up = np.array([tilted.force_b[still.start] for still in tilted.stills]) / 9.80665
    level = rival_motion("inclined_plane", rng=np.random.default_rng(1), settings=RivalSettings(still_s=0.5))
    exact = np.array([level.force_b[still.start] for still in level.stills]) / 9.80665
    assert 0.007 < np.sqrt(np.mean(np.sum((up - exact) ** 2, axis=1))) < 0.013  # 39 angles of 0.01 rad


def seen_up(kind: str, errors: BenchErrors, still: int) -> np.ndarray:
    """Return which way is up for the case in one still of a procedure, drawn from the same state whatever it is."""
    rng = np.random.default_rng(7)
    if kind == "rate_table":
        motion = bench_motion("rate_table", rng=rng, settings=BenchSettings(errors=errors, turn_rates=(1.0,)))
    else:
        settings = RivalSettings(errors=errors, plane_angles=(0.0,), trolley_hz=(0.5,), piston_hz=(1.0,))
        motion = rival_motion(kind, rng=rng, settings=settings)  # type: ignore[arg-type]
    start = motion.stills[still].start
    return np.asarray(motion.force_b[start] / 9.80665)


def test_every_rig_has_the_same_mountings_and_the_same_level() -> None:
    mounted = BenchErrors(mount_tilt=0.01)
    for axis, still in enumerate((0, 2, 4)):  # the two drives rest after their run too
        table, piston = seen_up("rate_table", mounted, axis), seen_up("piston", mounted, still)
        trolley, plane = seen_up("trolley", mounted, still), seen_up("inclined_plane", mounted, axis)
        along, across, third = axis, (axis + 1) % 3, (axis + 2) % 3
        assert abs(piston[across]) > 1e-4  # rad, or nothing was drawn
        np.testing.assert_allclose(table, piston, atol=1e-4)  # to second order in the tilt
        np.testing.assert_allclose(-trolley[along], piston[across], atol=2e-4)
        np.testing.assert_allclose(-plane[along], piston[third], atol=2e-4)
        np.testing.assert_allclose(-plane[across], trolley[third], atol=2e-4)
    mount, _, _ = rig_of(mounted, np.random.default_rng(7))
    first = seen_up("piston", mounted, 0)
    np.testing.assert_allclose(first[1:], (mount[2], -mount[1]), atol=1e-4)  # t x e_x, of optics and an arm too
    off_level = BenchErrors(level=0.01)
    seen = [
        np.arccos(seen_up(kind, off_level, 0).max()) for kind in ("rate_table", "piston", "trolley", "inclined_plane")
    ]
    assert seen[0] > 1e-3
    np.testing.assert_allclose(seen, seen[0], rtol=1e-6)


def test_a_drive_errs_in_stroke_frequency_and_form() -> None:
    def lifted(errors: BenchErrors) -> tuple[np.ndarray, np.ndarray]:
        settings = RivalSettings(errors=errors, piston_hz=(1.0,), run_s=20.0)
        motion = rival_motion("piston", rng=np.random.default_rng(3), settings=settings)
        first = motion.stills[0].stop
        push = motion.force_b[first + 300 : first + 1700, 0] - 9.80665  # without the swell at both ends
        return np.abs(np.fft.rfft(push * np.hanning(1400))), np.fft.rfftfreq(1400, 0.01)

    exact, _ = lifted(BenchErrors())
    longer, frequency_hz = lifted(BenchErrors(stroke=0.01))
    bent, _ = lifted(BenchErrors(harmonic=0.01))
    own, second = np.argmin(np.abs(frequency_hz - 1.0)), np.argmin(np.abs(frequency_hz - 2.0))
    assert 1e-4 < abs(longer[own] / exact[own] - 1.0) < 0.04
    assert 1e-3 < bent[second] / exact[own] < 0.16  # acceleration: four times the displacement's part
    assert exact[second] < 1e-4 * exact[own]
    slower = rival_motion(
        "piston", rng=np.random.default_rng(3), settings=RivalSettings(errors=BenchErrors(table_rate=0.01))
    )
    plain = rival_motion("piston", rng=np.random.default_rng(3))
    assert np.abs(slower.force_b - plain.force_b).max() > 1.0


def test_a_table_reads_what_its_servo_achieves_in_whole_counts() -> None:
    errors = BenchErrors(servo=2e-4, encoder_lines=10_000)
    motion = bench_motion(
        "rate_table", rng=np.random.default_rng(1), settings=BenchSettings(errors=errors, dwell_s=2.0)
    )
    count = np.pi / 20_000.0
    commanded = np.array([rate for _ in range(3) for size in BenchSettings().turn_rates for rate in (size, -size)])
    read = np.array([turn.turn_rate for turn in motion.turns])
    true = np.array([motion.rate_b[t.start : t.stop, "xyz".index(t.axis)].mean() for t in motion.turns])
    np.testing.assert_allclose(read * 2.0 / count, np.round(read * 2.0 / count), atol=1e-6)
    assert np.abs(read - true).max() < 1.01 * count / 2.0  # a count over 2 s
    assert 0.7e-4 < np.std(true - commanded) < 1.3e-4  # 2e-4 rad over 2 s, 102 dwells


def test_a_robot_arm_excites_every_axis() -> None:
    motion = rival_motion("robot_arm", rng=np.random.default_rng(2))
    turning = np.std(motion.rate_b, axis=0)
    assert turning.min() > 0.3 * turning.max()
    assert 1.0 < np.abs(motion.rate_b).max() < 300.0 * np.pi / 180.0  # within the gyroscope's range
    spread = np.linalg.eigvalsh(np.cov(motion.force_b.T))
    assert spread.min() > 1.0  # (m/s2)^2: gravity visits all directions


def test_a_procedure_that_is_not_one_is_refused() -> None:
    with pytest.raises(InputError, match="wanted one of trolley, inclined_plane, piston, robot_arm, got 'swing'"):
        rival_motion("swing", rng=np.random.default_rng(0))  # type: ignore[arg-type]
