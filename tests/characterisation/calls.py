"""All calls, by name."""

from characterisation import calls_drift, calls_fits, calls_study, calls_use
from characterisation.shared import CALLS, leaves_of

PARTS = (calls_fits, calls_drift, calls_use, calls_study)

__all__ = ["CALLS", "PARTS", "leaves_of"]
