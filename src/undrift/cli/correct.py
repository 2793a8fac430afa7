"""``undrift correct``: many recordings, any size, constant memory."""

from contextlib import nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from undrift.base.options import Details, Files, Json, Output, Policy, Report
from undrift.cli.common import progress, say, show_verdict, write_json
from undrift.commands.files import (
    Opening,
    calibrated_part,
    check_folder,
    check_output,
    check_report,
    name_of,
    named_columns,
    origin_of,
)
from undrift.commands.register import Registered
from undrift.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable

    from rich.progress import Progress

    from undrift.base.summary import Origin
    from undrift.correction.correct import Corrector, CorrectorState
    from undrift.correction.coverage import Beyond
    from undrift.correction.rest import RestOffset, Stretch
    from undrift.drift.hysteresis import TempHistory
    from undrift.findings import Finding
    from undrift.model import Calibration
    from undrift.record import Record

NOT_COVERED = ("outside", "extrapolated", "without_temperature")  # of the tuning tables


def correct(
    *records: Files,
    calibration: Path | None = None,
    registered: Registered = Registered(),
    output: Output,
    policy: Policy = "raise",
    power_on_s: float | None = None,
    temp_history: str | None = None,
    offset: Literal["none", "rest"] = "none",
    still_start_s: float | None = None,
    still_stop_s: float | None = None,
    opening: Opening = Opening(),
    scheduler: str | None = None,
    report: Report = None,
    details: Details = False,
    json: Json = False,
) -> int:
    """Turn raw recordings into rad/s and m/s2; the ending of the output names the format. Parquet streams in constant memory.

    Parameters
    ----------
    records : Path
        One or more recordings of the calibrated device.
    calibration : Path or None
        calibration.json of the device.
    output : Path
        File for one recording: .parquet, .csv, .csv.gz, .mat, or sub-.._task-.._tracksys-.._motion.tsv (BIDS); folder for
        several, made where it is missing.
    policy : str
        Temperatures outside a tuning table: refuse (raise), hold the table's end, or leave a gap (nan). Where no
        temperature was recorded the result is a gap under each, and a warning says for how long.
    power_on_s : float
        Time since power-on at the first sample of each recording, s; without it no warm-up is subtracted.
    temp_history : str
        Course of the temperature before each recording, for a calibration that corrects hysteresis: warming, cooling, or the
        temperatures at which it turned, oldest first, degC, as in 25,60. Without it hysteresis is corrected as far as a
        recording shows its own course; none leaves the middle of the loop.
    offset : str
        "rest" also subtracts the mean rate that is left at the first still phase (or the named one), as --offset of orient
        does: best with tables, for what they cannot know.
    still_start_s : float or None
        Start of a stretch at rest, s on the recording's own clock; without it the first still phase is found.
    still_stop_s : float or None
        End of that stretch.
    scheduler : str or None
        Address of a Dask scheduler, as in tcp://host:8786: its workers take a recording each; they see the same files.
    """
    from undrift.correction.correct import Corrector

    stretch = (still_start_s, still_stop_s)
    if offset == "none" and stretch != (None, None):
        raise InputError("--still-start-s, --still-stop-s: wanted --offset rest beside them, got none; add it")
    model, calibration = registered.read(calibration, records, opening)
    targets = _targets(records, output, (calibration, opening.column_map))
    check_report(report, reads=(*records, calibration))
    folder = targets[0].parent
    opening = opening.like(model, calibration)
    made = not folder.exists()
    folder.mkdir(exist_ok=True)
    history = None if temp_history is None else _history(temp_history, model)
    corrector = partial(Corrector, model, policy, power_on_s=power_on_s, temp_history=history)
    settings: dict[str, object] = {"policy": policy, "power_on_s": power_on_s, "offset": offset}
    settings |= {} if history is None else {"temp_history": temp_history}
    made_by = partial(_provenance, calibration=calibration, model=model, settings=settings)
    corrected = partial(_correct_one, corrector=corrector, model=model, opening=opening, made_by=made_by)
    if offset == "rest":
        corrected = partial(corrected, stretch=stretch)
    try:
        results = _correct_all(records, targets, corrected, scheduler)
    except BaseException:
        if made:
            folder.rmdir()
        raise
    rows = [_row(*result) for result in results]
    if report is not None:
        _write_report(report, rows, targets[0], origin_of(*records, calibration))
    if json:
        write_json({"calibration": str(calibration), "recordings": rows}, "correct")
        return 0
    for record, target, state, remarks in results:
        say(
            f"{record} -> {target}: {state.samples} samples in rad/s and m/s2",
            *(f"  warning: {text}" for text in remarks.warnings),
            *(f"  note: {text}" for text in remarks.notes),
        )
    if details:
        show_verdict(model.verdict, details=True)
    say(*([f"Wrote {report}"] if report else []))
    return 0


