"""Figure 3 beside its rival without a chamber, typical unit and units of the kind, simulated and actual, as docs/note.md has it.

``python -m benchmarks.figure3 [--units 30] [--seed 0]`` prints both tables: the device 12.5 K above the bench, tables from rising
soaks, each drawn unit on a person of its own. 5 s a unit.
"""

import argparse
import sys

from undrift.study.figure3 import COMPARED, DRAWN_UNITS, DrawnRow, Figure3, drawn_cohort, figure3


def typical_row(found: Figure3, k: int) -> str:
    """Return the row of one correction for the typical unit."""
    figures = (
        found.simulated_max_deg[k],
        found.actual_max_deg[k],
        found.simulated_actual_max_deg[k],
        found.correlation[k],
    )
    return " | ".join((COMPARED[k], *(f"{value:.2f}" for value in figures)))


def drawn_row(row: DrawnRow) -> str:
    """Return the row of one correction over drawn units."""
    quartiles = row.simulated_deg, (row.lower_deg, row.median_deg, row.upper_deg), row.apart_deg
    spreads = (f"{middle:.2f} ({low:.2f} to {high:.2f})" for low, middle, high in quartiles)
    correlations = (
        f"{r:.2f} [{ends[0]:.2f}, {ends[1]:.2f}]"
        for r, ends in (
            (row.correlation, row.correlation_interval),
            (row.largest_correlation, row.largest_interval),
        )
    )
    return " | ".join((row.correction, *spreads, str(row.within), *correlations))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--units", type=int, default=DRAWN_UNITS)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    print("correction | simulated | actual | largest difference | r")
    typical = figure3(seed=given.seed)
    print("\n".join(typical_row(typical, k) for k in range(len(COMPARED))))
    print(
        f"\n{given.units} drawn: correction | simulated | actual | difference | within 0.15 deg | r over time | r over units"
    )
    for row in drawn_cohort(units=given.units, seed=given.seed):
        print(drawn_row(row))
    return 0


if __name__ == "__main__":
    sys.exit(main())
