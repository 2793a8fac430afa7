"""The cheapest session for each kind of device, task and category of people: makes docs/study-answers.md.

``python -m benchmarks.answers [KIND ...] [--devices 20]`` uses the shipped fits where they exist. Sessions in a chamber are
left out, as they take hours. The page is written after each device.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from undrift.base.workers import executor
from undrift.sim.device.presets import PRESETS
from undrift.study.judge import StudyOutcome, judge
from undrift.study.plan import Study, StudyTask, with_categories
from undrift.study.run import run_study, with_checked_fits
from undrift.study.sessions import SESSIONS

PAGE = Path(__file__).parents[1] / "docs" / "study-answers.md"
TASKS = ("sit_to_stand", "step", "posturography")
CATEGORIES = ("level_2", "young", "impaired")
SESSION_NAMES = (
    "motion", "hand", "free poses", "three rates", "hand, warm", "three rates, warm",
)  # fmt: skip


def study_of(kind: str, devices: int) -> Study:
    """Return the study of a kind of device."""
    study = Study(
        name=kind,
        device=kind,
        tasks=tuple(StudyTask(name=name) for name in TASKS),
        sessions=tuple(SESSIONS[name] for name in SESSION_NAMES),
        subjects=devices,
        subjects_max=devices,
    )
    return with_categories(study, CATEGORIES)


def answer_row(outcome: StudyOutcome) -> list[str]:
    """Return the answers for all tasks and categories together at each target."""
    return [answer.session or "none" for answer in outcome.for_all]


def worst_row(outcome: StudyOutcome) -> list[str]:
    """Return the error that 95 % of devices stay below in the least favourable task and category, for each session."""
    cells = []
    for name in SESSION_NAMES:
        rows = [row for task in outcome.tasks for row in task.sessions if row.session.name == name]
        worst = max(row.quantile_deg for row in rows)
        cells.append(f"{worst:.2f}" if np.isfinite(worst) else "–")
    return cells


def task_rows(outcome: StudyOutcome) -> list[list[str]]:
    """Return a row per task: the answers at the three targets for each category."""
    rows = []
    for name in TASKS:
        cells = [
            " / ".join(answer.session or "none" for answer in task.answers)
            for task in outcome.tasks
            if task.task.name == name
        ]
        rows.append([name.replace("_", "-"), *cells])
    return rows


def table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Return a Markdown table."""
    lines = [heads, ["---"] * len(heads), *rows]
    return [f"| {' | '.join(line)} |" for line in lines]


def first_sentences(answers: Sequence[Sequence[str]]) -> str:
    """Return what a laboratory can do, from the answers at 0.5, 1 and 2 deg of each device, task and category."""
    half, one = ([answer[k] for answer in answers] for k in (0, 1))
    by_hand = sum(name in ("motion", "hand", "free poses") for name in one)
    at_room = sum(name not in ("none", "hand, warm", "three rates, warm") for name in half)
    warm = sum("warm" in name for name in half)
    return (
        f"**For 1 deg, calibrate by hand at room temperature: this is enough in {by_hand} of {len(answers)} combinations of "
        f"device, task and people.\nFor 0.5 deg, a session at room temperature is enough in {at_room}, and a session at the "
        f"temperature at which the device is worn in {warm} more.**"
    )


def page(outcomes: Sequence[StudyOutcome]) -> str:
    """Return the page."""
    first = outcomes[0].study
    targets = [f"{target:g} deg" for target in first.target_deg]
    minutes = [f"{name} ({SESSIONS[name].length_min:.0f})" for name in SESSION_NAMES]
    rows = [[outcome.study.device, *row] for outcome in outcomes for row in task_rows(outcome)]
    lines = [
        "# Answers for each kind of device",
        "",
        first_sentences([cell.split(" / ") for row in rows for cell in row[2:]]),
        "",
        "Good enough means that 95 % of the simulated devices have an error below the target, each on a different person.",
        f"Each row is for {outcomes[0].subjects} devices (seed {first.seed}), worn {first.excursion_k[0]:g} to "
        f"{first.excursion_k[1]:g} K above room temperature, with the offset of the rest subtracted.",
        "Sessions in a chamber take hours and are not in the tables.",
        "",
        "## One session for all tasks and people",
        "",
        "The table covers three tasks (sit-to-stand, step, posturography) and three categories of people (level 2 of the note, "
        "young, impaired).",
        "",
        *table(("device", *targets), [[outcome.study.device, *answer_row(outcome)] for outcome in outcomes]),
        "",
        "## Error that 95 % of the devices stay below",
        "",
        "Errors are in deg, for the least favourable combination of task and category.",
        "The minutes of each session are in brackets.",
        "A dash means that the session could not calibrate every device.",
        "",
        *table(("device", *minutes), [[outcome.study.device, *worst_row(outcome)] for outcome in outcomes]),
        "",
        "## Each task",
        "",
        f"Each cell lists the cheapest session at {' / '.join(targets)}.",
        "",
        *table(
            ("device", "task", *(name.replace("_", " ") for name in CATEGORIES)),
            rows,
        ),
        "",
    ]
    return "\n".join(lines)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kinds", nargs="*", default=[*PRESETS], help="presets; all if not given")
    parser.add_argument("--devices", type=int, default=20)
    parser.add_argument("--output", type=Path, default=PAGE)
    given = parser.parse_args()
    outcomes = list[StudyOutcome]()
    with executor() as spread:
        for kind in given.kinds:
            study = with_checked_fits(study_of(kind, given.devices), spread)
            outcomes.append(judge(study, run_study(study, spread)))
            print(kind, "shipped fits" * study.shipped, *answer_row(outcomes[-1]), *worst_row(outcomes[-1]), flush=True)
            given.output.write_text(page(outcomes), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
