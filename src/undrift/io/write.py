"""What a record and an orientation are written as, by the ending of the name: undrift's own tables and those of other programs.

=================  ==================================  ==============================================================
ending             record                              orientation
=================  ==================================  ==============================================================
.parquet           every bit, frame, state, device     time, quaternion, angles
.csv, .csv.gz      plain table; NAME.csv.json beside   the same
.mat               MATLAB 5, a variable for a column   the same
_motion.tsv        BIDS motion [1]_, three files       ORNT channels
.sto                                                   OpenSense [2]_: a column for a sensor, cells w,x,y,z
=================  ==================================  ==============================================================

.. [1] Brain Imaging Data Structure 1.11, modality "motion": bids-specification.readthedocs.io
.. [2] "OpenSense - Kinematics with IMU Data", OpenSim documentation: opensimconfluence.atlassian.net
"""

import io
import json
import re
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError
from undrift.files import write_together, write_whole
from undrift.io.arrays import digest_of
from undrift.io.columns import native_columns
from undrift.io.parquet import write_parquet
from undrift.io.text import Provenance, sidecar_of, statement_of, write_csv, write_rows
from undrift.record import Record, sample_rate_of
from undrift.units import RADIAN_PER_DEGREE

COLUMNS = ("time_s", "q_w", "q_x", "q_y", "q_z", "inclination_deg", "heading_deg", "pitch_deg")
Columns = tuple[Sequence[str], Sequence[FloatArray]]  # names, and a column (N,) for each


def write_record_as(record: Record, path: Path, made_by: Provenance | None = None) -> None:
    """Write a record in the format that the ending of the name stands for."""
    _writer(path, RECORD_WRITERS)(record, path, made_by or {})


def write_orientation(
    time: FloatArray,
    q_nb: FloatArray,
    angles: tuple[FloatArray, FloatArray, FloatArray],
    path: str | Path,
    *,
    body: str = "sensor",
) -> None:
    """Write orientation over time; undrift reads the quaternions of its own tables back as a reference.
    time (N,) s, q_nb (N, 4), three angles (N,) rad; the sensor's name heads its column in .sto and its channels in BIDS."""
    values = (time, *q_nb.T, *(angle / RADIAN_PER_DEGREE for angle in angles))
    _writer(Path(path), ORIENTATION_WRITERS)((COLUMNS, values), Path(path), body)


def files_of(path: Path) -> tuple[Path, ...]:
    """Return the files that writing under a name makes, the named one first."""
    if path.name.lower().endswith(BIDS):
        _entities(path)
        stem = path.name.removesuffix(BIDS)
        return path, *(path.with_name(stem + end) for end in ("_motion.json", "_channels.tsv", "_channels.json"))
    return (path, sidecar_of(path)) if path.name.lower().endswith((".csv", ".csv.gz")) else (path,)


def _writer(path: Path, writers: Mapping[str, Callable[..., None]]) -> Callable[..., None]:
    for ending, write in writers.items():
        if path.name.lower().endswith(ending):
            return write
    *most, last = writers
    raise InputError(f"{path}: wanted a name ending in {', '.join(most)} or {last}, got another; name the format so")


# ---- own tables


def _orientation_parquet(table: Columns, path: Path, _: str) -> None:
    import pyarrow as pa
    from pyarrow import parquet

    buffer = io.BytesIO()
    parquet.write_table(pa.table(dict(zip(*table, strict=True))), buffer)
    write_whole(path, buffer.getvalue())


# ---- MATLAB


def _record_mat(record: Record, path: Path, made_by: Provenance) -> None:
    names, columns = native_columns(record)
    _write_mat((names, columns), path, json.dumps(statement_of(record, path, names) | {"provenance": made_by}))


def _write_mat(table: Columns, path: Path, statement: str = "") -> None:
    """Write each column as a variable (N, 1) of its name, and the statement as the text ``undrift``."""
    from scipy.io import savemat

    held: dict[str, Any] = {name: np.reshape(column, (-1, 1)) for name, column in zip(*table, strict=True)}
    mark = {"undrift": statement, "undrift_sha256": digest_of(statement, held)} if statement else {}
    buffer: Any = io.BytesIO()
    savemat(buffer, held | mark)
    write_whole(path, buffer.getvalue())


# ---- OpenSense


def _orientation_sto(table: Columns, path: Path, body: str) -> None:
    """Write the quaternions, scalar first; OpenSense looks for a column BODY_imu and for a level frame with z up (see docs)."""
    time, *q = table[1][:5]
    if not re.fullmatch(r"\w+", body):
        raise InputError(f"`body`: wanted letters, digits and _ for a column of {path}, got '{body}'; name a body")
    head = (
        f"DataRate={sample_rate_of(time):.6f}", "DataType=Quaternion", "version=3", "OpenSimVersion=4.5", "endheader",
        f"time\t{body.removesuffix('_imu')}_imu",
    )  # fmt: skip
    rows = (f"{t:.9g}\t{w:.12g},{x:.12g},{y:.12g},{z:.12g}" for t, w, x, y, z in zip(time, *q, strict=True))
    write_whole(path, "\n".join((*head, *rows)) + "\n")


# ---- BIDS motion: a table without a header, what its columns are, and what the recording is

