"""The note's method on what a virtual bench recorded: constant calibration, tables, and a worn trial at three levels.

::

    bench                        -> calibrate    offset, matrix
    bench and thermal            -> fit_drift    tables
    a sit-to-stand, worn, warmer -> correct, orient, compare with the optics     none, static, static and dynamic

Only ``bench_checks`` knows the hidden truth.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from undrift.calibration.model import Calibration, DriftTables
from undrift.calibration.procedure import calibrate
from undrift.drift.procedure import DriftFit, fit_drift
from undrift.record import Record, Reference
from undrift.session import Session
from undrift.sim.device.model import DeviceModel
from undrift.sim.motion.library import draw_task
from undrift.sim.optics import OpticsSettings, see
from undrift.study.figure3 import worn_record
from undrift.validation.trial import Trial, validate_trial

Level = Literal["constant calibration", "static table", "all tables"]
LEVELS: tuple[Level, ...] = ("constant calibration", "static table", "all tables")
EXCURSION_K = 12.5  # between the note's 10 and 15
OPTICS = OpticsSettings(gaps=0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BenchFit:
    """What the runs gave.

    Parameters
    ----------
    constant : Calibration
        Of the bench run alone.
    drift : DriftFit
        Its calibration has the tables.
    """

    constant: Calibration
    drift: DriftFit

    @property
    def levels(self) -> tuple[Calibration, Calibration, Calibration]:
        """Calibrations for each of ``LEVELS``."""
        full = self.drift.calibration
        static = replace(full.drift or DriftTables(), scale=None, dynamic=None)
        return self.constant, replace(full, drift=static), full


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WornTrial:
    """A sit-to-stand of a person who wears the device.

    Parameters
    ----------
    record : Record
        What the device read.
    reference : Reference
        What the optics saw.
    """

    record: Record
    reference: Reference


def fit_bench(bench: Session, thermal: Session) -> BenchFit:
    """Fit what a virtual bench recorded.

    Parameters
    ----------
    bench, thermal : Session
        As read from the run folders.

    Returns
    -------
    BenchFit
        Constant calibration, and tables from both runs.

    Raises
    ------
    UndriftError
        Sessions that do not tell.
    """
    constant = calibrate(bench)
    return BenchFit(constant=constant, drift=fit_drift((bench, thermal), constant))


def worn_trial(device: DeviceModel, *, seed: int, excursion_k: float = EXCURSION_K) -> WornTrial:
    """Simulate a sit-to-stand with a device that its wearer has warmed.

    Parameters
    ----------
    device : DeviceModel
        The same unit as on the bench.
    seed : int
        Draws person, optics and noise.
    excursion_k : float
        Board temperature above the bench's, K.

    Returns
    -------
    WornTrial
        Raw readings, and optics.
    """
    person, noise = np.random.default_rng([seed, 0]), np.random.default_rng([seed, 1])
    performed = draw_task("sit_to_stand", rng=person)
    reference = see(performed, rng=person, settings=OPTICS)
    return WornTrial(record=worn_record(device, performed, excursion_k=excursion_k, rng=noise), reference=reference)


def judge_levels(fit: BenchFit, worn: WornTrial) -> tuple[Trial, ...]:
    """Hold the trial against the optics at each level of correction.

    Parameters
    ----------
    fit : BenchFit
        Calibrations.
    worn : WornTrial
        The trial.

    Returns
    -------
    tuple of Trial
        One for each of ``LEVELS``.
    """
    return tuple(
        validate_trial(worn.record, worn.reference, calibration=calibration, name=name)
        for name, calibration in zip(LEVELS, fit.levels, strict=True)
    )
