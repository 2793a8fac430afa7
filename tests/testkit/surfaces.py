"""Surfaces of known errors, for the statistics of a study."""

import numpy as np


def errors(error: np.ndarray) -> dict[str, np.ndarray]:
    """All error columns of runs whose root-mean-square is known: a maximum of twice that, alike in both timings."""
    return {
        f"error_{offline}{figure}_deg": factor * error
        for offline in ("", "offline_")
        for figure, factor in (("rms", 1.0), ("max", 2.0), ("end", 1.5))
    }
