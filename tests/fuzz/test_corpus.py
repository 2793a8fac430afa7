"""Inputs that once ended otherwise than in one clear line, and a short run over fresh ones."""

import gzip
import random
import tomllib
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fuzz.inputs import BAD, damaged, outcome, seeds
from fuzz.oracle import judge
from testkit.data import data_path

CORPUS = tomllib.loads((Path(__file__).parent / "corpus.toml").read_text())["fault"]
SEEDS = {seed.name: seed for seed in seeds()}
FAST = (  # of each kind of file one that reads in milliseconds
    "example_ferraris_session.csv", "imuData01.csv", "dec_int.c3d", "markers.trc.gz", "gnactv_sample.bin", "skin_data_xsens.txt",
    "NilsPodX-6F13_20210109_162824.bin", "sensors.csv", "Pelvis_20210820_202113_836.csv", "agread_gt9x_example-IMU.csv.gz",
)  # fmt: skip


def faulty(content, fault):
    """Return the content with a fault of the corpus; text is replaced in what a packed file holds."""
    if content[:2] == b"\x1f\x8b":
        return gzip.compress(faulty(gzip.decompress(content), fault))
    held = bytearray(content)
    for at, value in fault.get("set", ()):
        held[at] = value
    if "old" in fault:
        old = fault["old"].encode()
        assert old in held
        held = held.replace(old, fault["new"].encode("latin-1"), 1)
    return bytes(held)


@pytest.mark.parametrize("fault", CORPUS, ids=lambda fault: fault["why"])
def test_a_past_failure_is_refused_or_read(fault, tmp_path):
    data_path(".")
    seed = SEEDS[fault["input"]]
    found = outcome(seed, faulty(seed.content, fault), tmp_path)
    assert found.kind not in BAD, found.text


@pytest.mark.parametrize("seed", [seed for seed in SEEDS.values() if seed.simulated], ids=lambda seed: seed.name)
def test_a_damaged_input_is_refused_or_read(seed, tmp_path):
    assert outcome(seed, seed.content, tmp_path / "sound").kind in ("read", "equal")
    for number in range(4):
        content = damaged(seed.content, random.Random(f"{number} {seed.name}"))
        found = outcome(seed, content, tmp_path / str(number))
        assert found.kind not in BAD, found.text


@pytest.mark.slow
def test_what_is_read_of_damaged_recordings_is_theirs_or_said_otherwise(tmp_path):
    data_path(".")
    counted: Counter[str] = Counter()
    for name in (*FAST, "r.csv", "r.parquet", "r.txt"):
        for number in range(12):
            content = damaged(SEEDS[name].content, random.Random(f"oracle {number} {name}"))
            found = outcome(SEEDS[name], content, tmp_path / f"{number}-{name}", commands=False)
            assert found.kind not in BAD, f"{number} {name}: {found.text}"
            counted[found.kind] += 1
    assert min(counted[kind] for kind in ("equal", "refused", "finding", "own value")) > 0, counted


@pytest.mark.parametrize(
    ("fault", "kind"),
    [
        (lambda lines: lines, "equal"),
        (lambda lines: [*lines[:50], *lines[60:]], "finding"),  # a gap in time
        (lambda lines: [*lines[:50], lines[50][::-1], *lines[51:]], "refused"),
        (lambda lines: [*lines[:50], b"0.49,1,2,3,4,5,6,25", *lines[51:]], "own value"),
        (lambda lines: [lines[0].replace(b"dps", b"rad_s"), *lines[1:]], "header value"),
        (lambda lines: lines[:90], "own value"),  # cut at the end of a line
    ],
)
def test_the_oracle_names_what_became_of_a_table(tmp_path, fault, kind):
    seed = SEEDS["r.csv"]
    content = b"\n".join(fault(seed.content.rstrip(b"\n").split(b"\n"))) + b"\n"
    assert outcome(seed, content, tmp_path, commands=False).kind == kind


@pytest.mark.parametrize(
    "change",
    [
        lambda r: replace(r, values=r.values[:-1]),
        lambda r: replace(r, values=r.values[:, [0, 2, 1, *range(3, r.values.shape[1])]]),
        lambda r: replace(r, units=(("time", "s"), ("gyro", "rad/s"), *r.units[2:])),
        lambda r: replace(r, values=r.values * 1.01),
        lambda r: replace(r, values=np.roll(r.values, 1, axis=0)),
    ],
)
def test_the_oracle_knows_what_a_reader_must_not_do(change):
    sound = SEEDS["r.csv"].sound
    touched = sound.content.replace(b"\n0.5,", b"\n0.500001,")
    assert judge(sound, touched, change(sound.reading))[0] == "SILENT"
