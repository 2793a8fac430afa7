"""Records and orientations in the files of undrift and of other programs, each judged by a reader that is not its writer's."""

import gzip
import json
import re

import numpy as np
import pytest

from testkit.strategies import assert_same, one_line
from undrift.errors import FileFormatError, InputError
from undrift.io.formats import read_record, read_reference, write_record
from undrift.io.write import COLUMNS, write_orientation
from undrift.record import Record


def orientation(n=50, seed=0):
    rng = np.random.default_rng(seed)
    q = rng.normal(size=(n, 4))
    q /= np.linalg.norm(q, axis=1)[:, None]
    angles = tuple(rng.uniform(-np.pi, np.pi, n) for _ in range(3))
    return np.arange(n) / 100.0 + 7.0, q, angles


@pytest.mark.parametrize("name", ["a.parquet", "a.csv", "a.csv.gz", "A.CSV", "a.mat"])
def test_quaternions_come_back_as_a_reference(tmp_path, name):
    time, q, angles = orientation()
    write_orientation(time, q, angles, tmp_path / name)
    back = read_reference(tmp_path / name)
    np.testing.assert_array_equal(back.time, time)
    # the reader takes the length to one: a rounding error each
    np.testing.assert_allclose(np.sum(back.q_nb * q, axis=1) ** 2, 1.0, atol=1e-14)
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_angles_are_in_degrees_under_their_names(tmp_path):
    time, q, angles = orientation()
    write_orientation(time, q, angles, tmp_path / "a.csv.gz")
    lines = gzip.decompress((tmp_path / "a.csv.gz").read_bytes()).decode().splitlines()
    assert lines[0].replace('"', "") == ",".join(COLUMNS)
    table = np.array([[float(cell) for cell in line.split(",")] for line in lines[1:]])
    for k, angle in enumerate(angles):
        np.testing.assert_allclose(table[:, 5 + k], np.degrees(angle), rtol=1e-15)


def test_a_pitch_with_gaps_is_an_empty_or_nan_cell_and_the_poses_still_read(tmp_path):
    time, q, angles = orientation()
    pitch = angles[2].copy()
    pitch[10:20] = np.nan
    write_orientation(time, q, (angles[0], angles[1], pitch), tmp_path / "a.csv")
    cells = [line.split(",")[-1] for line in (tmp_path / "a.csv").read_text().splitlines()[1:]]
    assert all(cell in ("", "nan") for cell in cells[10:20])
    assert read_reference(tmp_path / "a.csv").valid.all()


def test_another_ending_and_a_folder_that_is_not_there_are_refused(tmp_path):
    time, q, angles = orientation()
    with pytest.raises(InputError) as error:
        write_orientation(time, q, angles, tmp_path / "a.xlsx")
    assert "wanted a name ending in .parquet, .csv, .csv.gz, .sto, .mat or _motion.tsv, got another" in one_line(error)
    with pytest.raises(InputError) as error:
        write_orientation(time, q, angles, tmp_path / "none" / "a.csv")
    assert "wanted a folder to write to" in one_line(error)
    assert list(tmp_path.iterdir()) == []


def test_an_older_table_stays_where_the_new_one_cannot_be_finished(tmp_path, monkeypatch):
    from pathlib import Path

    time, q, angles = orientation()
    (tmp_path / "a.csv").write_text("older")

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "replace", full)
    with pytest.raises(InputError, match=r"a\.csv: wanted room for \d+ bytes more on the disk"):
        write_orientation(time, q, angles, tmp_path / "a.csv")
    assert (tmp_path / "a.csv").read_text() == "older"
    assert [path.name for path in tmp_path.iterdir()] == ["a.csv"]


# ---- other programs


def recording(n=40, *, gaps=False):
    rng = np.random.default_rng(5)
    gyro = rng.normal(size=(n, 3))
    if gaps:
        gyro[3:6, 1] = np.nan
    return Record(
        time=np.arange(n) / 50.0 + 3.0,
        gyro=gyro,
        accel=rng.normal(size=(n, 3)),
        mag_ut=rng.normal(size=(n, 3)),
        temp_c=np.full(n, 25.0),
        frame="b",
        state="corrected",
        device="MTi-1",
    )


