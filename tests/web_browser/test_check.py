"""The page Check: the trace of a recording with its rests and turns; columns and units prove themselves."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Page, expect

import undrift
from testkit.bench import BenchServer
from undrift.io.column_map import read_map
from undrift.io.formats import read_record
from undrift.io.parquet import write_parquet
from undrift.model import Calibration
from undrift.record import Record
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY
from web_browser.conftest import faults_of, shoot, wide_and_narrow

COMMAND_MS = 60_000


@pytest.fixture(scope="module")
def calibrated() -> tuple[Record, Calibration]:
    """A device that rests on six faces, turned in between, in counts; and its calibration."""
    rng = np.random.default_rng(7)
    device = undrift.random_device(rng)
    made = undrift.calibrate(undrift.simulate_session("bench", device, rng=rng))
    (record,) = undrift.simulate_session("ferraris", device, rng=rng, labelled=False).records
    return record, made


@pytest.fixture(scope="module")
def turned(calibrated: tuple[Record, Calibration]) -> Record:
    """The same in physical units."""
    return replace(undrift.correct(*calibrated), state="raw", frame="s")


def dropped(page: Page, path: Path) -> list[str]:
    """Drop a file and wait for its trace; return what the browser complains of, as it comes."""
    complaints: list[str] = []
    page.on("console", lambda line: complaints.append(line.text) if line.type == "error" else None)
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.set_default_timeout(COMMAND_MS)
    page.get_by_label("Choose files").set_input_files(path)
    page.get_by_role("heading", name=path.name).wait_for()
    page.locator(".trace canvas").first.wait_for()
    return complaints


@wide_and_narrow
def test_a_trace_shows_both_sensors_with_rests_and_turns(
    open_page: Callable[..., Page], tmp_path: Path, calibrated: tuple[Record, Calibration], width: int, height: int,
    scheme: str,
) -> None:  # fmt: skip
    write_parquet(calibrated[0], tmp_path / "counts.parquet")
    page = open_page("/check", width=width, height=height, color_scheme=scheme)
    complaints = dropped(page, tmp_path / "counts.parquet")
    expect(page.locator(".found")).to_have_text("100.0 s: 12 rests on 6 faces, 11 turns.")
    page.mouse.move(0, 0)
    shoot(page, f"check-counts-{width}")
    assert faults_of(page) == []
    assert complaints == []


@wide_and_narrow
def test_columns_and_units_prove_themselves_and_what_nothing_shows_stays_empty(
    open_page: Callable[..., Page], tmp_path: Path, turned: Record, width: int, height: int, scheme: str
) -> None:
    table = np.column_stack(
        (turned.time * 1e3, np.asarray(turned.gyro) / RADIAN_PER_DEGREE, np.asarray(turned.accel) / STANDARD_GRAVITY)
    )
    swapped = table[:, [0, 4, 5, 6, 1, 2, 3]]  # names say gyro where the accelerometers are
    np.savetxt(tmp_path / "log.csv", swapped, "%.6f", ",", header="Time,gx,gy,gz,ax,ay,az", comments="")
    page = open_page("/check", width=width, height=height, color_scheme=scheme)
    complaints, proof = dropped(page, tmp_path / "log.csv"), page.locator(".proof")
    expect(proof).not_to_contain_text("|a| at rest = 1.00 g")
    page.get_by_text("Columns", exact=True).click()
    for sensor, names in (("Gyroscopes", ("ax", "ay", "az")), ("Accelerometers", ("gx", "gy", "gz"))):
        for axis, name in zip("xyz", names, strict=True):
            page.get_by_label(f"{sensor}, {axis}").select_option(name)
    page.get_by_label("Unit of the gyroscopes").select_option("dps")
    page.get_by_label("Unit of the accelerometers").select_option("?")
    expect(proof).to_have_text("|a| at rest = 1.00 count, rate at rest = 0.01 deg/s.")
    page.get_by_role("button", name="Read the file").click()
    wrong = "unit of the accelerometers: choose the unit of the device"
    expect(page.locator(".bench-main")).to_contain_text(wrong)
    page.get_by_label("Unit of the accelerometers").select_option("m/s2")
    expect(proof).to_have_text(
        re.compile(r"\|a\| at rest = 0\.10 g, .*, but gravity is 1\.00 g\. Check the columns and the unit\.")
    )
    page.get_by_label("Unit of the accelerometers").select_option("g")
    expect(proof).to_have_text("|a| at rest = 1.00 g, rate at rest = 0.01 deg/s.")
    shoot(page, f"check-columns-{width}")
    page.mouse.move(0, 0)
    assert faults_of(page) == []
    page.get_by_role("button", name="Read the file").click()
    expect(page.get_by_role("link", name="Calibrate from it")).to_be_visible()
    expect(page.locator(".found")).to_have_text("100.0 s: 12 rests on 6 faces, 11 turns.")
    assert complaints == []


@pytest.mark.slow
@wide_and_narrow
def test_the_sign_of_a_column_is_chosen_and_its_map_has_it(
    open_page: Callable[..., Page], bench_server: BenchServer, tmp_path: Path, turned: Record, width: int, height: int,
    scheme: str,
) -> None:  # fmt: skip
    opposite = np.asarray(turned.accel) * (-1.0, 1.0, 1.0) / STANDARD_GRAVITY
    table = np.column_stack((turned.time * 1e3, np.asarray(turned.gyro) / RADIAN_PER_DEGREE, opposite))
    np.savetxt(tmp_path / "log.csv", table, "%.6f", ",", header="Time,gx,gy,gz,ax,ay,az", comments="")
    page = open_page("/check", width=width, height=height, color_scheme=scheme)
    complaints = dropped(page, tmp_path / "log.csv")
    page.get_by_label("Unit of the gyroscopes").select_option("dps")
    page.get_by_label("Unit of the accelerometers").select_option("g")
    disagree = page.get_by_text("accelerometer column x is (they read turns about the accelerometer axes +x, -y, -z")
    expect(disagree).to_be_visible()
    page.get_by_text("Columns", exact=True).click()
    page.get_by_label("Sign of accelerometers x").select_option("-")
    expect(disagree).to_be_hidden()
    expect(page.locator(".proof")).to_have_text("|a| at rest = 1.00 g, rate at rest = 0.01 deg/s.")
    page.mouse.move(0, 0)
    shoot(page, f"check-sign-{width}")
    assert faults_of(page) == []
    page.get_by_role("button", name="Read the file").click()
    expect(page.get_by_role("link", name="Calibrate from it")).to_be_visible()
    (path,) = bench_server.folder.glob("uploads/*/map.toml")
    read = read_record(path.with_name("log.csv"), read_map(path))
    assert np.abs(np.asarray(read.in_si().accel) - np.asarray(turned.accel)).max() < 1e-4
    assert complaints == []
