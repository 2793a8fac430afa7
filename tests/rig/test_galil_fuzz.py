"""Thousands of answers and commands spoilt on their way: the driver says so, never hangs, and begins nothing unconfirmed.

Spoilt answers: cut short, a byte changed, rubbish, doubled, late behind their deadline, late together with the next one, none at
all, a refusal, a hang-up. Spoilt commands: a byte or the end lost.
"""

import contextlib
import random
import re
from collections import Counter

import pytest

from testkit.cards import Card
from testkit.data import show
from testkit.rig_bench import mean_turn_rate
from testkit.scripted_server import VirtualScripted
from testkit.virtual_clock import VirtualClock
from undrift.errors import LimitError, LinkError, RigError, RigFault, RigTimeout
from undrift.rig.galil import GalilCard, GalilRig
from undrift.rig.rig import RigSettings
from undrift.units import RADIAN_PER_DEGREE

LETTERS = b"?:0123456789 .-\r\nTPXBG\x00\x07\xff\xc2"
REPLY_S = 0.03
AT_OPENING = 0.3  # share of openings that are spoilt as well
CALLS = {
    "identify": lambda rig: rig.identify(),
    "on": lambda rig: rig.enable(True),
    "off": lambda rig: rig.enable(False),
    "acceleration": lambda rig: rig.set_acceleration(40.0),
    "turn": lambda rig: rig.turn_for(90.0 * RADIAN_PER_DEGREE, 1.0),
    "turn back": lambda rig: rig.turn_for(-4.5 * RADIAN_PER_DEGREE, 1.0),
    "stop": lambda rig: rig.stop(),
    "position": lambda rig: rig.position(),
    "measure": lambda rig: mean_turn_rate(rig, rig.clock, 0.1),
    "following error": lambda rig: rig.following_error(),
    "fault": lambda rig: rig.fault(),
    "servo": lambda rig: rig.read_servo(),
    "close": lambda rig: rig.close(),
}
# what may be begun, as the card must have it; at its own acceleration of 256000 counts/s2, and at 40 rad/s2
ASKED = {"turn": {"PR 9609", "PR 9608"}, "turn back": {"PR -499"}}
TAKES_ANY = ("identify", "close")  # any text is a name; closing asks again
HARMLESS = re.compile(
    r"STX|AB|MOX|MG _BGX|MG _MOX|MG \d{5}|TC1"
)  # what brings an axis to rest, and questions about that


class Mover(Card):
    """Remembers what it held each time that it began."""

    def __init__(self):
        super().__init__(polls=3)
        self.held |= {"TM": "1000", "KP": "6", "KI": "0", "KD": "64"}
        self.last, self.begun = "", []

    def answer(self, command):
        try:
            said = super().answer(command)
        except (KeyError, ValueError):  # a word that lost a letter
            self.code = 1
            return b"?"
        if said == b":" and command.startswith("PR "):
            self.last = command
            self.arrives = abs(int(self.held["PR"])) <= 100  # a long way is not made at once
        return said

    def act(self, command):
        if command == "BGX":
            self.begun.append(self.last)
        return super().act(command)


class PoorLine:
    """A card at the end of a line that spoils a share of what passes."""

    def __init__(self, seed, share):
        self.clock = VirtualClock()
        self.card, self.share = Mover(), share
        self.chance = random.Random(seed)
        self.armed, self.heard, self.spoilt = True, 0, Counter()
        self.server = VirtualScripted(self, self.clock)
        self.connections, self.senseless = set(), []  # all; and that of each answer that can be none
        self._unended, self._held_back = "", b""

    def __call__(self, command):
        self.heard += 1
        self.connections.add(self.server.line)
        command, self._unended = self._unended + command, ""
        before, self._held_back = self._held_back, b""
        if not self.armed or self.chance.random() >= self.share:
            return before + self.card(command)
        way = self.chance.choice(WAYS)
        self.spoilt[way.__name__] += 1
        if way in (PoorLine.rubbish, PoorLine.unanswered):
            self.senseless.append(self.server.line)
        said = way(self, command)
        return None if said is None else before + said

    def cut(self, command):
        said = self.card(command)
        return said[: self.chance.randrange(len(said))]

    def changed(self, command):
        said = self.card(command)
        place = self.chance.randrange(len(said))
        return said[:place] + bytes([self.chance.choice(LETTERS)]) + said[place + 1 :]

    def rubbish(self, command):
        self.card(command)
        said = bytes(self.chance.choice(LETTERS) for _ in range(self.chance.randrange(60)))
        return b"#" + said + self.chance.choice((b"", b"\r\n:"))

    def doubled(self, command):
        return 2 * self.card(command)

    def late(self, command):
        said = self.card(command)
        self.clock.jump(self.clock.now() + REPLY_S * self.chance.uniform(0.5, 2.0))
        return said

    def held_back(self, command):
        self._held_back = self.card(command)

    def unanswered(self, command):
        self.card(command)

    def refused(self, command):
        self.card.code = self.chance.choice((1, 5, 7, 20, 131, 999))
        return b"?"

    def cut_off(self, command):
        self.card(command)
        self.server.hang_up()

    def byte_lost(self, command):
        place = self.chance.randrange(len(command))
        return self.card(command[:place] + command[place + 1 :])

    def end_lost(self, command):
        self._unended = command


