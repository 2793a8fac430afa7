"""The page of a validation: a table of errors, the course of each trial, agreement over trials."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from undrift.findings import told_apart
from undrift.model import Verdict
from undrift.report.figures import draw_agreement, draw_bars, draw_comparison, svg_of
from undrift.report.page import Origin, Section, rows_section, write_page
from undrift.units import RADIAN_PER_DEGREE

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.figure import Figure

    from undrift.model import Calibration
    from undrift.validation.agreement import Coverage, Validation
    from undrift.validation.trial import Figures, Trial, TrialSettings

# ---- method

_ALIGNED = {
    "auto": "the rotation between the device's case and the reference's body, from their rates, is removed where it exceeds "
    "{above_deg:g} deg",
    "rates": "the rotation between the device's case and the reference's body, from their rates, is removed",
    "none": "the device's case is assumed to be the reference's body",
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Method:
    """What was asked of a validation."""

    recordings: tuple[str, ...]  # File of each recording
    references: tuple[str, ...]  # File of each one's reference; empty where the recordings hold their own
    # That judged the recordings; the fit to all of them in leave-one-out; None where they were judged as they come
    calibration: "Calibration | None"
    source: str  # File of the calibration; empty where it was fitted to the references
    leave_one_out: bool  # Each recording was judged by a fit to the others
    verdict: Verdict  # Of the calibration, or of the fits to the others
    settings: "TrialSettings"  # Offset, ADC, axes of the pitch, search of the lag


def method_section(method: Method) -> Section:
    """Return what was done, one row a choice."""
    settings, made = method.settings, method.calibration
    verdict = Verdict() if made is None else method.verdict
    rows = {
        "calibration": _calibration(method),
        "its verdict": "" if made is None else verdict.status,
        "gyroscope's offset": _offset(method),
        "ADC's rounding": _adc(method),
        "start": f"tilt from the specific force, heading from the reference, both over the last {settings.rest_s:g} s of rest or "
        f"less; from {settings.lead_s:g} s before the motion the gyroscope alone",
        "pitch": f"in the body's plane of {settings.forward} (forward) and {settings.up} (up)",
        "lag": f"searched up to {settings.lag.longest_lag_s:g} s either way; one up to {settings.undo_lag_above_s * 1e3:g} ms is "
        "the sensor's own and stays in the figures, a longer one is removed",
        "mounting": _ALIGNED[settings.align].format(above_deg=settings.align_above / RADIAN_PER_DEGREE),
    }
    return Section(
        title="Method",
        columns=("step", "choice"),
        rows=tuple(row for row in rows.items() if row[1]),
        words=True,
    )


def recordings_section(method: Method, trials: "tuple[Trial, ...]") -> Section:
    """Return what was found of each recording before it was judged, one row a recording."""
    references = method.references or ("the same file",) * len(trials)
    rows = []
    for file, reference, trial in zip(method.recordings, references, trials, strict=True):
        mounting = "not observable"
        if trial.mounting is not None:
            angle_deg = trial.mounting.alignment.angle / RADIAN_PER_DEGREE
            mounting = f"{angle_deg:.1f}, {'removed' if trial.mounting.applied else 'left in'}"
        row = {
            "recording": file,
            "reference": reference,
            "motion (s)": f"{trial.motion.start_s:.1f} to {trial.motion.stop_s:.1f}",
            "lag found (ms)": f"{trial.lag.seconds * 1e3:.2f} +- {trial.lag.standard_uncertainty * 1e3:.2f}",
            "lag in the figures": "removed" if trial.lag_undone else "left in",
            "mounting (deg)": mounting,
            "optics seen, whole file (%)": f"{100.0 * trial.figures.valid_optics_file:.1f}",
        }
        rows.append(row)
    text = ("The motion, over which the errors count, is shaded in each figure of errors.",)
    return rows_section("Recordings", rows, text=text)


def _calibration(method: Method) -> str:
    made = method.calibration
    if made is None:
        return "none: readings in the unit of their file"
    if method.leave_one_out:
        return "leave-one-out: each recording judged by a gyroscope fit to the references of the others"
    if not method.source:
        return "gyroscope fitted to the references of these same recordings, so figures are optimistic: use --leave-one-out"
    triads = [f"{name} by {t.method}" for name, t in (("gyroscope", made.gyro), ("accelerometer", made.accel)) if t]
    tables = "" if made.drift is None else ", with tables over temperature"
    return f"{method.source} of {made.device or 'a device without a name'}: {', '.join(triads)}{tables}"


def _offset(method: Method) -> str:
    rest = "the mean rate of the first still phase is subtracted"
    if method.leave_one_out:
        return "the fit's: each recording's rest before the motion, and the motion of the others"
    if method.settings.offset == "rest":
        return rest if method.calibration is None else f"the calibration's, and {rest} after it"
    return "not corrected" if method.calibration is None else "the calibration's alone"


def _adc(method: Method) -> str:
    if method.settings.adc == "none":
        return "left in"
    made = method.calibration
    if made is None:
        return "corrected where the codes show it; see the notes of the recording"
    if made.adc is None:
        return "unknown to the calibration: left in"
    triads = (
        ("gyroscope", made.adc.gyro_lsb, made.adc.gyro_rounding),
        ("accelerometer", made.adc.accel_lsb, made.adc.accel_rounding),
    )
    words = [f"{name} {rounding.replace('_', ' ')}" for name, lsb, rounding in triads if lsb is not None]
    return f"corrected by the calibration ({', '.join(words)})"


# ---- errors

COLUMNS = (
    ("rmse_total_deg", "total rmse (deg)"),
    ("rmse_inclination_deg", "inclination rmse (deg)"),
    ("rmse_heading_deg", "heading rmse (deg)"),
    ("rmse_pitch_deg", "pitch rmse (deg)"),
    ("max_abs_pitch_deg", "pitch max (deg)"),
    ("end_total_deg", "end total (deg)"),
    ("end_inclination_deg", "end inclination (deg)"),
    ("drift_deg_per_min", "drift (deg/min)"),
)
PITCH_DEFINED = (
    "Pitch defined: share of the samples in which pitch is defined; it is left out where the body lies within 5 deg of its side, "
    "and near there pitch max may exceed the error in space"
)
OPTICS_SEEN = "Optics seen: share of the motion in which the reference saw the body, where alone errors count;"


def write_validation_report(result: "Validation", method: Method, path: Path, origin: Origin | None = None) -> None:
    """Write the page of a validation."""
    write_page(
        path,
        title=f"Against the reference: {len(result.trials)} recording{'s' * (len(result.trials) > 1)}",
        answer=_answer(result, method),
        pictures=(svg_of(draw_validation(result) if len(result.trials) > 1 else trial_figure(result.trials[0])),),
        sections=validation_sections(result, method),
        findings=tuple(item for trial in result.trials for item in trial.findings),
        verdict=None if method.calibration is None else method.verdict,
        origin=origin,
    )


def _answer(result: "Validation", method: Method) -> str:
    """Return what the orientation is worth, in a sentence."""
    how = "with the offset of the first still phase removed"
    if method.leave_one_out:
        how = "calibrated with the other recordings"
    elif method.calibration is not None:
        how = f"calibrated with {method.source}" if method.source else "calibrated with these same recordings"
    figures, over = result.median, f", median of {len(result.trials)} recordings" if len(result.trials) > 1 else ""
    return (
        f"Orientation is wrong by {figures.rmse_total_deg:.2g} deg rms in total and {figures.rmse_inclination_deg:.2g} deg in "
        f"inclination over the motion{over}, {how if method.calibration or method.settings.offset == 'rest' else 'uncorrected'}."
    )


def validation_sections(result: "Validation", method: Method) -> tuple[Section, ...]:
    """Return the sections of a validation's page."""
    rows = [("mean", result.mean), ("median", result.median)] if len(result.trials) > 1 else []
    return (
        trials_section(result.trials, rows),
        *_expected(result),
        *_agreement(result),
        method_section(method),
        recordings_section(method, result.trials),
        *(map(trial_section, result.trials) if len(result.trials) > 1 else ()),
    )


