"""A run's bench over the emulator: a device that does not exist on its axis, hands and a chamber that obey at once."""

import contextlib
import math
import time

import numpy as np

from testkit.emulated.emulator import Emulator, EmulatorSettings
from testkit.emulated.stream import EmulatedDevice, StreamSettings
from testkit.emulated_axis import axis_rate
from undrift.base.clock import VirtualClock
from undrift.record import Record
from undrift.rig.chamber import SoakSettings
from undrift.rig.folder import RunFolder
from undrift.rig.judge import RunSettings
from undrift.rig.programme import Protocol, programme_of
from undrift.rig.rig import Limits, RigSettings, open_rig
from undrift.rig.run import RigBench, run_programme
from undrift.sim.device.effects import Offset, Scale, SensorChain, WhiteNoise
from undrift.sim.device.model import DeviceModel
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

DPS = RADIAN_PER_DEGREE
GAIN = np.array([[1.02, 0.01, -0.005], [0.0, 0.97, 0.008], [0.012, -0.004, 1.01]])
OFFSET = np.array([1.5, -0.8, 0.4])  # dps
NOISE_DPS = 0.02
LIMITS = Limits(turn_rate=200.0 * DPS, acceleration=50.0, travel=None)
UP = {sign + axis: (1 if sign == "+" else -1) * np.eye(3)[k] for k, axis in enumerate("xyz") for sign in "+-"}
SHORT = Protocol(
    name="short",
    faces=("+z",),
    face_s=0.5,
    turn_rate_min=30.0 * DPS,
    turn_rate_max=60.0 * DPS,
    turn_rate_step=30.0 * DPS,
    axes=("z",),
    dwell_s=1.0,
    bracket_s=0.5,
)

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


class Hands:
    """Mount at once, and remember how."""

    def __init__(self):
        self.up = None
        self.mounted = []

    def mount(self, up):
        self.up = up
        self.mounted.append(up)


class Device:
    """Reads the emulator's true axis through a matrix, an offset and noise, 100 times an emulated second."""

    def __init__(self, emulator, hands, seed=1):
        self.emulator, self.hands = emulator, hands
        self.rng = np.random.default_rng(seed)
        self.began = self.ended = None

    def start(self, *, certain=True):
        self.began, self.ended = self.emulator.now(), None

    def end(self):
        self.ended = self.emulator.now()

    def stop(self):
        times = np.arange(self.began, self.emulator.now() if self.ended is None else self.ended, 0.01)
        _, rate = self.emulator.axis_states(times, mean_s=0.01)
        up = self.up()
        gyro = (rate[:, None] / DPS * up) @ GAIN.T + OFFSET + NOISE_DPS * self.rng.normal(size=(len(times), 3))
        accel = np.tile(STANDARD_GRAVITY * up, (len(times), 1)) + 1e-3 * self.rng.normal(size=(len(times), 3))
        return Record(time=times, gyro=gyro, accel=accel, gyro_unit="dps", accel_unit="m/s2", device="made")

    def up(self):
        return UP[self.hands.up]

    def latest(self):
        return ""

    def close(self):
        pass


class Oven:
    """A chamber that is soaked on the second question."""

    near_c = None

    def __init__(self, window_s=300.0):
        self.temp_c, self.asked = 25.0, 0
        self.criterion = SoakSettings(window_s=window_s)

    def set(self, temp_c):
        self.temp_c, self.asked = temp_c, 0
        return temp_c

    def read(self):
        return self.temp_c

    def slope_c_per_min(self):
        return math.inf

    def soaked(self):
        self.asked += 1
        return self.asked > 1

    def close(self):
        pass


def streaming(emulator, seed=1):
    """Return the same device as one that sends: +z up, 25 degC, listened to over its socket."""
    noise = NOISE_DPS * DPS * np.sqrt(0.01)
    device = DeviceModel(
        serial="made",
        gyro=SensorChain(
            unit="dps",
            scale=Scale(nominal_sensitivity=1.0 / DPS, error=np.diag(GAIN) - 1.0),
            offset=Offset(constant=OFFSET * DPS),
            white_noise=WhiteNoise(random_walk=np.full(3, noise)),
        ),
        accel=SensorChain(unit="m/s2", scale=Scale(nominal_sensitivity=1.0)),
    )
    return EmulatedDevice(
        device, emulator, lambda times: np.full(len(times), 25.0), emulator.clock, StreamSettings(seed=seed)
    )


def emulated(**settings):
    """Return an emulated table on a clock of its own, on which no time passes but what the test waits for."""
    return Emulator(EmulatorSettings(**settings), clock=VirtualClock())


def on_host(speed=20.0, **settings):
    """Return one behind real sockets, on the host's clock, for other processes."""
    return Emulator(EmulatorSettings(speed=speed, **settings))


def opened(emulator, **settings):
    """Open the table; on the host's clock answers have time, as other programs may keep the computer busy."""
    reply_timeout_s = 2.0 if isinstance(emulator.clock, VirtualClock) else 20.0
    return open_rig(
        f"{emulator.settings.kind}:tcp://{emulator.host}:{emulator.port}",
        RigSettings(**{"clock": emulator.clock, "reply_timeout_s": reply_timeout_s, "limits": LIMITS, **settings}),
    )


def run(
    emulator,
    path,
    protocol=SHORT,
    *,
    resume=False,
    report=lambda progress: None,
    chamber=None,
    giving_up=RunSettings(device_lag_s=0.0),
    readings=None,
    **settings,
):
    """Run a protocol on an emulator; return the result and the hands. Readings are the fake device's, made likewise, or given."""
    hands, readings = Hands(), readings or Device
    with RunFolder(path, protocol, resume=resume) as folder:
        bench = RigBench(
            rig=opened(emulator, **settings),
            readings=readings(emulator, hands) if callable(readings) else readings,
            mounting=hands,
            chamber=chamber,
            clock=emulator.clock,
        )
        made = run_programme(
            programme_of(protocol),
            bench,
            folder,
            report=report,
            serial="made",
            gravity_m_s2=STANDARD_GRAVITY,
            settings=giving_up,
        )
    return made, hands


def mean_turn_rate(rig, clock, duration_s):
    """Return the mean rate over a while, from two positions."""
    first = rig.position()
    clock.wait(duration_s)
    last = rig.position()
    return (last.angle - first.angle) / (last.time - first.time)


def at_rest(emulator, within_s=60.0):
    """Wait until the true axis is at rest with its motor off; False when it never is."""
    return emulator.clock.host.until(
        lambda: abs(axis_rate(emulator)) <= 1e-3 and not emulator.motor_on, within_s, 0.005
    )


def gain_of(session, turn_rates=None):
    """Return the device's own-axis gain by least squares, and its standard uncertainty."""
    turns = session.turns
    rates = np.array([t.turn_rate for t in turns]) / DPS if turn_rates is None else np.asarray(turn_rates) / DPS
    axis = "xyz".index(turns[0].axis)
    means = np.array([session.records[t.recording].gyro[t.start : t.stop, axis].mean() for t in turns])
    shape = np.stack((rates, np.ones_like(rates)), axis=1)
    fit, _, _, _ = np.linalg.lstsq(shape, means, rcond=None)
    left = means - shape @ fit
    scatter = math.sqrt(max(left @ left / max(1, len(rates) - 2), NOISE_DPS**2 / 50))
    return fit[0], scatter * math.sqrt(np.linalg.inv(shape.T @ shape)[0, 0])


@contextlib.contextmanager
def timed(label, log):
    start = time.monotonic()
    yield
    log.append((label, time.monotonic() - start))
