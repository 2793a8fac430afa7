"""PX4 and ArduPilot: the published conversion, curves read back, what is lost, and what is refused."""

import re
from dataclasses import replace

import numpy as np
import pytest

from testkit.autopilots import import_ardupilot, import_px4, read_parameters
from testkit.data import show
from testkit.full_calibration import STEPS, device, tables
from undrift.errors import InputError
from undrift.export import ExportOptions
from undrift.export.autopilots import Cubic, export_ardupilot, export_px4, fit_cubic
from undrift.model import AdcModel, DriftTables, StaticDrift
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

DEG = np.pi / 180.0


def value(text, name):
    return read_parameters(text)[name]


def fixture_times():
    """Temperatures of the conversion fixture: a warm-up from 18 degC that ends just short of 75 degC."""
    t = np.arange(0.0, 2700.0, 0.1)
    return 18.0 + 57.0 * (1.0 - np.exp(-t / 600.0)) / (1.0 - np.exp(-4.5))


def fixture_curve(temp_c):
    d = temp_c - 35.0
    return (0.30 + 0.012 * d - 2e-4 * d**2 + 1.5e-6 * d**3) * DEG


def fixture(extra=0.0):
    """A calibration in rad/s whose static table is the curve of the fixture."""
    temp_c = np.linspace(fixture_times()[0], fixture_times()[-1], 115)
    offset = np.column_stack([fixture_curve(temp_c) + extra * ((temp_c - 45.0) / 30.0) ** 4] * 3)
    made = device(unit="si", g=False, drift=DriftTables(static=StaticDrift(temp_c=temp_c, gyro_offset=offset)))
    return replace(made, gyro=replace(made.gyro, unit_in="rad/s"))


def test_the_conversion_fixture_has_the_published_figures():
    ardupilot, px4 = export_ardupilot(fixture()).text, export_px4(fixture()).text
    got = [value(ardupilot, f"INS_TCAL1_GYR{power}_Y") for power in (1, 2, 3)]
    show("ArduPilot 1..3", got, "209.43951024, -3.4906585040, 0.026179938780")
    np.testing.assert_allclose(got, [209.43951024, -3.4906585040, 0.026179938780], rtol=3e-11)  # the printed digits
    got = [value(px4, f"TC_G0_X{power}_2") for power in range(4)]
    show("PX4 X0..X3", got, "7.2227115044e-3, 1.3954153152e-4, -2.5874548074e-6, 2.6179938780e-8")
    np.testing.assert_allclose(got, [7.2227115044e-3, 1.3954153152e-4, -2.5874548074e-6, 2.6179938780e-8], rtol=3e-11)
    assert value(px4, "TC_G0_TREF") == pytest.approx(46.4999466350, abs=1e-10)
    dropped = next(note for note in export_ardupilot(fixture()).notes if "no place" in note)
    assert "0.3 / 0.3 / 0.3 deg/s" in dropped  # 5.235987756e-3 rad/s


def test_both_ways_give_the_same_curve():
    temp_c = np.linspace(19.0, 74.0, 500)
    for back in (import_px4(export_px4(fixture()).text), import_ardupilot(export_ardupilot(fixture()).text)):
        worst = float(np.abs(back.gyro.at(temp_c) - fixture_curve(temp_c)[:, None]).max())
        show("worst difference after export and import, rad/s", worst, 1e-15)
        assert worst < 1e-15
    px4 = import_px4(export_px4(fixture()).text)
    again = px4.gyro.about(35.0).about(px4.gyro.reference_c)
    np.testing.assert_allclose(again.coefficients, px4.gyro.coefficients, rtol=1e-12)


