"""``undrift correct``: convert recordings of any size to rad/s and m/s2, in constant memory."""

from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import nullcontext, suppress
from contextvars import copy_context
from functools import partial
from pathlib import Path
from typing import Any, Literal

from undrift import __version__
from undrift.base.options import Output, Policy
from undrift.base.workers import threads
from undrift.calibration.triads import check_force
from undrift.commands.batch import each_recording
from undrift.commands.files import NamedRest, Opening, Reader, named_columns
from undrift.commands.outputs import check_output
from undrift.correction.consistency import check_corrected
from undrift.correction.correct import Corrector
from undrift.correction.coverage import REFERENCE_SPAN_C
from undrift.correction.plan import NOWHERE, Reach
from undrift.correction.rest import FOUND_IN_S, RemainingOffset, find_offset
from undrift.errors import InputError
from undrift.files import sha256_of
from undrift.findings import Finding, finding, told_apart
from undrift.io.column_map import naming
from undrift.io.formats import detect, iter_record
from undrift.io.parquet import ParquetWriter, parquet_rows
from undrift.io.symptoms import check_gravity, find_saturated
from undrift.io.write import RECORD_WRITERS, files_of, write_record_as
from undrift.model import Calibration
from undrift.orientation import check_whole
from undrift.record import Record, joined
from undrift.report import Report, Table
from undrift.report.figures import draw_record
from undrift.screen import progress, reading

READ = 0.8  # reported progress while a recording of unknown length is read
NOT_COVERED = ("outside", "extrapolated", "without_temperature")  # kinds of samples that the tuning tables do not cover


