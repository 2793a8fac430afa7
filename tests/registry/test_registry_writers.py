"""Four stations write at once and lose nothing; a writer that is killed loses at most the entry it had open."""

import sqlite3
import subprocess
import sys
import time

import pytest

from testkit.data import show
from undrift.registry.registry import open_registry

WRITER = """
import sys, time
from datetime import UTC, datetime
from pathlib import Path
from undrift.registry.registry import NewEntry, open_registry

place, name, count, go = sys.argv[1], sys.argv[2], int(sys.argv[3]), Path(sys.argv[4])
with open_registry(place, station=name) as registry:
    print("ready", flush=True)
    while not go.exists():
        time.sleep(0.005)
    for k in range(count):
        document = {"writer": name, "number": k, "covariance": [[0.1 * i * j for i in range(12)] for j in range(12)]}
        made = datetime(2026, 3, 1, tzinfo=UTC)
        (added,) = registry.add(NewEntry(kind="calibration", serial=f"{name}-{k % 7}", document=document, made_at=made))
        print(added.entry.id, flush=True)
"""
STATIONS = 4


def start(place, name, count, go):
    words = [sys.executable, "-c", WRITER, place, name, str(count), str(go)]
    return subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@pytest.mark.slow
@pytest.mark.parametrize("each", [100, 1000])
def test_four_stations_at_once_lose_nothing(place, tmp_path, each):
    go = tmp_path / "go"
    writers = [
        start(place, f"station{k}", each, go) for k in range(STATIONS)
    ]  # each finds no tables, or those of another
    assert [writer.stdout.readline() for writer in writers] == ["ready\n"] * STATIONS
    began = time.monotonic()
    go.touch()
    told = [writer.communicate(timeout=120) for writer in writers]
    seconds = time.monotonic() - began
    assert [err for _, err in told] == [""] * STATIONS
    assert [writer.returncode for writer in writers] == [0] * STATIONS
    reported = [int(line) for out, _ in told for line in out.split()]
    with open_registry(place) as registry:
        held = [entry for entry, _ in registry.entries()]
        devices = registry.devices()
    show(place.partition(":")[0][-20:], f"{len(held)} entries in {seconds:.1f} s, {len(held) / seconds:.0f} a second")
    assert len(held) == len({entry.sha256 for entry in held}) == STATIONS * each
    assert {entry.id for entry in held} == set(reported)
    assert len(reported) == len(set(reported)) == STATIONS * each
    for k in range(STATIONS):
        assert sum(entry.station == f"station{k}" for entry in held) == each
    assert len(devices) == 7 * STATIONS


def test_a_killed_writer_loses_at_most_its_open_entry(place, tmp_path):
    go = tmp_path / "go"
    victim, other = start(place, "victim", 100_000, go), start(place, "other", 100, go)
    assert victim.stdout.readline() == other.stdout.readline() == "ready\n"
    go.touch()
    lines = [victim.stdout.readline() for _ in range(50)]
    victim.kill()  # kill -9
    lines += victim.stdout.readlines()  # of the same reader: it holds lines that came together with those above
    victim.communicate(timeout=60)
    assert victim.returncode != 0
    out, err = other.communicate(timeout=60)
    assert (other.returncode, err, len(out.split())) == (0, "", 100)
    reported = {int(line) for line in lines if line.endswith("\n")}  # the last line may be cut off
    with open_registry(place) as registry:
        present = {entry.id: entry.station for entry, _ in registry.entries()}
        documents = [registry.entry(number).document["number"] for number, name in present.items() if name == "victim"]
    assert reported <= {number for number, name in present.items() if name == "victim"}
    assert len(documents) - len(reported) in (0, 1)
    assert sorted(documents) == list(range(len(documents)))  # without a hole
    assert sum(name == "other" for name in present.values()) == 100
    show("reported before the kill, present", (len(reported), len(documents)))
    if "://" not in place:
        with sqlite3.connect(place) as file:
            assert file.execute("PRAGMA integrity_check").fetchone() == ("ok",)
