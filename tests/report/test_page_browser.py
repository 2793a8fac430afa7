"""Pages of the commands as a reader meets them: whole, on a wide and a narrow screen, light and dark, and on paper."""

import json
import shlex
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from testkit.demo_session import demo_session
from testkit.pages import CORNERS, browser, faults_of, seen_in
from testkit.pictures import pictures_looked_at
from testkit.remembered import folder_made_once, run_folder
from undrift.cli.app import run
from undrift.commands.rig import run_report
from undrift.io.formats import write_record
from undrift.io.reference import write_reference
from undrift.io.session import write_session
from undrift.record import Record
from undrift.report.page import Origin, write_report
from undrift.report.report import Report
from undrift.rig.folder import RecordedDwell
from undrift.rig.run import RunResult
from undrift.sim.motion.bench import BenchSettings
from undrift.sim.thermal import ChamberSettings, ThermalSettings, simulate_thermal_session
from undrift.units import RADIAN_PER_DEGREE

CALLS = {  # of commands that take no reference apart, in order: later ones read what earlier ones wrote
    "calibrate": "session -o c.json",
    "drift": "soaks --calibration c.json",
    "noise": "rest.parquet --rest-s 1:10",
    "correct": "trial.parquet --calibration c.json -o corrected.parquet",
    "orient": "corrected.parquet -o angles.csv",
    "validate": "trial.parquet --reference reference.parquet --calibration c.json",
}
SOAKS = ThermalSettings(
    bench=BenchSettings(sample_rate_hz=50.0, still_s=4.0, move_s=1.0, turn_rates=(0.5, 1.5), dwell_s=1.0),
    chamber=ChamberSettings(ramp_rate_c_per_min=20.0, air_lag_s=5.0, board_lag_s=10.0, soak_hold_s=100.0),
    set_points_c=(20.0, 30.0, 40.0),
    faces="six",
)
NAMES = (*CALLS, "rig")


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a page of each command, made once in a run of the suite; calibrate twice: again.html."""
    return folder_made_once(run_folder(tmp_path_factory), "pages", make_pages)


def make_pages(folder: Path) -> None:
    """Write recordings, and the pages of commands on them; cut.json has what their pictures cut off."""
    rng = np.random.default_rng(2007)
    made = demo_session(rng, quick=True)
    write_session(made.session, folder / "session")
    write_session(simulate_thermal_session("soak", made.device, rng=rng, settings=SOAKS), folder / "soaks")
    write_record(made.trial.record, folder / "trial.parquet")
    write_reference(made.trial.reference, folder / "reference.parquet")
    walk = np.cumsum(rng.normal(0.0, 1e-5, (40_000, 3)), axis=0)
    accel = rng.normal(0.0, 1e-2, (40_000, 3)) + np.array([0.0, 0.0, 9.81])
    rest = Record(time=np.arange(40_000) / 100.0, gyro=rng.normal(0.0, 1e-3, (40_000, 3)) + walk, accel=accel)
    write_record(rest, folder / "rest.parquet")
    with pytest.MonkeyPatch.context() as held, pictures_looked_at() as cut:
        held.chdir(folder)
        held.setenv("SOURCE_DATE_EPOCH", "1800000000")
        for name, words in CALLS.items():
            assert run([name, *shlex.split(words), "--report", f"{name}.html"]) in (0, 1), name
        assert run(["calibrate", "session", "--report", "again.html"]) in (0, 1)
        origin = Origin(command="undrift rig run", inputs=(("protocol.toml", "0" * 64),))
        write_report(Path("rig.html"), rig_run(), origin)
    (folder / "cut.json").write_text(json.dumps(cut))


def rig_run() -> Report:
    """Return what a run of a rate table came to."""
    turns = [
        RecordedDwell(
            step=k, purpose="rate", up="+z", axis="xyz"[k % 3], samples=300, start_s=0.0, stop_s=3.0, missing=k // 5,
            nominal_turn_rate=rate * RADIAN_PER_DEGREE, turn_rate=1.0001 * rate * RADIAN_PER_DEGREE,
            turn_rate_uncertainty=1e-5,
        )
        for k, rate in enumerate((-90.0, -45.0, 45.0, 90.0, 30.0, -30.0))
    ]  # fmt: skip
    result = RunResult(pieces=tuple(turns), added=6, duration_s=40.0, rig="a table")
    return run_report({Path("run"): result})


@pytest.mark.slow
def test_no_picture_of_a_page_cuts_its_legend_or_a_label(pages: Path) -> None:
    assert json.loads((pages / "cut.json").read_text()) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_a_page_has_its_parts_and_fetches_nothing(pages: Path, name: str) -> None:
    assert faults_of((pages / f"{name}.html").read_text()) == []


@pytest.mark.slow
def test_every_page_reads_on_wide_and_narrow_screens_light_and_dark_and_on_paper(pages: Path, playwright: Any) -> None:
    with browser(playwright) as held:  # the style is one: a page is judged at one of the corners
        corners = zip(NAMES, cycle(CORNERS), strict=False)
        assert [fault for name, at in corners for fault in seen_in(held, pages / f"{name}.html", judged=(at,))] == []
