"""Figure 3 and its rival without a chamber, for the typical unit and drawn units, simulated and actual, as in
docs/note.md.

``python -m benchmarks.figure3 [--units 30] [--seed 0]`` prints both tables. The device is 12.5 K warmer than on the
bench, tables are from rising soaks, and each drawn unit is on another person. It takes 5 s per unit.
"""

import argparse
import sys

import numpy as np
from scipy.stats import pearsonr

from undrift.arrays import FloatArray
from undrift.sim.device.presets import random_device
from undrift.study.figure3 import COMPARED, Figure3, figure3
from undrift.study.plan import DEVICE
from undrift.validation.agreement import mean_interval
from undrift.validation.levels import NOTE_DIFFERENCE_DEG


def typical_row(result: Figure3, k: int) -> str:
    """Return the row of a correction for the typical unit."""
    figures = (
        result.simulated_max_deg[k],
        result.actual_max_deg[k],
        result.simulated_actual_max_deg[k],
        result.correlation[k],
    )
    return " | ".join((COMPARED[k], *(f"{value:.2f}" for value in figures)))


def drawn_row(errors: FloatArray, k: int) -> str:
    """Return the row of a correction over drawn units, from their errors (units, 4, 5)."""
    simulated, actual, difference, correlation = errors[:, :, k].T
    quartiles = (np.quantile(x, (0.5, 0.25, 0.75)) for x in (simulated, actual, difference))
    spreads = ["{:.2f} ({:.2f} to {:.2f})".format(*values) for values in quartiles]
    middle, ends = mean_interval(np.arctanh(correlation))  # Fisher's z
    largest = pearsonr(simulated, actual)
    low, high = largest.confidence_interval()
    over_time = "{:.2f} [{:.2f}, {:.2f}]".format(*np.tanh((middle, *ends)))
    over_units = f"{largest.statistic:.2f} [{low:.2f}, {high:.2f}]"
    within = str(int((difference <= NOTE_DIFFERENCE_DEG).sum()))
    return " | ".join((COMPARED[k], *spreads, within, over_time, over_units))


def drawn_errors(number: int, seed: int) -> FloatArray:
    """Return one drawn unit, (4, 5), for each of ``COMPARED``: largest pitch error simulated and actual and their largest
    difference, deg, and their correlation.
    """
    unit = random_device(np.random.default_rng([seed, 3, number]), grade=DEVICE)
    result = figure3(unit, seed=1000 * (seed + 1) + number)
    largest = (result.simulated_max_deg, result.actual_max_deg, result.simulated_actual_max_deg)
    return np.array((*largest, result.correlation))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--units", type=int, default=30)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    print("correction | simulated | actual | largest difference | r")
    typical = figure3(seed=options.seed)
    print("\n".join(typical_row(typical, k) for k in range(len(COMPARED))))
    print(
        f"\n{options.units} drawn: correction | simulated | actual | difference | within 0.15 deg | r over time | r over units"
    )
    errors = np.array([drawn_errors(number, options.seed) for number in range(options.units)])
    for k in range(len(COMPARED)):
        print(drawn_row(errors, k))
    return 0


if __name__ == "__main__":
    sys.exit(main())
