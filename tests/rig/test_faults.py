"""The fault matrix: every fault in every phase of a run ends at rest, loses one dwell at most, and is made good by a resume."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from run_bench import GAIN, OFFSET, Oven, at_rest, emulated, run
from undrift.errors import RigError, UndriftError
from undrift.io.session import read_session
from undrift.protocol import Protocol
from undrift.rig.journal import read_journal
from undrift.units import RADIAN_PER_DEGREE as DPS

SPEED = 50.0
FAULTS = (
    "drop_bytes", "stall", "garbage", "half_reply", "slow_link", "disconnect",
    "amplifier_fault", "encoder_loss", "limit_switch", "abort_input", "power_cut",
)  # fmt: skip
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
AT_ONCE = 3  # most of a cell is waiting for answers that do not come


def broken(emulator, path, fault, phase):
    """Run with a fault that begins in a phase, the third time it comes where it comes so often; return the error, or None."""
    times = {"ramping": 3, "settling": 3, "dwelling": 45, "resting": 12, "writing": 3}.get(phase, 1)
    count = 0

    def report(progress):
        nonlocal count
        count += progress.phase == phase
        if count == times and progress.phase == phase:
            emulator.inject(fault)

    if phase == "connecting":
        emulator.inject(fault)
    try:
        run(emulator, path, PROTOCOL, report=report, chamber=Oven(), reply_timeout_s=0.1)
    except UndriftError as error:
        return error
    return None


def pieces(path):
    return read_journal(path / "journal.jsonl")[0][1:] if path.exists() else ()


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory):
    path = tmp_path_factory.mktemp("uninterrupted") / "run"
    with emulated(SPEED) as emulator:
        run(emulator, path, PROTOCOL, chamber=Oven())
        assert at_rest(emulator)
    return own_axis_means(read_session(path))


def own_axis_means(session):
    """Return nominal rates and mean readings of the dwells about z, deg/s."""
    assert [np.sign(turn.turn_rate) for turn in session.turns] == [np.sign(rate) for rate in RATES_DPS]
    means = [session.records[turn.recording].gyro[turn.start : turn.stop, 2].mean() for turn in session.turns]
    return np.array(RATES_DPS), np.array(means)  # nominal: at 50 times real time the host times a position badly


def compare(found, uninterrupted):
    """Compare dwell by dwell, with the device's true matrix and with the run that nothing broke, and their gains."""
    rates, means = found
    np.testing.assert_allclose(means, GAIN[2, 2] * rates + OFFSET[2], rtol=0.0, atol=READING_DPS)
    np.testing.assert_allclose(means, uninterrupted[1], rtol=0.0, atol=2.0 * READING_DPS)
    gains = [np.polyfit(*pair, 1)[0] for pair in (found, uninterrupted)]
    assert abs(gains[0] - gains[1]) < GAIN_BOUND


@pytest.mark.parametrize("dwell", range(4))
@pytest.mark.parametrize("error_dps", [0.25, -1.0, 60.0])
def test_a_dwell_that_was_corrupted_does_not_pass_the_comparison(uninterrupted, dwell, error_dps):
    compare(uninterrupted, uninterrupted)
    rates, means = uninterrupted
    means = means.copy()
    means[dwell] += error_dps
    with pytest.raises(AssertionError):
        compare((rates, means), uninterrupted)


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_in_any_phase_ends_at_rest_and_a_resume_completes(fault, tmp_path, uninterrupted, capsys):
    with ThreadPoolExecutor(AT_ONCE) as pool:
        cells = list(pool.map(lambda phase: cell(fault, phase, tmp_path / phase, uninterrupted), PHASES))
    assert len(cells) == len(PHASES)
    with capsys.disabled():
        if fault == FAULTS[0]:
            print("\ndwells kept + dwells of the resume; ! where the run ended with an error")
            print(" " * 20 + " ".join(f"{phase:>10}" for phase in PHASES))
        print(f"{fault:>19} " + " ".join(f"{said:>10}" for said in cells))


def cell(fault, phase, path, uninterrupted):
    """Break a run, look at what it left, resume it, compare; return what was kept and added in words."""
    with emulated(SPEED) as emulator:
        error = broken(emulator, path, fault, phase)
        kept = pieces(path)
        before = {entry["step"]: (path / f"pieces/{entry['step']:04d}.parquet").read_bytes() for entry in kept}
        emulator.clear()
        assert at_rest(emulator), f"{fault} while {phase}: the table is not at rest with its motor off"
        assert error is None or isinstance(error, RigError)
        assert phase == "closing" or (error is None) == (len(kept) == 7)
        result, _ = run(emulator, path, PROTOCOL, resume=True, chamber=Oven())
        assert at_rest(emulator)
    assert [piece.step for piece in result.pieces] == [2, 3, 4, 5, 6, 7, 8]
    for step, content in before.items():
        assert (path / f"pieces/{step:04d}.parquet").read_bytes() == content, "a dwell that was done has changed"
    compare(own_axis_means(read_session(path)), uninterrupted)
    return f"{len(kept)}+{result.added}{'' if error is None else '!'}"