def trials_section(trials: "Sequence[Trial]", more: "Sequence[tuple[str, Figures]]" = ()) -> Section:
    """Return the table of errors, one row a trial."""
    rows = []
    for name, figures in (*((trial.recording, trial.figures) for trial in trials), *more):
        row = {"recording": name} | {head: f"{getattr(figures, key):.2f}" for key, head in COLUMNS}
        shares = {"pitch defined (%)": figures.pitch_defined, "optics seen (%)": figures.valid_optics}
        rows.append(row | {head: f"{100.0 * share:.1f}" for head, share in shares.items()})
    text = (
        "Root-mean-square over the motion; end errors are medians over the first three seconds after it.",
        f"{PITCH_DEFINED}.",
        f"{OPTICS_SEEN} rests and ends of the file do not count in it.",
    )
    return rows_section("Errors", rows, text=text)


def expected_rows(trials: "Sequence[Trial]") -> list[tuple[str, ...]]:
    """Return observed and expected errors, deg, one row a trial: end total, then total over the motion."""
    rows = list[tuple[str, ...]]()
    for trial in trials:
        made, figures = trial.expected, trial.figures
        if made is not None:
            end = (figures.end_total_deg, made.end_total_deg, made.end_at_most_deg)
            rmse = (figures.rmse_total_deg, made.rmse_total_deg, made.rmse_at_most_deg)
            cells = [
                (told_apart(seen, ".2f", most), f"{root:.2f}", told_apart(most, ".2f", seen))
                for seen, root, most in (end, rmse)
            ]
            rows.append((trial.recording, *cells[0], *cells[1]))
    return rows


