"""The report of a validation: errors in degrees beside their predicted limits, and at each level of correction."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from undrift.findings import Finding
from undrift.io.store import findings_json
from undrift.model import Calibration
from undrift.report.figures import draw_level_errors, draw_validation, trial_figure
from undrift.report.levels import level_details, level_tables, levels_json
from undrift.report.report import Drawing, Estimate, Report, Table
from undrift.units import RADIAN_PER_DEGREE
from undrift.validation.agreement import Validation
from undrift.validation.align import LEAD_S, REST_S
from undrift.validation.levels import LevelTable
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
    "pitch %: share of the samples in which pitch is defined. It is left out where the body lies within 5 deg of its "
    "side, and near there pitch max may exceed the error in space."
)
PREDICTED = (
    "Predicted from the uncertainty of the calibration and from what changes between recordings of a device: 95 % of the "
    "errors are at most as large."
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """Recordings compared with their references."""

    result: Validation
    levels: LevelTable
    settings: TrialSettings
    calibration: Calibration | None  # that was read, or fitted to all recordings
    source: str  # file of the calibration, empty if it was fitted to the references
    files: tuple[tuple[str, str], ...]  # each recording and its reference, empty if the recording contains it

    @property
    def fitted(self) -> bool:
        """Whether the calibration was fitted to the references."""
        return self.calibration is not None and not self.source

    @property
    def offset_subtracted(self) -> bool:
        """Whether an offset was taken from the recordings themselves."""
        return any(trial.rest is not None for trial in self.result.trials)


def validation_report(compared: Comparison, findings: tuple[Finding, ...], notes: tuple[str, ...]) -> Report:
    result, levels = compared.result, compared.levels
    trials, many = result.trials, len(result.trials) > 1
    courses = [Table(title=f"Course of {trial.recording}", figure=_course(trial)) for trial in trials]
    return Report(
        title=f"Against the reference: {len(trials)} recording{'s' * many}",
        answer=_answer(compared),
        tables=[errors_table(result), *_predicted(trials), *level_tables(levels)],
        details=[
            *level_details(levels),
            *_remarks(trials),
            _recordings(compared),
            Table(title="Method", note=_method(compared)),
            *(courses if many else ()),
        ],
        notes=notes,
        findings=[*findings, *(item for trial in trials for item in trial.findings)],
        figures=[
            (lambda: draw_validation(result)) if many else _course(trials[0]),
            lambda: draw_level_errors(levels),
        ],
        data={
            "trials": [_trial_json(trial) for trial in trials],
            "mean": asdict(result.mean),
            "median": asdict(result.median),
            "levels": levels_json(levels),
            "calibration": "reference" if compared.fitted else compared.source or None,
            "leave_one_out": bool(result.held_out),
            "offset": compared.settings.offset,
        },
    )


def _course(trial: Trial) -> Drawing:
    return lambda: trial_figure(trial)


def _answer(compared: Comparison) -> str:
    """Return the error before and after, and whether it is within the predicted limits."""
    result, quantity = compared.result, compared.levels.quantity
    before = compared.levels.errors[0].error_deg  # the first level is uncalibrated
    parts = [f"{np.nanmedian(before):.3g} deg raw"] if np.isfinite(before).any() else []
    if compared.calibration is not None or compared.offset_subtracted:
        parts.append(f"{getattr(result.median, f'rmse_{quantity}_deg'):.2g} deg {_correction(compared)}")
    over = f", median of {len(result.trials)} recordings" if len(result.trials) > 1 else ""
    answer = f"{quantity.capitalize()} error {', '.join(parts)} (rms over the motion{over})."
    within = [trial.within_expected for trial in result.trials if trial.within_expected is not None]
    if within:
        count = f" ({sum(within)} of {len(within)} recordings)" if len(within) > 1 else ""
        answer += f" Within the predicted limits: {'yes' if all(within) else 'no'}{count}."
    return answer


def _correction(compared: Comparison) -> str:
    """Return what was done to the readings, in words."""
    words = f"calibrated with {compared.source}" if compared.source else "calibrated with these same recordings"
    if compared.result.held_out:
        words = "calibrated with the other recordings"
    offsets = {"rest": "offset of the rest subtracted", "motion": "offset from motion subtracted"}
    subtracted = offsets.get(compared.settings.offset, "") if compared.offset_subtracted else ""
    return ", ".join(words for words in (words if compared.calibration else "", subtracted) if words)


def errors_table(result: Validation) -> Table:
    """Return the errors, one row a recording, with mean and median of several."""
    rows = [(trial.recording, trial.figures) for trial in result.trials]
    rows += [("mean", result.mean), ("median", result.median)] if len(result.trials) > 1 else []
    return Table(
        title="Error against the reference (deg)",
        columns=("recording", *ERRORS, "pitch %", "optics %"),
        rows=[
            (
                name,
                *(getattr(figures, key) for key in ERRORS.values()),
                100.0 * figures.pitch_defined,
                100.0 * figures.valid_optics,
            )
            for name, figures in rows
        ],
        form=dict.fromkeys(ERRORS, ".2f") | {"pitch %": ".1f", "optics %": ".1f"},
        note="Root mean square over the motion, largest error of the pitch, and median after the motion (end)."
        + (f" {PITCH_DEFINED}" if any(figures.pitch_defined < 1.0 for _, figures in rows) else ""),
    )


def _predicted(trials: tuple[Trial, ...]) -> list[Table]:
    """Return the errors beside their predicted limits."""
    rows = [
        (
            trial.recording, trial.figures.rmse_total_deg, trial.expected.rmse_at_most_deg,
            trial.figures.end_total_deg, trial.expected.end_at_most_deg, trial.within_expected,
        )
        for trial in trials
        if trial.expected is not None
    ]  # fmt: skip
    columns = ("recording", "total rms", "rms at most", "end total", "end at most", "within")
    return [Table(title="Predicted limits (deg)", columns=columns, rows=rows, note=PREDICTED)] if rows else []


def _remarks(trials: tuple[Trial, ...]) -> list[Table]:
    rows = [(trial.recording, item.level, item.text) for trial in trials for item in trial.findings]
    return [Table(title="Findings by recording", columns=("recording", "level", "finding"), rows=rows)] if rows else []


def _method(compared: Comparison) -> str:
    """Return how the errors were determined."""
    settings = compared.settings
    above = f" if it exceeds {settings.align_above / RADIAN_PER_DEGREE:g} deg" if settings.align == "auto" else ""
    mounted = " The mounting of the calibration turned the readings." if settings.mounting else ""
    text = (
        f"Readings: {_correction(compared) or 'as they are'}. "
        f"The tilt at the start is that of the specific force, and the heading that of the reference, over the last "
        f"{REST_S:g} s of rest. From {LEAD_S:g} s before the motion on, the gyroscopes alone are integrated. "
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
    columns = (
        "recording",
        "reference",
        "motion from (s)",
        "to (s)",
        "lag (ms)",
        "in the errors",
        "mounting (deg)",
        "removed",
    )
    rows = []
    for (file, reference), trial in zip(compared.files, compared.result.trials, strict=True):
        lag = Estimate(trial.lag.seconds * 1e3, trial.lag.standard_uncertainty * 1e3)
        angle_deg = None if trial.mounting is None else trial.mounting.angle / RADIAN_PER_DEGREE
        removed = None if trial.mounting is None else trial.mounting.applied
        motion = (trial.motion.start_s, trial.motion.stop_s)
        rows.append((file, reference or "the same file", *motion, lag, not trial.lag_undone, angle_deg, removed))
    return Table(title="Recordings", columns=columns, rows=rows, form=".1f")


def _trial_json(trial: Trial) -> dict[str, Any]:
    return {
        "recording": trial.recording,
        **asdict(trial.figures),
        "expected_end_deg": trial.expected and trial.expected.end_total_deg,
        "expected": trial.expected and asdict(trial.expected),
        "within_expected": trial.within_expected,
        "rest": trial.rest and trial.rest.figures,
        "findings": findings_json(trial.findings),
    }
