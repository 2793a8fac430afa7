"""undrift sync: recordings of several devices on one clock, or a finding where they share too little motion."""

import numpy as np
import pytest

import undrift as package
from testkit.command_line import contents
from testkit.data import data_path
from testkit.hand_turns import Device, later, make_recording
from undrift.commands.sync import sync
from undrift.io.formats import read_record, read_reference, write_record
from undrift.io.reference import write_reference

OFFSET_S = 4.25


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Two sensors and optics of one motion on clocks of their own, the second torn; and a recording of another one."""
    folder = tmp_path_factory.mktemp("sync")
    first, reference = make_recording(np.random.default_rng(4), Device(noise=2e-3), turn_s=25.0)
    other, _ = make_recording(
        np.random.default_rng(4), Device(noise=2e-3, forward=np.array([[0, 0, 1.0], [1, 0, 0], [0, 1, 0]])), turn_s=25.0
    )
    part = (other.time < 20.0) | (other.time > 20.7)
    torn = type(other)(time=other.time[part] * (1.0 + 5e-5) + OFFSET_S, gyro=other.gyro[part], accel=other.accel[part])
    strange, _ = make_recording(np.random.default_rng(5), turn_s=25.0)
    for name, record in {"pelvis": first, "thigh": torn, "strange": strange}.items():
        write_record(record, folder / f"{name}.csv")
    write_reference(later(reference, -2.0), folder / "optics.csv")
    return folder


@pytest.mark.slow
def test_several_recordings_and_optics_come_on_the_first_ones_clock_with_gaps_where_rows_are_missing(
    undrift, files, tmp_path
):
    words = ("sync", files / "pelvis.csv", files / "thigh.csv", "--reference", files / "optics.csv")
    answer = undrift.good(*words, "-o", tmp_path / "synced", "--report", tmp_path / "sync.html")
    assert answer.out.startswith("On the clock of pelvis.csv: 2 of 2 others, within 0.")
    assert "verdict: good" in answer.out
    assert set(contents(tmp_path / "synced")) == {"pelvis.parquet", "thigh.parquet", "optics.parquet"}
    told = undrift.good(*words, "--json").json()
    assert told["kind"] == "undrift.sync"
    first, thigh, optics = told["recordings"]
    assert (first["synced"], "offset_s" in first, first["gaps"]) == (True, False, 0)
    assert thigh["offset_s"] == pytest.approx(OFFSET_S + 5e-5 * thigh["at_s"], abs=thigh["expanded_uncertainty_s"])
    assert thigh["skew_ppm"] == pytest.approx(50.0, abs=2.0 * thigh["skew_expanded_uncertainty_ppm"])
    assert optics["offset_s"] == pytest.approx(-2.0, abs=optics["expanded_uncertainty_s"])
    assert max(thigh["expanded_uncertainty_s"], optics["expanded_uncertainty_s"]) < 1e-3
    aligned, pelvis = (read_record(tmp_path / "synced" / f"{name}.parquet") for name in ("thigh", "pelvis"))
    missing = np.isnan(aligned.gyro).any(axis=1)
    assert missing.sum() == thigh["gaps"] == 141  # 0.7 s at 200 Hz, both ends
    assert aligned.time[missing][[0, -1]] == pytest.approx((20.0, 20.7), abs=0.006)
    same = np.interp(pelvis.time[2000:3900], aligned.time, np.nan_to_num(aligned.gyro[:, 0]))
    assert np.corrcoef(same, pelvis.gyro[2000:3900, 2])[0, 1] > 0.999
    poses = read_reference(tmp_path / "synced" / "optics.parquet")
    assert poses.time[0] == pytest.approx(0.0, abs=1e-3)
    page = (tmp_path / "sync.html").read_text()
    assert "thigh" in page
    assert page.count("<svg") == 1


@pytest.mark.slow
def test_a_recording_of_another_motion_is_a_finding_and_no_lag(undrift, files, tmp_path):
    words = ("sync", files / "pelvis.csv", files / "strange.csv", files / "thigh.csv")
    answer = undrift(*words, "-o", tmp_path / "synced")
    assert (answer.code, answer.err) == (1, "")
    assert "strange.csv shares too little motion for a clock" in answer.out
    assert "On the clock of pelvis.csv: 1 of 2 others" in answer.out
    assert set(contents(tmp_path / "synced")) == {"pelvis.parquet", "thigh.parquet"}
    told = undrift(*words, "--json").json()
    strange = told["recordings"][1]
    assert (strange["synced"], strange["output"]) == (False, None)
    assert strange.keys().isdisjoint({"offset_s", "skew_ppm", "expanded_uncertainty_s", "at_s"})
    assert [item["code"] for item in told["findings"]] == ["sync.not_shared"]


@pytest.mark.slow
def test_a_recording_that_shares_its_motion_with_the_second_alone_comes_through_it(undrift, tmp_path):
    (first, _), (last, _) = (
        make_recording(np.random.default_rng(seed), Device(noise=1e-3), turn_s=25.0) for seed in (6, 7)
    )
    gyro, accel = (np.concatenate((getattr(first, key), getattr(last, key))) for key in ("gyro", "accel"))
    whole = type(first)(time=np.arange(len(gyro)) / 200.0, gyro=gyro, accel=accel)
    for name, record in {"first": first, "middle": whole, "last": last}.items():
        write_record(record, tmp_path / f"{name}.csv")
    told = undrift.good("sync", *(tmp_path / f"{name}.csv" for name in ("first", "last", "middle")), "--json").json()
    rows = {row["recording"].rpartition("/")[2]: row for row in told["recordings"]}
    assert rows["last.csv"]["through"] == "middle.csv"
    assert rows["last.csv"]["start_s"] == pytest.approx(first.time[-1] + 0.005, abs=1e-3)
    assert rows["last.csv"]["expanded_uncertainty_s"] > rows["middle.csv"]["expanded_uncertainty_s"]


def test_python_takes_names_one_by_one_or_in_a_list_and_the_module_stays_one(files):
    names = [str(files / f"{name}.csv") for name in ("pelvis", "thigh")]
    found = package.sync(names)
    assert len(found.records) == len(package.sync(*names).records) == 2
    assert found.files[1].clock.offset_s == pytest.approx(OFFSET_S, abs=0.01)
    assert "On the clock of pelvis.csv" in repr(found)
    from undrift.sync import find_lag, shared_motion

    assert package.sync.find_lag is find_lag
    assert package.sync.shared_motion is shared_motion
    assert package.sync is not sync


@pytest.mark.slow
def test_foam_is_said_to_move_on_its_own(undrift, tmp_path):
    rigid, soft = (data_path("chain_with_optics", f"seg2_trial1_{name}.csv.gz") for name in ("imu", "imu_soft"))
    undrift.good("info", rigid, "--write-map", tmp_path / "map.toml")
    answer = undrift.good("sync", rigid, soft, "--map", tmp_path / "map.toml")
    assert "verdict: marginal" in answer.out
    assert "The clock of seg2_trial1_imu_soft.csv.gz is uncertain by 6" in answer.out


def test_what_sync_refuses(undrift, files, tmp_path):
    alone = undrift.refused("sync", files / "pelvis.csv")
    assert "wanted two recordings or more, got 1; name those of one motion" in alone
    still, _ = make_recording(np.random.default_rng(5), turn_s=5.0)
    write_record(type(still)(time=still.time, gyro=0.0 * still.gyro), tmp_path / "still.csv")
    assert "wanted two recordings that turn together" in undrift.refused(
        "sync", files / "pelvis.csv", tmp_path / "still.csv", "-o", tmp_path / "out"
    )
    assert not (tmp_path / "out").exists()
    write_record(still, tmp_path / "pelvis.csv")
    assert "another name for each recording" in undrift.refused(
        "sync", files / "pelvis.csv", tmp_path / "pelvis.csv", "-o", tmp_path / "out"
    )
    assert "undrift's own" not in undrift.refused("sync", files / "pelvis.csv", tmp_path / "none.csv")
