"""From a study to the rate table: the protocol of each task as a file, its plan by mountings, the commands that run it.

The study's sessions read the faces at room temperature before the chamber is used, and so does the file (``faces.at``): the
forecast of ``rig run`` for it is the study's minutes.
"""

import shlex
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from undrift.base.summary import Section, plain_words

if TYPE_CHECKING:
    from undrift.programme import Protocol
    from undrift.study.outcome import StudyOutcome, TaskOutcome


def protocol_of(outcome: "StudyOutcome", task: "TaskOutcome", place: int | None = None) -> "Protocol":
    """Return what the rate table does for a protocol of a task, by default the one to use."""
    from undrift.programme import DAMPING
    from undrift.study.outcome import points_of

    plan = next(each for each in outcome.study.tasks if each.key == task.surface.task)
    point = points_of(plan, task.surface)[task.to_use[0] if place is None else place]
    quality = plan.space.setting_of(point).quality
    damping = DAMPING if quality is None else 0.5 / quality
    return replace(plan.protocol_of(point), name=task.surface.task, damping=damping, faces_at="room")


def write_protocol(folder: Path, task: str, protocol: "Protocol") -> Path:
    """Write the protocol of a task for ``rig run``; return the file."""
    from undrift.programme import write_protocol as write

    path = folder / f"protocol-{task}.toml"
    write(replace(protocol, faces=tuple(pose for pose in protocol.faces if " " not in pose)), path)  # no inclined ones
    return path


def _plan(protocol: "Protocol", title: str) -> tuple[Section, str]:
    """Return the plan of a session, mounting by mounting, and its length."""
    from undrift.programme import Dwell, Mount, Soak, programme_of

    programme, rows = programme_of(protocol), []
    first = [k for k, step in enumerate(programme.steps) if isinstance(step, Mount)]
    for begin, end in zip(first, [*first[1:], None], strict=True):
        steps = programme.steps[begin:end]
        purposes = [step.purpose for step in steps if isinstance(step, Dwell)]
        temps_c = ", ".join(f"{step.temp_c:g}" for step in steps if isinstance(step, Soak)) or "room"
        counts = len(purposes) - purposes.count("rate"), purposes.count("rate")
        rows.append((str(steps[0]), temps_c, *map(str, counts), f"{sum(step.duration_s for step in steps) / 60.0:.1f}"))
    total = f"{len(rows)} mountings, {programme.duration_s / 60.0:.0f} min"
    heads = ("step", "set-points (degC)", "rests", "rates", "time (min)")
    return Section(title=f"{title}: plan of the session, {total}", columns=heads, rows=tuple(rows), folded=True), total


def write_protocols(outcome: "StudyOutcome", folder: Path) -> None:
    """Write the protocol to use of each task."""
    for task in outcome.tasks:
        write_protocol(folder, task.surface.task, protocol_of(outcome, task))


def run_words(protocol: "Protocol", folder: Path) -> tuple[object, ...]:
    """Return the words of the command that runs the protocol of a task; addresses are to be filled in."""
    places = ("--rig", "--device", "--chamber")[: 3 if protocol.temperatures_c else 2]
    addresses = (word for place in places for word in (place, "ADDRESS"))
    return "rig", "run", folder / f"protocol-{protocol.name}.toml", *addresses, "-o", f"session-{protocol.name}"


def rig_sections(outcome: "StudyOutcome", folder: Path) -> tuple[Section, ...]:
    """Return the commands that run the protocol of each task on a rate table and fit it, and the plans of these sessions."""
    lines, plans = [], []
    for task in outcome.tasks:
        key, protocol = task.surface.task, protocol_of(outcome, task)
        session, oven = f"session-{key}", bool(protocol.temperatures_c)
        plan, total = _plan(protocol, plain_words(key))
        plans.append(plan)
        lines.append(f"On the rate table, {plain_words(key)}: {total}.")
        if inclined := [pose for pose in protocol.faces if " " in pose]:
            lines.append(
                f"File and commands have the level faces alone; errors above are with {', '.join(inclined)} too."
            )
        lines.append("undrift " + shlex.join(map(str, run_words(protocol, folder))))
        lines.append(f"undrift calibrate {session} --mode paper --output {key}.json")
        tables = f"--spline not-a-knot --tables scale+dynamic --output {key}.json"
        lines += [f"undrift drift {session} --calibration {key}.json {tables}"] * oven
    return Section(title="Commands for the rate table", text=tuple(lines)), *plans
