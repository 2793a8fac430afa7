"""``undrift measure``: what a motor task shows, each measure with what the instrument adds to its error."""

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from undrift.base.options import OptionalOutput, Side, verb
from undrift.base.summary import Drawing, Result, Section, Summary, figure_of
from undrift.commands import Progress, silent
from undrift.commands.batch import of_folder
from undrift.commands.files import Opening, TableUse, check_output, corrected, named_columns
from undrift.errors import InputError

if TYPE_CHECKING:
    from undrift.findings import Finding
    from undrift.measures.tasks import Event, TaskResult
    from undrift.measures.uncertainty import Instrument, Measure
    from undrift.measures.worn import Course
    from undrift.model import BodyMounting, Calibration

ENDING = "_events.tsv"
Task = Literal["sit-to-stand", "5xSTS", "standing", "walk", "step", "tug"]
DECIMALS = {"deg": 1, "s": 2, "deg/s": 1, "Hz": 2, "m/s2": 4, "m2/s4": 5, "m/s": 4, "deg2": 2, "m": 2, "%": 1,
            "steps/min": 1}  # fmt: skip
FIRST = {  # measures that the answer names
    "sit-to-stand": ("duration_s", "peak_trunk_pitch_deg", "peak_thigh_velocity_dps"),
    "5xSTS": ("five_times_duration_s", "peak_trunk_pitch_deg", "peak_thigh_velocity_dps"),
    "standing": ("rms_m_s2", "rms_pitch_deg"),
    "tug": ("tug_duration_s", "peak_turn_velocity_dps"),
    "step": ("rise_duration_s", "peak_trunk_pitch_deg"),
    "walk": ("cadence_per_min", "stance_percent", "stride_duration_s"),
}
ENOUGH_STRIDES, FEW_STRIDES = 50, 20  # for a spread known to 10 and 16 %
SPREAD = 0.1  # of the whole: parts below it are not named


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Measured(Result):
    """Measures of a task, and the events that they are taken between."""

    record: Path
    task: str
    output: Path | None
    device: "Instrument"
    course: "Course"
    shown: "TaskResult"
    measures: "tuple[Measure, ...]"
    closed: "tuple[Measure, ...]"  # of the recording with eyes closed
    findings: "tuple[Finding, ...]"
    notes: tuple[str, ...]

    def summary(self) -> Summary:
        """Return the measures as a table, and what limits them."""
        named = {one.name: one for one in self.measures}
        first = [named[name] for name in FIRST[self.task] if name in named][:2]
        whole = "; ".join(f"{_words(one)} {statement(one)}" for one in first)
        count = max(len(one.values) for one in self.measures) if self.measures else 0
        times = f", {count} times" if count > 1 and self.task != "5xSTS" else ""
        times = f", {self.shown.strides} strides" if self.shown.strides else times
        heads = "measure", "mean +- standard uncertainty", "smallest change between visits", "least to greatest", "from"
        table: list[tuple[str, ...]] = [heads, *map(_row, self.measures)]
        head, *rows = [(*one[:3], *one[3 if count > 1 else 4 :]) for one in table]
        sections = [Section(title="Measures", columns=head, rows=tuple(rows), words=True), *_halving(first)]
        if self.closed:
            sections.append(_pairs(self.measures, self.closed))
        events = tuple((f"{one.onset:.2f}", f"{one.duration:.2f}", one.trial_type) for one in self.shown.events)
        columns = ("onset (s)", "duration (s)", "trial_type")
        sections.append(Section(title="Events", columns=columns, rows=events, folded=True))
        return Summary(
            title=f"{self.task}: {self.record.name}",
            answer=f"{self.task}{times}: {whole or 'no measure can be stated'}.",
            data=self._data(),
            pictures=(self._picture(),),
            sections=tuple(sections),
            findings=self.findings,
            notes=self.notes,
            next=self._next(first),
            written=() if self.output is None else (self.output, self.output.with_suffix(".json")),
        )

    def _next(self, first: "list[Measure]") -> tuple[object, ...]:
        """Return the study that finds the calibration session which halves a limited angle."""
        wanted = [one.parts["calibration"] * one.halving("calibration") for one in first if _unit(one) == "deg"]
        small = max(wanted, default=0.0)
        return ("study", "--preset", "note", "--target-deg", f"{small:.2g}", "-o", "study") if small else ()

    def _picture(self) -> Drawing:
        from undrift.measures.stepping import zeroed_velocity
        from undrift.units import RADIAN_PER_DEGREE

        course, events = self.course, [(one.onset, one.duration, one.trial_type) for one in self.shown.events]
        second = {
            "standing": ("roll (deg)", course.roll / RADIAN_PER_DEGREE),
            "tug": ("turning (deg/s)", course.turning / RADIAN_PER_DEGREE),
            "walk": ("upward acceleration\n(m/s2)", course.up),
            "step": ("upward velocity\n(m/s)", zeroed_velocity(course)[0]),
        }.get(self.task, ("upward velocity\n(m/s)", course.velocity))
        place = "trunk" if self.device.place == "lower-back" else self.device.place
        if place != "trunk":
            sign, label = (-1.0, "swing rate") if self.task == "walk" else (1.0, "thigh rate")
            second = f"{label} (deg/s)", sign * course.rate[:, 1] / RADIAN_PER_DEGREE
        courses = {f"{place} pitch (deg)": course.pitch / RADIAN_PER_DEGREE, second[0]: second[1]}
        return figure_of("figures:draw_measured", course.time, courses, events)

    def _data(self) -> dict[str, Any]:
        from undrift.io.store import findings_json

        return {
            "recording": str(self.record), "task": self.task, "output": self.output and str(self.output),
            "place": self.device.place, "measures": {one.name: _json(one) for one in self.measures},
            "eyes_closed": {one.name: _json(one) for one in self.closed} or None,
            "left_out": dict(self.shown.missing), "strides": self.shown.strides or None, "assumed": self.device.assumed,
            "events": [
                {"onset_s": one.onset, "duration_s": one.duration, "trial_type": one.trial_type} for one in self.shown.events
            ],
            "findings": findings_json(self.findings),
        }  # fmt: skip