def _write_report(path: Path, rows: list[dict[str, object]], first: Path, origin: "Origin") -> None:
    """Write the page, with a picture of the first recording, or of its beginning where it is long."""
    from undrift.io.formats import iter_record
    from undrift.report.commands import write_correct_report

    remarks = [
        f"{Path(str(row['recording'])).name}: {text}"
        for row in rows
        for key in ("warnings", "notes")
        for text in row[key]  # type: ignore[attr-defined]
    ]
    write_correct_report(path, next(iter_record(first)), rows, remarks=tuple(remarks), origin=origin)


def _history(text: str, model: "Calibration") -> "TempHistory":
    """Return the course of the temperature that was stated."""
    if text == "none":
        return "none"
    static = None if model.drift is None else model.drift.static
    if static is None or static.hysteresis is None:
        raise InputError(
            "--temp-history: wanted a calibration that corrects hysteresis, got one without; leave it out, or fit tables to "
            "sweeps both ways"
        )
    try:
        if text in ("warming", "cooling"):
            return "warming" if text == "warming" else "cooling"
        return tuple(float(part) for part in text.split(","))
    except ValueError as error:
        raise InputError(
            f"--temp-history: wanted none, warming, cooling or temperatures as in 25,60, got '{text}'; state one of these"
        ) from error


def _row(record: Path, target: Path, state: "CorrectorState", remarks: "Remarks") -> dict[str, object]:
    """Return a recording as --json has it."""
    from undrift.io.store import findings_json

    outside = {f"samples_{kind}": getattr(state, f"samples_{kind}") for kind in NOT_COVERED}
    outside |= {f"seconds_{kind}": getattr(state.reach, f"seconds_{kind}") for kind in NOT_COVERED}
    return {
        "recording": str(record),
        "output": str(target),
        "samples": state.samples,
        **outside,
        "beyond_range": [
            {key: getattr(one, key) for key in ("sensor", "samples", "share", "worst")}
            | {"range": one.seen, "unit": "rad/s" if one.sensor == "gyro" else "m/s2"}
            for one in remarks.beyond
            if one.samples
        ],
        "rest": remarks.rest and remarks.rest.figures,
        "warnings": remarks.warnings,
        "notes": remarks.notes,
        "findings": findings_json(remarks.findings),
    }


def _correct_all(
    records: tuple[Path, ...],
    targets: list[Path],
    correct_one: "Callable[..., tuple[CorrectorState, Remarks]]",
    scheduler: str | None,
) -> list[tuple[Path, Path, "CorrectorState", "Remarks"]]:
    """Correct into a hidden folder beside the targets; they appear when all are whole."""
    done = []
    from undrift.files import hidden_folder

    with hidden_folder(targets[0].parent) as held, progress() as shown:
        parts = [held / target.name for target in targets]
        if scheduler is not None:
            done = _on_workers(list(zip(records, parts, strict=True)), correct_one, scheduler, shown)
        else:
            for record, part in zip(records, parts, strict=True):
                task = shown.add_task(record.name, total=_rows(record))
                done.append(correct_one(record, part, advance=partial(shown.advance, task)))
        for part in sorted(held.iterdir()):  # the recordings, and what is written beside them
            part.replace(targets[0].parent / part.name)
    return [(record, target, *one) for record, target, one in zip(records, targets, done, strict=True)]


def _job(
    correct_one: "Callable[..., tuple[CorrectorState, Remarks]]", job: tuple[Path, Path]
) -> "tuple[CorrectorState, Remarks]":
    """Correct on a worker: by absolute paths, since it stands in a folder of its own, and without a bar."""
    return correct_one(*job, advance=bool)


def _on_workers(
    jobs: list[tuple[Path, Path]],
    correct_one: "Callable[..., tuple[CorrectorState, Remarks]]",
    scheduler: str,
    shown: "Progress",
) -> list[tuple["CorrectorState", "Remarks"]]:
    from undrift.study.run import Dask

    task, done = shown.add_task("recordings", total=len(jobs)), {}
    for place, one in Dask(scheduler).run(partial(_job, correct_one), [(r.resolve(), p.resolve()) for r, p in jobs]):
        done[place] = one
        shown.advance(task)
    return [done[place] for place in range(len(jobs))]


def _targets(records: tuple[Path, ...], output: Path, read: tuple[Path | None, ...]) -> list[Path]:
    """Return the file that each recording is written to."""
    from undrift.io.write import RECORD_WRITERS, files_of

    endings = tuple(RECORD_WRITERS)
    if len(records) == 1 and output.name.lower().endswith(endings):
        targets = [output]
    else:
        if output.suffix and not output.is_dir():
            named = f"a name ending in {', '.join(endings[:-1])} or {endings[-1]}"
            wanted = "a folder for several recordings" if len(records) > 1 else named
            raise InputError(f"output: wanted {wanted}, got {output}; name it so")
        check_folder(output)
        targets = [output / (name_of(record) + ".parquet") for record in records]
    doubled = sorted({t.name for t in targets if targets.count(t) > 1})
    if doubled:
        raise InputError(
            f"output: wanted another name for each recording, got {', '.join(doubled)} twice; correct them apart"
        )
    if output in targets or output.is_dir():
        for target in targets:
            check_output(target, endings=endings, reads=(*records, *read), beside=files_of(target)[1:])
    return targets


