"""The page Check: the trace of a recording zooms, columns and units prove themselves, a stretch is left out, the device turns."""

import json
import re
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from urllib.error import HTTPError
from urllib.request import Request, urlopen

import numpy as np
import pytest
from playwright.sync_api import Page, expect

import undrift
from testkit.bench import BenchServer, bench_process
from undrift.io.formats import read_record
from undrift.io.parquet import write_parquet
from undrift.io.session import read_map
from undrift.model import Calibration
from undrift.record import Record
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY
from web_browser.conftest import faults_of, shoot, state_serial, step, wide_and_narrow

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
    page.locator(".panel-plot canvas").first.wait_for()
    return complaints


def chosen(page: Page) -> list[float]:
    """Drag over three to five tenths of the trace; return the ends of the stretch, s."""
    over = page.locator(".u-over").first
    over.scroll_into_view_if_needed()
    box = over.bounding_box()
    assert box is not None
    at = [box["x"] + share * box["width"] for share in (0.3, 0.5)]
    page.mouse.move(at[0], box["y"] + 40)
    page.mouse.down()
    page.mouse.move(at[1], box["y"] + 40, steps=5)
    page.mouse.up()
    return [float(page.get_by_label(name).input_value()) for name in ("Stretch from, s", "to, s")]


def rests_used(folder: Path, count: int) -> str:
    """Wait for so many calibrations; return how many rests the last one used."""
    last = time.monotonic() + COMMAND_MS / 1000.0
    while len(made := list(folder.glob("jobs/*/calibration.json"))) < count and time.monotonic() < last:
        time.sleep(0.1)
    newest = max(made, key=lambda path: path.stat().st_mtime)
    return str(json.loads(newest.read_text())["provenance"]["settings"]["stills"])


@pytest.mark.slow
@wide_and_narrow
def test_a_stretch_is_zoomed_to_and_left_out_of_what_is_calibrated(
    open_page: Callable[..., Page], bench_server: BenchServer, tmp_path: Path, turned: Record, width: int, height: int,
    scheme: str,
) -> None:  # fmt: skip
    write_parquet(turned, tmp_path / "turns.parquet")
    page = open_page("/check", width=width, height=height, color_scheme=scheme)
    complaints, state = dropped(page, tmp_path / "turns.parquet"), page.locator(".panel-state")
    expect(state).to_have_text("0.00 to 99.99 s. 12 rests on 6 faces, 11 turns")
    expect(page.locator(".proof")).to_have_text("|a| at rest = 1.00 g, rate at rest = 0.01 deg/s.")
    start, stop = chosen(page)
    assert (start, stop) == (pytest.approx(30.0, abs=1.0), pytest.approx(50.0, abs=1.0))
    with page.expect_response(re.compile("/trace/")) as response:
        page.get_by_role("button", name="Zoom to it").click()
    expect(state).to_have_text(f"{start:.2f} to {stop:.2f} s. 12 rests on 6 faces, 11 turns")
    rows = int.from_bytes(response.value.body()[12:16], "little")
    assert 100 < rows <= width  # a pixel has no more than a row, of the stretch alone
    shoot(page, f"check-zoomed-{width}")
    page.get_by_role("button", name="Leave it out").click()
    expect(page.get_by_text(f"Left out: {start:.2f} to {stop:.2f} s.")).to_be_visible()
    expect(state).to_have_text("0.00 to 99.99 s. 10 rests on 5 faces, 8 turns")
    page.mouse.move(0, 0)
    shoot(page, f"check-left-out-{width}")
    assert faults_of(page) == []
    step(page, "Calibrate")
    state_serial(page)
    for rests, again in (("10", False), ("12", True)):
        if again:
            step(page, "Check")
            page.get_by_role("button", name="Use all again").click()
            expect(state).to_have_text("0.00 to 99.99 s. 12 rests on 6 faces, 11 turns")
            step(page, "Calibrate")
        page.get_by_role("button", name="Calibrate", exact=True).click()
        assert rests_used(bench_server.folder, 1 + again) == f"{rests} found"
    assert complaints == []


