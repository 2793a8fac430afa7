"""Sessions made ready for a thermal fit: units, half steps, power-on, corrected records."""

from dataclasses import replace

import numpy as np
import pytest

from undrift.drift.observe import (
    accel_unit_of,
    check_at_rest,
    in_units_of,
    nominal_models,
    observe_rests,
    since_power_on,
)
from undrift.errors import InputError, NotObservable
from undrift.model import AdcModel
from undrift.record import Record, Session, Still
from undrift.sim.device.presets import preset
from undrift.sim.device.truth import true_calibration

COUNTS = true_calibration(preset("enc03j_3031"))


def record(*, begin_s=0.0, seconds=60.0, gyro_unit="count", accel_unit="count", state="raw"):
    rng = np.random.default_rng(2)
    n = round(50 * seconds)
    return Record(
        time=begin_s + np.arange(n) / 50.0,
        gyro=rng.normal(0.0, 1.0, (n, 3)),
        accel=rng.normal([0.0, 0.0, 10.0], 1.0, (n, 3)),
        temp_c=np.linspace(20.0, 30.0, n),
        gyro_unit=gyro_unit,
        accel_unit=accel_unit,
        state=state,
    )


def session(*records):
    stills = tuple(Still(start=0, stop=len(r), recording=k) for k, r in enumerate(records))
    return Session(kind="thermal", serial="A", gravity_m_s2=9.80665, records=records, stills=stills)


def ages(*records):
    held = [session(*records)]
    blocks = observe_rests(held, temperatures=[[r.temp_c for r in records]])
    return blocks, since_power_on(blocks, held).power_on_s


def test_a_clock_that_runs_on_is_one_switch_on_and_one_that_begins_anew_is_another():
    blocks, since = ages(record(), record(begin_s=300.0))
    assert blocks.power_on_s[-1] == pytest.approx(since[-1] - 300.0)
    assert (np.diff(since) > 0.0).all()
    blocks, since = ages(record(), record(begin_s=300.0), record(begin_s=0.0), record(begin_s=100.0))
    late = since.reshape(4, -1)
    np.testing.assert_allclose(late[2], late[0])
    np.testing.assert_allclose(late[3], late[0] + 100.0)
    np.testing.assert_allclose(late[1], late[0] + 300.0)


def test_readings_come_in_the_units_of_the_calibration_with_their_half_steps():
    physical = replace(COUNTS, gyro=replace(COUNTS.gyro, unit_in="rad/s"))
    ready = in_units_of(session(record(gyro_unit="dps")), physical).records[0]
    assert ready.gyro_unit == "rad/s"
    np.testing.assert_allclose(ready.gyro, np.radians(record().gyro))
    cut = replace(COUNTS, adc=AdcModel(gyro_lsb=np.full(3, 0.5), gyro_rounding="floor"))
    before, after = record(), in_units_of(session(record()), cut).records[0]
    np.testing.assert_allclose(after.gyro, before.gyro + 0.25)
    np.testing.assert_array_equal(after.accel, before.accel)


def test_another_unit_and_a_corrected_record_are_refused():
    with pytest.raises(
        InputError, match="recording 0: wanted gyro readings in count, the unit of the calibration, got dps"
    ):
        in_units_of(session(record(gyro_unit="dps")), COUNTS)
    corrected = record(gyro_unit="rad/s", accel_unit="m/s2", state="corrected")
    with pytest.raises(InputError, match="recording 1: wanted raw readings, got a corrected record"):
        in_units_of(session(record(), corrected), COUNTS)


def test_a_log_that_never_lies_still_is_refused_however_even_it_looks():
    held = [session(record())]
    blocks = observe_rests(held, temperatures=[[held[0].records[0].temp_c]])
    check_at_rest(blocks, COUNTS)
    restless = replace(
        blocks, gyro_variance=np.full((len(blocks), 3), (np.radians(2.0) * COUNTS.gyro.scale_factor) ** 2)
    )
    with pytest.raises(NotObservable, match=r"got none: .* the mean of ten seconds is known to 2 deg/s only"):
        check_at_rest(restless, COUNTS)


def test_a_nominal_model_keeps_the_unit_and_counts_have_none():
    model = nominal_models([session(record(gyro_unit="dps"))])
    np.testing.assert_allclose(model.gyro.matrix, np.radians(np.eye(3)))
    assert model.accel is None
    assert model.verdict.status == "marginal"
    with pytest.raises(NotObservable, match="in a physical unit, got count; give --calibration"):
        nominal_models([session(record())])


def test_the_unit_of_the_accelerometers_is_the_calibrations_or_the_one_they_share():
    physical = session(record(gyro_unit="dps", accel_unit="g"))
    bare = nominal_models([physical])
    assert accel_unit_of([physical], bare) == "g"
    assert accel_unit_of([physical, session(record())], bare) == "count"
    assert accel_unit_of([physical], COUNTS) == COUNTS.accel.unit_in
