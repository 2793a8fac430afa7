"""A mistake, how it is planted into sound input, and what undrift says: named, refused, warned, noted, silent or harmless."""

import asyncio
import contextlib
import io
import json
import re
import tempfile
import warnings
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from matplotlib.figure import Figure

import undrift
from mistakes.sound import Recording
from undrift.cli.app import run as call
from undrift.errors import UndriftError
from undrift.findings import Finding
from undrift.io.reference import write_reference
from undrift.web.bench import Bench, ServerSettings

OUTPUTS = {"calibrate": "made.json", "drift": "made.json", "correct": "made.parquet", "orient": "made.parquet"}
OUTPUTS |= {"validate": "made"}
WITHOUT_DRAWING = patch.object(Figure, "savefig", lambda _, file, **__: file.write(b"<svg ></svg>"))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Case:
    """The files of a person, and the question. A mistake changes one thing of it."""

    route: str  # a command, "python ...", or "bench ..."
    recordings: tuple[Recording, ...] = ()
    options: tuple[object, ...] = ()
    calibration: undrift.Calibration | None = None
    references: tuple[undrift.Reference | str, ...] = ()  # str: the text of a TRC
    session: undrift.Session | None = None
    edit: Callable[[Path], None] | None = None  # changes the files, once they are written
    script: Callable[["Case"], object] | None = None  # a call of the Python interface
    page: Callable[["Case", Bench], Any] | None = None  # what a person does on the page; async
    mapped: bool = True  # False gives the files without a map
    together: bool = False  # gives the folder of the recordings


Change = Callable[[Case], Case]


@dataclass(frozen=True, slots=True, kw_only=True)
class Mistake:
    sound: str  # name of the sound input
    name: str  # what the person did, as a clause
    change: Change
    says: str  # a text that matches names the true cause
    outcome: str = "named"  # what it comes to
    noted: bool = False  # a finding for the record is enough: the stated uncertainty covers the error

    @property
    def label(self) -> str:
        return f"{self.sound}: a person {self.name}"


@dataclass(frozen=True, slots=True)
class Told:
    code: int
    error: str = ""
    warnings: tuple[str, ...] = ()  # findings that warn or fail
    notes: tuple[str, ...] = ()  # findings for the record
    calibration: undrift.Calibration | None = None


# ---- running


def run(case: Case) -> Told:
    """Do what the person asks for, in a new folder."""
    with tempfile.TemporaryDirectory(prefix="mistake-") as folder, WITHOUT_DRAWING:
        if case.script is not None:
            return _run_script(case)
        if case.page is not None:
            with ThreadPoolExecutor(
                1
            ) as pool:  # a browser test of the same worker leaves a loop running in this thread
                return pool.submit(asyncio.run, _use_page(case, Path(folder))).result()
        return _run_command(case, Path(folder))


def _run_command(case: Case, folder: Path) -> Told:
    argv: list[object] = [case.route]
    if case.session is not None:
        undrift.write_session(case.session, folder / "session")
        argv.append(folder / "session")
    else:
        home = folder / "recordings" if case.together else folder
        home.mkdir(exist_ok=True)
        paths = [recording.write(home / f"recording{k}.csv") for k, recording in enumerate(case.recordings)]
        argv += [home] if case.together else paths
        (folder / "map.toml").write_text(case.recordings[0].map_text())
        argv += ["--map", folder / "map.toml"] if case.mapped else []
    argv += case.options
    if case.calibration is not None:
        undrift.write_calibration(case.calibration, folder / "calibration.json")
        argv += ["--calibration", folder / "calibration.json"]
    for k, reference in enumerate(case.references):
        path = folder / f"reference{k}.{'trc' if isinstance(reference, str) else 'parquet'}"
        if isinstance(reference, str):
            path.write_text(reference)
        else:
            write_reference(reference, path)
        argv += ["--reference", path]
    if case.route in OUTPUTS:
        argv += ["-o", folder / ("made" if case.together else OUTPUTS[case.route])]
    if case.edit is not None:
        case.edit(folder)
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        code = call([str(word).replace("{folder}", str(folder)) for word in (*argv, "--json")])
    answer = json.loads(out.getvalue() or "{}")
    answer |= answer.get("data") or {}
    error = ((answer.get("error") or {}).get("text") or err.getvalue().strip()) if code > 1 else ""
    made = folder / "made.json"
    calibration = undrift.read_calibration(made) if case.route == "calibrate" and made.exists() else None
    return Told(code, error.replace(f"{folder}/", ""), _texts(answer), _texts(answer, "info"), calibration)


