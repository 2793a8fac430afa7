"""The calibration for a command: a named file, or the newest file in a folder for the recording's device.

A laboratory keeps the calibrations of its devices in a folder with subfolders. The serial number in a recording selects
the files of its device. The date in each calibration selects the newest file.
"""

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from undrift.commands.files import Opening
from undrift.errors import InputError
from undrift.files import checked_file
from undrift.io.formats import detect
from undrift.io.inspect import needs_map
from undrift.io.session import read_session
from undrift.io.store import KIND, read_calibration
from undrift.model import Calibration

NO_DATE = datetime.min.replace(tzinfo=UTC)


@dataclass(frozen=True, slots=True, kw_only=True)
class ChosenCalibration:
    """A calibration and its file."""

    path: Path | None = None
    model: Calibration | None = None  # None if no calibration was named
    notes: tuple[str, ...] = ()  # which file was taken from a folder


def choose_calibration(source: Path | None, recordings: Sequence[Path], opening: Opening) -> ChosenCalibration:
    """Return the calibration in a file, or the newest calibration in a folder with the recordings' serial number."""
    if source is None:
        return ChosenCalibration()
    if not source.is_dir():
        return ChosenCalibration(path=source, model=read_calibration(source))
    serials = {serial_of(path, opening) for path in recordings}
    if len(serials) > 1:
        raise InputError(
            f"{source}: the recordings are of several devices ({', '.join(sorted(serials))}), and one calibration is "
            "applied to all of them. Run the command once for each device."
        )
    (serial,) = serials
    models = {path: read_calibration(path) for path in calibration_files(source)}
    dates = {path: _created(model) for path, model in models.items() if model.device == serial}
    if not dates:
        serials_there = sorted({model.device or "without serial number" for model in models.values()})
        raise InputError(
            f"{source}: no calibration of {serial} in this folder. It contains {', '.join(serials_there) or 'no calibration'}. "
            "Name the file."
        )
    newest = [path for path, date in dates.items() if date == max(dates.values())]
    if len(newest) > 1:
        names = ", ".join(str(path.relative_to(source)) for path in newest)
        raise InputError(
            f"{source}: several newest calibrations of {serial} have the same date: {names}. Name one of these files."
        )
    path = newest[0]
    origin = "without a date" if dates[path] == NO_DATE else f"of {dates[path]:%Y-%m-%d}"
    note = f"The calibration is {path} {origin}, the newest of {len(dates)} of {serial}."
    return ChosenCalibration(path=path, model=models[path], notes=(note,))


def calibration_files(folder: Path) -> Iterator[Path]:
    """Yield the calibrations of a folder and its subfolders. An unreadable JSON file raises an error."""
    for path in sorted(folder.rglob("*.json")):
        try:
            content = json.loads(path.read_bytes())
        except ValueError as error:
            raise InputError(
                f"{path}: this file is not JSON, so its age cannot be checked. Repair or remove it."
            ) from error
        if isinstance(content, dict) and content.get("kind") == KIND:
            yield path


def serial_of(recording: Path, opening: Opening) -> str:
    """Return the serial number of a recording or session. Raise an error if it has none."""
    if not recording.is_dir():
        checked_file(recording)
    if detect(recording) == "session":
        serial = read_session(recording).serial
    elif opening.column_map is None and needs_map(recording):
        serial = ""  # a table of other columns: only a map could name its device
    else:
        serial = next(iter(opening.chunks(recording))).device
    if not serial:
        raise InputError(
            f"{recording}: the recording does not state the serial number of its device, so no calibration can be selected from a "
            "folder. Name the file with `calibration`."
        )
    return serial


def _created(model: Calibration) -> datetime:
    try:
        date = datetime.fromisoformat(model.provenance.created)
    except ValueError:
        return NO_DATE
    return date if date.tzinfo else date.replace(tzinfo=UTC)
