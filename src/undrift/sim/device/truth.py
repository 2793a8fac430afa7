"""Truth: what would correct a simulated device without error, and what its data sheet alone says, to hold estimates against."""

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.model import MATRIX_NAMES, OFFSET_NAMES, Calibration, TriadModel
from undrift.sim.device.device import SimulatedDevice, SimulatedTriad
from undrift.sim.device.random import Grade, TriadGrade
from undrift.units import STANDARD_GRAVITY


def true_calibration(
    device: SimulatedDevice, *, temp_c: float | None = None, gravity_m_s2: float = STANDARD_GRAVITY
) -> Calibration:
    """Return the calibration that is exact at one temperature.

    ``matrix = (diag(S) E)^-1``, ``offset = S (o + c (T - T0))``, g-sensitivity seen through the same matrix.

    Parameters
    ----------
    device : SimulatedDevice
        The truth.
    temp_c : float, optional
        Temperature, degC; the reference temperature where not given.
    gravity_m_s2 : float
        Local gravity to note in it, m/s2.

    Returns
    -------
    Calibration
        Covariance zero.
    """
    temp = device.reference_temp_c if temp_c is None else temp_c
    warmth = temp - device.reference_temp_c
    return Calibration(
        device=device.serial,
        reference_temp_c=temp,
        gravity_m_s2=gravity_m_s2,
        gyro=_model(device.gyro, warmth, "rad/s"),
        accel=_model(device.accel, warmth, "m/s2"),
    )


def nominal_calibration(grade: Grade, *, gravity_m_s2: float = STANDARD_GRAVITY) -> Calibration:
    """Return what a data sheet alone would make of the readings: nominal sensitivity, square axes, no offset.

    Parameters
    ----------
    grade : Grade
        The kind of device.
    gravity_m_s2 : float
        Local gravity to note in it, m/s2.

    Returns
    -------
    Calibration
        Covariance zero.
    """

    def triad(sheet: TriadGrade, unit_out: str) -> TriadModel:
        limit = sheet.full_scale / sheet.sensitivity
        return _inverse(np.eye(3) / sheet.sensitivity, np.zeros(3), None, sheet.unit, unit_out, limit, "nominal")

    return Calibration(
        device="nominal",
        reference_temp_c=float("nan"),
        gravity_m_s2=gravity_m_s2,
        gyro=triad(grade.gyro, "rad/s"),
        accel=triad(grade.accel, "m/s2"),
    )


def largest_departure(estimate: TriadModel, truth: TriadModel) -> float:
    """Return how far an estimate lies from the truth, element by element, at most.

    Over the matrix, and the g-sensitivity where it was fitted: |estimate - truth| / standard uncertainty. The offset is left
    out, since it wanders from the moment that the truth is stated for.

    Parameters
    ----------
    estimate, truth : TriadModel
        Of the same triad; the estimate with its covariance.

    Returns
    -------
    float
        In standard uncertainties.
    """
    sigma = estimate.standard_uncertainty
    apart = np.abs(estimate.matrix - truth.matrix).ravel() / sigma[:9]
    if estimate.g_sensitivity is not None:
        true = np.zeros((3, 3)) if truth.g_sensitivity is None else truth.g_sensitivity
        apart = np.concatenate((apart, np.abs(estimate.g_sensitivity - true).ravel() / sigma[12:]))
    return float(apart.max())


def _model(triad: SimulatedTriad, warmth: float, unit_out: str) -> TriadModel:
    matrix = np.linalg.inv(triad.forward_matrix)
    limit = triad.full_scale / float(np.max(triad.sensitivity))
    feigned = matrix @ (triad.sensitivity[:, None] * triad.g_sensitivity)
    return _inverse(
        matrix,
        triad.sensitivity * (triad.offset + triad.offset_per_k * warmth),
        feigned if triad.g_sensitivity.any() else None,
        triad.unit,
        unit_out,
        limit,
        "truth",
    )


def _inverse(
    matrix: FloatArray,
    offset: FloatArray,
    g_sensitivity: FloatArray | None,
    unit_in: str,
    unit_out: str,
    limit: float,
    method: str,
) -> TriadModel:
    return TriadModel(
        method=method,
        unit_in=unit_in,
        unit_out=unit_out,
        matrix=matrix,
        offset=offset,
        g_sensitivity=g_sensitivity,
        covariance=np.zeros((12, 12)),
        parameters=(*MATRIX_NAMES, *OFFSET_NAMES),
        rms_residual=0.0,
        count=0,
        rank=12,
        condition=1.0,
        valid_range=(-limit, limit),
    )
