"""Recordings to try: the sample of the package, and public sets by address and checksum; ``UNDRIFT_DATA`` names a local copy."""

import os
import shutil
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from importlib.resources import as_file, files
from pathlib import Path
from urllib.parse import quote

from undrift.errors import InputError
from undrift.files import hidden_folder, no_folder

SAMPLE = "sample"
REGISTRY = Path(__file__).with_suffix(".toml")


@dataclass(frozen=True, slots=True, kw_only=True)
class PublicSet:
    """One set of recordings."""

    name: str
    what: str  # For what it is good
    licence: str
    address: str  # As published; empty for the sample
    base: str = ""  # What stands before each path
    bytes: int = 0  # Of all files; 0 where it is not known
    files: tuple[tuple[str, str], ...] = ()  # Path and sha256; none where it is not fetched
    why_not: str = ""  # Why it is not fetched


def public_sets() -> tuple[PublicSet, ...]:
    """Return the sample, then the public sets."""
    with as_file(files("undrift").joinpath(SAMPLE)) as folder:
        size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    sample = PublicSet(
        name=SAMPLE,
        what="Six faces, rate table, set-points, a rest, a sit-to-stand with optics; simulated, comes with the package",
        licence="MIT",
        address="",
        bytes=size,
    )
    listed = tomllib.loads(REGISTRY.read_text(encoding="utf-8"))["set"]
    made = (one | {"files": tuple((f["path"], f["sha256"]) for f in one.get("files", ()))} for one in listed)
    return (sample, *(PublicSet(**one) for one in made))


def local_copy(name: str) -> Path | None:
    """Return the folder of a set in ``UNDRIFT_DATA``; None where it is not there."""
    held = os.environ.get("UNDRIFT_DATA")
    folder = None if not held else Path(held) / name
    return folder if folder is not None and folder.is_dir() else None


def fetch(name: str, folder: Path) -> str:
    """Copy or download a set into a new folder, all of it or nothing; return where it came from."""
    known = {one.name: one for one in public_sets()}
    if name not in known:
        raise InputError(f"data: wanted one of {', '.join(known)}, got {name!r}; see undrift data list")
    if folder.exists():
        raise InputError(f"{folder}: wanted a folder that does not exist yet, got one that does; name another")
    if not folder.parent.is_dir():
        raise InputError(f"{folder}: wanted a folder that exists, got none named {folder.parent}; make it first")
    chosen, local = known[name], local_copy(name)
    if name == SAMPLE:
        with as_file(files("undrift").joinpath(SAMPLE)) as source:
            _whole(folder, lambda part: _copied(source, part))
        return "the package"
    if local is not None:
        _whole(folder, lambda part: _copied(local, part))
        return str(local)
    if not chosen.files:
        raise InputError(
            f"data {name}: wanted a set with checksums, got none: {chosen.why_not}; download it from {chosen.address}, "
            "or let UNDRIFT_DATA name a folder that holds it"
        )
    _whole(folder, lambda part: _downloaded(chosen, part))
    return chosen.address


def _whole(folder: Path, fill: Callable[[Path], None]) -> None:
    """Fill a hidden neighbour that then takes the folder's name; nothing stays where it fails, or is killed."""
    try:
        with hidden_folder(folder.parent) as held:
            part = held / folder.name
            part.mkdir()
            fill(part)
            part.rename(folder)
    except OSError as error:
        raise no_folder(folder, error) from error


def _copied(source: Path, part: Path) -> None:
    for path in sorted(source.rglob("*")):
        target = part / path.relative_to(source)
        if path.is_dir():
            target.mkdir(parents=True, exist_ok=True)
        elif path.suffix != ".pyc":
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, target)


def _downloaded(chosen: PublicSet, part: Path) -> None:
    import pooch
    from requests import RequestException

    pooch.get_logger().setLevel("ERROR")
    for path, digest in chosen.files:
        address = chosen.base + quote(path)
        try:
            pooch.retrieve(address, known_hash=f"sha256:{digest}", fname=Path(path).name, path=part)
        except RequestException as error:
            status = getattr(error.response, "status_code", None)
            got = "no connection" if status is None else f"status {status}"
            raise InputError(
                f"data {chosen.name}: wanted {address}, got {got}; connect to the network, or let UNDRIFT_DATA name a local copy"
            ) from error
        except ValueError as error:  # the checksum
            raise InputError(
                f"data {chosen.name}: wanted {address} with sha256 {digest[:12]}..., got other bytes; they changed, do not use them"
            ) from error
