"""An emulated device on an emulated table: it is read at even steps of emulated time and sends what it says over TCP.

::

    up_b = the mounted face, a little tilted     the table's axis, vertical
    rate_b = turn_rate up_b + R_nb^T earth       force_b = g up_b
    R_nb = R_z(angle) R_face

It says all it says whether anybody listens or not; who connects hears it from then on. With the device's clock in error by c,
reading k is taken at k / (rate (1 + c)). What the effects remember is carried from one chunk to the next; the jitter and the delays
of a converter are left out. Lines and frames are written here from their definitions, apart from the readers in live/.
"""

import binascii
import struct
from collections.abc import Callable
from dataclasses import dataclass
from functools import reduce
from operator import xor
from typing import Literal, Protocol, get_args
from urllib.parse import urlencode

import numpy as np

from testkit.emulated.server import ClientSession, Machine, Served
from undrift.arrays import FloatArray, IntArray
from undrift.base.clock import Clock
from undrift.errors import InputError, check_positive
from undrift.frames import quaternion_conjugate, quaternion_of, quaternion_product, rotate
from undrift.record import MountedFace
from undrift.sim.bench import CausalDevice
from undrift.sim.device.effects import Scene
from undrift.sim.device.model import DeviceModel
from undrift.sim.motion.bench import earth_rate
from undrift.sim.motion.motion import facing, unit_vector
from undrift.units import STANDARD_GRAVITY

# ---- How the emulated device writes its readings: lines with an XOR behind a star, or frames with sync bytes and a CRC-16.

Framing = Literal["line", "frame"]
COUNTER_BITS = 16
SYNC = b"\xaa\x55"


def line_of(count: int, row: FloatArray) -> bytes:
    """Return a reading as a line: numbers joined by commas, star, two hex digits of the XOR of all before it.
    row (K,)."""
    numbers = (f"{int(value)}" if value.is_integer() else repr(value) for value in row.tolist())
    text = ",".join((str(count % 2**COUNTER_BITS), *numbers)).encode("ascii")
    return b"%s*%02X\n" % (text, reduce(xor, text))


def frame_of(count: int, row: FloatArray) -> bytes:
    """Return a reading as a frame: AA 55, counter in two bytes, channels as doubles, CRC-16 of these, little end first.
    The CRC is that of x^16 + x^12 + x^5 + 1, begun with ones, most significant bit first. row (K,)."""
    body = struct.pack(f"<H{len(row)}d", count % 2**COUNTER_BITS, *row.tolist())
    return SYNC + body + struct.pack("<H", binascii.crc_hqx(body, 0xFFFF))


# ---- stream

CHANNELS = ("gyro_x", "gyro_y", "gyro_z", "accel_x", "accel_y", "accel_z", "temp")
DEVICE_FAULTS = {
    "lost_readings": "every seventh reading is not sent; its number is missing",
    "garbled_readings": "every seventh reading is sent with a bit turned over",
    "silence": "nothing is sent while it lasts; the numbers go on",
}
MOST_AT_ONCE = 4096  # readings: a tick does not take for ever
MOST_WAITING = 1 << 22  # bytes kept for a client that does not read


