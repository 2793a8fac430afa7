"""Report of a validation: errors in degrees next to their predicted limits, and at each level of correction."""

from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from undrift.findings import Finding, two_digits
from undrift.io.store import findings_json
from undrift.model import Calibration
from undrift.report.figures import draw_level_errors, draw_people_agreement, draw_validation, trial_figure
from undrift.report.report import Cell, Estimate, Report, Table
from undrift.units import RADIAN_PER_DEGREE
from undrift.validation.agreement import Validation
from undrift.validation.align import LEAD_S, REST_S
from undrift.validation.levels import LevelSummary, LevelTable
from undrift.validation.trial import END_S, OWN_LAG_S, Trial, TrialSettings

ERRORS = {
    "total": "rmse_total_deg",
    "inclination": "rmse_inclination_deg",
    "pitch": "rmse_pitch_deg",
    "pitch max": "max_abs_pitch_deg",
    "end total": "end_total_deg",
    "end inclination": "end_inclination_deg",
    "lag (ms)": "lag_ms",
}
PITCH_DEFINED = (
    "pitch %: share of the samples in which pitch is defined. Pitch is undefined if the body is within 5 deg of lying on its "
    "side. Near that position, pitch max may exceed the error in space."
)
PREDICTED = (
    "Predicted from the uncertainty of the calibration and from the changes of a device between recordings: 95 % of the errors do "
    "not exceed these limits."
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """Recordings compared with their references."""

    result: Validation
    levels: LevelTable
    settings: TrialSettings
    calibration: Calibration | None  # calibration that was read, or fitted to all recordings
    source: str  # file of the calibration, empty if it was fitted to the references
    files: tuple[
        tuple[str, str], ...
    ]  # paths of each recording and its reference, the latter empty if the recording contains it

    @property
    def fitted(self) -> bool:
        """Return True if the calibration was fitted to the references."""
        return self.calibration is not None and not self.source

    @property
    def offset_subtracted(self) -> bool:
        """Return True if an offset from the recordings was subtracted."""
        return any(trial.rest is not None for trial in self.result.trials)


def validation_report(compared: Comparison, findings: tuple[Finding, ...], notes: tuple[str, ...]) -> Report:
    result, levels = compared.result, compared.levels
    trials, many = result.trials, len(result.trials) > 1
    courses = [Table(title=f"Course of {trial.recording}", figure=partial(trial_figure, trial)) for trial in trials]
    remarks: list[dict[str, Cell]] = [
        {"recording": trial.recording, "level": item.level, "finding": item.text}
        for trial in trials
        for item in trial.findings
    ]
    return Report(
        title=f"Against the reference: {len(trials)} recording{'s' * many}",
        answer=_answer(compared),
        tables=[errors_table(result), _predicted(trials), *level_tables(levels)],
        details=[
            *level_details(levels),
            Table.of("Findings by recording", remarks),
            _recordings(compared),
            Table(title="Method", note=_method(compared)),
            *(courses if many else ()),
        ],
        notes=notes,
        findings=[*findings, *(item for trial in trials for item in trial.findings)],
        figures=[
            partial(draw_validation, result) if many else partial(trial_figure, trials[0]),
            partial(draw_level_errors, levels),
        ],
        data={
            "trials": [_trial_json(trial) for trial in trials],
            "mean": result.mean,
            "median": result.median,
            "levels": levels_json(levels),
            "calibration": "reference" if compared.fitted else compared.source or None,
            "leave_one_out": bool(result.held_out),
            "offset": compared.settings.offset,
        },
    )


def _answer(compared: Comparison) -> str:
    """Return a sentence with the error before and after, and with its comparison with the predicted limits."""
    result, quantity = compared.result, compared.levels.quantity
    before = compared.levels.errors[0].error_deg  # the first level is uncalibrated
    parts = [f"{np.nanmedian(before):.3g} deg raw"] if np.isfinite(before).any() else []
    if compared.calibration is not None or compared.offset_subtracted:
        parts.append(f"{two_digits(getattr(result.median, f'rmse_{quantity}_deg'))} deg {_correction(compared)}")
    over = f", median of {len(result.trials)} recordings" if len(result.trials) > 1 else ""
    answer = f"{quantity.capitalize()} error {', '.join(parts)} (rms over the motion{over})."
    within = [trial.within_expected for trial in result.trials if trial.within_expected is not None]
    if within:
        count = f" ({sum(within)} of {len(within)} recordings)" if len(within) > 1 else ""
        answer += f" Within the predicted limits: {'yes' if all(within) else 'no'}{count}."
    return answer


def _correction(compared: Comparison) -> str:
    """Return a phrase for the processing of the readings."""
    words = f"calibrated with {compared.source}" if compared.source else "calibrated with these same recordings"
    if compared.result.held_out:
        words = "calibrated with the other recordings"
    offsets = {"rest": "offset of the rest subtracted", "motion": "offset from motion subtracted"}
    subtracted = offsets.get(compared.settings.offset, "") if compared.offset_subtracted else ""
    return ", ".join(words for words in (words if compared.calibration else "", subtracted) if words)


def errors_table(result: Validation) -> Table:
    """Return the errors, one row per recording, with mean and median of several recordings."""
    named = [(trial.recording, trial.figures) for trial in result.trials]
    named += [("mean", result.mean), ("median", result.median)] if len(named) > 1 else []
    rows: list[dict[str, Cell]] = [
        {"recording": name, **{head: getattr(figures, key) for head, key in ERRORS.items()}}
        | {"pitch %": 100.0 * figures.pitch_defined, "optics %": 100.0 * figures.valid_optics}
        for name, figures in named
    ]
    note = "Root mean square over the motion, largest error of the pitch, and median after the motion (end)."
    if any(figures.pitch_defined < 1.0 for _, figures in named):
        note += f" {PITCH_DEFINED}"
    form = dict.fromkeys(ERRORS, ".2f") | dict.fromkeys(("pitch %", "optics %"), ".1f")
    return Table.of("Error against the reference (deg)", rows, form=form, note=note)


def _predicted(trials: tuple[Trial, ...]) -> Table:
    """Return the errors next to their predicted limits."""
    rows: list[dict[str, Cell]] = [
        {
            "recording": trial.recording,
            "total rms": trial.figures.rmse_total_deg,
            "rms at most": trial.expected.rmse_at_most_deg,
            "end total": trial.figures.end_total_deg,
            "end at most": trial.expected.end_at_most_deg,
            "within": trial.within_expected,
        }
        for trial in trials
        if trial.expected is not None
    ]
    return Table.of("Predicted limits (deg)", rows, note=PREDICTED)


def _method(compared: Comparison) -> str:
    """Return a description of the method of comparison."""
    settings = compared.settings
    above = f" if it exceeds {settings.align_above / RADIAN_PER_DEGREE:g} deg" if settings.align == "auto" else ""
    mounted = " The mounting of the calibration turned the readings." if settings.mounting else ""
    text = (
        f"Readings: {_correction(compared) or 'as they are'}. "
        f"The tilt at the start is taken from the specific force, and the heading from the reference, over the last "
        f"{REST_S:g} s of rest. From {LEAD_S:g} s before the motion on, only the gyroscopes are integrated. "
        f"A lag of up to {OWN_LAG_S * 1e3:g} ms is the sensor's own and stays in the errors. A longer lag is removed. "
        f"The rotation between device and reference is removed{above}. "
        f"The pitch is in the plane of {settings.forward} (forward) and {settings.up} (up).{mounted} "
        f"Errors are root mean squares over the motion, and the median of the {END_S:g} s after it (end)."
    )
    if compared.fitted and not compared.result.held_out:
        text += " The calibration was fitted to these recordings. Use --leave-one-out for an unbiased error."
    return text


def _recordings(compared: Comparison) -> Table:
    """Return the motion, the lag and the mounting of each recording."""
    rows: list[dict[str, Cell]] = [
        {
            "recording": file,
            "reference": reference or "the same file",
            "motion from (s)": trial.motion.start_s,
            "to (s)": trial.motion.stop_s,
            "lag (ms)": Estimate(1e3 * trial.lag.seconds, 1e3 * trial.lag.standard_uncertainty),
            "in the errors": not trial.lag_undone,
            "mounting (deg)": None if trial.mounting is None else trial.mounting.angle / RADIAN_PER_DEGREE,
            "removed": None if trial.mounting is None else trial.mounting.applied,
        }
        for (file, reference), trial in zip(compared.files, compared.result.trials, strict=True)
    ]
    return Table.of("Recordings", rows, form=".1f")


def _trial_json(trial: Trial) -> dict[str, Any]:
    return {
        "recording": trial.recording,
        **asdict(trial.figures),
        "expected_end_deg": trial.expected and trial.expected.end_total_deg,
        "expected": trial.expected,
        "within_expected": trial.within_expected,
        "rest": trial.rest and trial.rest.figures,
        "findings": trial.findings,
    }


# ---- levels of correction

TRIAL = ("recording", "person", "task", "device")
METHODS = {"strapdown": "gyroscopes", "vqf": "VQF"}
SIMULATED = (
    "Simulated: a device with exactly the errors that its calibration describes, in this motion. Differs by: largest difference "
    "between the actual and the simulated error at any time."
)
AGREEMENT = (
    "Agreement of device and optics on the range of pitch, one mean per person, for ten people or more: limits of Bland and "
    "Altman, ICC(2,1) within one task, and the smallest change that is more than measurement error (MDC95). An ICC "
    "depends on how much the people differ."
)


def label_of(table: LevelTable, level: str, method: str) -> str:
    """Return the label of a row: the level, with the method if there are two."""
    return f"{level}, {METHODS[method]}" if len({errors.method for errors in table.errors}) > 1 else level


def level_tables(table: LevelTable) -> list[Table]:
    """Return the errors at each level over all trials, and for ten people or more the agreement with the optics."""
    return [_errors_table(table, "all"), _agreement(table)]


def level_details(table: LevelTable) -> list[Table]:
    """Return the errors at each level for each task and device, and of each trial."""
    groups = dict.fromkeys(summary.group for summary in table.summaries if summary.group != "all")
    labels = [label_of(table, errors.level, errors.method) for errors in table.errors]
    missing: list[dict[str, Cell]] = [
        {"level": label, "reason": errors.missing}
        for label, errors in zip(labels, table.errors, strict=True)
        if errors.missing
    ]
    names = TRIAL if any(trial.person or trial.task or trial.device for trial in table.trials) else TRIAL[:1]
    trials: list[dict[str, Cell]] = [
        {name: getattr(trial, name) for name in names}
        | {label: float(errors.error_deg[k]) for label, errors in zip(labels, table.errors, strict=True)}
        for k, trial in enumerate(table.trials if len(table.trials) > 1 else ())
    ]
    return [
        *(_errors_table(table, group) for group in groups),
        Table.of("Levels without a result", missing),
        Table.of(f"{table.quantity.capitalize()} error of each trial (deg)", trials, form=".2f"),
    ]


def _errors_table(table: LevelTable, group: str) -> Table:
    """Return a row for each level: error, reduction from the level above, and the error of a simulated device."""
    rows = list[dict[str, Cell]]()
    summaries = [summary for summary in table.summaries if summary.group == group]
    for summary, errors in zip(summaries, table.errors, strict=True):
        decision, compared = summary.decision, np.isfinite(errors.difference_deg)
        low, high = summary.interval_deg if summary.people > 1 else (None, None)
        row: dict[str, Cell] = {
            "level": label_of(table, summary.level, summary.method),
            "people": summary.people,
            "trials": summary.trials,
            "error (deg)": summary.mean_deg,
            "95 % from": None if low is None else max(low, 0.0),
            "to": high,
            "less than above": None if decision is None else decision.difference,
            "rated": None if decision is None else decision.verdict,
        }
        if group == "all":
            row["simulated"] = float(errors.simulated_deg[compared].mean()) if compared.any() else None
            row["differs by"] = float(errors.difference_deg[compared].max()) if compared.any() else None
        rows += [row] if summary.trials else []
    heads = {head for row in rows for head, cell in row.items() if cell is not None}
    return Table.of(
        "Levels of correction" if group == "all" else f"Levels of correction, {group}",
        [{head: cell for head, cell in row.items() if head in heads} for row in rows],
        form=".2f",
        note=_level_note(table, group),
    )


def _level_note(table: LevelTable, group: str) -> str:
    parts = [f"{table.quantity.capitalize()} error, root mean square over the motion, mean over people."]
    if any(summary.decision for summary in table.summaries):
        parts.append(
            f"With three people or more, each level is compared with the level above it: better, equivalent or worse by "
            f"{table.margin_deg:g} deg, at 5 % over all levels."
        )
    if group == "all" and any(np.isfinite(errors.difference_deg).any() for errors in table.errors):
        parts.append(SIMULATED)
    return " ".join(parts)


def _agreement(table: LevelTable) -> Table:
    """Return the agreement with the optics, for levels and groups with ten people or more."""
    rows, overall = list[list[Cell]](), list[LevelSummary]()
    for summary in table.summaries:
        if (limits := summary.agreement) is not None:
            icc, label = summary.icc, label_of(table, summary.level, summary.method)
            reliability = [None] * 4 if icc is None else [icc.value, *icc.interval, icc.minimal_detectable_change]
            rows.append([summary.group, label, limits.count, limits.bias, *limits.limits, *reliability])
            overall += [summary] if summary.group == "all" else []
    if not overall:
        return Table(title="Agreement with the optics")
    best = min(overall, key=lambda summary: summary.mean_deg)
    columns = (
        "group", "level", "people", "bias (deg)", "limits from (deg)", "to (deg)", "ICC(2,1)", "ICC from", "to",
        "MDC95 (deg)",
    )  # fmt: skip
    return Table(
        title="Agreement with the optics",
        columns=columns,
        rows=rows,
        form=".2f",
        note=AGREEMENT,
        figure=partial(draw_people_agreement, table, best),
    )


def levels_json(table: LevelTable) -> dict[str, Any]:
    """Return the levels of correction for JSON."""
    errors = [
        asdict(replace(row, findings=()))
        | {"findings": [{"recording": name, **findings_json([item])[0]} for name, item in row.findings]}
        for row in table.errors
    ]
    return {
        "quantity": table.quantity,
        "margin_deg": table.margin_deg,
        "trials": [{name: getattr(trial, name) for name in TRIAL} for trial in table.trials],
        "summaries": table.summaries,
        "errors": errors,
    }
