"""``undrift correct``: recordings in rad/s and m/s2, of any size, in constant memory."""

from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import nullcontext, suppress
from contextvars import copy_context
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

from undrift import __version__
from undrift.base.options import Output
from undrift.base.workers import threads
from undrift.calibration.triads import check_force
from undrift.commands.batch import each_recording
from undrift.commands.calibration_file import choose_calibration
from undrift.commands.files import (
    NamedRest,
    Opening,
    TableUse,
    calibrated_part,
    calibration_findings,
    check_output,
    named_columns,
)
from undrift.correction.consistency import check_corrected
from undrift.correction.correct import Corrector
from undrift.correction.plan import Carry
from undrift.correction.rest import FOUND_IN_S, RemainingOffset, find_offset
from undrift.errors import InputError
from undrift.files import sha256_of
from undrift.findings import Finding, finding
from undrift.io.column_map import naming
from undrift.io.formats import detect, iter_record
from undrift.io.parquet import ParquetWriter, parquet_rows
from undrift.io.store import content_hash
from undrift.io.symptoms import check_gravity, find_saturated
from undrift.io.write import RECORD_WRITERS, files_of, write_record_as
from undrift.model import Calibration
from undrift.orientation import check_whole
from undrift.record import Record, joined
from undrift.report import Report, Table
from undrift.report.figures import draw_record
from undrift.screen import progress, reading

READ = 0.8  # share of the time when a recording without a known length is read
NOT_COVERED = ("outside", "extrapolated", "without_temperature")  # of the tuning tables


@dataclass(frozen=True, slots=True, kw_only=True)
class Done:
    """A corrected recording: its coverage by the tables, findings and notes."""

    state: Carry
    findings: tuple[Finding, ...]
    notes: tuple[str, ...]


@each_recording(".parquet")
def correct(
    recording: Path,
    /,
    *,
    calibration: Path,
    output: Output,
    applying: TableUse = TableUse(),
    offset: Literal["none", "rest", "motion"] = "none",
    rest: NamedRest = NamedRest(),
    opening: Opening = Opening(),
    scheduler: str | None = None,
) -> Report:
    """Convert raw recordings to rad/s and m/s2. The ending of the output selects the format.

    Parameters
    ----------
    recording : Path
        One or more recordings of the calibrated device, or a folder of them.
    calibration : Path
        calibration.json of the device, or a folder of calibrations: the newest one of the recording's serial number.
    output : Path
        File for a single recording: .parquet, .csv or .csv.gz. Parquet needs constant memory. Folder for several
        recordings, created if it is missing.
    offset : str
        "rest" also subtracts the mean rate that remains at the first (or the named) still phase, like `offset` of
        orient. With tables, it removes the offset that they cannot model. "motion" starts from that rest, if there is
        one, and estimates the offset from gravity while the device moves. The whole recording is then in memory.
    scheduler : str or None
        Address of a Dask scheduler, for example tcp://host:8786, for several recordings. Each worker processes a
        recording. The workers need access to the same files.
    """
    if offset == "none" and rest.rest_s is not None:
        raise InputError("`rest_s` requires `offset` rest or motion. Add it, or omit `rest_s`.")
    check_output(
        output,
        endings=tuple(RECORD_WRITERS),
        reads=(recording, calibration if calibration.is_file() else None, opening.column_map),
        beside=files_of(output)[1:],
    )
    chosen = choose_calibration(calibration, (recording,), opening)
    model, path = chosen.model, chosen.path
    if model is None or path is None:
        raise InputError(f"{calibration}: expected a calibration, got none. Name a calibration.json.")
    opening = opening.like(model, path)
    corrector = partial(Corrector, model, applying.policy, power_on_s=applying.power_on_s)
    remaining = None
    if offset != "none":
        remaining = _remaining_offset(recording, model, opening, corrector(), offset=offset, rest=rest)
    stream = corrector() if remaining is None else corrector(offset=remaining)
    settings = {"policy": applying.policy, "power_on_s": applying.power_on_s, "offset": offset}
    done = _correct(recording, output, model, opening, stream, _provenance(recording, path, model, settings))
    notes = (*chosen.notes, *(item.text for item in (remaining.findings if remaining else ())), *done.notes)
    return Report(
        title=f"Corrected: {recording.name}",
        answer=_answer(done.state),
        tables=[_coverage(done.state)],
        notes=list(dict.fromkeys(notes)),
        findings=[*calibration_findings(model), *done.findings],
        figures=[lambda: draw_record(next(iter_record(output)))],  # the beginning of a long one
        written=[output],
        data={
            "recording": str(recording),
            "samples": done.state.reach.samples,
            **{
                f"{unit}_{kind}": getattr(done.state.reach, f"{unit}_{kind}")
                for unit in ("samples", "seconds")
                for kind in NOT_COVERED
            },
            "rest": remaining and remaining.figures,
        },
        next_command=() if model.gyro is None else _next_command(output),
    )


