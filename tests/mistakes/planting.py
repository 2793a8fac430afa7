"""A mistake, how it is planted into sound input, and what becomes of it: named, refused, warned, silent or harmless."""

import asyncio
import contextlib
import io
import json
import re
import signal
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from matplotlib.figure import Figure

import undrift
from mistakes.habits import Habit
from mistakes.sound import Recording
from mistakes.unnamed import UNNAMED
from undrift.cli.app import run as call
from undrift.errors import UndriftError
from undrift.findings import Finding
from undrift.io.reference import write_reference
from undrift.io.session import write_session
from undrift.io.store import write_calibration
from undrift.sim.motion.motion import Motion
from undrift.web.bench import Bench, ServerSettings

Wrong = Mapping[str, float]  # What is wrong by how much: name with its unit -> rms or largest error
GOOD_ENOUGH = (
    2.0  # A figure whose error is less than this many times that of the sound input is right within its uncertainty
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Case:
    """What a person has, and what the person asks for. A mistake changes one thing of it."""

    route: str  # A command, "python ...", or "bench ..."
    recordings: tuple[Recording, ...] = ()
    words: tuple[object, ...] = ()  # Further options
    calibration: undrift.Calibration | None = None
    references: tuple[undrift.Reference | str, ...] = ()  # str: the text of a TRC
    session: undrift.Session | None = None
    edit: Callable[[Path], None] | None = None  # Of the files, once they are written
    call: Callable[["Case"], object] | None = None  # Of the Python interface
    page: Callable[["Case", Path, Bench], Any] | None = None  # What the page of the bench does; async
    mapped: bool = True  # False gives the files without a map
    together: bool = False  # Gives the folder in which the recordings are
    later: Recording | None = None  # Read in the same way, and corrected by what was made; with its truth
    expected: undrift.Record | None = (
        None  # What a right correction, or reading, of the later one or the first one gives
    )
    motion: Motion | None = None  # What was true of the first one
    wrong: Callable[["Case", Path, "Told"], Wrong] | None = None


Change = Callable[[Case], Case]


@dataclass(frozen=True, slots=True)
class Told:
    """What a person is told."""

    code: int
    error: str = ""
    warnings: tuple[str, ...] = ()  # Findings that warn or fail
    notes: tuple[str, ...] = ()  # Findings for the record
    answer: Any = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Mistake:
    """One mistake of a user."""

    name: str  # What the person did, as a clause
    sound: Callable[[], Case]
    change: Change
    named: tuple[str, ...]  # A text that one of them matches names the true cause
    noted: bool = False  # A finding for the record names it well enough: the stated uncertainty holds it

    @property
    def route(self) -> str:
        """Return the route."""
        return self.sound().route


def label_of(sound: Callable[[], Case]) -> str:
    """Return the name of a sound input, which is not made for it."""
    return f"{sound.__module__}.{sound.__name__}"


def mistake(sound: Callable[[], Case], name: str, change: Change, named: tuple[str, ...]) -> Mistake:
    """Return a mistake."""
    return Mistake(name=name, sound=sound, change=change, named=named)


def planted(sound: Callable[[], Case], *habits: Habit) -> list[Mistake]:
    """Return habits as mistakes of one route: all files, and the later one, are read with them."""
    return [mistake(sound, one.name, with_recordings(one.change), one.named) for one in habits]


@dataclass(frozen=True, slots=True, kw_only=True)
class Result:
    """What became of a mistake."""

    mistake: str
    route: str
    sound: str  # Which sound input it was planted into
    outcome: str
    line: str  # The text that names it, else the first that was shown
    wrong: Wrong  # Against the truth; empty where there is no result
    command: str


# ---- running


def run(case: Case, folder: Path) -> Told:
    """Do what the person asks for."""
    if case.call is not None:
        return _python(case)
    if case.page is not None:
        with ThreadPoolExecutor(1) as pool:  # a browser test of the same worker leaves a loop running in this thread
            return pool.submit(asyncio.run, _page(case, folder)).result()
    return _command(words_of(case, folder))


def words_of(case: Case, folder: Path) -> list[object]:
    """Write the files of a case and return the words of its command."""
    argv: list[object] = [*case.route.split()]
    files, mapped = written(case, folder)
    argv += [*files, *(("--map", mapped) if mapped else ()), *case.words]
    if case.calibration is not None:
        write_calibration(case.calibration, folder / "calibration.json")
        argv += ["--calibration", folder / "calibration.json"]
    if case.references:
        argv += ["--reference", *written_references(case, folder)]
    outputs = {"calibrate": "made.json", "drift": "made.json", "correct": "made.parquet", "orient": "made.parquet"}
    outputs |= {"validate": "made"}
    argv += ["-o", folder / ("made" if case.together else outputs[case.route])] if case.route in outputs else []
    if case.edit is not None:
        case.edit(folder)
    return [*(str(word).replace("{folder}", str(folder)) for word in argv), "--json"]


def written(case: Case, folder: Path) -> tuple[list[Path], Path | None]:
    """Write recordings or session, and the map."""
    if case.session is not None:
        write_session(case.session, folder / "session")
        return [folder / "session"], None
    place = folder / "recordings" if case.together else folder
    place.mkdir(exist_ok=True)
    for number, one in enumerate(case.recordings):
        one.write(place, f"recording{number}.csv")
    mapped = folder / "map.toml"
    mapped.write_text(case.recordings[0].map_text())
    files = [folder / f"recording{number}.csv" for number in range(len(case.recordings))]
    files = [place] if case.together else files
    return files, mapped if case.mapped else None


def written_references(case: Case, folder: Path) -> list[Path]:
    """Write the references."""
    paths = []
    for number, one in enumerate(case.references):
        paths.append(folder / f"reference{number}.{'trc' if isinstance(one, str) else 'parquet'}")
        if isinstance(one, str):
            paths[-1].write_text(one)
        else:
            write_reference(one, paths[-1])
    return paths


UNPRINTED = patch.object(
    Figure, "savefig", lambda _, file, **__: file.write(b"<svg ></svg>")
)  # figures are made, not written


def _called(words: list[object]) -> tuple[int, str, str]:
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), warnings.catch_warnings(), UNPRINTED:
        warnings.simplefilter("ignore")
        code = call([str(word) for word in words])
    return code, out.getvalue(), err.getvalue()


