"""From a study to the rate table: the protocol of each task as a file, its plan by mountings, the commands that run it.

The study's sessions read the faces at room temperature before the chamber is used, and so does the file (``faces.at``): the
forecast of ``rig run`` for it is the study's minutes.
"""

import shlex
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from undrift.base.summary import Cells, Section, plain_words, spoken, table_section

if TYPE_CHECKING:
    from undrift.rig.programme import Protocol
    from undrift.study.outcome import StudyOutcome, TaskOutcome


def protocol_of(outcome: "StudyOutcome", task: "TaskOutcome", place: int | None = None) -> "Protocol":
    """Return what the rate table does for a protocol of a task, by default the cheapest that is equivalent to the optimum."""
    from undrift.rig.programme import DAMPING
    from undrift.study.outcome import points_of

    plan = next(each for each in outcome.study.tasks if each.key == task.surface.task)
    point = points_of(plan, task.surface)[task.optimum.cheapest if place is None else place]
    quality = plan.space.setting_of(point).quality
    damping = DAMPING if quality is None else 0.5 / quality
    return replace(plan.protocol_of(point), name=task.surface.task, damping=damping, faces_at="room")


def write_protocol(folder: Path, task: str, protocol: "Protocol") -> Path:
    """Write the protocol of a task for ``rig run``; return the file."""
    from undrift.rig.programme import write_protocol as write

    path = folder / f"protocol-{task}.toml"
    write(protocol, path)
    return path


@dataclass(frozen=True, slots=True, kw_only=True)
class PlannedMounting:
    """What is done while the device is mounted one way."""

    up: str  # Device axis that points up
    temps_c: tuple[float, ...]  # Set-points, degC; none at room temperature
    rests: int
    rates: int
    minutes: float  # With the mounting and the soaks


def mountings_of(protocol: "Protocol") -> tuple[PlannedMounting, ...]:
    """Return the plan of a session, mounting by mounting."""
    from undrift.rig.programme import Dwell, Mount, Soak, programme_of

    steps = programme_of(protocol).steps
    first = [k for k, step in enumerate(steps) if isinstance(step, Mount)]
    plan = []
    for begin, end in zip(first, [*first[1:], len(steps)], strict=True):
        part = steps[begin:end]
        dwells = [step for step in part if isinstance(step, Dwell)]
        turning = sum(dwell.purpose == "rate" for dwell in dwells)
        temps_c = tuple(step.temp_c for step in part if isinstance(step, Soak))
        minutes = sum(step.duration_s for step in part) / 60.0
        up, rests = str(part[0]), len(dwells) - turning
        plan.append(PlannedMounting(up=up, temps_c=temps_c, rests=rests, rates=turning, minutes=minutes))
    return tuple(plan)


def write_protocols(outcome: "StudyOutcome", folder: Path) -> None:
    """Write the protocol to use of each task."""
    for task in outcome.tasks:
        write_protocol(folder, task.surface.task, protocol_of(outcome, task))


def rig_sections(outcome: "StudyOutcome", folder: Path) -> tuple[Section, ...]:
    """Return the commands that run the protocol of each task on a rate table and fit it, and the plans of these sessions."""
    lines, plans = [], []
    cells: Cells[PlannedMounting] = (
        ("step", lambda each: each.up),
        ("set-points (degC)", lambda each: ", ".join(f"{temp_c:g}" for temp_c in each.temps_c) or "room"),
        ("rests", lambda each: str(each.rests)),
        ("rates", lambda each: str(each.rates)),
        ("time (min)", lambda each: f"{each.minutes:.1f}"),
    )
    for task in outcome.tasks:
        key, protocol = task.surface.task, protocol_of(outcome, task)
        plan, oven = mountings_of(protocol), " `chamber` ADDRESS" * bool(protocol.temperatures_c)
        session, path = f"session-{key}", folder / f"protocol-{key}.toml"
        fits = [f"undrift calibrate {session} `output` {key}.json"]
        fits += [f"undrift drift {session} `calibration` {key}.json `output` {key}.json"] * bool(
            protocol.temperatures_c
        )
        total = f"{len(plan)} mountings, {sum(each.minutes for each in plan):.0f} min"
        lines.append(f"On the rate table, {plain_words(key)}: {total}.")
        lines.append(
            f"undrift rig run {shlex.quote(str(path))} `rig` ADDRESS `device` ADDRESS{oven} `output` {session}"
        )
        lines += fits
        plans.append(table_section(f"{plain_words(key)}: plan of the session, {total}", plan, cells, folded=True))
    text = tuple(spoken(line, called=True) for line in lines)
    return Section(title="Commands for the rate table", text=text), *plans