@pytest.mark.slow
def test_a_finger_drags_a_stretch_sideways_and_scrolls_the_page_up_and_down(
    open_page: Callable[..., Page], tmp_path: Path, turned: Record
) -> None:
    write_parquet(turned, tmp_path / "turns.parquet")
    page = open_page("/check", width=390, height=844, has_touch=True, is_mobile=True)
    complaints, over = dropped(page, tmp_path / "turns.parquet"), page.locator(".u-over").first
    over.scroll_into_view_if_needed()
    touches = page.context.new_cdp_session(page)

    def drag(*shares: tuple[float, float]) -> None:
        box = over.bounding_box()
        assert box is not None
        (x0, y0), (x1, y1) = ((box["x"] + x * box["width"], box["y"] + y * box["height"]) for x, y in shares)
        for k in range(11):
            at = {"x": x0 + 0.1 * k * (x1 - x0), "y": y0 + 0.1 * k * (y1 - y0)}
            kind = "touchStart" if k == 0 else "touchMove"
            touches.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": [at]})
        touches.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})

    ends = [page.get_by_label(name) for name in ("Stretch from, s", "to, s")]
    drag((0.3, 0.4), (0.5, 0.4))
    expect(ends[1]).not_to_have_value("")
    start, stop = (float(end.input_value()) for end in ends)
    assert (start, stop) == (pytest.approx(30.0, abs=1.0), pytest.approx(50.0, abs=1.0))
    shoot(page, "check-touched-390")
    before = page.evaluate("scrollY")
    drag((0.7, 0.9), (0.71, 0.1))
    page.wait_for_function("before => scrollY > before + 30", arg=before)
    assert [float(end.input_value()) for end in ends] == [start, stop]
    page.get_by_role("button", name="Leave it out").tap()
    expect(page.get_by_text(f"Left out: {start:.2f} to {stop:.2f} s.")).to_be_visible()
    assert complaints == []


@pytest.mark.slow
def test_the_device_turns_as_the_recording_says(open_page: Callable[..., Page], tmp_path: Path, turned: Record) -> None:
    write_parquet(turned, tmp_path / "turns.parquet")
    page = open_page("/check", width=1280, height=800)
    complaints, words = dropped(page, tmp_path / "turns.parquet"), page.locator(".panel-device .soft").first
    expect(words).to_have_text("Device with +x up, 0 deg off")
    drawing = page.locator(".panel-device svg").first.inner_html()
    page.get_by_role("button", name="Play").click()
    expect(words).to_have_text(re.compile("[+-][yz] up"))
    assert page.locator(".panel-device svg").first.inner_html() != drawing
    page.get_by_role("button", name="Stop").click()
    for seconds, face in ((19.0, "+y"), (35.0, "+z"), (43.0, "-z")):  # the rests of the recording
        point_at(page, seconds)
        expect(words).to_have_text(re.compile(re.escape(f"Device with {face} up, 0 deg")))
    assert complaints == []


def point_at(page: Page, seconds: float) -> None:
    """Point at a time of the whole trace."""
    box = page.locator(".u-over").first.bounding_box()
    assert box is not None
    page.locator(".u-over").first.hover(position={"x": seconds / 99.99 * box["width"], "y": 30})


