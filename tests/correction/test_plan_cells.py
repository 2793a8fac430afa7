"""Tables made ready: even grids where there is one."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from testkit.full_calibration import GAP, STEPS, WILD
from undrift.correction.plan import evened
from undrift.kernels.correct import cell


def test_even_grids_are_found_where_there_is_one():
    assert len(evened(STEPS).nodes) == 115
    assert len(evened(GAP).nodes) == 37  # the gap between -10 and 10 deg/s filled with three nodes
    assert len(evened(np.array([0.0, 2.0, 5.0])).nodes) == 6  # the smallest gap is two steps
    assert evened(WILD).inverse == 0.0
    assert evened(np.array([0.0, 1e-6, 1.0])).inverse == 0.0  # too fine


@pytest.mark.slow
@given(low=st.integers(-400, 400), parts=st.integers(1, 1000), cells=st.integers(1, 2000))
def test_the_cell_of_an_even_table_is_found_without_a_search(low, parts, cells):
    nodes = (low + np.arange(cells + 1)) / parts  # any step: 1/3, 0.1, 0.007 degC
    grid = evened(nodes)
    assert grid.inverse > 0.0
    assert grid.cells == cells


@pytest.mark.parametrize("nodes", [STEPS, WILD], ids=["even", "searched"])
def test_cell_and_fraction_are_found_to_both_ends(nodes):
    grid, values = evened(nodes), np.arange(len(nodes), dtype=float)
    for x in (*nodes, *(0.3 * nodes[1:] + 0.7 * nodes[:-1]), nodes[0] - 5.0, nodes[-1] + 5.0):
        i, f = cell(grid, x)
        assert i + f == pytest.approx(np.interp(x, nodes, values), abs=1e-9)
        assert 0 <= i < len(nodes) - 1
        assert 0.0 <= f <= 1.0
