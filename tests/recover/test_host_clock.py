"""A session whose host stamped it in bursts, with drop-outs, calibrates as well as with the device's own clock.

The simulator of the host (testkit/host.py) shares nothing with the fit of the clock (io/clock.py). Errors are those of the
gyroscope's matrix against the device's true one in the accelerometer's axes, largest element.
"""

from dataclasses import replace

import numpy as np
import pytest

from testkit.data import show
from testkit.host import HostSettings, HostStamped, stamp_on_host
from undrift.calibration.calibrate import calibrate
from undrift.errors import CalibrationError
from undrift.io.clock import fit_clock
from undrift.io.session import read_session, write_session
from undrift.model import Calibration
from undrift.record import Record, Session
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.presets import random_device
from undrift.sim.motion.bench import BenchSettings
from undrift.sim.sessions import simulate_session

MANY = BenchSettings(poses=40, still_s=4.0, move_s=1.5)
BURSTS = HostSettings(lost_share=0.001, outages=2)
WHOLE = {"stall_share": 0.0, "lost_share": 0.0, "outages": 0}
JITTER = HostSettings(interval_s=(0.004, 0.012), latency_s=0.004, **WHOLE)  # type: ignore[arg-type]
MILD = HostSettings(interval_s=(0.001, 0.004), latency_s=0.0006, **WHOLE)  # type: ignore[arg-type]


def session_of(seed: int, settings: HostSettings) -> tuple[DeviceModel, Session, HostStamped]:
    device = random_device(np.random.default_rng(seed))
    rng = np.random.default_rng(100 + seed)
    session = simulate_session("multi_position", device, rng=rng, settings=MANY, labelled=False)
    return device, session, stamp_on_host(session.records[0], rng=np.random.default_rng(200 + seed), settings=settings)


def error(made: Calibration, device: DeviceModel) -> float:
    """Return the largest element of M K - 1, K the true forward matrix in axes in which the accelerometer is upper triangular."""
    q, r = np.linalg.qr(np.linalg.inv(device.accel.forward_matrix))
    turn = (q * np.sign(np.diag(r))).T
    assert made.gyro is not None
    assert made.gyro.method == "multi-position"
    return float(np.abs(made.gyro.matrix @ device.gyro.forward_matrix @ turn.T - np.eye(3)).max())


def outcome(session: Session, record: Record, device: DeviceModel) -> float:
    """Return the error, infinity where nothing could be fitted."""
    try:
        return error(calibrate(replace(session, records=(record,))), device)
    except (CalibrationError, AssertionError):
        return float("inf")


@pytest.mark.slow
@pytest.mark.parametrize("devices", [2, 4])
@pytest.mark.parametrize(("name", "settings"), [("bursts and drop-outs", BURSTS), ("jitter", JITTER), ("mild", MILD)])
def test_regular_clock_is_as_good_as_the_true_one(name: str, settings: HostSettings, devices: int) -> None:
    errors = []
    for seed in range(devices):
        device, session, result = session_of(seed, settings)
        true = replace(result.record, time=session.records[0].time[result.kept])
        fitted = replace(result.record, time=fit_clock(result.record.time).time)
        counted = replace(result.record, time=fit_clock(result.record.time, result.counter.astype(float)).time)
        errors.append([outcome(session, record, device) for record in (true, result.record, fitted, counted)])
    largest = np.max(errors, axis=0)
    for clock, value in zip(
        ("true clock", "host's stamps", "--clock regular", "regular by the counter"), largest, strict=True
    ):
        show(f"{name}: largest gyro element error of {devices} devices, {clock}", f"{value:.2e}", "as the true clock")
    for regular in np.array(errors)[:, 2:].T:  # the host's seconds are 2e-4 longer, and thresholds may fall elsewhere
        assert (regular < 1.3 * np.array(errors)[:, 0] + 4e-4).all()
    assert largest[1] > 2.0 * largest[2] or name == "mild"


@pytest.mark.slow
def test_clock_of_session_toml_is_the_fitted_one(tmp_path) -> None:
    device, session, result = session_of(1, BURSTS)
    write_session(replace(session, records=(result.record,)), tmp_path / "s")
    path = tmp_path / "s" / "session.toml"
    path.write_text(path.read_text() + 'clock = "regular"\n')
    assert error(calibrate(read_session(path)), device) < 4e-3