@each_recording(".parquet")
def correct(
    recording: Path,
    /,
    *,
    calibration: Path,
    output: Output,
    power_on_s: float | None = None,
    policy: Policy = "raise",
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
        calibration.json of the device, or a folder of calibrations: the newest one with the recording's serial number.
    output : Path
        File for a single recording: .parquet, .csv or .csv.gz. Parquet needs constant memory. Folder for several recordings, which
        is created if necessary.
    power_on_s : float or None
        Time since power-on at the first sample of each recording, s. Without it, no warm-up is subtracted.
    policy : str
        Temperatures outside a tuning table: refuse (raise), hold the table's end, or leave a gap (nan). Without a
        recorded temperature the result is always a gap, and a warning reports its duration.
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
    read_files = (recording, calibration if calibration.is_file() else None, opening.column_map)
    check_output(output, endings=tuple(RECORD_WRITERS), reads=read_files, beside=files_of(output)[1:])
    reader = Reader(opening, calibration, (recording,))
    model = reader.calibration[0]
    corrector = partial(Corrector, model, policy, power_on_s=power_on_s)
    remaining = None if offset == "none" else _remaining_offset(reader, recording, corrector(), offset, rest)
    reader.notes += [] if remaining is None else [item.text for item in remaining.findings]
    stream = corrector(offset=remaining)
    findings = _correct(
        reader, recording, output, stream, {"policy": policy, "power_on_s": power_on_s, "offset": offset}
    )
    reach = stream.state.reach
    counts = {
        f"{unit}_{kind}": getattr(reach, f"{unit}_{kind}") for unit in ("samples", "seconds") for kind in NOT_COVERED
    }
    return Report(
        title=f"Corrected: {recording.name}",
        answer=_answer(reach),
        tables=[_coverage(reach)],
        notes=list(dict.fromkeys(reader.notes)),
        findings=[*reader.findings, *findings],
        figures=[lambda: draw_record(next(iter_record(output)))],  # only the beginning of a long recording
        written=[output],
        data={"recording": str(recording), "samples": reach.samples, **counts, "rest": remaining and remaining.figures},
        next_command=() if model.gyro is None else _next_command(output),
    )


def _answer(reach: Reach) -> str:
    far, outside = reach.samples_extrapolated, reach.samples_outside + reach.samples_without_temperature
    if far or outside:
        shares = [f"{100.0 * count / reach.samples:.3g} %" for count in (far, outside)]
        covered = f"{shares[0]} of them with extrapolated tuning tables, {shares[1]} outside"
    elif reach.temp_c == NOWHERE:
        covered = "not compared with the temperature of the calibration: the recording or the calibration has none"
    elif reach.departure_c > REFERENCE_SPAN_C:
        covered = (
            f"up to {told_apart(reach.departure_c, '.1f', REFERENCE_SPAN_C)} K from the temperature of the calibration"
        )
    else:
        covered = "none outside the temperatures of the calibration"
    return f"{reach.samples} samples are in rad/s and m/s2, {covered}."


def _coverage(reach: Reach) -> Table:
    """Return the parts of the recording that the tuning tables do not cover."""
    rows = [
        (kind.replace("_", " "), count, getattr(reach, f"seconds_{kind}"))
        for kind in NOT_COVERED
        if (count := getattr(reach, f"samples_{kind}"))
    ]
    columns = ("reason", "samples", "time (s)")
    return Table(title="Not covered by the tuning tables", columns=columns, rows=rows, form=".1f")


def _next_command(output: Path) -> tuple[object, ...]:
    """Return the next command for a corrected recording, if its beginning is complete."""
    with suppress(InputError):
        check_whole(next(iter_record(output)))
        return ("orient", output, "-o", output.with_name("angles.csv"))
    return ()


def _correct(
    reader: Reader, recording: Path, output: Path, stream: Corrector, settings: dict[str, object]
) -> list[Finding]:
    """Correct a recording into a file, chunk by chunk if the format permits this. Return findings against the result."""
    findings, chunked = dict[tuple[object, ...], Finding](), output.name.endswith(".parquet")
    total = parquet_rows(recording) if detect(recording) == "parquet" else None
    with (
        reading(READ, recording),
        ParquetWriter(output) if chunked else nullcontext() as writer,
        threads(1) as pool,  # a second thread writes a chunk while the next one is corrected
    ):
        made_by = {} if writer else _made_by(reader, recording, settings)
        write = writer.write if writer else partial(write_record_as, path=output, made_by=made_by)
        written: Future[Any] = pool.submit(bool)
        for raw in read_ahead(reader.chunks(recording)) if chunked else (reader.read(recording),):
            chunk, is_first = reader.calibrated_part(raw), not stream.state.reach.samples
            corrected = stream.push_checked(chunk)
            signs = [*find_saturated(chunk), *(item for item in corrected.findings if item.code == "correct.device")]
            if is_first:  # the first chunk is enough
                with named_columns(recording):
                    check_force(corrected.record)
                    signs += _signs(corrected.record, reader.calibration[0], chunk)
            for item in signs:  # each finding once, over all chunks
                findings.setdefault((item.code, item.values.get("channel"), item.values.get("axis")), item)
            written.result()
            written = pool.submit(write, corrected.record)
            reader.notes += corrected.notes
            progress(recording.name, stream.state.reach.samples / total if total else READ)
        written.result()
    return [*findings.values(), *stream.findings]


def _made_by(reader: Reader, recording: Path, settings: dict[str, object]) -> dict[str, object]:
    """Return the origin of a corrected recording, which is written beside a CSV file."""
    model, path = reader.calibration
    return {
        "inputs": [{"file": file.name, "sha256": sha256_of(file)} for file in (recording, path) if file.is_file()],
        "calibration": {"created": model.provenance.created, "verdict": model.verdict.status},
        "settings": settings,
        "versions": {"undrift": __version__},
    }


def read_ahead(chunks: Iterator[Record]) -> Iterator[Record]:
    """Read the next chunk in a second thread while the caller processes the current chunk."""
    with threads(1) as pool:
        take = partial(next, chunks, None)
        coming = pool.submit(copy_context().run, take)  # the reading thread sees the progress of the caller
        while (chunk := coming.result()) is not None:
            coming = pool.submit(copy_context().run, take)
            yield chunk


def _remaining_offset(
    reader: Reader, recording: Path, corrector: Corrector, offset: Literal["rest", "motion"], rest: NamedRest
) -> RemainingOffset:
    """Return the offset that remains after the correction. For a rest, only the necessary readings are read."""
    corrected = list[Record]()
    with naming(recording):
        for raw in reader.chunks(recording):
            corrected.append(corrector.push_checked(reader.calibrated_part(raw)).record)
            last_s = rest.ends_s[1] if rest.ends_s else corrected[0].time[0] + FOUND_IN_S
            if offset == "rest" and corrected[-1].time[-1] >= last_s:
                break
        head = joined(corrected)
        return find_offset(head, offset, reader.calibration[0].gyro, rest.still_in(head))


def _signs(done: Record, model: Calibration, raw: Record) -> list[Finding]:
    """Return signs that the wrong columns, unit or calibration were used."""
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
    return [*check_corrected(done, model, raw), *missing, *check_gravity(done)]
