"""Quiet stance on a force plate beside the simulated cohort's sway.

Of the plate: the centre of pressure, and the horizontal force over the mass, which is the acceleration of the body's centre. Of
the cohort: the acceleration at L5, which stands at the height of the centre, and the centre of pressure of the pendulum,
p = x - (1.147 h/g) x''. The library's stance is eyes closed on foam; a trial in another condition is told as such. Real and
simulated are different people: there is nothing to pair.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from undrift.arrays import FloatArray, frozen
from undrift.errors import InputError
from undrift.frames import rotate
from undrift.sim.motion.library import draw_task
from undrift.sim.motion.subject import cohort
from undrift.sim.motion.sway import GYRATION
from undrift.sim.motion.task import Task
from undrift.study.real_motion import BesideRow
from undrift.units import STANDARD_GRAVITY

Condition = Literal["closed on foam", "open on foam", "closed on firm", "open on firm"]
RATE_HZ = 100.0
PATH_HZ = 10.0  # the path of the centre of pressure is taken at this rate: the plate's noise adds none
BAND_HZ = (0.05, 2.5)  # below, 50 s do not tell; above, the library has no power
EDGE_S = 2.5  # of the simulated stance, in which sway swells up
STANCE_S = 45.0  # of both, so that slow wander counts alike
MEASURES = (
    ("centre of pressure AP, rms", "mm"),
    ("centre of pressure ML, rms", "mm"),
    ("centre of pressure AP, range", "mm"),
    ("centre of pressure ML, range", "mm"),
    ("speed of the centre of pressure", "mm/s"),
    ("mean frequency AP", "Hz"),
    ("mean frequency ML", "Hz"),
    ("acceleration AP, rms", "mm/s2"),
    ("acceleration ML, rms", "mm/s2"),
)
COLUMNS = {
    "grf": ("Time", "GRFNET_X", "GRFNET_Z", "COPNET_X", "COPNET_Z", 1.0),  # m, X forward
    "plate": ("Time[s]", "Fx[N]", "Fy[N]", "COPx[cm]", "COPy[cm]", 0.01),  # cm, x forward
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Stance:
    """A stance on a force plate, forward and sideways.

    Parameters
    ----------
    name : str
        Of the trial.
    condition : str
        Eyes and surface.
    time : array, shape (N,)
        s.
    acceleration : array, shape (N, 2)
        Of the body's centre, m/s2.
    pressure : array, shape (N, 2)
        Centre of pressure, m.
    """

    name: str
    condition: Condition
    time: FloatArray
    acceleration: FloatArray
    pressure: FloatArray

    def __post_init__(self) -> None:
        n = len(self.time)
        for name, shape in (("time", (n,)), ("acceleration", (n, 2)), ("pressure", (n, 2))):
            object.__setattr__(self, name, frozen(getattr(self, name), shape, f"Stance.{name}"))


def read_stance(path: Path, *, mass_kg: float, condition: Condition) -> Stance:
    """Read a stance from a public force-plate file, tab-separated, gzipped or not.

    Parameters
    ----------
    path : Path
        With net ground reaction force and centre of pressure: GRFNET_X, GRFNET_Z, COPNET_X, COPNET_Z in N and m, or Fx, Fy in N
        and COPx, COPy in cm.
    mass_kg : float
        Of the person.
    condition : str
        Eyes and surface.

    Returns
    -------
    Stance
        Mean force taken off.

    Raises
    ------
    InputError
        No such file, other columns, or a mass that is none.
    """
    import gzip
    import io

    if not mass_kg > 0.0:
        raise InputError(f"{path.name}: wanted the person's mass in kg, got {mass_kg:g}; state it")
    try:
        content = path.read_bytes()
        text = io.StringIO((gzip.decompress(content) if path.suffix == ".gz" else content).decode())
        names = text.readline().split("\t")
        table = np.loadtxt(text, ndmin=2)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: wanted a table of numbers under one line of names, got {error}; check it") from error
    names = [name.strip() for name in names]
    for *wanted, scale in COLUMNS.values():
        if all(name in names for name in wanted):
            at = [names.index(str(name)) for name in wanted]
            force, pressure = table[:, at[1:3]], table[:, at[3:5]] * float(scale)
            return Stance(
                name=path.name.split(".")[0],
                condition=condition,
                time=table[:, at[0]],
                acceleration=(force - force.mean(axis=0)) / mass_kg,
                pressure=pressure,
            )
    raise InputError(
        f"{path.name}: wanted columns GRFNET_X, GRFNET_Z, COPNET_X, COPNET_Z or Fx[N], Fy[N], COPx[cm], COPy[cm], got "
        f"{', '.join(names[:6])}; name them so"
    )


def sway_rows(stances: tuple[Stance, ...], *, subjects: int = 30, seed: int = 0) -> tuple[BesideRow, ...]:
    """Lay stances beside the simulated cohort's sway.

    Parameters
    ----------
    stances : tuple of Stance
        Real trials.
    subjects : int
        Of the simulation cohort, 30 at most.
    seed : int
        Draws cohort and sway.

    Returns
    -------
    tuple of BesideRow
        By stance, then measure.
    """
    people = cohort("simulation", rng=np.random.default_rng([seed, 0]))[:subjects]
    rng = np.random.default_rng([seed, 1])
    drawn = [draw_task("posturography", rng=rng, subject=person) for person in people]
    simulated = np.array([sway_figures(_simulated(task)) for task in drawn])
    low, middle, high = np.percentile(simulated, (2.5, 50.0, 97.5), axis=0)
    rows = []
    for stance in stances:
        other = stance.condition != "closed on foam"
        said = f"{stance.condition}: the library's stance is eyes closed on foam, which sways more" if other else ""
        for k, ((measure, unit), real) in enumerate(zip(MEASURES, sway_figures(stance), strict=True)):
            rows.append(
                BesideRow(
                    trial=stance.name,
                    task="posturography",
                    measure=measure,
                    unit=unit,
                    real=float(real),
                    low=float(low[k]),
                    median=float(middle[k]),
                    high=float(high[k]),
                    said=said,
                )
            )
    return tuple(rows)


def sway_figures(stance: Stance) -> FloatArray:
    """Measure a stance.

    Parameters
    ----------
    stance : Stance
        Real or simulated; its middle 45 s count.

    Returns
    -------
    array, shape (9,)
        In the order and units of ``MEASURES``; NaN where the stance is shorter than 45 s.
    """
    count = round(STANCE_S * RATE_HZ)
    spare = len(stance.time) - count
    if spare < 0:
        return np.full(len(MEASURES), np.nan)
    middle = slice(spare // 2, spare // 2 + count)
    pressure = 1e3 * (stance.pressure[middle] - stance.pressure[middle].mean(axis=0))
    acceleration = 1e3 * (stance.acceleration[middle] - stance.acceleration[middle].mean(axis=0))
    coarse = pressure[:: round(RATE_HZ / PATH_HZ)]
    speed = float(np.linalg.norm(np.diff(coarse, axis=0), axis=1).mean()) * PATH_HZ
    frequency = [_mean_frequency(column) for column in pressure.T]
    return np.array([*pressure.std(axis=0), *np.ptp(pressure, axis=0), speed, *frequency, *acceleration.std(axis=0)])


def _mean_frequency(x: FloatArray) -> float:
    power, frequency = np.abs(np.fft.rfft(x * np.hanning(len(x)))) ** 2, np.fft.rfftfreq(len(x), 1.0 / RATE_HZ)
    band = (frequency >= BAND_HZ[0]) & (frequency <= BAND_HZ[1])
    return float(power[band] @ frequency[band] / power[band].sum())


def _simulated(task: Task) -> Stance:
    time = np.arange(task.moving_s[0] + EDGE_S, task.moving_s[1] - EDGE_S + 1e-9, 1.0 / RATE_HZ)
    motion = task.at(time, STANDARD_GRAVITY)
    acceleration = rotate(motion.q_nb, motion.force_b)[:, :2]
    pressure = task.position(time)[:, :2] - GYRATION * task.arm_b[2] / STANDARD_GRAVITY * acceleration
    return Stance(name="simulated", condition="closed on foam", time=time, acceleration=acceleration, pressure=pressure)
