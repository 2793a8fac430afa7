"""Before and after in degrees over a stated motion, against closed forms."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.plain_triad import plain_triad
from undrift.model import Calibration, DriftTables, DynamicDrift, ScaleDrift, StaticDrift
from undrift.validation.table_worth import LEAN, MOTION_S, expected_errors

NODES = np.array([20.0, 25.0, 30.0, 37.5, 50.0])
SLOPE = 0.01  # deg/s per K on x
U = 0.002  # deg/s, standard uncertainty of the table


def calibration(**tables):
    gyro = plain_triad("dps", "rad/s")
    offset = np.stack([SLOPE * (NODES - 25.0), 0.0 * NODES, 0.0 * NODES], axis=1)
    static = StaticDrift(
        temp_c=NODES,
        gyro_offset=offset,
        gyro_uncertainty=np.full((5, 3), U),
        gyro_extrapolated=np.zeros(5, bool),
    )
    drift = DriftTables(**({"static": static} | tables))
    return Calibration(device="a", reference_temp_c=25.0, gravity_m_s2=9.81, gyro=gyro, drift=drift)


def test_an_offset_alone_is_taken_by_a_rest_and_by_the_table():
    found = expected_errors(calibration(), rest_variance=np.full(3, 0.001**2))
    assert found.temp_c == 37.5
    assert found.constant_deg == pytest.approx(12.5 * SLOPE * MOTION_S, rel=0.01)
    assert found.rest_deg == pytest.approx(0.0, abs=1e-6)
    assert found.tables_deg == pytest.approx(1.96 * U * MOTION_S)
    assert found.both_deg == pytest.approx(1.96 * 0.001 * MOTION_S)
    assert "12.5 K above the reference" in found.motion
    assert "were not measured" in found.answer


def test_a_scale_over_temperature_is_left_by_the_rest_and_not_by_the_table():
    matrix = np.radians(np.eye(3)) * (1.0 - 0.002 * (NODES - 25.0))[:, None, None]
    scale = ScaleDrift(temp_c=NODES, gyro_matrix=matrix, gyro_uncertainty=np.full((5, 3, 3), np.radians(1e-4)))
    found = expected_errors(calibration(scale=scale), rest_variance=np.zeros(3))
    grown = 1.0 / (1.0 - 0.002 * 12.5) - 1.0
    assert found.rest_deg == pytest.approx(np.degrees(LEAN) * grown, rel=0.01)
    assert found.constant_deg > found.rest_deg
    assert found.both_deg == pytest.approx(1.96 * np.degrees(LEAN) * 1e-4 / (1.0 - 0.025), rel=1e-6)
    assert "--offset rest" in found.answer


def test_tables_that_add_nothing_are_called_so():
    rates = np.radians([-60.0, 0.0, 60.0])
    dynamic = DynamicDrift(
        temp_c=NODES, turn_rate=rates, error=np.zeros((5, 3, 3)), uncertainty=np.full((5, 3, 3), np.radians(0.01))
    )
    found = expected_errors(calibration(dynamic=dynamic), rest_variance=np.zeros(3))
    assert found.answer == "A rest before the motion is as good as these tables here"
    flat = calibration()
    none = replace(flat.drift.static, gyro_offset=np.zeros((5, 3)))
    found = expected_errors(replace(flat, drift=replace(flat.drift, static=none)), rest_variance=np.zeros(3))
    assert found.answer.startswith("At this temperature, these tables are no better")
