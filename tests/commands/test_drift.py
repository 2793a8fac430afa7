"""undrift drift: real logs as a lab reads them, made sessions, and what is refused with its number and nothing written."""

import re
from dataclasses import replace

import numpy as np
import pytest

from testkit.command_line import contents
from undrift.io.formats import write_record
from undrift.io.session import write_session
from undrift.io.store import read_calibration, write_calibration
from undrift.record import Record
from undrift.sim.device.presets import preset
from undrift.sim.device.truth import true_calibration
from undrift.sim.motion.bench import BenchSettings
from undrift.sim.thermal import ChamberSettings, ThermalSettings, simulate_thermal_session

pytestmark = pytest.mark.usefixtures("computed_once")

DEVICE = preset("enc03j_3031")
QUICK = ChamberSettings(ramp_rate_c_per_min=20.0, air_lag_s=5.0, board_lag_s=10.0, soak_hold_s=300.0)
BENCH = BenchSettings(
    sample_rate_hz=50.0, still_s=6.0, move_s=1.0, turn_rates=tuple(np.radians((30.0, 60.0, 90.0))), dwell_s=1.5
)
SOAKS = ThermalSettings(
    bench=BENCH, chamber=QUICK, set_points_c=(18.0, 28.0, 38.0, 47.0, 57.0, 66.0, 75.0), back=True, faces="six"
)


@pytest.fixture(scope="module")
def soaks(tmp_path_factory):
    """A session of soaks up and down on six faces, and the device's calibration."""
    folder = tmp_path_factory.mktemp("soaks")
    made = simulate_thermal_session("soak", DEVICE, rng=np.random.default_rng(1), settings=SOAKS)
    write_session(made, folder / "session")
    write_calibration(true_calibration(DEVICE), folder / "calibration.json")
    return folder


@pytest.mark.slow
def test_a_full_session_is_good_and_every_table_is_shown_and_drawn(undrift, soaks, tmp_path):
    words = ["drift", soaks / "session", "--calibration", soaks / "calibration.json"]
    answer = undrift.good(*words, "--details", "-o", tmp_path / "c.json", "--report", tmp_path / "p.html")
    out = answer.out
    for said in (
        "verdict: good",
        "hysteresis half-width",
        "Scale factor",
        "extrapolated",
    ):
        assert said in out, said
    assert len(re.findall(r"^ [xyz] +(-?0\.(?:20|19)\d*) ± ", out, re.MULTILINE)) == 3  # 0.2 %/K by the preset
    assert (tmp_path / "p.html").read_text().count("<svg") >= 4
    assert len(out.splitlines()) < 66  # three findings take up to three lines each
    held = read_calibration(tmp_path / "c.json")
    assert held.drift.static.gyro_hysteresis is not None
    assert held.drift.scale is not None


@pytest.mark.slow
def test_several_logs_are_combined_and_a_warm_up_is_fitted(undrift, soaks, tmp_path):
    for k in range(3):
        settings = replace(SOAKS, warm_up_c=(8.0 + 10.0 * k, 28.0 + 10.0 * k), warm_up_s=1500.0)
        made = simulate_thermal_session("warm_up", DEVICE, rng=np.random.default_rng(k), settings=settings)
        write_record(made.records[0], tmp_path / f"day{k}.parquet")
    logs = sorted(tmp_path.glob("*.parquet"))
    own = tmp_path / "c.json"
    answer = undrift.good(
        "drift", *logs, "--calibration", soaks / "calibration.json", "--warm-up", "-o", own, "--details"
    )
    assert "between sessions" in answer.out
    assert "one session only" not in answer.out
    assert "--power-on-s 0 -o corrected.parquet" in answer.out
    assert read_calibration(own).drift.static.warm_up is not None
    walk = tmp_path / "walk.parquet"
    write_record(simulate_thermal_session("warm_up", DEVICE, rng=np.random.default_rng(9)).records[0], walk)
    words = [walk, "--calibration", own]
    assert "No warm-up was subtracted" in undrift.good("noise", *words).out
    words += ["-o", tmp_path / "corrected.parquet"]
    assert "No warm-up was subtracted" in undrift.good("correct", *words).out
    assert "No warm-up was subtracted" not in undrift.good("correct", *words, "--power-on-s", "0").out


def warm_log(path, *, temp_c=None, **changes):
    rng = np.random.default_rng(3)
    n = 50 * 300
    values = {
        "time": np.arange(n) / 50.0,
        "gyro": rng.normal(0.0, 1e-3, (n, 3)),
        "accel": rng.normal([0.0, 0.0, 9.8], 1e-2, (n, 3)),
        "temp_c": np.linspace(20.0, 30.0, n) if temp_c is None else temp_c(n),
    }
    write_record(Record(**(values | changes)), path)
    return path


def shaken(n):
    return np.cumsum(np.random.default_rng(4).normal(0.0, 1.0, (n, 3)), axis=0) % 3.0


REFUSED = {
    "no temperature": ({"temp_c": lambda n: None}, "neither a column"),
    "constant": ({"temp_c": lambda n: np.full(n, 25.0)}, "constant"),
    "a narrow span": (
        {"temp_c": lambda n: np.linspace(20.0, 21.6, n)},
        r"span 1\.6 degC",
    ),
    "impossible": ({"temp_c": lambda n: np.linspace(20.0, 300.0, n)}, "-40 to 125 degC"),
    "corrected": ({"state": "corrected", "frame": "b"}, "is corrected already"),
    "counts": ({"gyro_unit": "count"}, "no known scale"),
    "never at rest": (
        {"gyro": shaken(15000), "accel": 10.0 * shaken(15000)},
        "no stretch at rest",
    ),
}


@pytest.mark.parametrize("fault", REFUSED)
def test_a_log_that_tells_nothing_is_refused_with_its_number(undrift, tmp_path, fault):
    changes, message = REFUSED[fault]
    log = warm_log(tmp_path / "log.parquet", **changes)
    before = contents(tmp_path)
    outputs = ["-o", tmp_path / "c.json", "--report", tmp_path / "p.html"]
    assert re.search(message, undrift.refused("drift", log, *outputs))
    assert contents(tmp_path) == before
