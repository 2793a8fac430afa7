"""What every command does with a result: one JSON object on stdout, or something a person likes to read."""

import json
import math
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, TypeAlias

from cyclopts import Parameter

from undrift.errors import InputError

if TYPE_CHECKING:
    from contextlib import AbstractContextManager

    from rich.console import Console
    from rich.progress import Progress
    from rich.table import Table

    from undrift.io.columns import ColumnMap, ReadSettings
    from undrift.model import Calibration, Verdict
    from undrift.record import Record, Reference

# ---- What a command may be told about a recording that does not say it itself.

Flag: TypeAlias = Annotated[bool, Parameter(show_default=False)]


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Opening:
    """How to read a foreign recording.

    Parameters
    ----------
    column_map : Path or None
        TOML file with columns, units and what else a foreign table needs: the keys of a [[recording]] in session.toml.
        With undrift's own column names only sample_rate_hz, gaps, repair_time or drop_bad_rows, without columns.
    sample_rate_hz : float or None
        Samples per second, for a file without time.
    sensor : str or None
        Which sensor, in a file of several (APDM).
    gaps : str or None
        "keep" takes NaN as a gap, "raise" refuses it; overrules the map. Without either it is refused.
    """

    column_map: Annotated[Path | None, Parameter(name="--map")] = None
    sample_rate_hz: float | None = None
    sensor: str | None = None
    gaps: Literal["raise", "keep"] | None = None

    def columns(self) -> "ColumnMap | None":
        """Return the column map, None where none was named.

        Returns
        -------
        ColumnMap or None
            Read from the file; None too where it names no columns, for a file with undrift's own names.
        """
        from undrift.io.session import read_column_map, read_map_settings

        if self.column_map is None or read_map_settings(self.column_map) is not None:
            return None
        return read_column_map(self.column_map)

    def settings(self) -> "ReadSettings":
        """Return what else the reader is told.

        Returns
        -------
        ReadSettings
            Rate, sensor, gaps, and what a map without columns says; options overrule it.
        """
        from dataclasses import replace

        from undrift.io.columns import ReadSettings
        from undrift.io.session import read_map_settings

        held = (None if self.column_map is None else read_map_settings(self.column_map)) or ReadSettings()
        return replace(
            held,
            sample_rate_hz=self.sample_rate_hz or held.sample_rate_hz,
            sensor=self.sensor,
            gaps=self.gaps or held.gaps,
        )

    def read(self, path: Path) -> "Record":
        """Read a recording; a session folder gives its only recording.

        Parameters
        ----------
        path : Path
            File or folder.

        Returns
        -------
        Record
            The readings.

        Raises
        ------
        InputError
            As the reader says, or a session of several recordings.
        """
        from undrift.errors import InputError
        from undrift.io.formats import detect, read_record
        from undrift.io.session import read_session

        if detect(path) != "session":
            return read_record(path, self.columns(), settings=self.settings())
        records = read_session(path).records
        if len(records) > 1:
            raise InputError(
                f"{path}: wanted one recording, got a session of {len(records)}; name the file of one of them"
            )
        return records[0]


def check_physical(record: "Record", path: Path) -> None:
    """Refuse counts and volts where nothing says what they are worth.

    Parameters
    ----------
    record : Record
        As read, without a calibration.
    path : Path
        Where it was read.

    Raises
    ------
    InputError
        A gyroscope or accelerometer in counts or volts.
    """
    from undrift.errors import InputError
    from undrift.units import is_physical

    held = (("gyro", record.gyro, record.gyro_unit), ("accel", record.accel, record.accel_unit))
    for name, values, unit in held:
        if values is not None and not is_physical(unit):
            raise InputError(
                f"{path}: wanted physical units, or the calibration of the device, got {name} in {unit}; "
                "say --calibration calibration.json"
            )


def calibrated_part(record: "Record", model: "Calibration") -> "tuple[Record, tuple[str, ...]]":
    """Leave out the triad that stays in counts or volts because the calibration has no model of it.

    Parameters
    ----------
    record : Record
        As read.
    model : Calibration
        That it is to be corrected with.

    Returns
    -------
    record : Record
        Unchanged where every triad has a model or a physical unit, or where nothing would be left.
    notes : tuple of str
        What was left out, and why.
    """
    from dataclasses import replace

    from undrift.units import is_physical

    if record.gyro is None or record.accel is None or (model.gyro is None and model.accel is None):
        return record, ()
    if model.accel is None and not is_physical(record.accel_unit):
        return replace(record, accel=None, accel_unit="m/s2"), (_left_out("accelerometers", record.accel_unit),)
    if model.gyro is None and not is_physical(record.gyro_unit):
        return replace(record, gyro=None, gyro_unit="rad/s"), (_left_out("gyroscopes", record.gyro_unit),)
    return record, ()


