"""Levels of correction for ``undrift validate --compare`` and ``undrift validate FOLDER --trials trials.csv``.

The table of trials has a row per recording. Columns: recording, person, task and device; reference, if the recording
does not contain a reference. Optional columns: calibration, map, sensor, reference_map, reference_up and markers, with
the values of the options. Paths are relative to the table.
"""

import csv
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from undrift import __version__
from undrift.base.options import Side
from undrift.base.summary import Result, Section, Summary, at, figure_of, interval, number, plain
from undrift.commands import Progress, part_of
from undrift.commands.files import Opening, Optics, origin_of, save_json, worn_by
from undrift.errors import InputError, UndriftError
from undrift.files import read_bytes

if TYPE_CHECKING:
    from undrift.validation.levels import LevelSummary, LevelTable, LevelTrial
    from undrift.validation.trial import TrialSettings


NEEDED = ("recording", "person", "task", "device")
FILES = ("recording", "reference", "calibration", "map", "reference_map")
OPTIONAL = (*FILES[1:], "sensor", "reference_up", "markers")
METHODS = {"strapdown": "gyroscopes", "vqf": "VQF"}

# ---- sections


def label_of(table: "LevelTable", level: str, method: str) -> str:
    """Return the label of a row: the level, with the method if there are two."""
    methods = {errors.method for errors in table.errors}
    return f"{level}, {METHODS[method]}" if len(methods) > 1 else level


def levels_sections(table: "LevelTable") -> tuple[Section, ...]:
    """Return the errors at each level of correction over all trials, and their details."""
    groups = list(dict.fromkeys(summary.group for summary in table.summaries))
    sections = [_errors_section(table, "all"), _warnings(table), _agreement(table), _simulated_section(table)]
    sections += [replace(_errors_section(table, group), on="page") for group in groups[1:]]
    return (*(section for section in sections if section.rows or section.text), _trials(table))


def _errors_section(table: "LevelTable", group: str) -> Section:
    rows = list[tuple[str, ...]]()
    for summary in table.summaries:
        if summary.group != group or not summary.trials:
            continue
        low, high = summary.interval_deg
        spread = f"{max(low, 0.0):.2f} to {high:.2f}" if summary.people > 1 else "–"
        decision = summary.decision
        less = (
            (number(decision.difference), interval(decision.interval, ".2f"), decision.verdict)
            if decision
            else ("–",) * 3
        )
        rows.append(
            (
                label_of(table, summary.level, summary.method),
                f"{summary.people} ({summary.trials})",
                number(summary.mean_deg),
                spread,
                number(summary.median_deg),
                *less,
            )
        )
    missing = dict.fromkeys(
        f"{label_of(table, row.level, row.method)}: {row.missing}" for row in table.errors if row.missing
    )
    heads = ("level", "people (trials)", "error (deg)", "95 %", "median trial", "less than above", "95 %", "verdict")
    text = (
        f"{table.quantity} error, root mean square over the motion, mean over people. Each level is compared with the level above "
        f"it: better, equivalent or worse by a margin of {table.margin_deg:g} deg, at 5 % over all levels, from three people on.",
        *(missing if group == "all" else ()),
    )
    title = "Levels of correction" if group == "all" else f"Levels of correction, {group}"
    return Section(title=title, columns=heads, rows=tuple(rows), text=text)


def _warnings(table: "LevelTable") -> Section:
    """Return the warnings of the trials, once for each recording, with the first level that has it."""
    texts = dict[tuple[str, str], str]()
    for errors in table.errors:
        for recording, item in errors.findings:
            texts.setdefault((recording, item.code), f"{Path(recording).name}, {errors.level}: {item.text}")
    return Section(title="Warnings", text=tuple(texts.values()))


def _agreement(table: "LevelTable") -> Section:
    """Return the agreement with the optics, for levels and groups with ten people or more."""
    rows = list[tuple[str, ...]]()
    best: LevelSummary | None = None
    for summary in table.summaries:
        limits, icc = summary.agreement, summary.icc
        if limits is None:
            continue
        cells = (
            (f"{icc.value:.3f}", interval(icc.interval), number(icc.minimal_detectable_change)) if icc else ("–",) * 3
        )
        bias = f"{round(limits.bias, 2) + 0.0:+.2f}"
        name = label_of(table, summary.level, summary.method)
        rows.append((summary.group, name, str(limits.count), bias, interval(limits.limits, "+.2f"), *cells))
        if summary.group == "all" and (best is None or summary.mean_deg < best.mean_deg):
            best = summary
    heads = ("group", "level", "people", "bias (deg)", "95 % limits", "ICC(2,1)", "95 %", "MDC95 (deg)")
    text = (
        f"Agreement of device and optics on the {table.measure}, one mean per person, for ten people or more. The "
        f"columns are Bland "
        "and Altman's limits, ICC(2,1) within a single task, and the smallest change that "
        "exceeds measurement error. An ICC depends "
        "on how much the people differ.",
    )
    if best is None:
        return Section(title="Agreement with the optics")
    picture = figure_of("figures:draw_people_agreement", table, best)
    return Section(title="Agreement with the optics", columns=heads, rows=tuple(rows), text=text, pictures=(picture,))


