"""BROAD trials: remaining error after each step of the correction, expected error, and common properties of devices of
a model.

``python -m benchmarks.broad`` prints three tables (some minutes), or only the named tables: steps, expected, offset.

1. End error and root-mean-square error of each device, raw to calibrated on the *other* trials of the device.
2. Expected against observed errors, over every fit to a part of a device's trials that is judged on another trial. Its prior
   (spread of matrix and in-motion offset between recordings) is learnt from the other devices.
3. The offset of each trial from motion, as it was read, with and without its rest, and the run time.

D. Laidig, M. Caruso, A. Cereatti, T. Seel, "BROAD - A benchmark for robust inertial orientation estimation", Data 2021, CC BY 4.0.
"""

import os
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache
from itertools import combinations
from pathlib import Path
from time import perf_counter

import numpy as np

from benchmarks.broad_files import read_broad
from undrift.arrays import FloatArray
from undrift.calibration.codes import device_adc
from undrift.calibration.reference import ReferenceFit, fit_reference
from undrift.correction.motion import fit_motion
from undrift.correction.rest import find_rest_offset
from undrift.fit.triad import nominal_triad
from undrift.model import AdcModel, Calibration
from undrift.record import Record, Reference
from undrift.units import STANDARD_GRAVITY
from undrift.validation.agreement import Validation, validate_leave_one_out, validate_trials
from undrift.validation.expected import ERROR_PRIOR, ErrorPrior
from undrift.validation.trial import Figures, TrialSettings, validate_trial

DEVICES = {"B": ("02", "05", "07", "09"), "C": ("03", "24"), "D": ("32", "35")}  # by their offsets: no id in the data


@cache
def trial(number: str) -> tuple[Record, Reference]:
    """Return record and reference of a trial."""
    folder = Path(os.environ.get("UNDRIFT_DATA", "../shared/data")) / "broad"
    return read_broad(next(folder.glob(f"{number}_*.hdf5")))


def pairs(numbers: Sequence[str]) -> list[tuple[Record, Reference]]:
    """Return several trials."""
    return [trial(number) for number in numbers]


# ---- 1. what each step leaves


def steps(numbers: tuple[str, ...]) -> Iterator[tuple[str, Validation]]:
    """Yield the trials of a device after each step of the correction."""
    trials = pairs(numbers)
    rest = TrialSettings(offset="rest")
    yield "raw", validate_trials(trials, names=numbers)
    yield "rest offset", validate_trials(trials, settings=rest, names=numbers)
    rounding = [nominal_calibration(record) for record, _ in trials]
    yield "rest offset and quantisation", validate_trials(trials, calibrations=rounding, settings=rest, names=numbers)
    yield "calibrated", validate_leave_one_out(trials, names=numbers)


def nominal_calibration(record: Record) -> Calibration:
    """Return a calibration that only gives back what the rounding of a record's codes took."""
    return Calibration(
        device=record.device,
        reference_temp_c=float("nan"),
        gravity_m_s2=STANDARD_GRAVITY,
        gyro=nominal_triad(record.gyro_unit, "rate"),
        accel=nominal_triad(record.accel_unit, "accel"),
        adc=device_adc([record]),
    )


def floor(numbers: tuple[str, ...]) -> Validation:
    """Return the trials, each by a fit to itself."""
    adc = device_adc([trial(n)[0] for n in numbers])
    return Validation.of(
        tuple(validate_trial(*trial(n), calibration=_calibration(single(n, adc), adc), name=n) for n in numbers)
    )


@cache
def single(number: str, adc: AdcModel | None) -> ReferenceFit:
    """Return the fit to one trial."""
    return fit_reference([trial(number)[0]], [trial(number)[1]], adc=adc)


def _calibration(fit: ReferenceFit, adc: AdcModel | None) -> Calibration:
    return Calibration(
        device="",
        reference_temp_c=float("nan"),
        gravity_m_s2=STANDARD_GRAVITY,
        gyro=fit.triad.model,
        adc=adc,
        verdict=fit.triad.verdict,
    )


# ---- 2. expected and observed

MATRIX_GRID = np.linspace(0.0, 2e-3, 41)  # relative
OFFSET_GRID = np.radians(np.linspace(0.0, 0.04, 41))  # rad/s


@cache
def adc_of(device: str) -> AdcModel | None:
    """Return how the codes of a device were rounded."""
    return device_adc([trial(n)[0] for n in DEVICES[device]])


def estimates(devices: Sequence[str]) -> list[list[tuple[FloatArray, FloatArray]]]:
    """Return what each trial of each device gives by itself: matrix and change to motion (12,), rad/s, and their covariance."""
    estimates_by_device = []
    for device in devices:
        adc = adc_of(device)
        models, elements = [single(n, adc).triad.model for n in DEVICES[device]], np.r_[:9, 12:15]
        estimates_by_device.append(
            [(np.append(m.matrix.ravel(), m.moving_offset), m.covariance[np.ix_(elements, elements)]) for m in models]
        )
    return estimates_by_device


