"""A session that contradicts the calibration given is refused or told with its figures."""

from dataclasses import replace

import numpy as np
import pytest

from undrift.drift.fit import DriftSettings, fit_drift
from undrift.drift.verdict import check_offsets
from undrift.errors import Implausible
from undrift.model import Verdict
from undrift.sim.device.presets import preset
from undrift.sim.device.truth import true_calibration
from undrift.sim.motion.bench import BenchSettings
from undrift.sim.thermal import ChamberSettings, ThermalSettings, simulate_thermal_session

DEVICE = preset("enc03j_3031")
CALIBRATION = true_calibration(DEVICE)
QUICK = ChamberSettings(ramp_rate_c_per_min=20.0, air_lag_s=5.0, board_lag_s=10.0, soak_hold_s=120.0)
BENCH = BenchSettings(
    sample_rate_hz=50.0, still_s=6.0, move_s=1.0, turn_rates=tuple(np.radians((30.0, 60.0))), dwell_s=1.5
)
SETTINGS = ThermalSettings(
    bench=BENCH,
    chamber=QUICK,
    set_points_c=(20.0, 30.0, 40.0),
    warm_up_c=(18.0, 38.0),
    warm_up_s=1000.0,
)
TABLES = DriftSettings(tables="none")


@pytest.fixture(scope="module")
def session():
    return simulate_thermal_session("soak", DEVICE, rng=np.random.default_rng(3), settings=SETTINGS)


def turned(session, change):
    return replace(session, turns=tuple(change(t) if t.turn_rate is not None else t for t in session.turns))


def shifted(dps, calibration=CALIBRATION):
    gyro = calibration.gyro
    return replace(calibration, gyro=replace(gyro, offset=gyro.offset + gyro.forward_matrix @ np.radians(dps)))


def warmed(seed, dps):
    result = simulate_thermal_session("warm_up", DEVICE, rng=np.random.default_rng(seed), settings=SETTINGS)
    gain = CALIBRATION.gyro.forward_matrix @ np.radians(dps)
    return replace(result, records=tuple(replace(r, gyro=r.gyro + gain) for r in result.records))


def test_turns_about_wrong_axes_are_refused(session):
    negated = turned(session, lambda t: replace(t, turn_rate=-t.turn_rate))
    with pytest.raises(Implausible, match="axes -x, -y, -z"):
        fit_drift([negated], CALIBRATION, settings=TABLES)
    ring = turned(session, lambda t: replace(t, axis={"x": "y", "y": "z", "z": "x"}[t.axis]))
    with pytest.raises(Implausible, match=r"axes \+y, \+z, \+x"):
        fit_drift([ring], CALIBRATION, settings=TABLES)


def test_other_scale_than_the_calibration_is_reported(session):
    fit = fit_drift([session], CALIBRATION, settings=TABLES)
    assert not any("differ" in item.code for item in fit.verdict.findings)
    for share, status, figure in ((0.9, "bad", "10."), (0.97, "marginal", "2.")):
        slow = turned(session, lambda t, share=share: replace(t, turn_rate=share * t.turn_rate))
        fit = fit_drift([slow], CALIBRATION, settings=TABLES)
        differs = [item for item in fit.verdict.findings if item.code == "drift.scale_differs"]
        assert len(differs) == 1
        assert figure in differs[0].sentence
        assert fit.verdict.status == status


@pytest.mark.parametrize(
    ("scale", "offset_g", "status"),
    [(1.01, 0.0, ""), (1.5, 0.0, "fail"), (1.0, 0.08, "warn")],
)
def test_accelerometers_that_contradict_are_reported(session, scale, offset_g, status):
    accel = CALIBRATION.accel
    other = replace(
        accel, matrix=accel.matrix * scale, offset=accel.offset + accel.forward_matrix @ np.full(3, 9.81 * offset_g)
    )
    fit = fit_drift([session], replace(CALIBRATION, accel=other), settings=TABLES)
    differs = [item for item in fit.verdict.findings if item.code == "drift.accel_differs"]
    assert [item.level for item in differs] == ([status] if status else [])


def with_table_uncertainty(static, dps):
    raw = np.broadcast_to(
        np.abs(np.diag(CALIBRATION.gyro.forward_matrix)) * np.radians(dps), (len(static.table.temp_c), 3)
    )
    return replace(static, gyro=replace(static.gyro, uncertainty=raw))


@pytest.mark.parametrize(
    ("off", "known_to", "status", "code"),
    [
        (6.0, 1.5, "marginal", "drift.offset_differs"),  # four standard uncertainties
        (15.0, 3.0, "marginal", "drift.offset_differs"),  # five: too few for bad
        (15.0, 1.0, "bad", "drift.offset_differs"),
        (6.0, 3.0, "good", ""),  # two
        (1.0, 0.1, "good", ""),  # ten, and no more than a switch-on makes
    ],
)
def test_offset_differs_from_three_standard_uncertainties(off, known_to, status, code):
    static = fit_drift([warmed(4, (0.0, 0.0, 0.0))], CALIBRATION, settings=TABLES).static
    verdict = Verdict.of(*check_offsets(with_table_uncertainty(static, known_to), shifted((off, 0.0, 0.0))))
    assert verdict.status == status
    assert [item.code for item in verdict.findings] == ([code] if code else [])
    if code:
        assert f"+- {known_to:.2g}, " in verdict.reasons[0]


def test_sessions_of_two_devices_are_refused():
    pair = [warmed(1, (0.0, 0.0, 0.0)), warmed(2, (120.0, 0.0, 0.0))]
    with pytest.raises(Implausible, match=r"standard deviation of"):
        fit_drift(pair, CALIBRATION, settings=TABLES)
