"""``undrift correct``: many recordings, any size, constant memory."""

import math
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import nullcontext, suppress
from contextvars import copy_context
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, cast

from undrift.base.options import Files, Output, verb
from undrift.base.summary import Drawing, Result, Section, Summary, at, figure_of, number, rows_section
from undrift.commands import Progress, part_of, reading, silent
from undrift.commands.calibration_file import choose_calibration
from undrift.commands.files import (
    NamedRest,
    Opening,
    TableUse,
    calibrated_part,
    check_folder,
    check_output,
    name_of,
    named_columns,
)
from undrift.commands.old_batch import of_folder
from undrift.errors import InputError
from undrift.units import STANDARD_GRAVITY, si_factor

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from undrift.arrays import FloatArray
    from undrift.correction.correct import Corrector
    from undrift.correction.plan import Carry
    from undrift.correction.rest import RemainingOffset
    from undrift.findings import Finding
    from undrift.model import Calibration
    from undrift.record import Record, Still

READ = 0.8  # of a recording that is corrected once it is read as a whole
RESTS = "Each value is a mean, over the first 65,536 samples if Parquet is written. Raw counts use the mean scale and offset."
NOT_COVERED = ("outside", "extrapolated", "without_temperature")  # of the tuning tables


@dataclass(frozen=True, kw_only=True, eq=False)
class CorrectedFile:
    """A corrected recording, with information for its users."""

    record: Path
    output: Path
    state: "Carry"
    notes: tuple[str, ...]
    findings: "tuple[Finding, ...]"  # ranges that the calibration does not cover, and symptoms of a wrong reading
    rest: "RemainingOffset | None"  # subtracted offset, also in the notes
    # for each rest of the first chunk, |a|, m/s2, and |w|, deg/s, raw and corrected, (n, 2), and the rms of |a| - g and
    # of |w|
    rests: "list[FloatArray]"
    at_rest: dict[str, float]

    def row(self) -> dict[str, Any]:
        """Return the recording as JSON has it."""
        from undrift.io.store import findings_json

        keys = [f"{unit}_{kind}" for unit in ("samples", "seconds") for kind in NOT_COVERED]
        return {
            "recording": str(self.record),
            "output": str(self.output),
            "samples": self.state.reach.samples,
            **{key: getattr(self.state.reach, key) for key in keys},
            "rest": self.rest and self.rest.figures,
            "at_rest": self.at_rest,
            "notes": self.notes,
            "findings": findings_json(self.findings),
        }


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class CorrectedFiles(Result):
    """Corrected recordings."""

    calibration: Path
    model: "Calibration"
    files: tuple[CorrectedFile, ...]
    notes: tuple[str, ...] = ()  # which calibration was taken from a folder

    @property
    def _next_command(self) -> tuple[object, ...]:
        """Return the next commands for a corrected recording, if its beginning is complete."""
        from undrift.io.formats import iter_record
        from undrift.orientation import check_whole

        output = self.files[0].output
        with suppress(InputError):
            check_whole(next(iter_record(output)))
            return ("orient", output, "-o", output.with_name("angles.csv"))
        return ()

    def summary(self) -> Summary:
        """Return how much of each recording the calibration covers, with warnings and notes."""
        from undrift.io.store import findings_json, verdict_json

        findings = tuple(item for file in self.files for item in file.findings)
        rows, several, verdict = [file.row() for file in self.files], len(self.files) > 1, self.model.verdict
        samples, far = (sum(row[key] for row in rows) for key in ("samples", "samples_extrapolated"))
        outside = sum(row["samples_outside"] + row["samples_without_temperature"] for row in rows)
        covered = "none outside the temperatures of the calibration"
        if far or outside:
            shares = [f"{100.0 * count / samples:.3g} %" for count in (far, outside)]
            covered = f"{shares[0]} of them where the tuning tables are extrapolated, {shares[1]} outside"
        keys = ("samples", *(f"samples_{kind}" for kind in NOT_COVERED))
        remarks = tuple(
            f"{file.record.name}, {what}: {text}" if several else f"{what}: {text}"
            for file in self.files
            for what, texts in (("warning", [warning.text for warning in file.findings]), ("note", file.notes))
            for text in texts
        )
        rests = figure_of("calibration:draw_rests", *self.files[0].rests, _gravity(self.model))
        corrected = Drawing(place="undrift.commands.correct:draw_corrected", of=(self.files[0].output,))
        return Summary(
            title=f"Corrected: {self.files[0].record.name}" + (f" and {len(rows) - 1} more" if several else ""),
            answer=f"{samples} samples are in rad/s and m/s2, {covered}.",
            data={"calibration": str(self.calibration), "recordings": rows, "notes": self.notes}
            | {"verdict": verdict_json(verdict), "findings": findings_json(findings)},
            pictures=(rests, corrected) if self.files[0].at_rest["rests"] else (corrected,),
            sections=(
                rows_section("Rests, raw -> corrected (rms)", [*map(_rests_row, self.files)], text=(RESTS,)),
                Section(
                    title="Recordings",
                    columns=("recording", "output", "samples", "outside tables", "extrapolated", "without temperature"),
                    rows=tuple(
                        (file.record.name, file.output.name, *(str(row[key]) for key in keys))
                        for file, row in zip(self.files, rows, strict=True)
                    ),
                ),
                Section(title="Warnings and notes", text=remarks),
            ),
            verdict=verdict,
            judged="the calibration",
            findings=findings,
            brief=True,
            notes=self.notes,
            written=tuple(file.output for file in self.files),
            next=() if several or self.model.gyro is None else self._next_command,
        )


