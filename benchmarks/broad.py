"""BROAD trials at hand: what each step of the correction leaves, what was expected, and what devices of a model share.

``python -m benchmarks.broad`` prints three tables (some minutes):

1. End error and root-mean-square error of each device, raw to calibrated on the *other* trials of the device.
2. Expected against observed errors, over every fit to a part of a device's trials that is judged on another trial. Its prior
   (spread of matrix and in-motion offset between recordings) is learnt from the other devices.
3. A hierarchical prior, nested: all that is chosen for a held-out trial comes from other trials (docs/decisions, 2026-11-22).

D. Laidig, M. Caruso, A. Cereatti, T. Seel, "BROAD - A benchmark for robust inertial orientation estimation", Data 2021, CC BY 4.0.
"""

import os
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache
from itertools import combinations
from pathlib import Path

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.calibrate import device_adc
from undrift.calibration.reference import ReferenceFit, fit_reference
from undrift.io.mocap import read_broad
from undrift.model import Calibration
from undrift.record import Record, Reference
from undrift.units import STANDARD_GRAVITY
from undrift.validation.agreement import Validation, summed, validate_leave_one_out, validate_trials
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
    held = pairs(numbers)
    for name, settings in (
        ("raw", TrialSettings(adc="none")),
        ("rest offset", TrialSettings(adc="none", offset="rest")),
        ("rest offset and quantisation", TrialSettings(offset="rest")),
    ):
        yield name, validate_trials(held, settings=settings, names=numbers)
    for name, settings in (("calibrated", TrialSettings(adc="none")), ("and quantisation", TrialSettings())):
        yield name, validate_leave_one_out(held, settings=settings, names=numbers)


def floor(numbers: tuple[str, ...]) -> Validation:
    """Return the trials, each by a fit to itself."""
    adc = device_adc([trial(n)[0] for n in numbers])
    return summed(
        tuple(validate_trial(*trial(n), calibration=_calibration(single(n, adc), adc), name=n) for n in numbers)
    )


@cache
def single(number: str, adc: object) -> ReferenceFit:
    """Return the fit to one trial."""
    return fit_reference([trial(number)[0]], [trial(number)[1]], adc=adc)  # type: ignore[arg-type]


def _calibration(fit: ReferenceFit, adc: object) -> Calibration:
    return Calibration(
        device="",
        reference_temp_c=float("nan"),
        gravity_m_s2=STANDARD_GRAVITY,
        gyro=fit.triad.model,
        adc=adc,  # type: ignore[arg-type]
        verdict=fit.triad.verdict,
    )


# ---- 2. expected and observed


def estimates(devices: Sequence[str]) -> list[list[tuple[FloatArray, FloatArray]]]:
    """Return what each trial of each device gives by itself: matrix and change to motion (12,), and their covariance."""
    each = []
    for device in devices:
        adc = device_adc([trial(n)[0] for n in DEVICES[device]])
        fits = [single(n, adc) for n in DEVICES[device]]
        each.append(
            [(np.append(f.triad.model.matrix.ravel(), f.motion_offset), f.triad.model.covariance) for f in fits]
        )
    return each


def learnt(devices: Sequence[str]) -> ErrorPrior:
    """Return the spread between recordings of one device by restricted maximum likelihood, on these devices."""
    from scipy.optimize import minimize

    groups = estimates(devices)

    def cost(logs: FloatArray) -> float:
        spread = np.diag(np.repeat(np.exp(2.0 * logs), (9, 3)))
        return sum(_restricted(group, spread) for group in groups)

    found = min(
        (minimize(cost, start, method="Nelder-Mead") for start in ((-8.0, -9.0), (-7.0, -8.0))), key=lambda r: r.fun
    )
    matrix, offset = np.exp(found.x)
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
    for device, numbers in DEVICES.items():
        print(f"device {device}: {' '.join(numbers)}")
        for name, result in (*steps(numbers), ("each fitted on itself", floor(numbers))):
            print(_row(name, [t.figures for t in result.trials]), flush=True)
    inside, seen = np.zeros(2, int), np.zeros(2, int)
    for device in DEVICES:
        prior = learnt([other for other in DEVICES if other != device])
        print(
            f"device {device}, prior by the others: matrix {prior.matrix:.1e}, in-motion offset "
            f"{np.degrees(prior.motion_offset):.4f}, rest to motion {np.degrees(prior.rest_to_motion):.4f}, day to day "
            f"{np.degrees(prior.day_to_day):.4f} deg/s"
        )
        for count, result in expected(device, prior):
            held = result.coverage
            assert held is not None
            inside += (held.end_inside, held.rmse_inside)
            seen += (held.ends, held.trials)
            for t in result.trials:
                made = t.expected
                assert made is not None
                print(
                    f"  {count - 1} to fit, {t.recording}: end {t.figures.end_total_deg:.2f}, expected {made.end_total_deg:.2f} "
                    "[{:.2f}, {:.2f}]; ".format(*made.end_interval_deg)
                    + f"rmse {t.figures.rmse_total_deg:.2f}, expected {made.rmse_total_deg:.2f} "
                    "[{:.2f}, {:.2f}]".format(*made.rmse_interval_deg),
                    flush=True,
                )
    print(f"inside 95 %: end {inside[0]} of {seen[0]}, rmse {inside[1]} of {seen[1]}")


if __name__ == "__main__":
    main()