def _simulated_section(table: "LevelTable") -> Section:
    """Return the errors of the actual and the simulated device next to each other."""
    import numpy as np

    from undrift.validation.levels import NOTE_DIFFERENCE_DEG

    rows = list[tuple[str, ...]]()
    for errors in table.errors:
        both = np.isfinite(errors.difference_deg)
        if both.any():
            means = [number(x[both].mean()) for x in (errors.error_deg, errors.simulated_deg, errors.difference_deg)]
            within = f"{(errors.difference_deg[both] <= NOTE_DIFFERENCE_DEG).sum()} of {both.sum()}"
            name = label_of(table, errors.level, errors.method)
            rows.append((name, *means, number(errors.difference_deg[both].max()), within))
    heads = ("level", "actual (deg)", "simulated", "difference", "most", f"within {NOTE_DIFFERENCE_DEG:g} deg")
    text = (
        "simulated: a device with this calibration, in the motion of the reference, corrected in the same way. "
        "difference: "
        "largest difference between the two errors of a trial, mean and maximum. The limit of the "
        "application note is "
        f"{NOTE_DIFFERENCE_DEG:g} deg over 4 s.",
    )
    return Section(title="Simulated against actual", columns=heads, rows=tuple(rows), text=text if rows else ())


def _trials(table: "LevelTable") -> Section:
    labelled = any(trial.person or trial.task or trial.device for trial in table.trials)
    names = NEEDED if labelled else NEEDED[:1]
    heads = (*names, *(label_of(table, errors.level, errors.method) for errors in table.errors))
    rows = (
        (*(getattr(trial, name) for name in names), *(number(float(errors.error_deg[k])) for errors in table.errors))
        for k, trial in enumerate(table.trials)
    )
    return Section(title=f"{table.quantity} error of each trial (deg)", columns=heads, rows=tuple(rows), folded=True)


def levels_json(table: "LevelTable") -> dict[str, Any]:
    """Return the levels of correction for JSON."""
    from undrift.io.store import findings_json

    errors = list[dict[str, Any]]()
    for row in table.errors:
        items = findings_json([item for _, item in row.findings])
        findings = [{"recording": pair[0], **item} for pair, item in zip(row.findings, items, strict=True)]
        errors.append(asdict(replace(row, findings=())) | {"findings": findings})
    return {
        "quantity": table.quantity,
        "measure": table.measure,
        "margin_deg": table.margin_deg,
        "trials": [{name: getattr(trial, name) for name in NEEDED} for trial in table.trials],
        "summaries": [asdict(summary) for summary in table.summaries],
        "errors": errors,
    }


# ---- validate FOLDER --trials trials.csv


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class PeopleValidated(Result):
    """Trials of people, judged at each level of correction."""

    folder: Path
    table: "LevelTable"
    output: Path | None = None

    def summary(self) -> Summary:
        """Return the answer, tables for all trials, tasks and devices, agreement, and a paragraph of methods."""
        methods = Section(title="Methods, to cite", text=(self.methods(),), on="page")
        return Summary(
            title=f"Validation of people: {self.folder.resolve().name}",
            answer=self._answer(),
            data=self.data,
            pictures=(figure_of("figures:draw_level_errors", self.table),),
            sections=(*levels_sections(self.table), methods),
            written=() if self.output is None else (self.output / "levels.json", self.output / "report.html"),
        )

    @property
    def data(self) -> dict[str, Any]:
        """Content of the JSON output and of levels.json."""
        return levels_json(self.table) | {"methods": self.methods()}

    def _answer(self) -> str:
        table = self.table
        every = [summary for summary in table.summaries if summary.group == "all" and summary.trials]
        complete = [summary for summary in every if summary.trials == max(candidate.trials for candidate in every)]
        first, best = every[0], min(complete, key=lambda summary: summary.mean_deg)
        low, high = best.interval_deg
        spread = f" [95 % {max(low, 0.0):.2f} to {high:.2f}]" if best.people > 1 else ""
        names = [label_of(table, candidate.level, candidate.method) for candidate in (best, first)]
        return (
            f"least of {len(complete)} levels, {names[0]}: {table.quantity} error {best.mean_deg:.2f} deg{spread}, {names[1]} "
            f"{first.mean_deg:.2f}; {best.people} people, {best.trials} trials"
        )

    def methods(self) -> str:
        """Return a paragraph about the methods, for a paper."""
        table = self.table
        people, tasks, devices = (len({getattr(trial, name) for trial in table.trials}) for name in NEEDED[1:])
        corrected_otherwise = sum(trial.left_out or trial.calibration is None for trial in table.trials)
        count = len(table.trials) - corrected_otherwise
        calibrated = f"{count} recordings were corrected with an earlier calibration of their device"
        if corrected_otherwise:
            calibrated += f", {corrected_otherwise} with a fit to the other recordings of their device (leave-one-out)"
        return (
            f"{len(table.trials)} recordings of {people} people in {tasks} tasks with {devices} inertial sensors were "
            f"compared with optical motion capture by undrift {__version__}. {calibrated}. The offset of the gyroscopes was taken "
            "from the calibration, from the first rest, or from gravity during the motion. Orientation was "
            "integrated from the "
            "gyroscopes (strapdown, started from the rest before the motion) or estimated "
            "with VQF (offline, without magnetometer). "
            "Lags between the clocks of more than 10 ms were removed "
            "before the comparison. Errors are root mean squares over the "
            f"motion of each trial ({table.quantity}), averaged by person. Means over people have Student's 95 % "
            f"interval. "
            f"Paired differences are judged against a margin of {table.margin_deg:g} deg with a "
            f"two-sided t test and two single-sided t "
            f"tests, with Bonferroni's correction. Agreement on the "
            f"{table.measure}, one mean per person, is given by Bland and "
            "Altman's 95 % limits and "
            "ICC(2,1) with its 95 % interval."
        )


