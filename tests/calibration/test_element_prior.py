"""What devices of a part deviate by: sizes and means are found again, and a motion that shows little is calibrated better."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.data import show
from undrift.base.codec import read, write
from undrift.calibration.calibrate import calibrate_from_motion
from undrift.calibration.element_prior import ELEMENTS, KINDS, PUBLISHED, ElementPrior, deviation_of, learn_prior
from undrift.errors import FileFormatError, InputError
from undrift.model import Calibration, TriadModel
from undrift.record import Record
from undrift.sim.motion.tasks import draw_task
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

# Of a part, by kind: standard deviation, and mean of the first element
TRUE = {
    "gyro_scale": (0.0015, 0.012),
    "gyro_cross": (0.001, -0.004),
    "accel_scale": (0.001, -0.006),
    "accel_cross": (0.0004, 0.001),
    "between": (0.0008, 0.005),
    "case": (0.003, 0.0),
    "accel_offset": (0.05, 0.2),
}
STATED = np.concatenate((np.full(18, 2e-4), np.full(3, 0.005)))  # standard uncertainty of a device's elements


def unit(rng: np.random.Generator, turned: bool = False) -> tuple[np.ndarray, Calibration]:
    """Return what a drawn device deviates by, and its calibration in physical units, which errs by what it states."""
    size, mean = np.array([TRUE[name] for name in KINDS]).T
    kinds = np.repeat(size, 3) * rng.standard_normal(21)
    kinds[::3] += mean
    true = np.linalg.solve(ELEMENTS, kinds)
    found = true + STATED * rng.standard_normal(21)
    per = RADIAN_PER_DEGREE if turned else 1.0  # readings in deg/s
    common = {"rms_residual": 0.0, "count": 1, "rank": 12, "condition": 1.0, "valid_range": (-9.0, 9.0)}
    scale = np.repeat((per, 1.0), (9, 3))
    gyro = TriadModel(
        method="affine", unit_in="deg/s" if turned else "rad/s", unit_out="rad/s", offset=np.zeros(3),
        matrix=per * (np.eye(3) + found[:9].reshape(3, 3)),
        covariance=np.diag((scale * np.append(STATED[:9], np.full(3, 1e-4))) ** 2), **common,
    )  # fmt: skip
    accel = TriadModel(
        method="affine", unit_in="m/s2", unit_out="m/s2", matrix=np.eye(3) + found[9:18].reshape(3, 3), offset=found[18:],
        covariance=np.diag(STATED[9:] ** 2), **common,
    )  # fmt: skip
    return true, Calibration(device="", reference_temp_c=25.0, gravity_m_s2=STANDARD_GRAVITY, gyro=gyro, accel=accel)


def moved(true: np.ndarray, rng: np.random.Generator) -> Record:
    """Return what a device reads in a free movement."""
    task = draw_task("free", rng=rng)
    motion = task.at(np.arange(round(task.duration_s * 50.0)) / 50.0, STANDARD_GRAVITY)
    matrices = np.eye(3) + true[:18].reshape(2, 3, 3)
    rates = np.linalg.solve(matrices[0], motion.mean_rate_b.T).T + 1e-3 * rng.standard_normal(motion.mean_rate_b.shape)
    forces = np.linalg.solve(matrices[1], motion.force_b.T).T + true[18:] + 0.02 * rng.standard_normal(rates.shape)
    return Record(time=motion.time, gyro=rates, accel=forces)


@pytest.mark.slow
def test_sizes_and_means_of_a_part_are_found_again_from_its_devices() -> None:
    rng = np.random.default_rng(5)
    made = learn_prior([unit(rng, turned=k % 2 == 0)[1] for k in range(60)], "a part")
    assert made.devices == 60
    for name, one in zip(KINDS, made.kinds, strict=True):
        size, mean = TRUE[name]
        show(f"{name}: size and mean found; true", (one.size, one.mean[0]), (size, mean))
        published = getattr(PUBLISHED, name)
        # what was known before counts by its elements: 60 devices bring 180
        wanted = np.sqrt((published.as_from * published.size**2 + 180.0 * size**2) / (published.as_from + 180.0))
        assert one.size == pytest.approx(wanted, rel=0.2)
        assert abs(one.mean[0] - 60.0 / 61.0 * mean) < 4.0 * size / np.sqrt(60.0)
        assert one.as_from == published.as_from + 180.0


@pytest.mark.slow
def test_a_part_that_is_known_calibrates_its_next_device_better_from_one_movement() -> None:
    rng = np.random.default_rng(6)
    learnt = learn_prior([unit(rng)[1] for _ in range(30)], "a part")
    errors: dict[str, list[np.ndarray]] = {"published": [], "learnt": []}
    inside = 0
    for _ in range(5):
        true, _ = unit(rng)
        record = moved(true, rng)
        for name, prior in (("published", PUBLISHED), ("learnt", learnt)):
            made = calibrate_from_motion([record], prior=prior)
            assert made.gyro is not None
            error = np.diag(made.gyro.matrix) - 1.0 - true[[0, 4, 8]]
            errors[name].append(error)
            if name == "learnt":
                inside += int((np.abs(error) < 1.96 * made.gyro.standard_uncertainty[[0, 4, 8]]).sum())
                (named,) = (one for one in made.verdict.findings if one.code == "motion.prior")
                assert named.values["source"] == "a part"
                before, after = named.values["gyro_scale_percent"]
                assert after < before
    rms = {name: float(np.sqrt(np.mean(np.square(each)))) for name, each in errors.items()}
    show("scale of gyroscopes after one movement, rms: published sizes, the part's", list(rms.values()))
    assert rms["learnt"] < 0.8 * rms["published"]
    assert inside >= 13  # of 15


def test_a_prior_is_the_same_from_its_file_and_no_other_file_is_one(tmp_path) -> None:
    made = learn_prior([unit(np.random.default_rng(1))[1]], "one device")
    write(made, tmp_path / "prior.json")
    again = read(ElementPrior, tmp_path / "prior.json")
    assert again.kinds == made.kinds
    assert again.source == "one device"
    (tmp_path / "prior.json").write_text('{"kind": "undrift.calibration", "format": 1}')
    with pytest.raises(FileFormatError, match=r"undrift\.prior"):
        read(ElementPrior, tmp_path / "prior.json")


def test_what_cannot_be_counted_says_why() -> None:
    _, made = unit(np.random.default_rng(1))
    assert made.gyro is not None
    for wrong, words in (
        (
            replace(made, accel=None),
            "both triads in physical units with an uncertainty, got none of the accelerometers",
        ),
        (replace(made, gyro=replace(made.gyro, unit_in="count")), "got none of the gyroscopes"),
        (replace(made, gyro=replace(made.gyro, covariance=np.zeros((12, 12)))), "got none of the gyroscopes"),
        (replace(made, gyro=replace(made.gyro, method="motion")), "leans on no prior, got one from motion alone"),
    ):
        with pytest.raises(InputError, match=words):
            deviation_of(wrong)
    assert [one.size for one in learn_prior([], "nothing").kinds] == pytest.approx(
        [one.size for one in PUBLISHED.kinds]
    )
