"""The open comparison: ``UNDRIFT_RIVALS=PYTHON python -m benchmarks.public [orientation|bench]``.

PYTHON is the interpreter of an environment with ahrs, allantools, imucal and vqf. Writes docs/comparison.json, the
source of the docs page and its figure. Other tables in it remain unchanged.
"""

import datetime
import json
import sys
from pathlib import Path

from benchmarks.public import bench, orientation

OUT = Path(__file__).parents[2] / "docs" / "comparison.json"
ORDER = ("end", "inclination", "poses", "certificate", "six-faces", "rate-table", "warm-up", "allan")


def main() -> None:
    """Make the tables that are named, or all."""
    stored = {table["name"]: table for table in json.loads(OUT.read_text())["tables"]} if OUT.exists() else {}
    for name in sys.argv[1:] or ("bench", "orientation"):
        for table in {"bench": bench, "orientation": orientation}[name].tables():
            stored[table.name] = table.as_dict()
            print(f"\n{table.title}, {table.unit}")
            for row in stored[table.name]["rows"]:
                span = "" if row["low"] is None else f" [{row['low']:.3g}, {row['high']:.3g}]"
                label = ", ".join(filter(None, (row["method"], row["program"])))
                print(f"  {label:90} {row['mean']:8.3g}{span}  " + " ".join(f"{v:.3g}" for v in row["values"]))
    content = {"made": datetime.date.today().isoformat(), "tables": [stored[name] for name in ORDER if name in stored]}
    OUT.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n")


if __name__ == "__main__":
    main()