def _command(words: list[object]) -> Told:
    code, out, err = _called(words)
    answer = json.loads(out) if out.strip() else {}
    answer |= answer.get("data") or {}
    error = ((answer.get("error") or {}).get("text") or err.strip()) if code > 1 else ""
    return Told(code, error, tuple(dict.fromkeys(texts_of(answer))), tuple(texts_of(answer, "info")), answer)


def _python(case: Case) -> Told:
    assert case.call is not None
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            answer = case.call(case)
        except UndriftError as error:
            return Told(2, str(error))
    told = [str(one.message) for one in caught]
    return Told(0, "", tuple(dict.fromkeys([*told, *texts_of(answer)])), answer=answer)


async def _page(case: Case, folder: Path) -> Told:
    """Do what a person does on the page of the bench."""
    assert case.page is not None
    bench, error = Bench(ServerSettings(folder=folder / "bench")), ""
    with warnings.catch_warnings(), UNPRINTED:
        warnings.simplefilter("ignore")
        try:
            await case.page(case, folder, bench)
        except UndriftError as refusal:
            error = bench.plain(str(refusal))
        finally:
            bench.close()
    found = [item.looked.findings for item in bench.items if item.looked]
    found += [shown["findings"] for item in bench.items for shown in item.results.values()]
    texts = [(level, f"{sentence} {action}".rstrip()) for findings in found for level, sentence, action in findings]
    told = tuple(dict.fromkeys(text for level, text in texts if level != "info"))
    return Told(2 if error else 0, error, told, tuple(text for level, text in texts if level == "info"), bench)


def texts_of(value: Any, *levels: str) -> list[str]:
    """Return the texts of findings that warn or fail, or of other levels, in an answer."""
    wanted = levels or ("warn", "fail")
    if isinstance(value, Finding):
        return [value.text] if value.level in wanted else []
    if isinstance(value, Mapping):
        if "level" in value and "text" in value:
            return [f"{value['text']} {value.get('action', '')}".rstrip()] if value["level"] in wanted else []
        if "worst_finding" in value:  # a row of a folder
            return [] if levels else [text for text in (value["error"], value["worst_finding"]) if text]
        return [text for item in value.values() for text in texts_of(item, *levels)]
    if is_dataclass(value) and not isinstance(value, type):
        return texts_of({one.name: getattr(value, one.name, None) for one in fields(value)}, *levels)
    if isinstance(value, list | tuple):
        return [text for item in value for text in texts_of(item, *levels)]
    return []


# ---- judging

LONGEST_S = 20.0  # Of processor time: a command that takes longer than this on a recording of minutes hangs
WAITED = 20.0  # times that, of a busy computer's clock: a command that waits for nothing hangs too


class TooLong(BaseException):
    """A command did not end."""


@contextlib.contextmanager
def limited(seconds: float) -> Iterator[None]:
    """End what takes too long."""

    def stop(*_: object) -> None:
        raise TooLong

    clocks = {signal.SIGPROF: (signal.ITIMER_PROF, seconds), signal.SIGALRM: (signal.ITIMER_REAL, WAITED * seconds)}
    before = {name: signal.signal(name, stop) for name in clocks}
    for timer, limit_s in clocks.values():
        signal.setitimer(timer, limit_s)
    try:
        yield
    finally:
        for name, (timer, _) in clocks.items():
            signal.setitimer(timer, 0.0)
            signal.signal(name, before[name])


@cache
def control(sound: Callable[[], Case]) -> tuple[Told, Wrong]:
    """Return what is told about sound input, and how far its result is from the truth."""
    return told_and_wrong(sound())


