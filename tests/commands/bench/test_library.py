"""Files and jobs of a bench: listed again by the next bench; one bench a folder."""

import json
import os
import subprocess
import sys

import pytest

from undrift.commands.bench.library import ABOUT, Library, Remark, came_words, lock_folder


def stored(library, name, came_s, content="x"):
    """Put a file into a folder of its own, as an upload does."""
    path = library.folder / "uploads" / f"{came_s:x}" / name
    path.parent.mkdir(parents=True)
    path.write_text(content)
    os.utime(path, (came_s, came_s))
    return path


@pytest.fixture
def library(tmp_path):
    return Library(tmp_path / "bench")


def test_what_is_known_of_a_file_is_known_to_the_next_bench(library):
    one = library.file_at(stored(library, "walk.csv", 1000))
    one.about, one.sample_rate_hz, one.mounting = {"kind": "recording", "summary": "60 samples"}, 100.0, "Lower back"
    one.map, one.made = one.folder / "map.toml", {"correct: report": one.folder / "validation" / "report.html"}
    one.remarks = {"info": [Remark(level="warn", text="short", action="record longer")]}
    one.save()
    (again,) = Library(library.folder).files
    assert again == one
    assert (again.name, again.options()) == ("walk.csv", ("--map", one.map, "--sample-rate-hz", 100.0))


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
    again = Library(library.folder)
    assert [one.name for one in again.files] == ["walk", "new.csv", "between.csv", "old.csv"]
    assert not half.parent.exists()
    assert [one.name for one in again.jobs] == ["2026-02-01-000000-B", "2026-01-01-000000-A"]
    assert [one.summary for one in again.jobs] == ["no readings"] * 2
    assert came_words(again.files[1]).startswith("1970-01-01")


@pytest.mark.slow
def test_a_folder_has_one_bench_and_the_second_is_shown_the_first(tmp_path):
    lock = lock_folder(tmp_path)
    lock.write("http://127.0.0.1:8765/")
    lock.flush()
    held = [sys.executable, "-m", "undrift", "bench", "--port", "0", "--no-browser", "--folder", str(tmp_path)]
    refused = subprocess.run([*held, "--json"], capture_output=True, text=True, check=False)
    assert refused.returncode == 2
    text = json.loads(refused.stdout)["error"]["text"]
    assert text.startswith("bench: ")
    assert text.endswith("in use by the bench at http://127.0.0.1:8765/. Open that bench, or choose another folder.")
    lock.close()
    lock_folder(tmp_path).close()
