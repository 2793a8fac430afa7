"""Composition: a table takes the place of its constant, so that nothing counts twice; each step meets what the last one left.

Other flight stacks fit a thermal polynomial that carries a constant, keep the offset of the static calibration beside it, and
subtract both; applied to the readings of the calibration itself that leaves the rate of minus one offset.
"""

from dataclasses import replace

import numpy as np
import pytest

from testkit.full_calibration import GAP, STEPS, N, device, record, tables
from undrift.correction.correct import correct, correct_checked
from undrift.model import DriftTables, DynamicDrift, ScaleDrift, StaticDrift

REFERENCE_C = 30.0
LAW = np.array([[120.0, -80.0, 45.0], [0.9, -1.6, 0.4], [0.010, 0.004, -0.012]])  # counts, per degC, per degC^2


def offset(temp):
    t = np.asarray(temp)[:, None] - REFERENCE_C
    return LAW[0] + LAW[1] * t + LAW[2] * t**2


def fitted_table(rng, noise):
    """A cubic through noisy means at rest, as absolute offsets at the nodes, with their standard uncertainty."""
    seen = np.linspace(18.0, 75.0, 200)
    means = offset(seen) + rng.normal(size=(200, 3)) * noise
    design, nodes = np.vander(seen - 45.0, 4), np.vander(STEPS - 45.0, 4)
    spread = noise * np.sqrt(np.einsum("ni,ij,nj->n", nodes, np.linalg.inv(design.T @ design), nodes))
    table = nodes @ np.linalg.lstsq(design, means, rcond=None)[0]
    return StaticDrift(temp_c=STEPS, gyro_offset=table, gyro_uncertainty=np.tile(spread[:, None], 3))


def at_rest(temp, rng, noise=0.0):
    gyro = offset(temp) + rng.normal(size=(len(temp), 3)) * noise
    return record(len(temp), gyro=gyro, accel=None, temp_c=temp)


@pytest.mark.parametrize("seed", range(5))
def test_thermal_table_agrees_at_the_calibration_temperature(seed):
    rng, noise, many = np.random.default_rng(seed), 2.0, 4000
    raw = at_rest(np.full(many, REFERENCE_C), rng, noise)
    c = device(g=False)
    # calibrated at rest
    c = replace(c, gyro=replace(c.gyro, offset=raw.gyro.mean(axis=0)), reference_temp_c=REFERENCE_C)
    table = fitted_table(rng, noise)
    alone = correct(raw, c).gyro.mean(axis=0)
    both = correct(raw, replace(c, drift=DriftTables(static=table))).gyro.mean(axis=0)
    node = np.searchsorted(STEPS, REFERENCE_C)
    counts = np.hypot(table.gyro_uncertainty[node], noise / np.sqrt(many))  # of the table, and of the calibration
    within = np.sqrt(c.gyro.matrix**2 @ counts**2)
    assert np.abs(alone).max() < 1e-12  # rad/s, rounding: the calibration takes its own rest for zero
    assert (np.abs(both - alone) < 4.0 * within).all()  # 15 axes: 1 in 1000 that one lies beyond 4 sigma
    twice = raw.gyro.mean(axis=0) - table.gyro_offset[node] - c.gyro.offset  # what the others come to
    assert np.abs(c.gyro.matrix @ twice).max() > 100.0 * within.max(), "the failure would be seen"


def test_away_from_the_calibration_the_table_alone_is_subtracted():
    rng = np.random.default_rng(1)
    temp = np.linspace(20.0, 70.0, N)
    c = device(g=False)
    table = fitted_table(rng, 0.0)
    done = correct(at_rest(temp, rng), replace(c, drift=DriftTables(static=table)))
    curve = 0.125 * 0.5**2 * np.abs(2.0 * LAW[2]).max()  # counts: a parabola between nodes 0.5 degC apart
    assert np.abs(done.gyro).max() < 1.1 * curve * np.abs(c.gyro.matrix).sum(axis=1).max()


@pytest.mark.parametrize("change", [{"offset": np.array([1e4, -1e4, 1e4])}, {"matrix": np.eye(3) * 7.0}])
def test_a_constant_that_a_table_replaces_has_no_say(change):
    r, c = record(), device(drift=tables(scale=STEPS))
    other = replace(c, gyro=replace(c.gyro, **change), accel=replace(c.accel, **change))
    assert correct_checked(r, c).record.gyro.tobytes() == correct_checked(r, other).record.gyro.tobytes()
    assert correct_checked(r, c).record.accel.tobytes() == correct_checked(r, other).record.accel.tobytes()


def test_dynamic_table_meets_the_rate_after_the_scale_table():
    c, rng = device(), np.random.default_rng(9)
    temp = np.linspace(20.0, 70.0, N)
    matrix = c.gyro.matrix * (1.0 + 0.01 * (STEPS - 45.0))[:, None, None]  # a third more or less at the ends
    share = 0.02 + 0.001 * (STEPS - 18.0)  # error over rate: linear in both, so that the table holds it exactly
    dynamic = DynamicDrift(temp_c=STEPS, turn_rate=GAP, error=(share[:, None] * GAP)[..., None] * [1.0, -1.0, 0.5])
    static = StaticDrift(temp_c=STEPS, gyro_offset=offset(STEPS))
    table = DriftTables(static=static, scale=ScaleDrift(temp_c=STEPS, gyro_matrix=matrix), dynamic=dynamic)
    measured, force = rng.uniform(-1.5, 1.5, (N, 3)), rng.normal(size=(N, 3)) * 9.81
    at = np.array([np.interp(temp, STEPS, column) for column in matrix.reshape(115, 9).T]).T.reshape(N, 3, 3)
    held = np.array([np.interp(temp, STEPS, column) for column in offset(STEPS).T]).T
    u = np.linalg.solve(at, (measured + force @ c.gyro.g_sensitivity.T)[..., None])[..., 0] + held
    raw = record(gyro=u, accel=force @ c.accel.forward_matrix.T + c.accel.offset, temp_c=temp)
    error = (0.02 + 0.001 * (temp - 18.0))[:, None] * measured * [1.0, -1.0, 0.5]
    got = correct(raw, replace(c, drift=table, reference_temp_c=np.nan))
    np.testing.assert_allclose(got.gyro, measured - error, rtol=0, atol=1e-12)  # a solve of values near 1000 counts
