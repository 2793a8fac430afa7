"""The page of a validation: a table of errors, the course of each trial, agreement over trials."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from undrift.report.figures import draw_agreement, draw_comparison, svg_of
from undrift.report.page import Section, write_page
from undrift.units import RADIAN_PER_DEGREE

if TYPE_CHECKING:
    from collections.abc import Sequence

    from undrift.arrays import FloatArray
    from undrift.validation import Figures, Trial, Validation

COLUMNS = (
    ("rmse_total_deg", "total rmse (deg)"),
    ("rmse_inclination_deg", "inclination rmse (deg)"),
    ("rmse_heading_deg", "heading rmse (deg)"),
    ("rmse_pitch_deg", "pitch rmse (deg)"),
    ("max_abs_pitch_deg", "pitch max (deg)"),
    ("end_total_deg", "end total (deg)"),
    ("end_inclination_deg", "end inclination (deg)"),
    ("drift_deg_per_min", "drift (deg/min)"),
    ("lag_ms", "lag (ms)"),
)
MOST_POINTS = 4000  # of a drawn course


def write_validation_report(result: "Validation", path: Path) -> None:
    """Write the page of a validation.

    Parameters
    ----------
    result : Validation
        Trials and what they come to.
    path : Path
        The .html file.
    """
    write_page(
        path,
        title="Against the reference",
        lead=f"{len(result.trials)} recording{'s' * (len(result.trials) > 1)}, errors in degrees.",
        sections=validation_sections(result),
    )


def validation_sections(result: "Validation") -> tuple[Section, ...]:
    """Return the sections of a validation's page.

    Parameters
    ----------
    result : Validation
        Trials and what they come to.

    Returns
    -------
    tuple of Section
        Table, agreement, one section a trial.
    """
    rows = [("mean", result.mean), ("median", result.median)] if len(result.trials) > 1 else []
    return (trials_section(result.trials, rows), *_agreement(result), *map(trial_section, result.trials))


def trials_section(trials: "Sequence[Trial]", more: "Sequence[tuple[str, Figures]]" = ()) -> Section:
    """Return the table of errors, one row a trial.

    Parameters
    ----------
    trials : sequence of Trial
        Recordings judged.
    more : sequence of (str, Figures)
        Further rows, such as the mean.

    Returns
    -------
    Section
        In degrees.
    """
    named = [(trial.recording, trial.figures) for trial in trials]
    return Section(
        title="Errors",
        text=("Root-mean-square over the motion; end errors are medians over the first three seconds after it.",),
        columns=("recording", *(head for _, head in COLUMNS), "optics seen (%)"),
        rows=tuple(_row(name, figures) for name, figures in (*named, *more)),
    )


def _row(name: str, figures: "Figures") -> tuple[str, ...]:
    cells = (f"{getattr(figures, key):.2f}" for key, _ in COLUMNS)
    return (name, *cells, f"{100.0 * figures.valid_optics:.1f}")


def trial_section(trial: "Trial") -> Section:
    """Return the course of one trial: pitch of device and optics, and the errors.

    Parameters
    ----------
    trial : Trial
        A recording judged.

    Returns
    -------
    Section
        With its notes and a picture.
    """
    errors = (
        ("total", _degrees(trial.error.total)),
        ("inclination", _degrees(trial.error.inclination)),
        ("pitch", _degrees(trial.error.pitch)),
    )
    step = max(1, len(trial.time) // MOST_POINTS)
    thin = slice(None, None, step)
    figure = draw_comparison(
        trial.time[thin],
        _degrees(trial.sensor_pitch)[thin],
        _degrees(trial.reference_pitch)[thin],
        [(name, course[thin]) for name, course in errors],
        title=f"{trial.recording}: sagittal pitch",
    )
    return Section(title=trial.recording, text=trial.notes, pictures=(svg_of(figure),))


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


def _degrees(angles: "FloatArray") -> "FloatArray":
    degrees: FloatArray = angles / RADIAN_PER_DEGREE
    return degrees
