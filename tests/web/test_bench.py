"""The bench without a browser: files, results that survive a kill, place, refusals."""

import asyncio
import html
import json
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("nicegui")

import undrift
from undrift.base.spoken import CALLED
from undrift.commands.certificate import Statement
from undrift.commands.files import Place
from undrift.errors import InputError
from undrift.findings import finding
from undrift.io.parquet import write_parquet
from undrift.report import Report
from undrift.screen import progress
from undrift.units import gravity_at
from undrift.web.bench import Bench, ServerSettings
from undrift.web.items import Item, lock_folder


@pytest.fixture(scope="module")
def record():
    """Six faces and turns of a device, in counts."""
    rng = np.random.default_rng(7)
    (made,) = undrift.simulate_session("ferraris", undrift.random_device(rng), rng=rng, labelled=False).records
    return made


@pytest.fixture
def bench(tmp_path):
    made = Bench(ServerSettings(folder=tmp_path / "bench"))
    yield made
    made.close()


def sent(bench, name, write):
    """Return a file as an upload stores it."""
    place = bench.folder / "uploads" / name.partition(".")[0]
    place.mkdir(parents=True)
    write(place / name)
    return place / name


@pytest.mark.parametrize(
    "place", [Place(latitude_deg=91.0, height_m=0.0), Place(gravity_m_s2=981.0), Place(gravity_m_s2=9.81, height_m=0.0)]
)
def test_a_place_that_is_none_is_refused(bench, place):
    with pytest.raises(InputError):
        bench.set_place(place)


def test_a_recording_is_calibrated_certified_and_corrected_and_another_bench_shows_all_of_it(bench, record):
    path = sent(bench, "faces.parquet", lambda path: write_parquet(record, path))

    async def work():
        await bench.add([path])
        (item,) = bench.items
        assert (item.kind, item.serial) == ("recording", record.device or "faces")
        item.turn_deg = 360.0
        bench.set_place(Place(latitude_deg=59.9, height_m=20.0))
        await bench.calibrate(item)
        await bench.certify(item, Statement(laboratory="Lab of room 2"))
        bench.typed["format"] = ".parquet"
        await bench.correct(item)

    asyncio.run(work())
    other = Bench(bench.settings)
    (item,) = other.items
    assert item.page("orient") is None
    assert item.files("correct") == [item.folder / "faces-corrected.parquet"]
    assert other.calibration == item.folder / "calibration.json"
    made = json.loads(other.calibration.read_text())
    assert made["gravity_m_s2"] == pytest.approx(gravity_at(59.9, 20.0), abs=1e-3)
    assert f"Verdict: {made['verdict']['status']}" in item.page("calibrate").read_text()
    assert "Lab of room 2" in (item.folder / "certificate.html").read_text()
    assert undrift.read_record(item.folder / "faces-corrected.parquet").gyro_unit == "rad/s"
    pages = [(item.folder / name).read_text() for name in ("info.html", "calibrate.html", "correct.html")]
    assert [page for page in pages if str(bench.folder) in page] == []


def test_files_of_a_phone_sent_together_are_one_recording_and_others_are_two(bench, record):
    def axes(kind, unit):
        return ",".join(['"Time (s)"', *(f'"{kind} {x} ({unit})"' for x in "xyz")]) + "\n"

    rows = "".join(f"{k / 50},0,0,9.8\n" for k in range(60))
    phone = [
        sent(bench, "Gyroscope.csv", lambda path: path.write_text(axes("Gyroscope", "rad/s") + rows)),
        sent(bench, "Accelerometer.csv", lambda path: path.write_text(axes("Acceleration", "m/s^2") + rows)),
    ]
    asyncio.run(bench.add(phone))
    assert [(item.kind, item.path.name) for item in bench.items] == [("recording", "files")]
    two = [sent(bench, name, lambda path: write_parquet(record, path)) for name in ("a.parquet", "b.parquet")]
    asyncio.run(bench.add(two))
    assert [item.path.name for item in bench.items] == ["b.parquet", "a.parquet", "files"]
    assert len(Bench(bench.settings).items) == 3


