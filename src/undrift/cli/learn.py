"""``undrift learn``: update the offset over temperature by the rests of daily recordings, no chamber needed."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from undrift.base.options import Details, Files, Json, OptionalOutput
from undrift.cli.common import Steps, say, say_next, show_table, show_verdict, write_json
from undrift.commands.files import Opening, check_figure, check_output, dates_of
from undrift.errors import InputError

if TYPE_CHECKING:
    from undrift.drift.learn import LearnFit


def learn(
    *recordings: Files,
    calibration: Path,
    output: OptionalOutput = None,
    date: Annotated[tuple[str, ...], Parameter(show_default=False)] = (),
    power_on_s: float | None = None,
    figure: Path | None = None,
    opening: Opening = Opening(),
    details: Details = False,
    json: Json = False,
) -> int:
    """Update the gyroscopes' offset over temperature by the rests of daily recordings, with turn-on repeatability and ageing.

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
    from undrift.cli.drift import read_thermal
    from undrift.drift.daily_rests import LearnSettings
    from undrift.drift.learn import learn_drift
    from undrift.findings import finding
    from undrift.io.store import read_calibration, write_calibration
    from undrift.model import Verdict
    from undrift.report.drift import draw_learnt
    from undrift.report.figures import save_figure

    if power_on_s is not None and not 0.0 <= power_on_s < float("inf"):
        raise InputError(f"power-on-s: wanted 0 s or more, got {power_on_s:g}; leave it out where it is not known")
    read = (*(path for path in recordings if path.exists()), opening.column_map)
    check_output(output, endings=(".json",), reads=read)  # may be the calibration that was read: it is written whole
    check_figure(figure, reads=(*read, calibration))
    dates, changed = dates_of(recordings, date)
    model = read_calibration(calibration)
    own, sessions = opening.like(model, calibration), []
    with Steps("learn") as shown:
        for k, path in enumerate(recordings):
            shown(f"reading {path.name}", 0.8 * k / len(recordings))
            sessions.append(read_thermal(path, own, model))
        shown("finding rests", 0.8)
        fit = learn_drift(sessions, model, dates=dates, settings=LearnSettings(power_on_s=power_on_s))
    if changed:
        note = Verdict.of(finding("drift.learn_file_dates", "info", count=changed))
        made = replace(fit.calibration, verdict=fit.calibration.verdict.also(note))
        fit = replace(fit, calibration=made, verdict=fit.verdict.also(note))
    if figure is not None:
        save_figure(draw_learnt(fit), figure)
    if output is not None:
        write_calibration(fit.calibration, output)
    if json:
        write_json(_summary(fit, output), "learn")
    else:
        _show(fit)
        show_verdict(fit.verdict, details=details)
        say(*(f"Wrote {path}" for path in (figure, output) if path is not None))
        if output is None:
            say("No tables were written: add -o calibration.json to keep them")
        else:
            say_next("correct", recordings[0], "--calibration", output, "-o", "corrected.parquet")
    return 1 if fit.verdict.status == "bad" else 0


def _summary(fit: "LearnFit", output: Path | None) -> dict[str, object]:
    """Return what was learnt, in deg/s, for JSON."""
    from undrift.io.store import verdict_json
    from undrift.units import RADIAN_PER_DEGREE

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
        "verdict": verdict_json(fit.verdict),
    }


def _show(fit: "LearnFit") -> None:
    from undrift.drift.daily_rests import CELL_C
    from undrift.report.drift import LEARN_HEADS, learn_rows
    from undrift.units import RADIAN_PER_DEGREE

    device = fit.calibration.device or "device without a serial number"
    cells, left = len(fit.rest_kept), int((~fit.rest_kept).sum())
    say(
        f"{device}: {cells - left} stretches at rest, each within {CELL_C:g} degC, in {fit.recordings} recordings, {left} left out"
    )
    show_table("gyroscope offset, x y z, uncertainty of a switch-on to come", LEARN_HEADS, learn_rows(fit))
    rows = [
        (
            axis,
            f"{fit.turn_on[k] / RADIAN_PER_DEGREE:.2g} +- {fit.turn_on_uncertainty[k] / RADIAN_PER_DEGREE:.1g}",
            f"{fit.ageing[k] / RADIAN_PER_DEGREE:.2g} +- {fit.ageing_uncertainty[k] / RADIAN_PER_DEGREE:.1g}",
        )
        for k, axis in enumerate("xyz")
    ]
    show_table("standard deviations", ("axis", "turn-on (deg/s)", "ageing in 30 days (deg/s)"), rows)