# ---- the table of trials


def validate_people(
    folder: Path,
    name: Path,
    *,
    settings: "TrialSettings",
    forward: Side | None,
    up: Side | None,
    opening: Opening,
    output: Path | None,
    progress: Progress,
) -> PeopleValidated:
    """Judge the recordings of a table in a folder at each level of correction, by gyroscopes and by VQF."""
    from undrift.validation.levels import calibrate_by_others, judge_levels

    table = folder / name
    if not table.is_file():
        raise InputError(
            f"validate: there is no {table}. Write a row per recording with the columns {', '.join(NEEDED)} and reference."
        )
    rows, trials = list(_rows(table)), list["LevelTrial"]()
    _check_rows(table, rows)
    for k, row in enumerate(rows):
        progress(f"reading {row['recording']}", 0.3 * k / len(rows))
        trials.append(_trial(table, row, opening, forward, up))
    progress("fitting devices without a calibration", 0.3)
    trials = calibrate_by_others(trials, settings)
    judged = judge_levels(trials, settings=settings, methods=("strapdown", "vqf"), progress=part_of(progress, 0.4, 1.0))
    result = PeopleValidated(folder=folder, table=judged, output=output)
    if output is not None:
        output.mkdir(exist_ok=True)
        save_json(output / "levels.json", plain(result.data))
        files = (table, *(table.parent / row[column] for row in rows for column in FILES if row[column]))
        at("undrift.report.page:write_page")(output / "report.html", result.summary(), origin_of(*dict.fromkeys(files)))
    return result


def _rows(table: Path) -> Iterator[dict[str, str]]:
    """Yield the rows of the table, every column that there may be in each."""
    reader = csv.DictReader(read_bytes(table).decode("utf-8-sig", "replace").splitlines())
    heads = [head.strip() for head in reader.fieldnames or ()]
    lacking, unknown = [x for x in NEEDED if x not in heads], [x for x in heads if x not in (*NEEDED, *OPTIONAL)]
    if lacking or unknown:
        got = f"no {', '.join(lacking)}" if lacking else f"also {', '.join(unknown)}"
        raise InputError(
            f"{table}: expected columns {', '.join(NEEDED)}, and of {', '.join(OPTIONAL)}, got {got}. Correct the header line."
        )
    empty, rows = dict.fromkeys((*NEEDED, *OPTIONAL), ""), 0
    for line, row in enumerate(reader, start=2):
        cells = empty | {head.strip(): (value or "").strip() for head, value in row.items() if head}
        if missing := [name for name in NEEDED if not cells[name]]:
            raise InputError(
                f"{table}: {', '.join(missing)} is missing in line {line}. Fill it in, or delete the line."
            )
        rows += 1
        yield cells
    if not rows:
        raise InputError(f"{table}: expected a row for each recording, got none. Add the rows.")


def _check_rows(table: Path, rows: list[dict[str, str]]) -> None:
    """Refuse a recording in two rows, which would correct itself, and a device that is calibrated in some rows only."""
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


def _trial(table: Path, row: dict[str, str], opening: Opening, forward: Side | None, up: Side | None) -> "LevelTrial":
    """Read one row's recording, reference and calibration."""
    from undrift.io.store import read_calibration
    from undrift.validation.levels import LevelTrial

    paths = {name: table.parent / row[name] if row[name] else None for name in FILES}
    recording = cast("Path", paths["recording"])
    reference = (paths["reference"],) if paths["reference"] else ()
    optics = Optics(
        reference=reference, reference_map=paths["reference_map"], markers=row["markers"] or None,
        reference_up=cast("Any", row["reference_up"] or None),
    )  # fmt: skip
    model = read_calibration(paths["calibration"]) if paths["calibration"] else None
    how = replace(opening, column_map=paths["map"] or opening.column_map, sensor=row["sensor"] or opening.sensor)
    try:
        (pair,) = optics.pairs((recording,), how.like(model, paths["calibration"]), command="validate")
    except UndriftError as error:
        raise InputError(f"{table}, {row['recording']}: {error}") from error
    about: dict[str, Any] = {name: row[name] for name in NEEDED}
    worn = worn_by(model, forward, up)
    return LevelTrial(
        **about, record=pair[0], reference=pair[1], calibration=model, cluster=optics.of_cluster(), mounting=worn
    )
