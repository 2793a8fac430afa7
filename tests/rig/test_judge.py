"""A rest that someone disturbed, and a face that nobody mounted, are taken again; what a sound rest reads is never refused."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.rig_bench import SHORT, UP, Device, emulated, run
from undrift.errors import RigFault
from undrift.io.parquet import read_parquet
from undrift.record import FACES, Record
from undrift.rig.judge import APART, STILL, Disturbed, Rests
from undrift.rig.programme import Dwell
from undrift.units import STANDARD_GRAVITY

FACES_ALONE = replace(SHORT, faces=("+z", "-z", "+x"), axes=())


def rest(up="+z", purpose="face"):
    return Dwell(purpose=purpose, up=up, axis=None, turn_rate=0.0, ramp_s=0.0, settle_s=0.0, dwell_s=4.0)


def read(rng, up="+z", *, noise=0.01, count=False, step=0.0, force=None):
    accel = STANDARD_GRAVITY * (UP[up] if force is None else force) + noise * rng.standard_normal((400, 3))
    gyro = noise * rng.standard_normal((400, 3))
    if count:
        accel, gyro = 1700.0 * accel + [300.0, -80.0, 40.0], 900.0 * gyro
    if step:
        accel, gyro = step * np.rint(accel / step), step * np.rint(gyro / step)
    units = ("count", "count") if count else ("dps", "m/s2")
    return Record(time=np.arange(400) / 100.0, gyro=gyro, accel=accel, gyro_unit=units[0], accel_unit=units[1])


def test_constant_readings_in_g_are_faces_like_others():
    rests, made = Rests(), {up: read(np.random.default_rng(5), up, noise=0.0) for up in FACES}
    made = {up: replace(record, accel=record.accel / STANDARD_GRAVITY, accel_unit="g") for up, record in made.items()}
    for up, record in made.items():
        rests.check(rest(up), record, "step")
        rests.keep(rest(up), record)
    with pytest.raises(Disturbed, match=r"got the readings of \+z"):
        rests.check(rest("-x"), made["+z"], "step")


def bumped(record):
    """A table that is pushed for a tenth of a second."""
    gyro = np.array(record.gyro)
    gyro[len(gyro) // 2 :][:10] += 30.0 * gyro.std(axis=0)
    return replace(record, gyro=gyro)


@pytest.mark.parametrize("how", [{}, {"count": True}, {"step": 0.1}, {"noise": 0.0}, {"noise": 0.3}])
def test_sound_rests_are_kept(how):
    rng = np.random.default_rng(1)
    for _ in range(100):
        rests = Rests()
        for up in FACES:
            record = read(rng, up, **how)
            rests.check(rest(up), record, "step")
            rests.keep(rest(up), record)


@pytest.mark.parametrize("count", [False, True])
def test_a_bump_is_seen_in_the_first_rest_and_in_later_ones(count):
    rng, rests = np.random.default_rng(2), Rests()
    with pytest.raises(Disturbed, match=r"wanted it at rest in step 1, got \d+ times the spread of this rig's rests"):
        rests.check(rest(), bumped(read(rng, count=count)), "step 1")
    for _ in range(3):
        rests.keep(rest(), read(rng, count=count))
    loud = read(rng, noise=0.01 * 1.5 * STILL, count=count)  # from start to end: only other rests tell
    with pytest.raises(Disturbed):
        rests.check(rest(), loud, "step 2")
    Rests().check(rest(), loud, "step 1")


def test_a_face_that_nobody_mounted_is_seen():
    rng, rests = np.random.default_rng(3), Rests()
    rests.keep(rest("+z"), read(rng, "+z", count=True))
    with pytest.raises(Disturbed, match=r"wanted \+x up in step, got the readings of \+z; mount it again"):
        rests.check(rest("+x"), read(rng, "+z", count=True), "step")
    rests.check(rest("+x"), read(rng, "+x", count=True), "step")
    with pytest.raises(
        Disturbed, match=r"wanted -z up in step, got gravity along another axis"
    ):  # counts: +z less what is read
        rests.check(rest("-z"), read(rng, "+y", count=True), "step")
    rests.check(rest("-z"), read(rng, "-z", count=True), "step")


def test_in_a_physical_unit_the_first_face_tells():
    rng = np.random.default_rng(4)
    Rests().check(rest("+x"), read(rng, "+x"), "step")
    for wrong in ("-x", "+y", "-z"):
        with pytest.raises(Disturbed, match="gravity along another axis"):
            Rests().check(rest("+x"), read(rng, wrong), "step")
    slanted = np.array([np.cos(np.radians(40.0)), np.sin(np.radians(40.0)), 0.0])
    with pytest.raises(Disturbed):
        Rests().check(rest("+x"), read(rng, force=slanted), "step")
    assert APART > 1.0


class Clumsy(Device):
    """Is pushed, or holds the face before, in some of its readings."""

    def __init__(self, emulator, hands, *, pushed=(), forgot=()):
        super().__init__(emulator, hands)
        self.taken, self.pushed, self.forgot, self.before = 0, pushed, forgot, None

    def stop(self):
        self.taken += 1
        up, self.hands.up = self.hands.up, self.before if self.taken in self.forgot else self.hands.up
        record = super().stop()
        self.hands.up = self.before = up
        return bumped(record) if self.taken in self.pushed else record


@pytest.mark.parametrize("how", [{"pushed": (1, 3)}, {"forgot": (2,)}])
def test_a_run_takes_a_disturbed_rest_again_and_keeps_sound_ones_alone(tmp_path, monkeypatch, how):
    made = {}

    def device(emulator, hands):
        made["device"] = Clumsy(emulator, hands, **how)
        return made["device"]

    monkeypatch.setattr("testkit.rig_bench.Device", device)
    with emulated() as emulator:
        result, hands = run(emulator, tmp_path, FACES_ALONE)
    assert result.added == 3
    assert made["device"].taken == 3 + len(next(iter(how.values())))
    assert len(hands.mounted) == made["device"].taken  # mounted again each time
    for piece in result.pieces:
        record = read_parquet(tmp_path / piece.name).record
        assert np.allclose(record.accel.mean(axis=0), STANDARD_GRAVITY * UP[piece.up], atol=0.01)
        assert np.ptp(record.gyro, axis=0).max() < 0.2


def test_a_rest_that_is_always_disturbed_ends_the_run(tmp_path, monkeypatch):
    monkeypatch.setattr("testkit.rig_bench.Device", lambda emulator, hands: Clumsy(emulator, hands, pushed=range(99)))
    with emulated() as emulator:
        with pytest.raises(RigFault, match=r"wanted it at rest in step 1 .*continue with --resume"):
            run(emulator, tmp_path, FACES_ALONE)
        assert not emulator.motor_on


def test_a_resumed_run_knows_the_rests_on_the_disk(tmp_path, monkeypatch):
    with emulated() as emulator:
        run(emulator, tmp_path, FACES_ALONE)
        journal = (tmp_path / "journal.jsonl").read_text().splitlines(keepends=True)
        (tmp_path / "journal.jsonl").write_text("".join(journal[:-1]))  # the last face is taken anew

        class Loud(Device):
            def stop(self):
                record = super().stop()
                return replace(record, gyro=record.gyro + 2.0 * STILL * 0.02 * self.rng.normal(size=record.gyro.shape))

        monkeypatch.setattr("testkit.rig_bench.Device", Loud)
        with pytest.raises(RigFault, match="times the spread of this rig's rests"):
            run(emulator, tmp_path, FACES_ALONE, resume=True)