def draw_corrected(path: Path) -> Any:
    """Draw a corrected recording, or its beginning where it is long."""
    from undrift.io.formats import iter_record

    return at("undrift.report.figures:draw_record")(next(iter_record(path)))


@verb
@of_folder(".parquet")
def correct(
    *records: Files,
    calibration: Path,
    output: Output,
    applying: TableUse = TableUse(),
    offset: Literal["none", "rest", "motion"] = "none",
    named: NamedRest = NamedRest(),
    opening: Opening = Opening(),
    scheduler: str | None = None,
    progress: Progress = silent,
) -> CorrectedFiles:
    """Convert raw recordings to rad/s and m/s2. The ending of the output selects the format. Parquet needs constant
    memory.

    Parameters
    ----------
    records : Path
        One or more recordings of the calibrated device, or a folder of them.
    calibration : Path
        calibration.json of the device, or a folder of calibrations: the newest one of the recording's serial number.
    output : Path
        File for a single recording: .parquet, .csv or .csv.gz. Folder for several recordings, created if it is missing.
    offset : str
        "rest" also subtracts the mean rate that remains at the first (or the named) still phase, like `offset` of
        orient. With tables, it removes the offset that they cannot model. "motion" starts from that rest, if there is
        one, and estimates the offset from gravity while the device moves. The whole recording is then in memory.
    scheduler : str or None
        Address of a Dask scheduler, for example tcp://host:8786. Each worker processes a recording. The workers need
        access to the same files.
    """
    from undrift.correction.correct import Corrector

    if offset == "none" and named.rest_s is not None:
        raise InputError("`rest_s` requires `offset` rest or motion: add it, or omit `rest_s`")
    chosen = choose_calibration(calibration, records, opening)
    model, calibration = cast("Calibration", chosen.model), cast("Path", chosen.path)
    targets = targets_of(records, output, (calibration, opening.column_map))
    folder = targets[0].parent
    opening = opening.like(model, calibration)
    created = not folder.exists()
    folder.mkdir(exist_ok=True)
    corrector = partial(Corrector, model, applying.policy, power_on_s=applying.power_on_s)
    settings: dict[str, object] = {"policy": applying.policy, "power_on_s": applying.power_on_s, "offset": offset}
    made_by = partial(_provenance, calibration=calibration, model=model, settings=settings)
    find_offset = None if offset == "none" else partial(_remaining_offset, offset=offset, named=named)
    corrected = partial(
        _correct_one, corrector=corrector, model=model, opening=opening, made_by=made_by, find_offset=find_offset
    )
    try:
        files = _correct_all(records, targets, corrected, scheduler, progress)
    except BaseException:
        if created:
            folder.rmdir()
        raise
    return CorrectedFiles(calibration=calibration, model=model, files=files, notes=chosen.notes)


