"""A device whose readings come late: what it took before a mounting was done is in no dwell of that face."""

import bisect
from dataclasses import replace

import numpy as np
import pytest

from testkit.rig_bench import LIMITS, SHORT, UP, Device, Hands, at_rest, run, simulated
from testkit.waiting import LONG_S
from undrift.errors import RigTimeout
from undrift.io.session import read_session
from undrift.live.decoder import Chunk, StreamDescription
from undrift.live.recorder import DwellReadings, Recorder, RecorderSettings
from undrift.programme import Protocol
from undrift.units import STANDARD_GRAVITY

RATE = 100.0
BEFORE = "-z"  # how the device lay before the first mounting
FACES = Protocol(faces=("+x", "-x", "+z"), face_s=1.0)


class TimedHands(Hands):
    """Mount, and remember when."""

    def __init__(self, bench):
        super().__init__(bench)
        self.clock, self.since = bench.clock, []

    def mount(self, up):
        super().mount(up)
        self.since.append(self.clock.now())

    def up_at(self, moment):
        return (BEFORE, *self.mounted)[bisect.bisect(self.since, moment)]


class Late:
    """Reads its pose RATE times a second; at the connection it is ``behind_s`` behind, then sends ``speed`` times as fast."""

    name, errors = "late", 0

    def __init__(self, hands, behind_s, speed):
        channels = ("count", "accel_x", "accel_y", "accel_z")
        self.description = StreamDescription(channels=channels, rate=RATE, accel_unit="m/s2")
        self.hands, self.behind_s, self.speed = hands, behind_s, speed
        self.sent = 0

    def open(self):
        self.opened = self.hands.clock.now()

    def close(self):
        pass

    def read(self, deadline_s):
        clock = self.hands.clock
        clock.jump(clock.now() + 0.1)
        now = clock.now()
        begun = self.opened - self.behind_s
        due = int(min(now - begun, self.speed * (now - self.opened)) * RATE)
        counts = np.arange(self.sent, due)
        self.sent = due
        values = [STANDARD_GRAVITY * UP[self.hands.up_at(begun + k / RATE)] for k in counts]
        return Chunk(host_time=np.full(len(counts), now), counter=counts + 0.0, values=np.array(values))


def test_a_backlog_of_the_pose_before_the_mounting_is_in_no_dwell(tmp_path):
    bench = simulated()
    hands = TimedHands(bench)
    late = Late(
        hands, behind_s=30.0, speed=4.0
    )  # caught up 10 s after the connection; the first dwell would be over by then
    with Recorder(late, RecorderSettings(silence_s=LONG_S), bench.clock) as recorder:
        readings = DwellReadings(recorder, deadline_s=LONG_S)
        result, _ = run(bench, tmp_path, FACES, readings=lambda bench: readings, hands=hands)
    session = read_session(tmp_path)
    assert [still.face for still in session.stills] == ["+x", "-x", "+z"] == hands.mounted
    for still in session.stills:
        accel = session.records[still.recording].accel[still.start : still.stop]
        assert (accel == STANDARD_GRAVITY * UP[still.face]).all(), f"{still.face} holds readings of another pose"
    assert min(piece.samples for piece in result.pieces) >= 100


def test_a_dwell_that_began_too_late_to_be_whole_is_read_again(tmp_path):
    class LateOnce(Device):
        stops = 0

        def stop(self):
            record = super().stop()
            LateOnce.stops += 1
            return record.part(len(record) // 2, len(record)) if LateOnce.stops == 1 else record

    bench = simulated()
    result, _ = run(bench, tmp_path, Protocol(faces=("+z",), face_s=2.0), readings=LateOnce)
    assert LateOnce.stops == 2
    assert result.pieces[0].samples >= 200


def test_a_dwell_is_not_read_again_while_a_table_of_limited_travel_turns(tmp_path):
    class LateOnce(Device):
        turning = 0

        def stop(self):
            record = super().stop()
            if abs(self.bench.turn_rate()) < 0.1:
                return record
            LateOnce.turning += 1
            return record.part(len(record) // 2, len(record))

    bench = simulated(limits=replace(LIMITS, travel=1000.0))
    with pytest.raises(RigTimeout, match=r"at least 80% of \d+ readings in step 3 .*, got \d+"):
        run(bench, tmp_path, SHORT, readings=LateOnce)
    assert at_rest(bench)
    assert LateOnce.turning == 1


def test_a_backlog_is_waited_out_before_the_table_turns(tmp_path):
    rates = []

    class Asked(Device):
        def start(self, *, certain=True):
            rates.append(self.bench.turn_rate())
            super().start()

    bench = simulated()
    run(bench, tmp_path, replace(SHORT, faces=(), bracket_s=0.0), readings=Asked)
    assert len(rates) == 1 + 4
    assert rates[0] == 0.0
    assert min(np.abs(rates[1:])) > 0.1
