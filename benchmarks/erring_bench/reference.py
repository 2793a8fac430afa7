"""Fit to references on a bench that errs: markers put on anew, cameras with noise, consumer parts with all their effects.

The mounting of each recording is drawn and not known, so scale and cross-axis terms are compared as M'M, which no rotation changes.
The gyroscopes' offset is that of these recordings in motion, with g-sensitivity and what the offset did on that day: no constant of
the device, and not compared. What it adds to an error in degrees is judged by ``benchmarks.broad``.
"""

from collections.abc import Iterator

import numpy as np

from benchmarks.erring_bench import Row, Tally
from undrift.arrays import FloatArray
from undrift.calibration.reference import ReferenceSettings, fit_reference
from undrift.calibration.reference_accel import fit_reference_accel
from undrift.fit.least_squares import TriadFit
from undrift.model import TriadModel
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.presets import GradeName, random_device
from undrift.sim.device.simulate import simulate_device
from undrift.sim.device.truth import true_calibration
from undrift.sim.motion.poses import OpticsSettings, see
from undrift.sim.motion.tasks import draw_task
from undrift.units import STANDARD_GRAVITY

RATE_HZ = 100.0
CASES: dict[str, tuple[GradeName, OpticsSettings]] = {
    "industrial part, cameras 0.02 deg": ("industrial", OpticsSettings()),
    "consumer part, 0.06 deg, mounting 0.5 deg": ("consumer", OpticsSettings(angle_sd=1e-3, mount_sd=9e-3)),
}


def rows(devices: int, seed: int) -> Iterator[Row]:
    """Yield the rows of the gyroscopes and of the accelerometers."""
    for case, (grade, optics) in CASES.items():
        rng = np.random.default_rng(seed)
        gyro, accel = (Tally(f"reference, {triad}", case) for triad in ("gyroscope", "accelerometer"))
        for _ in range(devices):
            device = random_device(rng, grade=grade)
            fits = _fits(device, rng, optics)
            truth = true_calibration(device)
            for tally, fit, true in zip((gyro, accel), fits, (truth.gyro, truth.accel), strict=True):
                if true is not None:
                    groups = _groups(fit, true)
                    tally.add(
                        fit.verdict, **(groups if tally is accel else {k: groups[k] for k in ("scale", "cross-axis")})
                    )
        yield from gyro.rows()
        yield from accel.rows()


def _fits(device: DeviceModel, rng: np.random.Generator, optics: OpticsSettings) -> tuple[TriadFit, TriadFit]:
    records, references = [], []
    for _ in range(3):
        task = draw_task("free", rng=rng)
        motion = task.at(np.arange(round(task.duration_s * RATE_HZ)) / RATE_HZ, STANDARD_GRAVITY)
        records.append(simulate_device(device, motion, rng=rng).record)
        references.append(see(task, rng=rng, settings=optics))
    fit = fit_reference(records, references, settings=ReferenceSettings())
    known = fit_reference_accel(
        records, references, fit.triad.model, mountings=fit.mountings, gravity_m_s2=STANDARD_GRAVITY
    )
    return fit.triad, known


def _groups(fit: TriadFit, true: TriadModel) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Return errors and standard deviations of M'M, relative, and of the offset, in units of the output."""
    matrix, size = fit.model.matrix, float(np.linalg.norm(true.matrix, 2))
    element = np.eye(9).reshape(9, 3, 3)
    change = (np.swapaxes(element, 1, 2) @ matrix + matrix.T @ element).reshape(9, 9).T / size**2
    sigma = np.sqrt(np.diag(change @ fit.model.covariance[:9, :9] @ change.T)).reshape(3, 3)
    error = (matrix.T @ matrix - true.matrix.T @ true.matrix) / size**2
    upper = np.triu_indices(3, 1)
    offset = size * (fit.model.offset - true.offset)
    return {
        "scale": (np.diag(error) / 2.0, np.diag(sigma) / 2.0),
        "cross-axis": (error[upper], sigma[upper]),
        "offset": (offset, size * fit.model.standard_uncertainty[9:12]),
    }
