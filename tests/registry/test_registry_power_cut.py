"""What a power cut leaves of a registry: at each fsync, with what was not brought to the disk lost, empty, zeros or torn."""

from collections import Counter

import pytest

from testkit.data import show
from testkit.disk import cuts, logged
from undrift.registry.registry import open_registry

ADD = """
from datetime import UTC, datetime
from testkit.disk import mark
from undrift.registry.registry import NewEntry, open_registry

for k in range(3):
    with open_registry({place!r}) as registry:
        registry.add(NewEntry(kind="run", serial="A17", document={{"k": k}}, made_at=datetime(2026, 3, 1 + k, tzinfo=UTC)))
        mark(k)
"""


@pytest.mark.slow
def test_an_entry_that_was_reported_survives_a_power_cut_and_others_are_there_or_not(tmp_path):
    folder = tmp_path / "disk"
    folder.mkdir()
    logged(ADD.format(place=str(folder / "r.sqlite")), folder, tmp_path / "log")
    counted = Counter()
    for number, cut in enumerate(cuts(tmp_path / "log", folder)):
        path = tmp_path / str(number)
        for name, content in cut.files.items():
            if not name.endswith("-shm"):  # shared memory, made anew
                (path / name).parent.mkdir(parents=True, exist_ok=True)
                (path / name).write_bytes(content)
        path.mkdir(exist_ok=True)
        with open_registry(str(path / "r.sqlite")) as registry:
            kept = [
                entry.document["k"]
                for entry in map(registry.entry, sorted(entry.id for entry, _ in registry.entries()))
            ]
        counted["cuts"] += 1
        counted[f"{len(kept)} entries"] += 1
        assert kept == [*range(len(kept))]
        assert len(kept) >= len(cut.marks), cut
    show("power cuts of a registry", counted)
    assert {f"{k} entries" for k in range(4)} < {*counted}
