"""Thousands of answers and commands spoilt on their way: a driver says so, never hangs, and begins nothing unconfirmed."""

import contextlib
import random
import re
from collections import Counter

import pytest

from testkit.data import show
from testkit.driver_bench import KINDS
from testkit.scripted_server import Scripted
from testkit.virtual_clock import VirtualClock
from undrift.errors import LinkError, RigError, RigFault, RigTimeout
from undrift.rig.rig import RigSettings
from undrift.units import RADIAN_PER_DEGREE as DPS

LETTERS = b"<>?|:,.-$= 0123456789okerrorMPosIdleJogTPXBG\r\n\x00\x07\xff\xc2"
REPLY_S = 0.03
WORD = re.compile("[\x85]|\x18(?!\x16)|[^\r\n\x85]+")  # a command of a line, or a single byte
CALLS = {
    "identify": lambda rig: rig.identify(),
    "on": lambda rig: rig.enable(True),
    "off": lambda rig: rig.enable(False),
    "acceleration": lambda rig: rig.set_acceleration(40.0),
    "turn": lambda rig: rig.turn_for(90.0 * DPS, 1.0),
    "stop": lambda rig: rig.stop(),
    "position": lambda rig: rig.position(),
    "fault": lambda rig: rig.fault(),
}
ASKED = {"9609", "9608"}  # counts of the turn, at the card's own acceleration and at the one set


WORDS = {  # what begins a move, what brings an axis to rest, what changes nothing
    "galil": (r"BGX", r"STX|AB", r"MG .*|TC1|MOX|\x12\x16"),
    "grbl": (r"\$J=.*", "!?[\x85\x18]", r"\?|!|\$\$|\$SLP|\$X"),
}


class PoorLine:
    """A controller at the end of a line that spoils a share of what passes, once it is armed."""

    def __init__(self, kind, seed, share):
        controller, self.rig, line = KINDS[kind]
        self.controller, self.share, self.chance = controller(), share, random.Random(seed)
        self.clock, self.armed, self.spoilt, self.begun = VirtualClock(), False, Counter(), set()
        self.server = Scripted(self, self.clock, **line)

    def __call__(self, command):
        if not self.armed or self.chance.random() >= self.share:
            return self.answer(command)
        way = self.chance.choice(WAYS)
        self.spoilt[way.__name__] += 1
        return way(self, command)

    def answer(self, command):
        """Return what the controller says; a word that lost a letter is no command of it."""
        if command == "BGX":
            self.begun.add(self.controller.held.get("PR"))
        try:
            return self.controller(command)
        except (KeyError, ValueError):
            return b"?"

    def cut(self, command):
        said = self.answer(command) or b""
        return said[: self.chance.randrange(len(said) + 1)]

    def changed(self, command):
        said = bytearray(self.answer(command) or b"?")
        said[self.chance.randrange(len(said))] = self.chance.choice(LETTERS)
        return bytes(said)

    def rubbish(self, command):
        self.answer(command)
        return bytes(self.chance.choice(LETTERS) for _ in range(self.chance.randrange(60)))

    def doubled(self, command):
        return 2 * (self.answer(command) or b"")

    def late(self, command):
        said = self.answer(command)
        self.clock.jump(self.clock.now() + REPLY_S * self.chance.uniform(0.5, 2.0))
        return said

    def unanswered(self, command):
        self.answer(command)

    def cut_off(self, command):
        self.answer(command)
        self.server.hang_up()

    def byte_lost(self, command):
        place = self.chance.randrange(len(command))
        return self.answer(command[:place] + command[place + 1 :])


WAYS = (
    PoorLine.cut, PoorLine.changed, PoorLine.rubbish, PoorLine.doubled, PoorLine.late, PoorLine.unanswered, PoorLine.cut_off,
    PoorLine.byte_lost,
)  # fmt: skip


def check_sent(kind, name, sent, failure):
    """A move is begun at most once, by the call that asks for it, and after a failure the table is told to stop."""
    begin, stop, asks = WORDS[kind]
    begun = [place for place, command in enumerate(sent) if re.fullmatch(begin, command)]
    assert len(begun) <= (name == "turn"), (name, sent)
    if kind == "galil" and begun:
        assert sent[begun[0] - 1] == "PR ?", sent
    if isinstance(failure, LinkError | RigTimeout) and sent:
        harmless = re.compile(f"{stop}|{asks}")
        last = max((place for place, command in enumerate(sent) if not harmless.fullmatch(command)), default=-1)
        assert any(re.fullmatch(stop, command) for command in sent[last + 1 :]), (name, sent)


def converse(kind, line, names, failures):
    """Open a rig, and give it calls over a poor line until it is of no use any more."""
    line.armed = False
    rig, sent = line.rig(line.server.url, RigSettings(clock=line.clock, reply_timeout_s=REPLY_S)), []
    send = rig.send

    def noted(data):
        sent.extend(WORD.findall(data.decode("latin-1")))
        send(data)

    rig.send = noted
    line.armed = True
    for name in names:
        sent.clear()
        start, failure = line.clock.now(), None
        try:
            CALLS[name](rig)
        except (LinkError, RigTimeout, RigFault) as error:
            failure = error
            failures[type(error).__name__] += 1
        assert line.clock.now() - start < 60.0, f"{name} hangs"
        check_sent(kind, name, sent, failure)
        if "Open it again" in str(failure):
            break
    with contextlib.suppress(RigError):
        rig.close()
    assert not rig.is_open


@pytest.mark.parametrize("share", [0.1, 0.4])
@pytest.mark.parametrize("kind", WORDS)
def test_spoilt_lines_end_in_errors_and_begin_nothing(kind, share):
    failures, spoilt = Counter(), Counter()
    for seed in range(10):
        line = PoorLine(kind, seed, share)
        while len(line.server.heard) < 400:
            with contextlib.suppress(RigError):  # of the opening
                converse(kind, line, line.chance.choices([*CALLS, "stop", "turn", "turn", "turn"], k=20), failures)
        spoilt += line.spoilt
        assert line.begun <= ASKED, "a move was begun whose distance the card had otherwise"
    show(f"{kind}: spoilt, and failed", (sum(spoilt.values()), failures))
    assert set(spoilt) == {way.__name__ for way in WAYS}
    assert set(failures) >= {"LinkError", "RigTimeout"}