def _correct_all(
    records: tuple[Path, ...],
    targets: list[Path],
    correct_one: "Callable[..., CorrectedFile]",
    scheduler: str | None,
    progress: Progress,
) -> tuple[CorrectedFile, ...]:
    """Correct into a hidden folder next to the targets. The targets appear when all are complete."""
    from undrift.files import hidden_folder, take_names

    with hidden_folder(targets[0].parent) as hidden:
        jobs, done = (
            [(record, hidden / corrected.name) for record, corrected in zip(records, targets, strict=True)],
            dict[int, CorrectedFile](),
        )
        if scheduler is not None:
            from undrift.study.run import executor

            there = [(record.resolve(), target.resolve()) for record, target in jobs]  # workers run in other folders
            with executor(None, scheduler) as spread:
                for place, corrected in enumerate(spread(correct_one, there)):
                    done[place] = corrected
                    progress(records[place].name, len(done) / len(jobs))
        else:
            for k, job in enumerate(jobs):
                done[k] = correct_one(job, progress=part_of(progress, k / len(jobs), (k + 1) / len(jobs)))
        take_names(
            {hidden.parent / target.name: target for target in sorted(hidden.iterdir())}
        )  # and their sidecar files
    return tuple(replace(done[k], record=record, output=targets[k]) for k, record in enumerate(records))


def targets_of(records: tuple[Path, ...], output: Path, read: tuple[Path | None, ...]) -> list[Path]:
    """Return the file that each recording is written to."""
    from undrift.io.write import RECORD_WRITERS, files_of

    endings = tuple(RECORD_WRITERS)
    if len(records) == 1 and output.name.lower().endswith(endings):
        targets = [output]
    else:
        if output.suffix and not output.is_dir():
            ending_text = f"a name ending in {', '.join(endings[:-1])} or {endings[-1]}"
            wanted = "a folder for several recordings" if len(records) > 1 else ending_text
            raise InputError(f"output: expected {wanted}, got {output}. Correct the name.")
        check_folder(output)
        targets = [output / (name_of(record) + ".parquet") for record in records]
    doubled = sorted({t.name for t in targets if targets.count(t) > 1})
    if doubled:
        raise InputError(
            f"output: several recordings would be written to {', '.join(doubled)}. Correct them in separate runs."
        )
    if output in targets or output.is_dir():
        for target in targets:
            check_output(target, endings=endings, reads=(*records, *read), beside=files_of(target)[1:])
    return targets


def _correct_one(
    job: tuple[Path, Path],
    *,
    corrector: "Callable[..., Corrector]",
    model: "Calibration",
    opening: Opening,
    made_by: "Callable[[Path], dict[str, object]]",
    find_offset: "Callable[..., RemainingOffset] | None",
    progress: Progress = silent,
) -> CorrectedFile:
    """Correct a recording into a file, chunk by chunk where the file takes chunks."""
    from undrift.calibration.triads import check_force
    from undrift.correction.consistency import check_corrected
    from undrift.io.formats import detect
    from undrift.io.inspect import find_saturated
    from undrift.io.parquet import ParquetWriter, parquet_rows
    from undrift.io.write import write_record_as

    (record, target), stream, notes, rest = job, corrector(), dict[str, None](), None
    if find_offset is not None:
        rest = find_offset(record, model, opening, corrector())
        stream, notes = corrector(offset=rest), {item.text: None for item in rest.findings}
    suspicions: tuple[Finding, ...] = ()
    saturated: dict[object, Finding] = {}  # by channel and axis, over all chunks
    unchunked, total = (
        not target.name.endswith(".parquet"),
        parquet_rows(record) if detect(record) == "parquet" else None,
    )
    with (
        reading(progress, READ, record),
        nullcontext() if unchunked else ParquetWriter(target) as writer,
        ThreadPoolExecutor(1) as pool,  # writes a chunk while the next chunk is corrected
    ):
        write = writer.write if writer else partial(write_record_as, path=target, made_by=made_by(record))
        written: Future[Any] = pool.submit(bool)
        for read in (opening.read(record),) if unchunked else read_ahead(opening.chunks(record)):
            chunk, left_out = calibrated_part(read, model)
            for saturation in find_saturated(chunk):
                saturated.setdefault((saturation.values["channel"], saturation.values["axis"]), saturation)
            done = stream.push_checked(chunk)
            if stream.state.reach.samples == len(chunk):  # the first chunk is enough
                with named_columns(record):
                    check_force(done.record)
                    suspicions = (*check_corrected(done.record, model, chunk), *_suspicions(done.record, model))
                suspicions += tuple(saturation for saturation in done.findings if saturation.code == "correct.device")
                rests, rms = _compare_rests(chunk, done.record, model)
            written.result()
            written = pool.submit(write, done.record)
            notes.update(dict.fromkeys((*left_out, *done.notes)))
            progress(record.name, stream.state.reach.samples / total if total else READ)
        written.result()
    suspicions = (
        *saturated.values(),
        *(saturation for saturation in suspicions if saturation.code != "recording.saturated"),
    )
    findings = (*suspicions, *stream.findings)
    return CorrectedFile(
        record=record, output=target, state=stream.state, notes=tuple(notes), findings=findings,
        rest=rest, rests=rests, at_rest=rms,
    )  # fmt: skip


