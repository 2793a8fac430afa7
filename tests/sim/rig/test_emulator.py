"""The emulator on a real socket and a pseudo terminal: clients, faults of the link, power cuts, clean ends."""

import contextlib
import os
import random
import socket
import threading
import time
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from testkit.data import show
from testkit.emulated_axis import axis_angle, axis_rate, axis_state
from undrift.base.clock import VirtualClock
from undrift.errors import InputError
from undrift.sim.rig.axes import ServoSettings
from undrift.sim.rig.emulator import RIG_FAULTS, Emulator, EmulatorSettings
from undrift.sim.rig.server import LINK_FAULTS


@pytest.fixture
def emulator() -> Iterator[Emulator]:
    with Emulator(EmulatorSettings(speed=20.0)) as running:
        yield running


@contextlib.contextmanager
def client(emulator: Emulator) -> Iterator[socket.socket]:
    with socket.create_connection((emulator.host, emulator.port), timeout=60.0) as connection:
        yield connection


def ask(connection: socket.socket, line: str, prompts: int = 1, timeout_s: float = 60.0) -> bytes:
    """Send a line and read until so many prompts, or until the time is over."""
    connection.settimeout(timeout_s)
    connection.sendall(line.encode("latin-1") + b"\r")
    answer = b""
    with contextlib.suppress(TimeoutError):
        while answer.count(b":") + answer.count(b"?") < prompts:
            piece = connection.recv(4096)
            if not piece:
                break
            answer += piece
    return answer


def say(emulator: Emulator, line: str, prompts: int = 1) -> bytes:
    """Send a line to an emulator on a virtual clock and return its answer."""
    wire, answer = emulator.clock.connection(emulator.host, emulator.port), b""
    wire.write(line.encode("latin-1") + b"\r")
    while answer.count(b":") < prompts:
        answer += wire.receive(1.0)
    wire.close()
    return answer


def hear(connection: socket.socket, size: int) -> bytes:
    """Read until so many bytes have come."""
    connection.settimeout(60.0)
    heard = b""
    while len(heard) < size and (piece := connection.recv(size - len(heard))):
        heard += piece
    return heard


def wait_until(condition: Callable[[], bool], timeout_s: float = 60.0) -> bool:
    end = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() > end:
            return False
        time.sleep(0.002)
    return True


def test_a_client_turns_the_axis_over_a_socket(emulator):
    with client(emulator) as c:
        assert ask(c, "SH;JG 10000;BG", 3) == b":::"
        assert wait_until(lambda: axis_rate(emulator) > 1.4)
        assert emulator.motor_on
        moment = emulator.now()
        angle, _ = axis_state(emulator, moment)
        assert angle == pytest.approx(axis_angle(emulator), abs=0.5)
        assert ask(c, "ST") == b":"
        assert wait_until(lambda: b" 0.0000" in ask(c, "MG _BGX"))
    times, angles = emulator.history()
    assert len(times) == len(angles)


def test_the_axis_goes_on_while_no_client_says_anything(emulator):
    with client(emulator) as c:
        ask(c, "SH;JG 5000;BG", 3)
        before = emulator.machine.card.axis.time
        assert wait_until(lambda: emulator.machine.card.axis.time > before + 1.0)
    assert wait_until(lambda: axis_angle(emulator) > 1.0)  # nor when it has gone
    with client(emulator) as c:
        assert ask(c, "MG _BGX") == b" 1.0000\r\n:"


def test_two_clients_share_one_card(emulator):
    with client(emulator) as one, client(emulator) as two:
        ask(one, "DP 77")
        assert ask(two, "TP") == b" 0000000077\r\n:"
        emulator.inject("message")
        assert one.recv(100) == two.recv(100) == b"EMULATED MESSAGE\r\n"


def test_exchanges_are_quick(emulator):
    with client(emulator) as c:
        took = []
        for _ in range(200):
            begun = time.monotonic()
            ask(c, "TP")
            took.append(time.monotonic() - begun)
    quick = float(np.quantile(took, 0.1))  # a busy machine delays most of them, not all
    show("one exchange, ms", round(quick * 1e3, 3), 20)
    assert quick < 0.02


def test_a_client_that_does_not_read_holds_nobody_up(emulator):
    with client(emulator) as deaf, client(emulator) as other:
        deaf.setblocking(False)
        with contextlib.suppress(BlockingIOError):
            for _ in range(2000):
                deaf.send(b"MG " + b"TIME," * 10 + b"1\r")
        assert ask(other, "TP") == b" 0000000000\r\n:"


COSTLY = b"QU A[],0,999,1\r" * 300  # two milliseconds each: together, more than anybody else should wait