WAYS = (
    PoorLine.cut, PoorLine.changed, PoorLine.rubbish, PoorLine.doubled, PoorLine.late, PoorLine.held_back, PoorLine.unanswered,
    PoorLine.refused, PoorLine.cut_off, PoorLine.byte_lost, PoorLine.end_lost,
)  # fmt: skip


def opened(line, sent):
    """Open a rig, and keep in a list what it sends."""
    port = GalilCard(line.server.url, reply_timeout_s=REPLY_S, clock=line.clock)
    send = port.send

    def noted(data):
        sent.extend(data.decode("ascii").split("\r")[:-1])
        send(data)

    port.send = noted
    return GalilRig(port, RigSettings(clock=line.clock))


def check_sent(name, sent, failure):
    """Nothing is begun but by a call that was asked to, once, right after its number was read back; nor after a failure."""
    begins = [place for place, command in enumerate(sent) if command.startswith("BG")]
    assert len(begins) <= (name in ASKED), (name, sent)
    for place in begins:
        assert sent[place - 2] in ASKED[name], sent
        assert sent[place - 1 : place + 1] == ["PR ?", "BGX"], sent
    if isinstance(failure, LinkError | RigTimeout) and sent:
        last = max((place for place, command in enumerate(sent) if not HARMLESS.fullmatch(command)), default=-1)
        after = sent[max([last, *begins]) + 1 :]
        assert "STX" in after, (name, sent)
        assert any(command.startswith("MO") for command in after), (name, sent)


def converse(line, calls, failures):
    """Open a rig over a poor line and give it calls until it is of no use any more."""
    sent, before = [], set(line.connections)
    line.armed = line.chance.random() < AT_OPENING  # else a poor line would seldom be opened
    rig = opened(line, sent)
    line.armed = True
    for name in calls:
        sent.clear()
        begun, senseless, failure = len(line.card.begun), len(line.senseless), None
        start = line.clock.now()
        try:
            CALLS[name](rig)
        except (LinkError, RigTimeout, RigFault, LimitError) as error:
            failure = error
            failures[type(error).__name__] += 1
        assert line.clock.now() - start < 60.0, f"{name} hangs"
        check_sent(name, sent, failure)
        assert set(line.card.begun[begun:]) <= ASKED.get(name, set()), (name, sent)
        if failure is None and name not in TAKES_ANY:
            assert set(line.senseless[senseless:]) <= before, f"{name} made sense of rubbish, or of nothing"
        if "Open it again" in str(failure):
            break
    with contextlib.suppress(RigError):
        rig.close()
    assert not rig.card.is_open


@pytest.mark.parametrize("share", [0.02, 0.1, 0.4])
def test_spoilt_answers_and_commands_end_in_words_and_nothing_is_begun_unconfirmed(share):
    failures, lines = Counter(), [PoorLine(seed, share) for seed in range(12)]
    for line in lines:
        chance = random.Random(line.chance.random())
        while line.heard < 400:
            with contextlib.suppress(RigError):  # of the opening
                converse(line, chance.choices([*CALLS], k=30), failures)
    spoilt = sum((line.spoilt for line in lines), Counter())
    begun = Counter(entry for line in lines for entry in line.card.begun)
    heard = sum(line.heard for line in lines)
    show(f"of {heard} exchanges spoilt, failed, begun", [sum(c.values()) for c in (spoilt, failures, begun)])
    assert sum(spoilt.values()) > 0.5 * share * heard * (1.0 - AT_OPENING)
    assert share < 0.1 or set(spoilt) == {way.__name__ for way in WAYS}
    assert set(failures) >= {"LinkError", "RigTimeout", "RigFault"}
    assert share > 0.1 or set(begun) == set().union(*ASKED.values())
