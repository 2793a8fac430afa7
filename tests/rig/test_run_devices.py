"""Several devices on one table: the same dwells, a folder each; what one of them loses, the others keep."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.rig_bench import GAIN, SHORT, Device, Hands, at_rest, gain_of, simulated
from undrift.errors import LinkError, RigTimeout
from undrift.io.session import read_session
from undrift.programme import Dwell, programme_of
from undrift.rig.folder import RunFolder
from undrift.rig.run import Mounted, RigBench, run_programme
from undrift.units import STANDARD_GRAVITY

PLAN = programme_of(SHORT)
DWELLS = [number for number, step in enumerate(PLAN.steps) if isinstance(step, Dwell)]


class Failing(Device):
    """Falls silent, late or disturbed in some of its dwells, counted from 1."""

    def __init__(self, bench, number, *, silent=(), dead_from=99, disturbed=()):
        super().__init__(bench, number)
        self.silent, self.dead_from, self.disturbed, self.taken = silent, dead_from, disturbed, 0

    def start(self):
        if self.taken >= self.dead_from - 1:
            raise LinkError("made: expected a device that sends, got none")
        super().start()

    def stop(self):
        self.taken += 1
        if self.taken in self.silent:
            self.bench.clock.wait(5.0)  # that its answer is waited for
            raise RigTimeout("made: wanted readings, got none")
        record = super().stop()
        if self.taken in self.disturbed:
            gyro = np.array(record.gyro)
            gyro[: len(gyro) // 8] += 5.0 * np.sin(np.arange(len(gyro) // 8))[:, None]
            return replace(record, gyro=gyro)
        return record


def run_two(bench, path, *, first=None, second=None, resume=False):
    hands, shown = Hands(bench), []
    devices = [Failing(bench, number, **(how or {})) for number, how in enumerate((first, second))]
    with (
        RunFolder(path / "a", SHORT, resume=resume) as own,
        RunFolder(path / "b", SHORT, resume=resume) as other,
    ):
        connected = RigBench(rig=bench.table, mounting=hands, clock=bench.clock)
        results = run_programme(
            PLAN,
            connected,
            Mounted(readings=devices[0], folder=own, serial="first"),
            Mounted(readings=devices[1], folder=other, serial="second"),
            report=lambda progress: shown.append(progress.live),
            gravity_m_s2=STANDARD_GRAVITY,
        )
    assert any(live.endswith((" of first", " of second")) for live in shown), "whose readings are shown"
    return results, hands, devices


def test_two_devices_are_read_in_the_same_dwells_each_into_its_folder(tmp_path):
    bench = simulated(devices=2)
    (result, other), hands, _ = run_two(bench, tmp_path)
    assert at_rest(bench)
    assert hands.mounted == ["+z"]  # both at once
    assert (result.added, other.added) == (len(DWELLS), len(DWELLS))
    sessions = [read_session(tmp_path / name) for name in "ab"]
    assert [session.serial for session in sessions] == ["first", "second"]
    for session in sessions:
        gain, uncertainty = gain_of(session)
        assert abs(gain - GAIN[2, 2]) < 4.0 * uncertainty + 1e-3
    assert [piece.turn_rate for piece in result.pieces] == [piece.turn_rate for piece in other.pieces]
    assert not np.array_equal(sessions[0].records[0].gyro, sessions[1].records[0].gyro)


@pytest.mark.parametrize("slower", ["first", "second"])
def test_a_device_that_does_not_answer_in_one_dwell_misses_it_alone_and_a_resumed_run_reads_it(tmp_path, slower):
    name, sound = ("a", "b") if slower == "first" else ("b", "a")
    bench = simulated(devices=2)
    with pytest.raises(RigTimeout, match=rf"{name}: expected 7 dwells, got 6. Step 3 \(\+30 deg/s.*wanted readings"):
        run_two(bench, tmp_path, **{slower: {"silent": (3,)}})
    assert at_rest(bench)
    lengths = [record.duration_s for record in read_session(tmp_path / sound).records]
    assert len(lengths) == 7
    assert max(lengths) < 1.6  # the wait for the other is not part of a dwell
    assert len(read_session(tmp_path / name).records) == 6
    before = {path.name: path.read_bytes() for path in (tmp_path / sound / "pieces").iterdir()}
    bench = simulated(devices=2)
    results, _, _ = run_two(bench, tmp_path, resume=True)
    assert tuple(result.added for result in results) == ((1, 0) if slower == "first" else (0, 1))
    assert {path.name: path.read_bytes() for path in (tmp_path / sound / "pieces").iterdir()} == before
    assert len(read_session(tmp_path / name).records) == 7


def test_a_device_that_is_gone_does_not_end_the_others_run_and_two_that_are_gone_end_it_at_once(tmp_path):
    bench = simulated(devices=2)
    with pytest.raises(RigTimeout, match=r"b: expected 7 dwells, got 2. Step 3"):
        run_two(bench, tmp_path / "one", second={"dead_from": 3})
    assert at_rest(bench)
    assert len(read_session(tmp_path / "one" / "a").records) == 7
    bench = simulated(devices=2)
    with pytest.raises(LinkError, match="expected a device that sends, got none"):
        run_two(bench, tmp_path / "both", first={"dead_from": 3}, second={"dead_from": 2})
    assert at_rest(bench)
    assert [len(read_session(tmp_path / "both" / name).records) for name in "ab"] == [2, 1]


def test_a_rest_that_disturbs_one_device_is_taken_again_for_it_alone(tmp_path):
    bench = simulated(devices=2)
    results, _, devices = run_two(bench, tmp_path, second={"disturbed": (7,)})
    assert [device.taken for device in devices] == [7, 8]
    assert [result.added for result in results] == [7, 7]
