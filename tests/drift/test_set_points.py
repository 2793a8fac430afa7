"""Tables of set-points: rows of means, as chamber software writes them, give the tables that their device has."""

from pathlib import Path

import numpy as np
import pytest

from testkit.data import show
from undrift.drift.fit import fit_drift
from undrift.drift.observe import observe_steps
from undrift.errors import InputError
from undrift.io.session import read_file_map, read_session, session_from_files, write_session

TEMPS = np.concatenate((np.arange(20.0, 71.0, 10.0), np.arange(65.0, 24.0, -10.0)))
SD, COUNT = 0.05, 400  # deg/s, readings in a mean
MAP = """
columns = { temp = "T", gyro = ["gx", "gy", "gz"] }
units = { temp = "degC", gyro = "count" }
scale = { gyro = { gain = 2.0, offset = 0.0 } }
[set_points]
count = "n"
gyro_sd = ["sx", "sy", "sz"]
rate = "w"
axis = "z"
"""


def truth(temp_c):
    """Offset of each axis, deg/s, at a temperature."""
    t = np.asarray(temp_c, float)[..., None] - 25.0
    return np.array([1.0, -2.0, 0.5]) + t * np.array([0.02, -0.01, 0.03]) + t**2 * np.array([2e-4, 1e-4, -1e-4])


def table(folder: Path, *, seed=1, spread=True, rates=(), unit=0.5, name="chamber.csv"):
    """Write a table of means; a cell is deg/s over the stated gain of 2, so that the map's numbers are deg/s."""
    rng, rows = np.random.default_rng(seed), []
    for temp in TEMPS:
        for rate in (0.0, *rates):
            # a visit scatters about its curve by more than its readings' noise, as bias instability has it
            mean = truth(temp) + np.array([0.0, 0.0, rate]) * (1.0 + 1e-4 * (temp - 25.0))
            mean = mean + rng.normal(0.0, SD / np.sqrt(COUNT), 3) + rng.normal(0.0, 3e-3, 3)
            cells = [f"{temp:.2f}", f"{COUNT}", *(f"{unit * value:.6f}" for value in mean), f"{rate:g}"]
            rows.append(cells + [f"{unit * SD:.4f}"] * 3 * spread)
    head = ["T", "n", "gx", "gy", "gz", "w", *(["sx", "sy", "sz"] if spread else [])]
    path = folder / name
    path.write_text("\n".join(",".join(row) for row in (head, *rows)) + "\n")
    return path


def mapped(folder: Path, text: str) -> Path:
    (folder / "map.toml").write_text(text)
    return folder / "map.toml"


def session_of(folder: Path, text: str = MAP.replace('"count" }', '"dps" }'), **how):
    return session_from_files([table(folder, **how)], read_file_map(mapped(folder, text)))


def test_rows_are_read_with_count_spread_rate_and_scale(tmp_path):
    session = session_of(tmp_path, rates=(30.0, -30.0))
    (means,), (record,) = session.means, session.records
    assert (session.kind, len(record), session.file_map) == ("set-points", 3 * len(TEMPS), None)
    np.testing.assert_array_equal(means.count, COUNT)
    np.testing.assert_allclose(means.gyro_uncertainty, SD / np.sqrt(COUNT))  # the gain holds for the spread as well
    np.testing.assert_allclose(np.degrees(means.rate_b[:3, 2]), (0.0, 30.0, -30.0))
    np.testing.assert_allclose(record.gyro[0], truth(20.0), atol=0.03)
    assert (means.rate_b[:, :2] == 0.0).all()


def test_offsets_over_temperature_are_those_of_the_device_within_what_is_stated(tmp_path):
    inside, worst = [], 0.0
    nodes = np.arange(20.0, 70.5, 0.5)
    for seed in range(8):
        found = fit_drift([session_of(tmp_path, seed=seed)]).calibration.drift.static
        at = [np.interp(nodes, found.temp_c, column) for column in found.gyro_offset.T]
        doubt = [np.interp(nodes, found.temp_c, column) for column in found.gyro_uncertainty.T]
        error = np.stack(at, axis=1) - truth(nodes)
        inside.append((np.abs(error) <= 1.96 * np.stack(doubt, axis=1)).mean())
        worst = max(worst, float(np.abs(error).max()))
    show("set-points: nodes within 95 %; largest error, deg/s", f"{np.mean(inside):.2f}; {worst:.4f}", "0.87; 0.02")
    # 24 curves with about three independent values each: 0.95 - 3 sqrt(0.95 * 0.05 / 72) = 0.87
    assert np.mean(inside) > 0.87
    assert worst < 0.02  # five standard deviations of a visit, 0.05 / 20 and 0.003 deg/s in quadrature


def test_rows_with_a_rate_give_the_scale_over_temperature(tmp_path):
    text = MAP.replace('"count" }', '"dps" }').replace('rate = "w"\naxis = "z"', 'rate = ["wx", "wy", "wz"]')
    path, lines = table(tmp_path, rates=(-60.0, -30.0, 30.0, 60.0)), []
    for k, line in enumerate(path.read_text().splitlines()):
        cells = line.split(",")
        lines.append(",".join([*cells, *(["wx", "wy", "wz"] if k == 0 else ["0", "0", cells[5]])]))
    path.write_text("\n".join(lines) + "\n")
    session = session_from_files([path], read_file_map(mapped(tmp_path, text)))
    fit = fit_drift([session])
    assert len(fit.steps) == 4 * len(TEMPS)
    assert len(np.unique(fit.steps.soak)) == len(TEMPS)
    (temps,) = (record.temp_c.copy() for record in session.records)
    temps[0] = np.nan  # a first row without temperature
    steps = observe_steps([session], temperatures=[[temps]])
    np.testing.assert_array_equal(steps.soak, fit.steps.soak)
    assert fit.scale_summary is not None
    slope = np.polyfit(fit.scale_summary.soak_temp_c, fit.scale_summary.soak_percent[:, 2], 1)[0]
    # 0.01 % per degC is simulated; a soak knows its scale to 0.003 deg/s over 90 deg/s, eleven of them over 50 degC
    assert slope == pytest.approx(0.01, abs=3e-4)


