"""The simulated bench: a run on it is a session that calibrates, whatever breaks ends at rest."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.rig_bench import SHORT
from undrift.calibration.calibrate import calibrate
from undrift.errors import LinkError, RigError, RigFault, RigTimeout
from undrift.io.session import read_session
from undrift.programme import programme_of
from undrift.record import FACES
from undrift.rig.folder import RunFolder
from undrift.rig.rig import open_rig
from undrift.rig.run import Mounted, RigBench, run_programme
from undrift.rig.simulated import AirSettings, SimulatedBench, SimulatedSettings
from undrift.sim.device.presets import random_device
from undrift.sim.device.truth import true_calibration
from undrift.units import STANDARD_GRAVITY

DEVICE = random_device(np.random.default_rng(3), grade="consumer")
WHOLE = replace(SHORT, faces=FACES, axes=("x", "y", "z"), face_s=2.0, dwell_s=2.0)


def run_on(bench, path, protocol=SHORT, *, resume=False, report=lambda progress: None, **more):
    with RunFolder(path, protocol, resume=resume) as folder:
        chamber = bench.chamber if protocol.temperatures_c else None
        connected = RigBench(rig=bench.table, mounting=bench, chamber=chamber, clock=bench.clock)
        mounted = Mounted(readings=bench.readings[0], folder=folder, serial="made")
        return run_programme(programme_of(protocol), connected, mounted, report=report, **more)[0]


def at_rest(bench):
    bench.clock.wait(10.0)
    return bench.turn_rate() == 0.0 and not bench.servo.powered


def test_a_run_is_a_session_that_calibrates_to_the_truth(tmp_path):
    bench = SimulatedBench((DEVICE,))
    result = run_on(bench, tmp_path / "run", WHOLE, gravity_m_s2=STANDARD_GRAVITY)
    assert at_rest(bench)
    for piece in result.pieces:
        if piece.purpose == "rate":  # the encoder's counts over a dwell
            assert abs(piece.turn_rate - piece.set_turn_rate) < 6.0 * max(piece.turn_rate_uncertainty, 1e-6)
    found, true = calibrate(read_session(tmp_path / "run")), true_calibration(DEVICE)
    for name in ("gyro", "accel"):
        ratio = getattr(found, name).matrix @ np.linalg.inv(getattr(true, name).matrix)
        np.testing.assert_allclose(ratio, np.eye(3), atol=3e-3)


def test_the_same_seed_makes_the_same_run_and_another_seed_another(tmp_path):
    read = []
    for name, seed in (("one", 1), ("same", 1), ("other", 2)):
        run_on(SimulatedBench((DEVICE,), SimulatedSettings(seed=seed)), tmp_path / name)
        read.append([record.gyro for record in read_session(tmp_path / name).records])
    assert all(np.array_equal(a, b) for a, b in zip(read[0], read[1], strict=True))
    assert not np.array_equal(read[0][0], read[2][0])


def test_a_chamber_soaks_and_the_board_follows(tmp_path):
    air = AirSettings(ramp_c_per_min=60.0, period_s=20.0, board_lag_s=10.0)
    bench = SimulatedBench((DEVICE,), SimulatedSettings(air=air))
    run_on(bench, tmp_path / "run", replace(SHORT, temperatures_c=(30.0, 40.0)))
    temps = {round(turn.temp_c) for turn in read_session(tmp_path / "run").turns}
    assert len(temps) == 2
    assert max(temps) - min(temps) == pytest.approx(10.0, abs=1.0)
    bench.chamber.close()
    bench.clock.wait(3600.0)
    assert bench.chamber.read() == pytest.approx(25.0, abs=1.0)


@pytest.mark.parametrize(
    ("fault", "error", "message"),
    [
        ("stall", RigFault, "motor off|a steady turn|rad/s within"),
        ("power_cut", LinkError, "no answer"),
        ("lost_readings", RigTimeout, "at least 80% of"),
    ],
)
@pytest.mark.parametrize("phase", ["ramping", "dwelling"])
def test_a_fault_ends_at_rest_and_a_resume_completes(tmp_path, fault, error, message, phase):
    bench = SimulatedBench((DEVICE,))

    def strike(progress):
        if progress.phase == phase and progress.number == 4:
            bench.faults.add(fault)

    with pytest.raises(error, match=message):
        run_on(bench, tmp_path / "run", report=strike)
    bench.faults.clear()
    assert bench.clock.wait(60.0) is None
    assert bench.turn_rate() == 0.0
    result = run_on(bench, tmp_path / "run", resume=True)
    assert (len(result.pieces), 0 < result.added < 7) == (7, True)
    assert at_rest(bench)


def test_a_wrong_face_is_seen_and_mounted_again(tmp_path, caplog):
    bench = SimulatedBench((DEVICE,))

    struck = []

    def strike(progress):
        if progress.phase == "mounting" and "-x" in progress.step and not struck:
            struck.append(progress.number)
            bench.faults.add("wrong_face")

    run_on(bench, tmp_path / "run", WHOLE, report=strike)
    assert "dwell is repeated" in caplog.text or "mounted and read again" in caplog.text
    for still in read_session(tmp_path / "run").stills:
        if still.face:
            record = read_session(tmp_path / "run").records[still.recording]
            axis, way = "xyz".index(still.face[1]), 1.0 if still.face[0] == "+" else -1.0
            assert way * record.accel[still.start : still.stop, axis].mean() > 0.0


def test_a_table_turns_for_a_time_and_keeps_its_limits():
    table = open_rig("simulated:?clock_speed=1e6")
    table.enable(True)
    table.set_acceleration(40.0)
    start = table.position().angle
    assert table.turn_for(1.0, 2.0) == pytest.approx(1.0, rel=1e-3)
    table._bench.clock.wait(2.0)
    table.stop()
    assert table.position().angle - start == pytest.approx(1.0 * (2.0 - 1.0 / 40.0), abs=1e-3)
    assert table.fault() is None
    with pytest.raises(RigError):
        table.turn_for(100.0, 2.0)
    table.close()
    with pytest.raises(RigFault, match="its motor off"):
        table.turn_for(1.0, 2.0)
