"""Simulated sessions and trials: a device, a motion, and the data that undrift receives."""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray
from undrift.record import Record, Reference, Session, TemperatureSensitivity
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.presets import PRESETS, sensitivity_of
from undrift.sim.device.simulate import simulate_device
from undrift.sim.motion.bench import BenchKind, BenchSettings, bench_motion
from undrift.sim.motion.motion import Motion
from undrift.sim.motion.poses import OpticsSettings, see
from undrift.sim.motion.tasks import TaskName, draw_task
from undrift.units import STANDARD_GRAVITY

SAMPLE_RATE_HZ = 100.0  # sample rate of a trial


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SimulatedTrial:
    """A test trial and its truth."""

    record: Record  # readings of the device
    reference: Reference  # poses of the cameras
    motion: Motion  # true motion at the samples of the device


def simulate_session(
    kind: BenchKind,
    device: DeviceModel,
    *,
    rng: np.random.Generator,
    settings: BenchSettings | None = None,
    temp_c: float | tuple[float, float] | None = None,
    power_on_s: float = 0.0,
    labelled: bool = True,
) -> Session:
    """Return a calibration session of a simulated device.

    Parameters
    ----------
    kind : str
        six_face, rate_table, bench, ferraris or multi_position.
    device : DeviceModel
        The sensors.
    rng : Generator
        Draws motion and noise.
    settings : BenchSettings, optional
        Rests, turns and errors of the bench.
    temp_c : float or (float, float), optional
        Board temperature, degC: constant, or at start and end with a linear change. Default: the reference temperature.
    power_on_s : float
        Time since power-on at the first sample, s.
    labelled : bool
        False returns a session without the labels of its stills and turns.

    Returns
    -------
    Session
        One recording.

    Examples
    --------
    >>> import numpy as np, undrift
    >>> rng = np.random.default_rng(7)
    >>> device = undrift.random_device(rng)
    >>> session = undrift.simulate_session("bench", device, rng=rng)
    >>> len(session.stills), len(session.turns)
    (9, 102)
    """
    motion = bench_motion(kind, rng=rng, settings=settings)
    reading = simulate_device(device, motion, rng=rng, temp_c=_temperature(temp_c, len(motion)), power_on_s=power_on_s)
    return Session(
        kind="calibration",
        serial=device.serial,
        gravity_m_s2=motion.gravity_m_s2,
        records=(reading.record,),
        stills=motion.stills if labelled else (),
        turns=motion.turns if labelled else (),
        sensitivity=sensitivity_of(device.name) if device.name in PRESETS else TemperatureSensitivity(),
    )


def simulate_trial(
    task: TaskName,
    device: DeviceModel,
    *,
    rng: np.random.Generator,
    gravity_m_s2: float = STANDARD_GRAVITY,
    optics: OpticsSettings | None = None,
    temp_c: float | tuple[float, float] | None = None,
) -> SimulatedTrial:
    """Return a test trial of a simulated device with its optical reference.

    Parameters
    ----------
    task : str
        sit_to_stand, posturography, free or step.
    device : DeviceModel
        The sensors.
    rng : Generator
        Draws performance, noise and optics.
    gravity_m_s2 : float
        Gravity, m/s2.
    optics : OpticsSettings, optional
        Rate and errors of the cameras.
    temp_c : float or (float, float), optional
        Board temperature, degC, as in ``simulate_session``.

    Returns
    -------
    SimulatedTrial
        Record, reference and truth.

    Examples
    --------
    >>> import numpy as np, undrift
    >>> rng = np.random.default_rng(7)
    >>> device = undrift.random_device(rng)
    >>> trial = undrift.simulate_trial("sit_to_stand", device, rng=rng)
    >>> len(trial.record), trial.record.sample_rate_hz
    (1545, 100.0)
    """
    performed = draw_task(task, rng=rng)
    time = np.arange(round(performed.duration_s * SAMPLE_RATE_HZ)) / SAMPLE_RATE_HZ
    motion = performed.at(time, gravity_m_s2)
    record = simulate_device(device, motion, rng=rng, temp_c=_temperature(temp_c, len(motion))).record
    return SimulatedTrial(record=record, reference=see(performed, rng=rng, settings=optics), motion=motion)


def _temperature(temp_c: float | tuple[float, float] | None, samples: int) -> float | FloatArray | None:
    return np.linspace(*temp_c, samples) if isinstance(temp_c, tuple) else temp_c
