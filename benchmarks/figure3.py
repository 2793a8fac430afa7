"""Figure 3 beside its rival without a chamber: largest pitch error of each correction, typical unit and units of the kind.

``python -m benchmarks.figure3 [--units 30] [--seed 0]`` prints the table of docs/study.md: the actual device 12.5 K above the
bench, tables from rising soaks (typical unit also from soaks both ways), each drawn unit on a person of its own.
"""

import argparse
import sys

from undrift.study.figure3 import DRAWN_UNITS, drawn_cohort, figure3


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--units", type=int, default=DRAWN_UNITS)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    typical, both_ways = (figure3(seed=given.seed, back=back).actual_max_deg for back in (False, True))
    print(
        f"{'largest pitch error, deg':26}{'typical':>9}{'both ways':>11}{f'{given.units} drawn units: median (quartiles)':>42}"
    )
    for k, row in enumerate(drawn_cohort(units=given.units, seed=given.seed)):
        drawn = f"{row.median_deg:.2f} ({row.lower_deg:.2f} to {row.upper_deg:.2f})"
        print(f"{row.correction:26}{typical[k]:9.2f}{both_ways[k]:11.2f}{drawn:>42}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
