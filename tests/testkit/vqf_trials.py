"""What corrected readings are worth to an orientation filter: VQF without a magnetometer on the eight BROAD trials at hand.

Each trial is corrected by a fit to the references of the device's other trials, and never by its own. The error is the total angle
against optics, root mean square over the motion; heading is made equal over the two seconds before it.
``PYTHONPATH=src:tests python -m testkit.vqf_trials docs/vqf-on-broad.svg`` draws the figure of docs/orientation.md.
"""

import sys
from functools import cache
from pathlib import Path

import numpy as np

from testkit.broad_trials import DEVICES, of_device
from undrift.calibration.codes import device_adc
from undrift.calibration.reference import leave_one_out
from undrift.correction.correct import correct
from undrift.frames import quaternion_conjugate, quaternion_product
from undrift.model import Calibration
from undrift.orientation import OrientSettings, heading_of, orient
from undrift.record import Record, Reference
from undrift.report.figures import draw_bars, save_figure
from undrift.units import STANDARD_GRAVITY
from undrift.validation.trial import compare_orientations

BEFORE_S = 2.0
LABELS = ("VQF on raw readings", "on corrected readings", "and the calibration's uncertainty as prior")


def total_error_deg(q_nb: np.ndarray, reference: Reference) -> float:
    """Return the error of an orientation at the reference's samples."""
    moving = (reference.moving > 0.5) & reference.valid
    start = reference.time[np.flatnonzero(moving)[0]]
    before = reference.valid & (reference.time >= start - BEFORE_S) & (reference.time < start)
    off = heading_of(quaternion_product(q_nb, quaternion_conjugate(reference.q_nb)))[before]
    turn = -float(np.angle(np.exp(1j * off).mean()))
    level = quaternion_product(np.array([np.cos(turn / 2.0), 0.0, 0.0, np.sin(turn / 2.0)]), q_nb)
    return float(np.degrees(np.sqrt(np.mean(compare_orientations(level, reference.q_nb).total[moving] ** 2))))


def by_itself(record: Record) -> np.ndarray:
    """Return the orientation that the package vqf finds with its own settings."""
    from vqf import VQF

    record = record.in_si()
    result = VQF(1.0 / record.sample_rate_hz)
    return result.updateBatch(np.ascontiguousarray(record.gyro), np.ascontiguousarray(record.accel))["quat6D"]


@cache
def errors_deg() -> dict[str, list[float]]:
    """Return errors by trial and device, deg: VQF raw, VQF corrected, with the prior of a calibration, and strapdown."""
    errors = {}
    for device in DEVICES:
        pairs, names = of_device(device)
        records, references = zip(*pairs, strict=True)
        adc = device_adc(records)
        fits = leave_one_out(records, references, adc=adc)
        for name, (record, reference), fit in zip(names, pairs, fits, strict=True):
            model = Calibration(
                device=device, reference_temp_c=np.nan, gravity_m_s2=STANDARD_GRAVITY, gyro=fit.model, adc=adc
            )
            corrected = correct(record, model)
            with_prior = orient(corrected, None, OrientSettings(method="vqf"), gyro_model=fit.model).q_nb
            strapdown = orient(corrected, None, gyro_model=fit.model).q_nb
            tracks = (by_itself(record), by_itself(corrected), with_prior, strapdown)
            errors[f"{name[:2]} ({device})"] = [total_error_deg(q, reference) for q in tracks]
    return errors


def main(path: str) -> None:
    errors = errors_deg()
    bars = {label: [values[k] for values in errors.values()] for k, label in enumerate(LABELS)}
    title = "VQF against optics: BROAD trials, device in brackets"
    save_figure(draw_bars(list(errors), bars, title=title, label="total error, rms (deg)"), Path(path))
    for name, values in (errors | {"mean": np.mean(list(errors.values()), axis=0).tolist()}).items():
        print("| ".join((f"| {name} ", *(f"{value:.2f} " for value in values), "")).rstrip())


if __name__ == "__main__":
    main(sys.argv[1])