def learnt(devices: Sequence[str]) -> ErrorPrior:
    """Return the spread between recordings of these devices: root of its mean square by restricted likelihood.

    Few recordings can exclude neither a spread of zero nor a large one. Therefore their likelihood is averaged with
    equal prior probability.
    """
    groups = estimates(devices)
    grid = np.array([(matrix, offset) for matrix in MATRIX_GRID for offset in OFFSET_GRID])
    cost = [sum(_restricted(g, np.diag(np.repeat(sizes**2, (9, 3)))) for g in groups) for sizes in grid]
    weight = np.exp(-0.5 * (np.array(cost) - min(cost)))
    matrix, offset = np.sqrt((weight @ grid**2) / weight.sum())
    offsets = np.concatenate([[x[9:] for x, _ in group] for group in groups])
    rests = [np.array([trial(n)[0].between(0.0, 20.0).gyro.mean(axis=0) for n in DEVICES[d]]) for d in devices]
    spare = sum(len(r) - 1 for r in rests)
    day = np.sqrt(sum(((r - r.mean(axis=0)) ** 2).sum() for r in rests) / (3 * spare))
    return replace(
        ERROR_PRIOR,
        matrix=float(matrix),
        motion_offset=float(offset),
        rest_to_motion=float(np.sqrt((offsets**2).mean())),
        day_to_day=float(day),
    )


def _restricted(group: list[tuple[FloatArray, FloatArray]], spread: FloatArray) -> float:
    """Return -2 log of the restricted likelihood of recordings about their device's unknown mean."""
    variances = [covariance + spread for _, covariance in group]
    weights = [np.linalg.inv(v) for v in variances]
    normal = sum(weights)
    mean = np.linalg.solve(normal, sum(w @ x for w, (x, _) in zip(weights, group, strict=True)))
    total = float(np.linalg.slogdet(normal)[1])
    for (x, _), v, w in zip(group, variances, weights, strict=True):
        total += float(np.linalg.slogdet(v)[1] + (x - mean) @ w @ (x - mean))
    return total


def expected(device: str, prior: ErrorPrior) -> Iterator[tuple[int, Validation]]:
    """Yield leave-one-out over every two trials or more of a device."""
    for count in range(2, len(DEVICES[device]) + 1):
        for numbers in combinations(DEVICES[device], count):
            yield count, validate_leave_one_out(pairs(numbers), settings=TrialSettings(prior=prior), names=numbers)


# ---- tables


def _row(name: str, figures: Sequence[Figures]) -> str:
    ends = [f.end_total_deg for f in figures]
    rmse = [f.rmse_total_deg for f in figures]
    return f"  {name:30} end {np.mean(ends):6.2f} ({' '.join(f'{e:.2f}' for e in ends)})   rmse {np.mean(rmse):6.2f}"


def main() -> None:
    """Print the tables."""
    tables = {"steps": print_steps, "expected": print_expected, "offset": print_offsets}
    for name in sys.argv[1:] or tables:
        tables[name]()


def print_steps() -> None:
    """Print what each step leaves."""
    for device, numbers in DEVICES.items():
        print(f"device {device}: {' '.join(numbers)}")
        for name, result in (*steps(numbers), ("each fitted on itself", floor(numbers))):
            print(_row(name, [t.figures for t in result.trials]), flush=True)


def print_expected() -> None:
    """Print expected against observed errors, how many lie inside 95 %."""
    inside, counted = np.zeros(2, int), np.zeros(2, int)
    for device in DEVICES:
        prior = learnt([other for other in DEVICES if other != device])
        print(
            f"device {device}, prior by the others: matrix {prior.matrix:.1e}, in-motion offset "
            f"{np.degrees(prior.motion_offset):.4f}, rest to motion {np.degrees(prior.rest_to_motion):.4f}, day to day "
            f"{np.degrees(prior.day_to_day):.4f} deg/s"
        )
        for count, result in expected(device, prior):
            for t in result.trials:
                predicted = t.expected
                assert predicted is not None
                pairs = (
                    (predicted.end_interval_deg, t.figures.end_total_deg),
                    (predicted.rmse_interval_deg, t.figures.rmse_total_deg),
                )
                inside += [low <= value <= high for (low, high), value in pairs]
                counted += [bool(np.isfinite(value)) for _, value in pairs]
                print(
                    f"  {count - 1} to fit, {t.recording}: end {t.figures.end_total_deg:.2f}, "
                    f"expected {predicted.end_total_deg:.2f} "
                    "[{:.2f}, {:.2f}]; ".format(*predicted.end_interval_deg)
                    + f"rmse {t.figures.rmse_total_deg:.2f}, expected {predicted.rmse_total_deg:.2f} "
                    "[{:.2f}, {:.2f}]".format(*predicted.rmse_interval_deg),
                    flush=True,
                )
    print(f"inside 95 %: end {inside[0]} of {counted[0]}, rmse {inside[1]} of {counted[1]}")


def print_offsets() -> None:
    """Print the offset from motion of each trial, deg/s, its standard uncertainty and the time that it takes, s."""
    for number in (n for numbers in DEVICES.values() for n in numbers):
        record = trial(number)[0]
        for name, rest in (("with its rest", find_rest_offset(record)), ("without", None)):
            fit_motion(record, rest)  # the compiler's time is not the estimator's
            start = perf_counter()
            motion_offset = fit_motion(record, rest).offset
            took, sigma = perf_counter() - start, np.sqrt(np.diag(motion_offset.covariance[0]))
            print(
                f"  {number}, {record.duration_s:.0f} s, {name:13} {took:5.2f} s   "
                + " ".join(
                    f"{np.degrees(o):8.4f} +- {np.degrees(s):.4f}"
                    for o, s in zip(motion_offset.rate[0], sigma, strict=True)
                ),
                flush=True,
            )


if __name__ == "__main__":
    main()
