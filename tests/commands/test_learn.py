"""undrift learn: daily recordings in files, dates from names and options, and what is refused with nothing written."""

import json
import os
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest

from undrift.cli.app import run
from undrift.commands.files import dates_of
from undrift.errors import InputError
from undrift.io.formats import write_record
from undrift.io.store import read_calibration, write_calibration
from undrift.sim.daily_use import DailyUseSettings, draw_day, simulate_daily_use
from undrift.sim.device.presets import random_device_of
from undrift.sim.device.truth import true_calibration
from undrift.units import RADIAN_PER_DEGREE

USE = DailyUseSettings(days=4, rest_s=15.0, worn_s=20.0, sample_rate_hz=12.5)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder with a calibration and four recordings named by their date."""
    path, rng = tmp_path_factory.mktemp("days"), np.random.default_rng(8)
    device = random_device_of("mpu6050", rng)
    for day in simulate_daily_use(device, rng=rng, settings=USE, motions=[draw_day(rng, USE)]):
        write_record(day.session.records[0], path / f"2026-03-0{day.number + 1}.parquet")
    true = true_calibration(device)
    covariance = np.array(true.gyro.covariance)
    covariance[9:12, 9:12] = np.eye(3) * (0.03 * RADIAN_PER_DEGREE * true.gyro.scale_factor) ** 2
    write_calibration(replace(true, gyro=replace(true.gyro, covariance=covariance)), path / "c.json")
    return path


def call(*words):
    return run(["learn", *map(str, words)])


def recordings(folder):
    return sorted(folder.glob("2026-03-0?.parquet"))


@pytest.mark.slow
def test_recordings_become_a_table_that_corrects_and_exports(undrift, folder, tmp_path):
    made = tmp_path / "c2.json"
    words = (*recordings(folder), "--calibration", folder / "c.json", "-o", made, "--figure", tmp_path / "c.svg")
    out = undrift.good("learn", *words).out
    assert "stretches at rest, each within 2 degC, in 4 recordings, 0 left out" in out
    assert "verdict: good" in out
    assert "Next: undrift correct" in out
    assert (tmp_path / "c.svg").stat().st_size > 10_000
    calibration = read_calibration(made)
    assert [name for name, _ in calibration.provenance.inputs] == [path.name for path in recordings(folder)]
    assert dict(calibration.provenance.settings)["drift_learn_recordings"] == "4"
    assert [date[:10] for _, date in calibration.drift.learnt.recordings] == [f"2026-03-0{k}" for k in range(1, 5)]
    assert (
        run(["correct", str(recordings(folder)[0]), "--calibration", str(made), "-o", str(tmp_path / "x.parquet")]) == 0
    )
    assert run(["export", str(made), "--target", "c", "-o", str(tmp_path / "u.h")]) == 0
    assert run(["info", str(made)]) == 0


@pytest.mark.slow
def test_day_by_day_writes_the_same_tables_as_all_at_once(folder, tmp_path, capsys):
    days = recordings(folder)
    assert call(*days, "--calibration", folder / "c.json", "-o", tmp_path / "all.json") == 0
    held = folder / "c.json"
    for k, day in enumerate(days):
        assert call(day, "--calibration", held, "-o", tmp_path / f"{k}.json") == 0
        held = tmp_path / f"{k}.json"
    whole, other = (json.loads(path.read_text()) for path in (tmp_path / "all.json", held))
    one = whole["drift"]
    assert (one, whole["accel"]) == (other["drift"], other["accel"])
    assert one["learnt"]["accel"]["model"] == json.loads((folder / "c.json").read_text())["accel"]
    assert call(days[0], "--calibration", held, "-o", held) == 0  # in place, and a second time
    assert "knows already" in capsys.readouterr().out
    assert json.loads(held.read_text())["drift"] == one


@pytest.mark.slow
def test_json_states_change_and_uncertainty_at_every_node(folder, capsys):
    assert call(*recordings(folder), "--calibration", folder / "c.json", "--json") == 0
    answer = json.loads(capsys.readouterr().out)
    assert (answer["kind"], answer["recordings"], answer["output"]) == ("undrift.learn", 4, None)
    nodes = answer["nodes"]
    assert all(len(node["after_dps"]) == len(node["after_uncertainty_dps"]) == 3 for node in nodes)
    assert any(node["extrapolated"] for node in nodes)
    assert any(not node["extrapolated"] for node in nodes)
    near = [node for node in nodes if not node["extrapolated"]]
    assert max(max(node["after_uncertainty_dps"]) for node in near) < 0.2
    assert len(answer["turn_on_dps"]) == len(answer["ageing_dps"]) == 3
    assert answer["accelerometers"]["changed"] is False  # one motion: too few poses
    assert answer["accelerometers"]["offset_mg"] == [0.0, 0.0, 0.0]
    assert min(answer["accelerometers"]["offset_mg_uncertainty"]) > 0.0
    assert "drift.learn_accel_sphere" in [item["code"] for item in answer["verdict"]["findings"]]


def test_the_date_is_stated_or_that_of_the_name_or_of_the_files_last_change(tmp_path, folder, capsys):
    names = ("walk_20260305T0830.csv", "2026-03-06 07:15.csv", "run-2026_13_40.csv")
    paths = tuple(tmp_path / name for name in names)
    for path in paths:
        path.write_text("")
    os.utime(paths[2], (1.0e9, 1.0e9))
    found, changed = dates_of(paths, ())
    assert found[0] == datetime(2026, 3, 5, 8, 30, tzinfo=UTC)
    assert found[1] == datetime(2026, 3, 6, 7, 15, tzinfo=UTC)
    assert found[2] == datetime.fromtimestamp(1.0e9, UTC)
    assert changed == 1
    stated, changed = dates_of(paths[:1], ("2026-04-01",))
    assert (stated, changed) == ([datetime(2026, 4, 1, tzinfo=UTC)], 0)
    with pytest.raises(InputError, match="wanted one for each recording, got 1 for 3"):
        dates_of(paths, ("2026-04-01",))
    with pytest.raises(InputError, match=r"wanted one as 2026-03-01 .*, got 'soon'"):
        dates_of(paths[:1], ("soon",))
    copy = tmp_path / "walk.parquet"
    copy.write_bytes(recordings(folder)[0].read_bytes())
    assert call(copy, "--calibration", folder / "c.json", "--json") == 0
    assert "drift.learn_file_dates" in {item["code"] for item in json.loads(capsys.readouterr().out)["findings"]}


def test_what_is_refused_writes_nothing(folder, tmp_path, capsys):
    day, made = recordings(folder)[0], tmp_path / "c2.json"
    corrected = tmp_path / "corrected.parquet"
    assert run(["correct", str(day), "--calibration", str(folder / "c.json"), "-o", str(corrected)]) == 0
    capsys.readouterr()
    assert call(corrected, "--calibration", folder / "c.json", "-o", made) == 2
    assert "got a corrected record" in capsys.readouterr().err
    assert call(day, "--calibration", folder / "c.json", "-o", made, "--power-on-s", "-1") == 2
    assert "power-on-s: wanted 0 s or more" in capsys.readouterr().err
    assert call(day, "--calibration", folder / "c.json", "-o", tmp_path / "c2.txt") == 2
    assert "wanted a name ending in .json" in capsys.readouterr().err
    assert not made.exists()
