"""Tables of the errors at each level of correction, and of the agreement with the optics."""

from dataclasses import asdict, replace
from typing import Any

import numpy as np

from undrift.io.store import findings_json
from undrift.report.figures import draw_people_agreement
from undrift.report.report import Cell, Table
from undrift.validation.agreement import BlandAltman
from undrift.validation.levels import LevelSummary, LevelTable

TRIAL = ("recording", "person", "task", "device")
METHODS = {"strapdown": "gyroscopes", "vqf": "VQF"}
SIMULATED = (
    "Simulated: a device that errs exactly as its calibration says, in the same motion. Differs by: largest difference "
    "between the actual and the simulated error at any time."
)
AGREEMENT = (
    "Agreement of device and optics on the range of pitch, one mean per person, from ten people on: limits of Bland and "
    "Altman, ICC(2,1) within one task, and the smallest change that is more than measurement error (MDC95). An ICC "
    "depends on how much the people differ."
)


def label_of(table: LevelTable, level: str, method: str) -> str:
    """Return the label of a row: the level, with the method if there are two."""
    return f"{level}, {METHODS[method]}" if len({errors.method for errors in table.errors}) > 1 else level


def level_tables(table: LevelTable) -> list[Table]:
    """Return the errors at each level over all trials, and the agreement with the optics from ten people on."""
    return [_errors_table(table, "all"), *_agreement(table)]


def level_details(table: LevelTable) -> list[Table]:
    """Return the errors at each level for each task and device, and of each trial."""
    groups = dict.fromkeys(summary.group for summary in table.summaries if summary.group != "all")
    tables = [_errors_table(table, group) for group in groups]
    missing = [(label_of(table, row.level, row.method), row.missing) for row in table.errors if row.missing]
    if missing:
        tables.append(Table(title="Levels without a result", columns=("level", "reason"), rows=missing))
    if len(table.trials) > 1:
        names = TRIAL if any(trial.person or trial.task or trial.device for trial in table.trials) else TRIAL[:1]
        labels = [label_of(table, errors.level, errors.method) for errors in table.errors]
        rows = [
            (*(getattr(trial, name) for name in names), *(float(errors.error_deg[k]) for errors in table.errors))
            for k, trial in enumerate(table.trials)
        ]
        title = f"{table.quantity.capitalize()} error of each trial (deg)"
        tables.append(Table(title=title, columns=(*names, *labels), rows=rows, form=".2f"))
    return tables


def _errors_table(table: LevelTable, group: str) -> Table:
    """Return a row for each level: error, reduction from the level above, and the error of a simulated device."""
    summaries = [summary for summary in table.summaries if summary.group == group]
    rows = list[dict[str, Cell]]()
    for summary, errors in zip(summaries, table.errors, strict=True):
        if not summary.trials:
            continue
        low, high = summary.interval_deg if summary.people > 1 else (None, None)
        row: dict[str, Cell] = {
            "level": label_of(table, summary.level, summary.method),
            "people": summary.people,
            "trials": summary.trials,
            "error (deg)": summary.mean_deg,
            "95 % from": None if low is None else max(low, 0.0),
            "to": high,
            "less than above": None if summary.decision is None else summary.decision.difference,
            "rated": None if summary.decision is None else summary.decision.verdict,
        }
        if group == "all":
            compared = np.isfinite(errors.difference_deg)
            row["simulated"] = float(errors.simulated_deg[compared].mean()) if compared.any() else None
            row["differs by"] = float(errors.difference_deg[compared].max()) if compared.any() else None
        rows.append(row)
    heads = [head for head in (rows[0] if rows else {}) if any(row[head] is not None for row in rows)]
    return Table(
        title="Levels of correction" if group == "all" else f"Levels of correction, {group}",
        columns=heads,
        rows=[[row[head] for head in heads] for row in rows],
        form=".2f",
        note=_note(table, group),
    )


def _note(table: LevelTable, group: str) -> str:
    parts = [f"{table.quantity.capitalize()} error, root mean square over the motion, mean over people."]
    if any(summary.decision for summary in table.summaries):
        parts.append(
            f"From three people on, each level is compared with the level above it: better, equivalent or worse by "
            f"{table.margin_deg:g} deg, at 5 % over all levels."
        )
    if group == "all" and any(np.isfinite(errors.difference_deg).any() for errors in table.errors):
        parts.append(SIMULATED)
    return " ".join(parts)


def _agreement(table: LevelTable) -> list[Table]:
    """Return the agreement with the optics, for levels and groups with ten people or more."""
    judged = [(summary, summary.agreement) for summary in table.summaries if summary.agreement is not None]
    overall = [summary for summary, _ in judged if summary.group == "all"]
    if not overall:
        return []
    best = min(overall, key=lambda summary: summary.mean_deg)
    columns = (
        "group", "level", "people", "bias (deg)", "limits from (deg)", "to (deg)", "ICC(2,1)", "ICC from", "to",
        "MDC95 (deg)",
    )  # fmt: skip
    return [
        Table(
            title="Agreement with the optics",
            columns=columns,
            rows=[_agreement_row(table, summary, limits) for summary, limits in judged],
            form=".2f",
            note=AGREEMENT,
            figure=lambda: draw_people_agreement(table, best),
        )
    ]


def _agreement_row(table: LevelTable, summary: LevelSummary, limits: BlandAltman) -> list[Cell]:
    icc = summary.icc
    row: list[Cell] = [summary.group, label_of(table, summary.level, summary.method), limits.count, limits.bias]
    row += list(limits.limits)
    return row + ([None] * 4 if icc is None else [icc.value, *icc.interval, icc.minimal_detectable_change])


def levels_json(table: LevelTable) -> dict[str, Any]:
    """Return the levels of correction for JSON."""
    errors = list[dict[str, Any]]()
    for row in table.errors:
        items = findings_json([item for _, item in row.findings])
        findings = [{"recording": pair[0], **item} for pair, item in zip(row.findings, items, strict=True)]
        errors.append(asdict(replace(row, findings=())) | {"findings": findings})
    return {
        "quantity": table.quantity,
        "margin_deg": table.margin_deg,
        "trials": [{name: getattr(trial, name) for name in TRIAL} for trial in table.trials],
        "summaries": [asdict(summary) for summary in table.summaries],
        "errors": errors,
    }
