"""Truth: the Calibration that would correct a simulated device without error, to hold an estimate against."""

import numpy as np

from undrift.calibration.model import MATRIX_NAMES, OFFSET_NAMES, Calibration, TriadModel
from undrift.sim.device.device import SimulatedDevice, SimulatedTriad
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


def _model(triad: SimulatedTriad, warmth: float, unit_out: str) -> TriadModel:
    matrix = np.linalg.inv(triad.forward_matrix)
    limit = triad.full_scale / float(np.max(triad.sensitivity))
    feigned = matrix @ (triad.sensitivity[:, None] * triad.g_sensitivity)
    return TriadModel(
        method="truth",
        unit_in=triad.unit,
        unit_out=unit_out,
        matrix=matrix,
        offset=triad.sensitivity * (triad.offset + triad.offset_per_k * warmth),
        g_sensitivity=feigned if triad.g_sensitivity.any() else None,
        covariance=np.zeros((12, 12)),
        parameters=(*MATRIX_NAMES, *OFFSET_NAMES),
        rms_residual=0.0,
        count=0,
        rank=12,
        condition=1.0,
        valid_range=(-limit, limit),
    )
