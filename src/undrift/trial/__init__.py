"""Trials: many devices in many motions, corrected by many calibrations, for the error of the sagittal pitch alone.

A trial is what ``simulate_device``, ``correct`` and ``integrate_strapdown`` make of it one after the other, in one kernel that
keeps no array in between. The kernel knows these effects: scale, offset over temperature, thermal scale, rate drift, white
noise, random walk, rails, low-pass, converter, and a thermometer with lag and self-heating; ``trial_device`` switches off the
others. Noise comes from counters: number j of a trial is a hash of (seed, effect, trial, sample), whatever the batch, the order
and the number of threads.
"""

from undrift.trial.bench import TrialBench, trial_bench
from undrift.trial.device import trial_device
from undrift.trial.run import run_trials, trial_noise
from undrift.trial.values import Trial, TrialErrors, TrialSettings

__all__ = [
    "Trial",
    "TrialBench",
    "TrialErrors",
    "TrialSettings",
    "run_trials",
    "trial_bench",
    "trial_device",
    "trial_noise",
]