def told_and_wrong(case: Case) -> tuple[Told, Wrong]:
    """Run a case in a folder of its own."""
    import tempfile

    with tempfile.TemporaryDirectory(prefix="mistake-") as name:
        told = run(case, Path(name))
        wrong: Wrong = {}
        if told.code < 2 and case.wrong is not None:
            try:
                wrong = case.wrong(case, Path(name), told)
            except UndriftError:  # what was made serves for nothing
                wrong = {"unusable": np.inf}
    told = replace(told, error=told.error.replace(f"{name}/", ""))
    return told, wrong


def _plain(text: str) -> str:
    """Return a text without its numbers, to tell a warning from one that sound input gives as well."""
    return re.sub(r"[-+]?\d[\d.e+-]*", "#", text)


def named_by(texts: tuple[str, ...], patterns: tuple[str, ...]) -> str:
    """Return the first text that names the cause."""
    return next((text for text in texts if any(re.search(one, text, re.IGNORECASE) for one in patterns)), "")


@cache
def judged(one: Mistake) -> Result:
    """Plant a mistake and return what became of it."""
    sound_told, sound_wrong = control(one.sound)
    case = one.change(one.sound())
    try:
        with limited(LONGEST_S):
            told, wrong = told_and_wrong(case)
    except TooLong:
        told, wrong = Told(2, f"internal error: no end within {LONGEST_S:g} s"), {}
    usual = {_plain(text) for text in sound_told.warnings}
    new = tuple(text for text in told.warnings if _plain(text) not in usual)
    texts = (told.error,) if told.code >= 2 else new
    line = named_by((*texts, *(told.notes if one.noted else ())), one.named)
    note = named_by(told.notes, one.named)
    right = all(value <= GOOD_ENOUGH * sound_wrong.get(name, 0.0) for name, value in wrong.items()) if wrong else False
    if "internal error" in told.error:
        outcome = "broken"
    elif line:
        outcome = "named"
    elif told.code >= 2:
        outcome = "refused"
    elif right:
        outcome = "harmless"
    else:
        outcome = "warned" if new else "noted" if note else "silent"
    return Result(
        mistake=one.name,
        route=case.route,
        sound=one.sound.__name__,
        outcome=outcome,
        line=line or next(iter(texts), note),
        wrong=wrong,
        command=f'python -m tests.mistakes "{case.route}" {one.sound.__name__} "{one.name}"',
    )


def later_error(case: Case, folder: Path, _: Told) -> Wrong:
    """Return the error of a later recording that the person reads in the same way and corrects by what was made."""
    assert case.later is not None
    case.later.write(folder, "later.csv")
    (folder / "later.toml").write_text(case.later.map_text())
    words = ["correct", folder / "later.csv", "--map", folder / "later.toml", "--calibration", folder / "made.json"]
    code, out, _ = _called([*words, "-o", folder / "later.parquet", "--json"])
    if code >= 2:  # with 1 the verdict of the calibration is bad, and the file is written
        raise UndriftError(json.loads(out)["error"]["text"])
    return record_error(undrift.read_record(folder / "later.parquet"), case.expected)


def record_error(record: undrift.Record, expected: undrift.Record | None) -> Wrong:
    """Return the rms error of rate and specific force, at the moments that the record states."""
    assert expected is not None
    reading, right = record.in_si(), expected.in_si()
    error: dict[str, float] = {}
    for name, values, true, factor in (
        ("deg/s", reading.gyro, right.gyro, np.degrees(1.0)),
        ("mg", reading.accel, right.accel, 1e3 / 9.80665),
    ):
        if values is None or true is None:
            error[name] = np.inf
            continue
        there = np.stack([np.interp(reading.time, right.time, column) for column in true.T], axis=1)
        size = np.linalg.norm(values - there, axis=1)
        error[name] = factor * float(np.sqrt(np.nanmean(size**2)))
    return error


def with_recordings(change: Callable[[Recording], Recording]) -> Change:
    """Return the change of a habit: all files of this person, and the later one, are read with it."""

    def changed(case: Case) -> Case:
        later = None if case.later is None else change(case.later)
        return replace(case, recordings=tuple(change(one) for one in case.recordings), later=later)

    return changed


# ---- what is asked of all


def false_alarms(sound: Callable[[], Case], mistakes: Iterable[Mistake]) -> list[str]:
    """Return the texts about sound input that refuse it or name a mistake."""
    told, _ = control(sound)
    where = f"{sound().route} ({sound.__name__})"
    if told.code:
        return [f"{where}: {told.error or f'exit code {told.code}'}"]
    patterns = tuple(pattern for one in mistakes if one.sound is sound for pattern in one.named)
    results = [text for text in told.warnings if named_by((text,), patterns)]
    return [f"{where}: {text}" for text in results]


def expected_of(one: Mistake) -> str:
    """Return what a mistake comes to: named, unless unnamed.py lists it."""
    return UNNAMED.get((one.route, one.sound.__name__, one.name), ("named", ""))[0]
