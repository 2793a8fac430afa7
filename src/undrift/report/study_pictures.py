"""Pictures of a study: error surface, what each parameter does, error against rig time, Figure 3."""

from typing import TYPE_CHECKING, Any

import numpy as np

from undrift.report.figures import DEVICE, ERROR, LIMIT, OPTICS, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from undrift.arrays import FloatArray
    from undrift.study.figure3 import Figure3
    from undrift.study.outcome import StudyOutcome, TaskOutcome

NAMES = {
    "cutoff_hz": "cut-off (Hz)",
    "turn_rate_step_dps": "step d (deg/s)",
    "turn_rate_min_dps": "omega_m (deg/s)",
    "turn_rate_max_dps": "omega_M (deg/s)",
}
LEAST_P = 1e-4  # below it a p value is no longer told by its digits
LEAST_CONTRAST = 2.0  # of the ends of the colours: small differences are to look small
LEVEL_NAMES = ("no compensation", "static", "static and dynamic")
LEVEL_COLOURS = (LIMIT, ERROR, DEVICE)


def told_p(p: float) -> str:
    """Return a p value for people.

    Parameters
    ----------
    p : float
        0 to 1.

    Returns
    -------
    str
        Two digits, or that it is below 0.0001.
    """
    return f"{p:.2g}" if p >= LEAST_P else f"< {LEAST_P:.4f}"


def draw_surface(outcome: "StudyOutcome", task: "TaskOutcome") -> "Figure":
    """Draw the mean error over the protocols: a column for each step d, what is not shown at its best.

    Parameters
    ----------
    outcome : StudyOutcome
        Says what is minimised.
    task : TaskOutcome
        With its surface.

    Returns
    -------
    Figure
        Upper row cut-off against omega_M, lower row omega_m against omega_M; a star on the optimum, a ring on the note's.
    """
    surface = task.surface
    mean = surface.error(outcome.study.objective).mean(axis=0)
    steps = np.unique(surface.turn_rate_step_dps)
    figure, axes = new_figure(2, columns=len(steps), height=2.0, share_x=False)
    low, high = float(np.nanmin(mean)), float(np.nanmax(mean))
    if high < LEAST_CONTRAST * low:
        middle, reach = np.sqrt(low * high), np.sqrt(LEAST_CONTRAST)
        low, high = middle / reach, middle * reach
    mesh: Any = None
    marks = [(task.optimum.best, "*", DEVICE, 90)]
    if task.beside is not None and task.beside.place is not None:
        marks.append((task.beside.place, "o", OPTICS, 110))
    for row, name in enumerate(("cutoff_hz", "turn_rate_min_dps")):
        ys, xs = np.unique(getattr(surface, name)), np.unique(surface.turn_rate_max_dps)
        for column, step in enumerate(steps):
            panel = axes[row * len(steps) + column]
            shown = _least(
                surface.turn_rate_max_dps, getattr(surface, name), mean, surface.turn_rate_step_dps == step, (xs, ys)
            )
            edges = np.arange(len(xs) + 1) - 0.5, np.arange(len(ys) + 1) - 0.5  # one row of cells has a height too
            mesh = panel.pcolormesh(*edges, shown, cmap="YlOrBr", vmin=low, vmax=high)
            panel.grid(False)
            panel.set_xticks(np.arange(len(xs)), [f"{x:.3g}" for x in xs])
            panel.set_yticks(np.arange(len(ys)), [f"{y:.3g}" for y in ys])
            if row == 0:
                panel.set_title(f"d = {step:.3g} deg/s", fontsize=9)
            else:
                panel.set_xlabel(NAMES["turn_rate_max_dps"])
            if column == 0:
                panel.set_ylabel(NAMES[name])
            for place, mark, colour, size in marks:
                if surface.turn_rate_step_dps[place] == step:
                    at = (
                        np.searchsorted(xs, surface.turn_rate_max_dps[place]),
                        np.searchsorted(ys, getattr(surface, name)[place]),
                    )
                    face = colour if mark == "*" else "none"
                    panel.scatter(*at, marker=mark, s=size, facecolor=face, edgecolor=colour, linewidth=1.4, zorder=3)
    figure.colorbar(mesh, ax=axes, shrink=0.7, label=f"mean {outcome.study.objective} error (deg)")
    return figure


def _least(x: "FloatArray", y: "FloatArray", error: "FloatArray", rows: Any, grid: Any) -> "FloatArray":
    """Return the least error of the protocols in each cell, NaN where none was tried."""
    xs, ys = grid
    shown = np.full((len(ys), len(xs)), np.nan)
    for place in np.flatnonzero(rows & np.isfinite(error)):
        at = np.searchsorted(ys, y[place]), np.searchsorted(xs, x[place])
        shown[at] = np.fmin(shown[at], error[place])
    return shown


