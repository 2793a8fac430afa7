"""A sensor on skin: a spring's known answers, a motion that is consistent in itself, and nothing where all sizes are 0."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from undrift.frames import quaternion_conjugate, quaternion_product, rotate, rotation_vector
from undrift.record import Reference
from undrift.sim.motion.motion import Motion, Step, Sway, mean_rate
from undrift.sim.motion.poses import fit_pose_spline
from undrift.sim.motion.tasks import Task, draw_task
from undrift.sim.motion.worn import FINE_HZ, WornErrors, wear_on_skin
from undrift.study.plan import RecordedTask

DEG = np.pi / 180.0
G = 9.81
TISSUE = WornErrors(tissue=0.1 * DEG, tissue_hz=13.0, tissue_damping=0.15)


@dataclass(frozen=True)
class Shaken:
    """A level body that is shaken upright by a sinusoid of acceleration."""

    frequency_hz: float
    acceleration: float = 1.0
    duration_s: float = 12.0
    contacts_s: tuple[float, ...] = ()

    def at(self, time: np.ndarray, gravity_m_s2: float) -> Motion:
        size = self.acceleration / (2.0 * np.pi * self.frequency_hz) ** 2
        shake = Sway((size,), (self.frequency_hz,), (0.0,), 0.0, self.duration_s, 2.0)
        return Task(name="free", duration_s=self.duration_s, moving_s=(0.0, self.duration_s), up=(shake,)).at(
            time, gravity_m_s2
        )


def worn(performed: object, errors: WornErrors) -> tuple[Motion, Motion]:
    """The bone's and the sensor's motion."""
    sensor = wear_on_skin(performed, errors, np.random.default_rng(1), G)  # type: ignore[arg-type]
    return performed.at(sensor.time, G), sensor  # type: ignore[attr-defined]


def leant(bone: Motion, sensor: Motion) -> np.ndarray:
    """Rotation of the sensor against the bone, rad (N, 3)."""
    return rotation_vector(quaternion_product(quaternion_conjugate(bone.q_nb), sensor.q_nb))


@pytest.mark.parametrize(("frequency_hz", "gain"), [(1.0, 1.0), (13.0, 1.0 / 0.3), (39.0, 1.0 / 8.05)])
def test_the_sensor_turns_as_a_spring_does_below_at_and_above_its_resonance(frequency_hz: float, gain: float) -> None:
    bone, sensor = worn(Shaken(frequency_hz), TISSUE)
    steady = slice(round(5.0 * FINE_HZ), round(9.0 * FINE_HZ))
    angle = leant(bone, sensor)[steady]
    x = frequency_hz / 13.0
    ratio = 1.0 / abs(1.0 - x * x + 0.3j * x)  # the textbook's, independent of the code
    assert ratio == pytest.approx(gain, rel=0.02)
    assert np.abs(angle[:, 1]).max() == pytest.approx(0.1 * DEG * ratio, rel=0.01)  # an upward shake pitches it
    assert np.abs(angle[:, [0, 2]]).max() < 1e-9
    force = (sensor.force_b - bone.force_b)[steady, 2]  # d'' = x^2 ratio; the sensor leans by a degree at most
    assert np.abs(force).max() == pytest.approx(x * x * ratio, rel=0.03)


@pytest.mark.parametrize("name", ["sit_to_stand", "step"])
def test_rate_and_force_of_a_worn_sensor_belong_to_its_orientation(name: str) -> None:
    task = draw_task(name, rng=np.random.default_rng(3))  # type: ignore[arg-type]
    bone, sensor = worn(task, replace(TISSUE, impact=0.5 * G, vibration=20.0 * DEG))
    np.testing.assert_allclose(sensor.mean_rate_b[1:], mean_rate(sensor.time, sensor.q_nb, sensor.rate_b[0])[1:])
    between = 0.5 * (sensor.rate_b[1:] + sensor.rate_b[:-1])  # a trapezoid at 800 Hz: (w h)^2 / 12 of 80 Hz is 0.03
    assert np.abs(between - sensor.mean_rate_b[1:]).max() < 0.04 * np.abs(sensor.rate_b).max()
    size = np.degrees(np.abs(leant(bone, sensor)).max())
    assert 0.05 < size < 5.0
    still = sensor.time < 0.5 * task.moving_s[0]
    shown = rotate(sensor.q_nb, sensor.force_b)[still]
    assert np.abs(shown - [0.0, 0.0, G]).max() < 1e-6  # at rest it feels gravity alone


def test_a_sensor_without_any_effect_moves_as_the_bone() -> None:
    bone, sensor = worn(draw_task("step", rng=np.random.default_rng(3)), WornErrors())
    for name in ("q_nb", "rate_b", "mean_rate_b", "force_b", "angular_acceleration_b"):
        np.testing.assert_allclose(getattr(sensor, name), getattr(bone, name), atol=1e-12)
    assert not WornErrors().on


def test_impacts_come_as_the_seat_is_left_and_as_each_foot_comes_down_and_make_the_tissue_ring() -> None:
    rise = draw_task("sit_to_stand", rng=np.random.default_rng(3))
    step = draw_task("step", rng=np.random.default_rng(3))
    assert (len(rise.contacts_s), len(step.contacts_s)) == (1, 2)
    assert all(task.moving_s[0] < at < task.moving_s[1] for task in (rise, step) for at in task.contacts_s)
    assert draw_task("posturography", rng=np.random.default_rng(3)).contacts_s == ()
    bone, rigid = worn(rise, WornErrors(impact=2.0 * G, impact_s=0.03))
    felt = rotate(bone.q_nb, rigid.force_b - bone.force_b)
    # its top may lie half a sample aside: (pi / 1600 / 0.03)^2
    assert felt[:, 2].max() == pytest.approx(2.0 * G, rel=5e-3)
    assert rigid.time[felt[:, 2].argmax()] - rise.contacts_s[0] == pytest.approx(0.015, abs=0.002)
    _, alone = worn(rise, TISSUE)
    _, rung = worn(rise, replace(TISSUE, impact=2.0 * G, impact_s=0.03))
    ringing = leant(alone, rung)[:, 1]
    after = rung.time > rise.contacts_s[0] + 0.03
    turns = np.flatnonzero(np.diff(np.sign(ringing[after])))[:4]  # half periods of the damped spring
    half = 0.5 / (13.0 * np.sqrt(1.0 - 0.15**2))
    np.testing.assert_allclose(np.diff(turns) / FINE_HZ, half, atol=2.0 / FINE_HZ)


def test_a_recorded_motion_has_its_impact_where_it_is_accelerated_upward_most() -> None:
    rise = draw_task("sit_to_stand", rng=np.random.default_rng(3))
    time = np.arange(0.0, rise.duration_s, 0.01)
    poses = Reference(time=time, q_nb=rise.at(time, G).q_nb, position=rise.position(time))
    task = RecordedTask(spline=fit_pose_spline(poses), moving_s=rise.moving_s)
    (at,) = task.contacts_s
    (rising,) = (part for part in rise.up if isinstance(part, Step))
    assert 0.0 < at - rise.contacts_s[0] < 0.5 * rising.duration_s  # upward in the first half of the rise