@pytest.mark.parametrize("reads", [False, True])
def test_a_client_that_floods_leaves_others_their_turn(emulator, reads):
    with client(emulator) as flood, client(emulator) as other:
        ask(other, "DM A[1000]")
        flooding = threading.Event()

        def say_on() -> None:
            with contextlib.suppress(OSError):
                while True:
                    flood.sendall(COSTLY)
                    flooding.set()

        def listen() -> None:
            with contextlib.suppress(OSError):
                while flood.recv(1 << 20):
                    pass

        threads = [threading.Thread(target=target) for target in (say_on, *([listen] if reads else []))]
        for thread in threads:
            thread.start()
        assert flooding.wait(60.0)
        took = []
        for _ in range(30):
            begun = time.monotonic()
            assert ask(other, "TP") == b" 0000000000\r\n:"
            took.append(time.monotonic() - begun)
        flood.shutdown(socket.SHUT_RDWR)
        for thread in threads:
            thread.join(60.0)
    typical = float(np.median(took))  # a busy machine delays some
    show("an answer beside a flood, s", round(typical, 4), 0.2)
    assert typical < 0.2


def test_a_flood_is_obeyed_in_full_and_in_order(emulator):
    with client(emulator) as c:
        wanted = b"".join(b" %d.0000\r\n:" % number for number in range(3000))
        threading.Thread(target=c.sendall, args=(b"".join(b"MG %d\r" % number for number in range(3000)),)).start()
        assert hear(c, len(wanted)) == wanted


def test_a_pseudo_terminal_speaks_the_same_language():
    with Emulator(EmulatorSettings(with_pty=True, speed=5.0)) as emulator:
        assert emulator.pty_path is not None
        for _ in range(2):  # a client may come back
            descriptor = os.open(emulator.pty_path, os.O_RDWR | os.O_NOCTTY)
            try:
                os.write(descriptor, b"TP\r")
                answer = b""
                while not answer.endswith(b":"):
                    answer += os.read(descriptor, 100)
                assert answer == b" 0000000000\r\n:"
            finally:
                os.close(descriptor)


def test_a_virtual_clock_makes_a_conversation_repeatable():
    ends = []
    for _ in range(2):
        clock = VirtualClock()
        with Emulator(EmulatorSettings(), clock=clock) as emulator:
            say(emulator, "SH;JG 4321;BG", 3)
            clock.wait(1.5)
            say(emulator, "ST")
            clock.wait(0.5)
            ends.append(axis_state(emulator, 1.7))
    assert ends[0] == ends[1]


def test_a_mean_rate_is_free_of_the_ripple_of_the_servo():
    clock = VirtualClock()
    with Emulator(EmulatorSettings(), clock=clock) as emulator:
        say(emulator, "SH;JG 10000;BG", 3)
        clock.wait(2.0)
        times = np.linspace(1.0, 2.0, 101)
        _, momentary = emulator.axis_states(times)
        _, mean = emulator.axis_states(times, mean_s=0.01)
        show("ripple, momentary and of 10 ms means, deg/s", [float(np.degrees(np.std(r))) for r in (momentary, mean)])
        assert np.degrees(np.std(momentary)) > 0.5
        assert np.degrees(np.abs(mean - np.pi / 2).max()) < 0.05
        assert axis_state(emulator, 0.001, mean_s=0.01)[1] < 0.1


def test_dropped_bytes_garbage_and_halves_reach_the_client(emulator):
    with client(emulator) as c:
        emulator.inject("drop_bytes", answers=1)
        assert ask(c, "TP") == b" 0000000\n:"  # each third of the 14
        emulator.inject("half_reply", answers=1)
        c.sendall(b"TP\r")
        assert hear(c, 7) == b" 000000"
        assert ask(c, "", 1, timeout_s=0.1) == b":"  # and nothing of the other half
        emulator.inject("garbage", answers=1)
        c.sendall(b"TP\r")
        garbage = hear(c, 22)
        assert not set(garbage) & set(b":?")
        assert ask(c, "TP") == b" 0000000000\r\n:"


def test_stalled_and_late_answers_come_after_all(emulator):
    with client(emulator) as c:
        emulator.inject("stall")
        assert ask(c, "SH;JG 5000;BG", 3, timeout_s=0.1) == b""
        assert wait_until(lambda: axis_rate(emulator) > 0.5)  # the card does what it is told meanwhile
        emulator.clear("stall")
        assert hear(c, 3) == b":::"
        emulator.inject("late_reply", answers=1)
        begun = time.monotonic()
        assert ask(c, "ST") == b":"
        assert time.monotonic() - begun > 0.45


def test_a_slow_link_delivers_byte_by_byte(emulator):
    with client(emulator) as c:
        emulator.inject("slow_link", answers=1)
        begun = time.monotonic()
        assert ask(c, "TP") == b" 0000000000\r\n:"
        assert time.monotonic() - begun > 0.6  # 14 bytes at 20 a second


