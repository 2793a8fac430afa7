"""``undrift noise``: noise coefficients of a device at rest."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from undrift.cli.common import (
    Details,
    Json,
    Opening,
    calibrated_part,
    check_gravity,
    check_output,
    say,
    show_table,
    show_verdict,
    waiting,
    write_json,
)
from undrift.errors import InputError
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

if TYPE_CHECKING:
    from undrift.calibration.noise import AxisNoise
    from undrift.record import Record


def noise(
    record: Path,
    /,
    *,
    calibration: Path | None = None,
    start_s: float | None = None,
    stop_s: float | None = None,
    power_on_s: float | None = None,
    figure: Annotated[Path | None, Parameter(name=["--figure", "-o"])] = None,
    opening: Opening = Opening(),
    details: Details = False,
    json: Json = False,
) -> int:
    """Angle random walk, bias instability, rate random walk of a device at rest, each with its 95 % interval.

    Parameters
    ----------
    record : Path
        Recording at rest; hours show more than minutes.
    calibration : Path or None
        calibration.json: turns counts into rad/s and m/s2 first.
    start_s : float or None
        Use the recording from here on, s on its own clock.
    stop_s : float or None
        Use the recording up to here, s on its own clock.
    power_on_s : float or None
        Time since power-on at the first sample, s; without it no warm-up is subtracted.
    figure : Path or None
        Allan plot to write: .svg, .png or .pdf.
    opening : Opening
        How to read a foreign recording.
    """
    from undrift.calibration.noise import TERMS, fit_noise
    from undrift.io.store import read_calibration, verdict_json
    from undrift.report.figures import PICTURES, draw_allan, save_figure

    check_output(figure, endings=PICTURES, reads=(record, calibration))
    with waiting("reading and fitting"):
        model = None if calibration is None else read_calibration(calibration)
        readings, notes = opening.like(model, calibration).read(record), tuple[str, ...]()
        began = readings.time[0]
        if start_s is not None or stop_s is not None:
            readings = _between(readings, start_s, stop_s)
        if model is not None:
            from undrift.correction.correct import correct_checked

            since = None if power_on_s is None else float(power_on_s + readings.time[0] - began)
            readings, left_out = calibrated_part(readings, model)
            done = correct_checked(readings, model, power_on_s=since)
            readings, notes = done.record, (*left_out, *done.warnings, *done.notes)
        check_gravity(readings, record)
        found = fit_noise(readings)
    if figure is not None:
        save_figure(draw_allan(found, title=f"{record.name}: overlapping Allan deviation"), figure)
    if json:
        triads = ("gyro", "accel")
        write_json(
            {name: [_axis_json(axis) for axis in getattr(found, name)] for name in triads}
            | {
                key: {name: getattr(found, f"{name}_{of}") for name in triads}
                for key, of in (("adev", "adev"), ("units", "unit"))
            }
            | {key: getattr(found, key) for key in ("taus_s", "duration_s", "confidence")}
            | {"verdict": verdict_json(found.verdict), "notes": notes},
            "noise",
        )
        return 0
    for what, triad, axes in (("gyroscopes", "gyro", found.gyro), ("accelerometers", "accel", found.accel)):
        if axes:
            title = f"{what}, in brackets the {100.0 * found.confidence:g} % intervals"
            _show(title, axes, tuple(TERMS[triad].values()))
    show_verdict(found.verdict, details=details)
    say(*(f"  note: {note}" for note in notes), *([] if figure is None else [f"Wrote {figure}"]))
    return 0


def _between(record: "Record", start_s: float | None, stop_s: float | None) -> "Record":
    """Return the stretch that was asked for, which must lie within the recording."""
    first, last = float(record.time[0]), float(record.time[-1])
    start, stop = first if start_s is None else start_s, float("inf") if stop_s is None else stop_s
    if not (start < stop and start < last and stop > first):
        raise InputError(
            f"--start-s, --stop-s: wanted a stretch of the recording, which goes from {first:.6g} to {last:.6g} s, got {start:g} "
            f"to {stop:g} s; name times on its own clock"
        )
    return record.between(start, stop)


def _axis_json(axis: "AxisNoise") -> dict[str, object]:
    names = ("angle_random_walk", "bias_instability", "rate_random_walk", "quantization")
    made: dict[str, object] = {"axis": axis.axis}
    for name in names:
        made[name] = {key: getattr(getattr(axis, name), key) for key in ("value", "interval", "unit", "reason")}
    customary = _customary(axis)
    return made if customary is None else made | {customary[1]: customary[0]}


def _customary(axis: "AxisNoise") -> tuple[float, str, str] | None:
    """Return the random walk as data sheets have it, with its name in JSON and its unit; None for counts and volts."""
    walk = axis.angle_random_walk
    if walk.unit == "rad/s/sqrt(Hz)":  # which is rad/sqrt(s): 60 sqrt(s) make a sqrt(h)
        return 60.0 * walk.value / RADIAN_PER_DEGREE, "angle_random_walk_deg_per_sqrt_h", "deg/sqrt(h)"
    if walk.unit == "m/s2/sqrt(Hz)":
        return 1e6 * walk.value / STANDARD_GRAVITY, "velocity_random_walk_ug_per_sqrt_hz", "ug/sqrt(Hz)"
    return None


def _show(title: str, axes: tuple["AxisNoise", ...], names: tuple[str, ...]) -> None:
    rows = []
    for axis in axes:
        three = (axis.angle_random_walk, axis.bias_instability, axis.rate_random_walk)
        cells = [
            f"{c.value:.3g} [{c.interval[0]:.3g}, {c.interval[1]:.3g}]"
            if c.value == c.value
            else f"not seen, under {c.interval[1]:.2g}"
            for c in three
        ]
        rows.append((axis.axis, *cells))
    heads = [f"{name} ({c.unit})" for name, c in zip(names, three, strict=True)]
    show_table(title, ("axis", *heads), rows)
    walks = [(axis.axis, customary) for axis in axes if (customary := _customary(axis)) is not None]
    if walks:
        values = ", ".join(f"{axis} {value:.3g}" for axis, (value, _, _) in walks)
        say(f"{names[0]} in {walks[0][1][2]}: {values}")
