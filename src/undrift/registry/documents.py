"""What the registry keeps of a file or folder: a calibration whole, a certificate with its bytes, of recordings what they were.

A session or run is kept as the names and hashes of its files with what they hold; its readings stay where they are. A certificate
names the calibration it states by a content hash, and takes serial number, dates and temperatures from it.
"""

import base64
import re
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from undrift.base.summary import months_after
from undrift.correction.correct import REFERENCE_SPAN_C
from undrift.errors import InputError, RegistryError
from undrift.files import read_bytes, sha256_of
from undrift.io.session import NAME, read_session
from undrift.io.store import KIND, calibration_json, hash_of, read_calibration
from undrift.model import Calibration
from undrift.record import Record, check_serial
from undrift.registry.registry import NewEntry, Registry

JOURNAL = "journal.jsonl"  # of a run folder
LARGEST_PDF = 20 * 10**6  # bytes
_IS_KIND = re.compile(rb'\s*{\s*"kind"\s*:\s*"%s"' % KIND.encode())  # of a file as undrift writes it
_STATES = re.compile(rb"calibration sha256 ([0-9a-f]{64})")


@dataclass(frozen=True, slots=True, kw_only=True)
class Stated:
    """What a person states of the files to add; None where the file itself is to say."""

    serial: str | None = None
    valid_months: int = 12  # of a calibration
    temp_c: tuple[float, float] | None = None  # where a calibration is valid, degC
    made_at: datetime | None = None
    supersedes: int | None = None
    note: str = ""


def new_entries(paths: list[Path], stated: Stated, registry: Registry) -> list[NewEntry]:
    """Return the entries of files and folders, calibrations before their certificates."""
    made: dict[str, NewEntry] = {}
    for path in sorted(paths, key=_is_pdf):
        one = _new_entry(path, stated, made, registry)
        made[hash_of(one.document)] = one
    return list(made.values())


def _new_entry(path: Path, stated: Stated, made: dict[str, NewEntry], registry: Registry) -> NewEntry:
    if path.is_dir() or path.name == NAME:
        return _of_session(path if path.is_dir() else path.parent, stated)
    if _is_pdf(path):
        return _of_certificate(path, stated, made, registry)
    head = read_bytes(path, 1 << 10)
    if not head.lstrip().startswith(b"{"):
        raise InputError(
            f"{path}: wanted a calibration.json, a certificate, or the folder of a session or run, got another file; name one"
        )
    return of_calibration(read_calibration(path), stated, source=str(path.resolve()))


def of_calibration(model: Calibration, stated: Stated, *, source: str) -> NewEntry:
    """Return the entry of a calibration; it is due some months after it was made."""
    made_at = stated.made_at or _time_of(model.provenance.created, source)
    return NewEntry(
        kind="calibration",
        serial=_serial(model.device, stated, source),
        document=calibration_json(model),
        made_at=made_at,
        due_at=months_after(made_at, stated.valid_months),
        temp_c=stated.temp_c or valid_temperatures(model),
        verdict=model.verdict.status,
        source=source,
        supersedes=stated.supersedes,
        note=stated.note,
    )


def valid_temperatures(model: Calibration) -> tuple[float, float] | None:
    """Return where a calibration is valid, degC: its table of offsets, else near its reference temperature; None if not known."""
    static = None if model.drift is None else model.drift.static
    if static is not None:
        return float(static.temp_c[0]), float(static.temp_c[-1])
    at = model.reference_temp_c
    return None if np.isnan(at) else (at - REFERENCE_SPAN_C, at + REFERENCE_SPAN_C)


