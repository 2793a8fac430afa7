"""The fault matrix: every fault in every phase of a run ends at rest, loses one dwell at most, and is made good by a resume."""

import random

import numpy as np
import pytest

from testkit.cards import TurningBoard, TurningCard
from testkit.data import show
from testkit.rig_bench import GAIN, OFFSET, RATES, SHORT, Device, Oven, at_rest, driven, run, simulated, with_set_points
from undrift.errors import RigError, RigTimeout, UndriftError
from undrift.io.session import read_session
from undrift.rig.folder import read_journal
from undrift.rig.lock import stop_rig
from undrift.rig.rig import RigSettings
from undrift.units import RADIAN_PER_DEGREE as DPS

REPLY_S = 0.5
WIRE = ("drop_bytes", "silence", "garbage", "half_reply", "slow_link", "disconnect")
CARD = ("stall", "limit_switch", "abort_input", "power_cut")  # stall: of the amplifier
DEVICE = "device_silent"
PHASES = ("connecting", "ramping", "dwelling", "resting", "closing")
OTHER_PHASES = ("mounting", "soaking", "enabling", "settling", "writing")
# a tick of 1 ms at either end of a dwell is then 0.03 deg/s at most
PROTOCOL = with_set_points(SHORT.but(rates=RATES.but(seconds=2.0)), 30.0)
RATES_DPS = (30.0, -30.0, 60.0, -60.0)  # as the programme turns
READING_DPS = 0.1  # a dwell's mean reading: noise 0.02/sqrt(50), and a servo that creeps at 1 count in a dwell
LIMIT_DPS = 0.05  # stored rate against the true one


class Silent(Device):
    """A device that sends nothing while something is wrong with it."""

    def __init__(self, faulty):
        super().__init__(faulty.bench)
        self.faulty = faulty

    def stop(self):
        if self.faulty.now in (DEVICE, "power_cut"):
            raise RigTimeout("device: wanted readings, got none")
        return super().stop()


class Faulty:
    """A simulated bench behind a controller, and what is wrong with it now."""

    def __init__(self, fault, controller=TurningCard):
        self.fault, self.now, self.bench = fault, "", simulated()
        self.card, self.chance, self.late = controller(self.bench), random.Random(1), None
        self.card.server.answer = self.answer

    def answer(self, command):
        """Return what comes through the wire of the card's answer."""
        if self.now not in WIRE:
            return self.card(command)
        answer = None if self.now == "silence" else self.card(command)
        if self.now == "disconnect":
            self.card.server.hang_up()
        elif self.now == "slow_link":  # each answer comes with the next one
            answer, self.late = self.late, answer
        elif answer and self.now == "drop_bytes":
            place = self.chance.randrange(len(answer))
            answer = answer[:place] + answer[place + 1 :]
        elif answer and self.now == "half_reply":
            answer = answer[: len(answer) // 2]
        elif answer and self.now == "garbage":
            answer = b"\x07gar\r\n:ok\r\n"
        return answer

    def inject(self):
        self.now = self.fault
        if self.fault == "power_cut":
            self.bench.servo.powered = False
            self.card.server.refuse_from_now_on()
        elif self.fault in CARD:
            self.card.fault = self.fault

    def clear(self):
        self.now = self.card.fault = ""
        if self.fault == "power_cut":
            self.card.start()
            self.card.server.accept_again()

    def run(self, path, *, protocol=PROTOCOL, **more):
        chamber = Oven() if protocol.temperatures_c else None
        return run(
            self.bench,
            path,
            protocol,
            chamber=chamber,
            readings=lambda bench: Silent(self),
            rig=lambda: driven(self.card, reply_timeout_s=REPLY_S),
            **more,
        )


def broken(bench, path, phase, protocol=PROTOCOL):
    """Run with a fault that begins in a phase, not always of the first step that has it; return the error, or None."""
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
        bench.run(path, report=report, protocol=protocol)
    except UndriftError as error:
        return error
    return None


def pieces(path):
    return read_journal(path / "session.toml")[1]


def error_of_rates(path):
    """Compare a whole run with the device's true matrix. Return the largest error of the stored rates, deg/s.

    The device says how fast the table truly turned over its readings, to NOISE / sqrt(200) = 0.0014 deg/s. The stored rate agrees
    with that within the limit or, if a fault delayed answers, within three of its stated standard uncertainties.
    """
    session, dwells = read_session(path), [piece for piece in pieces(path) if piece.purpose == "rate"]
    means = np.array([session.records[turn.recording].gyro[turn.start : turn.stop, 2].mean() for turn in session.turns])
    np.testing.assert_allclose(means, GAIN[2, 2] * np.array(RATES_DPS) + OFFSET[2], rtol=0.0, atol=READING_DPS)
    stated = np.array([piece.turn_rate_uncertainty for piece in dwells]) / DPS
    errors = np.abs([turn.turn_rate / DPS for turn in session.turns] - (means - OFFSET[2]) / GAIN[2, 2])
    assert (errors <= np.maximum(LIMIT_DPS, 3.0 * stated)).all(), errors
    return errors.max()


@pytest.mark.parametrize("phases", [PHASES, pytest.param(OTHER_PHASES, marks=pytest.mark.slow)], ids=["main", "other"])
@pytest.mark.parametrize("fault", [*WIRE, *CARD, DEVICE])
def test_a_fault_in_any_phase_ends_at_rest_and_a_resume_completes(fault, phases, tmp_path):
    cells = [cell(Faulty(fault), phase, tmp_path / phase) for phase in phases]
    show(
        f"{fault}: dwells kept + dwells of the resume; ! where the run ended with an error", [said for said, _ in cells]
    )
    if fault in (DEVICE, "power_cut"):  # nothing can go on; a run that never saw the fault would be no test of it
        assert all(said.endswith("!") for (said, _), phase in zip(cells, phases, strict=True) if phase != "closing")
    off = [float(each) for _, each in cells]
    show(f"{fault}: stored rates off the true ones, deg/s", [round(each, 3) for each in off])
    assert np.median(off) < LIMIT_DPS


@pytest.mark.parametrize("fault", WIRE)
def test_a_stepper_board_on_a_bad_line_ends_at_rest_and_a_resume_completes(fault, tmp_path):
    said, off = cell(Faulty(fault, TurningBoard), "dwelling", tmp_path / "run")
    assert said == "4+3!"
    assert off < LIMIT_DPS


def cell(faulty, phase, path):
    """Break a run, look at what it left, resume it, compare; return what was kept and added in words, and how far rates are off."""
    error = broken(faulty, path, phase)
    kept = pieces(path)
    before = {piece.step: (path / piece.name).read_bytes() for piece in kept}
    faulty.clear()
    if "NOT CONFIRMED" in str(error):  # the operator stops it, once the link is back
        stop_rig(faulty.card.address, RigSettings(clock=faulty.bench.clock))
    assert at_rest(faulty.bench), f"{faulty.fault} while {phase}: the table is not at rest with its motor off"
    assert error is None or isinstance(error, RigError)
    assert phase == "closing" or (error is None) == (len(kept) == 7)
    faulty.run(path, resume=True)
    assert at_rest(faulty.bench)
    assert [piece.step for piece in pieces(path)] == [2, 3, 4, 5, 6, 7, 8]
    for step, content in before.items():
        assert (path / f"pieces/{step:04d}.parquet").read_bytes() == content, "a dwell that was done has changed"
    return f"{len(kept)}+{7 - len(kept)}{'' if error is None else '!'}", error_of_rates(path)
