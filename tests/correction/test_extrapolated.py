"""Nodes that no data were near: time spent there and what the tables state, against a plain twin, batch and stream."""

from dataclasses import replace

import numpy as np
import pytest

from testkit import twins
from testkit.full_calibration import GAP, STEPS, WILD, N, device, record, tables
from undrift.correction.correct import Corrector, correct_checked
from undrift.errors import DriftRangeError
from undrift.model import DriftTables, DynamicDrift, StaticDrift

QUANTISED = np.round(np.linspace(20.0, 70.0, N) * 2.0) / 2.0  # on the nodes of STEPS


def marked(drift, *, static=None, scale=None, dynamic=None, stated=True, accel=True):
    """The same tables with marks, and with uncertainties of a few counts, or of thousandths of a matrix or a rate."""
    rng = np.random.default_rng(6)

    def u(*shape):
        return rng.uniform(1.0, 2.0, shape) if stated else None

    if static is not None:
        n = len(drift.static.temp_c)
        of = {"gyro_uncertainty": u(n, 3), "gyro_extrapolated": static}
        if accel:
            of |= {"accel_uncertainty": u(n, 3), "accel_extrapolated": static[::-1]}
        drift = replace(drift, static=replace(drift.static, **of))
    if scale is not None:
        n = len(drift.scale.temp_c)
        given = u(n, 3, 3)
        of = {"gyro_uncertainty": None if given is None else given * 1e-6, "gyro_extrapolated": scale}
        drift = replace(drift, scale=replace(drift.scale, **of))
    if dynamic is not None:
        given = u(*drift.dynamic.error.shape)
        of = {"uncertainty": None if given is None else given * 1e-3, "extrapolated": dynamic}
        drift = replace(drift, dynamic=replace(drift.dynamic, **of))
    return drift


@pytest.mark.parametrize("nodes", [STEPS, WILD, np.array([18.0, 20.0, 26.0, 75.0])], ids=["even", "searched", "filled"])
@pytest.mark.parametrize("temp", [record().temp_c, QUANTISED], ids=["between", "on nodes"])
def test_a_sample_is_extrapolated_where_a_node_that_it_draws_on_is(nodes, temp):
    marks = np.random.default_rng(7).random(len(nodes)) < (0.2 if len(nodes) > 9 else 0.0)
    marks[0] = True
    drift = marked(tables(static=nodes, dynamic=None), static=marks)
    c, r = device(drift=drift), replace(record(), temp_c=temp)
    done = correct_checked(r, c)
    si = np.sqrt(drift.static.gyro_uncertainty**2 @ c.gyro.matrix.T**2).max(axis=1)
    of_rate, rate = twins.extrapolated(nodes, marks, si, temp)
    si = np.sqrt(drift.static.accel_uncertainty**2 @ c.accel.matrix.T**2).max(axis=1)
    of_accel, accel = twins.extrapolated(nodes, marks[::-1], si, temp)
    np.testing.assert_array_equal(done.extrapolated, of_rate | of_accel)
    assert 0 < np.count_nonzero(done.extrapolated) < N
    assert (done.reach.stated["rate"], done.reach.stated["accel"]) == pytest.approx((rate, accel), rel=1e-12)
    assert done.reach.stated["scale"] == 0.0
    assert done.seconds_extrapolated == pytest.approx(np.count_nonzero(done.extrapolated) * 0.01)


def test_the_dynamic_table_is_extrapolated_where_rate_and_temperature_meet_a_mark():
    marks = np.zeros((len(STEPS), len(GAP)), dtype=bool)
    marks[STEPS > 40.0] = np.radians(45.0) < GAP  # hot and fast to the one side
    c = device(drift=marked(tables(static=None, dynamic=(STEPS, GAP)), dynamic=marks))
    done = correct_checked(record(), c, policy="hold")
    hot = record().temp_c > 40.0
    fast = (done.record.gyro > np.radians(45.0)).any(axis=1)
    np.testing.assert_array_equal(done.extrapolated, hot & fast)
    assert 0 < done.extrapolated.sum() < hot.sum()
    assert 1e-3 < done.reach.stated["rate"] < 2e-3


