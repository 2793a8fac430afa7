"""Levels of correction for ``undrift validate`` and ``undrift validate FOLDER --trials trials.csv``.

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
    from undrift.validation.levels import LevelTable, LevelTrial
    from undrift.validation.trial import TrialSettings


NEEDED = ("recording", "person", "task", "device")
FILES = ("recording", "reference", "calibration", "map", "reference_map")
OPTIONAL = (*FILES[1:], "sensor", "reference_up", "markers")
METHODS = {"strapdown": "gyroscopes", "vqf": "VQF"}
EMPTY = "–"

# ---- sections


def label_of(table: "LevelTable", level: str, method: str) -> str:
    """Return the label of a row: the level, with the method if there are two."""
    return f"{level}, {METHODS[method]}" if len({errors.method for errors in table.errors}) > 1 else level


def levels_sections(table: "LevelTable") -> tuple[Section, ...]:
    """Return the errors at each level of correction, the agreement, and the errors of each trial."""
    groups = list(dict.fromkeys(summary.group for summary in table.summaries))
    sections = [_errors_section(table, "all"), _agreement(table)]
    sections += [replace(_errors_section(table, group), on="page") for group in groups[1:]]
    labelled = any(trial.person or trial.task or trial.device for trial in table.trials)
    names = NEEDED if labelled else NEEDED[:1]
    trials = Section(
        title=f"{table.quantity.capitalize()} error of each trial (deg)",
        columns=(*names, *(label_of(table, errors.level, errors.method) for errors in table.errors)),
        rows=tuple(
            (
                *(getattr(trial, name) for name in names),
                *(number(float(errors.error_deg[k])) for errors in table.errors),
            )
            for k, trial in enumerate(table.trials)
        ),
        folded=True,
    )
    return (
        *(section for section in sections if section.rows or section.text),
        *([trials] if len(table.trials) > 1 else ()),
    )


def _errors_section(table: "LevelTable", group: str) -> Section:
    """Return a row for each level: error, reduction from the level above, and the error of a simulated device."""
    import numpy as np

    rows = list[tuple[str, ...]]()
    for summary, errors in zip(
        (summary for summary in table.summaries if summary.group == group), table.errors, strict=True
    ):
        if not summary.trials:
            continue
        (low, high), decision = summary.interval_deg, summary.decision
        cells = [f"{max(low, 0.0):.2f} to {high:.2f}" if summary.people > 1 else EMPTY]
        cells += [number(decision.difference), decision.verdict] if decision else [EMPTY, EMPTY]
        both = np.isfinite(errors.difference_deg)
        if group == "all":
            simulated = errors.simulated_deg[both].mean() if both.any() else np.nan
            cells += [number(simulated), number(errors.difference_deg[both].max() if both.any() else np.nan)]
        label = label_of(table, summary.level, summary.method)
        rows.append((label, f"{summary.people} ({summary.trials})", number(summary.mean_deg), *cells))
    heads = ["level", "people (trials)", "error (deg)", "95 %", "less than above", "rated"]
    text = [f"{table.quantity.capitalize()} error, root mean square over the motion, mean over people."]
    if any(summary.decision for summary in table.summaries):
        text.append(
            f"From three people on, each level is compared with the level above it: better, equivalent or worse by "
            f"{table.margin_deg:g} deg, at 5 % over all levels."
        )
    if group == "all":
        heads += ["simulated", "differs by"]
        if any(np.isfinite(errors.difference_deg).any() for errors in table.errors):
            text.append(
                "Simulated: a device that errs exactly as its calibration says, in the same motion. Differs by: largest "
                "difference between the actual and the simulated error at any time."
            )
        for reason in dict.fromkeys(errors.missing for errors in table.errors if errors.missing):
            levels = (label_of(table, x.level, x.method) for x in table.errors if x.missing == reason)
            text.append(f"{'; '.join(levels)}: {reason}")
    title = "Levels of correction" if group == "all" else f"Levels of correction, {group}"
    told = [k for k in range(len(heads)) if any(row[k] != EMPTY for row in rows)]
    return Section(
        title=title,
        columns=tuple(heads[k] for k in told),
        rows=tuple(tuple(row[k] for k in told) for row in rows),
        text=tuple(text),
    )


def _warnings(table: "LevelTable") -> tuple[Section, ...]:
    """Return the warnings of the trials, once for each recording, with the first level that has it."""
    texts = dict[tuple[str, str], str]()
    for errors in table.errors:
        for recording, item in errors.findings:
            texts.setdefault((recording, item.code), f"{Path(recording).name}, {errors.level}: {item.text}")
    return (Section(title="Warnings", text=tuple(texts.values())),) if texts else ()


def _agreement(table: "LevelTable") -> Section:
    """Return the agreement with the optics, for levels and groups with ten people or more."""
    rows = list[tuple[str, ...]]()
    best = None
    for summary in table.summaries:
        limits, icc = summary.agreement, summary.icc
        if limits is None:
            continue
        cells = [EMPTY] * 3
        if icc is not None:
            cells = [f"{icc.value:.3f}", interval(icc.interval), number(icc.minimal_detectable_change)]
        label, bias = label_of(table, summary.level, summary.method), f"{limits.bias:+.2f}"
        rows.append((summary.group, label, str(limits.count), bias, interval(limits.limits, "+.2f"), *cells))
        if summary.group == "all" and (best is None or summary.mean_deg < best.mean_deg):
            best = summary
    if best is None:
        return Section(title="Agreement with the optics")
    return Section(
        title="Agreement with the optics",
        columns=("group", "level", "people", "bias (deg)", "95 % limits", "ICC(2,1)", "95 %", "MDC95 (deg)"),
        rows=tuple(rows),
        text=(
            "Agreement of device and optics on the range of pitch, one mean per person, from ten people on: limits of Bland and "
            "Altman, ICC(2,1) within one task, and the smallest change that is more than measurement error (MDC95). An ICC depends "
            "on how much the people differ.",
        ),
        pictures=(figure_of("figures:draw_people_agreement", table, best),),
    )


def levels_json(table: "LevelTable") -> dict[str, Any]:
    """Return the levels of correction for JSON."""
    from undrift.io.store import findings_json

    errors = list[dict[str, Any]]()
    for row in table.errors:
        items = findings_json([item for _, item in row.findings])
        named = [{"recording": pair[0], **item} for pair, item in zip(row.findings, items, strict=True)]
        errors.append(asdict(replace(row, findings=())) | {"findings": named})
    return {
        "quantity": table.quantity,
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
            sections=(*levels_sections(self.table), *_warnings(self.table), methods),
            written=() if self.output is None else (self.output / "levels.json", self.output / "report.html"),
        )

    @property
    def data(self) -> dict[str, Any]:
        """Content of the JSON output and of levels.json."""
        return levels_json(self.table) | {"methods": self.methods()}

    def _answer(self) -> str:
        """Return the error before, and the smallest error of the levels that judge most trials."""
        table = self.table
        judged = [summary for summary in table.summaries if summary.group == "all" and summary.trials]
        most = max(summary.trials for summary in judged)
        first, best = judged[0], min((s for s in judged if s.trials == most), key=lambda summary: summary.mean_deg)
        before, after = (label_of(table, summary.level, summary.method) for summary in (first, best))
        low, high = best.interval_deg
        spread = f" [95 % {max(low, 0.0):.2f} to {high:.2f}]" if best.people > 1 else ""
        return (
            f"{table.quantity.capitalize()} error {first.mean_deg:.3g} deg {before}, {best.mean_deg:.2f} deg{spread} at the best "
            f"level ({after}); {best.people} people, {best.trials} trials."
        )

    def methods(self) -> str:
        """Return a paragraph about the methods, for a paper."""
        table = self.table
        people, tasks, devices = (len({getattr(trial, name) for trial in table.trials}) for name in NEEDED[1:])
        by_others = sum(trial.left_out or trial.calibration is None for trial in table.trials)
        count = len(table.trials) - by_others
        calibrated = f"{count} recordings were corrected with an earlier calibration of their device"
        if by_others:
            calibrated += f", {by_others} with a fit to the other recordings of their device (leave-one-out)"
        return (
            f"{len(table.trials)} recordings of {people} people in {tasks} tasks with {devices} inertial sensors were "
            f"compared with optical motion capture by undrift {__version__}. {calibrated}. The offset of the gyroscopes was taken "
            "from the calibration, from the first rest, or from gravity during the motion. Orientation was integrated from the "
            "gyroscopes (strapdown, started from the rest before the motion) or estimated with VQF (offline, without "
            "magnetometer). Lags between the clocks of more than 10 ms were removed before the comparison. Errors are root mean "
            f"squares over the motion of each trial ({table.quantity}), averaged by person. Means over people have Student's 95 % "
            f"interval. Paired differences are judged against a margin of {table.margin_deg:g} deg with a two-sided t test and two "
            "one-sided t tests, with Bonferroni's correction. Agreement on the range of pitch, one mean per person, is given by "
            "Bland and Altman's 95 % limits and ICC(2,1) with its 95 % interval."
        )


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


# ---- the table of trials


def _rows(table: Path) -> Iterator[dict[str, str]]:
    """Yield the rows of the table, with every possible column in each."""
    reader = csv.DictReader(read_bytes(table).decode("utf-8-sig", "replace").splitlines())
    heads = [head.strip() for head in reader.fieldnames or ()]
    lacking, unknown = [x for x in NEEDED if x not in heads], [x for x in heads if x not in (*NEEDED, *OPTIONAL)]
    if lacking or unknown:
        got = f"no {', '.join(lacking)}" if lacking else f"also {', '.join(unknown)}"
        raise InputError(
            f"{table}: expected columns {', '.join(NEEDED)}, and of {', '.join(OPTIONAL)}, got {got}. Correct the header line."
        )
    count = 0
    for line, row in enumerate(reader, start=2):
        cells = dict.fromkeys((*NEEDED, *OPTIONAL), "")
        cells |= {head.strip(): (value or "").strip() for head, value in row.items() if head}
        if missing := [name for name in NEEDED if not cells[name]]:
            raise InputError(
                f"{table}: {', '.join(missing)} is missing in line {line}. Fill it in, or delete the line."
            )
        count += 1
        yield cells
    if not count:
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
    """Read the recording, the reference and the calibration of a row."""
    from undrift.io.store import read_calibration
    from undrift.validation.levels import LevelTrial

    paths = {name: table.parent / row[name] if row[name] else None for name in FILES}
    optics = Optics(
        reference=(paths["reference"],) if paths["reference"] else (),
        reference_map=paths["reference_map"],
        markers=row["markers"] or None,
        reference_up=cast("Any", row["reference_up"] or None),
    )
    model = read_calibration(paths["calibration"]) if paths["calibration"] else None
    how = replace(opening, column_map=paths["map"] or opening.column_map, sensor=row["sensor"] or opening.sensor)
    try:
        ((record, reference),) = optics.pairs(
            (cast("Path", paths["recording"]),), how.like(model, paths["calibration"]), command="validate"
        )
    except UndriftError as error:
        raise InputError(f"{table}, {row['recording']}: {error}") from error
    return LevelTrial(
        recording=row["recording"],
        person=row["person"],
        task=row["task"],
        device=row["device"],
        record=record,
        reference=reference,
        calibration=model,
        cluster=optics.of_cluster(),
        mounting=worn_by(model, forward, up),
    )
