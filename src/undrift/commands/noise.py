"""``undrift noise``: noise coefficients of a device at rest."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from undrift.base.options import Picture, verb
from undrift.base.summary import Drawing, Result, Summary, figure_of, table_section
from undrift.calibration.expanded import COVERAGE
from undrift.commands import Progress, reading, silent
from undrift.commands.answer import ANSWERED_S
from undrift.commands.calibration_file import choose_calibration
from undrift.commands.data_sheet import PART, sheet_of, sheet_words
from undrift.commands.files import Opening, calibrated_part, check_figure, named_columns
from undrift.errors import InputError
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, is_physical

if TYPE_CHECKING:
    from undrift.calibration.noise import AxisNoise, NoiseFit
    from undrift.model import Calibration, Verdict
    from undrift.record import Record

_DEG_PER_H, _UG = 3600.0 / RADIAN_PER_DEGREE, 1e6 / STANDARD_GRAVITY  # of a rad/s, of a m/s2
# As data sheets have them, by term and SI unit: key in JSON, unit, factor; 60 sqrt(s) make a sqrt(h)
_WALK, _FLOOR, _RISE = "angle_random_walk", "bias_instability", "rate_random_walk"
DATA_SHEET = {
    (_WALK, "rad/s/sqrt(Hz)"): ("angle_random_walk_deg_per_sqrt_h", "deg/sqrt(h)", 60.0 / RADIAN_PER_DEGREE),
    (_FLOOR, "rad/s"): ("bias_instability_deg_per_h", "deg/h", _DEG_PER_H),
    (_RISE, "rad/s/sqrt(s)"): ("rate_random_walk_deg_per_h_per_sqrt_h", "deg/h/sqrt(h)", 60.0 * _DEG_PER_H),
    (_WALK, "m/s2/sqrt(Hz)"): ("velocity_random_walk_ug_per_sqrt_hz", "ug/sqrt(Hz)", _UG),
    (_FLOOR, "m/s2"): ("bias_instability_ug", "ug", _UG),
    (_RISE, "m/s2/sqrt(s)"): ("acceleration_random_walk_ug_per_sqrt_h", "ug/sqrt(h)", 60.0 * _UG),
}
SHEET = {_WALK: "random_walk", _FLOOR: "instability"}  # what a preset keeps of a data sheet
DENSITY = {
    "gyro": ("deg/s/sqrt(Hz)", math.sqrt(2.0) / RADIAN_PER_DEGREE),
    "accel": ("ug/sqrt(Hz)", math.sqrt(2.0) * _UG),
}


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Noise(Result):
    """Noise coefficients of a recording at rest."""

    record: Path
    fit: "NoiseFit"
    verdict: "Verdict"
    kind: str  # Whose data sheet stands beside, "" for none
    notes: tuple[str, ...]
    written: tuple[Path | None, ...]
    stretch: tuple[object, ...] = ()  # Words that cut it out of the recording

    def summary(self) -> Summary:
        """Return what the noise means for an angle, and the coefficients of each axis with their intervals."""
        from undrift.calibration.noise import TERMS
        from undrift.io.store import verdict_json

        fit, seen, sections, kind = self.fit, [], [], self.kind
        physical = all(is_physical(getattr(fit, f"{one}_unit")) for one in TERMS if getattr(fit, one))
        after = {"angle_after_60_s_deg": [{"axis": axis.axis} | angle_after(axis) for axis in fit.gyro]}
        follows = ("--calibration", "calibration.json")
        for name, triad, axes in (("gyroscopes", "gyro", fit.gyro), ("accelerometers", "accel", fit.accel)):
            if not axes:
                continue
            names, walks = TERMS[triad], [axis.angle_random_walk for axis in axes]
            largest = max((walk.value for walk in walks if math.isfinite(walk.value)), default=math.nan)
            if math.isfinite(largest):
                seen.append(f"{names['angle_random_walk']} up to {largest:.2g} {walks[0].unit}")
            drawing = figure_of("figures:draw_allan_fit", fit, triad, names)
            cells: list[tuple[str, Callable[[AxisNoise], str]]] = [("axis", lambda axis: axis.axis)]
            for term, words in names.items():
                cells.append((f"{words} ({getattr(axes[0], term).unit})", partial(_cell, term)))
            if physical and triad == "gyro":
                cells.append(
                    (f"angle after {ANSWERED_S:.0f} s (deg)", lambda axis: f"{angle_after(axis)['angle']:.2g}")
                )
            title, text = (
                f"{name}, in brackets the {100.0 * fit.confidence:g} % intervals",
                _data_sheet(axes, names, triad, kind),
            )
            sections.append(table_section(title, axes, cells, text=tuple(text), pictures=(drawing,)))
        return Summary(
            title=f"Noise of {self.record.name}",
            answer=_meaning(fit)
            or f"{fit.duration_s:.4g} s at rest show {' and '.join(seen) or 'no coefficient'}; a calibration gives degrees.",
            data=_data(fit)
            | (after if physical else {})
            | _sheet_json(kind)
            | {"verdict": verdict_json(self.verdict), "notes": self.notes},
            pictures=(figure_of("figures:draw_allan", fit),),
            sections=tuple(sections),
            verdict=self.verdict,
            notes=(*self.notes, *([f"{sheet_words(kind)}: typical figures"] if kind else ())),
            written=self.written,
            next=() if physical else ("noise", self.record, *self.stretch, *follows),
        )


@verb
def noise(
    record: Path,
    /,
    *,
    calibration: Path | None = None,
    start_s: float | None = None,
    stop_s: float | None = None,
    power_on_s: float | None = None,
    figure: Picture = None,
    kind: str | None = None,
    opening: Opening = Opening(),
    progress: Progress = silent,
) -> Noise:
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
    kind : str or None
        Preset of the device's part, as mpu6050, whose data sheet stands beside; by default the part that the calibration names.
    """
    from undrift.calibration.noise import fit_noise
    from undrift.calibration.triads import check_force

    reads = (record, calibration, opening.column_map)
    check_figure(figure, reads=reads)
    chosen = choose_calibration(calibration, (record,), opening)
    model, calibration = chosen.model, chosen.path
    kind = kind or (model.provenance.text(PART) if model else "")
    _ = kind and sheet_of(kind)  # refused before the work
    with reading(progress, 0.3, record):
        readings = opening.like(model, calibration).read(record)
    since = None if power_on_s is None else float(power_on_s - readings.time[0])
    if start_s is not None or stop_s is not None:
        readings = _between(readings, start_s, stop_s)
    with named_columns(record):
        readings, notes = (readings, ()) if model is None else _corrected(readings, model, since)
        check_force(readings)
    progress("fitting", 0.3)
    fit = fit_noise(readings)
    if figure is not None:
        title = {"title": f"{record.name}: overlapping Allan deviation"}
        Drawing(place="undrift.report.figures:draw_allan", of=(fit,), options=title).save(figure)
    ends = {"--start-s": start_s, "--stop-s": stop_s}
    stretch = tuple(word for name, end in ends.items() if end is not None for word in (name, f"{end:g}"))
    return Noise(
        record=record,
        fit=fit,
        verdict=fit.verdict,
        kind=kind,
        notes=(*chosen.notes, *notes),
        written=(figure,),
        stretch=stretch,
    )


