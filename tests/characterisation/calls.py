"""All calls, by name."""

from characterisation import calls_drift, calls_fits
from characterisation.shared import CALLS, leaves_of

PARTS = (calls_fits, calls_drift)

__all__ = ["CALLS", "PARTS", "leaves_of"]
