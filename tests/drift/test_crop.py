"""Tables are fitted over all that was seen and cut afterwards."""

import numpy as np

from undrift.drift.fit import widened


def test_nodes_go_on_at_their_step_until_they_span_what_was_seen():
    nodes = np.linspace(40.0, 50.0, 21)
    wide = widened(nodes, (38.9, 51.0))
    np.testing.assert_allclose(wide, np.arange(38.5, 51.1, 0.5))
    np.testing.assert_array_equal(wide[3:24], nodes)
    np.testing.assert_array_equal(widened(nodes, (41.0, 50.0)), nodes)