@verb
@of_folder(ENDING)
def measure(
    record: Path,
    /,
    *,
    task: Task,
    eyes_closed: Path | None = None,
    worn: Literal["lower-back", "thigh", "shank"] | None = None,
    mounting: Path | None = None,
    calibration: Path | None = None,
    forward: Side | None = None,
    up: Side | None = None,
    output: OptionalOutput = None,
    applying: TableUse = TableUse(),
    opening: Opening = Opening(),
    progress: Progress = silent,
) -> Measured:
    """Measures of a motor task by one worn device, with the instrument's uncertainty; events as BIDS has them.

    Parameters
    ----------
    record : Path
        A corrected recording of the task, or a raw one with its calibration; or a folder of them, with one of output.
    task : str
        sit-to-stand, every rise from a seat; 5xSTS, five of them as fast as possible; standing, quiet stance; walk, steps
        straight ahead; step, rising a step or stairs; tug, timed up and go.
    eyes_closed : Path or None
        With standing: the same person's stance with eyes closed, compared with the recording.
    worn : str or None
        Where the device is worn, with stated sides: the lower back, which is assumed without, a thigh (sit-to-stand, 5xSTS,
        walk) or a shank (walk). A mounting states it.
    mounting : Path or None
        calibration.json with the device's mounting, as mount writes it, of a corrected recording.
    calibration : Path or None
        calibration.json of the device, for a raw recording; its mounting is taken where it has one.
    forward : str or None
        Device axis that points forward on the upright wearer; with up in place of a mounting, within 5 deg (assumed). Without
        both and without a mounting they are +x and +z.
    up : str or None
        Device axis that points up on the upright wearer.
    output : Path or None
        Onset, duration and type of each event: .._events.tsv, and the meaning of its columns as .json (BIDS).
    """
    from undrift.io.store import read_calibration
    from undrift.measures.tasks import measure_of
    from undrift.measures.uncertainty import instrument, take

    reads = (record, eyes_closed, mounting, calibration, opening.column_map)
    check_output(output, endings=(ENDING,), reads=reads, beside=(output.with_suffix(".json"),) if output else ())
    if (eyes_closed and task != "standing") or (mounting and calibration):
        raise InputError(
            "measure: wanted eyes_closed with the task standing alone, and a calibration or a mounting, got others; leave one out"
        )
    model = None if calibration is None else read_calibration(calibration)
    calibrated = model if mounting is None else read_calibration(mounting)
    place = _worn(calibrated, mounting, worn, forward, up)
    task_measure, devices = measure_of(task, place.place if place else "lower-back"), list["Instrument"]()
    earlier, notes = list["Finding"](), list[str]()
    for path in (record, eyes_closed) if eyes_closed else (record,):
        progress(f"measuring {path.name}", 0.2)
        with named_columns(path):
            readings, against, remarks = corrected(opening.like(model, calibration).read(path), path, model, applying)
            devices.append(instrument(readings, calibrated, place))
        earlier += against
        notes += remarks
    taken = [take(device, task_measure) for device in devices]
    shown, measures = taken[0]
    if output is not None:
        _write_events(shown.events, output)
    return Measured(
        record=record, task=task, output=output, device=devices[0], course=devices[0].course(task_measure), shown=shown,
        measures=measures, closed=taken[1][1] if eyes_closed else (),
        findings=(*earlier, *_findings(devices, shown, measures, FIRST[task])), notes=tuple(dict.fromkeys(notes)),
    )  # fmt: skip


