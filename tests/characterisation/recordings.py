"""The public recordings that calls share, opened as their SOURCE.md says; UNDRIFT_DATA names their folder."""

import csv
import json
from functools import cache

import numpy as np

from testkit.axis_lag import find_axis_lag
from testkit.data import data_path
from undrift.arrays import runs
from undrift.calibration.dwells import dwell_means
from undrift.io.mocap import read_broad
from undrift.record import Record, Reference, Session, Still, Turn
from undrift.units import STANDARD_GRAVITY

BICYCLE = (
    "phi_000_theta_000", "phi_000_theta_090", "phi_000_theta_180", "phi_000_theta_270", "phi_090_theta_000",
    "phi_270_theta_000", "reference", "rsidedown", "rsideup", "sahfd01", "sahfu01",
)  # fmt: skip
Ranges = dict[str, tuple[int, int]]


def nist_points() -> np.ndarray:
    """Return the 1000 points of NIST SP 1065, section 12.4."""
    n = [1234567890]
    for _ in range(999):
        n.append(16807 * n[-1] % 2147483647)
    return np.array(n) / 2147483647.0


def bicycle() -> Session:
    """Return eleven still recordings of a bicycle's MPU-6050."""
    records = []
    for name in BICYCLE:
        d = np.load(data_path("multipos_mpu6050_bicycle", f"{name}.npz"))
        records.append(
            Record(time=d["t_s"], gyro=d["gyro_rad_s"], accel=d["acc_raw"], accel_unit="count", temp_c=d["temp_degC"])
        )
    return Session(kind="calibration", serial="bicycle", gravity_m_s2=STANDARD_GRAVITY, records=tuple(records))


def foot_example() -> tuple[Record, Ranges]:
    """Return the example session of a foot sensor, in deg/s and m/s2."""
    d = np.loadtxt(data_path("ferraris_nilspod", "example_ferraris_session.csv"), delimiter=",", skiprows=1)
    record = Record(time=np.arange(len(d)) / 102.4, gyro=d[:, 1:4], accel=d[:, 4:7], gyro_unit="dps")
    ranges = json.loads(data_path("ferraris_nilspod", "example_ferraris_session_list.json").read_text())
    return record, {name: (part["start"], part["end"]) for name, part in ranges.items()}


def foot_annotated() -> tuple[Record, Ranges]:
    """Return the annotated session of a foot sensor, in counts."""
    with open(data_path("ferraris_nilspod", "annotated_session.csv")) as file:
        rows = list(csv.DictReader(file))
    part = np.array([row["part"] for row in rows])
    values = {s: np.array([[float(row[f"{s}_{a}"]) for a in "xyz"] for row in rows]) for s in ("acc", "gyr")}
    record = Record(
        time=np.arange(len(rows)) / 204.8,
        gyro=values["gyr"],
        accel=values["acc"],
        gyro_unit="count",
        accel_unit="count",
    )
    names = sorted(set(part.tolist()))
    return record, {n: (int(np.argmax(part == n)), int(np.argmax(part == n) + (part == n).sum())) for n in names}


def foot_pieces(ranges: Ranges, angle_deg: float) -> tuple[tuple[Still, ...], tuple[Turn, ...]]:
    """Return faces and turns of a foot sensor's session."""
    stills = tuple(
        Still(start=start, stop=stop, face=("+" if name[2] == "p" else "-") + name[0])  # type: ignore[arg-type]
        for name, (start, stop) in ranges.items()
        if not name.endswith("rot")
    )
    turns = tuple(
        Turn(start=start, stop=stop, axis=name[0], angle=np.radians(angle_deg))  # type: ignore[arg-type]
        for name, (start, stop) in ranges.items()
        if name.endswith("rot")
    )
    return stills, turns


def xsens() -> Record:
    """Return the published multi-position set, raw counts."""
    accel, gyro = (np.loadtxt(data_path("multipos_xsens", f"xsens_{what}.txt.gz")) for what in ("acc", "gyro"))
    return Record(time=accel[:, 0], accel=accel[:, 1:], gyro=gyro[:, 1:], accel_unit="count", gyro_unit="count")


def jig_lag(run: str) -> float:
    """Return how late the sensor of a public rate table is, s."""
    d = np.load(data_path("ratetable_jig", f"{run}.npz"))
    record = Record(time=d["t_imu"], gyro=d["gyro_bno_dps"], gyro_unit="dps")
    return find_axis_lag(record, d["t_jig"], np.radians(d["top_angle_deg"].astype(float))).seconds


def jig_dwells(run: str, lag: float):
    """Return mean readings at the rates that a public rate table achieved."""
    d = np.load(data_path("ratetable_jig", f"{run}.npz"))
    record = Record(time=d["t_imu"], gyro=d["gyro_bno_dps"], gyro_unit="dps")
    time, angle = d["t_jig"], np.radians(d["top_angle_deg"].astype(float))
    rate = np.gradient(angle, time)
    turns = []
    for commanded in np.radians(d["cmd_top_speed_dps"].astype(float)):
        steady = runs(np.abs(rate - commanded) < 0.01 * abs(commanded) + 0.01)
        first, last = steady[np.argmax(steady[:, 1] - steady[:, 0])]
        start, stop = time[first] + 1.0, time[last - 1] - 1.0
        inside = (time >= start) & (time < stop)
        achieved = np.polyfit(time[inside], angle[inside], 1)[0]
        begin, end = np.searchsorted(record.time, (start + lag, stop + lag))
        turns.append(Turn(start=int(begin), stop=int(end), axis="y", turn_rate=-float(achieved)))
    return dwell_means([record], turns)


@cache
def broad(number: int) -> tuple[Record, Reference]:
    """Return record and reference of a BROAD trial."""
    return read_broad(next(data_path("broad").glob(f"{number:02d}_*.hdf5")))


def broad_beginning(number: int, stop_s: float) -> tuple[Record, Reference]:
    """Return the beginning of a BROAD trial."""
    record, reference = broad(number)
    keep = reference.time < stop_s
    return record.between(0.0, stop_s), Reference(
        time=reference.time[keep],
        q_nb=reference.q_nb[keep],
        position=None if reference.position is None else reference.position[keep],
        moving=None if reference.moving is None else reference.moving[keep],
    )
