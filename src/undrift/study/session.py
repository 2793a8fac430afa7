"""A calibration session as a study simulates it: the protocol's programme on the virtual bench, and what the device reads.

The steps are those of ``undrift rig run`` (rig/programme.py): first the faces at room temperature, then, for each axis
mounted once, all set-points in it: a rest, the rates both ways, a rest. What a dwell imposes is known; what the device makes
of it is simulated (sim/device/dwells.py). Between dwells the chamber soaks, the table runs up and the filter settles, while
the offset wanders on.
"""

from dataclasses import dataclass, replace

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.drift.observe.observations import RateSteps, RestBlocks
from undrift.errors import InputError
from undrift.protocol import Protocol
from undrift.rig.programme import Dwell, Purpose, programme_of
from undrift.session import FACES, Face
from undrift.sim.device.dwells import DwellReadings, Dwells, simulate_dwells
from undrift.sim.device.model import DeviceModel
from undrift.units import STANDARD_GRAVITY

WARMED_UP_S = 1800.0  # the bench waits half an hour after power-on
ROOM_TEMP_C = 25.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Imposed:
    """What a session imposes, N dwells.

    Parameters
    ----------
    dwells : Dwells
        Times, rates, forces, temperatures.
    kind : array of int, shape (N,)
        0 a face, 1 a rest at zero rate, 2 a steady rate.
    soak : array of int, shape (N,)
        Which set-point.
    faces : tuple of str
        Axis that points up, for each dwell.
    duration_s : float
        Of the whole session on the rig, s.
    """

    dwells: Dwells
    kind: IntArray
    soak: IntArray
    faces: tuple[Face, ...]
    duration_s: float


FACE, REST, RATE = 0, 1, 2
KINDS: dict[Purpose, int] = {"face": FACE, "bracket": REST, "rate": RATE}


def impose(protocol: Protocol, *, gravity_m_s2: float = STANDARD_GRAVITY) -> Imposed:
    """Lay out the dwells of a protocol.

    Parameters
    ----------
    protocol : Protocol
        What to do.
    gravity_m_s2 : float
        m/s2.

    Returns
    -------
    Imposed
        In the order of time.

    Raises
    ------
    InputError
        A protocol without rates.
    """
    if protocol.turn_rate_step <= 0.0:
        raise InputError("study: wanted a protocol with rates, got none; state turn_rate_step and the two ends")
    steps = [*programme_of(replace(protocol, faces=())).steps]
    if protocol.faces:
        steps = [*programme_of(replace(protocol, turn_rate_step=0.0, temperatures_c=())).steps, *steps]
    temperatures = protocol.temperatures_c or (ROOM_TEMP_C,)
    rows: list[tuple[float, Dwell]] = []
    clock = WARMED_UP_S
    for step in steps:
        if isinstance(step, Dwell):
            rows.append((clock + step.ramp_s + step.settle_s, step))
        clock += step.duration_s
    dwells = [dwell for _, dwell in rows]
    warm = [ROOM_TEMP_C if dwell.temp_c is None else dwell.temp_c for dwell in dwells]
    return Imposed(
        dwells=Dwells(
            start_s=np.array([start for start, _ in rows]),
            duration_s=np.array([dwell.dwell_s for dwell in dwells]),
            rate_b=np.array([_rate(dwell) for dwell in dwells]),
            force_b=np.array([_force(dwell.up, gravity_m_s2) for dwell in dwells]),
            temp_c=np.array(warm),
        ),
        kind=np.array([KINDS[dwell.purpose] for dwell in dwells]),
        soak=np.array(
            [0 if dwell.purpose == "face" else temperatures.index(t) for dwell, t in zip(dwells, warm, strict=True)]
        ),
        faces=tuple(dwell.up for dwell in dwells),
        duration_s=clock - WARMED_UP_S,
    )


def rest_blocks(imposed: Imposed, readings: DwellReadings) -> RestBlocks:
    """Return the rests at zero rate as the drift fits take them.

    Parameters
    ----------
    imposed : Imposed
        What was done.
    readings : DwellReadings
        What the device said.

    Returns
    -------
    RestBlocks
        One row a rest.
    """
    at = np.flatnonzero(imposed.kind == REST)
    count = readings.samples[at, None]
    middle = imposed.dwells.start_s[at] + 0.5 * imposed.dwells.duration_s[at]
    return RestBlocks(
        session=np.zeros(len(at), dtype=np.int64),
        pose=np.array([FACES.index(imposed.faces[i]) for i in at], dtype=np.int64),
        time=middle,
        power_on_s=middle,
        temp_c=readings.temp_c[at],
        ramp_c_per_min=np.zeros(len(at)),
        gyro=readings.gyro[at],
        accel=readings.accel[at],
        gyro_variance=readings.gyro_variance[at] / count,
        accel_variance=readings.accel_variance[at] / count,
    )


def rate_steps(imposed: Imposed, readings: DwellReadings) -> RateSteps:
    """Return the dwells at a steady rate as the drift fits take them.

    Parameters
    ----------
    imposed : Imposed
        What was done.
    readings : DwellReadings
        What the device said.

    Returns
    -------
    RateSteps
        One row a dwell.
    """
    at = np.flatnonzero(imposed.kind == RATE)
    return RateSteps(
        session=np.zeros(len(at), dtype=np.int64),
        soak=imposed.soak[at],
        time=imposed.dwells.start_s[at] + 0.5 * imposed.dwells.duration_s[at],
        temp_c=readings.temp_c[at],
        rate_b=imposed.dwells.rate_b[at],
        gyro=readings.gyro[at],
        accel=readings.accel[at],
        gyro_variance=readings.gyro_variance[at] / readings.samples[at, None],
    )


def read_session(imposed: Imposed, device: DeviceModel, *, rng: np.random.Generator) -> DwellReadings:
    """Return what a device reads in a session.

    Parameters
    ----------
    imposed : Imposed
        What is done.
    device : DeviceModel
        The device.
    rng : Generator
        Draws its noise.

    Returns
    -------
    DwellReadings
        One row a dwell.
    """
    return simulate_dwells(device, imposed.dwells, rng=rng, felt=imposed.kind == FACE)


def _rate(dwell: Dwell) -> FloatArray:
    rate = np.zeros(3)
    if dwell.axis is not None:
        rate["xyz".index(dwell.axis)] = dwell.turn_rate
    return rate


def _force(face: Face, gravity_m_s2: float) -> FloatArray:
    force = np.zeros(3)
    force["xyz".index(face[1])] = gravity_m_s2 if face[0] == "+" else -gravity_m_s2
    return force
