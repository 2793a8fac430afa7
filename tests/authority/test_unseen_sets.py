"""Recordings that were not used to build undrift: what is determined, against each SOURCE.md, and what is refused."""

import numpy as np
import pytest
from pymatreader import read_mat
from scipy.io import loadmat

from testkit.data import data_path, show
from testkit.findings import only
from undrift.calibration.calibrate import calibrate_from_motion
from undrift.calibration.in_motion import fit_in_motion
from undrift.calibration.noise import fit_noise
from undrift.calibration.norm import QUADRATIC_SD, fit_norm
from undrift.correction.motion import fit_motion
from undrift.errors import Implausible
from undrift.record import Record
from undrift.segments import sphere_of
from undrift.units import RADIAN_PER_DEGREE
from undrift.units import STANDARD_GRAVITY as G


def encoder(which: str) -> tuple[Record, np.ndarray]:
    """Return the sensor on the motor and the angle of its encoder, deg."""
    columns = {name: column.ravel() for name, column in loadmat(data_path("encoder_mpu6050", f"raw_{which}_slow.mat")).items()
               if name.startswith("all")}  # fmt: skip
    time = columns["all_time"]
    later = np.append(True, time[1:] > np.maximum.accumulate(time)[:-1] + 1e-4)  # stamps step back or double
    gyro, accel = (
        np.stack([columns[f"all_{kind}_2_{axis}"] for axis in "xyz"], axis=1)[later] for kind in ("gyro", "accel")
    )
    record = Record(time=time[later] - time[0], gyro=gyro, accel=accel, gyro_unit="dps", accel_unit="g")
    return record, columns["all_encoder"][later]


@pytest.mark.parametrize(("which", "axes"), [("yaw", "z"), ("roll", "xyz")])
def test_offset_from_motion_holds_the_encoder_or_keeps_its_prior(which: str, axes: str) -> None:
    record, angle = encoder(which)
    result = fit_motion(record.in_units("rad/s", "m/s2"), None).offset
    offset, spread = np.degrees(result.rate), np.degrees(np.sqrt(np.diagonal(result.covariance, axis1=1, axis2=2)))
    turned = np.cumsum(record.gyro * np.diff(record.time, prepend=0.0)[:, None], axis=0)
    known = np.column_stack((angle, record.time, np.ones(len(angle))))
    true = np.linalg.lstsq(known, turned, rcond=None)[0][1]  # rotation minus that of the encoder, per second
    for axis in axes:
        k = "xyz".index(axis)
        show(
            f"{which}, {axis}: offset, deg/s",
            f"{offset[:, k].mean():.3f} +- {spread[:, k].max():.3f}, true {true[k]:.3f}",
        )
        assert abs(offset[:, k].mean() - true[k]) < 3.0 * spread[:, k].max()
    if which == "yaw":  # gravity shows no turn about the vertical
        assert np.abs(offset[:, 2]).max() < 1e-3
        assert spread[:, 2].min() > 0.99 * result.prior[2] / RADIAN_PER_DEGREE
        assert only(result.findings, "correct.motion_offset_kept").values["axes"] == "z"


NOMINAL = 0.0163  # rad/s a count of the analog gyroscopes
BY_OPTICS = np.array([15.49, 16.07, 17.29])  # 1e-3 rad/s a count


