"""Inputs that once ended otherwise than in one clear line, and a short run over fresh ones."""

import gzip
import random
import tomllib
from pathlib import Path

import pytest

from fuzz.inputs import BAD, damaged, outcome, seeds
from testkit.data import data_path

CORPUS = tomllib.loads((Path(__file__).parent / "corpus.toml").read_text())["fault"]
SEEDS = {seed.name: seed for seed in seeds()}


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
    assert outcome(seed, seed.content, tmp_path / "sound").kind == "read"
    for number in range(4):
        content = damaged(seed.content, random.Random(f"{number} {seed.name}"))
        found = outcome(seed, content, tmp_path / str(number))
        assert found.kind not in BAD, found.text
