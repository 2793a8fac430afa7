"""One dwell with a rate that is not its own: named before the fit, or a walk of the offset, bends to it."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.findings import only
from undrift.calibration.checks import nearest_signed_permutation
from undrift.calibration.dwells import DwellMeans, imposed_rates
from undrift.calibration.rate_table import RestMeans, check_dwells, fit_rate_table, fit_with_rests
from undrift.errors import Implausible

DPS = np.pi / 180.0
RATES = np.array([-90.0, -45.0, 45.0, 90.0]) * DPS
K = np.array([[900.0, 12.0, -9.0], [-11.0, 910.0, 7.0], [8.0, -6.0, 895.0]])
B = np.array([20.0, 95.0, 70.0])
FELT = np.array([[0.3, -0.2, 0.1], [0.2, 0.25, -0.3], [-0.1, 0.3, 0.2]])  # count per m/s2: 0.2 (deg/s)/g


def table(noise=0.5, seed=0, curve=0.0):
    """Twelve dwells and six rests of gyroscopes that feel gravity."""
    rng = np.random.default_rng(seed)
    axis = tuple(a for a in "xyz" for _ in RATES)
    rate = np.tile(RATES, 3)
    up = 9.81 * np.eye(3)[["xyz".index(a) for a in axis]]
    w = np.eye(3)[["xyz".index(a) for a in axis]] * rate[:, None]
    w = w + curve * w * np.abs(w)
    faces = 9.81 * np.vstack((np.eye(3), -np.eye(3)))
    reading = w @ K.T + up @ FELT.T + B + noise * rng.normal(size=(12, 3))
    rests = RestMeans(
        dwell_force=up,
        reading=faces @ FELT.T + B + noise * rng.normal(size=(6, 3)),
        force=faces,
        noise=np.full((6, 3), max(noise, 1e-6)),
        time=np.arange(6) * 8.0,
    )
    dwells = DwellMeans(
        reading=reading,
        turn_rate=rate,
        axis=axis,
        noise=np.full((12, 3), max(noise, 1e-6)),
        up=np.ones(12),
        unit="count",
        time=48.0 + 4.0 * np.arange(12),
    )
    return dwells, rests


def stated(dwells, k, rate_dps):
    wrong = dwells.turn_rate.copy()
    wrong[k] = rate_dps * DPS
    return replace(dwells, turn_rate=wrong)


def checked(dwells, rests, **more):
    check_dwells(dwells, imposed_rates(dwells, None), rests=rests, **more)


@pytest.mark.parametrize(
    ("rate", "reads"),
    [
        (45.0, r"turn 6, y at \+45 deg/s: reads as -45[.0-9]*; check its sign, value"),
        (-67.5, r"turn 6, y at -67.5 deg/s: reads as -4[45]"),
        (0.0, r"turn 6, y at \+0 deg/s: reads as -4[45]"),
        (-45.9, r"turn 6, y at -45.9 deg/s: reads as -4[45]"),
    ],
)
def test_a_wrong_sign_or_value_is_named_with_what_it_reads(rate, reads):
    dwells, rests = table()
    with pytest.raises(Implausible, match=reads) as caught:
        checked(stated(dwells, 5, rate), rests)
    assert caught.value.turns == (6,)


def test_a_wrong_axis_and_the_numbers_of_the_session_are_named():
    dwells, rests = table()
    wrong = replace(dwells, axis=(*dwells.axis[:5], "z", *dwells.axis[6:]))
    with pytest.raises(Implausible, match=r"turn 26, z at -45 deg/s: reads as -45.* about y; check"):
        checked(wrong, rests, numbers=tuple(range(21, 33)))


def test_three_false_dwells_are_all_named_and_more_are_counted():
    dwells, rests = table()
    three = stated(stated(stated(dwells, 1, 45.0), 5, 45.0), 10, -45.0)
    with pytest.raises(Implausible) as caught:
        checked(three, rests)
    assert caught.value.turns == (2, 6, 11)


def test_without_rests_the_dwells_alone_tell():
    dwells, _ = table()
    with pytest.raises(Implausible, match=r"turn 6, y at \+45 deg/s"):
        checked(stated(dwells, 5, 45.0), None)


def test_sound_tables_pass_with_noise_curvature_and_without_anything():
    for seed in range(40):
        checked(*table(seed=seed))
        checked(*table(noise=5.0, seed=seed))  # 0.3 deg/s
    checked(*table(noise=0.0))
    checked(*table(curve=0.003))  # 0.5 % of full scale at the ends


def test_too_few_dwells_to_tell_are_left_alone():
    dwells, _ = table()
    few = [0, 3, 4, 7, 8, 11]
    six = replace(
        dwells,
        reading=dwells.reading[few],
        turn_rate=-dwells.turn_rate[few],
        axis=tuple(dwells.axis[k] for k in few),
        up=np.ones(6),
    )
    checked(six, None)


def test_a_table_that_is_uncertain_drifts_or_scatters_is_not_good():
    dwells, rests = table(noise=0.05)
    assert fit_with_rests(fit_rate_table(dwells), dwells, rests).verdict.status == "good"
    wrong = stated(dwells, 5, 45.0)  # as if nobody had looked for it
    fit = fit_with_rests(fit_rate_table(wrong), wrong, rests)
    assert np.array_equal(nearest_signed_permutation(fit.model.forward_matrix), np.eye(3))
    assert fit.verdict.status == "bad"
    scatter = only(fit.verdict.findings, "rate_table.scatter")
    assert scatter.values["residual_percent"] > scatter.values["wanted"] == 0.5
    uncertain = only(fit.verdict.findings, "rate_table.uncertainty")
    assert uncertain.values["uncertainty_percent"] > uncertain.values["wanted"] == 0.5
    drifting = replace(dwells, reading=dwells.reading + 0.4 * (dwells.time - 70.0)[:, None])  # 1.5 deg/s in a minute
    walk = fit_with_rests(fit_rate_table(drifting), drifting, None)
    assert walk.verdict.status == "marginal"
    drift = only(walk.verdict.findings, "rate_table.drift")
    assert drift.level == "warn"
    assert drift.values["dps_per_minute"] > drift.values["wanted"] == 0.1