def test_a_published_px4_set_is_the_same_curve_in_ardupilot():
    # Pixracer, gyro 0, published from the cubic down to the constant
    down = np.array([
        [5.31149453e-7, -5.3815e-8, -1.0459545e-8], [9.1002960e-8, 4.88552757e-7, -1.751046284e-6],
        [6.7804380e-5, -1.48861756e-4, 1.14951130e-4], [-2.0944914e-2, 8.1914719e-3, -3.57050245e-4],
    ])  # fmt: skip
    tref, tmin, tmax = 44.155124664, 32.155124664, 56.157894135
    lines = ["TC_G_ENABLE,1", f"TC_G0_TREF,{tref}", f"TC_G0_TMIN,{tmin}", f"TC_G0_TMAX,{tmax}"]
    lines += [f"TC_G0_X{power}_{axis},{float(down[3 - power, axis])!r}" for power in range(4) for axis in range(3)]
    published = import_px4("\n".join(lines)).gyro
    x = 5.0
    np.testing.assert_allclose(
        published.at(np.array([tref + x]))[0], ((down[0] * x + down[1]) * x + down[2]) * x + down[3], rtol=1e-13
    )
    np.testing.assert_array_equal(published.at(np.array([90.0])), published.at(np.array([tmax])))  # held at its ends
    nodes = np.linspace(tmin, tmax, 50)
    static = StaticDrift(temp_c=nodes, gyro_offset=published.at(nodes))
    made = replace(fixture(), drift=DriftTables(static=static), reference_temp_c=40.0)
    back = import_ardupilot(export_ardupilot(made).text).gyro
    np.testing.assert_allclose(back.at(nodes), published.at(nodes), rtol=0, atol=1e-15)


def test_the_constant_is_in_one_place_only():
    px4 = export_px4(fixture()).text
    assert [value(px4, f"CAL_GYRO0_{axis}OFF") for axis in "XYZ"] == [0.0, 0.0, 0.0]
    assert value(px4, "TC_G0_X0_0") != 0.0
    plain = replace(fixture(), drift=None)
    px4 = export_px4(plain).text
    assert value(px4, "TC_G_ENABLE") == 0.0
    assert "TC_G0_X0_0" not in px4
    for text, read in ((px4, import_px4), (export_ardupilot(plain).text, import_ardupilot)):
        back = read(text)
        np.testing.assert_allclose(back.gyro.at(np.array([30.0]))[0], plain.gyro.offset, rtol=1e-15)
        np.testing.assert_allclose(back.accel.at(np.array([30.0]))[0], plain.accel.offset, rtol=1e-15)
        np.testing.assert_allclose(back.accel_gain, np.diag(plain.accel.matrix), rtol=1e-15)


def test_counts_want_the_gain_of_the_driver():
    made = device(g=False, drift=tables(static=np.linspace(20.0, 70.0, 6), dynamic=None))
    for to in (export_px4, export_ardupilot):
        with pytest.raises(
            InputError, match="gyro: wanted the gain that the autopilot's driver uses, since the calibration is"
        ):
            to(made)
        with pytest.raises(InputError, match="accel: wanted the gain"):
            to(made, ExportOptions(gyro_dps_per_unit=1e-3 / RADIAN_PER_DEGREE))
        with pytest.raises(InputError, match=r"got -1\.0; give the nominal gain"):
            to(made, ExportOptions(gyro_dps_per_unit=-1.0))
    text = export_px4(
        made, ExportOptions(gyro_dps_per_unit=1e-3 / RADIAN_PER_DEGREE, accel_g_per_unit=5e-3 / STANDARD_GRAVITY)
    ).text
    table = made.drift.static
    fitted = fit_cubic(table.temp_c, table.gyro_offset * 1e-3)
    np.testing.assert_allclose(import_px4(text).gyro.coefficients, fitted.coefficients, rtol=1e-14)
    np.testing.assert_allclose(import_px4(text).accel_gain, np.diag(made.accel.matrix) / 5e-3, rtol=1e-15)


@pytest.mark.parametrize("sensor", [0, 1, 2])
def test_the_sensor_is_in_every_name(sensor):
    made, settings = device(unit="si", drift=tables(dynamic=None)), ExportOptions(sensor=sensor)
    px4, ardupilot = export_px4(made, settings).text, export_ardupilot(made, settings).text
    assert set(re.findall(r"(?:TC_[GA]|GYRO|ACC)(\d)_", px4)) == {str(sensor)}
    number = "" if sensor == 0 else str(sensor + 1)
    for name in (
        f"INS_GYR{number}OFFS_X",
        f"INS_ACC{number}SCAL_Z",
        f"INS_TCAL{sensor + 1}_ACC3_Y",
        f"INS_GYR{sensor + 1}_CALTEMP",
    ):
        assert f"\n{name}," in ardupilot
    assert import_px4(px4, sensor=sensor).gyro is not None
    assert import_px4(px4, sensor=(sensor + 1) % 3).accel_gain.tolist() == [1.0, 1.0, 1.0]
    assert import_ardupilot(ardupilot, sensor=sensor).accel is not None
    assert import_ardupilot(ardupilot, sensor=(sensor + 1) % 3).gyro is None