def analog() -> Record:
    """Return the third recording of analog gyroscopes, by their nominal gain, with a sphere through the accelerometers."""
    log = loadmat(data_path("analog_gyro_with_optics", "imuRaw3.mat"))
    counts, time = log["vals"].astype(float).T, log["ts"].ravel()
    accel = counts[:, :3] * np.array([-1.0, -1.0, 1.0])
    center, radius = sphere_of(np.array([block.mean(axis=0) for block in np.array_split(accel, len(accel) // 50)]))
    gyro = (counts[:, [4, 5, 3]] - counts[:100, [4, 5, 3]].mean(axis=0)) * NOMINAL
    return Record(
        time=time - time[0], gyro=gyro, accel=(accel - center) * G / radius, gyro_unit="rad/s", accel_unit="m/s2"
    )


def test_motion_of_analog_gyroscopes_holds_their_gains_by_optics() -> None:
    model = fit_in_motion([analog()]).gyro
    gain = 1e3 * NOMINAL * np.diag(model.model.matrix)
    spread = 1e3 * NOMINAL * model.model.standard_uncertainty[[0, 4, 8]]
    show(
        "analog gyroscopes, motion alone: gains, 1e-3 rad/s a count",
        f"{gain.round(2)} +- {spread.round(2)}, optics {BY_OPTICS}",
    )
    assert (np.abs(gain - BY_OPTICS) < 3.0 * spread).all()
    assert "motion.prior" in [item.code for item in model.verdict.findings]


def test_residual_of_24_poses_is_the_stated_one() -> None:
    raw = G * loadmat(data_path("poses_and_turns_cvut", "acc24.mat"))["ACC_meas"].T
    fit = fit_norm(raw, gravity=G, variances=np.full(raw.shape, 1e-8), quadratic_sd=QUADRATIC_SD)
    written = np.linalg.norm((raw - fit.offset) @ fit.matrix.T, axis=1) - G
    np.testing.assert_allclose(fit.residuals, written, atol=1e-9)  # rounding
    rms_mg = float(np.sqrt(np.mean(written**2))) / (1e-3 * G)
    show("poses_and_turns_cvut: rms length of 24 poses, mg", f"{rms_mg:.2f} stated and left", 0.44)
    show("  of it, uncertainty of a corrected reading, mg", f"{fit.uncertainty / (1e-3 * G):.2f}", 2.0)
    assert rms_mg < 0.44  # a linear fit of the publication leaves 0.43
    assert fit.uncertainty < 2e-3 * G


def tumbled(signs: tuple[float, float, float], part: str = "full-sphere") -> Record:
    """Return the sphere by hand or another part, with the gyroscopes' axes times their signs, on an even clock."""
    folder = "tumble_mpu6050"
    triads = {
        name: np.asarray(read_mat(data_path(folder, f"set-2_{part}_{name}.mat"))[key], float)
        for name, key in (("gyroscope", "gyroBuffer"), ("accelerometer", "accelBuffer"))
    }
    count = min(map(len, triads.values()))
    time = np.linspace(0.0, np.ptp(triads["gyroscope"][:, 0]), len(triads["gyroscope"]))[:count]
    gyro, accel = (triads[name][:count, 1:] for name in ("gyroscope", "accelerometer"))
    return Record(time=time, gyro=gyro * signs, accel=accel, gyro_unit="dps", accel_unit="g")


def test_tumbling_with_reversed_axes_is_refused_with_both_causes() -> None:
    with pytest.raises(Implausible) as caught:
        calibrate_from_motion([tumbled((1.0, 1.0, 1.0))])
    show("tumble_mpu6050: refused", str(caught.value))
    assert all(axis in str(caught.value) for axis in "xy")


def test_hour_at_rest_gives_the_white_noise() -> None:
    file = data_path("course_icm20948", "a_part5_gyro_1hour.csv")
    counts = np.genfromtxt(file, delimiter=",", skip_header=1, usecols=(0, 1, 2))
    fit = fit_noise(Record(time=np.linspace(0.0, 3600.0, len(counts)), gyro=counts, gyro_unit="count"))
    density = np.array([axis.angle_random_walk.value for axis in fit.gyro])
    show("course_icm20948: angle random walk, counts/sqrt(Hz)", density)
    # an upper limit: the standard deviation contains the drift
    plain = counts.std(axis=0) * np.sqrt(3600.0 / len(counts))
    assert (density < plain).all()
    assert (density > 0.5 * plain).all()
