"""A triad without cross-axis terms, for tests of other effects."""

import numpy as np

from undrift.model import TriadModel
from undrift.units import si_factor


def plain_triad(unit_in, unit_out, quantity="rate", *, offset=(0.0, 0.0, 0.0), offset_sigma=0.0):
    """Return a triad of physical units. offset_sigma is the standard uncertainty of the offset, raw unit."""
    covariance = np.zeros((12, 12))
    covariance[9:12, 9:12] = np.eye(3) * offset_sigma**2
    return TriadModel(
        method="test",
        unit_in=unit_in,
        unit_out=unit_out,
        matrix=np.eye(3) * si_factor(unit_in, quantity) / si_factor(unit_out, quantity),
        offset=np.array(offset),
        covariance=covariance,
        rms_residual=0.0,
        count=1,
        rank=12,
        condition=1.0,
        valid_range=(-100.0, 100.0),
    )
