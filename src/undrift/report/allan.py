"""The Allan plot: what averaging does to the readings of a device at rest."""

from typing import TYPE_CHECKING

import numpy as np

from undrift.calibration.noise import NoiseFit
from undrift.report.figures import AXIS_COLOURS, LIMIT, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def draw_allan(found: NoiseFit, *, title: str) -> "Figure":
    """Draw Allan deviation over averaging time, with its intervals and the slope of white noise as a guide.

    Parameters
    ----------
    found : NoiseFit
        A triad or both.
    title : str
        Heading.

    Returns
    -------
    Figure
        One panel a triad, both axes logarithmic; a bar at each point is its interval.
    """
    both = (
        ("gyro", found.gyro, found.gyro_adev, found.gyro_limits, found.gyro_unit),
        ("accel", found.accel, found.accel_adev, found.accel_limits, found.accel_unit),
    )
    triads = [triad for triad in both if triad[1]]
    figure, panels = new_figure(len(triads), height=3.4)
    taus = found.taus_s
    for panel, (name, axes, deviation, limits, unit) in zip(panels, triads, strict=True):
        for k, (axis, colour) in enumerate(zip(axes, AXIS_COLOURS, strict=False)):
            course = deviation[:, k]
            reach = np.abs(limits[:, :, k] - course)  # bars are lengths down and up
            panel.errorbar(
                taus,
                course,
                yerr=reach,
                color=colour,
                marker="o",
                markersize=2.5,
                elinewidth=0.7,
                label=f"{name} {axis.axis}",
            )
        panel.set_xscale("log")
        panel.set_yscale("log")
        anchor = float(np.nanmedian(deviation[0]))
        panel.plot(taus, anchor * np.sqrt(taus[0] / taus), color=LIMIT, linestyle=":", label="white noise, slope -1/2")
        panel.set_ylabel(f"Allan deviation ({unit})")
        panel.legend(loc="best", frameon=False)
    panels[0].set_title(f"{title}, bars: {100.0 * found.confidence:g} %", loc="left", fontsize=10)
    panels[-1].set_xlabel("averaging time (s)")
    return figure
