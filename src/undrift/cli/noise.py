"""``undrift noise``: what a device says when it does not move."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from undrift.cli.common import Flag, Opening, calibrated_part, check_gravity
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

if TYPE_CHECKING:
    from undrift.calibration.noise import AxisNoise, NoiseFit
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
    json: Flag = False,
) -> int:
    """Angle random walk, bias instability, rate random walk of a device at rest, each with its 95 % interval.

    Parameters
    ----------
    record : Path
        Recording at rest; hours show more than minutes.
    calibration : Path or None
        calibration.json: turns counts into rad/s and m/s2 first.
    start_s : float or None
        Take the recording from here only, s on its own clock.
    stop_s : float or None
        Take the recording up to here only, s on its own clock.
    power_on_s : float or None
        Time since power-on at the first sample, s; without it no warm-up is taken off.
    figure : Path or None
        Allan plot to write: .svg, .png or .pdf.
    opening : Opening
        How to read a foreign recording.
    json : bool
        One JSON object on stdout.

    Returns
    -------
    int
        Exit code.
    """
    from undrift.calibration.noise import TERMS, fit_noise
    from undrift.cli.common import checked_output, console, show_verdict, waiting, write_json
    from undrift.report.figures import PICTURES

    if figure is not None:
        checked_output(figure, endings=PICTURES, reads=(record, calibration))
    with waiting("reading and fitting"):
        readings, notes = opening.read(record), tuple[str, ...]()
        began = readings.time[0]
        if start_s is not None or stop_s is not None:
            readings = _between(readings, start_s, stop_s)
        if calibration is not None:
            from undrift.correction.correct import correct_checked
            from undrift.io.store import read_calibration

            since = None if power_on_s is None else float(power_on_s + readings.time[0] - began)
            model = read_calibration(calibration)
            readings, left_out = calibrated_part(readings, model)
            done = correct_checked(readings, model, power_on_s=since)
            readings, notes = done.record, (*left_out, *done.warnings, *done.notes)
        check_gravity(readings, record)
        found = fit_noise(readings)
    if figure is not None:
        _draw(found, figure, record.name)
    if json:
        write_json(noise_json(found) | {"notes": notes})
        return 0
    brackets = f"in brackets the {100.0 * found.confidence:g} % intervals"
    _show(f"gyroscopes, {brackets}", found.gyro, tuple(TERMS["gyro"].values()))
    _show(f"accelerometers, {brackets}", found.accel, tuple(TERMS["accel"].values()))
    show_verdict(found.verdict)
    for note in notes:
        console().print(f"  note: {note}", markup=False)
    if figure is not None:
        console().print(f"Wrote {figure}", markup=False)
    return 0


def _between(record: "Record", start_s: float | None, stop_s: float | None) -> "Record":
    """Return the stretch that was asked for, which must lie within the recording."""
    import numpy as np

    from undrift.errors import InputError

    first, last = float(record.time[0]), float(record.time[-1])
    start, stop = first if start_s is None else start_s, np.inf if stop_s is None else stop_s
    if not (start < stop and start < last and stop > first):
        raise InputError(
            f"--start-s, --stop-s: wanted a stretch of the recording, which goes from {first:.6g} to {last:.6g} s, got {start:g} "
            f"to {stop:g} s; name times on its own clock"
        )
    return record.between(start, stop)


def noise_json(found: "NoiseFit") -> dict[str, object]:
    """Return a noise fit under the names that other programs rely on.

    Parameters
    ----------
    found : NoiseFit
        Coefficients and Allan deviation.

    Returns
    -------
    dict
        gyro, accel, taus_s, adev and what goes with them.
    """
    return {
        "gyro": [_axis_json(axis) for axis in found.gyro],
        "accel": [_axis_json(axis) for axis in found.accel],
        "taus_s": found.taus_s,
        "adev": {"gyro": found.gyro_adev, "accel": found.accel_adev},
        "units": {"gyro": found.gyro_unit, "accel": found.accel_unit},
        "duration_s": found.duration_s,
        "confidence": found.confidence,
        "verdict": {"status": found.verdict.status, "reasons": found.verdict.reasons},
    }


def _axis_json(axis: "AxisNoise") -> dict[str, object]:
    named = ("angle_random_walk", "bias_instability", "rate_random_walk", "quantization")
    held = {name: getattr(axis, name) for name in named}
    told: dict[str, object] = {"axis": axis.axis}
    told |= {
        name: {"value": c.value, "interval": c.interval, "unit": c.unit, "reason": c.reason} for name, c in held.items()
    }
    customary = _customary(axis)
    return told if customary is None else told | {customary[1]: customary[0]}


def _customary(axis: "AxisNoise") -> tuple[float, str, str] | None:
    """Return the random walk as data sheets have it, with its name in JSON and its unit; None for counts and volts."""
    walk = axis.angle_random_walk
    if walk.unit == "rad/s/sqrt(Hz)":  # which is rad/sqrt(s): 60 sqrt(s) make a sqrt(h)
        return 60.0 * walk.value / RADIAN_PER_DEGREE, "angle_random_walk_deg_per_sqrt_h", "deg/sqrt(h)"
    if walk.unit == "m/s2/sqrt(Hz)":
        return 1e6 * walk.value / STANDARD_GRAVITY, "velocity_random_walk_ug_per_sqrt_hz", "ug/sqrt(Hz)"
    return None


def _show(title: str, axes: tuple["AxisNoise", ...], names: tuple[str, ...]) -> None:
    from undrift.cli.common import console, table

    if not axes:
        return
    first = axes[0]
    units = (first.angle_random_walk.unit, first.bias_instability.unit, first.rate_random_walk.unit)
    shown = table(title, "axis", *(f"{name} ({unit})" for name, unit in zip(names, units, strict=True)))
    for axis in axes:
        cells = []
        for coefficient in (axis.angle_random_walk, axis.bias_instability, axis.rate_random_walk):
            low, high = coefficient.interval
            seen = coefficient.value == coefficient.value
            cells.append(f"{coefficient.value:.3g} [{low:.3g}, {high:.3g}]" if seen else f"not seen, under {high:.2g}")
        shown.add_row(axis.axis, *cells)
    console().print(shown, markup=False)
    walks = [(axis.axis, customary) for axis in axes if (customary := _customary(axis)) is not None]
    if walks:
        values = ", ".join(f"{axis} {value:.3g}" for axis, (value, _, _) in walks)
        console().print(f"{names[0]} in {walks[0][1][2]}: {values}", markup=False)


def _draw(found: "NoiseFit", path: Path, name: str) -> None:
    from undrift.report.figures import draw_allan, save_figure

    save_figure(draw_allan(found, title=f"{name}: overlapping Allan deviation"), path)
