"""Apply a command to each recording of a folder, with a table of the results at the end.

If a file fails, its row contains the error and the other files continue. An error in a shared file, such as the
calibration, ends the call. Subfolders are included, and outputs are written to subfolders of the same names. The output
folder contains ``summary.json``, updated after each file, and at the end ``summary.csv``, ``summary.parquet`` and
``summary.html``. A second call processes only missing rows. A row remains valid while its recording, the values and
files of the options and the version are unchanged, and its output exists.
"""

import csv
import hashlib
import io
import json
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass, field, fields, is_dataclass
from functools import wraps
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, TypeAlias

from undrift import __version__
from undrift.base.summary import Result, Section, Summary, at, plain
from undrift.commands import Progress, part_of, silent
from undrift.commands.files import Opening, check_folder, files_in, is_recording, name_of, origin_of, save_json
from undrift.errors import InputError, UndriftError
from undrift.findings import Verdict

if TYPE_CHECKING:
    from undrift.record import Record

HEADS = {"name": "file", "verdict": "verdict", "sample_rate_hz": "rate (Hz)", "gaps": "gaps"}
ENDS = ("csv", "parquet", "html", "json")  # of the table
FOLDER = {"kind": "folder", "format": "folder", "gaps": 0} | dict.fromkeys(
    ("rows", "sample_rate_hz", "duration_s", "temp_c")
)
Row: TypeAlias = dict[str, Any]
EMPTY: Row = dict.fromkeys(("name", "kind", "summary", "verdict", "worst_finding", "error", "key"), "") | dict.fromkeys(
    ("sample_rate_hz", "gaps", "output")
)


@dataclass(frozen=True, kw_only=True)
class CountedOpening(Opening):
    """Settings for reading a recording, with the number of files read."""

    seen: Row = field(default_factory=dict)

    def record(self, path: Path) -> "Record":
        """Read one file."""
        return self._saw(super().record(path))

    def chunks(self, path: Path) -> "Iterator[Record]":
        """Read one file in chunks."""
        yield from map(self._saw, super().chunks(path))

    def _saw(self, record: "Record") -> "Record":
        from undrift.io.inspect import gaps_of

        if self.seen.get("until_s", -float("inf")) < record.time[0]:  # not read before
            self.seen.setdefault("sample_rate_hz", record.sample_rate_hz)
            self.seen["gaps"] = self.seen.get("gaps", 0) + gaps_of(record)
            self.seen["until_s"] = float(record.time[-1])
        return record


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class FolderTable(Result):
    """The results of a command for each file of a folder."""

    command: str
    folder: Path
    rows: tuple[Row, ...]
    standing: int  # Rows of an earlier call
    output: Path | None
    others: tuple[str, ...]  # entries that are not recordings

    def summary(self) -> Summary:
        """Return the table: a row per file, with the worst finding of each."""
        errors = [row["error"] for row in self.rows if row["error"]]
        kinds = sorted(Counter(row["kind"] for row in self.rows).items())
        answer = f"{len(self.rows)} entries: " + ", ".join(f"{number} {kind}" for kind, number in kinds)
        before = f" ({self.standing} of them before)" if self.standing else ""
        done = f"{len(self.rows) - len(errors)} of {len(self.rows)} done{before}, {len(errors)} with an error"
        info = self.command == "info"
        texts = [(row["error"] or row["worst_finding"]).partition(", for example")[0] for row in self.rows]
        texts_shown = (text or info * row["summary"] for text, row in zip(texts, self.rows, strict=True))
        lines = [f"{row['name']}: {text}" for row, text in zip(self.rows, texts_shown, strict=True) if text]
        lines += [f"no recordings: {', '.join(self.others)}"] if self.others else []
        cells = tuple(tuple(_cell(row[key]) for key in HEADS) for row in self.rows)
        listed = [{key: value for key, value in row.items() if key != "key"} for row in self.rows]
        data: Row = FOLDER | {"columns": [], "units": {}, "stills": [], "findings": []} if info else {}
        data |= {"folder": str(self.folder), "summary": answer, "problems": errors, "standing": self.standing}
        return Summary(
            title=f"{self.command}: {self.folder.resolve().name}",
            answer=f"{self.folder}: folder, {answer if info else done}",
            data=data | {"files": listed, "output": self.output and str(self.output)},
            sections=(
                Section(title="Files", columns=tuple(HEADS.values()), rows=cells, text=tuple(lines), on="terminal"),
                Section(
                    title="Files",
                    columns=(*HEADS.values(), "worst finding, or error"),
                    rows=tuple((*row, text) for row, text in zip(cells, texts, strict=True)),
                    words=True,
                    on="page",
                ),
            ),
            written=() if self.output is None else tuple(self.output / f"summary.{end}" for end in ENDS),
            failed=not info and any(row["verdict"] in ("bad", "error") for row in self.rows),
        )


