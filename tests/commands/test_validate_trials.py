"""``undrift validate FOLDER --trials trials.csv`` on files of three people in two tasks."""

import json
import re

import numpy as np
import pytest

from testkit.trc_text import trc
from undrift.frames import rotate
from undrift.io.formats import write_record
from undrift.io.store import write_calibration
from validation.test_levels import FULL, worn

CLUSTER = {  # body frame, m
    "l_psis": (0.0, 0.05, 0.0),
    "r_psis": (0.0, -0.05, 0.0),
    "l_asis": (0.15, 0.1, 0.02),
    "r_asis": (0.15, -0.1, -0.02),
}


def write_trial(folder, person, task, record, reference):
    """Write a recording and its markers, z up; return the names of both files."""
    centre = np.zeros((len(reference.time), 3)) if reference.position is None else reference.position
    points = np.stack([centre + rotate(reference.q_nb, np.array([at])) for at in CLUSTER.values()], axis=1)
    names = f"data/{person}/imu_{task}.parquet", f"data/{person}/optics_{task}.trc"
    (folder / names[0]).parent.mkdir(parents=True, exist_ok=True)
    write_record(record, folder / names[0])
    text = trc(points, list(CLUSTER), rate=reference.sample_rate_hz, first=float(reference.time[0]))
    (folder / names[1]).write_bytes(text.encode())
    return names


HEADS = "recording,reference,person,task,device,reference_up,markers,calibration"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("people")
    write_calibration(FULL, folder / "a.json")
    rows = [HEADS]
    for person in range(3):
        for task, name in (("sit_to_stand", "chairrise"), ("step", "step")):
            files = write_trial(folder, f"pp00{person + 1}", name, *worn(person, task))
            rows.append(f'{files[0]},{files[1]},pp00{person + 1},{name},A,z,"{",".join(CLUSTER)}",a.json')
    (folder / "trials.csv").write_text("\n".join(rows) + "\n")
    return folder


def test_people_by_tasks_from_files_to_a_page(undrift, folder, tmp_path):
    answer = undrift.good("validate", folder, "--trials", "trials.csv", "-o", tmp_path / "out", "--json").data()
    assert [trial["person"] for trial in answer["trials"]] == ["pp001", "pp001", "pp002", "pp002", "pp003", "pp003"]
    rows = {(row["group"], row["level"], row["method"]): row for row in answer["summaries"]}
    assert rows["all", "rest", "strapdown"]["mean_deg"] < 0.3
    assert rows["all", "rest", "vqf"]["people"] == 3
    assert {row["group"] for row in answer["summaries"]} == {"all", "chairrise", "step"}
    page = (tmp_path / "out" / "report.html").read_text()
    assert "Agreement with the optics" not in page  # three people
    assert json.loads((tmp_path / "out" / "levels.json").read_text())["data"]["quantity"] == answer["quantity"]


@pytest.mark.parametrize(
    ("changed", "refused"),
    [
        (("person,", "who,"), "expected columns recording, person, task, device, and of"),
        (("pp002,chairrise", ",chairrise"), "person is missing in line 4"),
        (("imu_step.parquet", "imu_walk.parquet"), r"pp001/imu_walk.parquet: "),
        (("a.json\n", "\n"), "expected a calibration in every row of device A or in none, got 5 of 6"),
        (
            ("pp001/imu_step.parquet", "pp001/imu_chairrise.parquet"),
            r"expected each recording once, got .*chairrise.parquet in several",
        ),
    ],
)
def test_a_table_that_does_not_fit_is_one_line_and_nothing_is_written(undrift, folder, tmp_path, changed, refused):
    (folder / "changed.csv").write_text((folder / "trials.csv").read_text().replace(*changed, 1))
    said = undrift.refused("validate", folder, "--trials", "changed.csv", "-o", tmp_path / "out")
    assert re.search(refused, said), said
    assert not (tmp_path / "out").exists()


def test_trials_need_one_folder_with_the_table(undrift, folder, tmp_path):
    for words, said in (
        (sorted(folder.glob("data/pp001/imu_*.parquet")), "got 2 paths"),
        ([tmp_path], "there is no"),
        ([folder, "--offset", "none"], "cannot be combined"),
        ([folder, "--calibration", folder / "a.json"], "cannot be combined"),
    ):
        assert said in undrift.refused("validate", *words, "--trials", "trials.csv")