@dataclass(frozen=True, slots=True, kw_only=True)
class Remarks:
    """What a reader of a corrected recording should know."""

    warnings: list[str]  # Where the calibration did not cover it, and signs that it was not read rightly
    notes: list[str]
    findings: "tuple[Finding, ...]"  # Signs of other columns or another unit; in the warnings too
    beyond: "tuple[Beyond, ...]"  # Readings beyond the range of the fits; in the warnings too
    rest: "RestOffset | None" = None  # What was subtracted because it was left at a rest; in the notes too


def _correct_one(
    record: Path,
    part: Path,
    *,
    corrector: "Callable[..., Corrector]",
    model: "Calibration",
    opening: Opening,
    made_by: "Callable[[Path], dict[str, object]]",
    stretch: "Stretch | None" = None,
    advance: "Callable[[float], None]",
) -> tuple["CorrectorState", Remarks]:
    from undrift.correction.consistency import check_corrected, check_force
    from undrift.correction.correct import read_ahead
    from undrift.correction.coverage import find_beyond
    from undrift.io.inspect import find_saturated
    from undrift.io.parquet import ParquetWriter
    from undrift.io.write import write_record_as

    stream, notes, rest = corrector(), dict[str, None](), None
    if stretch is not None:
        rest = _rest_offset(record, model, opening, corrector(), stretch)
        stream, notes = corrector(offset=rest), {rest.finding.text: None}
    suspicions: tuple[Finding, ...] = ()
    saturated: dict[object, Finding] = {}  # by channel and axis, over all chunks
    beyond: tuple[Beyond, ...] = ()
    whole = not part.name.endswith(".parquet")
    with nullcontext() if whole else ParquetWriter(part) as writer:
        for read in (opening.read(record),) if whole else read_ahead(opening.chunks(record)):
            chunk, left_out = calibrated_part(read, model)
            for one in find_saturated(chunk):
                saturated.setdefault((one.values["channel"], one.values["axis"]), one)
            done = stream.push_checked(chunk)
            if stream.state.samples == len(chunk):  # the first chunk is enough
                with named_columns(record):
                    check_force(done.record)
                    suspicions = (*check_corrected(done.record, model, chunk), *_suspicions(done.record, model))
                suspicions += tuple(one for one in done.findings if one.code == "correct.device")
            if writer is None:
                write_record_as(done.record, part, made_by(record))
            else:
                writer.write(done.record)
            notes.update(dict.fromkeys((*left_out, *done.notes)))
            found = find_beyond(done.record, model)
            beyond = tuple(a.joined(b) for a, b in zip(beyond, found, strict=True)) if beyond else found
            advance(len(chunk))
    suspicions = (*saturated.values(), *(one for one in suspicions if one.code != "recording.saturated"))
    warnings = [*(one.text for one in suspicions), *stream.warnings, *(one.text for one in beyond if one.text)]
    return stream.state, Remarks(warnings=warnings, notes=[*notes], findings=suspicions, beyond=beyond, rest=rest)


def _rest_offset(
    record: Path, model: "Calibration", opening: Opening, corrector: "Corrector", stretch: "Stretch"
) -> "RestOffset":
    """Return what the calibration leaves at a rest of a recording, of which no more is read than needed."""
    from undrift.correction.rest import find_rest_offset_in

    try:
        parts = (calibrated_part(read, model)[0] for read in opening.chunks(record))
        return find_rest_offset_in((corrector.push_checked(part).record for part in parts), stretch)
    except InputError as error:
        raise InputError(f"{record}: {error}", **error.numbers) from error


def _provenance(
    record: Path, *, calibration: Path, model: "Calibration", settings: dict[str, object]
) -> dict[str, object]:
    """Return what a corrected recording was made from and by, for the files that state it."""
    from undrift import __version__
    from undrift.files import sha256_of
    from undrift.io.store import content_hash

    inputs = [{"file": path.name, "sha256": sha256_of(path)} for path in (record, calibration) if path.is_file()]
    inputs += [] if calibration.is_file() else [{"file": str(calibration), "sha256": content_hash(model)}]
    return {
        "inputs": inputs,
        "calibration": {"created": model.provenance.created, "verdict": model.verdict.status},
        "settings": settings,
        "versions": {"undrift": __version__},
    }


def _suspicions(done: "Record", model: "Calibration") -> "tuple[Finding, ...]":
    """Return signs that other columns or another unit were read than meant."""
    from undrift.findings import finding
    from undrift.io.inspect import GRAVITY_RANGE, median_accel_g

    named = (("gyroscope", model.gyro, done.gyro), ("accelerometer", model.accel, done.accel))
    suspicions = [
        finding("correct.no_sensor", "warn", sensor=what)
        for what, triad, values in named
        if triad is not None and values is None
    ]
    median = median_accel_g(done)
    if median < GRAVITY_RANGE[0] or median > GRAVITY_RANGE[1]:
        suspicions.append(finding("correct.gravity", "warn", median_g=median))
    return tuple(suspicions)


def _rows(record: Path) -> int | None:
    from undrift.io.formats import detect
    from undrift.io.parquet import parquet_rows

    return parquet_rows(record) if detect(record) == "parquet" else None