def of_folder(ending: str | None, *, alone: tuple[str, ...] = ()) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Let a command accept a folder of recordings instead of a recording. Outputs are NAME and the ending. With None,
    nothing is written.

    ``alone`` names options that apply to a single recording only.
    """

    def of(function: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(function)
        def called(*given: Any, **stated: Any) -> Any:
            if len(given) != 1 or not is_plain_folder(given[0]):
                return function(*given, **stated)
            values = (SimpleNamespace(**stated), *stated.values())
            if names := [name for name in alone if any(getattr(value, name, None) for value in values)]:
                raise InputError(
                    f"`{names[0]}`: expected a recording or a session, got the folder {given[0]}. Name the files in it."
                )
            output, progress = stated.pop("output", None), stated.pop("progress", silent)
            job = _Job(function=function, ending=ending, stated=stated, output=output)
            return job.run(given[0], progress)

        return called

    return of


def is_plain_folder(path: Path) -> bool:
    """Return True if a folder is neither a session nor a recording."""
    from undrift.io.formats import detect

    with suppress(InputError):
        return path.is_dir() and not detect(path)
    return path.is_dir()


def _entries(folder: Path, output: Path | None) -> Iterator[Path]:
    """Yield the entries of a folder and its subfolders, except hidden entries, outputs of such a call, and links that
    lead back.
    """
    tables = {f"summary.{ending}" for ending in ENDS} if _has_table(folder) else set()
    for entry in sorted(folder.iterdir()):
        if entry.name.startswith(".") or entry.name in tables or entry.resolve() == output:
            continue
        if not is_plain_folder(entry):
            yield entry
        elif not folder.resolve().is_relative_to(entry.resolve()) and not _has_table(entry):
            yield from _entries(entry, output)


def _has_table(folder: Path) -> bool:
    table = folder / "summary.json"
    return table.is_file() and b'"undrift.batch"' in table.read_bytes()[:40]


@dataclass(frozen=True, kw_only=True, eq=False)
class _Job:
    """A command, and its options for all files."""

    function: Callable[..., Any]
    ending: str | None
    stated: Row
    output: Path | None

    def run(self, folder: Path, progress: Progress) -> FolderTable:
        """Call the command on each file of a folder, or take the row that an earlier call made."""
        command, output = self.function.__name__, self.output
        check_folder(output)
        if output is not None and (output.suffix or output.resolve() == folder.resolve()):
            raise InputError(f"output: expected a folder other than {folder}, got {output}. Choose another folder.")
        entries = list(_entries(folder, output and output.resolve()))
        files = [entry for entry in entries if command == "info" or is_recording(entry)]
        if not files:
            got = f"{len(entries)} entries that are none" if entries else "an empty folder"
            raise InputError(f"{folder}: expected a recording or a folder of recordings, got {got}. Check the path.")
        places = [file.relative_to(folder) for file in files]
        names = Counter(place.with_name(name_of(place)) for place in places)
        earlier, rows, shared = dict[str, Row](), list[Row](), [*files_in(tuple(self.stated.values()))]
        if output is not None:
            output.mkdir(exist_ok=True)
            with suppress(OSError, ValueError, KeyError, TypeError):
                earlier = {
                    row["name"]: EMPTY | row for row in json.loads((output / "summary.json").read_bytes())["rows"]
                }
        for k, place in enumerate(places):
            progress(str(place), k / len(files))
            name = place.with_name(name_of(place))
            name = name if names[name] == 1 else place
            file_progress = part_of(progress, k / len(files), (k + 1) / len(files))
            rows.append(self.row(folder, place, name, earlier.get(place.as_posix(), EMPTY), file_progress))
            error = rows[-1]["error"]
            if all(row["error"] for row in rows) and any(error.startswith(f"{path}: ") for path in shared):
                raise InputError(error)
            if output is not None:
                save_json(output / "summary.json", {"kind": "undrift.batch", "command": command, "rows": rows})
        standing = sum(row is earlier.get(row["name"]) for row in rows)
        other_entries = tuple(str(entry.relative_to(folder)) for entry in entries if entry not in files)
        table = FolderTable(
            command=command, folder=folder, rows=tuple(rows), standing=standing, output=output, others=other_entries
        )
        if output is not None:
            _write(table, output)
        return table

    def row(self, folder: Path, place: Path, name: Path, earlier: Row, progress: Progress) -> Row:
        """Return the result of the command for a file of a folder, written under a name there, or its error."""
        file, row, command = (
            folder / place,
            EMPTY | {"name": place.as_posix(), "kind": "recording"},
            self.function.__name__,
        )
        try:
            options = dict(self.stated)
            row["key"] = _key(command, file, options)
            if self.output is not None and self.ending is not None:
                options["output"] = self.output / f"{name}{self.ending}"
                options["output"].parent.mkdir(parents=True, exist_ok=True)
                row["output"] = str(options["output"])
            same = all(earlier[key] == row[key] for key in ("key", "output", "error"))
            if same and (row["output"] is None or Path(row["output"]).exists()):
                return earlier
            opening = options.get("opening", Opening())
            watched = CountedOpening(**{field.name: getattr(opening, field.name) for field in fields(opening)})
            summary = self.function(file, **options | {"opening": watched, "progress": progress}).summary()
        except (UndriftError, OSError, ValueError, ArithmeticError, LookupError, TypeError, MemoryError) as error:
            text = str(error) if isinstance(error, UndriftError | OSError) else f"{type(error).__name__}: {error}"
            kind = "damaged" if command == "info" else row["kind"]
            return row | {"kind": kind, "verdict": "error", "error": text.removeprefix(f"{file}: "), "output": None}
        facts = watched.seen | (summary.data if command == "info" else {})
        row |= _verdict_and_answer(summary) | {
            key: plain(facts[key]) for key in ("kind", "sample_rate_hz", "gaps") if key in facts
        }
        none = {"verdict": ""} if row["kind"] in ("text", "settings") else {}
        return row | none if row["sample_rate_hz"] else row | none | {"gaps": None}


def _key(command: str, file: Path, options: Row) -> str:
    """Return the hash of all inputs of a row: recording, options and their files, version."""
    values = {
        name: asdict(option) if is_dataclass(option) and not isinstance(option, type) else option
        for name, option in options.items()
    }
    read = origin_of(file, *files_in(tuple(options.values()))).inputs
    return hashlib.sha256(json.dumps([__version__, command, plain(values), read]).encode()).hexdigest()


def _verdict_and_answer(summary: Summary) -> Row:
    """Return verdict, worst finding and answer of a summary. The verdict is the worse of the verdicts of file and
    calibration.
    """
    verdict = Verdict.of(*summary.findings).also(summary.verdict or Verdict())
    worst = next((item.text for level in ("fail", "warn") for item in verdict.findings if item.level == level), "")
    answer = str(summary.data.get("summary") or summary.answer)
    return {"verdict": verdict.status, "worst_finding": worst, "summary": answer}


def _cell(value: object) -> str:
    return "" if value is None else f"{value:.6g}" if isinstance(value, float) else str(value)


def _write(table: FolderTable, folder: Path) -> None:
    """Write the table as CSV, Parquet and a page."""
    import pyarrow as pa
    from pyarrow import parquet

    from undrift.files import write_whole

    columns = (*HEADS, "worst_finding", "error", "summary", "output")
    rows, text, buffer = [{key: row[key] for key in columns} for row in table.rows], io.StringIO(), io.BytesIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_whole(folder / "summary.csv", text.getvalue())
    parquet.write_table(pa.Table.from_pylist(rows), buffer)
    write_whole(folder / "summary.parquet", buffer.getvalue())
    at("undrift.report.page:write_page")(folder / "summary.html", table.summary(), origin_of(table.folder))
