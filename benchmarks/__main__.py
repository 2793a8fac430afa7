"""Run every benchmarks/bench_*.py and print one table. With ``--strict``, exit with 1 if a gate is violated.

``python -m benchmarks [NAME ...]`` runs only the named ones (``correct`` for ``bench_correct.py``). The gates apply to an
idle machine with two cores. A busy machine violates some.
"""

import importlib
import sys
import time
from pathlib import Path

from benchmarks.figure import Figure


def main(names: list[str]) -> int:
    """Print the figures of the named benchmarks, or of all. Return 1 if a gate is broken and ``--strict`` is given."""
    strict = "--strict" in names
    names = [name for name in names if name != "--strict"]
    every = {path.stem.removeprefix("bench_"): path.stem for path in sorted(Path(__file__).parent.glob("bench_*.py"))}
    unknown = sorted(set(names) - set(every))
    if unknown:
        print(f"no benchmark named {', '.join(unknown)}; there are {', '.join(every)}", file=sys.stderr)
        return 2
    broken: list[str] = []
    for name in names or every:
        start = time.perf_counter()
        figures: list[Figure] = importlib.import_module(f"benchmarks.{every[name]}").run()
        print(f"\n{name}   ({time.perf_counter() - start:.0f} s)")
        for figure in figures:
            mark = "" if not figure.gate else "ok" if figure.passed else "BROKEN"
            print(f"  {figure.label:<84} {figure.value:>10.4g} {figure.unit:<10} {figure.gate:<9} {mark}")
        broken += [f"{name}: {figure.label}" for figure in figures if not figure.passed]
    print(f"\n{len(broken)} gates broken" + "".join(f"\n  {line}" for line in broken))
    return 1 if broken and strict else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