def test_a_mat_file_holds_a_variable_for_each_column_as_scipy_reads_it_and_comes_back(tmp_path):
    from scipy.io import loadmat

    record = recording()
    write_record(record, tmp_path / "r.mat")
    held = loadmat(tmp_path / "r.mat")
    assert held["gyro_y_rad_s"].shape == (40, 1)
    np.testing.assert_array_equal(held["gyro_y_rad_s"][:, 0], record.gyro[:, 1])
    assert json.loads(held["undrift"][0])["state"] == "corrected"
    assert_same(read_record(tmp_path / "r.mat"), record)


def test_a_mat_file_of_undrift_with_a_broken_statement_is_refused(tmp_path):
    from scipy.io import savemat

    columns = {name: np.zeros((3, 1)) for name in ("gyro_x_dps", "gyro_y_dps", "gyro_z_dps")}
    savemat(tmp_path / "r.mat", {"time_s": np.arange(3.0)[:, None], **columns, "undrift": "no json"})
    with pytest.raises(FileFormatError, match="wanted frame, state and device in 'undrift', got others"):
        read_record(tmp_path / "r.mat")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["r.parquet", "r.mat"])
def test_a_flipped_bit_in_a_file_of_undrift_is_refused_or_changes_nothing(tmp_path, name):
    rng = np.random.default_rng(16)
    record = Record(
        time=np.arange(60) / 100.0, gyro=rng.normal(size=(60, 3)), accel=rng.normal(size=(60, 3)), device="A7"
    )
    path = tmp_path / name
    write_record(record, path)
    whole, refused = path.read_bytes(), 0
    for place in rng.integers(8 * len(whole), size=40):
        changed = bytearray(whole)
        changed[place // 8] ^= 1 << (place % 8)
        path.write_bytes(changed)
        try:
            assert_same(read_record(path), record)
        except InputError:
            refused += 1
    assert refused >= 20


def test_opensense_gets_a_header_a_named_column_and_quaternions_scalar_first(tmp_path):
    """The header and the cells as in the example of "OpenSense - Kinematics with IMU Data", OpenSim documentation, read 2026-11."""
    time, q, angles = orientation()
    write_orientation(time, q, angles, tmp_path / "o.sto", body="pelvis")
    head, _, body = (tmp_path / "o.sto").read_text().partition("endheader\n")
    keys = dict(line.split("=") for line in head.splitlines())
    assert float(keys["DataRate"]) == 100.0  # Hz
    assert (keys["DataType"], keys["version"]) == ("Quaternion", "3")
    names, *rows = body.splitlines()
    assert names == "time\tpelvis_imu"
    table = np.array([[float(cell) for cell in re.split("[\t,]", row)] for row in rows])
    np.testing.assert_allclose(table[:, 0], time, rtol=1e-8)  # nine digits are written
    np.testing.assert_allclose(table[:, 1:], q, atol=1e-11)  # twelve digits are written


def test_a_name_that_opensense_cannot_have_as_a_column_is_refused(tmp_path):
    with pytest.raises(InputError, match="wanted letters, digits and _ for a column"):
        write_orientation(*orientation(), tmp_path / "o.sto", body="my pelvis")
    assert list(tmp_path.iterdir()) == []


NAME = "sub-01_task-walk_tracksys-imu_motion.tsv"


@pytest.fixture(scope="module")
def bids():
    """The machine-readable BIDS specification, as the package bidsschematools holds it (CC BY 4.0)."""
    schema = pytest.importorskip("bidsschematools.schema")
    return schema.load_schema()


def assert_bids(bids, folder, name=NAME):
    """Judge the files of a recording by the rules of the BIDS schema; return what they hold."""
    stem, rules = name.removesuffix("_motion.tsv"), bids.rules
    names = {path.name for path in folder.iterdir()}
    assert names == {name, *(stem + end for end in ("_motion.json", "_channels.tsv", "_channels.json"))}
    file = rules.files.raw.motion.motion
    entities = [part.partition("-")[0] for part in stem.split("_")]
    short = {bids.objects.entities[long].name: (long, need) for long, need in file.entities.items()}
    assert set(entities) >= {key for key, (_, need) in short.items() if need == "required"}
    order = [key for key in rules.entities if key in file.entities]
    assert [short[key][0] for key in entities] == [key for key in order if key in {short[e][0] for e in entities}]
    described = json.loads((folder / f"{stem}_motion.json").read_text())
    for group in rules.sidecars.motion.values():
        for key, need in group.fields.items():
            need = need if isinstance(need, str) else need["level"]
            assert key in described or need != "required", key
            if key in described:
                kind = bids.objects.metadata[key]["type"]
                assert isinstance(described[key], {"string": str, "number": int | float, "integer": int}[kind]), key
    rule = rules.tabular_data.motion.motionChannels
    heads, *rows = [line.split("\t") for line in (folder / f"{stem}_channels.tsv").read_text().splitlines()]
    column = {key: bids.objects.columns[key] for key in rule.columns}
    assert heads[: len(rule.initial_columns)] == [column[key].name for key in rule.initial_columns]
    by_name = {column[key].name: column[key] for key in rule.columns}
    assert set(heads) <= set(by_name)
    channels = [dict(zip(heads, row, strict=True)) for row in rows]
    for channel in channels:
        for head, cell in channel.items():
            assert cell
            assert cell == "n/a" or cell in by_name[head].get("enum", [cell]), (head, cell)
    levels = json.loads((folder / f"{stem}_channels.json").read_text())["reference_frame"]["Levels"]
    assert {channel["reference_frame"] for channel in channels} - {"n/a"} == set(levels)
    for level in levels.values():
        for key in ("RotationRule", "RotationOrder"):
            assert level[key] in bids.objects.metadata[key].enum
    lines = [line.split("\t") for line in (folder / name).read_text().splitlines()]
    assert {len(line) for line in lines} == {len(channels)}
    return described, channels, lines


def test_a_record_in_bids_keeps_the_rules_of_the_schema(tmp_path, bids):
    record = recording(gaps=True)
    write_record(record, tmp_path / NAME)
    described, channels, lines = assert_bids(bids, tmp_path)
    assert (described["TaskName"], described["SamplingFrequency"]) == ("walk", 50.0)
    assert (described["GYROChannelCount"], described["ACCELChannelCount"], described["MAGNChannelCount"]) == (3, 3, 3)
    assert [channel["type"] for channel in channels].count("GYRO") == 3
    assert channels[1] == {
        "name": "gyro_x_rad_s",
        "component": "x",
        "type": "GYRO",
        "tracked_point": "MTi-1",
        "units": "rad/s",
        "reference_frame": "case",
    }
    assert [line[2] for line in lines[2:7]] == [str(record.gyro[2, 1]), "n/a", "n/a", "n/a", str(record.gyro[6, 1])]
    values = np.array([[float(line[0]), float(line[1])] for line in lines])  # no header: the first line is a sample
    np.testing.assert_allclose(values[:, 0], np.arange(40) / 50.0, atol=1e-12)  # s from the first sample
    np.testing.assert_array_equal(values[:, 1], record.gyro[:, 0])


def test_an_orientation_in_bids_keeps_the_rules_of_the_schema(tmp_path, bids):
    time, q, angles = orientation()
    write_orientation(time, q, angles, tmp_path / NAME, body="LowerBack")
    described, channels, lines = assert_bids(bids, tmp_path)
    assert described["ORNTChannelCount"] == 4
    assert [channel["component"] for channel in channels] == ["n/a", "quat_w", "quat_x", "quat_y", "quat_z"]
    assert {channel["tracked_point"] for channel in channels} == {"LowerBack"}
    np.testing.assert_array_equal([[float(cell) for cell in line[1:]] for line in lines], q)


@pytest.mark.parametrize(
    "name", ["walk_motion.tsv", "task-walk_sub-01_tracksys-imu_motion.tsv", "sub-01_task-walk_motion.tsv"]
)
def test_a_name_that_is_not_of_bids_is_refused_and_nothing_is_written(tmp_path, name):
    with pytest.raises(InputError, match="wanted a name of BIDS motion, got another"):
        write_record(recording(), tmp_path / name)
    assert list(tmp_path.iterdir()) == []