def _worn(
    calibrated: "Calibration | None", path: Path | None, place: str | None, forward: str | None, up: str | None
) -> "BodyMounting | None":
    """Return how the device is worn: by the sides that are stated, else by the mounting that a calibration keeps."""
    import numpy as np

    from undrift.model import AXES, BodyMounting

    worn = None if calibrated is None else calibrated.mounting
    if place is not None and worn is not None and worn.place != place:
        raise InputError(
            f"measure: wanted a device at the {place} (`worn`), got a mounting for the {worn.place}; state the one that is right"
        )
    if forward is None and up is None and (place in (None, "lower-back") or worn is not None):
        if worn is None and path is not None:
            raise InputError(
                f"{path}: wanted a calibration that keeps a mounting, got one without; find it (mount), or state sides"
            )
        return worn
    sides = (forward or "+x", up or "+z")
    ways = [np.eye(3)[AXES.index(side[1])] * (1.0 if side[0] == "+" else -1.0) for side in sides]
    if abs(ways[0] @ ways[1]) > 0.5:
        raise InputError(
            f"measure: wanted two axes of the device, got forward {sides[0]} and up {sides[1]}; state two different ones"
        )
    matrix = np.stack((ways[0], np.cross(ways[1], ways[0]), ways[1]))
    place = place or (worn.place if worn else "lower-back")
    return BodyMounting(place=place, matrix=matrix, covariance=np.zeros((3, 3)), basis="stated")


def _findings(
    devices: "list[Instrument]", shown: "TaskResult", measures: "tuple[Measure, ...]", first: tuple[str, ...]
) -> "tuple[Finding, ...]":
    """Return what is assumed, what limits the first measures and would halve it, and what is left out."""
    from undrift.findings import finding

    assumed = tuple(dict.fromkeys(what for one in devices for what in one.assumed))
    texts = [finding("measure.assumed", "warn", what=assumed)] if assumed else []
    peak = next((one.mean for one in measures if one.name == "peak_trunk_pitch_deg"), 0.0)
    texts += [finding("measure.sides", "warn", pitch_deg=peak)] if peak < 0.0 else []
    for one in [one for one in measures if one.name in first][:2]:
        if not _shows(one):
            continue
        (source, adds), (second, next_adds) = list(one.parts.items())[:2]
        share, size = one.halving(source), devices[0].sizes.get(source, 0.0)
        words: dict[str, Any] = {"measure": _words(one), "unit": _unit(one), "part": adds, "whole": one.uncertainty}
        if not share:
            words |= {"source": source, "rest": one.without(source), "second": second, "next_part": next_adds}
            texts.append(finding("measure.limit_several", "info", **words))
            continue
        words |= {"half": share * adds, "size": size, "aim": share * size, "times": math.ceil(share**-2)}
        words |= {"faster": math.ceil(1.0 / share)}
        limit = finding(
            {
                "noise": "measure.limit_noise", "mounting": "measure.limit_mounting", "calibration": "measure.limit_calibration",
                "offset": "measure.limit_offset", "temperature": "measure.limit_temperature", "motion": "measure.limit_motion",
                "sampling": "measure.limit_sampling",
            }[source], "info", **words,
        )  # fmt: skip
        texts.append(limit)
    if 0 < (count := shown.strides) < ENOUGH_STRIDES:
        spread = 100.0 / math.sqrt(2.0 * (count - 1))
        few: dict[str, float] = {"count": count, "percent": spread, "enough": ENOUGH_STRIDES}
        texts.append(finding("measure.few_strides", "warn" if count < FEW_STRIDES else "info", **few))
    texts += [finding("measure.left_out", "info", measure=name, reason=reason) for name, reason in shown.missing]
    return tuple(texts)


def _halving(first: "list[Measure]") -> list[Section]:
    """Return how small each source must become to halve the uncertainty of the first measures, where their decimals show it."""
    rows, text = list[tuple[str, ...]](), list[str]()
    for one in filter(_shows, first):
        for source, size in one.parts.items():
            share, rest = one.halving(source), one.without(source)
            half = f"{share * size:.2g}" if share else f"not alone: the others leave {rest:.2g}"
            if size > SPREAD * one.uncertainty:
                rows.append((f"{_words(one)} ({_unit(one)})", source, f"{size:.2g}", half))
        if not one.halving("calibration"):
            least = f"{one.without('calibration'):.2g} of {one.uncertainty:.2g} {_unit(one)}"
            text.append(f"A perfect calibration would leave {least} of the uncertainty of {_words(one)}.")
    heads, title = ("measure", "source", "adds", "half the uncertainty at"), "What would halve the uncertainty"
    section = Section(title=title, text=tuple(text), columns=heads, rows=tuple(rows), words=True, folded=True)
    return [section] if rows else []


