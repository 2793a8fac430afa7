"""Runs on the simulated bench: achieved rates reach the session, and every ending is at rest."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.cards import TurningBoard, TurningCard
from testkit.rig_bench import (
    FACE,
    GAIN,
    LIMITS,
    RATES,
    SHORT,
    Device,
    Oven,
    at_rest,
    driven,
    gain_of,
    run,
    simulated,
    with_set_points,
)
from undrift.errors import InputError, RigFault, RigTimeout
from undrift.io.session import read_session
from undrift.programme import Protocol
from undrift.rig import run as run_file
from undrift.units import RADIAN_PER_DEGREE as DPS


def test_a_run_is_a_session_with_the_rates_that_were_achieved(tmp_path):
    said = []
    bench = simulated()
    result, hands = run(bench, tmp_path, report=said.append)
    assert at_rest(bench)
    session = read_session(tmp_path)
    assert hands.mounted == ["+z"]
    assert [round(turn.turn_rate / DPS) for turn in session.turns] == [30, -30, 60, -60]
    assert [still.face for still in session.stills] == ["+z"] * 3
    for turn, piece in zip(session.turns, [p for p in result.pieces if p.purpose == "rate"], strict=True):
        # in the dwell's second: a count at each end, a count of creep, half a tick of the card's clock at 60 deg/s
        assert abs(turn.turn_rate - piece.set_turn_rate) < 0.06 * DPS
        assert 0.0 < piece.turn_rate_uncertainty < 0.06 * DPS
    phases = {progress.phase for progress in said}
    assert phases == {"mounting", "enabling", "ramping", "settling", "dwelling", "resting", "writing", "closing"}
    left = [progress.left_s for progress in said]
    assert left[0] > left[-1] >= 0.0


@pytest.mark.parametrize("controller", [TurningCard, TurningBoard])
def test_a_run_through_a_driver_turns_at_every_rate(tmp_path, controller):
    bench = simulated()
    card = controller(bench)
    result, _ = run(bench, tmp_path, rig=lambda: driven(card))
    assert at_rest(bench)
    turns = [piece for piece in result.pieces if piece.purpose == "rate"]
    assert [round(piece.turn_rate / DPS) for piece in turns] == [30, -30, 60, -60]
    gain, uncertainty = gain_of(read_session(tmp_path))
    assert gain == pytest.approx(GAIN[2, 2], abs=max(5.0 * uncertainty, 1e-3))


def test_a_chamber_is_set_and_waited_for_with_the_motor_off(tmp_path):
    bench = simulated()
    motor = []
    result, _ = run(
        bench,
        tmp_path,
        with_set_points(SHORT, 30.0, 40.0),
        chamber=Oven(),
        report=lambda progress: motor.append(bench.servo.powered) if progress.phase == "soaking" else None,
    )
    assert motor
    assert not any(motor)
    assert {piece.temp_c for piece in result.pieces} == {30.0, 40.0}
    assert {turn.temp_c for turn in read_session(tmp_path).turns} == {30.0, 40.0}
    assert read_session(tmp_path).kind == "thermal"


def test_temperatures_without_a_chamber_and_unsafe_rates_move_nothing(tmp_path):
    bench = simulated()
    with pytest.raises(InputError, match="require a chamber"):
        run(bench, tmp_path / "a", with_set_points(SHORT, 30.0))
    with pytest.raises(InputError, match=r"turn rate: at most 200 deg/s .*, got 210"):
        run(bench, tmp_path / "b", SHORT.but(rates=RATES.but(turn_rate_max_dps=300.0)))
    assert at_rest(bench)
    assert bench.angle() == 0.0


def test_a_chamber_that_never_soaks_ends_in_time_and_at_rest(tmp_path, monkeypatch):
    monkeypatch.setattr(Oven, "soaked", lambda self, slope: False)
    monkeypatch.setattr(run_file, "SOAK_TIMEOUT_S", 5.0)
    bench = simulated()
    with pytest.raises(RigTimeout, match=r"not steady at 30 degC within 0.1 K/min after 5 s, got 30.00 degC"):
        run(
            bench,
            tmp_path,
            with_set_points(SHORT, 30.0),
            chamber=Oven(),
        )
    assert at_rest(bench)


HEATED = with_set_points(Protocol(faces=FACE.but(seconds=3.0)), 40.0)


class Warm(Device):
    """A device with a thermometer: 30 degC at first, 40 when it has followed the chamber with 60 s; in a dwell as told."""

    def __init__(self, bench, in_dwell=lambda t: 0.0 * t):
        super().__init__(bench)
        self.born, self.in_dwell, self.phase = bench.now(), in_dwell, ""

    def stop(self):
        record = super().stop()
        follows = 40.0 - 10.0 * np.exp(-(record.time - self.born) / 60.0)
        away = self.in_dwell(record.time - record.time[0]) if self.phase == "resting" else 0.0
        return replace(record, temp_c=follows + away)


def heated(bench, path, device):
    """Run with a device that knows the phase of the run."""

    def report(progress):
        device.phase = progress.phase

    return run(bench, path, HEATED, chamber=Oven(), report=report, readings=lambda bench: device)[0]


def test_a_soak_waits_until_the_devices_own_thermometer_stands_still_and_its_mean_is_written(tmp_path):
    bench = simulated()
    device = Warm(bench)
    piece = run(bench, tmp_path, HEATED, chamber=Oven(), readings=lambda bench: device)[0].pieces[0]
    took_s = bench.now() - device.born
    assert took_s > 60.0 * np.log(10.0 / 0.1), "10 K at 60 s falls below 0.1 K/min after 4.6 time constants"
    assert piece.temp_c == 40.0
    assert 39.8 < piece.device_c < 40.0
    assert read_session(tmp_path).stills[0].temp_c == piece.device_c


def test_a_device_without_a_thermometer_is_given_five_of_its_stated_time_constants(tmp_path):
    bench = simulated()
    begun, said = bench.now(), []
    run(
        bench,
        tmp_path,
        HEATED,
        chamber=Oven(),
        after_air_s=100.0,
        report=lambda progress: said.append((progress.phase, bench.now() - begun)),
    )
    assert next(at for phase, at in said if phase == "settling") > 100.0
    assert read_session(tmp_path).stills[0].temp_c == 40.0
    assert read_session(tmp_path).kind == "calibration"  # one temperature makes no tables


def test_a_door_that_opens_while_the_table_dwells_ends_the_run_at_rest(tmp_path):
    oven = Oven()

    def report(progress):
        if progress.phase == "dwelling":
            oven.temp_c = 25.0

    bench = simulated()
    with pytest.raises(RigFault, match=r"40 degC within 0.5 K in step 3 .*, got 25.00 degC"):
        run(bench, tmp_path, with_set_points(SHORT.but(faces=None), 40.0), chamber=oven, report=report)
    assert at_rest(bench)
    assert len(read_session(tmp_path).stills) == 1


def test_a_thermometer_that_jumps_in_a_dwell_ends_the_run(tmp_path):
    bench = simulated()
    with pytest.raises(RigFault, match=r"steady within 0.5 K in step 2"):
        heated(bench, tmp_path, Warm(bench, lambda t: np.where(t > 1.5, 3.0, 0.0)))
    assert at_rest(bench)


def test_gaps_are_no_readings_and_a_few_are_counted(tmp_path):
    def device(lost):
        class Gappy(Device):
            def stop(self):
                record = super().stop()
                keep = np.arange(len(record)) % 10 >= lost
                return replace(record, gyro=np.where(keep[:, None], record.gyro, np.nan))

        return Gappy

    still = Protocol(faces=FACE.but(seconds=2.0))
    bench = simulated()
    piece = run(bench, tmp_path / "few", still, readings=device(1))[0].pieces[0]
    assert 0.09 < piece.missing / piece.samples < 0.11
    with pytest.raises(RigTimeout, match=r"at least 80% of \d+ readings in step 1"):
        run(bench, tmp_path / "many", still, readings=device(3))


class LateOnce(Device):
    """A device whose first dwell, or first turning dwell, is only half read."""

    def __init__(self, bench, turning=False):
        super().__init__(bench)
        self.turning, self.stops = turning, 0

    def stop(self):
        turns, record = abs(self.bench.turn_rate()) >= 0.1, super().stop()
        self.stops += turns >= self.turning
        return record.part(len(record) // 2, len(record)) if self.stops == 1 and turns >= self.turning else record


def test_dwell_that_began_too_late_is_read_again(tmp_path):
    bench = simulated()
    late = LateOnce(bench)
    result, _ = run(bench, tmp_path, Protocol(faces=FACE.but(seconds=2.0)), readings=lambda bench: late)
    assert late.stops == 2
    assert result.pieces[0].samples >= 200


def test_dwell_is_not_read_again_while_a_table_of_limited_travel_turns(tmp_path):
    bench = simulated(limits=replace(LIMITS, travel=1000.0))
    late = LateOnce(bench, turning=True)
    with pytest.raises(RigTimeout, match=r"at least 80% of \d+ readings in step 3 .*, got \d+"):
        run(bench, tmp_path, SHORT, readings=lambda bench: late)
    assert at_rest(bench)
    assert late.stops == 1
