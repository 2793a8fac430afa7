"""Files and jobs of a bench: listed again by the next bench, by their names; deleted whole; a quota; one bench a folder."""

import asyncio
import json
import os
import subprocess
import sys

import pytest

pytest.importorskip("nicegui")

from undrift.commands.bench.library import ABOUT, Library, Remark, came_words, lock_folder
from undrift.errors import InputError
from undrift.web.bench import Bench, ServerSettings
from undrift.web.commands import CommandOutcome


def stored(library, name, came_s, content="x"):
    """Put a file into a folder of its own, as an upload does."""
    path = library.folder / "uploads" / f"{came_s:x}" / name
    path.parent.mkdir(parents=True)
    path.write_text(content)
    os.utime(path, (came_s, came_s))
    return path


@pytest.fixture
def library(tmp_path):
    return Library(tmp_path / "bench", 20.0)


def test_what_is_known_of_a_file_is_known_to_the_next_bench(library):
    one = library.file_at(stored(library, "walk.csv", 1000))
    one.about, one.sample_rate_hz, one.mounting = {"kind": "recording", "summary": "60 samples"}, 100.0, "Lower back"
    one.map, one.made = one.folder / "map.toml", {"correct: report": one.folder / "validation" / "report.html"}
    one.remarks = {"info": [Remark(level="warn", text="short", action="record longer")]}
    one.save()
    library.rename(one, "  Ann's\n walk ")
    (again,) = Library(library.folder, 20.0).files
    assert again == one
    assert (again.name, again.options()) == ("Ann's walk", ("--map", one.map, "--sample-rate-hz", 100.0))
    library.rename(one, "")
    assert Library(library.folder, 20.0).files[0].name == "walk.csv"


def test_files_and_jobs_that_nobody_described_are_listed_the_newest_first_and_halves_are_deleted(library):
    stored(library, "old.csv", 1000)
    stored(library, "new.csv", 3000)
    damaged = stored(library, "between.csv", 2000).parent / ABOUT
    damaged.write_text('{"path": "gone.csv", "made": {}, "remarks": {}}')
    half = stored(library, "sent.part", 4000)
    walk = stored(library, "Gyroscope.csv", 5000).parent / "walk"
    walk.mkdir()
    (walk.parent / "Gyroscope.csv").rename(walk / "Gyroscope.csv")  # files of a phone, in a folder
    os.utime(walk, (5000, 5000))
    for name in ("2026-01-01-000000-A", "2026-02-01-000000-B"):
        (library.folder / "jobs" / name).mkdir()
    again = Library(library.folder, 20.0)
    assert [one.name for one in again.files] == ["walk", "new.csv", "between.csv", "old.csv"]
    assert not half.parent.exists()
    assert [one.name for one in again.jobs] == ["2026-02-01-000000-B", "2026-01-01-000000-A"]
    assert [one.summary for one in again.jobs] == ["no readings"] * 2
    assert came_words(again.files[1]).endswith("1e-06 MB")


def test_a_folder_that_is_full_is_refused_in_one_line(library):
    library.file_at(stored(library, "walk.csv", 1000, "x" * 1500))
    small = Library(library.folder, 2e-6)
    small.check_room()
    with pytest.raises(
        InputError, match=r"wanted at most 2e-06 GB in it, got .*e-06 GB; delete files or jobs"
    ) as refused:
        small.check_room(1000.0)
    assert "\n" not in str(refused.value)


def test_what_is_deleted_is_gone_from_the_disk_and_from_every_tab(tmp_path):
    bench = Bench(ServerSettings(folder=tmp_path / "bench"))
    one = bench.library.file_at(stored(bench.library, "calibration.json", 1000))
    job, (first, second) = bench.new_job("A17"), (bench.visit("one"), bench.visit("two"))
    first.calibration = second.calibration = one.path
    first.recordings.chosen, second.shown = one, job
    bench.working.append(object())
    with pytest.raises(InputError, match=r"calibration.json: wanted to delete it at rest, got work that goes on"):
        bench.delete(one)
    bench.working.clear()
    bench.delete(one)
    bench.delete(job)
    assert not one.folder.exists()
    assert not job.folder.exists()
    assert (first.calibration, second.calibration, first.recordings.chosen, second.shown, bench.job) == (None,) * 5
    assert (bench.library.files, bench.library.jobs) == ([], [])
    bench.close()


def test_what_a_tab_chooses_and_types_is_its_own_and_is_there_when_it_comes_back(tmp_path):
    bench = Bench(ServerSettings(folder=tmp_path / "bench"))
    first, second = bench.visit("one"), bench.visit("two")
    answers = {"kind": "calibration", "summary": "a calibration"}

    async def command(*words, folder=None):
        return CommandOutcome(code=0, answer=answers)

    bench.command = command
    first.rates.turn_rate_max_dps, first.recordings.form.worn = "120", "shank"
    asyncio.run(second.recordings.add(stored(bench.library, "other.json", 1000)))
    assert second.calibration == second.recordings.chosen.path
    assert (first.calibration, first.recordings.chosen) == (None, None)
    assert (second.rates.turn_rate_max_dps, second.recordings.form.worn) == ("90", "")
    assert bench.visit("one") is first
    assert [one.name for one in first.library.files] == ["other.json"]
    bench.close()


@pytest.mark.slow
def test_a_folder_has_one_bench_and_the_second_is_shown_the_first(tmp_path):
    lock = lock_folder(tmp_path)
    lock.write("http://127.0.0.1:8765/")
    lock.flush()
    held = [sys.executable, "-m", "undrift", "bench", "--port", "0", "--no-browser", "--folder", str(tmp_path)]
    refused = subprocess.run([*held, "--json"], capture_output=True, text=True, check=False)
    assert refused.returncode == 2
    text = json.loads(refused.stdout)["error"]["text"]
    assert text.startswith("bench: wanted ")
    assert text.endswith("in use by the bench at http://127.0.0.1:8765/; open that, or name another folder")
    lock.close()
    lock_folder(tmp_path).close()


def test_a_device_that_another_version_described_is_listed_with_what_is_understood(tmp_path):
    place = tmp_path / "devices" / "one"
    place.mkdir(parents=True)
    (place / ".bench.json").write_text('{"title": "imu3", "serial": 7, "colour": "red"}')
    (device,) = Library(tmp_path, 1.0).devices
    assert (device.name, device.serial) == ("imu3", "")