def test_a_scale_table_states_a_share_of_the_reading():
    drift = tables(static=None, scale=STEPS, dynamic=None)
    drift = marked(drift, scale=STEPS > 60.0)
    c = device(drift=drift)
    done = correct_checked(record(), c)
    np.testing.assert_array_equal(done.extrapolated, record().temp_c > 60.0)
    used = drift.scale.gyro_uncertainty[STEPS > 60.0]
    turned = [np.sqrt((u**2 @ c.gyro.forward_matrix**2).max()) for u in used]  # (dM K w)_i for one w_k at a time
    assert done.reach.stated["scale"] == pytest.approx(max(turned), rel=1e-3)  # one or two of the nodes may not be met
    share = 100.0 * done.reach.stated["scale"]
    assert done.findings[0].code == "correct.extrapolated"
    assert done.findings[0].values["uncertainty"] == (f"{share:.2g} % of the reading",)


def test_what_lies_outside_the_table_is_outside_and_not_extrapolated():
    marks = (STEPS < 30.0) | (STEPS > 70.0)
    c, r = device(drift=marked(tables(dynamic=None), static=marks)), record(low=10.0, high=80.0)
    for policy in ("hold", "nan"):
        done = correct_checked(r, c, policy=policy)
        assert (r.temp_c[done.outside] < 18.0).any()
        assert (r.temp_c[done.outside] > 75.0).any()
        np.testing.assert_array_equal(done.outside, (r.temp_c < 18.0) | (r.temp_c > 75.0))
        inside = (r.temp_c >= 18.0) & (r.temp_c <= 75.0)
        # the marks of the accelerometers run the other way: below 23 and above 63 degC
        np.testing.assert_array_equal(done.extrapolated, inside & ((r.temp_c < 30.0) | (r.temp_c > 63.0)))
        assert [found.code for found in done.findings] == ["correct.outside", "correct.extrapolated"]
        assert done.warnings[0].startswith(f"{done.outside.sum() * 0.01:.1f} s outside the drift table: 1")
        assert done.warnings[1].startswith(f"{done.extrapolated.sum() * 0.01:.1f} s where the drift table is extrapol")


def test_raise_refuses_what_lies_further_beyond_what_was_seen_than_tables_reach_unasked():
    c = device(drift=marked(tables(dynamic=None), static=STEPS > 60.0, accel=False))
    assert correct_checked(record(high=62.9), c).extrapolated.any()
    with pytest.raises(DriftRangeError, match=r"wanted temperatures from 18 to 63 degC, got 20\.0 to 63\.\d degC"):
        correct_checked(record(high=63.9), c)
    with pytest.raises(DriftRangeError, match="wanted temperatures from 18 to 63 degC"):
        Corrector(c, "raise").push_checked(record(high=63.9))


def test_extrapolated_nodes_are_part_of_the_table_and_warn_where_they_are_not_refused():
    c = device(drift=marked(tables(dynamic=None), static=STEPS > 60.0, accel=False))
    for policy in ("hold", "nan"):
        done = correct_checked(record(), c, policy=policy)
        assert np.isfinite(done.record.gyro).all()
        rate = np.degrees(done.reach.stated["rate"])
        assert done.warnings == (
            f"{done.seconds_extrapolated:.1f} s where the drift table is extrapolated: standard uncertainty there up to "
            f"{rate:.2g} deg/s; extend the thermal session to these temperatures and rates",
        )


def test_marks_without_an_uncertainty_are_reported_as_such():
    c = device(drift=marked(tables(dynamic=None), static=STEPS > 60.0, stated=False))
    done = correct_checked(record(), c, policy="hold")
    assert [found.code for found in done.findings] == ["correct.extrapolated_unstated"]
    assert "the table states no uncertainty there" in done.warnings[0]
    drift = marked(tables(dynamic=None), static=STEPS > 60.0)
    gappy = drift.static.gyro_uncertainty.copy()
    gappy[-20] = np.nan
    gappy_device = device(drift=replace(drift, static=replace(drift.static, gyro_uncertainty=gappy)))
    done = correct_checked(record(), gappy_device, policy="hold")
    assert np.isinf(done.reach.stated["rate"])