def angle_after(axis: "AxisNoise") -> dict[str, float]:
    """Return U of an angle after 60 s, deg, by term; its offset is the mean of 60 s at rest just before.

    The two means differ by sqrt(2) sigma(tau), which is what the Allan deviation is: U = k tau sqrt(2) sigma(tau). A term that the
    recording does not show counts by its upper limit.
    """
    from undrift.calibration.noise import FLICKER

    tau, each = ANSWERED_S, dict[str, float]()
    for term, shape in ((_WALK, 1.0 / tau), (_FLOOR, FLICKER), (_RISE, tau / 3.0)):
        one = getattr(axis, term)
        size = one.interval[1] if math.isnan(one.value) else one.value
        each[term] = COVERAGE * tau * math.sqrt(2.0 * shape) * size / RADIAN_PER_DEGREE
    return each | {"angle": math.hypot(*each.values())}


def _meaning(fit: "NoiseFit") -> str:
    """Return what white noise and instability mean for an angle, at 95 % on the worst axis; "" for counts or volts."""
    parts = []
    if fit.gyro and is_physical(fit.gyro_unit):
        axis = max(fit.gyro, key=lambda one: angle_after(one)["angle"])
        each = angle_after(axis)
        words = ((_WALK, "white noise"), (_FLOOR, "bias instability"), (_RISE, "rate random walk"))
        terms = (f"{name} {'under ' * math.isnan(getattr(axis, key).value)}{each[key]:.2g} deg" for key, name in words)
        if not math.isfinite(each["angle"]):
            return ""
        parts.append(
            f"After {ANSWERED_S:g} s the angle is good to {each['angle']:.2g} deg (95 %, offset from {ANSWERED_S:g} s at rest "
            f"before): {', '.join(terms)}."
        )
    if fit.accel and is_physical(fit.accel_unit):
        walk = max(one.angle_random_walk.value for one in fit.accel)
        tilt_deg = COVERAGE * walk / STANDARD_GRAVITY / RADIAN_PER_DEGREE
        parts.append(f"White noise leaves an inclination from 1 s at rest good to {tilt_deg:.2g} deg.")
    return " ".join(parts)


