"""A session recorded as the documentation says is good on most devices; one that errs where it counts is not; good ones hold."""

from collections import Counter
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from benchmarks.erring_bench import multi_position

from testkit.data import show
from testkit.findings import only
from undrift.calibration.calibrate import calibrate
from undrift.calibration.settings import CalibrateSettings
from undrift.sim.device.presets import random_device
from undrift.sim.device.truth import true_calibration
from undrift.sim.motion.bench import BenchErrors, BenchSettings
from undrift.sim.sessions import simulate_session
from undrift.units import RADIAN_PER_DEGREE as DEG

KINDS = (
    *("mpu6050", "icm20948", "bmi160", "bmi270", "bmi088", "lsm6dso"),
    *("xsens_mti1", "shimmer3", "consumer", "industrial", "wearable", "enc03j_3031"),
)
WARM = {"power_on_s": 1200.0}
MILD = {"temp_c": (24.8, 25.2), **WARM}  # and faces 0.1 deg off level


@cache
def sessions(kind, *, labelled=True, devices=len(KINDS), **more):
    """Return a session of each of the devices."""
    results = []
    for seed, name in enumerate(KINDS[:devices]):
        rng = np.random.default_rng(seed)
        device = random_device(rng, grade=name)
        settings = BenchSettings(errors=BenchErrors(face_tilt=0.1 * DEG, hand_axis=0.5 * DEG))
        rng = np.random.default_rng(1000 + seed)
        results.append(simulate_session(kind, device, rng=rng, settings=settings, labelled=labelled, **more))
    return results


def verdicts(drawn, **settings):
    results = [calibrate(session, settings=CalibrateSettings(**settings)).verdict for session in drawn]
    reasons = Counter(item.code for result in results for item in result.findings if item.level != "info")
    counts = Counter(result.status for result in results)
    show(f"verdicts of {len(results)} devices", dict(counts), dict(reasons))
    return counts, reasons


SOUND = [
    (kind, labelled, 360.0 if kind == "ferraris" and not labelled else None, temperature)
    for kind in ("six_face", "ferraris", "multi_position")
    for labelled in (True, False)
    for temperature in (labelled, not labelled)  # the second, where the other of both is missing, in `make test-long`
]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "labelled", "angle", "temperature"),
    [case if case[1] == case[3] else pytest.param(*case, marks=pytest.mark.slow) for case in SOUND],
)
def test_sound_session_is_good_on_four_devices_of_five(kind, labelled, angle, temperature):
    drawn = sessions(kind, labelled=labelled, **MILD)
    if not temperature:
        drawn = (replace(s, records=tuple(replace(r, temp_c=None) for r in s.records)) for s in drawn)
    counts, reasons = verdicts(drawn, turn_angle_deg=angle)
    assert counts["good"] >= 0.8 * len(KINDS), reasons
    assert counts["bad"] == 0


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["six_face", "ferraris", "multi_position"])
@pytest.mark.parametrize("devices", [6, len(KINDS)])
def test_a_session_whose_numbers_are_in_doubt_is_never_good(kind, devices):
    counts, _ = verdicts(sessions(kind, devices=devices, temp_c=(22.0, 27.0)))  # 5 K within the session
    assert counts["good"] == 0
    counts, reasons = verdicts(replace(s, gravity_source="standard") for s in sessions(kind, **MILD)[:devices])
    assert (counts["good"], reasons["session.gravity"]) == (0, devices)


@pytest.mark.slow
def test_full_turns_that_give_no_scale_are_no_information_alone():
    session = sessions("ferraris", **MILD)[0]
    record, stop = session.records[0], session.turns[0].stop + 600  # six faces, one turn and the rest after it
    kept = {name: getattr(record, name)[:stop] for name in ("time", "gyro", "accel", "temp_c")}
    calibration = calibrate(replace(session, records=(replace(record, **kept),), stills=(), turns=()))
    assert calibration.gyro is None
    assert calibration.verdict.status == "marginal"
    assert only(calibration.verdict.findings, "session.not_observable").level == "warn"


def test_the_scale_of_offset_alone_is_uncertain_as_a_part_s_is():
    session = sessions("six_face", **MILD)[0]
    record = session.records[0]
    calibration = calibrate(replace(session, records=(replace(record, gyro=record.gyro / 16.4, gyro_unit="dps"),)))
    assert calibration.gyro.method == "rest"
    relative = calibration.gyro.standard_uncertainty[:9].reshape(3, 3) / np.diag(calibration.gyro.matrix)
    np.testing.assert_allclose(np.diag(relative), 0.03)
    assert calibration.verdict.status == "good"


@pytest.mark.slow
@pytest.mark.parametrize("devices", [20, 40])
def test_intervals_hold_where_a_bare_log_of_tilted_faces_is_good(devices):
    # Rests before and after a full turn lie on one face as they were laid down: they are one draw of its tilt, not two.
    inside = {"scale": [], "cross": [], "offset": []}
    for seed in range(devices):
        rng = np.random.default_rng(seed)
        device = random_device(rng)
        session = simulate_session(
            "ferraris",
            device,
            rng=rng,
            labelled=False,
            settings=BenchSettings(errors=BenchErrors(face_tilt=0.1 * DEG)),
            temp_c=25.0,
        )
        calibration = calibrate(session, settings=CalibrateSettings(turn_angle_deg=360.0))
        if calibration.verdict.status != "good":
            continue
        truth, sigma = true_calibration(device, temp_c=25.0).accel, calibration.accel.standard_uncertainty
        held = np.abs(calibration.accel.matrix - truth.matrix) <= 1.96 * sigma[:9].reshape(3, 3)
        inside["scale"] += np.diag(held).tolist()
        inside["cross"] += held[~np.eye(3, dtype=bool)].tolist()
        inside["offset"] += (np.abs(calibration.accel.offset - truth.offset) <= 1.96 * sigma[9:12]).tolist()
    shares = {name: round(float(np.mean(item)), 3) for name, item in inside.items()}
    show("inside 95 % where good", shares, f"0.9 or more of {len(inside['cross'])}")
    assert len(inside["scale"]) >= 3 * 0.8 * devices  # most are good
    assert min(shares.values()) >= 0.90


def test_poses_whose_excess_variances_alternate_converge():
    rng = np.random.default_rng(1)
    for _ in range(
        47
    ):  # whole steps went back and forth between no excess of the rests and a little for this device alone
        session, truth = multi_position.drawn(multi_position.CASES["creep 1 degC, 12 bit, flicker"], rng)
    calibration = calibrate(session, accel="multi-position", gyro="multi-position", settings=multi_position.SETTINGS)
    matrix = truth[1][0]
    assert np.abs(calibration.gyro.matrix / np.diag(matrix).mean() - matrix / np.diag(matrix).mean()).max() < 1e-3
