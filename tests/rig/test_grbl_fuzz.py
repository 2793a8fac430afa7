"""Hundreds of bad answers at any step: the driver says so within its deadline, and jogs no more than it was asked to."""

import contextlib
import random

import pytest

from testkit.scripted_server import VirtualScripted
from testkit.virtual_clock import VirtualClock
from undrift.errors import LinkError, RigError, RigFault, RigTimeout
from undrift.rig.grbl import GrblBoard, GrblRig
from undrift.rig.rig import RigSettings

LETTERS = b"<>|:,.-$=0123456789 okerrorMPosIdleJogAlarmALARM\r\n\x00\xff\x85"
CALLS = (
    lambda rig: rig.identify(),
    lambda rig: rig.enable(True),
    lambda rig: rig.set_acceleration(1.0),
    lambda rig: rig.position(),
    lambda rig: rig.fault(),
    lambda rig: rig.stop(),
)


def good(command):
    if command == "?":
        return b"<Idle|MPos:0.000|FS:0,0>\r\n"
    if command == "\x18":
        return b"\r\nGrbl 1.1h ['$' for help]\r\n"
    if command == "$$":
        return b"$100=8.889\r\n$110=21600.000\r\n$120=500.000\r\nok\r\n"
    return None if command in "\x85!" else b"ok\r\n"


def spoilt(answer, chance):
    """Cut an answer short, change a byte of it, or put rubbish in its place."""
    way = chance.randrange(3)
    if way == 0:
        return answer[: chance.randrange(len(answer))]
    if way == 1:
        place = chance.randrange(len(answer))
        return answer[:place] + bytes([chance.choice(LETTERS)]) + answer[place + 1 :]
    return bytes(chance.choice(LETTERS) for _ in range(chance.randrange(60)))


@pytest.mark.parametrize("seed", range(10))
def test_bad_answers_at_any_step_end_within_the_deadline_and_nothing_jogs(seed):
    chance = random.Random(seed)
    bad, armed = 0, False

    def answer(command):
        nonlocal bad
        said = good(command)
        if said is None or not armed or chance.random() > (0.03 if command == "\x18" else 0.5):
            return said
        bad += 1
        return spoilt(said, chance) or None

    failures = 0
    for _ in range(6):
        armed, clock = False, VirtualClock()
        with VirtualScripted(answer, clock, terminator=b"\n", at_once="?!~\x18\x85") as server:
            with contextlib.suppress(RigError):
                link = GrblBoard(server.url, reply_timeout_s=0.02, clock=clock)
                rig = GrblRig(link, RigSettings(clock=clock))
                armed = True
                try:
                    for call in chance.choices(CALLS, k=8):
                        start = clock.now()
                        try:
                            call(rig)
                        except (LinkError, RigTimeout, RigFault):
                            failures += 1
                        assert clock.now() - start < 60.0
                finally:
                    with contextlib.suppress(RigError):
                        rig.close()
            assert not any(line.startswith("$J") for line in server.heard)
    assert bad > 30
    assert failures > 10
