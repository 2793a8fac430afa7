"""Real data first: every public set with a truth, one row each.

``python -m benchmarks.real [ROW ...] [--write]`` prints the table. ``--write`` also writes ``docs/real.json`` and the
table of ``docs/real.md``; with named rows, the other rows keep their former results. ``benchmarks/real.toml`` has the
task, the truth, the limit with its date and reason, and the commands of each row.
"""

import argparse
import json
import sys
import tomllib
from datetime import date
from pathlib import Path
from time import perf_counter
from typing import Any

from benchmarks.real.rows import ROWS

ROOT = Path(__file__).parents[2]
LIMITS = ROOT / "benchmarks" / "real.toml"
RESULTS, PAGE = ROOT / "docs" / "real.json", ROOT / "docs" / "real.md"
BEGIN, END = " <!-- table -->\n", " <!-- end of table -->\n"
MARGIN = 1.1  # a row that loses to the best rival by more has a reason
LEAST_SQUARES = {  # fits to the same readings without a prior, a weight or a setting
    "least squares to the optics of the others", "least squares of lengths", "straight line", "rest offset and angle",
    "cubic, as PX4 and ArduPilot store", "line through two means",
}  # fmt: skip


def run(name: str, texts: dict[str, Any]) -> dict[str, Any]:
    """Return the result of a row, or why it has none."""
    start = perf_counter()
    row: dict[str, Any] = {"name": name, **texts}
    try:
        outcome = ROWS[name]()
    except Exception as error:  # noqa: BLE001  a row that cannot run is a result
        return {**row, "failed": f"{type(error).__name__}: {error}", "seconds": round(perf_counter() - start, 1)}
    rival, best = min(outcome.rivals.items(), key=lambda item: item[1])
    return {
        **row, "error": round(outcome.error, 4), "rivals": {k: round(v, 4) for k, v in outcome.rivals.items()},
        "best_rival": rival, "within": bool(outcome.error <= texts["limit"]),
        "loses": bool(outcome.error > MARGIN * best), "inside": outcome.inside, "checks": outcome.checks,
        "parts": {k: round(v, 4) for k, v in outcome.parts.items()}, "seconds": round(perf_counter() - start, 1),
    }  # fmt: skip


def held_text(row: dict[str, Any]) -> str:
    """Return how many stated intervals hold."""
    return f"{row['inside']} of {row['checks']}" if row["checks"] else "none stated"


def line(row: dict[str, Any]) -> list[str]:
    """Return the cells of a row."""
    unit = row["unit"]
    if "failed" in row:
        return [row["set"], row["task"], f"{row['limit']:g} {unit}", "cannot run: " + row["failed"], "", ""]
    mark = ("" if row["within"] else " (outside)") + (" (loses)" if row["loses"] else "")
    best = row["rivals"][row["best_rival"]]
    return [row["set"], row["task"], f"{row['limit']:g} {unit}", f"{row['error']:.3g}{mark}",
        f"{best:.3g}, {row['best_rival']}", held_text(row)]  # fmt: skip


LEAST_SQUARES_TEXT = (
    "Priors and settings of undrift were chosen with simulations and with the trials of BROAD.",
    "This table compares undrift with ordinary least squares on the same readings, which has no priors, settings or intervals.",
    "Calibration from motion only has no such rival, because least squares without a prior has no unique answer for it.",
    "The truth of both Ferraris rows is such a fit.",
)
HEAD = ["set", "task", "limit", "undrift", "best plain rival", "95 % intervals that hold"]


def worth(rows: list[dict[str, Any]]) -> list[str]:
    """Return the table of rows that plain least squares can answer too."""
    cells = [["set", "task", "undrift", "plain least squares", "ratio"], ["---"] * 5]
    for row in rows:
        for rival in (name for name in row.get("rivals", {}) if name in LEAST_SQUARES):
            ours, plain, unit = row["error"], row["rivals"][rival], row["unit"]
            cells.append([row["set"], row["task"], f"{ours:.3g} {unit}", f"{plain:.3g} {unit}", f"{ours / plain:.2f}"])
    return ["| " + " | ".join(line) + " |" for line in cells]


