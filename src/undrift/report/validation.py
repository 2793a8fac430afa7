"""The page of a validation: a table of errors, the course of each trial, agreement over trials."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from undrift.report.figures import draw_agreement, draw_comparison, svg_of
from undrift.report.page import Section, write_page
from undrift.report.validation_method import Method, method_section, recordings_section
from undrift.units import RADIAN_PER_DEGREE

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.figure import Figure

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
)
PITCH_DEFINED = (
    "Pitch defined: share of the samples in which pitch is defined; it is left out where the body lies within 5 deg of its side, "
    "and near there pitch max may exceed the error in space"
)
OPTICS_SEEN = "Optics seen: share of the motion in which the reference saw the body, where alone errors count;"


def write_validation_report(result: "Validation", method: Method, path: Path) -> None:
    """Write the page of a validation.

    Parameters
    ----------
    result : Validation
        Trials and what they come to.
    method : Method
        What was asked for.
    path : Path
        The .html file.
    """
    write_page(
        path,
        title="Against the reference",
        lead=f"{len(result.trials)} recording{'s' * (len(result.trials) > 1)}, errors in degrees.",
        sections=validation_sections(result, method),
    )


def validation_sections(result: "Validation", method: Method) -> tuple[Section, ...]:
    """Return the sections of a validation's page.

    Parameters
    ----------
    result : Validation
        Trials and what they come to.
    method : Method
        What was asked for.

    Returns
    -------
    tuple of Section
        Errors, what was done, recordings, agreement, one section a trial.
    """
    rows = [("mean", result.mean), ("median", result.median)] if len(result.trials) > 1 else []
    return (
        trials_section(result.trials, rows),
        method_section(method),
        recordings_section(method, result.trials),
        *_agreement(result),
        *map(trial_section, result.trials),
    )


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
        text=(
            "Root-mean-square over the motion; end errors are medians over the first three seconds after it.",
            f"{PITCH_DEFINED}.",
            f"{OPTICS_SEEN} rests and ends of the file do not count in it.",
        ),
        columns=("recording", *(head for _, head in COLUMNS), "pitch defined (%)", "optics seen (%)"),
        rows=tuple(_row(name, figures) for name, figures in (*named, *more)),
    )


def _row(name: str, figures: "Figures") -> tuple[str, ...]:
    cells = (f"{getattr(figures, key):.2f}" for key, _ in COLUMNS)
    return (name, *cells, f"{100.0 * figures.pitch_defined:.1f}", f"{100.0 * figures.valid_optics:.1f}")


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
    return Section(title=trial.recording, text=trial.notes, pictures=(svg_of(trial_figure(trial)),))


def trial_figure(trial: "Trial") -> "Figure":
    """Draw the course of one trial: pitch of device and optics, and the errors, the motion shaded.

    Parameters
    ----------
    trial : Trial
        A recording judged.

    Returns
    -------
    Figure
        Two panels, deg over s.
    """
    errors = (("total", trial.error.total), ("inclination", trial.error.inclination), ("pitch", trial.error.pitch))
    return draw_comparison(
        trial.time,
        _degrees(trial.sensor_pitch),
        _degrees(trial.reference_pitch),
        [(name, _degrees(course)) for name, course in errors],
        title=f"{trial.recording}: sagittal pitch",
        moving=trial.moving,
    )


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
