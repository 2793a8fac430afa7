"""``undrift validate FOLDER --trials trials.csv``: validate people, tasks and devices at each level of correction.

The table of trials has one row per recording. Columns: recording, person, task and device; reference, if the recording
does not contain a reference. Optional columns: calibration, map, sensor, reference_map, reference_up and markers, with
the values of the options. Paths are relative to the table.
"""

import csv
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

from undrift.base.options import Side
from undrift.commands.files import Opening, Optics, Reader
from undrift.errors import InputError, UndriftError
from undrift.files import read_bytes
from undrift.report import Report, Table
from undrift.report.figures import draw_level_errors
from undrift.report.validation import TRIAL, label_of, level_details, level_tables, levels_json
from undrift.screen import part, progress
from undrift.validation.levels import LevelTable, LevelTrial, calibrate_by_others, judge_levels
from undrift.validation.trial import TrialSettings

FILES = ("recording", "reference", "calibration", "map", "reference_map")
OPTIONAL = (*FILES[1:], "sensor", "reference_up", "markers")


def validate_people(
    folder: Path, name: Path, *, settings: TrialSettings, forward: Side | None, up: Side | None, opening: Opening
) -> tuple[Report, tuple[Path, ...]]:
    """Judge the recordings of a table in a folder, with strapdown and with VQF. Also return the files that were read."""
    table = folder / name
    if not table.is_file():
        raise InputError(
            f"validate: there is no {table}. Write one row per recording with the columns {', '.join(TRIAL)} and reference."
        )
    rows, trials = list(_rows(table)), list[LevelTrial]()
    _check_rows(table, rows)
    for k, row in enumerate(rows):
        progress(f"reading {row['recording']}", 0.3 * k / len(rows))
        trials.append(_trial(table, row, opening, forward, up))
    progress("fitting devices without a calibration", 0.3)
    trials = calibrate_by_others(trials, settings)
    with part(0.4, 1.0):
        levels = judge_levels(trials, settings=settings, methods=("strapdown", "vqf"), progress=progress)
    report = Report(
        title=f"Validation of people: {folder.resolve().name}",
        answer=_answer(levels),
        tables=level_tables(levels),
        details=[*level_details(levels), *_warnings(levels)],
        figures=[lambda: draw_level_errors(levels)],
        data=levels_json(levels),
    )
    files = (table, *(table.parent / row[column] for row in rows for column in FILES if row[column]))
    return report, tuple(dict.fromkeys(files))


def _answer(table: LevelTable) -> str:
    """Return the error before correction, and the smallest error among the levels with the most judged trials."""
    judged = [summary for summary in table.summaries if summary.group == "all" and summary.trials]
    most = max(summary.trials for summary in judged)
    first, best = judged[0], min((s for s in judged if s.trials == most), key=lambda summary: summary.mean_deg)
    before, after = (label_of(table, summary.level, summary.method) for summary in (first, best))
    low, high = best.interval_deg
    spread = f" [95 % {max(low, 0.0):.2f} to {high:.2f}]" if best.people > 1 else ""
    return (
        f"{table.quantity.capitalize()} error {first.mean_deg:.3g} deg {before}, {best.mean_deg:.2f} deg{spread} at the "
        f"best level ({after}); {best.people} people, {best.trials} trials."
    )


def _warnings(table: LevelTable) -> list[Table]:
    """Return the warnings of the trials, once per recording, with the first level at which they occur."""
    rows = dict[tuple[str, str], tuple[str, str, str]]()
    for errors in table.errors:
        for recording, item in errors.findings:
            rows.setdefault((recording, item.code), (Path(recording).name, errors.level, item.text))
    columns = ("recording", "level", "warning")
    return [Table(title="Warnings", columns=columns, rows=list(rows.values()))] if rows else []


# ---- the table of trials


def _rows(table: Path) -> Iterator[dict[str, str]]:
    """Yield the rows of the table. Each row has every possible column."""
    reader = csv.DictReader(read_bytes(table).decode("utf-8-sig", "replace").splitlines())
    heads = [head.strip() for head in reader.fieldnames or ()]
    lacking, unknown = [x for x in TRIAL if x not in heads], [x for x in heads if x not in (*TRIAL, *OPTIONAL)]
    if lacking or unknown:
        got = f"no {', '.join(lacking)}" if lacking else f"also {', '.join(unknown)}"
        raise InputError(
            f"{table}: expected columns {', '.join(TRIAL)}, and of {', '.join(OPTIONAL)}, got {got}. Correct the header line."
        )
    count = 0
    for line, row in enumerate(reader, start=2):
        cells = dict.fromkeys((*TRIAL, *OPTIONAL), "")
        cells |= {head.strip(): (value or "").strip() for head, value in row.items() if head}
        if missing := [name for name in TRIAL if not cells[name]]:
            raise InputError(
                f"{table}: {', '.join(missing)} is missing in line {line}. Fill it in, or delete the line."
            )
        count += 1
        yield cells
    if not count:
        raise InputError(f"{table}: expected a row for each recording, got none. Add the rows.")


def _check_rows(table: Path, rows: list[dict[str, str]]) -> None:
    """Raise for a repeated recording, which would be corrected with itself, and for a device with a calibration in only some
    rows."""
    names = [(row["recording"], row["sensor"]) for row in rows]
    if twice := sorted({name for name, _ in names if names.count((name, _)) > 1}):
        raise InputError(f"{table}: expected each recording once, got {twice[0]} in several rows. Keep one row.")
    for device in dict.fromkeys(row["device"] for row in rows):
        calibrated = [bool(row["calibration"]) for row in rows if row["device"] == device]
        if any(calibrated) and not all(calibrated):
            raise InputError(
                f"{table}: expected a calibration in every row of device {device} or in none, got {sum(calibrated)} of "
                f"{len(calibrated)}. Fill it in."
            )


def _trial(table: Path, row: dict[str, str], opening: Opening, forward: Side | None, up: Side | None) -> LevelTrial:
    """Read the recording, the reference and the calibration of a row."""
    paths = {name: table.parent / row[name] if row[name] else None for name in FILES}
    optics = Optics(
        reference=(paths["reference"],) if paths["reference"] else (),
        reference_map=paths["reference_map"],
        markers=row["markers"] or None,
        reference_up=cast("Any", row["reference_up"] or None),
    )
    how = replace(opening, column_map=paths["map"] or opening.column_map, sensor=row["sensor"] or opening.sensor)
    reader = Reader(how, paths["calibration"])
    try:
        ((record, reference),) = optics.pairs((cast("Path", paths["recording"]),), reader, command="validate")
    except UndriftError as error:
        raise InputError(f"{table}, {row['recording']}: {error}") from error
    return LevelTrial(
        recording=row["recording"],
        person=row["person"],
        task=row["task"],
        device=row["device"],
        record=record,
        reference=reference,
        calibration=reader.model,
        cluster=optics.of_cluster(),
        mounting=reader.mounting(forward, up),
    )
