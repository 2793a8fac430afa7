"""A calibration session as a study simulates it: the protocol's dwells on the virtual bench, and what the device reads.

Order of a session, at each set-point in turn: faces (at the first only); then for each axis a rest, the rates both ways, a
rest. What a dwell imposes is known; what the device makes of it is simulated (sim/device/dwells.py). Between dwells the table
runs up and the filter settles, which takes time in which the offset wanders on.
"""

import math
from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.drift.observations import RateSteps, RestBlocks
from undrift.errors import InputError
from undrift.protocol import Protocol
from undrift.session import FACES, Axis, Face
from undrift.sim.device.dwells import DwellReadings, Dwells, simulate_dwells
from undrift.sim.device.model import DeviceModel
from undrift.units import STANDARD_GRAVITY

WARMED_UP_S = 1800.0  # the bench waits half an hour after power-on
SOAK_S = 1800.0  # ramp and soak between set-points
MOUNT_S = 60.0  # a person turns the device over
ROOM_TEMP_C = 25.0
_UP: dict[Axis, Face] = {"x": "+x", "y": "+y", "z": "+z"}


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


def settling_s(cutoff_hz: float) -> float:
    """Return how long a second-order low-pass takes to settle to a thousandth, 0.3 s at least.

    Parameters
    ----------
    cutoff_hz : float
        Hz.

    Returns
    -------
    float
        ``ln(1000) / (0.7071 * 2 pi f)``, s.
    """
    return max(0.3, math.log(1000.0) / (math.sqrt(0.5) * 2.0 * math.pi * cutoff_hz))


def impose(protocol: Protocol, *, rng: np.random.Generator, gravity_m_s2: float = STANDARD_GRAVITY) -> Imposed:
    """Lay out the dwells of a protocol.

    Parameters
    ----------
    protocol : Protocol
        What to do.
    rng : Generator
        Draws a random order.
    gravity_m_s2 : float
        m/s2.

    Returns
    -------
    Imposed
        In the order of time.

    Raises
    ------
    InputError
        A protocol without rates, or whose dwells have no stated length.
    """
    if protocol.dwell_s is None or protocol.turn_rate_step <= 0.0:
        raise InputError("study: wanted a protocol with rates and dwell_s, got none; state both")
    rows: list[tuple[float, float, FloatArray, Face, float, int, int]] = []
    clock, settle = WARMED_UP_S, settling_s(protocol.cutoff_hz)
    temperatures = protocol.temperatures_c or (ROOM_TEMP_C,)
    for soak, temp in enumerate(temperatures):
        clock += SOAK_S if protocol.temperatures_c else 0.0
        for face in protocol.faces if soak == 0 else ():
            clock += MOUNT_S
            rows.append((clock, protocol.face_s, np.zeros(3), face, temp, soak, FACE))
            clock += protocol.face_s
        for axis in protocol.axes:
            clock += MOUNT_S
            for signed in (0.0, *_ordered(protocol, rng), 0.0):
                clock += abs(signed) / protocol.acceleration * 2.0 + settle
                length = protocol.dwell_s if signed else protocol.bracket_s
                if length > 0.0:
                    rate = np.zeros(3)
                    rate["xyz".index(axis)] = signed
                    rows.append((clock, length, rate, _UP[axis], temp, soak, RATE if signed else REST))
                    clock += length
    return Imposed(
        dwells=Dwells(
            start_s=np.array([row[0] for row in rows]),
            duration_s=np.array([row[1] for row in rows]),
            rate_b=np.array([row[2] for row in rows]),
            force_b=np.array([_force(row[3], gravity_m_s2) for row in rows]),
            temp_c=np.array([row[4] for row in rows]),
        ),
        soak=np.array([row[5] for row in rows]),
        kind=np.array([row[6] for row in rows]),
        faces=tuple(row[3] for row in rows),
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


def _ordered(protocol: Protocol, rng: np.random.Generator) -> list[float]:
    rates = protocol.turn_rates()
    if protocol.order == "random":
        return [float(rate) for rate in rng.permutation(rates)]
    positive = rates[rates > 0.0]
    return [float(signed) for rate in positive for signed in (rate, -rate)]


def _force(face: Face, gravity_m_s2: float) -> FloatArray:
    force = np.zeros(3)
    force["xyz".index(face[1])] = gravity_m_s2 if face[0] == "+" else -gravity_m_s2
    return force
