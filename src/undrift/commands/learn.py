"""``undrift learn``: update gyroscope offsets over temperature, and accelerometers, by the rests of daily recordings."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from undrift.base.options import Files, OptionalOutput, Picture, verb
from undrift.base.summary import NOTHING_WRITTEN, Section, Summary, figure_of, rows_section
from undrift.commands import Progress, part_of, reading, silent
from undrift.commands.files import Opening, check_figure, check_output, dates_of, thermal_session
from undrift.errors import InputError
from undrift.units import RADIAN_PER_DEGREE

if TYPE_CHECKING:
    from undrift.arrays import FloatArray
    from undrift.drift.accel_in_use import AccelUseFit
    from undrift.drift.learn import LearnFit

ROWS = 9  # of the nodes, shown


@verb
def learn(
    *recordings: Files,
    calibration: Path,
    output: OptionalOutput = None,
    date: Annotated[tuple[str, ...], Parameter(show_default=False)] = (),
    power_on_s: float | None = None,
    figure: Picture = None,
    opening: Opening = Opening(),
    progress: Progress = silent,
) -> Summary:
    """Update the gyroscopes' offset over temperature by the rests of daily recordings, with turn-on repeatability and ageing.

    Where the rests point six ways or more, they also update offset and scale of the accelerometers.

    Parameters
    ----------
    recordings : Path
        Recordings of daily use, or session folders, one for each switch-on; rests on a table and of a quiet body are found.
    calibration : Path
        calibration.json of the device, with tables over temperature or without. What it was learnt from before is kept in it.
    output : Path or None
        calibration.json to write; may be the one that was read.
    date : str
        Date of each recording, in the same order, as 2026-03-01 or 2026-03-01T08:30; by default that in its name, else that of
        the file's last change.
    power_on_s : float or None
        Time since power-on when each recording begins, s; needed where the calibration holds a warm-up.
    figure : Path or None
        Picture of the offsets before and now with the rests: .svg, .png or .pdf.
    """
    from undrift.drift.learn import LearnSettings, learn_drift
    from undrift.findings import finding
    from undrift.io.store import read_calibration, write_calibration
    from undrift.model import Verdict

    if power_on_s is not None and not 0.0 <= power_on_s < float("inf"):
        raise InputError(f"power-on-s: wanted 0 s or more, got {power_on_s:g}; leave it out where it is not known")
    read = (*(path for path in recordings if path.exists()), opening.column_map)
    check_output(output, endings=(".json",), reads=read)  # may be the calibration that was read: it is written whole
    check_figure(figure, reads=(*read, calibration))
    dates, changed = dates_of(recordings, date)
    model = read_calibration(calibration)
    opening, sessions = opening.like(model, calibration), []
    for k, path in enumerate(recordings):
        with reading(part_of(progress, 0.8 * k / len(recordings), 0.8 * (k + 1) / len(recordings)), 1.0, path):
            sessions.append(thermal_session(path, opening, model))
    progress("finding rests", 0.8)
    fit = learn_drift(sessions, model, dates=dates, settings=LearnSettings(power_on_s=power_on_s))
    if changed:
        note = Verdict.of(finding("drift.learn_file_dates", "info", count=changed))
        made = replace(fit.calibration, verdict=fit.calibration.verdict.also(note))
        fit = replace(fit, calibration=made, verdict=fit.verdict.also(note))
    drawing = figure_of("drift:draw_learnt", fit)
    if figure is not None:
        drawing.save(figure)
    if output is not None:
        write_calibration(fit.calibration, output)
    return replace(
        learn_summary(fit),
        data=_data(fit, output),
        pictures=(drawing,),
        written=(figure, output),
        after=() if output else (NOTHING_WRITTEN,),
        next=("correct", recordings[0], "--calibration", output, "-o", "corrected.parquet") if output else (),
    )


def learn_summary(fit: "LearnFit") -> Summary:
    """Return how well the offset is known now, some of the nodes, turn-on repeatability and ageing."""
    from undrift.drift.learn import CELL_C

    device, left = fit.calibration.device or "device without a serial number", int((~fit.rest_kept).sum())
    rests = f"{len(fit.rest_kept) - left} stretches at rest, each within {CELL_C:g} degC"
    near = ~fit.extrapolated if not fit.extrapolated.all() else fit.extrapolated
    after, before = (
        f"{float(u[near].max()) / RADIAN_PER_DEGREE:.2g} deg/s" for u in (fit.after_uncertainty, fit.before_uncertainty)
    )
    used = f"{device}: {rests}, in {fit.recordings} recordings, {left} left out"
    changes = None if fit.accel is None else _accel_rows(fit.accel)
    return Summary(
        title=f"Gyroscope offsets of {device}, by daily rests",
        answer=f"Near these rests the standard uncertainty of a switch-on to come is at most {after}, before {before}.",
        sections=(
            Section(title="What was used", text=(used,)),
            rows_section("gyroscope offset, x y z, uncertainty of a switch-on to come", _nodes(fit)),
            rows_section("standard deviations", _deviations(fit)),
            *((rows_section("accelerometers, change and uncertainty", changes),) if changes else ()),
        ),
        verdict=fit.verdict,
        failed=fit.verdict.status == "bad",
    )


def _data(fit: "LearnFit", output: Path | None) -> dict[str, Any]:
    """Return what was learnt, in deg/s, for JSON."""
    from undrift.io.store import verdict_json

    columns = ("before", "before_uncertainty", "after", "after_uncertainty", "curve_uncertainty")
    nodes = [
        {"temp_c": temp, "extrapolated": bool(fit.extrapolated[k])}
        | {f"{name}_dps": getattr(fit, name)[k] / RADIAN_PER_DEGREE for name in columns}
        for k, temp in enumerate(fit.temp_c.tolist())
    ]
    figures = ("turn_on", "turn_on_uncertainty", "ageing", "ageing_uncertainty", "rest_scatter")
    return {
        "device": fit.calibration.device,
        "output": None if output is None else str(output),
        "recordings": fit.recordings,
        "rests": {"count": len(fit.rest_kept), "left_out": int((~fit.rest_kept).sum())},
        **{f"{name}_dps": getattr(fit, name) / RADIAN_PER_DEGREE for name in figures},
        "nodes": nodes,
        "accelerometers": None if fit.accel is None else _accel(fit.accel),
        "verdict": verdict_json(fit.verdict),
    }


def _accel(fit: "AccelUseFit") -> dict[str, Any]:
    """Return what the rests say about the accelerometers, of three axes: no change where they stay as they were."""
    from undrift.calibration.norm import MG

    doubt, change = (
        (fit.covariance.diagonal() ** 0.5, fit.change) if fit.changed else (fit.before, 0.0 * abs(fit.change))
    )
    figures: dict[str, Any] = {"changed": fit.changed, "directions": fit.directions, "held_out_mg": fit.held_out / MG}
    for name, k, unit in (("offset_mg", 6, MG), ("scale_percent", 0, 0.01), ("offset_mg_per_k", 9, MG)):
        figures |= {name: change[k : k + 3] / unit, f"{name}_uncertainty": doubt[k : k + 3] / unit}
    return figures


def _accel_rows(fit: "AccelUseFit") -> list[dict[str, str]]:
    """Return a row for each axis, in words."""
    heads = {"offset (mg)": "offset_mg", "scale (%)": "scale_percent", "offset (mg/K)": "offset_mg_per_k"}
    figures = _accel(fit)
    return [
        {"axis": axis}
        | {head: f"{figures[key][i]:+.2f} +- {figures[f'{key}_uncertainty'][i]:.2g}" for head, key in heads.items()}
        for i, axis in enumerate("xyz")
    ]


def _nodes(fit: "LearnFit") -> list[dict[str, str]]:
    """Return a row for some of the nodes: x, y and z in each cell, deg/s."""
    import numpy as np

    def cells(value: "FloatArray", form: str) -> str:
        return " ".join(format(x, form) for x in value / RADIAN_PER_DEGREE)

    chosen = np.unique(np.linspace(0, len(fit.temp_c) - 1, min(ROWS, len(fit.temp_c))).round().astype(int))
    return [
        {
            "temperature (degC)": f"{fit.temp_c[k]:g}{' extrapolated' if fit.extrapolated[k] else ''}",
            "offset (deg/s)": cells(fit.after[k], "+.3f"),
            "change (deg/s)": cells(fit.after[k] - fit.before[k], "+.3f"),
            "uncertainty before (deg/s)": cells(fit.before_uncertainty[k], ".3f"),
            "uncertainty (deg/s)": cells(fit.after_uncertainty[k], ".3f"),
        }
        for k in chosen
    ]


def _deviations(fit: "LearnFit") -> list[dict[str, str]]:
    """Return a row for each axis: from one switch-on to the next, and with time."""

    def cell(name: str, k: int) -> str:
        value, doubt = (getattr(fit, key)[k] / RADIAN_PER_DEGREE for key in (name, f"{name}_uncertainty"))
        return f"{value:.2g} +- {doubt:.1g}"

    return [
        {"axis": axis, "turn-on (deg/s)": cell("turn_on", k), "ageing in 30 days (deg/s)": cell("ageing", k)}
        for k, axis in enumerate("xyz")
    ]