@wide_and_narrow
def test_counts_turn_too_and_what_is_left_out_shows_nothing(
    open_page: Callable[..., Page], tmp_path: Path, calibrated: tuple[Record, Calibration], width: int, height: int,
    scheme: str,
) -> None:  # fmt: skip
    write_parquet(calibrated[0], tmp_path / "counts.parquet")
    page = open_page("/check", width=width, height=height, color_scheme=scheme)
    complaints, lies = dropped(page, tmp_path / "counts.parquet"), page.locator(".panel-device .soft").first
    rough = "The readings have no physical unit: gravity gives the drawing their scale, so it is rough."
    expect(page.get_by_text(rough)).to_be_visible()
    for seconds, face in ((3.0, "+x"), (19.0, "+y"), (35.0, "+z"), (43.0, "-z")):  # the rests of the recording
        point_at(page, seconds)
        expect(lies).to_have_text(re.compile(re.escape(f"Device with {face} up, ") + "[012] deg off"))
    assert chosen(page) == [pytest.approx(30.0, abs=1.0), pytest.approx(50.0, abs=1.0)]
    page.get_by_role("button", name="Leave it out").click()
    expect(page.get_by_text("Nothing is drawn in a gap; its heading begins anew after one.")).to_be_visible()
    expect(page.locator(".panel-state")).to_have_text("0.00 to 99.99 s. 10 rests on 5 faces, 8 turns")
    for seconds, face in ((19.0, "+y"), (40.0, ""), (61.0, "+x")):
        point_at(page, seconds)
        if face:
            expect(lies).to_be_visible()
            expect(lies).to_have_text(re.compile(re.escape(f"Device with {face} up, ") + "[012] deg off"))
        else:
            expect(lies).to_be_hidden()
    shoot(page, f"check-counts-{width}")
    page.mouse.move(0, 0)
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
    wrong = "unit of the accelerometers: wanted that of the device, got none; choose it"
    expect(page.locator(".bench-main")).to_contain_text(wrong)
    page.get_by_label("Unit of the accelerometers").select_option("m/s2")
    expect(proof).to_have_text(
        re.compile(r"\|a\| at rest = 0\.10 g, .*; gravity is 1.00 g: look at columns and unit\.")
    )
    page.get_by_label("Unit of the accelerometers").select_option("g")
    expect(proof).to_have_text("|a| at rest = 1.00 g, rate at rest = 0.01 deg/s.")
    shoot(page, f"check-columns-{width}")
    page.mouse.move(0, 0)
    assert faults_of(page) == []
    page.get_by_role("button", name="Read the file").click()
    expect(page.get_by_role("link", name="Calibrate from it")).to_be_visible()
    expect(page.locator(".panel-state")).to_contain_text("12 rests on 6 faces, 11 turns")
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
    complaints, lies = dropped(page, tmp_path / "log.csv"), page.locator(".panel-device .soft").first
    page.get_by_label("Unit of the gyroscopes").select_option("dps")
    page.get_by_label("Unit of the accelerometers").select_option("g")
    disagree = page.get_by_text("accelerometer column x is (they read turns about +x, -y, -z")
    expect(disagree).to_be_visible()
    expect(lies).to_have_text("Device with -x up, 0 deg off")
    page.get_by_text("Columns", exact=True).click()
    page.get_by_label("Sign of accelerometers x").select_option("-")
    expect(disagree).to_be_hidden()
    expect(lies).to_have_text("Device with +x up, 0 deg off")
    expect(page.locator(".proof")).to_have_text("|a| at rest = 1.00 g, rate at rest = 0.01 deg/s.")
    page.mouse.move(0, 0)
    shoot(page, f"check-sign-{width}")
    assert faults_of(page) == []
    page.get_by_role("button", name="Read the file").click()
    expect(page.get_by_role("link", name="Calibrate from it")).to_be_visible()
    (path,) = bench_server.folder.glob("uploads/*/map.toml")
    read = read_record(path.with_name("log.csv"), read_map(path)[0])
    assert np.abs(np.asarray(read.in_si().accel) - np.asarray(turned.accel)).max() < 1e-4
    assert complaints == []


def test_a_trace_is_for_whoever_has_the_token_and_no_other_file_is_one(tmp_path: Path) -> None:
    token = "0123456789abcdef"
    with bench_process(tmp_path / "bench", "--token", token) as server:
        place = server.folder / "uploads" / "x"
        place.mkdir(parents=True)
        np.save(
            place / "trace.npy",
            np.zeros(4, dtype=[("time", "f8"), ("gyro", "f4", 3), ("accel", "f4", 3), ("q_nb", "f4", 4)]),
        )
        np.save(place / "objects.npy", np.array([{}], dtype=object))  # is not unpickled
        (place / "map.toml").write_text("gaps = 1")
        cookie = {"Cookie": f"undrift_token_{server.port}={token}"}

        def answered(name: str, headers: dict[str, str]) -> tuple[int, bytes]:
            url = f"http://127.0.0.1:{server.port}/trace/uploads/x/{name}?start=0&stop=9&rows=9"
            try:
                with urlopen(Request(url, headers=headers)) as answer:
                    return answer.status, answer.read()
            except HTTPError as error:
                with error:
                    return error.code, error.read()

        assert answered("trace.npy", {})[0] == 403
        code, body = answered("trace.npy", cookie)
        assert (code, body[:4]) == (200, b"UDF1")
        wrong = b"trace: wanted readings of a file, got others; choose a recording\n"
        for name in ("objects.npy", "map.toml", "none.npy", "..%2F..%2F..%2Fother.npy"):
            assert answered(name, cookie) == (404, wrong)
