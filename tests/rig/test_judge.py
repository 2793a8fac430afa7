"""A rest that someone disturbed, and a face that nobody mounted, are taken again; what a sound rest reads is never refused."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.rig_bench import DPS, GAIN, OFFSET, SHORT, UP, Device, Hands, run, simulated
from undrift.errors import RigFault
from undrift.io.parquet import read_parquet
from undrift.programme import Dwell
from undrift.record import FACES, Record
from undrift.rig.judge import APART, STILL, Contradiction, Disturbed, RestCheck, TurnCheck
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
    rests, made = RestCheck(), {up: read(np.random.default_rng(5), up, noise=0.0) for up in FACES}
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


@pytest.mark.slow
@pytest.mark.parametrize("how", [{}, {"count": True}, {"step": 0.1}, {"noise": 0.0}, {"noise": 0.3}])
def test_sound_rests_are_kept(how):
    rng = np.random.default_rng(1)
    for _ in range(100):
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


def kept(*faces, read_as=()):
    """Return rests that hold faces in counts, some of them as another face reads."""
    rng, rests = np.random.default_rng(6), RestCheck()
    for up in faces:
        rests.keep(rest(up), read(rng, dict(read_as).get(up, up), count=True))
    return rests, rng


@pytest.mark.parametrize(
    ("pair", "surely"), [((), False), (("+y", "-y"), True), (("+z", "-z"), True), (("+z",), False)]
)
@pytest.mark.parametrize("wrong", ["+z", "-y"])
def test_in_counts_a_pair_about_another_axis_tells_which_of_two_faces_is_wrong(pair, surely, wrong):
    if wrong in pair:
        pytest.skip("then both read the same, whatever else there is")
    rests, rng = kept(*pair, "+x", read_as=[("+x", wrong)])
    with pytest.raises(Contradiction, match=r"-x must be up .* than \+x\. One of") as told:
        rests.check(rest("-x"), read(rng, "-x", count=True), "step")
    assert (told.value.other, told.value.surely) == ("+x", surely)
    rests.forget("+x")
    rests.check(rest("-x"), read(rng, "-x", count=True), "step")


def test_in_counts_a_pair_about_another_axis_clears_the_face_that_was_kept():
    rests, rng = kept("+y", "-y", "+x")
    with pytest.raises(Disturbed, match=r"-x must be up .* than \+x\. Mount it"):
        rests.check(rest("-x"), read(rng, "+z", count=True), "step")


def test_in_counts_two_faces_that_read_the_same_are_both_in_doubt():
    rests, rng = kept("+y", "-y", "+x", read_as=[("+x", "-x")])
    with pytest.raises(Contradiction, match=r"readings of \+x.* Mount both") as told:
        rests.check(rest("-x"), read(rng, "-x", count=True), "step")
    assert not told.value.surely


class InCounts(Device):
    """Reads counts."""

    def stop(self):
        record = super().stop()
        accel = np.rint(1700.0 * record.accel + [300.0, -80.0, 40.0])
        return replace(record, accel=accel, accel_unit="count")


SIX = ("+x", "-x", "+y", "-y", "+z", "-z")


@pytest.mark.parametrize(
    ("wrong", "mounted"),
    [
        ({1: "+y"}, "+x -x -x +y -y +z -z +x"),  # the first: -x is mounted twice, then +x again at the end
        ({1: "-x"}, "+x -x -x +y -y +z -z +x"),
        ({2: "+z"}, "+x -x -x +y -y +z -z"),  # the second is mounted again, and nothing else
        ({3: "-x"}, "+x -x +y +y -y +z -z"),
        ({3: "+z"}, "+x -x +y -y +z -z +y"),  # with -y the faces before show at once that +y is wrong
    ],
)
def test_a_run_in_counts_takes_the_face_again_that_was_wrong(tmp_path, wrong, mounted):
    bench, protocol = simulated(), replace(SHORT, faces=SIX, axes=())
    result, hands = run(bench, tmp_path / "run", protocol, readings=InCounts, hands=Hands(bench, wrong))
    assert hands.mounted == mounted.split()
    assert (result.added, len(result.pieces)) == (6, 6)
    read = {piece.up: read_parquet(tmp_path / "run" / piece.name).record.accel.mean(axis=0) for piece in result.pieces}
    for up in SIX:
        assert np.allclose(read[up], 1700.0 * STANDARD_GRAVITY * UP[up] + [300.0, -80.0, 40.0], atol=5.0)
    assert len(list((tmp_path / "run").glob("aside/*"))) == mounted.endswith(("+x", "+y"))
    assert run(bench, tmp_path / "run", protocol, readings=InCounts, resume=True)[0].added == 0  # taken back for good


def test_faces_that_contradict_each_other_for_good_end_the_run_and_name_both(tmp_path):
    bench = simulated()
    always = Hands(bench, dict.fromkeys(range(1, 99), "+y"))
    with pytest.raises(RigFault, match=r".x must be up in step .*, got the readings of .x"):
        run(bench, tmp_path, replace(SHORT, faces=("+x", "-x"), axes=()), readings=InCounts, hands=always)
    assert not bench.servo.powered


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
        record = read_parquet(tmp_path / piece.name).record
        assert np.allclose(record.accel.mean(axis=0), STANDARD_GRAVITY * UP[piece.up], atol=0.01)
        assert np.ptp(record.gyro, axis=0).max() < 0.2


def test_a_rest_that_is_always_disturbed_ends_the_run(tmp_path):
    bench = simulated()
    with pytest.raises(RigFault, match=r"not at rest in step 1 .*`resume`"):
        run(bench, tmp_path, FACES_ALONE, readings=lambda bench: Clumsy(bench, range(99)))
    assert not bench.servo.powered


def test_a_resumed_run_knows_the_rests_on_the_disk(tmp_path):
    bench = simulated()
    run(bench, tmp_path, FACES_ALONE)
    journal = (tmp_path / "journal.jsonl").read_text().splitlines(keepends=True)
    (tmp_path / "journal.jsonl").write_text("".join(journal[:-1]))  # the last face is taken anew

    class Loud(Device):
        def stop(self):
            record = super().stop()
            noise = np.random.default_rng(1).normal(size=record.gyro.shape)
            return replace(record, gyro=record.gyro + 2.0 * STILL * 0.02 * noise)

    with pytest.raises(RigFault, match="times the spread"):
        run(bench, tmp_path, FACES_ALONE, resume=True, readings=Loud)


# ---- turns


def turn(rate_dps, axis="z", dwell_s=4.0):
    return Dwell(
        purpose="rate", up=f"+{axis}", axis=axis, turn_rate=rate_dps * DPS, ramp_s=0.1, settle_s=0.1, dwell_s=dwell_s
    )


def turning(rng, rates_dps, *, gain=GAIN, noise=0.05, step=0.0, limit=np.inf, n=400):
    """Readings about z, a rate after the other in equal parts."""
    rate = np.repeat(np.atleast_1d(rates_dps), -(-n // np.size(rates_dps)))[:n]
    gyro = np.clip(rate[:, None] * gain[:, 2] + OFFSET, -limit, limit) + noise * rng.standard_normal((n, 3))
    gyro = step * np.rint(gyro / step) if step else gyro
    return Record(time=np.arange(n) / 100.0, gyro=gyro, gyro_unit="count")


def judge_turns(rng, pairs, **how):
    """Judge and keep a rest, then turns at the first rates whose readings are of the second."""
    turns = TurnCheck()
    turns.keep(rest(), 0.0, turning(rng, 0.0, **how))
    for rate, read_dps in pairs:
        record = turning(rng, read_dps, **how)
        turns.check(turn(rate), rate * DPS, record, f"step at {rate:g}")
        turns.keep(turn(rate), rate * DPS, record)
    return turns


SOUND = [(w, w) for rate in (1.0, 5.0, 30.0, 60.0, 90.0) for w in (rate, -rate)]


@pytest.mark.parametrize(
    "how",
    [
        {},
        {"noise": 2.0},
        {"noise": 0.0},
        {"step": 0.6},
        {"step": 0.6, "noise": 0.0},
        {"limit": 55.0},
        {"gain": -200.0 * GAIN},
    ],
)
def test_sound_turns_are_kept_those_beyond_the_range_too(how):
    rng = np.random.default_rng(7)
    for _ in range(30):
        turns = judge_turns(rng, SOUND, **how)
        turns.check(rest(), 0.0, turning(rng, 0.0, **how), "rest")


@pytest.mark.parametrize(
    ("pairs", "got"),
    [
        ([(30.0, 0.0)], "step at 30, got readings of a rest"),
        ([(5.0, 0.0)], "step at 5, got readings of a rest"),
        ([(30.0, 30.0), (-30.0, 30.0)], "step at -30, got readings of another rate"),
        ([(30.0, 30.0), (-30.0, -30.0), (60.0, -30.0)], "step at 60, got readings of another rate"),
        ([(60.0, 60.0), (90.0, 30.0)], "step at 90, got readings of another rate"),
        ([(90.0, [0.0, 90.0, 90.0, 90.0])], "step at 90, got readings that change"),
        ([(-30.0, [-30.0] * 7 + [-20.0])], "step at -30, got readings that change"),
    ],
)
def test_readings_of_another_dwell_are_not_kept_as_those_of_a_turn(pairs, got):
    with pytest.raises(Disturbed, match=f"wrong readings in {got}"):
        judge_turns(np.random.default_rng(8), pairs)


def test_a_rest_that_reads_as_a_turn_is_not_kept_and_one_at_another_temperature_may():
    rng = np.random.default_rng(9)
    turns = judge_turns(rng, [(30.0, 30.0), (-30.0, -30.0)])
    late = turning(rng, -30.0)
    with pytest.raises(Disturbed, match="step 5, got readings of a turn"):
        turns.check(rest(purpose="bracket"), 0.0, late, "step 5")
    turns.check(replace(rest(purpose="bracket"), temp_c=60.0), 0.0, late, "step 5")


def test_a_run_learns_from_the_disk_what_turns_read(tmp_path, monkeypatch):
    shown = {}
    bench = simulated()
    run(bench, tmp_path / "run")
    monkeypatch.setattr(
        TurnCheck, "keep", lambda _, step, rate, record: shown.setdefault(step.purpose, []).append(rate)
    )
    run(bench, tmp_path / "run", resume=True)
    assert np.allclose(np.array(shown["rate"]) / DPS, [30.0, -30.0, 60.0, -60.0], atol=0.5)