def _left_out(what: str, unit: str) -> str:
    return (
        f"the {what} are left out of the result: their readings are in {unit}, and the calibration has no model of them"
    )


def check_gravity(record: "Record", path: Path) -> None:
    """Refuse accelerations that cannot be in the unit that is stated: the answer would look like one and be wrong.

    Parameters
    ----------
    record : Record
        Readings of a worn or resting device; counts and volts are passed.
    path : Path
        Where they were read.

    Raises
    ------
    InputError
        A median under half or over twice that of gravity.
    """
    from undrift.errors import InputError
    from undrift.io.inspect import median_accel_g

    median = median_accel_g(record)
    if median < 0.5 or median > 2.0:
        raise InputError(
            f"{path}: wanted a specific force of about 1 g, got a median of {median:.3g} g; check the unit and the scale of the "
            "accelerometer"
        )


# ---- What a command may write to: looked at before the work begins, so that a wrong name costs nothing and loses nothing.


def checked_output(path: Path, *, endings: tuple[str, ...], reads: Iterable[Path | None]) -> Path:
    """Return the path of a file that may be written.

    Parameters
    ----------
    path : Path
        The file to write; it may exist.
    endings : tuple of str
        How its name may end.
    reads : iterable of Path or None
        What the command reads: none of these files, nor a recording in these folders, is written over.

    Returns
    -------
    Path
        The same.

    Raises
    ------
    InputError
        Another ending, a folder of that name, no folder to write into, or a file that is read.
    """
    if not path.name.lower().endswith(endings):
        raise InputError(f"{path}: wanted a name ending in {_either(endings)}, got another; name the format so")
    if path.is_dir():
        raise InputError(f"{path}: wanted the name of a file to write, got a folder; name a file in it")
    if not path.parent.is_dir():
        raise InputError(f"{path}: wanted a folder that exists, got none named {path.parent}; make it first")
    if path.exists() and any(_holds(read, path) for read in reads if read is not None):
        raise InputError(f"{path}: wanted another file to write than those that are read; name another")
    return path


def checked_folder(path: Path) -> Path:
    """Return the path of a folder that may be written to or made.

    Parameters
    ----------
    path : Path
        The folder; the one that holds it must exist.

    Returns
    -------
    Path
        The same.

    Raises
    ------
    InputError
        A file of that name, or nothing that could hold it.
    """
    if path.exists() and not path.is_dir():
        raise InputError(f"{path}: wanted a folder to write to, got a file of that name; name another")
    if not path.exists() and not path.parent.is_dir():
        raise InputError(f"{path}: wanted a folder that exists, got none named {path.parent}; make it first")
    return path


def name_of(path: Path) -> str:
    """Return a recording's name without its endings: walk.v2 of walk.v2.csv.gz.

    Parameters
    ----------
    path : Path
        File or folder.

    Returns
    -------
    str
        To name rows and files by.
    """
    name = path.resolve().name if path.name in ("", "..") else path.name
    for ending in (".gz", ".csv", ".txt", ".log", ".parquet", ".npz", ".mat", ".hdf5", ".h5", ".tsv"):
        if len(name) > len(ending):
            name = name.removesuffix(ending)
    return name


def _holds(read: Path, target: Path) -> bool:
    from undrift.io.session import NAME, read_session

    if not read.is_dir():
        return read.exists() and target.samefile(read)
    if (read / NAME).is_file():
        names = [NAME, *(name for name, _ in read_session(read).inputs)]
    else:
        names = [file.name for file in read.iterdir()]  # of a device that records into a folder
    return any(target.samefile(read / name) for name in names)


def _either(endings: tuple[str, ...]) -> str:
    return endings[0] if len(endings) == 1 else ", ".join(endings[:-1]) + " or " + endings[-1]


# ---- Recordings and their references, read in pairs.


def read_pairs(
    records: tuple[Path, ...],
    reference: tuple[Path, ...],
    labels: tuple[str, ...] | None,
    up: Literal["y", "z"] | None,
    opening: Opening,
    *,
    command: str,
) -> list[tuple["Record", "Reference"]]:
    """Read recordings and the reference of each.

    Parameters
    ----------
    records : tuple of Path
        Recordings.
    reference : tuple of Path
        One for each, in the same order; none where every recording is a BROAD file, which holds its own.
    labels : tuple of str or None
        Markers of one rigid cluster, for C3D and TRC.
    up : str or None
        Laboratory axis that points up, for C3D and TRC.
    opening : Opening
        How to read foreign recordings.
    command : str
        Who asks, for the error.

    Returns
    -------
    list of tuple
        Record and Reference.

    Raises
    ------
    InputError
        Another number of references than recordings, and all that the readers raise.
    """
    from undrift.io.formats import detect

    if not reference and all(detect(record) == "broad" for record in records):
        reference = records
    if len(reference) != len(records):
        raise InputError(
            f"{command}: wanted one reference for each recording, got {len(reference)} for {len(records)}; "
            "say --reference once for each, in the same order"
        )
    return [(opening.read(record), _poses(poses, labels, up)) for record, poses in zip(records, reference, strict=True)]


