"""What is kept of a file: what it states, and what a person states beside it; everything else is refused in a line."""

import hashlib
import shutil
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

import undrift
from testkit.full_calibration import device as calibrated
from testkit.full_calibration import tables
from testkit.plain_triad import plain_triad
from undrift.base.summary import months_after
from undrift.errors import InputError, RegistryError
from undrift.io.store import calibration_json, content_hash, write_calibration
from undrift.model import Provenance
from undrift.registry.documents import (
    Stated,
    candidates,
    new_entries,
    of_calibration,
    pdf_of,
    valid_temperatures,
)
from undrift.registry.registry import open_registry
from undrift.report.certificate import write_certificate

SAMPLE = Path(undrift.__file__).parent / "sample" / "bench"
MADE = Provenance(created="2026-01-31T10:00:00+02:00")


@pytest.fixture
def held(tmp_path):
    with open_registry(str(tmp_path / "registry.sqlite")) as made:
        yield made


@pytest.fixture
def model():
    gyro = plain_triad("dps", "rad/s", offset_sigma=0.1)
    return replace(calibrated(), device="A17", provenance=MADE, gyro=gyro, accel=None)


def test_a_calibration_is_kept_whole_and_is_due_the_months_after_it_was_made(held, model, tmp_path):
    write_calibration(model, tmp_path / "c.json")
    (entry,) = new_entries([tmp_path / "c.json"], Stated(), held)
    assert (entry.kind, entry.serial, entry.verdict) == ("calibration", "A17", model.verdict.status)
    assert entry.document == calibration_json(model)
    assert (entry.made_at, entry.due_at) == (datetime(2026, 1, 31, 8, tzinfo=UTC), datetime(2027, 1, 31, 8, tzinfo=UTC))
    assert entry.source == str(tmp_path / "c.json")
    at = model.reference_temp_c
    assert entry.temp_c == (at - 5.0, at + 5.0)
    stated = Stated(valid_months=1, temp_c=(0.0, 50.0), made_at=datetime(2024, 1, 31, tzinfo=UTC), note="n")
    (other,) = new_entries([tmp_path / "c.json"], stated, held)
    assert (other.temp_c, other.due_at, other.note) == ((0.0, 50.0), datetime(2024, 2, 29, tzinfo=UTC), "n")


@pytest.mark.parametrize(
    ("when", "months", "due"),
    [("2026-12-31", 2, "2027-02-28"), ("2026-01-15", 12, "2027-01-15"), ("2024-02-29", 12, "2025-02-28")],
)
def test_months_end_where_a_shorter_month_ends(when, months, due):
    assert months_after(datetime.fromisoformat(when), months) == datetime.fromisoformat(due)


def test_tables_are_valid_where_they_are_and_an_unknown_temperature_is_none(model):
    assert valid_temperatures(replace(model, drift=tables())) == (18.0, 75.0)
    assert valid_temperatures(replace(model, reference_temp_c=np.nan)) is None


def test_a_certificate_takes_what_it_states_from_its_calibration_and_keeps_its_bytes(held, model, tmp_path):
    write_calibration(model, tmp_path / "c.json")
    write_certificate(model, tmp_path / "c.pdf")
    with pytest.raises(
        RegistryError, match=f"in the registry, got none with content hash {content_hash(model)[:12]}; add both"
    ):
        new_entries([tmp_path / "c.pdf"], Stated(), held)
    both = new_entries([tmp_path / "c.pdf", tmp_path / "c.json"], Stated(), held)
    assert [one.kind for one in both] == ["calibration", "certificate"]
    known, entry = both
    assert (entry.serial, entry.made_at, entry.due_at, entry.temp_c) == (
        "A17",
        known.made_at,
        known.due_at,
        known.temp_c,
    )
    content = (tmp_path / "c.pdf").read_bytes()
    assert pdf_of(entry.document) == content
    assert entry.document["file_sha256"] == hashlib.sha256(content).hexdigest()
    held.add(known)
    (later,) = new_entries([tmp_path / "c.pdf"], Stated(), held)  # from the registry now
    assert later == entry