def _of_certificate(path: Path, stated: Stated, made: dict[str, NewEntry], registry: Registry) -> NewEntry:
    if path.stat().st_size > LARGEST_PDF:
        raise InputError(
            f"{path}: wanted a certificate of at most {LARGEST_PDF // 10**6} MB, got a larger file; name another"
        )
    content = read_bytes(path)
    found = _STATES.search(content)
    if found is None:
        raise InputError(
            f"{path}: wanted a certificate of this version of undrift, got another PDF; write it: undrift certificate"
        )
    digest = found[1].decode()
    known = made.get(digest) or registry.calibration_with(digest)
    if known is None:
        raise RegistryError(
            f"{path}: wanted the calibration that it states in the registry, got none with content hash {digest[:12]}; add both: "
            "undrift registry add calibration.json certificate.pdf"
        )
    document = {
        "calibration_sha256": digest,
        "file_sha256": sha256_of(path),
        "pdf_base64": base64.b64encode(content).decode(),
    }
    return NewEntry(
        kind="certificate",
        serial=_serial(known.serial, stated, str(path)),
        document=document,
        made_at=stated.made_at or known.made_at,
        due_at=known.due_at,
        temp_c=known.temp_c,
        verdict=known.verdict,
        source=str(path.resolve()),
        supersedes=stated.supersedes,
        note=stated.note,
    )


def _of_session(folder: Path, stated: Stated) -> NewEntry:
    held = read_session(folder)
    files = [{"file": name, "sha256": digest} for name, digest in held.inputs]
    document: dict[str, Any] = {
        "session": held.kind,
        "serial": held.serial,
        "gravity_m_s2": held.gravity_m_s2,
        "recordings": len(held.records),
        "samples": sum(len(record) for record in held.records),
        "duration_s": float(sum(record.time[-1] - record.time[0] for record in held.records if len(record))),
        "files": files,
    }
    changed = max((folder / name).stat().st_mtime for name, _ in held.inputs if (folder / name).exists())
    return NewEntry(
        kind="run" if (folder / JOURNAL).is_file() else "session",
        serial=_serial(held.serial, stated, str(folder)),
        document=document,
        made_at=stated.made_at or datetime.fromtimestamp(changed, UTC),
        temp_c=stated.temp_c or _temperatures(held.records),
        source=str(folder.resolve()),
        supersedes=stated.supersedes,
        note=stated.note,
    )


def _temperatures(records: tuple[Record, ...]) -> tuple[float, float] | None:
    parts = [record.temp_c[np.isfinite(record.temp_c)] for record in records if record.temp_c is not None]
    known = np.concatenate(parts) if parts else np.empty(0)
    return (float(known.min()), float(known.max())) if len(known) else None


def pdf_of(document: dict[str, Any]) -> bytes:
    """Return the file of a certificate."""
    return base64.b64decode(document["pdf_base64"])


def candidates(folder: Path) -> Iterator[Path]:
    """Yield what a folder holds for the registry: sessions, runs, calibrations, certificates; hidden names are left out."""
    if (folder / NAME).is_file():
        yield folder
    for path in sorted(folder.iterdir()):
        if path.name.startswith(".") or path.is_symlink():
            continue
        if path.is_dir():
            yield from candidates(path)
        elif _is_calibration(path) or (_is_pdf(path) and _STATES.search(path.read_bytes())):
            yield path


def _is_calibration(path: Path) -> bool:
    return path.suffix == ".json" and path.stat().st_size > 0 and _IS_KIND.match(read_bytes(path, 1 << 10)) is not None


def _is_pdf(path: Path) -> bool:
    try:
        with path.open("rb") as file:
            return file.read(5) == b"%PDF-"
    except OSError:
        return False


def _serial(of_file: str, stated: Stated, source: str) -> str:
    """Return the serial number that a file states, or else a person; refuse two."""
    if not of_file and not stated.serial:
        raise InputError(f"{source}: wanted the serial number of the device, got none; say `serial` S")
    # a correction may state another, which is what it corrects
    if of_file and stated.serial and of_file != stated.serial and stated.supersedes is None:
        raise InputError(
            f"{source}: wanted device {stated.serial}, got {of_file} in the file; leave out `serial`, or name another file"
        )
    serial = (stated.serial or of_file).strip()
    check_serial(serial, source, least=1)
    return serial


def _time_of(created: str, source: str) -> datetime:
    try:
        when = datetime.fromisoformat(created)
    except ValueError:
        raise InputError(
            f"{source}: wanted the date at which the calibration was made, got '{created}'; say `date` 2026-03-01"
        ) from None
    return when if when.tzinfo else when.replace(tzinfo=UTC)
