"""Run a command on many recordings: for several files, or for a folder of recordings, it is called once for each recording.

The output is then a folder with a file for each recording, in the same subfolders, and ``summary.csv``, which is written after each
recording. If a recording fails, its row contains the error, and the others continue. An error in a shared file, such as the
calibration, ends the call. A second call skips a recording if its output exists, and if content, options with their files and
version equal those in its row.
"""

import csv
import hashlib
import inspect
import io
import os
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial, wraps
from pathlib import Path
from typing import Annotated, Any, TypeAlias

from cyclopts import Parameter

from undrift import __version__
from undrift.base.workers import executor
from undrift.commands.files import is_recording
from undrift.commands.outputs import check_folder, files_in, name_of, origin_of
from undrift.errors import InputError, UndriftError
from undrift.files import write_whole
from undrift.findings import Finding, Level, finding
from undrift.io.formats import detect
from undrift.report import Report, Table
from undrift.screen import part, progress

Command: TypeAlias = Callable[..., Report]
Row: TypeAlias = dict[str, str]
SUMMARY = "summary.csv"
COLUMNS = ("recording", "verdict", "result", "worst_finding", "output", "inputs")


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    """A recording, with its name in the table, the output file and a hash of all its inputs."""

    name: str
    file: Path
    target: Path | None
    inputs: str


def each_recording(ending: str, *, together: tuple[str, ...] = ()) -> Callable[[Command], Command]:
    """Extend a command for one recording to several, or to a folder. Outputs have NAME and the ending, or are omitted with "".

    With one of the options ``together``, the command is called once with all files.
    """

    def of(command: Command) -> Command:
        signature = inspect.signature(command)
        first, *options = signature.parameters.values()

        @wraps(command)
        def called(*paths: Path, scheduler: str | None = None, **values: Any) -> Report:
            output = values.get("output")
            alone = len(paths) == 1 and not is_plain_folder(paths[0]) and (output is None or output.suffix)
            if alone or any(values.get(name) is not None for name in together):
                return command(*paths, **values)
            return _call_each(called, paths, values, ending, scheduler)

        hint = Annotated[Path, Parameter(required=True)]
        several = first.replace(kind=inspect.Parameter.VAR_POSITIONAL, annotation=hint)
        called.__annotations__ = command.__annotations__ | {first.name: hint}
        called.__signature__ = signature.replace(parameters=[several, *options])  # type: ignore[attr-defined]
        return called

    return of


def is_plain_folder(path: Path) -> bool:
    """Return True if a folder is neither a session nor a recording."""
    with suppress(InputError):
        return path.is_dir() and not detect(path)
    return path.is_dir()


def _call_each(
    command: Command, paths: tuple[Path, ...], values: dict[str, Any], ending: str, scheduler: str | None
) -> Report:
    """Call a command for each recording, or reuse the row of an earlier call."""
    output, options = values.get("output"), {name: value for name, value in values.items() if name != "output"}
    files, others = _recordings(paths, output)
    shared = tuple(files_in(tuple(options.values())))
    earlier, rows = dict[str, Row](), dict[str, Row]()
    if output is not None:
        check_folder(output)
        if output.suffix or output.resolve() in [path.resolve() for path in paths]:
            raise InputError(f"output: expected a folder other than the inputs, got {output}. Choose another folder.")
        output.mkdir(exist_ok=True)
        earlier = _read(output / SUMMARY)
    jobs = []
    for name, target in _targets(files, output, ending).items():
        read = origin_of(files[name], *shared).inputs
        inputs = hashlib.sha256(repr((__version__, command.__name__, options, read)).encode()).hexdigest()[:16]
        row = earlier.get(name)
        if row and row["inputs"] == inputs and row["verdict"] != "error" and (target is None or target.exists()):
            rows[name] = row
        else:
            jobs.append(Job(name=name, file=files[name], target=target, inputs=inputs))
    before = len(rows)
    for job, row in zip(jobs, _rows(command, jobs, options, scheduler), strict=True):
        if not rows and any(row["result"].startswith(f"{path}: ") for path in shared):
            raise InputError(row["result"])
        rows[job.name] = row
        if output is not None:
            _write(output / SUMMARY, rows.values())
    title = f"{command.__name__}: {', '.join(path.resolve().name for path in paths)}"
    return _report(title, [rows[name] for name in files], before, others, output)


def _recordings(paths: tuple[Path, ...], output: Path | None) -> tuple[dict[str, Path], list[str]]:
    """Return the recordings by name in the table, and the names of other files."""
    files, others = dict[str, Path](), list[str]()
    for path in paths:
        for file in _files(path, output and output.resolve()) if is_plain_folder(path) else [path]:
            name = file.name if file == path else file.relative_to(path).as_posix()
            if file != path and not is_recording(file):
                others.append(name)
            elif name in files:
                raise InputError(f"{file}: two recordings have the name {name}. Run the command once for each.")
            else:
                files[name] = file
    if not files:
        contents = f"{len(others)} other files" if others else "an empty folder"
        raise InputError(f"{paths[0]}: expected a recording or a folder of recordings, got {contents}. Check the path.")
    return files, others


