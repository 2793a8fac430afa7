"""The simulated bench for tests of a run: a device whose errors are known, hands that mount at once, an oven that soaks at once."""

import math
from collections.abc import Mapping
from dataclasses import replace
from unittest import mock

import numpy as np

from testkit.virtual_clock import VirtualClock
from undrift.programme import FacesTable, Protocol, ProtocolTable, RatesTable, TemperaturesTable, programme_of
from undrift.rig import chamber as chamber_file
from undrift.rig.chamber import ChamberSetup
from undrift.rig.folder import RunFolder
from undrift.rig.rig import Limits, RigSettings, open_rig
from undrift.rig.run import Mounted, RigBench, run_programme
from undrift.rig.simulated import SimulatedBench, SimulatedSettings
from undrift.sim.device.effects import Offset, Scale, SensorChain, WhiteNoise
from undrift.sim.device.model import DeviceModel
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

DPS = RADIAN_PER_DEGREE
GAIN = np.array([[1.02, 0.01, -0.005], [0.0, 0.97, 0.008], [0.012, -0.004, 1.01]])
OFFSET = np.array([1.5, -0.8, 0.4])  # dps
NOISE_DPS, RATE_HZ = 0.02, 100.0
LIMITS = Limits(turn_rate=200.0 * DPS, acceleration=50.0, travel=None)
UP = {sign + axis: (1 if sign == "+" else -1) * np.eye(3)[k] for k, axis in enumerate("xyz") for sign in "+-"}
FACE = FacesTable(order=("+z",), seconds=0.5)
RATES = RatesTable(
    turn_rate_min_dps=30.0, turn_rate_max_dps=60.0, turn_rate_step_dps=30.0, axes=("z",), seconds=1.0, bracket_s=0.5
)
SHORT = Protocol(protocol=ProtocolTable(name="short"), faces=FACE, rates=RATES)


def with_set_points(protocol, *set_points_c):
    return protocol.but(temperatures=TemperaturesTable(set_points_c=set_points_c))


PROTOCOL = """
[protocol]
name = "end to end"
[faces]
seconds = 3.0
[rates]
turn_rate_min_dps = 30.0
turn_rate_max_dps = 90.0
turn_rate_step_dps = 30.0
seconds = 3.0
bracket_s = 2.0
"""

# gyro = GAIN rate + OFFSET in deg/s, accel = force, with white noise
DEVICE = DeviceModel(
    serial="made",
    gyro=SensorChain(
        unit="dps",
        scale=Scale(
            nominal_sensitivity=1.0 / DPS,
            error=np.linalg.norm(GAIN, axis=1) - 1.0,
            axes=GAIN / np.linalg.norm(GAIN, axis=1, keepdims=True),
        ),
        offset=Offset(constant=OFFSET * DPS),
        white_noise=WhiteNoise(random_walk=np.full(3, NOISE_DPS * DPS / math.sqrt(RATE_HZ))),
    ),
    accel=SensorChain(
        unit="m/s2",
        scale=Scale(nominal_sensitivity=1.0),
        white_noise=WhiteNoise(random_walk=np.full(3, 1e-3 / math.sqrt(RATE_HZ))),
    ),
)


def simulated(clock=None, *, devices=1, **settings):
    """Return a simulated bench with these devices. On a virtual clock, time passes only when the test waits."""
    return SimulatedBench(
        (DEVICE,) * devices, SimulatedSettings(**{"limits": LIMITS, **settings}), clock or VirtualClock()
    )


class Hands:
    """Operator who mounts immediately and records it. Some mountings, counted from 1, have another face than requested."""

    def __init__(self, bench, wrong: Mapping[int, str] = {}):
        self.bench, self.wrong, self.mounted = bench, dict(wrong), []

    def mount(self, up):
        self.mounted.append(up)
        self.bench.mount(self.wrong.get(len(self.mounted), up))


class Device:
    """Readings of a device on the bench, for tests that modify them, without a thermometer."""

    def __init__(self, bench, number=0):
        self.bench, self.readings = bench, bench.readings[number]

    def start(self):
        self.readings.start()

    def end(self):
        self.readings.end()

    def stop(self):
        return replace(self.readings.stop(), temp_c=None)

    def latest(self):
        return ""

    def close(self):
        pass


class Oven:
    """A chamber that is soaked on the second question."""

    near_c = None

    def __init__(self, window_s=300.0):
        self.temp_c, self.asked = 25.0, 0
        self.settings = ChamberSetup(window_s=window_s)

    def set(self, temp_c):
        self.temp_c, self.asked = temp_c, 0
        return temp_c

    def read(self):
        return self.temp_c

    def soaked(self, slope_c_per_min):
        self.asked += 1
        return self.asked > 1

    def close(self):
        pass


def driven(card, **settings):
    """Open the driver of a card on the clock of its bench: Galil or GRBL."""
    clock = card.bench.clock
    return open_rig(card.address, RigSettings(**{"clock": clock, "limits": LIMITS, **settings}))


def run(
    bench,
    path,
    protocol=SHORT,
    *,
    resume=False,
    report=lambda progress: None,
    chamber=None,
    after_air_s=0.0,
    readings=Device,
    hands=None,
    rig=None,
):
    """Run a protocol on a bench, with its own table or a driver. Return the result and the operator."""
    hands = hands or Hands(bench)
    after_air = mock.patch.object(chamber_file, "AFTER_AIR_S", after_air_s)
    with RunFolder(path, protocol, resume=resume) as folder, after_air:
        table = rig() if rig else bench.table
        connected = RigBench(rig=table, mounting=hands, chamber=chamber, clock=bench.clock)
        mounted = Mounted(readings=readings(bench), folder=folder, serial="made")
        (result,) = run_programme(
            programme_of(protocol),
            connected,
            mounted,
            report=report,
            gravity_m_s2=STANDARD_GRAVITY,
        )
    return result, hands


def at_rest(bench, within_s=60.0):
    """Wait until the true axis is at rest with its motor off. Return False if this never happens."""
    return bench.clock.until(lambda: abs(bench.turn_rate()) <= 1e-3 and not bench.servo.powered, within_s, 0.1) is True


def gain_of(session, turn_rates=None):
    """Return the device's own-axis gain by least squares, and its standard uncertainty."""
    turns = session.turns
    rates = np.array([t.turn_rate for t in turns]) / DPS if turn_rates is None else np.asarray(turn_rates) / DPS
    axis = "xyz".index(turns[0].axis)
    means = np.array([session.records[t.recording].gyro[t.start : t.stop, axis].mean() for t in turns])
    shape = np.stack((rates, np.ones_like(rates)), axis=1)
    fit, _, _, _ = np.linalg.lstsq(shape, means, rcond=None)
    residual = means - shape @ fit
    scatter = math.sqrt(max(residual @ residual / max(1, len(rates) - 2), NOISE_DPS**2 / 50))
    return fit[0], scatter * math.sqrt(np.linalg.inv(shape.T @ shape)[0, 0])
