"""A twin of a device that is known: every parameter comes back within what its standard error says."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from testkit.data import show
from undrift.record import Record
from undrift.sim.device.effects import Adc, LeverArm, Offset, Sampling, Scale, SensorChain, WhiteNoise
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.simulate import simulate_device
from undrift.sim.motion.poses import OpticsSettings, see
from undrift.sim.motion.tasks import Task, draw_task
from undrift.twin.fit import Twin, fit_twin
from undrift.twin.held_out import compare_held_out, device_of
from undrift.units import STANDARD_GRAVITY

RATE_HZ, STEP_DPS = 200.0, 0.12
MATRIX = np.array([[1.004, 0.003, -0.005], [-0.002, 0.997, 0.004], [0.006, -0.001, 1.002]])
ACCEL_MATRIX = np.array([[0.995, -0.001, 0.002], [0.003, 1.006, -0.002], [0.001, 0.004, 0.999]])
GYRO_OFFSET, ACCEL_OFFSET = np.array([0.004, -0.003, 0.002]), np.array([0.02, -0.04, 0.03])
ARM = np.array([0.004, -0.012, 0.03])
GYRO_DELAY, ACCEL_DELAY = 0.0042, 0.0026
GYRO_WALK, ACCEL_WALK = 2e-4, 3e-3


def chain(matrix, offset, walk, unit):
    gain = np.linalg.norm(matrix, axis=1)
    return SensorChain(
        unit=unit,
        scale=Scale(nominal_sensitivity=1.0, error=gain - 1.0, axes=matrix / gain[:, None]),
        offset=Offset(constant=offset),
        white_noise=WhiteNoise(random_walk=np.full(3, walk)),
    )


def true_device():
    step = np.radians(STEP_DPS)
    gyro = replace(
        chain(MATRIX, GYRO_OFFSET, GYRO_WALK, "rad/s"),
        adc=Adc(bits=16, reference=step * 2.0**15, rounding="toward_zero", codes=False),
    )
    accel = replace(
        chain(ACCEL_MATRIX, ACCEL_OFFSET, ACCEL_WALK, "m/s2"), lever_arm=LeverArm(arms=np.tile(ARM, (3, 1)))
    )
    sampling = Sampling(
        sample_rate_hz=RATE_HZ,
        gyro_delay_s=np.full(3, 0.5 / RATE_HZ - GYRO_DELAY),
        accel_delay_s=np.full(3, -ACCEL_DELAY),
    )
    return DeviceModel(serial="known", gyro=gyro, accel=accel, sampling=sampling)


def said(task: Task, time: np.ndarray, rng: np.random.Generator) -> Record:
    # Asked at the delayed instants, so that noise stays white: taking samples between those of the motion smooths it.
    device = replace(true_device(), sampling=Sampling())
    late = simulate_device(device, task.at(time - GYRO_DELAY + 0.5 / RATE_HZ, STANDARD_GRAVITY), rng=rng).record
    later = simulate_device(device, task.at(time - ACCEL_DELAY, STANDARD_GRAVITY), rng=rng).record
    return replace(late, time=time, accel=later.accel)


@cache
def fitted() -> Twin:
    records, references = [], []
    for seed in (1, 2):
        rng = np.random.default_rng(seed)
        task = draw_task("free", rng=rng, rest_s=12.0)
        time = np.arange(round(task.duration_s * RATE_HZ)) / RATE_HZ
        records.append(said(task, time, rng))
        references.append(see(task, rng=rng, settings=OpticsSettings(sample_rate_hz=120.0, angle_sd=3e-4)))
    return fit_twin(records, references, names=["one", "two"])


def found(name: str) -> tuple[float, float]:
    parameter = next(p for p in fitted().parameters if p.name == name)
    assert parameter.identifiable, parameter.reason
    return float(parameter.value), parameter.standard_error


def truth() -> dict[str, float]:
    names = [a + b for a in "xyz" for b in "xyz"]
    known = {"gyro_delay": GYRO_DELAY, "accel_delay": ACCEL_DELAY}
    known |= dict(zip((f"gyro_matrix_{n}" for n in names), np.linalg.inv(MATRIX).ravel(), strict=True))
    known |= dict(zip((f"accel_matrix_{n}" for n in names), np.linalg.inv(ACCEL_MATRIX).ravel(), strict=True))
    for what, value in (("gyro_offset", GYRO_OFFSET), ("accel_offset", ACCEL_OFFSET), ("lever_arm", ARM)):
        known |= {f"{what}_{axis}": value[k] for k, axis in enumerate("xyz")}
    known |= {f"gyro_angle_random_walk_{axis}": GYRO_WALK for axis in "xyz"}
    return known | {f"accel_velocity_random_walk_{axis}": ACCEL_WALK for axis in "xyz"}


@pytest.mark.slow
def test_parameters_come_back_within_their_standard_error():
    z = {}
    for name, value in truth().items():
        got, error = found(name)
        z[name] = (got - value) / error
        print(f"  {name}: {got:.6g} +- {error:.2g}, true {value:.6g}, {z[name]:+.1f} standard errors")
    worst = max(z, key=lambda name: abs(z[name]))
    show("largest departure, standard errors", f"{abs(z[worst]):.1f} ({worst})", 5.0)
    show("rms over parameters", f"{np.sqrt(np.mean(np.square(list(z.values())))):.2f}", 2.0)
    assert abs(z[worst]) < 5.0  # 40 parameters, errors from a minute of blocks
    assert np.sqrt(np.mean(np.square(list(z.values())))) < 2.0


@pytest.mark.slow
def test_standard_errors_are_small_enough_to_be_of_use():
    assert max(found(f"gyro_matrix_{a}{b}")[1] for a in "xyz" for b in "xyz") < 1e-3
    assert max(found(f"accel_matrix_{a}{b}")[1] for a in "xyz" for b in "xyz") < 3e-3
    assert max(found(f"lever_arm_{a}")[1] for a in "xyz") < 1e-3
    assert found("gyro_delay")[1] < 1e-4


def test_the_device_of_the_twin_is_the_device():
    device = device_of(fitted(), sample_rate_hz=RATE_HZ)
    true = true_device()
    assert device.gyro.forward_matrix == pytest.approx(true.gyro.forward_matrix, abs=2e-3)
    assert device.accel.forward_matrix == pytest.approx(true.accel.forward_matrix, abs=5e-3)
    assert device.sampling.gyro_delay_s == pytest.approx(true.sampling.gyro_delay_s, abs=1e-4)
    assert device.gyro.adc is not None
    assert device.gyro.adc.step == pytest.approx(np.radians(STEP_DPS), rel=1e-6)


@pytest.mark.slow
def test_held_out_windows_are_as_good_as_the_poses():
    trials = compare_held_out(fitted(), rng=np.random.default_rng(3), lengths_s=(5.0,))
    assert [t.recording for t in trials] == ["one", "two"]
    for t in trials:
        median = float(np.degrees(np.nanmedian(t.pitch)))
        show(f"{t.recording}: largest pitch difference in 5 s, median, deg", f"{median:.3f}", 0.15)
        assert median < 0.15  # poses of 0.017 deg noise