def test_a_cut_connection_leaves_the_axis_turning_and_may_be_made_again(emulator):
    with client(emulator) as c:
        ask(c, "SH;JG 5000;BG", 3)
        emulator.inject("disconnect")
        assert c.recv(10) == b""
    with client(emulator) as c:
        assert ask(c, "MG _BGX") == b" 1.0000\r\n:"


def test_a_power_cut_closes_sockets_and_lets_the_axis_coast_to_rest(emulator):
    with client(emulator) as c:
        ask(c, "SH;JG 10000;BG", 3)
        assert wait_until(lambda: axis_rate(emulator) > 1.4)
        emulator.inject("power_cut")
        with contextlib.suppress(ConnectionResetError):
            assert c.recv(10) == b""
    assert not emulator.motor_on
    assert wait_until(lambda: axis_rate(emulator) == 0.0)
    with client(emulator) as c, contextlib.suppress(ConnectionResetError, BrokenPipeError):
        assert ask(c, "TP", timeout_s=0.2) == b""
    emulator.clear()
    with client(emulator) as c:
        assert ask(c, "MG _MOX") == b" 1.0000\r\n:"


def test_clearing_everything_does_not_reset_a_card_that_kept_its_power(emulator):
    with client(emulator) as c:
        ask(c, "SH;JG 5000;BG", 3)
        emulator.inject("slow_link")
        emulator.inject("limit_switch_reverse")
        emulator.clear()
        assert ask(c, "MG _BGX") == b" 1.0000\r\n:"


@pytest.mark.parametrize("kind", ["galil", "grbl"])
def test_every_fault_can_begin_and_end_on_every_rig(kind):
    with Emulator(EmulatorSettings(kind=kind, speed=5.0)) as emulator:
        for fault in (*LINK_FAULTS, *RIG_FAULTS):
            emulator.inject(fault)
            emulator.clear(fault)
        with client(emulator) as c:
            c.sendall(b"?" if kind == "grbl" else b"TP\r")
            assert c.recv(100)


def test_a_board_greets_and_jogs_over_a_socket():
    with Emulator(EmulatorSettings(kind="grbl", speed=20.0)) as emulator, client(emulator) as c:
        assert c.recv(100).startswith(b"\r\nGrbl")
        c.sendall(b"$J=G91A3600F5400\n")
        assert c.recv(100) == b"ok\r\n"
        assert wait_until(lambda: axis_rate(emulator) > 1.5)
        assert emulator.motor_on
        c.sendall(b"\x85")
        assert wait_until(lambda: axis_rate(emulator) == 0.0)
        assert emulator.history(1.0)[1][-1] == pytest.approx(axis_angle(emulator))


def test_random_bytes_over_the_socket_do_not_end_the_server(emulator):
    rng = random.Random(3)
    with client(emulator) as c:
        for _ in range(300):
            c.sendall(rng.randbytes(rng.randint(1, 200)))
        c.sendall(b"\r\\\r")
    with client(emulator) as c:
        assert ask(c, "TC0").endswith(b":")


def test_closing_twice_is_harmless_and_ends_the_thread():
    before = set(threading.enumerate())  # other tests of this worker may hold emulators of their own
    emulator = Emulator()
    started = set(threading.enumerate()) - before
    assert "emulated-rig" in [thread.name for thread in started]
    emulator.close()
    emulator.close()
    assert not any(thread.is_alive() for thread in started)
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection((emulator.host, emulator.port), timeout=1.0)


def test_wrong_calls_are_refused(emulator):
    with pytest.raises(InputError, match="emulator kind: wanted galil or grbl, got 'plotter'"):
        Emulator(EmulatorSettings(kind="plotter"))
    with pytest.raises(InputError, match=r"emulator host: wanted one of 127.0.0.1.*it serves this computer only"):
        Emulator(EmulatorSettings(host="0.0.0.0"))
    with pytest.raises(InputError, match=r"fault: wanted one of drop_bytes.*got 'flood'"):
        emulator.inject("flood")
    with pytest.raises(InputError, match="fault: wanted one of"):
        emulator.clear("flood")
    with pytest.raises(InputError, match="axis state: wanted times in"):
        axis_state(emulator, 1e6)
    with pytest.raises(InputError, match="clock: wanted a speed above 0, got 0"):
        Emulator(EmulatorSettings(speed=0.0))


def test_ten_minutes_are_emulated_in_less_than_three_seconds():
    clock = VirtualClock()
    settings = EmulatorSettings(servo=ServoSettings(), history_s=10.0)
    with Emulator(settings, clock=clock) as emulator:
        say(emulator, "SH;JG 10000;BG", 3)
        begun = time.process_time()  # of the processor: whatever else the machine does
        clock.wait(600.0)
        assert axis_angle(emulator) == pytest.approx(600.0 * 1.5708, rel=1e-3)
        speed = 600.0 / (time.process_time() - begun)
    show("times real time", round(speed), 200)
    assert speed > 200.0