def test_what_is_lost_is_said_with_figures():
    made = device(unit="si", drift=tables(scale=STEPS), adc=AdcModel(gyro_lsb=[1e-3] * 3, gyro_rounding="toward_zero"))
    for to in (export_px4, export_ardupilot):
        said = " | ".join(to(made).not_carried)
        for text in ("gains of the gyroscopes", "cross-axis terms of the gyroscopes, up to", "g-sensitivity, up to", "scale table",
                     "dynamic table), up to", "half a code step", "uncertainties"):  # fmt: skip
            assert text in said, text
        assert "static" not in said
    bent = export_px4(fixture(extra=0.05 * DEG))
    misfit = next(note for note in bent.notes if "depart from the gyroscopes' table" in note)
    worst = float(re.findall(r"up to ([\d.e-]+)", misfit)[0])
    show("a quartic of 0.05 deg/s leaves, deg/s", worst)
    curve = import_px4(bent.text).gyro
    static = fixture(extra=0.05 * DEG).drift.static
    true = np.abs(curve.at(static.temp_c) - static.gyro_offset).max() / DEG
    assert worst == pytest.approx(true, rel=0.06)  # two digits
    assert 0.001 < worst < 0.02


def test_nodes_without_data_do_not_bend_the_cubic():
    whole = fixture()
    static = whole.drift.static
    wrong = static.gyro_offset.copy()
    wrong[100:] += 1.0
    marks = np.arange(115) >= 100
    static = replace(static, gyro_offset=wrong, gyro_extrapolated=marks)
    px4 = import_px4(export_px4(replace(whole, drift=DriftTables(static=static))).text).gyro
    assert px4.high_c == static.temp_c[99]
    seen = static.temp_c[:100]
    np.testing.assert_allclose(px4.at(seen)[:, 0], fixture_curve(seen), rtol=0, atol=1e-15)


def test_codes_rounded_down_have_their_half_step_in_the_offset():
    made = replace(fixture(), adc=AdcModel(gyro_lsb=[2e-3] * 3, gyro_rounding="floor"))
    with_step, without = import_px4(export_px4(made).text).gyro, import_px4(export_px4(fixture()).text).gyro
    at = np.array([40.0])
    np.testing.assert_allclose(with_step.at(at), without.at(at) - 1e-3, rtol=0, atol=1e-15)


def test_few_nodes_make_a_lower_degree():
    line = fit_cubic(np.array([20.0, 40.0]), np.array([[0.0, 1.0, 2.0], [2.0, 1.0, 0.0]]))
    np.testing.assert_allclose(line.coefficients, [[1.0] * 3, [0.1, 0.0, -0.1], [0.0] * 3, [0.0] * 3], atol=1e-15)
    with pytest.raises(InputError, match=r"cubic coefficients: wanted shape \(4, 3\)"):
        Cubic(reference_c=25.0, coefficients=np.zeros((3, 3)), low_c=0.0, high_c=1.0, misfit=np.zeros(3))


def test_what_is_refused():
    with pytest.raises(InputError, match="wanted sensor 0, 1 or 2 of the autopilot, got 3"):
        export_px4(fixture(), ExportOptions(sensor=3))
    scaled = replace(device(unit="si", drift=tables(scale=STEPS)), reference_temp_c=float("nan"))
    with pytest.raises(
        InputError, match="wanted a temperature from 18 to 75 degC to read the tables at, got nan; give temp_c"
    ):
        export_px4(scaled)
    assert export_px4(scaled, ExportOptions(temp_c=30.0)).notes[0] == "tables over temperature are read at 30 degC"
    scale = replace(scaled.drift.scale, accel_matrix=None, accel_uncertainty=None, accel_extrapolated=None)
    gyro_alone = replace(scaled, drift=replace(scaled.drift, scale=scale))
    cold, hot = (export_px4(gyro_alone, ExportOptions(temp_c=t)) for t in (30.0, 60.0))
    assert cold.text == hot.text  # gains of gyroscopes have no place there: nothing is frozen, nothing is said of it
    assert "tables over temperature" not in " ".join((*cold.notes, *hot.notes))