BIDS = "_motion.tsv"
_NAME = re.compile(
    r"sub-[0-9A-Za-z]+(_ses-[0-9A-Za-z]+)?_task-(?P<task>[0-9A-Za-z]+)_tracksys-(?P<system>[0-9A-Za-z]+)"
    r"(_acq-[0-9A-Za-z]+)?(_run-[0-9]+)?_motion\.tsv"
)
_TYPES = {"time": "LATENCY", "gyro": "GYRO", "accel": "ACCEL", "mag": "MAGN", "temp": "TEMP", "q": "ORNT"}
_COUNTED = ("ACCEL", "GYRO", "MAGN", "ORNT", "LATENCY")  # types with a count of their own in motion.json
_UNITS = {
    "rad_s": "rad/s",
    "dps": "deg/s",
    "m_s2": "m/s^2",
    "g": "g",
    "mg": "mg",
    "ut": "uT",
    "c": "oC",
    "s": "s",
    "v": "V",
}
_FRAMES = {
    "sensor": "the sensor's own axes: they move with the body",
    "case": "the axes of the device's case: they move with the body",
    "level": "z up, heading from the start of the recording; quaternions turn the device's case to it",
}


def _record_bids(record: Record, path: Path, made_by: Provenance) -> None:
    names, columns = native_columns(record)
    channels = [_channel(name, "case" if record.frame == "b" else "sensor") for name in names]
    point = record.device or "sensor"
    more = {"DeviceSerialNumber": record.device} if record.device else {}
    _write_bids(channels, columns, path, point, more | {"UndriftProvenance": made_by} if made_by else more)


def _orientation_bids(table: Columns, path: Path, body: str) -> None:
    names, columns = table
    _write_bids([_channel(name, "level") for name in names[:5]], columns[:5], path, body, {})


def _channel(name: str, frame: str) -> dict[str, str]:
    """Return the row of channels.tsv of a column: gyro_x_rad_s, temp_c, q_w."""
    kind, _, rest = name.partition("_")
    axis, _, suffix = rest.partition("_") if kind in ("gyro", "accel", "mag") else ("", "", rest)
    component = f"quat_{rest}" if kind == "q" else axis or "n/a"
    return {
        "name": name,
        "component": component,
        "type": _TYPES[kind],
        "tracked_point": "",
        "units": "n/a" if kind == "q" else _UNITS.get(suffix, "n/a"),
        "reference_frame": frame if component != "n/a" else "n/a",
    }


def _entities(path: Path) -> tuple[str, str]:
    """Return the task and the tracking system of a name of BIDS."""
    found = _NAME.fullmatch(path.name)
    if found is None:
        raise InputError(
            f"{path}: wanted a name of BIDS motion, got another; name it sub-01_task-walk_tracksys-imu_motion.tsv (letters and "
            "digits after each -; ses, acq and run have their places)"
        )
    return found["task"], found["system"]


def _write_bids(
    channels: list[dict[str, str]], columns: Sequence[FloatArray], path: Path, point: str, more: Mapping[str, object]
) -> None:
    task, system = _entities(path)
    time, types = columns[0], [row["type"] for row in channels]
    columns = (time - time[0], *columns[1:])  # latency counts from the first sample
    measured = sum(kind not in ("LATENCY", "TEMP") for kind in types)
    content = {
        "TaskName": task,
        "TrackingSystemName": system,
        "SamplingFrequency": round(sample_rate_of(time), 6),
        "SamplingFrequencyEffective": (len(time) - 1) / float(time[-1] - time[0]),
        "SoftwareVersions": f"undrift {version('undrift')}",
        "TrackedPointsCount": 1,
        "MotionChannelCount": measured,
        **{f"{kind}ChannelCount": types.count(kind) for kind in _COUNTED},
        "MissingValues": "n/a",
        **more,
    }
    rows = [row | {"tracked_point": point} for row in channels]
    used = {row["reference_frame"] for row in rows} - {"n/a"}
    levels = {
        name: {"Description": text, "RotationRule": "right-hand", "RotationOrder": "n/a"}
        for name, text in _FRAMES.items()
        if name in used
    }
    table = "\n".join("\t".join(row) for row in ((*rows[0],), *(tuple(row.values()) for row in rows)))
    _, described, listed, frames = files_of(path)
    every = zip(*(column.tolist() for column in columns), strict=True)
    cells = ("\t".join("n/a" if value != value else repr(value) for value in row) for row in every)  # NaN is a gap
    files = {
        listed: table,
        frames: json.dumps({"reference_frame": {"Levels": levels}}, indent=1),
        described: json.dumps(content, indent=1),
        path: "\n".join(cells),
    }
    write_together({name: text + "\n" for name, text in files.items()})


RECORD_WRITERS: dict[str, Callable[[Record, Path, Provenance], None]] = {
    ".parquet": lambda record, path, _: write_parquet(record, path),
    ".csv": write_csv,
    ".csv.gz": write_csv,
    ".mat": _record_mat,
    BIDS: _record_bids,
}
ORIENTATION_WRITERS: dict[str, Callable[[Columns, Path, str], None]] = {
    ".parquet": _orientation_parquet,
    ".csv": lambda table, path, _: write_rows(path, *table),
    ".csv.gz": lambda table, path, _: write_rows(path, *table),
    ".sto": _orientation_sto,
    ".mat": lambda table, path, _: _write_mat(table, path),
    BIDS: _orientation_bids,
}
