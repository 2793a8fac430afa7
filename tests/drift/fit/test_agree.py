"""A session that contradicts the calibration given is refused or told with its figures."""

import re
from dataclasses import replace

import numpy as np
import pytest

from undrift.drift.procedure import DriftSettings, fit_drift
from undrift.errors import Implausible
from undrift.sim.device.presets import preset
from undrift.sim.device.truth import true_calibration
from undrift.sim.motion.bench import BenchSettings
from undrift.sim.thermal.chamber import ChamberSettings, WarmUpSettings
from undrift.sim.thermal.session import simulate_thermal_session
from undrift.sim.thermal.settings import ThermalSettings

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
    warm_up=WarmUpSettings(start_c=18.0, end_c=38.0, duration_s=1000.0),
)
TABLES = DriftSettings(tables="none", lag_s=0.0)


@pytest.fixture(scope="module")
def session():
    return simulate_thermal_session("soak", DEVICE, rng=np.random.default_rng(3), settings=SETTINGS)


def turned(session, change):
    return replace(session, turns=tuple(change(t) if t.turn_rate is not None else t for t in session.turns))


def shifted(dps, calibration=CALIBRATION):
    gyro = calibration.gyro
    return replace(calibration, gyro=replace(gyro, offset=gyro.offset + gyro.forward_matrix @ np.radians(dps)))


def warmed(seed, dps):
    made = simulate_thermal_session("warm_up", DEVICE, rng=np.random.default_rng(seed), settings=SETTINGS)
    gain = CALIBRATION.gyro.forward_matrix @ np.radians(dps)
    return replace(made, records=tuple(replace(r, gyro=r.gyro + gain) for r in made.records))


def test_turns_the_other_way_round_or_about_other_axes_are_refused(session):
    negated = turned(session, lambda t: replace(t, turn_rate=-t.turn_rate))
    with pytest.raises(Implausible, match=r"scale ratios -1.* got -x, -y, -z: column x and y and z reversed"):
        fit_drift([negated], CALIBRATION, settings=TABLES)
    ring = turned(session, lambda t: replace(t, axis={"x": "y", "y": "z", "z": "x"}[t.axis]))
    with pytest.raises(
        Implausible, match=r"against the calibration .* got \+y, \+z, \+x: columns .* exchanged in a ring"
    ):
        fit_drift([ring], CALIBRATION, settings=TABLES)


def test_a_scale_that_the_calibration_does_not_have_is_told_with_its_figure(session):
    fit = fit_drift([session], CALIBRATION, settings=TABLES)
    assert not any("off the calibration's" in reason for reason in fit.verdict.reasons)
    for share, status, figure in ((0.9, "bad", "10."), (0.97, "marginal", "2.")):
        slow = turned(session, lambda t, share=share: replace(t, turn_rate=share * t.turn_rate))
        fit = fit_drift([slow], CALIBRATION, settings=TABLES)
        said = [reason for reason in fit.verdict.reasons if "scale factors at the reference temperature" in reason]
        assert len(said) == 1
        assert f"temperature {figure}" in said[0]
        assert fit.verdict.status == status


def test_an_offset_that_is_not_the_calibration_s_is_told_in_deg_per_s():
    session = warmed(4, (0.0, 0.0, 0.0))
    assert not any(
        "constant" in r for r in fit_drift([session], shifted((1.0, 0.0, 0.0)), settings=TABLES).verdict.reasons
    )
    for dps, status in ((186.0, "bad"), (6.0, "marginal")):
        fit = fit_drift([session], shifted((dps, 0.0, 0.0)), settings=TABLES)
        said = [reason for reason in fit.verdict.reasons if "off the calibration's constant" in reason]
        assert len(said) == 1
        assert float(re.search(r"degC is (\S+) \+-", said[0])[1]) == pytest.approx(-dps, abs=0.5)
        assert fit.verdict.status == status


def test_sessions_of_two_devices_are_refused():
    pair = [warmed(1, (0.0, 0.0, 0.0)), warmed(2, (120.0, 0.0, 0.0))]
    with pytest.raises(Implausible, match=r"got a standard deviation of .* are they of one device\?"):
        fit_drift(pair, CALIBRATION, settings=TABLES)