def coverage_text(coverage: "Coverage") -> str:
    """Return how many of the observed errors are no larger than stated."""
    return (
        f"not larger than expected (95 %, at most): end error {coverage.end_inside} of {coverage.ends}, total error over the "
        f"motion {coverage.rmse_inside} of {coverage.trials}"
    )


def _expected(result: "Validation") -> tuple[Section, ...]:
    if result.coverage is None:
        return ()
    heads = ("recording", "end total (deg)", "expected", "at most", "total rmse (deg)", "expected rmse", "rmse at most")
    rows = [dict(zip(heads, row, strict=True)) for row in expected_rows(result.trials)]
    text = (
        "Expected: root mean square of the errors that follow from the calibration's covariance and from what changes between "
        f"recordings of a device. At most: 95 % of the errors are no larger. {coverage_text(result.coverage).capitalize()}.",
    )
    return (rows_section("Observed and expected errors", rows, text=text),)


def trial_section(trial: "Trial") -> Section:
    """Return the course of one trial: pitch of device and optics, and the errors."""
    return Section(title=trial.recording, findings=trial.findings, pictures=(svg_of(trial_figure(trial)),), folded=True)


def trial_figure(trial: "Trial") -> "Figure":
    """Draw the course of one trial: pitch of device and optics, and the errors, the motion shaded."""
    return draw_comparison(
        trial.time,
        trial.sensor_pitch / RADIAN_PER_DEGREE,
        trial.reference_pitch / RADIAN_PER_DEGREE,
        [(name, getattr(trial.error, name) / RADIAN_PER_DEGREE) for name in ("total", "inclination", "pitch")],
        title=f"{trial.recording}: sagittal pitch",
        moving=trial.moving,
    )


def draw_validation(result: "Validation") -> "Figure":
    """Draw the errors of each trial: total, inclination and pitch, root mean square."""
    names = [trial.recording for trial in result.trials]
    keys = {"total": "rmse_total_deg", "inclination": "rmse_inclination_deg", "pitch": "rmse_pitch_deg"}
    values = {name: [getattr(trial.figures, key) for trial in result.trials] for name, key in keys.items()}
    return draw_bars(names, values, title="Errors against the reference", label="rms over the motion (deg)")


def _agreement(result: "Validation") -> tuple[Section, ...]:
    if result.agreement is None:
        return ()
    limits, absolute = result.agreement.limits, result.agreement.absolute
    pairs = np.array([trial.mean_inclination for trial in result.trials]) / RADIAN_PER_DEGREE
    figure = draw_agreement(pairs.mean(axis=1), pairs[:, 0] - pairs[:, 1], limits.bias, limits.limits, unit="trial")
    text = (
        f"Mean inclination of each trial: bias {limits.bias:+.2f} deg, 95 % limits {limits.limits[0]:+.2f} to "
        f"{limits.limits[1]:+.2f} deg over {limits.count} trials. {absolute.kind} {absolute.value:.3f} "
        f"[{absolute.interval[0]:.3f}, {absolute.interval[1]:.3f}], standard error of measurement "
        f"{absolute.standard_error_of_measurement:.2f} deg. An ICC depends on how much the trials differ."
    )
    return (Section(title="Agreement over trials", text=(text,), pictures=(svg_of(figure),)),)