def _poses(path: Path, labels: tuple[str, ...] | None, up: Literal["y", "z"] | None) -> "Reference":
    """Read a reference; what a file of markers needs is asked for in the words of the command line."""
    from undrift.io.formats import detect, read_markers, read_reference
    from undrift.io.mocap import pose_from_cluster

    if detect(path) not in ("trc", "c3d"):
        return read_reference(path)
    try:
        markers = read_markers(path, up=up)
    except InputError as error:
        if up is not None or error.numbers.get("missing") != "up":
            raise
        raise InputError(
            f"{path}: wanted the axis that points up, got none; say --reference-up y or --reference-up z"
        ) from error
    if labels is None:
        raise InputError(
            f"{path}: wanted the labels of one rigid cluster, got none; say --markers with three or more, commas between, of "
            f"{', '.join(markers.labels)}"
        )
    return pose_from_cluster(markers, labels)


# ---- common

Json: TypeAlias = bool | int | float | str | Sequence["Json"] | Mapping[str, "Json"] | None


def console() -> "Console":
    """Return the console that results are shown on (stdout).

    Returns
    -------
    Console
        As wide as a table needs where stdout is not a terminal.
    """
    from rich.console import Console

    return Console(width=None if sys.stdout.isatty() else 400, highlight=False, soft_wrap=not sys.stdout.isatty())


def progress() -> "Progress":
    """Return a progress display on stderr, with the time left; silent where stderr is not a terminal.

    Returns
    -------
    Progress
        To be used as a context.
    """
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    stderr = Console(stderr=True)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeRemainingColumn(),
    )
    return Progress(*columns, console=stderr, transient=True, disable=not stderr.is_terminal)


def table(title: str, *columns: str) -> "Table":
    """Return an empty table whose columns after the first are right-aligned.

    Parameters
    ----------
    title : str
        Heading.
    *columns : str
        Column heads; a unit in brackets goes on a line of its own. Where space is short the first column folds.

    Returns
    -------
    Table
        Ready for rows.
    """
    from rich import box
    from rich.table import Table

    made = Table(title=title, box=box.SIMPLE_HEAD, title_justify="left", pad_edge=False)
    for k, column in enumerate(columns):
        head = column.replace(" (", "\n(")
        made.add_column(head, justify="right" if k else "left", no_wrap=k > 0, overflow="fold")
    return made


def write_json(value: object) -> None:
    """Write one JSON object to stdout.

    Parameters
    ----------
    value : object
        Mappings, sequences, numbers, arrays; NaN is written as null.
    """
    sys.stdout.write(json.dumps(plain(value), ensure_ascii=False, allow_nan=False) + "\n")


def plain(value: object) -> Json:
    """Return a value made of what JSON knows.

    Parameters
    ----------
    value : object
        Mappings, sequences, numbers, arrays, strings, None.

    Returns
    -------
    Json
        The same, with arrays as lists and NaN or infinity as None.
    """
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if hasattr(value, "tolist"):  # arrays and numbers of numpy
        return plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, str | int):
        return value
    if isinstance(value, Sequence | set | frozenset):
        return [plain(item) for item in value]
    return str(value)


def waiting(what: str) -> "AbstractContextManager[object]":
    """Return a context that shows on a terminal's stderr that something is being worked on.

    Parameters
    ----------
    what : str
        What is being done.

    Returns
    -------
    context manager
        Silent where stderr is not a terminal.
    """
    from contextlib import nullcontext

    from rich.console import Console

    stderr = Console(stderr=True)
    return stderr.status(what) if stderr.is_terminal else nullcontext()


def show_verdict(verdict: "Verdict") -> None:
    """Show a verdict and its reasons, one a line.

    Parameters
    ----------
    verdict : Verdict
        What a fit is worth.
    """
    colour = {"good": "green", "marginal": "yellow", "bad": "red"}[verdict.status]
    out = console()
    out.print(f"[bold {colour}]verdict: {verdict.status}[/bold {colour}]")
    for reason in verdict.reasons:
        out.print(f"  - {reason}", markup=False)