def draw_effects(task: "TaskOutcome") -> "Figure":
    """Draw the mean error over each parameter, the others at the optimum, with 95 % intervals within subjects.

    Parameters
    ----------
    task : TaskOutcome
        With its effects.

    Returns
    -------
    Figure
        Four panels, one scale of error.
    """
    figure, axes = new_figure(1, columns=4, height=2.4, share_x=False)
    ends = []
    for panel, effect, reach in zip(axes, task.optimum.effects, task.effect_reach_deg, strict=True):
        panel.errorbar(
            effect.values, effect.means_deg, yerr=reach if reach > 0.0 else None, color=DEVICE, marker="o", ms=3.5
        )
        panel.set_xlabel(NAMES[effect.name])
        p = f"p {told_p(effect.p_holm)}" if effect.test is not None else "not tested"
        panel.set_title(p, fontsize=9)
        ends += [effect.means_deg.min() - reach, effect.means_deg.max() + reach]
        panel.set_xticks(effect.values if len(effect.values) < 6 else effect.values[::3])
        panel.xaxis.set_major_formatter("{x:.3g}")
    low, high = min(ends), max(ends)
    for k, panel in enumerate(axes):
        panel.set_ylim(low - 0.08 * (high - low) - 1e-3, high + 0.08 * (high - low) + 1e-3)
        if k:
            panel.tick_params(labelleft=False)
    axes[0].set_ylabel("mean error (deg)")
    return figure


def draw_pareto(outcome: "StudyOutcome", task: "TaskOutcome") -> "Figure":
    """Draw error against minutes on the rig, one point a protocol.

    Parameters
    ----------
    outcome : StudyOutcome
        Says what is minimised.
    task : TaskOutcome
        With its optimum.

    Returns
    -------
    Figure
        One panel.
    """
    figure, (axes,) = new_figure(1, height=3.0)
    surface, found = task.surface, task.optimum
    mean, good = surface.error(outcome.study.objective).mean(axis=0), found.equivalent
    if not good.all():
        axes.scatter(surface.rig_minutes[~good], mean[~good], color=LIMIT, s=9, label="worse than the optimum")
    axes.scatter(surface.rig_minutes[good], mean[good], color=DEVICE, s=11, label="as good as the optimum")
    axes.plot(
        surface.rig_minutes[found.pareto], mean[found.pareto], color=ERROR, label="nothing is both shorter and better"
    )
    marks = [(found.best, "*", "optimum"), (found.cheapest, "D", "shortest that is as good")]
    if found.best == found.cheapest:
        marks = [(found.best, "*", "optimum, and shortest that is as good")]
    for place, mark, label in marks:
        axes.scatter(
            surface.rig_minutes[place],
            mean[place],
            marker=mark,
            s=130 if mark == "*" else 50,
            facecolor=ERROR,
            edgecolor=OPTICS,
            zorder=4,
            label=label,
        )
    if task.beside is not None and task.beside.place is not None:
        at = task.beside.place
        axes.scatter(
            surface.rig_minutes[at],
            mean[at],
            marker="o",
            s=90,
            facecolor="none",
            edgecolor=OPTICS,
            zorder=4,
            label="the note",
        )
    axes.set_ylim(0.0, 1.1 * float(np.nanmax(mean)))
    axes.set_xlabel("session (min)")
    axes.set_ylabel(f"mean {outcome.study.objective} error (deg)")
    figure.legend(loc="outside right upper", frameon=False)
    return figure


def draw_figure3(found: "Figure3") -> "Figure":
    """Draw the note's Figure 3: pitch in the sit-to-stand, errors at each level, simulated against actual.

    Parameters
    ----------
    found : Figure3
        Courses.

    Returns
    -------
    Figure
        Three panels.
    """
    figure, (pitch, error, apart) = new_figure(3, height=1.9)
    pitch.plot(found.time, found.reference_pitch, color=OPTICS)
    pitch.set_ylabel("pitch (deg)")
    pitch.set_title("sit-to-stand as the optics saw it", loc="left", fontsize=9)
    for k, (name, colour) in enumerate(zip(LEVEL_NAMES, LEVEL_COLOURS, strict=True)):
        error.plot(found.time, found.actual[k], color=colour, label=f"{name}, actual")
        error.plot(found.time, found.simulated[k], color=colour, linestyle="--", label=f"{name}, simulated")
        apart.plot(found.time, found.actual[k] - found.simulated[k], color=colour, label=name)
    error.set_ylabel("error (deg)")
    error.set_title("error of the pitch: actual device full, simulated dashed", loc="left", fontsize=9)
    error.legend(loc="best", fontsize=7.5, frameon=False, ncols=3)
    for limit in (-0.15, 0.15):
        apart.axhline(limit, color=OPTICS, linewidth=0.7, linestyle=":")
    apart.set_ylabel("difference (deg)")
    apart.set_title("actual less simulated; dotted: the note's 0.15 deg", loc="left", fontsize=9)
    apart.set_xlabel("time (s)")
    return figure