def test_tables_without_a_mark_or_met_elsewhere_give_no_warning():
    assert not correct_checked(record(), device(drift=marked(tables(dynamic=None), static=STEPS < 0.0))).warnings
    cold = device(drift=marked(tables(dynamic=None), static=STEPS > 60.0, accel=False))
    assert not correct_checked(record(high=60.0), cold).warnings
    only = device(drift=marked(tables(dynamic=None), static=STEPS > 60.0))
    gone = correct_checked(replace(record(), gyro=None), replace(only, gyro=None), policy="hold")
    assert gone.reach.stated["rate"] == 0.0
    gap = replace(record(), temp_c=np.full(N, np.nan))
    assert not correct_checked(gap, cold).extrapolated.any()


def test_a_stream_reports_the_extrapolated_nodes_of_the_batch():
    marks = np.zeros((len(STEPS), len(GAP)), dtype=bool)
    marks[50:] = GAP > 0.5
    c, r = device(drift=marked(tables(), static=STEPS > 60.0, dynamic=marks)), record(low=10.0, high=80.0)
    batch, corrector = correct_checked(r, c, policy="nan"), Corrector(c, "nan")
    masks = [corrector.push_checked(r.part(k, min(k + 29, N))).extrapolated for k in range(0, N, 29)]
    np.testing.assert_array_equal(np.concatenate(masks), batch.extrapolated)
    assert corrector.warnings == batch.warnings
    assert corrector.state.samples_extrapolated == batch.extrapolated.sum()
    assert corrector.state.reach.stated == batch.reach.stated
    assert corrector.state.reach.seconds_extrapolated == pytest.approx(batch.seconds_extrapolated)
    many = correct_checked(r, c, policy="nan", threads=3)
    np.testing.assert_array_equal(many.extrapolated, batch.extrapolated)
    assert many.warnings == batch.warnings


def test_hysteresis_is_reported_in_deg_per_s_and_not_applied():
    drift = tables(dynamic=None)
    with_loop = DriftTables(static=replace(drift.static, gyro_hysteresis=[4.0, -20.0, 0.0]))
    plain, done = (correct_checked(record(), device(drift=d)) for d in (drift, with_loop))
    assert done.record.gyro.tobytes() == plain.record.gyro.tobytes()
    left = np.degrees(np.abs(device().gyro.matrix @ [4.0, -20.0, 0.0]).max())
    assert done.notes == (
        f"Hysteresis is not corrected: half-width up to {left:.2g} deg/s, which counts as uncertainty; the table holds the mean of "
        "warming and cooling",
    )
    assert done.findings[0].code == "correct.hysteresis"
    assert done.findings[0].values["half_width_dps"] == pytest.approx(left, rel=1e-12)
    bare = DriftTables(static=StaticDrift(temp_c=[18.0, 75.0], gyro_hysteresis=[1.0, 1.0, 1.0]))
    assert correct_checked(record(), device(drift=bare)).notes == ()  # no table, no middle


@pytest.mark.parametrize(
    "nodes", [np.array([20.0, 30.0, 40.0, 50.0]), np.array([20.0, 30.0, 41.0, 50.0])], ids=["even", "searched"]
)
@pytest.mark.parametrize("marked_node", [0, 1, 2, 3])
def test_on_a_node_only_its_own_mark_counts(nodes, marked_node):
    marks = np.arange(4) == marked_node
    r = record(4, temp_c=nodes)
    c = device(drift=marked(tables(static=nodes, dynamic=None), static=marks, accel=False))
    np.testing.assert_array_equal(correct_checked(r, c, policy="hold").extrapolated, marks)


def test_on_a_node_of_rate_and_temperature_only_its_own_mark_counts():
    temp, rate = np.array([20.0, 30.0, 40.0]), np.array([-1.0, 0.0, 1.0])
    model = replace(device(g=False).gyro, matrix=np.eye(3), offset=np.zeros(3))
    for place in np.ndindex(3, 3):
        marks = np.zeros((3, 3), dtype=bool)
        marks[place] = True
        error = DynamicDrift(
            temp_c=temp, turn_rate=rate, error=np.zeros((3, 3, 3)), uncertainty=np.ones((3, 3, 3)), extrapolated=marks
        )
        c = device(g=False, gyro=model, drift=DriftTables(dynamic=error))
        r = record(9, gyro=np.repeat(rate, 3)[:, None] * np.ones(3), accel=None, temp_c=np.tile(temp, 3))
        np.testing.assert_array_equal(correct_checked(r, c).extrapolated, marks.T.ravel())