class TurnsOnAxis(Protocol):
    """What turns the device."""

    def axis_states(self, times: FloatArray, *, mean_s: float = 0.0) -> tuple[FloatArray, FloatArray]:
        """Return angle and rate at moments up to now, rad and rad/s: times (n,) s."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StreamSettings:
    """How the device is mounted and sends."""

    sample_rate_hz: float = 100.0  # Readings per second of the device's clock, unless its own model states a rate
    framing: Framing = "line"  # line or frame
    face: MountedFace = "+z"  # Axis of the device that points up at the start
    mount_tilt_sd: float = 0.0  # How well hands mount it: error about each axis, rad, drawn anew each time
    gravity_m_s2: float = STANDARD_GRAVITY  # Local gravity, m/s2
    latitude_deg: float | None = None  # For the Earth's rate; None leaves it out
    power_on_s: float = 3600.0  # Time since power-on at the start, s
    seed: int = 0  # Of noise and tilt
    host: str = "127.0.0.1"  # A loopback address
    port: int = 0  # 0 takes a free one

    def __post_init__(self) -> None:
        if self.framing not in get_args(Framing):
            raise InputError(f"emulated device: wanted format line or frame, got '{self.framing}'; name one of them")
        check_positive(self, "emulated device", "state it", "sample_rate_hz")


class EmulatedDevice(Served, Machine):
    """A device that sends until closed."""

    faulty, faults = "device fault", DEVICE_FAULTS

    def __init__(
        self,
        device: DeviceModel,
        table: TurnsOnAxis,
        board_temp: Callable[[FloatArray], FloatArray],
        clock: Clock,
        settings: StreamSettings,
    ) -> None:
        Machine.__init__(self, clock)
        self.device, self.settings = device, settings
        self.rate = device.sampling.sample_rate_hz or settings.sample_rate_hz
        self._table, self._board_temp = table, board_temp
        self._step = 1.0 / (self.rate * (1.0 + device.sampling.clock_error))
        self._hands = np.random.default_rng((settings.seed, 1))
        self._device = CausalDevice(device, self._step, np.random.default_rng(settings.seed))
        self._mount(settings.face)
        self._last_rate: FloatArray | None = None
        # Compile what takes readings before the first is due: its stream would begin with a backlog of as many seconds
        CausalDevice(device, self._step, np.random.default_rng(0)).read(*self._scene(np.array([clock.now()])))
        self._next = 1 + int(clock.now() / self._step + 1e-6)  # reading k is taken at k steps
        self._last_rate = None
        self.serve(self, (settings.host, settings.port), settings.seed)

    def address(self, clock_speed: float) -> str:
        """Return where it sends and what, as ``live.address`` reads it."""
        line = self.settings.framing == "line"
        options = {
            "format": self.settings.framing,
            "channels": ",".join(("count", *CHANNELS)),
            "rate": repr(self.rate),
            "gyro_unit": self.device.gyro.unit,
            "accel_unit": self.device.accel.unit,
            "counter_bits": str(COUNTER_BITS),
            "checksum": "xor" if line else "crc16",
            **({} if line else {"sync": "aa55", "pack": f"<H{len(CHANNELS)}d"}),
            "clock_speed": repr(float(clock_speed)),
            "device": self.device.serial,
        }
        query = urlencode([pair for pair in options.items() if pair[1]], safe=",/")
        return f"tcp://{self.host}:{self.port}?{query}"

    def mount(self, face: MountedFace) -> None:
        """Mount the device with another face up, from now on."""
        if face not in (faces := get_args(MountedFace)):
            raise InputError(f"mount: wanted one of {', '.join(faces)}, got '{face}'; name the axis that points up")
        with self.lock:
            self._go_on()
            self._mount(face)

    def tick(self) -> None:
        """Come up to now."""
        with self.lock:
            self._go_on()

    def new_session(self, serial: bool) -> "DeviceSession":
        """Make what a client hears."""
        return DeviceSession(self)

    def _mount(self, face: MountedFace) -> None:
        tilt = self._hands.normal(0.0, 1.0, 3) * self.settings.mount_tilt_sd
        up = unit_vector(face) + np.cross(tilt, unit_vector(face))
        self.face, self._up = face, up / np.linalg.norm(up)
        self._mounted = facing(np.array([1.0, 0.0, 0.0, 0.0]), self._up)

    def _go_on(self) -> None:
        now = self.clock.now()
        last = min(int(now / self._step + 1e-6), self._next + MOST_AT_ONCE - 1)  # a clock that adds up tenths
        if last < self._next:
            return
        counts = np.arange(self._next, last + 1)
        self._next = last + 1
        scene, mean = self._scene(np.minimum(counts * self._step, now))
        self._send(counts, np.column_stack(self._device.read(scene, mean)))

    def _scene(self, times: FloatArray) -> tuple[Scene, FloatArray]:
        """Return what surrounds the device at moments, and its mean rate over the step before each."""
        angle, mean_rate = self._table.axis_states(times, mean_s=self._step)
        rate = mean_rate[:, None] * self._up
        if self.settings.latitude_deg is not None:
            q = quaternion_product(quaternion_of(angle[:, None] * np.array([0.0, 0.0, 1.0])), self._mounted)
            rate = rate + rotate(quaternion_conjugate(q), earth_rate(self.settings.latitude_deg))
        before = np.vstack((rate[:1] if self._last_rate is None else self._last_rate, rate[:-1]))
        self._last_rate = rate[-1:]
        force = np.broadcast_to(self.settings.gravity_m_s2 * self._up, (len(times), 3))
        return self._surroundings(times, rate, (rate - before) / self._step, force), rate

    def _surroundings(self, times: FloatArray, rate: FloatArray, acceleration: FloatArray, force: FloatArray) -> Scene:
        temp = self._board_temp(times)
        return Scene(
            time=times,
            step_s=self._step,
            temp_c=temp,
            warmth=temp - self.device.reference_temp_c,
            age_s=times + self.settings.power_on_s,
            rate_b=rate,
            angular_acceleration_b=acceleration,
            force_b=force,
        )

    def _send(self, counts: IntArray, rows: FloatArray) -> None:
        if not self.sessions or "silence" in self._broken:
            return
        write, pieces = line_of if self.settings.framing == "line" else frame_of, []
        for count, row in zip(counts.tolist(), rows, strict=True):
            struck, piece = count % 7 == 0, write(count, row)
            if struck and "garbled_readings" in self._broken:
                piece = piece[:5] + bytes([piece[5] ^ 0x04]) + piece[6:]
            if not (struck and "lost_readings" in self._broken):
                pieces.append(piece)
        for session in self.sessions:
            session.tell(b"".join(pieces))


class DeviceSession(ClientSession):
    """One client of a device, which takes no notice of what it says."""

    def tell(self, data: bytes) -> None:
        """Take what the device says."""
        if len(self._unasked) < MOST_WAITING:
            super().tell(data)
