"""The fault matrix: every fault in every phase of a run ends at rest, loses one dwell at most, and is made good by a resume."""

import contextlib
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from testkit.data import show
from testkit.rig_bench import GAIN, OFFSET, Oven, at_rest, emulated, run, streaming
from undrift.errors import RigError, UndriftError
from undrift.io.session import read_session
from undrift.live.recorder import DwellReadings, Recorder, RecorderSettings
from undrift.live.transports import source_at
from undrift.rig.folder import read_journal
from undrift.rig.judge import RunSettings
from undrift.rig.programme import Protocol
from undrift.units import RADIAN_PER_DEGREE as DPS

SPEED = 50.0
FAULTS = (
    "drop_bytes", "stall", "garbage", "half_reply", "slow_link", "disconnect",
    "amplifier_fault", "encoder_loss", "limit_switch", "abort_input", "power_cut", "silence",
)  # fmt: skip
SILENCE = "silence"  # the device's, not the table's
PHASES = (
    "connecting", "mounting", "soaking", "enabling", "ramping", "settling", "dwelling", "resting", "writing", "closing",
)  # fmt: skip
PROTOCOL = Protocol(
    faces=("+z",),
    face_s=0.5,
    turn_rate_min=30.0 * DPS,
    turn_rate_max=60.0 * DPS,
    turn_rate_step=30.0 * DPS,
    axes=("z",),
    dwell_s=1.0,
    bracket_s=0.5,
    temperatures_c=(30.0,),
)
RATES_DPS = (30.0, -30.0, 60.0, -60.0)  # as the programme turns
READING_DPS = 0.1  # a dwell's mean reading: noise 0.02/sqrt(50), and a servo that creeps at 1 count in a dwell
GAIN_BOUND = 2.0 * READING_DPS / (60.0 * 10.0**0.5)  # such readings at these four rates
JUDGE = RunSettings()
STORED_DPS = (  # what check_rate lets pass where the link hides as much as it may
    (JUDGE.turn_rate_tolerance + JUDGE.link_tolerance) * np.abs(RATES_DPS)
    + JUDGE.angle_tolerance / DPS / PROTOCOL.dwell_s
)
TYPICAL_DPS = 0.2  # seen: 0.03, on a busy machine too; a card's millisecond taken for another would be 0.7 to 1.4
PATIENT_S = 20.0
AT_ONCE = 3  # most of a cell is waiting for answers that do not come


class Bench:
    """A table and what reads the device: the fake one, which is never silent, or one that sends over a socket."""

    def __init__(self, fault):
        self.fault = fault
        self.sends = fault == SILENCE

    def __enter__(self):
        with contextlib.ExitStack() as opened:
            self.emulator = opened.enter_context(emulated(SPEED))
            if self.sends:
                self.device = streaming(self.emulator)
                opened.callback(self.device.close)
            self._opened = opened.pop_all()
        return self

    def __exit__(self, *failure):
        self._opened.close()

    def inject(self):
        (self.device if self.sends else self.emulator).inject(self.fault)

    def clear(self):
        (self.device if self.sends else self.emulator).clear()

    def run(self, path, *, silence_s=PATIENT_S, **more):
        if not self.sends:
            return run(self.emulator, path, PROTOCOL, chamber=Oven(), **more)
        source = source_at(self.device.address(SPEED))
        with Recorder(source, settings=RecorderSettings(silence_s=silence_s)) as recorder:
            readings = DwellReadings(recorder, deadline_s=silence_s)
            return run(self.emulator, path, PROTOCOL, chamber=Oven(window_s=15.0), readings=readings, **more)


def broken(bench, path, phase):
    """Run with a fault that begins in a phase, not always of the first step that has it; return the error, or None.

    In a dwell it begins at the second report: a busy machine makes few of them, and never fewer.
    """
    step = {"ramping": 3, "settling": 3, "dwelling": 3, "resting": 2, "writing": 3}.get(phase, 1)
    reports = 2 if phase in ("dwelling", "resting") else 1
    seen = {}

    def report(progress):
        if progress.phase == phase:
            seen[progress.number] = seen.get(progress.number, 0) + 1
            if (len(seen), seen[progress.number]) == (step, reports):
                bench.inject()

    if phase == "connecting":
        bench.inject()
    try:
        bench.run(path, report=report, reply_timeout_s=0.1, silence_s=1.0)
    except UndriftError as error:
        return error
    return None


def pieces(path):
    return read_journal(path / "journal.jsonl")[0][1:] if path.exists() else ()


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory):
    path = tmp_path_factory.mktemp("uninterrupted") / "run"
    with Bench("none") as bench:
        bench.run(path)
        assert at_rest(bench.emulator)
    return own_axis(read_session(path))