def _shows(one: "Measure") -> bool:
    """Tell whether an uncertainty shows in the decimals of its measure."""
    return not _small(one.uncertainty, _places(one)).startswith("<")


def _words(one: "Measure") -> str:
    from undrift.measures.tasks import unit_of

    return unit_of(one.name)[0]


def _unit(one: "Measure") -> str:
    from undrift.measures.tasks import unit_of

    return unit_of(one.name)[1]


def _places(one: "Measure") -> int:
    """Return the decimals of a measure: those of its unit, one more where it is small."""
    places = DECIMALS[_unit(one)]
    return places + (abs(one.mean) < 50.0 * 10.0**-places)


def _small(value: float, places: int) -> str:
    """Return an uncertainty; below half of the last decimal it is less than that."""
    return f"{value:.{places}f}" if value >= 0.5 * 10.0**-places or not math.isfinite(value) else f"<{10.0**-places:g}"


def _shares(one: "Measure") -> str:
    """Return what the uncertainty is made of, the largest first; only what shows in the decimals."""
    places = _places(one)
    least = max(SPREAD * one.uncertainty, 0.5 * 10.0**-places)
    return ", ".join(f"{part:.{places}f} {name}" for name, part in one.parts.items() if part > least)


def statement(one: "Measure") -> str:
    """Return a measure with its standard uncertainty and what that is made of: 42.1 deg +- 0.9 (0.7 mounting, 0.5 offset)."""
    places, shares = _places(one), _shares(one)
    small = _small(one.uncertainty, places)
    return f"{one.mean:.{places}f} {_unit(one)} +- {small}" + (f" ({shares})" if shares else "")


def _row(one: "Measure") -> tuple[str, ...]:
    places = _places(one)
    span = f"{one.values.min():.{places}f} to {one.values.max():.{places}f}" if len(one.values) > 1 else ""
    small, change = (_small(size, places) for size in (one.uncertainty, one.smallest_change))
    return f"{_words(one)} ({_unit(one)})", f"{one.mean:.{places}f} +- {small}", change, span, _shares(one)


def _pairs(opened: "tuple[Measure, ...]", closed: "tuple[Measure, ...]") -> Section:
    """Return the table of eyes closed beside eyes open; the ratio's uncertainty counts each source once for both."""
    from undrift.measures.uncertainty import ratio

    other, rows = {one.name: one for one in closed}, []
    for one in (one for one in opened if one.name != "mean_pitch_deg"):  # no ratio: its zero is the mounting's
        if (two := other.get(one.name)) is not None:
            (value, uncertainty), places = ratio(two, one), _places(one)
            cells = (f"{each.mean:.{places}f}" for each in (one, two))
            rows.append((f"{_words(one)} ({_unit(one)})", *cells, f"{value:.2f} +- {_small(uncertainty, 2)}"))
    return Section(title="Eyes closed", columns=("measure", "open", "closed", "closed / open"), rows=tuple(rows))


def _json(one: "Measure") -> dict[str, Any]:
    from undrift.measures.tasks import UNITS

    end = next(end for end in UNITS if one.name.endswith(end))
    return {
        f"values{end}": one.values, f"mean{end}": one.mean, f"standard_uncertainty{end}": one.uncertainty,
        f"standard_uncertainties{end}": one.uncertainties, f"uncertainty_parts{end}": one.parts,
        f"smallest_change{end}": one.smallest_change,
    }  # fmt: skip


def _write_events(events: "tuple[Event, ...]", path: Path) -> None:
    """Write the events as BIDS has them."""
    from undrift.files import write_together
    from undrift.measures.tasks import TYPES

    rows = "".join(f"{one.onset:.4f}\t{one.duration:.4f}\t{one.trial_type}\n" for one in events)
    levels = {name: TYPES[name] for name in dict.fromkeys(one.trial_type for one in events)}
    described = {
        "onset": {"Description": "Start of the event since the first sample of the recording", "Units": "s"},
        "duration": {"Description": "Length of the event; 0 for an instant", "Units": "s"},
        "trial_type": {"Description": "What happens", "Levels": levels},
    }
    table = "onset\tduration\ttrial_type\n" + rows
    write_together({path: table, path.with_suffix(".json"): json.dumps(described, indent=1) + "\n"})
