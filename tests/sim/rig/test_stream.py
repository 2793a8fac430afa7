"""The emulated device on the emulated table: what live/ reads from its socket is what the device was made to say."""

import socket
import struct
import threading

import numpy as np
import pytest

from undrift.arrays import frozen
from undrift.base.clock import VirtualClock
from undrift.errors import InputError, RigFault, RigTimeout
from undrift.live.decoder import FrameDecoder, LineDecoder, StreamDescription
from undrift.live.transports import source_at
from undrift.record import FACES
from undrift.sim.device.presets import random_device
from undrift.sim.motion.bench import EARTH_RATE
from undrift.sim.motion.motion import unit_vector
from undrift.sim.rig.emulator import BenchHands, EmulatedBench, EmulatedBenchSettings
from undrift.sim.rig.stream import CHANNELS, CausalDevice, EmulatedDevice, StreamSettings, frame_of, line_of
from undrift.units import STANDARD_GRAVITY

DEVICE = random_device(np.random.default_rng(8), grade="consumer", serial="HIDDEN-1")


class Table:
    """Turns at a steady rate since time zero."""

    def __init__(self, turn_rate: float = 0.0) -> None:
        self.turn_rate = turn_rate

    def axis_states(self, times, *, mean_s=0.0):
        return times * self.turn_rate, np.full(len(times), self.turn_rate)


class Heard:
    """A device on a clock that is moved by hand, and what it says."""

    def __init__(self, table=None, device=DEVICE, **settings) -> None:
        self.clock = VirtualClock()
        warm = lambda times: np.full(len(times), 25.0)  # noqa: E731
        self.device = EmulatedDevice(device, table or Table(), warm, self.clock, StreamSettings(**settings))
        self.source = source_at(self.device.address(1.0), clock=self.clock)
        self.source.open()

    def __enter__(self) -> "Heard":
        return self

    def __exit__(self, *failure: object) -> None:
        self.source.close()
        self.device.close()

    def next(self, duration_s: float) -> tuple[np.ndarray, np.ndarray]:
        """Go on so long, and return counters and readings of it."""
        self.clock.wait(duration_s)
        last, counts, values = round(self.clock.now() * 100.0), [], []
        while not counts or counts[-1] < last:
            chunk = self.source.read(60.0)
            counts += chunk.counter.tolist()
            values += chunk.values.tolist()
        return np.array(counts), np.array(values)


def test_a_stream_does_not_begin_with_a_backlog_of_what_its_first_reading_compiled(monkeypatch):
    read, hand_clock, clocks = CausalDevice.read, VirtualClock, []

    def slow_once(device, scene, mean):
        if clocks and not clocks[0].now():
            clocks[0].wait(25.0)
        return read(device, scene, mean)

    monkeypatch.setattr(CausalDevice, "read", slow_once)
    monkeypatch.setitem(globals(), "VirtualClock", lambda: clocks.append(hand_clock()) or clocks[-1])
    with Heard() as heard:
        assert heard.next(0.1)[0].tolist() == list(range(2501, 2511))


@pytest.mark.parametrize("count", [0, 255, 65_535, 65_536 + 7])
def test_what_is_written_here_is_read_there(count):
    row = frozen([1.0, -2.0, 0.1, 1e-7, 3e5, -0.0, 24.75], (None,), "row")
    shared = {"channels": ("count", *CHANNELS), "rate": 100.0}
    line = LineDecoder(StreamDescription(**shared, checksum="xor"))
    frame = FrameDecoder(StreamDescription(**shared, format="frame", checksum="crc16", pack="<H7d"))
    wanted = [[count % 65_536, *row.tolist()]]
    assert line.feed(b"\n" + line_of(count, row)).tolist() == wanted
    assert frame.feed(frame_of(count, row)).tolist() == wanted
    assert line.errors == frame.errors == 0


def test_the_checksum_of_a_line_is_that_of_the_star():
    row = frozen([7.0], (None,), "row")
    assert line_of(1, row) == b"1,7*%02X\n" % (ord("1") ^ ord(",") ^ ord("7"))
    assert frame_of(1, row)[:4] == b"\xaa\x55\x01\x00"
    assert struct.unpack("<d", frame_of(1, row)[4:12]) == (7.0,)


@pytest.mark.parametrize("framing", ["line", "frame"])
def test_readings_carry_every_number_in_its_turn(framing):
    with Heard(framing=framing) as heard:
        counts = np.concatenate([heard.next(step)[0] for step in (0.5, 0.013, 2.0)])
        assert counts.tolist() == list(range(1, 252))


def test_the_readings_do_not_depend_on_how_often_the_device_is_looked_at():
    quiet = DEVICE.without_noise()
    with Heard(Table(0.7), quiet) as one, Heard(Table(0.7), quiet) as other:
        whole = one.next(2.0)[1]
        parts = np.vstack([other.next(0.1)[1] for _ in range(20)])
    assert parts == pytest.approx(whole, rel=1e-12)


def test_noise_is_drawn_from_the_seed():
    with Heard(seed=3) as one, Heard(seed=4) as other:
        apart = one.next(1.0)[1] - other.next(1.0)[1]
    assert (apart[:, :6].std(axis=0) > 0.0).all()


