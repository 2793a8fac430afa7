"""What the technical note claims and what undrift finds: writes the tables of docs/note.md and docs/study.md.

``undrift study --preset note -o note`` makes the study, then ``python -m benchmarks.note note/summary.json`` writes the tables
between the marks of the two pages.
"""

import argparse
import json
import re
import sys
from pathlib import Path
from typing import Any

DOCS = Path(__file__).parents[1] / "docs"
TASKS = {"sit_to_stand": "sit-to-stand", "step": "step", "posturography": "posturography"}
NOTE_P = {"sit_to_stand": "0.048", "step": "0.040", "posturography": "0.049"}
PROCEDURES = {
    "hand": "six faces and three full turns by hand, at room temperature",
    "free poses": "24 poses by hand with the moves between them",
    "three rates": "six faces, then 15, 52.5 and 90 deg/s in both directions about three axes",
    "note rates": "the same with the note's 17 rates",
    "hand, warm": "by hand, at the temperature at which the device is worn",
    "three rates, warm": "three rates, at that temperature",
    "two set-points": "three rates at 25 and 40 degC",
    "note": "the note's rates at its five set-points, 18 to 75 degC",
}
Row = dict[str, Any]


def table(columns: list[str], rows: list[list[str]]) -> str:
    """Return a table in Markdown."""
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (columns, ["---"] * len(columns), *rows))


def spread(values: list[float]) -> str:
    """Return the least and the largest value, deg."""
    low, high = f"{min(values):.3f}", f"{max(values):.3f}"
    return f"{low} deg each" if low == high else f"{low} to {high} deg"


def found(study: Row) -> dict[str, str]:
    """Return the tables by the names of their marks."""
    tables = study["tables"]
    numbers = {task: tables[f"{task}_the_note_s_table_1"] for task in TASKS}
    tests = {task: [row for row in rows if row["p"] is not None] for task, rows in numbers.items()}
    least = {task: min(row["p (Holm)"] for row in rows) for task, rows in tests.items()}
    rates = max(row["span (deg)"] for rows in tests.values() for row in rows if not row["parameter"].startswith("cut"))
    answers = [row for row in tables["the_cheapest_session_that_is_good_enough"] if row["task"] == "all tasks"]
    levels = {row["level"]: row for row in tables["figure_3_sit_to_stand_task_simulated_and_actual_device"]}
    largest = {level: row["actual: largest (deg)"] for level, row in levels.items()}
    methods = tables["methods_and_rivals"]
    tilt = {row["method"]: row["tilt at rest (deg)"] for row in methods}
    claims = [
        [
            "the four numbers of the protocol change the error (Table 1)",
            "p = " + ", ".join(NOTE_P.values()) + " (sit-to-stand, step, posturography)",
            "smallest p of the four, after Holm: " + ", ".join(f"{p:.2g}" for p in least.values())
            + f"; step and limits of the rates change the error by {1e3 * rates:.1f} mdeg at most",
        ],
        [
            "each task has its own best protocol (Table 1)",
            "other numbers for each task",
            "one session for all tasks: "
            + "; ".join(f"{row['target (deg)']:g} deg: {row['cheapest session']}" for row in answers),
        ],
        [
            "compensation reduces the error of a sit-to-stand (Figure 3)",
            "by more than 3.2 deg",
            f"from {largest['constants']:.2f} to {largest['all tables']:.2f} deg",
        ],
        [
            "the simulated and the actual device agree (Figure 3)",
            "within 0.15 deg",
            f"within {levels['all tables']['largest difference (deg)']:.2f} deg with all tables (both are simulated)",
        ],
        [
            "six faces calibrate accelerometers as well as motion does",
            "no difference",
            f"tilt at rest: six faces on a level plate {tilt['three rates']:.2f} deg, robot arm {tilt['robot arm']:.2f}, "
            f"inclined plane {tilt['inclined plane']:.2f}, trolley {tilt['trolley']:.2f}, piston {tilt['piston']:.2f}",
        ],
        ["the groups (Table 2)", "30 people each", "the same minimum, mean and maximum of age and height"],
    ]  # fmt: skip
    by_parameter = {
        task: {row["parameter"]: row for row in rows} for task, rows in tests.items()
    }  # the row of the note's value has the test
    first = [
        [
            TASKS[task],
            *(spread([row["mean error (deg)"] for row in numbers[task] if row["parameter"] == name]) for name in rows),
            ", ".join(f"{row['p']:.2g}" for row in rows.values()),
            f"{least[task]:.2g}",
            NOTE_P[task],
        ]
        for task, rows in by_parameter.items()
    ]
    shown = ["sit to stand", "step", "posturography"]
    rivals = [
        [
            row["method"] + (f" ({row['devices that fail']} devices fail)" if row["devices that fail"] else ""),
            f"{row['minutes']:.0f}",
            row["triads"],
            *(
                f"{row[f'{t} (deg)']:.2f} ({row[f'{t}, 95 % from (deg)']:.2f} to {row[f'{t}, to (deg)']:.2f})"
                for t in shown
            ),
            f"{row['tilt at rest (deg)']:.2f}",
        ]
        for row in methods
        if row["sit to stand (deg)"] is not None
    ]
    sessions = {task: {row["session"]: row for row in tables[f"{task}_sessions"]} for task in TASKS}
    errors = [
        [
            name,
            PROCEDURES[name],
            f"{row['minutes']:.0f}",
            *(
                f"{rows[name]['95 % of devices below']:.2f} ({rows[name]['mean (deg)']:.2f})"
                for rows in sessions.values()
            ),
        ]
        for name, row in sessions["sit_to_stand"].items()
        if row["mean (deg)"] is not None
    ]
    return {
        "claims": table(["claim", "the note", "undrift"], claims),
        "table-1": table(
            ["task", *by_parameter["step"], "p of the four", "smallest p after Holm", "the note's p"], first
        ),
        "rivals": table(["method", "minutes", "calibrates", *TASKS.values(), "tilt at rest"], rivals),
        "sessions": table(["session", "procedure", "minutes", *TASKS.values()], errors),
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("summary", type=Path, help="summary.json of the note's preset")
    tables = found(json.loads(parser.parse_args().summary.read_text()))
    for page in (DOCS / "note.md", DOCS / "study.md"):
        text = page.read_text()
        for name, rows in tables.items():
            text = re.sub(
                rf"(<!-- made: {name} -->\n)(?:.*?)(\n <!-- end of {name} -->)",
                lambda mark, rows=rows: f"{mark[1]}\n{rows}\n{mark[2]}",  # type: ignore[misc]
                text,
                flags=re.DOTALL,
            )
        page.write_text(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