def summary(rows: list[dict[str, Any]]) -> str:
    """Return the sums of the table."""
    done = [row for row in rows if "failed" not in row]
    inside, checks = (sum(row[key] for row in done) for key in ("inside", "checks"))
    share = f"{100.0 * inside / checks:.0f} %" if checks else "none"
    shares = [row["inside"] / row["checks"] for row in done if row["checks"]]
    return (
        f"{sum(row['within'] for row in done)} of {len(rows)} rows are within their limit. "
        f"{sum(row['loses'] for row in done)} lose to the best plain rival by more than 10 %. "
        f"Of {checks} stated 95 % intervals, {inside} hold ({share}). "
        f"The mean over the rows is {100.0 * sum(shares) / max(len(shares), 1):.0f} %."
    )


def page_table(content: dict[str, Any]) -> str:
    """Return the generated part of the page: the table, causes, limits and commands."""
    rows = content["rows"]
    table = ["| " + " | ".join(cells) + " |" for cells in (HEAD, ["---"] * len(HEAD), *map(line, rows))]
    sets = [row["set"] for row in rows]
    titles = [name if sets.count(name) == 1 else f"{name}, {row['task']}" for name, row in zip(sets, rows, strict=True)]
    causes = [f"- {title}: {row['cause']}" for title, row in zip(titles, rows, strict=True) if row.get("cause")]
    parts = [f"Run on {content['made']}. {summary(rows)}", "", *table, "", "## Misses and their causes", "", *causes,
        "", "## Without priors, weights and settings", "", *LEAST_SQUARES_TEXT, "", *worth(rows),
        "", "## Limits, rivals and commands"]  # fmt: skip
    for row in rows:
        rivals = "; ".join(f"{name} {value:.3g} {row['unit']}" for name, value in row.get("rivals", {}).items())
        parts += ["", f"### {row['set']}: {row['task']}", "", f"- Truth: {row['truth']}",
            f"- Limit: {row['limit']:g} {row['unit']}, set on {row['date']}. {row['reason']}",
            f"- Rivals: {rivals or 'none'}", "", "<!-- parsed: needs the recordings -->", "```sh",
            *row["commands"], "```"]  # fmt: skip
    left = [f"- `{name}`: {why}" for name, why in content["left_out"].items()]
    return "\n".join([*parts, "", "## Sets without a row", "", *left]) + "\n"


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("rows", nargs="*", metavar="ROW")
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    limits = tomllib.loads(LIMITS.read_text(encoding="utf-8"))
    unknown = sorted(set(options.rows) - set(ROWS))
    if unknown:
        print(f"no row {', '.join(unknown)}; there are {', '.join(ROWS)}", file=sys.stderr)
        return 2
    results = {}
    for name in options.rows or ROWS:
        results[name] = run(name, limits["rows"][name])
        print(f"{name} ({results[name]['seconds']:.0f} s): {' | '.join(line(results[name])[2:])}", flush=True)
        if "rivals" in results[name]:
            print("    " + "; ".join(f"{k} {v:.3g}" for k, v in results[name]["rivals"].items()), flush=True)
    if options.write:
        former = {row["name"]: row for row in json.loads(RESULTS.read_text())["rows"]} if RESULTS.exists() else {}
        rows = [{**(results.get(name) or former[name]), **limits["rows"][name]} for name in ROWS
            if name in former or name in results]  # fmt: skip
        content = {"made": str(date.today()), "rows": rows, "left_out": limits["left_out"]}
        RESULTS.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
        if PAGE.exists():
            before, _, rest = PAGE.read_text(encoding="utf-8").partition(BEGIN)
            PAGE.write_text(f"{before}{BEGIN}{page_table(content)}{END}{rest.partition(END)[2]}", encoding="utf-8")
    print(f"\n{summary([*results.values()])} {sum(row['seconds'] for row in results.values()):.0f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