def _run_script(case: Case) -> Told:
    assert case.script is not None
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            answer = case.script(case)
        except UndriftError as error:
            return Told(2, str(error))
    return Told(0, "", (*(str(warning.message) for warning in caught), *_texts(answer)))


async def _use_page(case: Case, folder: Path) -> Told:
    assert case.page is not None
    bench, error = Bench(ServerSettings(folder=folder / "bench")), ""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            await case.page(case, bench)
        except UndriftError as refusal:
            error = bench.plain(str(refusal))
        finally:
            bench.close()
    reports = [report for item in bench.items for report in item.reports.values()]
    findings = [item for report in reports for item in report.findings]
    notes = [item.text for item in findings if item.level == "info"]
    notes += [note for report in reports for note in report.notes]
    told = tuple(item.text for item in findings if item.level != "info")
    return Told(2 if error else 0, error, told, tuple(notes))


def _texts(value: Any, *levels: str) -> tuple[str, ...]:
    """Return the texts of findings that warn or fail, or of other levels, in an answer."""
    wanted = levels or ("warn", "fail")
    if isinstance(value, Finding):
        return (value.text,) if value.level in wanted else ()
    if isinstance(value, Mapping):
        if "level" in value and "text" in value:
            return (f"{value['text']} {value.get('action', '')}",) if value["level"] in wanted else ()
        if "worst_finding" in value:  # a row of a folder
            return () if levels else tuple(text for text in (value["error"], value["worst_finding"]) if text)
        value = list(value.values())
    elif is_dataclass(value) and not isinstance(value, type):
        value = [getattr(value, field.name, None) for field in fields(value)]
    texts = (_texts(item, *levels) for item in value) if isinstance(value, list | tuple) else ()
    return tuple(dict.fromkeys(text for group in texts for text in group))


# ---- judging


control = cache(run)  # what undrift says to sound input


def judge(mistake: Mistake, case: Case) -> tuple[str, str]:
    """Plant a mistake into sound input. Return what it comes to, and the text that names it or the first text that came."""
    sound, told = control(case), run(mistake.change(case))
    usual = {_without_numbers(text) for text in sound.warnings}
    new = tuple(text for text in told.warnings if _without_numbers(text) not in usual)
    texts = (told.error,) if told.code >= 2 else new
    line = _match((*texts, *(told.notes if mistake.noted else ())), mistake.says)
    note = _match(told.notes, mistake.says)
    if "internal error" in told.error:
        outcome = "broken"
    elif line:
        outcome = "named"
    elif told.code >= 2:
        outcome = "refused"
    elif _agree(told.calibration, sound.calibration):
        outcome = "harmless"
    else:
        outcome = "warned" if new else "noted" if note else "silent"
    return outcome, line or next(iter(texts), note)


def false_alarms(case: Case, patterns: Iterable[str]) -> list[str]:
    """Return the texts about sound input that refuse it or match what a mistake must say."""
    told = control(case)
    if told.code:
        return [told.error or f"exit code {told.code}"]
    return [text for text in told.warnings if any(_match((text,), pattern) for pattern in patterns)]


def _match(texts: Iterable[str], pattern: str) -> str:
    """Return the first text that a pattern matches."""
    return next((text for text in texts if re.search(pattern, text, re.IGNORECASE)), "")


def _without_numbers(text: str) -> str:
    """Return a text without its numbers, to tell a warning from one that sound input gives as well."""
    return re.sub(r"[-+]?\d[\d.e+-]*", "#", text)


def _agree(made: undrift.Calibration | None, sound: undrift.Calibration | None) -> bool:
    """Return whether a calibration agrees with that of sound input within its stated uncertainty."""
    if made is None or sound is None:
        return False
    for triad in ("gyro", "accel"):
        values, right = getattr(made, triad), getattr(sound, triad)
        if values is None or right is None:
            return False
        differences = np.append(values.matrix - right.matrix, values.offset - right.offset)
        if np.any(np.abs(differences) > 3.0 * np.sqrt(np.diag(values.covariance)[:12])):
            return False
    return True
