"""Tables made ready: even grids where there is one."""

import numpy as np

from tuned import GAP, STEPS, WILD
from undrift.drift.lookup import even_nodes


def test_even_grids_are_found_where_there_is_one():
    assert len(even_nodes(STEPS)) == 115
    assert len(even_nodes(GAP)) == 37  # the gap between -10 and 10 deg/s filled with three nodes
    assert len(even_nodes(np.array([0.0, 2.0, 5.0]))) == 6  # the smallest gap is two steps
    assert even_nodes(WILD) is None
    assert even_nodes(np.array([0.0, 1e-6, 1.0])) is None  # too fine
