"""What a trial is made of, what comes out, and how trials are run."""

from dataclasses import dataclass
from typing import NamedTuple

from undrift.arrays import FloatArray, IntArray
from undrift.session import Face


class Trial(NamedTuple):
    """One trial: which motion, device and calibration, by their places in the bench.

    Parameters
    ----------
    motion, device, calibration : int
        Places.
    number : int
        Names the trial's noise: the same number, the same noise.
    temp_c : float
        Temperature of the board at the first sample, degC.
    warming_k_per_s : float
        Its slope, K/s.
    """

    motion: int
    device: int
    calibration: int
    number: int
    temp_c: float = 25.0
    warming_k_per_s: float = 0.0


class TrialErrors(NamedTuple):
    """Errors of a batch of trials, in their order.

    Parameters
    ----------
    number : array, shape (B,)
        Of the trials.
    rms, maximum : array, shape (B,)
        Of the pitch error, rad; NaN where the pitch was lost.
    """

    number: IntArray
    rms: FloatArray
    maximum: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialSettings:
    """How trials are run.

    Parameters
    ----------
    forward, up : str
        Device axes that point forward and up in an upright segment.
    seed : int
        Of the noise.
    batch : int
        Trials whose errors come out together.
    threads : int
        Of the processor. The bits of the result depend neither on it nor on the batch.
    power_on_s : float
        Time since power-on at the first sample, s.
    """

    forward: Face = "+x"
    up: Face = "+z"
    seed: int = 0
    batch: int = 256
    threads: int = 1
    power_on_s: float = 0.0
