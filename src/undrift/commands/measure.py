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
DECIMALS = {"deg": 1, "s": 2, "deg/s": 1, "Hz": 2, "m/s2": 4, "m2/s4": 5, "m/s": 4, "deg2": 2, "m": 2, "%": 1,
            "steps/min": 1}  # fmt: skip
FIRST = {  # measures that the answer names
    "sit-to-stand": ("duration_s", "peak_trunk_pitch_deg"),
    "5xSTS": ("five_times_duration_s", "peak_trunk_pitch_deg"),
    "standing": ("rms_m_s2", "rms_pitch_deg"),
    "tug": ("tug_duration_s", "peak_turn_velocity_dps"),
    "step": ("rise_duration_s", "peak_trunk_pitch_deg"),
    "walk": ("cadence_per_min", "stride_duration_s"),
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
        first = [named[name] for name in FIRST[self.task] if name in named]
        whole = "; ".join(f"{_words(one)} {statement(one)}" for one in first)
        count = max(len(one.values) for one in self.measures) if self.measures else 0
        times = f", {count} times" if count > 1 and self.task != "5xSTS" else ""
        times = f", {self.shown.strides} strides" if self.shown.strides else times
        heads = (
            "measure",
            "mean",
            "standard uncertainty",
            "least to greatest",
            "smallest change between visits",
            "from",
        )
        rows = tuple(_row(one) for one in self.measures)
        sections = [Section(title="Measures", columns=heads, rows=rows, words=True)]
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
            written=() if self.output is None else (self.output, self.output.with_suffix(".json")),
        )

    def _picture(self) -> Drawing:
        from undrift.units import RADIAN_PER_DEGREE

        course, events = self.course, [(one.onset, one.duration, one.trial_type) for one in self.shown.events]
        second = {
            "standing": ("roll (deg)", course.roll / RADIAN_PER_DEGREE),
            "tug": ("turning (deg/s)", course.turning / RADIAN_PER_DEGREE),
            "walk": ("upward acceleration\n(m/s2)", course.up),
        }.get(self.task, ("upward velocity\n(m/s)", course.velocity))
        courses = {"trunk pitch (deg)": course.pitch / RADIAN_PER_DEGREE, second[0]: second[1]}
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
    task: Literal["sit-to-stand", "5xSTS", "standing", "walk", "step", "tug"],
    eyes_closed: Path | None = None,
    mounting: Path | None = None,
    calibration: Path | None = None,
    forward: Side | None = None,
    up: Side | None = None,
    output: OptionalOutput = None,
    applying: TableUse = TableUse(),
    opening: Opening = Opening(),
    progress: Progress = silent,
) -> Measured:
    """Measures of a motor task by one device at the lower back, with the instrument's uncertainty; events as BIDS has them.

    Parameters
    ----------
    record : Path
        A corrected recording of the task, or a raw one with its calibration; or a folder of them, with one of output.
    task : str
        sit-to-stand, every rise from a seat; 5xSTS, five of them as fast as possible; standing, quiet stance; walk, steps
        straight ahead; step, rising a step or stairs; tug, timed up and go.
    eyes_closed : Path or None
        With standing: the same person's stance with eyes closed, compared with the recording.
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
    check_output(
        output, endings=(ENDING,), reads=reads, beside=() if output is None else (output.with_suffix(".json"),)
    )
    if (eyes_closed and task != "standing") or (mounting and calibration):
        raise InputError(
            "measure: wanted eyes_closed with the task standing alone, and a calibration or a mounting, got others; leave one out"
        )
    model = None if calibration is None else read_calibration(calibration)
    calibrated = model if mounting is None else read_calibration(mounting)
    worn = _worn(calibrated, mounting, forward, up)
    task_measure, devices = measure_of(task), list["Instrument"]()
    earlier, notes = list["Finding"](), list[str]()
    for path in (record, eyes_closed) if eyes_closed else (record,):
        progress(f"measuring {path.name}", 0.2)
        with named_columns(path):
            readings, against, remarks = corrected(opening.like(model, calibration).read(path), path, model, applying)
            devices.append(instrument(readings, calibrated, worn))
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
    calibrated: "Calibration | None", path: Path | None, forward: str | None, up: str | None
) -> "BodyMounting | None":
    """Return how the device is worn: by the sides that are stated, else by the mounting that a calibration keeps."""
    import numpy as np

    from undrift.model import AXES, BodyMounting

    if forward is None and up is None:
        worn = None if calibrated is None else calibrated.mounting
        if worn is None and path is not None:
            raise InputError(
                f"{path}: wanted a calibration that keeps a mounting, got one without; find it (mount), or state sides"
            )
        if worn is not None and worn.place != "lower-back":
            raise InputError(
                f"measure: wanted a device at the lower-back, got one at the {worn.place}; its mounting states that"
            )
        return worn
    sides = (forward or "+x", up or "+z")
    ways = [np.eye(3)[AXES.index(side[1])] * (1.0 if side[0] == "+" else -1.0) for side in sides]
    if abs(ways[0] @ ways[1]) > 0.5:
        raise InputError(
            f"measure: wanted two axes of the device, got forward {sides[0]} and up {sides[1]}; state two different ones"
        )
    matrix = np.stack((ways[0], np.cross(ways[1], ways[0]), ways[1]))
    return BodyMounting(place="lower-back", matrix=matrix, covariance=np.zeros((3, 3)), basis="stated")


def _findings(
    devices: "list[Instrument]", shown: "TaskResult", measures: "tuple[Measure, ...]", first: tuple[str, ...]
) -> "tuple[Finding, ...]":
    """Return what is assumed, what limits the first measures and would halve it, and what is left out."""
    from undrift.findings import finding

    assumed = tuple(dict.fromkeys(what for one in devices for what in one.assumed))
    texts = [finding("measure.assumed", "warn", what=assumed)] if assumed else []
    peak = next((one.mean for one in measures if one.name == "peak_trunk_pitch_deg"), 0.0)
    texts += [finding("measure.sides", "warn", pitch_deg=peak)] if peak < 0.0 else []
    for one in (one for one in measures if one.name in first):
        source, part = next(iter(one.parts.items()))
        words = {"measure": _words(one), "part": part, "whole": one.uncertainty, "unit": _unit(one)}
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
    parts = [
        (name, part) for name, part in one.parts.items() if part > max(SPREAD * one.uncertainty, 0.5 * 10.0**-places)
    ]
    return ", ".join(f"{part:.{places}f} {name}" for name, part in parts)


def statement(one: "Measure") -> str:
    """Return a measure with its standard uncertainty and what that is made of: 42.1 deg +- 0.9 (0.7 mounting, 0.5 offset)."""
    places, shares = _places(one), _shares(one)
    small = _small(one.uncertainty, places)
    return f"{one.mean:.{places}f} {_unit(one)} +- {small}" + (f" ({shares})" if shares else "")


def _row(one: "Measure") -> tuple[str, ...]:
    places = _places(one)
    span = f"{one.values.min():.{places}f} to {one.values.max():.{places}f}" if len(one.values) > 1 else ""
    small, change = (_small(size, places) for size in (one.uncertainty, one.smallest_change))
    return f"{_words(one)} ({_unit(one)})", f"{one.mean:.{places}f}", small, span, change, _shares(one)


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
    write_together(
        {
            path: "onset\tduration\ttrial_type\n" + rows,
            path.with_suffix(".json"): json.dumps(described, indent=1) + "\n",
        }
    )
