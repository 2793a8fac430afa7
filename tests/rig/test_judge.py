"""A rest that someone disturbed, and a face that nobody mounted, are taken again; what a sound rest reads is never refused."""

import re
from dataclasses import replace

import numpy as np
import pytest

from testkit.rig_bench import FACE, SHORT, UP, Device, Hands, run, simulated
from undrift.errors import RigFault
from undrift.io.formats import read_counted
from undrift.programme import Dwell
from undrift.record import FACES, Record
from undrift.rig.judge import APART, STILL, Disturbed, RestCheck
from undrift.units import STANDARD_GRAVITY

FACES_ALONE = SHORT.but(faces=FACE.but(order=("+z", "-z", "+x")), rates=None)


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


def bumped(record):
    """A table that is pushed for a tenth of a second."""
    gyro = np.array(record.gyro)
    gyro[len(gyro) // 2 :][:10] += 30.0 * gyro.std(axis=0)
    return replace(record, gyro=gyro)


@pytest.mark.slow
@pytest.mark.parametrize("how", [{}, {"count": True}, {"step": 0.1}, {"noise": 0.0}, {"noise": 0.3}])
def test_sound_rests_are_kept(how):
    rng = np.random.default_rng(1)
    for _ in range(30):
        rests = RestCheck()
        for up in FACES:
            record = read(rng, up, **how)
            rests.check(rest(up), record, "step")
            rests.keep(rest(up), record)


@pytest.mark.parametrize("count", [False, True])
def test_a_bump_is_seen_in_the_first_rest_and_in_later_ones(count):
    rng, rests = np.random.default_rng(2), RestCheck()
    with pytest.raises(Disturbed, match=r"not at rest in step 1, got \d+ times"):
        rests.check(rest(), bumped(read(rng, count=count)), "step 1")
    for _ in range(3):
        rests.keep(rest(), read(rng, count=count))
    loud = read(rng, noise=0.01 * 1.5 * STILL, count=count)  # from start to end: only other rests tell
    with pytest.raises(Disturbed):
        rests.check(rest(), loud, "step 2")
    RestCheck().check(rest(), loud, "step 1")


def test_a_face_that_nobody_mounted_is_seen():
    rng, rests = np.random.default_rng(3), RestCheck()
    rests.keep(rest("+z"), read(rng, "+z", count=True))
    with pytest.raises(Disturbed, match=r"\+x must be up in step, got the readings of \+z"):
        rests.check(rest("+x"), read(rng, "+z", count=True), "step")
    rests.check(rest("+x"), read(rng, "+x", count=True), "step")
    with pytest.raises(Disturbed, match=r"-z must be up in step, got gravity"):  # counts: +z less what is read
        rests.check(rest("-z"), read(rng, "+y", count=True), "step")
    rests.check(rest("-z"), read(rng, "-z", count=True), "step")


def test_in_a_physical_unit_the_first_face_tells():
    rng = np.random.default_rng(4)
    RestCheck().check(rest("+x"), read(rng, "+x"), "step")
    for wrong in ("-x", "+y", "-z"):
        with pytest.raises(Disturbed, match="gravity along another axis"):
            RestCheck().check(rest("+x"), read(rng, wrong), "step")
    slanted = np.array([np.cos(np.radians(40.0)), np.sin(np.radians(40.0)), 0.0])
    with pytest.raises(Disturbed):
        RestCheck().check(rest("+x"), read(rng, force=slanted), "step")
    assert APART > 1.0


class InCounts(Device):
    """Reads counts."""

    def stop(self):
        record = super().stop()
        accel = np.rint(1700.0 * record.accel + [300.0, -80.0, 40.0])
        return replace(record, accel=accel, accel_unit="count")


SIX = ("+x", "-x", "+y", "-y", "+z", "-z")


@pytest.mark.parametrize(("wrong", "delete"), [({1: "+y"}, "+x"), ({1: "-x"}, "+x"), ({3: "+z"}, "+y")])
def test_a_wrong_face_in_counts_is_repeated_after_its_file_was_deleted(tmp_path, wrong, delete):
    bench, protocol, path = simulated(), SHORT.but(faces=FACE.but(order=SIX), rates=None), tmp_path / "run"
    with pytest.raises(RigFault, match=r"If .. was mounted wrongly, delete (pieces/\d+.parquet)") as told:
        run(bench, path, protocol, readings=InCounts, hands=Hands(bench, wrong))
    file = re.search(r"delete (pieces/\d+.parquet)", str(told.value))[1]
    (path / file).unlink()
    result, hands = run(simulated(), path, protocol, readings=InCounts, resume=True)
    assert hands.mounted[0] == delete
    read = {piece.up: read_counted(path / piece.name).record.accel.mean(axis=0) for piece in result.pieces}
    for up in SIX:
        assert np.allclose(read[up], 1700.0 * STANDARD_GRAVITY * UP[up] + [300.0, -80.0, 40.0], atol=5.0)
    assert run(simulated(), path, protocol, readings=InCounts, resume=True)[0].added == 0


class Clumsy(Device):
    """Is pushed in some of its readings, counted from 1."""

    def __init__(self, bench, pushed=()):
        super().__init__(bench)
        self.taken, self.pushed = 0, pushed

    def stop(self):
        self.taken += 1
        record = super().stop()
        return bumped(record) if self.taken in self.pushed else record


@pytest.mark.parametrize(
    ("pushed", "forgot"), [((1, 3), {}), ((), {2: "+z"})], ids=["pushed twice", "one mounting forgotten"]
)
def test_a_run_takes_a_disturbed_rest_again_and_keeps_only_sound_ones(tmp_path, pushed, forgot):
    bench = simulated()
    device = Clumsy(bench, pushed)
    result, hands = run(bench, tmp_path, FACES_ALONE, readings=lambda bench: device, hands=Hands(bench, forgot))
    assert result.added == 3
    assert device.taken == 3 + len(pushed) + len(forgot)
    assert len(hands.mounted) == device.taken  # mounted again each time
    for piece in result.pieces:
        record = read_counted(tmp_path / piece.name).record
        assert np.allclose(record.accel.mean(axis=0), STANDARD_GRAVITY * UP[piece.up], atol=0.01)
        assert np.ptp(record.gyro, axis=0).max() < 0.2