def _files(folder: Path, output: Path | None) -> Iterator[Path]:
    """Yield the files of a folder and its subfolders, except hidden files, results, and links that lead back."""
    for entry in sorted(folder.iterdir()):
        if entry.name.startswith(".") or entry.resolve() == output or entry.name == SUMMARY:
            continue
        if not is_plain_folder(entry):
            yield entry
        elif not folder.resolve().is_relative_to(entry.resolve()) and not _read(entry / SUMMARY):
            yield from _files(entry, output)


def _targets(files: dict[str, Path], output: Path | None, ending: str) -> dict[str, Path | None]:
    """Return the output file of each recording. Outputs of walk.csv and walk.txt keep these endings, so that they differ."""
    if output is None or not ending:
        return dict.fromkeys(files)
    short = {name: str(Path(name).with_name(name_of(Path(name)))) for name in files}
    count = Counter(short.values())
    return {name: output / ((short[name] if count[short[name]] == 1 else name) + ending) for name in files}


def _rows(command: Command, jobs: Sequence[Job], options: dict[str, Any], scheduler: str | None) -> Iterator[Row]:
    """Yield the row of each job, computed here or by the workers of a Dask scheduler."""
    if scheduler is not None:
        make = partial(_row, command=command, options=options, folder=Path.cwd())
        with executor(None, scheduler) as spread:
            yield from spread(make, jobs)
        return
    for k, job in enumerate(jobs):
        with part(k / len(jobs), (k + 1) / len(jobs)):
            progress(job.name, 0.0)
            yield _row(job, command=command, options=options)


def _row(job: Job, *, command: Command, options: dict[str, Any], folder: Path | None = None) -> Row:
    """Return the verdict and the answer of a command for one recording, or its error."""
    if folder is not None:
        os.chdir(folder)  # paths of the call are relative to its folder, also for a remote worker
    row = dict.fromkeys(COLUMNS, "") | {"recording": job.name, "inputs": job.inputs}
    try:
        if job.target is not None:
            job.target.parent.mkdir(parents=True, exist_ok=True)
            options = options | {"output": job.target}
        report = command(job.file, **options)
    except Exception as error:  # noqa: BLE001 the other recordings continue
        text = str(error) if isinstance(error, UndriftError | OSError) else f"{type(error).__name__}: {error}"
        return row | {"verdict": "error", "result": text.removeprefix(f"{job.file}: ")}
    worst = next((item.text for item in report.ordered_findings if item.level != "info"), "")
    output = "" if job.target is None else str(job.target)
    verdict, result = report.status if report.verdict_shown else "", report.answer.removeprefix(f"{job.file} ")
    return row | {"verdict": verdict, "result": result, "worst_finding": worst, "output": output}


def _report(title: str, rows: list[Row], before: int, others: list[str], output: Path | None) -> Report:
    failed = sum(row["verdict"] == "error" for row in rows)
    done = f"{len(rows) - failed} of {len(rows)} recordings are done"
    return Report(
        title=title,
        answer=f"{done}{f' ({before} of them before)' if before else ''}, and {failed} failed.",
        tables=[
            Table(
                title="Recordings",
                columns=("recording", "verdict", "result"),
                rows=[(row["recording"], row["verdict"], row["result"]) for row in rows],
            )
        ],
        notes=[f"These files are not recordings: {', '.join(others)}."] if others else [],
        findings=[_finding(row) for row in rows if row["verdict"] == "error" or row["worst_finding"]],
        written=[] if output is None else [output / SUMMARY],
        data={"recordings": len(rows), "failed": failed, "before": before},
    )


def _finding(row: Row) -> Finding:
    """Return the error of a recording, or its worst finding."""
    sentence = f"{row['recording']}: {row['result'] if row['verdict'] == 'error' else row['worst_finding']}"
    level: Level = "warn" if row["verdict"] == "marginal" else "fail"
    return finding("folder.recording", level, sentence, recording=row["recording"])


def _read(path: Path) -> dict[str, Row]:
    """Return the rows of an earlier call, or no rows if the file is missing or is another table."""
    if not path.is_file():
        return {}
    with path.open(newline="", encoding="utf-8", errors="replace") as file:
        table = csv.DictReader(file)
        return {row["recording"]: row for row in table} if tuple(table.fieldnames or ()) == COLUMNS else {}


def _write(path: Path, rows: Any) -> None:
    text = io.StringIO()
    table = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    table.writeheader()
    table.writerows(rows)
    write_whole(path, text.getvalue())