@pytest.mark.parametrize("face", FACES)
def test_a_face_that_points_up_feels_gravity_and_the_whole_turn(face):
    quiet = DEVICE.without_noise()
    up = unit_vector(face)
    with Heard(Table(1.2), quiet, face=face) as heard:
        said = heard.next(1.0)[1]
    gyro = quiet.gyro.forward_matrix @ (1.2 * up) + quiet.gyro.raw_offset
    accel = quiet.accel.forward_matrix @ (STANDARD_GRAVITY * up) + quiet.accel.raw_offset
    assert said[-1, 3:6] == pytest.approx(accel, abs=0.1 + 2e-3 * np.abs(accel).max())
    assert said[-1, :3] == pytest.approx(gyro, abs=1.0 + 0.02 * np.abs(gyro).max())  # g-sensitivity and bend


def test_mounting_moves_the_device_at_once_and_tilts_it_anew():
    with Heard(device=DEVICE.without_noise(), mount_tilt_sd=0.01) as heard:
        first = heard.next(0.5)[1][-1]
        heard.device.mount("-z")
        upside_down = heard.next(0.5)[1][-1]
        heard.device.mount("+z")
        again = heard.next(0.5)[1][-1]
        assert heard.device.face == "+z"
    gain = DEVICE.accel.gain * STANDARD_GRAVITY
    assert first[5] - upside_down[5] == pytest.approx(2 * gain, rel=0.05)
    assert 0.0 < abs(first[3] - again[3]) < 0.1 * gain


def test_the_earth_turns_a_device_that_is_told_its_latitude():
    quiet = DEVICE.without_noise()
    with Heard(device=quiet) as without, Heard(device=quiet, latitude_deg=90.0) as pole:
        apart = pole.next(0.1)[1][-1, :3] - without.next(0.1)[1][-1, :3]
    assert apart == pytest.approx(quiet.gyro.forward_matrix[:, 2] * EARTH_RATE, rel=1e-3, abs=1e-9)


def test_a_clock_that_runs_fast_counts_more():
    from dataclasses import replace

    fast = replace(DEVICE, sampling=replace(DEVICE.sampling, clock_error=0.01, sample_rate_hz=100.0))
    with Heard(device=fast) as heard:
        heard.clock.wait(10.0)
        counts = []
        while not counts or counts[-1] < 1010:
            counts += heard.source.read(2.0).counter.tolist()
    assert counts[-1] == 1010


def test_lost_and_garbled_readings_are_found_out():
    with Heard() as heard:
        heard.device.inject("lost_readings")
        counts = heard.next(0.2)[0]
        assert [k for k in range(1, 21) if k not in counts] == [7, 14]
        heard.device.clear()
        heard.device.inject("garbled_readings")
        counts = heard.next(0.2)[0]
        assert [k for k in range(21, 41) if k not in counts] == [21, 28, 35]
        assert heard.source.errors == 3


def test_a_silent_device_is_a_timeout_and_its_numbers_go_on():
    with Heard() as heard:
        heard.device.inject("silence")
        heard.clock.wait(0.5)
        heard.device.tick()
        with pytest.raises(RigTimeout, match=r"got nothing"):
            heard.source.read(0.05)
        heard.device.clear()
        assert heard.next(0.05)[0][0] == 56  # 0.5 s and the wait that ended


def test_what_cannot_be_is_refused():
    with Heard() as heard:
        with pytest.raises(
            InputError, match=r"mount: wanted one of \+x, -x, .*, got 'up'; name the axis that points up"
        ):
            heard.device.mount("up")
        with pytest.raises(InputError, match=r"device fault: wanted one of .*, silence, got 'fire'; name one of them"):
            heard.device.inject("fire")
    with pytest.raises(InputError, match=r"emulated device: wanted format line or frame, got 'xml'"):
        StreamSettings(framing="xml")
    with pytest.raises(InputError, match=r"emulated device: wanted sample_rate_hz above 0, got 0"):
        StreamSettings(sample_rate_hz=0)


def test_hands_mount_over_their_socket_or_say_why_not():
    before = threading.active_count()
    with EmulatedBench(EmulatedBenchSettings(device=DEVICE)) as bench:
        assert bench.device is DEVICE
        hands = BenchHands(bench.hands_address)
        hands.mount("-y")
        assert bench.stream.face == "-y"
        bench.mount("+y")
        with socket.create_connection(tuple(bench.hands_address.removeprefix("tcp://").split(":"))) as link:
            link.sendall(b"FACE?\nJUMP\n")
            answers = link.makefile()
            assert answers.readline() == "+y\n"
            assert answers.readline().startswith("ERROR hands: wanted MOUNT +x or FACE?, got another word")
        with pytest.raises(RigFault, match=r"hands: wanted up up, got 'ERROR mount: wanted one of"):
            hands.mount("up")
    bench.close()
    with pytest.raises(RigFault, match=r"hands: wanted \+x up, got '.*refused.*'; is the emulated bench running"):
        hands.mount("+x")
    with pytest.raises(InputError, match=r"hands: wanted tcp://host:port, got 'here'; rig emulate prints it"):
        BenchHands("here")
    assert threading.active_count() == before


def test_a_bench_that_cannot_open_all_its_parts_leaves_none_open():
    before = threading.active_count()
    with EmulatedBench(EmulatedBenchSettings(device=DEVICE)) as bench:
        taken = int(bench.chamber_address.rpartition(":")[2])
        with pytest.raises(OSError):
            EmulatedBench(EmulatedBenchSettings(device=DEVICE, hands_port=taken))
    assert threading.active_count() == before


def test_a_bench_without_a_device_draws_one():
    settings = EmulatedBenchSettings(stream=StreamSettings(seed=5))
    with EmulatedBench(settings) as one, EmulatedBench(settings) as other:
        assert one.device.serial == other.device.serial
        assert isinstance(one.stream._device, CausalDevice)