def read_ahead(chunks: "Iterator[Record]") -> "Iterator[Record]":
    """Read the next chunk in a second thread while the caller processes the current chunk."""
    with ThreadPoolExecutor(1) as pool:
        take = partial(next, chunks, None)
        coming = pool.submit(copy_context().run, take)  # the reading thread sees the progress of the caller
        while (chunk := coming.result()) is not None:
            coming = pool.submit(copy_context().run, take)
            yield chunk


def _gravity(model: "Calibration") -> float:
    return model.gravity_m_s2 if math.isfinite(model.gravity_m_s2) else STANDARD_GRAVITY


def _compare_rests(raw: "Record", done: "Record", model: "Calibration") -> "tuple[list[FloatArray], dict[str, float]]":
    """Return |a|, m/s2, and |w|, deg/s, in the mean of each rest, raw and corrected, (n, 2). Also return their rms from
    g, mg, and 0.
    """
    import numpy as np

    from undrift.commands.calibrate import raw_and_corrected
    from undrift.segments import find_still

    stills, sizes, rms = tuple["Still", ...](), list["FloatArray"](), dict[str, float]()
    with suppress(InputError):  # shorter than a window
        stills = find_still(done).stills
    ideals = {"accel": ("accel_mg", _gravity(model), si_factor("mg", "accel")), "gyro": ("rate_dps", 0.0, 1.0)}
    for name, (key, ideal, unit) in ideals.items():
        triads = [values for values in (getattr(raw, name), getattr(done, name)) if values is not None]
        means = [[values[still.start : still.stop].mean(axis=0) for still in stills] for values in triads] or [[], []]
        both = raw_and_corrected(getattr(model, name), getattr(raw, f"{name}_unit"), *means)
        sizes.append(both := both[np.isfinite(both).all(axis=1)])
        away = np.sqrt(((both - ideal) ** 2).mean(axis=0)) / unit if len(both) else (np.nan, np.nan)
        rms |= {f"raw_{key}": float(away[0]), key: float(away[1])}
    return sizes, {"rests": max(map(len, sizes))} | rms


def _rests_row(file: CorrectedFile) -> dict[str, str]:
    """Return the readings of a recording at its rests, raw -> corrected, or dashes without rests."""
    cells = {"recording": file.record.name, "rests": str(file.at_rest["rests"])}
    for head, key in (("|a| - g (mg)", "accel_mg"), ("rate (deg/s)", "rate_dps")):
        cells[head] = " -> ".join(number(file.at_rest[name], ".3g") for name in (f"raw_{key}", key))
    return cells


def _remaining_offset(
    record: Path,
    model: "Calibration",
    opening: Opening,
    corrector: "Corrector",
    *,
    offset: Literal["rest", "motion"],
    named: NamedRest,
) -> "RemainingOffset":
    """Return the remaining offset of a corrected recording. At a rest, only as many readings are read as needed."""
    from undrift.correction.rest import FOUND_IN_S, find_offset
    from undrift.io.column_map import naming
    from undrift.record import joined

    corrected, stop_s = list["Record"](), named.stop_s
    with naming(record):
        for read in opening.chunks(record):
            corrected.append(corrector.push_checked(calibrated_part(read, model)[0]).record)
            searched_to = stop_s or corrected[0].time[0] + FOUND_IN_S
            if offset == "rest" and corrected[-1].time[-1] >= searched_to:
                break
        head = joined(corrected)
        return find_offset(head, offset, model.gyro, named.still_in(head))


def _provenance(
    record: Path, *, calibration: Path, model: "Calibration", settings: dict[str, object]
) -> dict[str, object]:
    """Return the provenance of a corrected recording, for the files that store it."""
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
    from undrift.io.inspect import check_gravity

    triads = (("gyroscope", model.gyro, done.gyro), ("accelerometer", model.accel, done.accel))
    suspicions = [
        finding("correct.sensors_differ", "warn", what=f"no {what} in the recording. Check the names of the columns.")
        for what, triad, values in triads
        if triad is not None and values is None
    ]
    return (*suspicions, *check_gravity(done))