def test_of_recordings_names_hashes_and_what_they_hold_are_kept(held, tmp_path):
    session = undrift.simulate_session(
        "six_face", undrift.random_device(np.random.default_rng(7)), rng=np.random.default_rng(3)
    )
    undrift.write_session(session, tmp_path / "made")
    (entry,) = new_entries([tmp_path / "made"], Stated(), held)
    assert (entry.kind, entry.serial) == ("session", session.serial)
    digests = {item["file"]: item["sha256"] for item in entry.document["files"]}
    files = [path for path in (tmp_path / "made").rglob("*") if path.is_file()]
    assert digests == {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in files}
    (record,) = session.records
    assert (entry.document["recordings"], entry.document["samples"]) == (1, len(record))
    assert entry.document["duration_s"] == pytest.approx(record.time[-1] - record.time[0])
    assert entry.temp_c == (pytest.approx(record.temp_c.min()), pytest.approx(record.temp_c.max()))
    assert (entry.due_at, entry.verdict) == (None, None)
    shutil.copytree(tmp_path / "made", tmp_path / "copy")
    (tmp_path / "copy" / "journal.jsonl").touch()  # of a run
    (run,) = new_entries([tmp_path / "copy" / "session.toml"], Stated(), held)
    assert (run.kind, run.document) == ("run", entry.document)  # wherever it lies


def test_a_folder_gives_what_it_holds_for_the_registry_and_nothing_else(model, tmp_path):
    write_calibration(model, tmp_path / "c.json")
    (tmp_path / "deep" / ".hidden").mkdir(parents=True)
    write_calibration(model, tmp_path / "deep" / ".hidden" / "c.json")
    write_certificate(model, tmp_path / "deep" / "c.pdf")
    shutil.copytree(SAMPLE, tmp_path / "deep" / "bench")
    (tmp_path / "summary.json").write_text('{"calibration": {"kind": "undrift.calibration"}}')
    (tmp_path / "empty.json").touch()
    (tmp_path / "other.pdf").write_bytes(b"%PDF-1.7 a letter")
    assert {str(path.relative_to(tmp_path)) for path in candidates(tmp_path)} == {"c.json", "deep/c.pdf", "deep/bench"}


@pytest.mark.parametrize(
    ("change", "stated", "text"),
    [
        ({"device": ""}, {}, "wanted the serial number of the device, got none; say `serial` S"),
        ({}, {"serial": "B2"}, "wanted device B2, got A17 in the file; leave out `serial`, or name another file"),
        ({"device": "A\n17"}, {}, "wanted a serial number of 1 to 200 printable characters, got 4; correct it"),
        ({"provenance": Provenance()}, {}, "wanted the date at which the calibration was made, got ''; say `date` 2026-03-01"),
    ],
)  # fmt: skip
def test_a_calibration_without_serial_or_date_is_refused(model, change, stated, text):
    with pytest.raises(InputError) as told:
        of_calibration(replace(model, **change), Stated(**stated), source="c.json")
    assert str(told.value) == f"c.json: {text}"


def test_a_correction_may_state_another_serial(model):
    assert of_calibration(model, Stated(serial="B2", supersedes=1, note="wrong device"), source="c.json").serial == "B2"


@pytest.mark.parametrize(
    ("content", "text"),
    [
        (
            b"time,gx\n0,1\n",
            "wanted a calibration.json, a certificate, or the folder of a session or run, got another file",
        ),
        (b'{"kind": "other"}', "wanted kind 'undrift.calibration', got 'other'"),
        (b'{"kind": "undrift.calibration", "format": 9}', "wanted format 1, got 9"),
        (
            b"%PDF-1.7 a letter",
            "wanted a certificate of this version of undrift, got another PDF; write it: undrift certificate",
        ),
        (b"", "wanted a recording, got an empty file"),
    ],
)
def test_other_files_are_refused(held, tmp_path, content, text):
    (tmp_path / "file").write_bytes(content)
    with pytest.raises(InputError, match=text):
        new_entries([tmp_path / "file"], Stated(), held)


def test_a_pdf_too_large_for_a_certificate_is_refused(held, tmp_path):
    with (tmp_path / "file").open("wb") as file:
        file.write(b"%PDF-")
        file.truncate(20 * 10**6 + 1)
    with pytest.raises(InputError, match="wanted a certificate of at most 20 MB, got a larger file; name another"):
        new_entries([tmp_path / "file"], Stated(), held)