def _answer(state: Carry) -> str:
    reach = state.reach
    far, outside = reach.samples_extrapolated, reach.samples_outside + reach.samples_without_temperature
    covered = "none outside the temperatures of the calibration"
    if far or outside:
        shares = [f"{100.0 * count / reach.samples:.3g} %" for count in (far, outside)]
        covered = f"{shares[0]} of them where the tuning tables are extrapolated, {shares[1]} outside"
    return f"{reach.samples} samples are in rad/s and m/s2, {covered}."


def _coverage(state: Carry) -> Table:
    """Return how much of the recording the tuning tables do not cover."""
    reach = state.reach
    rows = [
        (kind.replace("_", " "), getattr(reach, f"samples_{kind}"), getattr(reach, f"seconds_{kind}"))
        for kind in NOT_COVERED
        if getattr(reach, f"samples_{kind}")
    ]
    return Table(
        title="Not covered by the tuning tables", columns=("reason", "samples", "time (s)"), rows=rows, form=".1f"
    )


def _next_command(output: Path) -> tuple[object, ...]:
    """Return the next command for a corrected recording, if its beginning is complete."""
    with suppress(InputError):
        check_whole(next(iter_record(output)))
        return ("orient", output, "-o", output.with_name("angles.csv"))
    return ()


def _correct(
    recording: Path, output: Path, model: Calibration, opening: Opening, stream: Corrector, made_by: dict[str, object]
) -> Done:
    """Correct a recording into a file, chunk by chunk where the file takes chunks."""
    notes, signs = dict[str, None](), tuple[Finding, ...]()
    saturated = dict[object, Finding]()  # by channel and axis, over all chunks
    chunked = output.name.endswith(".parquet")
    total = parquet_rows(recording) if detect(recording) == "parquet" else None
    with (
        reading(READ, recording),
        ParquetWriter(output) if chunked else nullcontext() as writer,
        threads(1) as pool,  # writes a chunk while the next chunk is corrected
    ):
        write = writer.write if writer else partial(write_record_as, path=output, made_by=made_by)
        written: Future[Any] = pool.submit(bool)
        for read in read_ahead(opening.chunks(recording)) if chunked else (opening.read(recording),):
            chunk, removed = calibrated_part(read, model)
            for item in find_saturated(chunk):
                saturated.setdefault((item.values["channel"], item.values["axis"]), item)
            corrected = stream.push_checked(chunk)
            if stream.state.reach.samples == len(chunk):  # the first chunk is enough
                with named_columns(recording):
                    check_force(corrected.record)
                    signs = (*check_corrected(corrected.record, model, chunk), *_signs(corrected.record, model))
            signs += tuple(item for item in corrected.findings if item.code == "correct.device")
            written.result()
            written = pool.submit(write, corrected.record)
            notes.update(dict.fromkeys((*removed, *corrected.notes)))
            progress(recording.name, stream.state.reach.samples / total if total else READ)
        written.result()
    signs = tuple(item for item in signs if item.code != "recording.saturated")
    return Done(state=stream.state, findings=(*saturated.values(), *signs, *stream.findings), notes=tuple(notes))


def read_ahead(chunks: Iterator[Record]) -> Iterator[Record]:
    """Read the next chunk in a second thread while the caller processes the current chunk."""
    with threads(1) as pool:
        take = partial(next, chunks, None)
        coming = pool.submit(copy_context().run, take)  # the reading thread sees the progress of the caller
        while (chunk := coming.result()) is not None:
            coming = pool.submit(copy_context().run, take)
            yield chunk


def _remaining_offset(
    recording: Path,
    model: Calibration,
    opening: Opening,
    corrector: Corrector,
    *,
    offset: Literal["rest", "motion"],
    rest: NamedRest,
) -> RemainingOffset:
    """Return the offset that remains after the correction. For a rest, only the necessary readings are read."""
    corrected, stop_s = list[Record](), rest.stop_s
    with naming(recording):
        for read in opening.chunks(recording):
            corrected.append(corrector.push_checked(calibrated_part(read, model)[0]).record)
            last_s = stop_s or corrected[0].time[0] + FOUND_IN_S
            if offset == "rest" and corrected[-1].time[-1] >= last_s:
                break
        head = joined(corrected)
        return find_offset(head, offset, model.gyro, rest.still_in(head))


def _provenance(recording: Path, calibration: Path, model: Calibration, settings: dict[str, Any]) -> dict[str, object]:
    """Return the provenance of a corrected recording, for the files that store it."""
    inputs = [{"file": path.name, "sha256": sha256_of(path)} for path in (recording, calibration) if path.is_file()]
    inputs += [] if calibration.is_file() else [{"file": str(calibration), "sha256": content_hash(model)}]
    return {
        "inputs": inputs,
        "calibration": {"created": model.provenance.created, "verdict": model.verdict.status},
        "settings": settings,
        "versions": {"undrift": __version__},
    }


def _signs(done: Record, model: Calibration) -> tuple[Finding, ...]:
    """Return signs that other columns or another unit were read than meant."""
    triads = (("gyroscope", model.gyro, done.gyro), ("accelerometer", model.accel, done.accel))
    missing = [
        finding(
            "correct.sensors_differ",
            "warn",
            f"The recording has no {name}, and the calibration has one.",
            "Check the names of the columns.",
        )
        for name, triad, values in triads
        if triad is not None and values is None
    ]
    return (*missing, *check_gravity(done))