def test_missing_columns_are_findings_and_the_fit_goes_on_by_the_scatter(tmp_path):
    text = MAP.replace('"count" }', '"dps" }').replace('gyro_sd = ["sx", "sy", "sz"]\n', "")
    poor = fit_drift([session_of(tmp_path, text, spread=False)])
    codes = {item.code: item for item in poor.verdict.findings}
    assert codes["drift.rows_without_uncertainty"].values["rows"] == len(TEMPS)
    rich = fit_drift([session_of(tmp_path)])
    codes = {item.code for item in rich.verdict.findings}
    assert "drift.rows_by_spread" in codes
    assert "drift.rows_without_uncertainty" not in codes
    ratio = np.median(poor.calibration.drift.static.gyro_uncertainty / rich.calibration.drift.static.gyro_uncertainty)
    # both know the scatter of eleven visits about a curve, seven degrees of freedom: three standard deviations of it
    assert 0.5 < ratio < 1.8


def test_a_table_of_means_is_not_warned_of_lag_or_of_a_missing_thermometer(tmp_path):
    codes = {item.code: item.level for item in fit_drift([session_of(tmp_path)]).verdict.findings}
    assert codes["drift.temperature_of_table"] == "info"
    assert not codes.keys() & {"drift.lag_and_hysteresis_excluded", "drift.power_on_transient", "drift.set_points_only"}


def test_what_a_map_of_set_points_may_not_say(tmp_path):
    dps = MAP.replace('"count" }', '"dps" }')
    for text, said in (
        (dps.replace('count = "n"\n', ""), "wanted count beside gyro_sd, got none"),
        (dps.replace('axis = "z"\n', ""), "wanted three columns of rate, or one and axis, got 1"),
        (dps.replace('"sx", "sy", "sz"', '"sx"'), "set_points.gyro_sd: wanted three columns x, y, z, got 1"),
        (dps.replace('count = "n"', 'count = "w"'), "wanted one reading or more in each mean, got a count of 0"),
        (dps.replace('count = "n"', 'count = "m"'), "wanted column 'm'"),
        (dps.replace('temp = "T", ', ""), "wanted the column of the set-points, got none"),
    ):
        with pytest.raises(InputError, match=said):
            fit_drift([session_of(tmp_path, text)])
    with pytest.raises(InputError, match="wanted recordings to write, got means of set-points"):
        write_session(session_of(tmp_path), tmp_path / "out")


def test_a_session_of_set_points_is_read_from_its_toml_as_from_its_map(tmp_path):
    table(tmp_path)
    head = '[session]\nkind = "set-points"\nserial = "a"\ngravity_m_s2 = 9.81\n[[recording]]\nfile = "chamber.csv"\n'
    dps = MAP.replace('"count" }', '"dps" }').replace("[set_points]", "[recording.set_points]")
    (tmp_path / "session.toml").write_text(head + dps)
    stated, bare = read_session(tmp_path), session_of(tmp_path)
    np.testing.assert_array_equal(stated.means[0].gyro_uncertainty, bare.means[0].gyro_uncertainty)
    np.testing.assert_array_equal(stated.records[0].gyro, bare.records[0].gyro)
    assert stated.file_map is None
    (tmp_path / "session.toml").write_text((head + dps).replace('"set-points"', '"thermal"'))
    with pytest.raises(InputError, match="wanted a table of means for each recording of kind set-points"):
        read_session(tmp_path)


DPS = """
columns = { temp = 0, gyro = [1, 2, 3] }
units = { temp = "degC", gyro = "dps" }
set_points = { rate = 4, axis = "z" }
"""


def bare(folder: Path, temp_c, gyro, rate):
    """Write a table without a header and read it by position."""
    rows = np.column_stack((temp_c, gyro + np.outer(rate, (0.0, 0.0, 1.0)), rate))
    (folder / "bare.csv").write_text("\n".join(",".join(f"{cell:.9g}" for cell in row) for row in rows) + "\n")
    return session_from_files([folder / "bare.csv"], read_file_map(mapped(folder, DPS)))


def test_every_row_of_a_table_without_a_header_is_a_block_of_rest(tmp_path):
    temp_c = np.linspace(-10.0, 56.0, 34)
    fit = fit_drift([bare(tmp_path, temp_c, truth(temp_c), np.zeros(34))])
    assert (len(fit.rests), float(fit.rests.temp_c.min())) == (34, -10.0)


def test_gyroscopes_that_repeat_one_reading_are_fitted(tmp_path):
    up = np.linspace(20.0, 40.0, 17)
    fit = fit_drift([bare(tmp_path, np.concatenate((up, up[::-1])), np.tile((0.0, 0.0, 0.2), (34, 1)), np.zeros(34))])
    np.testing.assert_allclose(fit.static.table.gyro_offset - (0.0, 0.0, 0.2), 0.0, atol=1e-6)


def test_rates_that_determine_no_surface_are_a_finding(tmp_path):
    rng = np.random.default_rng(1)
    temp_c, rate = np.array([30.0, 30.0, 30.0, 20.0, 30.0]), np.array([0.0, 100.0, -100.0, 0.0, 100.0])
    fit = fit_drift([bare(tmp_path, temp_c, truth(temp_c) + rng.normal(0.0, 0.005, (5, 3)), rate)])
    assert "drift.tables_not_observable" in {item.code for item in fit.verdict.findings}
