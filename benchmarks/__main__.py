"""Run every benchmarks/bench_*.py and print one table. With ``--strict``, exit with 1 if a gate is violated.

``python -m benchmarks [NAME ...]`` runs only the named ones (``correct`` for ``bench_correct.py``). Long benchmarks run
only if they are named (``study-note`` for ``long_study_note.py``). The gates apply to an idle machine with two cores. A
busy machine violates some.
"""

import importlib
import sys
import time
from pathlib import Path

from benchmarks.figure import Figure


def main(names: list[str]) -> int:
    """Print the figures of the named benchmarks, or of all.

    Parameters
    ----------
    names : list of str
        Module names without ``bench_``, empty for all; ``--strict`` anywhere among them.

    Returns
    -------
    int
        0; 1 where a gate is broken and ``--strict`` was said.
    """
    strict = "--strict" in names
    names = [name.replace("_", "-") for name in names if name != "--strict"]
    quick, long = _modules("bench_"), _modules("long_")
    every = {**quick, **long}
    unknown = sorted(set(names) - set(every))
    if unknown:
        print(f"no benchmark named {', '.join(unknown)}; there are {', '.join(every)}", file=sys.stderr)
        return 2
    broken: list[str] = []
    for name in names or quick:
        start = time.perf_counter()
        figures: list[Figure] = importlib.import_module(f"benchmarks.{every[name]}").run()
        print(f"\n{name}   ({time.perf_counter() - start:.0f} s)")
        for figure in figures:
            mark = "" if not figure.gate else "ok" if figure.passed else "BROKEN"
            print(f"  {figure.label:<84} {figure.value:>10.4g} {figure.unit:<10} {figure.gate:<9} {mark}")
        broken += [f"{name}: {figure.label}" for figure in figures if not figure.passed]
    print(f"\n{len(broken)} gates broken" + "".join(f"\n  {line}" for line in broken))
    return 1 if broken and strict else 0


def _modules(prefix: str) -> dict[str, str]:
    """Return the modules of a kind by the names that they are asked for by."""
    stems = sorted(path.stem for path in Path(__file__).parent.glob(f"{prefix}*.py"))
    return {stem.removeprefix(prefix).replace("_", "-"): stem for stem in stems}


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
