"""The part of a page that shows a calibration: matrices with their uncertainty, and what the fits say."""

import math
from typing import TYPE_CHECKING

from undrift.report.page import Section

if TYPE_CHECKING:
    from undrift.calibration.model import Calibration, TriadModel


def concise(value: float, uncertainty: float) -> str:
    """Return a value with its standard uncertainty in brackets, in units of the last digits: 0.99643(11).

    Parameters
    ----------
    value, uncertainty : float
        In the same unit; an uncertainty of zero marks a value that was held fixed.

    Returns
    -------
    str
        Two digits of uncertainty (GUM, 7.2.2).
    """
    if not (uncertainty > 0.0 and math.isfinite(uncertainty)):
        return f"{value:.6g}"
    places = max(0, 1 - math.floor(math.log10(uncertainty)))
    if places > 9:
        return f"{value:.6g}({uncertainty:.1g})"
    return f"{value:.{places}f}({round(uncertainty * 10.0**places)})"


def triad_rows(triad: "TriadModel") -> tuple[tuple[str, ...], ...]:
    """Return one row of cells for each axis: matrix, offset, scale factor, values with their uncertainty.

    Parameters
    ----------
    triad : TriadModel
        What was fitted.

    Returns
    -------
    tuple of tuple of str
        axis, m x, m y, m z, offset, scale factor.
    """
    sigma = dict(zip(triad.parameters, triad.standard_uncertainty, strict=True))
    rows = []
    for k, axis in enumerate("xyz"):
        matrix = [concise(triad.matrix[k, i], sigma.get(f"m_{axis}{other}", 0.0)) for i, other in enumerate("xyz")]
        offset = concise(triad.offset[k], sigma.get(f"offset_{axis}", 0.0))
        rows.append((axis, *matrix, offset, f"{triad.scale_factor[k]:.6g}"))
    return tuple(rows)


def triad_heads(triad: "TriadModel") -> tuple[str, ...]:
    """Return the heads of ``triad_rows``.

    Parameters
    ----------
    triad : TriadModel
        What was fitted.

    Returns
    -------
    tuple of str
        With units.
    """
    return (
        "axis",
        "m x",
        "m y",
        "m z",
        f"offset ({triad.unit_in})",
        f"scale factor ({triad.unit_in} per {triad.unit_out})",
    )


def triad_notes(triad: "TriadModel") -> tuple[str, ...]:
    """Return what goes with the rows: residual, rank, condition, range, g-sensitivity.

    Parameters
    ----------
    triad : TriadModel
        What was fitted.

    Returns
    -------
    tuple of str
        One or two sentences.
    """
    low, high = triad.valid_range
    notes = [
        f"residual {triad.rms_residual:.3g} {triad.unit_out} rms over {triad.count} equations; rank {triad.rank}, "
        f"condition {triad.condition:.3g}; valid {low:.3g} to {high:.3g} {triad.unit_out}"
    ]
    if triad.g_sensitivity is not None:
        worst = float(abs(triad.g_sensitivity).max())
        notes.append(f"g-sensitivity up to {worst:.2g} {triad.unit_out} per m/s2")
    return tuple(notes)


def calibration_sections(calibration: "Calibration") -> tuple[Section, ...]:
    """Return the sections of a page that show a calibration.

    Parameters
    ----------
    calibration : Calibration
        What was fitted.

    Returns
    -------
    tuple of Section
        One for each triad; standard uncertainties in brackets.
    """
    named = (("Accelerometers", calibration.accel), ("Gyroscopes", calibration.gyro))
    return tuple(
        Section(
            title=f"{name}: {triad.method}",
            text=(
                f"corrected = matrix @ (raw - offset); matrix in {triad.unit_out} per {triad.unit_in}, standard uncertainty of "
                "the last digits in brackets.",
                *triad_notes(triad),
            ),
            columns=triad_heads(triad),
            rows=triad_rows(triad),
        )
        for name, triad in named
        if triad is not None
    )