def own_axis(session):
    """Return stored rates and mean readings of the dwells about z, deg/s."""
    assert [turn.axis for turn in session.turns] == ["z"] * len(RATES_DPS)
    stored = [turn.turn_rate / DPS for turn in session.turns]
    means = [session.records[turn.recording].gyro[turn.start : turn.stop, 2].mean() for turn in session.turns]
    return np.array(stored), np.array(means)


def compare(found, uninterrupted):
    """Compare dwell by dwell, with the device's true matrix and with the run that nothing broke, and their gains.

    The device says how fast the table truly turned over its readings, to NOISE / sqrt(100) = 0.002 deg/s; the stored rate may be
    off that by what the run lets pass.
    """
    stored, means = found
    rates = np.array(RATES_DPS)
    np.testing.assert_allclose(means, GAIN[2, 2] * rates + OFFSET[2], rtol=0.0, atol=READING_DPS)
    np.testing.assert_allclose(means, uninterrupted[1], rtol=0.0, atol=2.0 * READING_DPS)
    gains = [np.polyfit(rates, each, 1)[0] for each in (means, uninterrupted[1])]
    assert abs(gains[0] - gains[1]) < GAIN_BOUND
    assert (np.abs(stored - true_rates(means)) <= STORED_DPS).all(), (stored, true_rates(means))


def true_rates(means):
    return (means - OFFSET[2]) / GAIN[2, 2]


@pytest.mark.parametrize("dwell", range(4))
@pytest.mark.parametrize("error_dps", [0.25, -1.0, 60.0])
def test_a_dwell_that_was_corrupted_does_not_pass_the_comparison(uninterrupted, dwell, error_dps):
    compare(uninterrupted, uninterrupted)
    stored, means = uninterrupted
    means = means.copy()
    means[dwell] += error_dps
    with pytest.raises(AssertionError):
        compare((stored, means), uninterrupted)


@pytest.mark.parametrize("dwell", range(4))
@pytest.mark.parametrize("error", [0.2, -1.0])
def test_a_stored_rate_that_is_wrong_does_not_pass_the_comparison(uninterrupted, dwell, error):
    stored, means = uninterrupted
    stored = stored.copy()
    stored[dwell] *= 1.0 + error
    with pytest.raises(AssertionError):
        compare((stored, means), uninterrupted)


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_in_any_phase_ends_at_rest_and_a_resume_completes(fault, tmp_path, uninterrupted, capsys):
    with ThreadPoolExecutor(AT_ONCE) as pool:
        cells = list(pool.map(lambda phase: cell(fault, phase, tmp_path / phase, uninterrupted), PHASES))
    assert len(cells) == len(PHASES)
    if fault in (SILENCE, "power_cut"):  # nothing can go on; a run that never saw the fault would be no test of it
        assert all(said.endswith("!") for said, _ in cells[:-1])
    with capsys.disabled():
        if fault == FAULTS[0]:
            print("\ndwells kept + dwells of the resume; ! where the run ended with an error")
            print(" " * 20 + " ".join(f"{phase:>10}" for phase in PHASES))
        print(f"{fault:>19} " + " ".join(f"{said:>10}" for said, _ in cells))
    off = [float(each) for _, each in cells]
    show(f"{fault}: stored rates off the true ones, deg/s", [round(each, 3) for each in off])
    assert np.median(off) < TYPICAL_DPS


def cell(fault, phase, path, uninterrupted):
    """Break a run, look at what it left, resume it, compare; return what was kept and added in words, and how far rates are off."""
    with Bench(fault) as bench:
        error = broken(bench, path, phase)
        kept = pieces(path)
        before = {entry["step"]: (path / f"pieces/{entry['step']:04d}.parquet").read_bytes() for entry in kept}
        bench.clear()
        assert at_rest(bench.emulator), f"{fault} while {phase}: the table is not at rest with its motor off"
        assert error is None or isinstance(error, RigError)
        assert phase == "closing" or (error is None) == (len(kept) == 7)
        result, _ = bench.run(path, resume=True)
        assert at_rest(bench.emulator)
    assert [piece.step for piece in result.pieces] == [2, 3, 4, 5, 6, 7, 8]
    for step, content in before.items():
        assert (path / f"pieces/{step:04d}.parquet").read_bytes() == content, "a dwell that was done has changed"
    found = own_axis(read_session(path))
    compare(found, uninterrupted)
    off = np.abs(found[0] - true_rates(found[1])).max()
    return f"{len(kept)}+{result.added}{'' if error is None else '!'}", off