def _corrected(readings: "Record", model: "Calibration", since: float | None) -> "tuple[Record, tuple[str, ...]]":
    """Return corrected readings and what to say of them; ``since`` is the time since power-on at zero of their clock, s."""
    from undrift.correction.correct import correct_checked

    readings, left_out = calibrated_part(readings, model)
    done = correct_checked(readings, model, power_on_s=None if since is None else float(since + readings.time[0]))
    return done.record, (*left_out, *done.warnings, *done.notes)


def _data(fit: "NoiseFit") -> dict[str, object]:
    triads = ("gyro", "accel")
    return (
        {name: [_axis_json(axis) for axis in getattr(fit, name)] for name in triads}
        | {
            key: {name: getattr(fit, f"{name}_{of}") for name in triads}
            for key, of in (("adev", "adev"), ("units", "unit"))
        }
        | {key: getattr(fit, key) for key in ("taus_s", "duration_s", "confidence")}
    )


def _between(record: "Record", start_s: float | None, stop_s: float | None) -> "Record":
    """Return the stretch that was asked for, which must lie within the recording."""
    first, last = float(record.time[0]), float(record.time[-1])
    start, stop = first if start_s is None else start_s, float("inf") if stop_s is None else stop_s
    if not (start < stop and start < last and stop > first):
        raise InputError(
            f"`start_s`, `stop_s`: wanted a stretch of the recording, which goes from {first:.6g} to {last:.6g} s, got {start:g} "
            f"to {stop:g} s; name times on its own clock"
        )
    return record.between(start, stop)


def _axis_json(axis: "AxisNoise") -> dict[str, object]:
    names = ("angle_random_walk", "bias_instability", "rate_random_walk", "quantization")
    made: dict[str, object] = {"axis": axis.axis}
    for name in names:
        made[name] = {key: getattr(getattr(axis, name), key) for key in ("value", "interval", "unit", "reason")}
    for (term, unit), (key, _, factor) in DATA_SHEET.items():
        if getattr(axis, term).unit == unit:
            made[key] = factor * getattr(axis, term).value
    return made


def _cell(term: str, axis: "AxisNoise") -> str:
    """Return a coefficient with its interval, or its upper limit if it is not observable."""
    one = getattr(axis, term)
    if math.isnan(one.value):
        return f"not observable, under {one.interval[1]:.2g}"
    return f"{one.value:.3g} [{one.interval[0]:.3g}, {one.interval[1]:.3g}]"


def _data_sheet(axes: tuple["AxisNoise", ...], names: dict[str, str], triad: str, kind: str) -> "Iterator[str]":
    """Yield the coefficients as data sheets have them, one line a term, beside those of the part."""
    for term, name in names.items():
        _, unit, factor = DATA_SHEET.get((term, getattr(axes[0], term).unit), ("", "", 1.0))
        if unit:
            values = ((axis.axis, getattr(axis, term)) for axis in axes)
            shown = (
                f"{axis} {factor * c.value:.3g}" if not math.isnan(c.value) else f"{axis} not observable"
                for axis, c in values
            )
            beside = ""
            if kind and (typical := getattr(getattr(sheet_of(kind), triad), SHEET.get(term, ""), 0.0)):
                density = f" (density {DENSITY[triad][1] * typical:.3g} {DENSITY[triad][0]})" if term == _WALK else ""
                beside = f"; data sheet of {kind} {factor * typical:.3g}{density}"
            yield f"{name} in {unit}: {', '.join(shown)}{beside}"


def _sheet_json(kind: str) -> dict[str, object]:
    """Return what the data sheet of the part states, in its units; nothing without a part."""
    typical = {
        key: factor * getattr(getattr(sheet_of(kind), "gyro" if unit.startswith("rad") else "accel"), SHEET[term])
        for (term, unit), (key, _, factor) in (DATA_SHEET.items() if kind else ())
        if term in SHEET
    }
    return {"data_sheet": {"part": kind, "source": sheet_words(kind)} | typical} if kind else {}