def test_what_cannot_be_read_stays_in_the_list_with_one_line(bench):
    path = sent(bench, "noise.parquet", lambda path: path.write_bytes(bytes(range(256)) * 40))
    asyncio.run(bench.add([path]))
    assert "binary data of an unknown kind" in bench.items[0].summary
    assert str(bench.folder) not in bench.items[0].summary


def test_a_table_without_units_is_refused_until_they_are_chosen(bench, record):
    table = np.column_stack((record.time * 1e3, record.gyro, record.accel))
    path = sent(
        bench,
        "log.csv",
        lambda path: np.savetxt(path, table, "%.6f", ",", header="Time,gx,gy,gz,ax,ay,az", comments=""),
    )
    asyncio.run(bench.add([path]))
    (item,) = bench.items
    assert item.draft["columns"]["gyro"] == ["gx", "gy", "gz"]
    item.draft["units"] |= {"gyro": "?", "accel": "count"}
    with pytest.raises(InputError, match="unit of gyro"):
        asyncio.run(bench.read_again(item))
    item.draft["units"]["gyro"] = "count"
    asyncio.run(bench.read_again(item))
    assert item.kind == "recording"
    assert "still phases" in item.page("info").read_text()
    assert Bench(bench.settings).items[0].opening.column_map == item.folder / "map.toml"


def test_a_calibration_that_is_dropped_is_used(bench, record):
    rng = np.random.default_rng(7)
    made = undrift.calibrate(undrift.simulate_session("six_face", undrift.random_device(rng), rng=rng))
    path = sent(bench, "device.json", lambda path: undrift.write_calibration(replace(made, device="A17"), path))
    asyncio.run(bench.add([path]))
    assert bench.calibration == path
    assert bench.items[0].serial == "A17"
    assert "Verdict" in bench.items[0].page("info").read_text()


def test_texts_have_the_words_of_the_page_and_no_options_or_folders(bench):
    text = f"{bench.folder}/uploads/a1/walk.csv: add `sample_rate_hz` in `old`.csv."
    assert bench.plain(text) == "walk.csv: add the samples per second in `old`.csv."
    item = Item(folder=bench.folder, path=bench.folder / "walk.csv")
    advice = finding(
        "orient.rest", "warn", "The offset is not known.", "Use `offset` rest, or the filter (`method` vqf)."
    )
    token = CALLED.set(("bench",))
    bench._keep(item, "orient", Report(title="t", answer="a", findings=[advice], notes=["Give `gravity_m_s2`."]))
    CALLED.reset(token)
    page = html.unescape(item.page("orient").read_text())
    assert 'Use "Gyroscope offset to subtract": rest, or the filter (command line: --method vqf).' in page
    assert "Give the gravity of the place." in page


@pytest.mark.parametrize("name", ["../secret", "/etc/passwd", "uploads", "a\0b", "x" * 5000, "nothing.csv"])
def test_only_files_of_the_bench_are_served(bench, name):
    (bench.folder.parent / "secret").write_text("x")
    with pytest.raises(InputError, match="only files that the bench wrote"):
        bench.inside(name)


def test_a_cancelled_command_ends_at_its_next_progress(bench):
    def work():
        progress("reading", 0.2)
        assert bench.work.text == "Correct: reading, 0 s"
        bench.work.cancelled = True
        progress("writing", 0.5)

    with pytest.raises(InputError, match="cancelled"):
        asyncio.run(bench.call("Correct", work))
    assert bench.work is None


def test_a_folder_has_one_bench_and_the_second_is_shown_the_first(tmp_path):
    with lock_folder(tmp_path) as lock:
        lock.write("http://127.0.0.1:8765/")
        lock.flush()
        with pytest.raises(InputError, match=r"in use by the bench at http://127\.0\.0\.1:8765/"):
            lock_folder(tmp_path)
    lock_folder(tmp_path).close()
