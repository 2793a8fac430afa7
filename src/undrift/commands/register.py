"""What commands share of the registry: where it is, a result that is added to it, a calibration that it knows."""

import shlex
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

from cyclopts import Parameter

from undrift.base.options import Flag, options
from undrift.base.summary import CALLED
from undrift.commands.files import Opening, dates_of
from undrift.errors import InputError, RegistryError

if TYPE_CHECKING:
    from undrift.model import Calibration
    from undrift.registry.registry import Entry, Registry

Where: TypeAlias = Annotated[
    str | None,
    Parameter(
        name="--registry",
        help="File of the registry, or postgresql://user@host/database; UNDRIFT_REGISTRY, else the file of this user, by default.",
    ),
]
ValidMonths: TypeAlias = Annotated[
    int | None,
    Parameter(help="Months after which a calibration is due again; a laboratory agrees on them with its customer."),
]


@options
@dataclass(frozen=True, kw_only=True)
class Registration:
    """Whether the result is added to the registry of devices.

    Parameters
    ----------
    register : bool
        Add the result to the registry of devices, with its serial number.
    """

    register: Flag = False
    registry: Where = None

    def check(self, serial: str | None = None) -> None:
        """Refuse, before any work, a registry that does not open, or a result without a serial number."""
        if not self.register:
            return
        open_place(self.registry).close()
        if serial == "":
            raise InputError(
                "`register`: wanted the serial number of the device, got none; say `serial` S, or state it in the session"
            )

    def add(
        self, *results: "Path | Calibration", source: Path | None = None, valid_months: int | None = None
    ) -> list[dict[str, Any]]:
        """Add files, folders or a calibration that is written to `source`; return what became of them, as JSON has it."""
        if not self.register:
            return []
        from undrift.registry.documents import Stated, new_entries, of_calibration

        stated = Stated(note="by undrift " + shlex.join(CALLED.get()[:1]))
        if valid_months is not None:
            stated = replace(stated, valid_months=valid_months)
        named = str(source.resolve()) if source else "undrift " + shlex.join(CALLED.get())
        models = [of_calibration(one, stated, source=named) for one in results if not isinstance(one, Path)]
        paths = [one for one in results if isinstance(one, Path)]
        try:
            with open_place(self.registry) as held:
                added = held.add(*models, *new_entries(paths, stated, held))
        except RegistryError as error:
            if not paths:
                raise  # nothing has been written yet
            again = shlex.join(("undrift", "registry", "add", *map(str, paths)))
            raise RegistryError(f"{error}; what was made is there, register it later: {again}") from error
        return [entry_json(one.entry) | {"new": one.new} for one in added]


@options
@dataclass(frozen=True, kw_only=True)
class RegistryLookup:
    """A calibration that the registry knows, in place of a file.

    Parameters
    ----------
    serial : str or None
        Serial number of the device, in place of --calibration: the registry's calibration that is valid at the date and the mean
        temperature of the recording.
    date : str or None
        Date of the recordings, as in 2026-03-01; by default of each the date in its name, else of the file's last change.
    """

    serial: str | None = None
    date: str | None = None
    registry: Where = None

    def read(self, given: Path | None, records: tuple[Path, ...], opening: Opening) -> "tuple[Calibration, Path]":
        """Return the calibration of a file, or of the registry, and what messages call it."""
        from undrift.io.store import calibration_of, read_calibration

        if (given is None) == (self.serial is None):
            got = "neither" if given is None else "both"
            raise InputError(f"correct: wanted `calibration` FILE or `serial` S, got {got}; say one of them")
        if given is not None:
            return read_calibration(given), given
        found = [self._of(record, opening) for record in records]
        if len({entry.id for entry in found}) > 1:
            named = ", ".join(f"{record.name}: entry {entry.id}" for record, entry in zip(records, found, strict=True))
            raise RegistryError(
                f"{self.serial}: wanted one calibration for all recordings, got several ({named}); correct them apart"
            )
        name = Path(f"registry entry {found[0].id}")
        return calibration_of(found[0].document, str(name)), name

    def _of(self, record: Path, opening: Opening) -> "Entry":
        from undrift.files import checked_file
        from undrift.io.store import calibration_of
        from undrift.registry.registry import covers

        if not record.is_dir():
            checked_file(record)
        when = dates_of((record,), () if self.date is None else (self.date,))[0][0]
        with open_place(self.registry, there=True) as held:
            serial, temp_c = str(self.serial), None
            for candidate in held.valid(serial, when):
                entry = held.entry(candidate.id)
                model = calibration_of(entry.document, f"registry entry {entry.id}")
                temp_c = mean_temperature(record, opening.like(model, Path(f"registry entry {entry.id}")))
                if temp_c is None or covers(entry, temp_c):
                    return entry
            return held.find(serial, on=when, temp_c=temp_c)  # states what there is


def mean_temperature(record: Path, opening: Opening) -> float | None:
    """Return the mean temperature of a recording, degC; None where it has none."""
    import numpy as np

    total, count = 0.0, 0
    for chunk in opening.chunks(record):
        known = np.empty(0) if chunk.temp_c is None else chunk.temp_c[np.isfinite(chunk.temp_c)]
        total, count = total + float(known.sum()), count + len(known)
    return total / count if count else None


def open_place(place: str | None, *, station: str | None = None, there: bool = False) -> "Registry":
    """Open a registry; with `there` one that is named must exist."""
    from undrift.registry.registry import open_registry

    if there and place is not None and "://" not in place and not Path(place).exists():
        raise RegistryError(f"{place}: wanted a registry, got no file of that name; check the path, or add to it first")
    return open_registry(place, station=station)


def entry_json(entry: "Entry", later: int | None = None) -> dict[str, Any]:
    """Return an entry as JSON has it, without its document."""
    names = ("kind", "sha256", "verdict", "added_by", "station", "source", "supersedes", "note")
    dates = {name: getattr(entry, name) for name in ("made_at", "due_at", "added_at")}
    times = {name: when and when.isoformat(timespec="seconds") for name, when in dates.items()}
    span = None if entry.low_c is None else [entry.low_c, entry.high_c]
    held = {name: getattr(entry, name) for name in names}
    return (
        {"entry": entry.id, "serial": entry.device.serial, "valid_temp_c": span}
        | held
        | times
        | {"superseded_by": later}
    )


def registered_lines(added: list[dict[str, Any]]) -> tuple[str, ...]:
    """Return a line for each entry."""
    lines = []
    for one in added:
        what = f"{one['kind']} of {one['serial']}"
        due = f", due {one['due_at'][:10]}" if one["due_at"] else ""
        number = f"as entry {one['entry']}: {what}"
        lines.append(f"Registered {number}{due}" if one["new"] else f"Already registered {number}")
    return tuple(lines)
