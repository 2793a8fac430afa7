"""``undrift orient``: compute the orientation of a recording as quaternions, inclination, heading and pitch."""

from pathlib import Path
from typing import Literal

import numpy as np

from undrift.base.options import Flag, Output, Side
from undrift.commands.batch import each_recording
from undrift.commands.files import NamedRest, Opening, Reader, named_columns
from undrift.commands.outputs import check_output
from undrift.findings import two_digits
from undrift.io.write import ORIENTATION_WRITERS, files_of, write_orientation
from undrift.orientation import Orientation, OrientSettings, magnetometer_not_calibrated
from undrift.orientation import orient as find_orientation
from undrift.report import Report, Table
from undrift.report.figures import draw_orientation
from undrift.screen import progress, reading
from undrift.units import RADIAN_PER_DEGREE


@each_recording(".parquet")
def orient(
    recording: Path,
    /,
    *,
    output: Output,
    calibration: Path | None = None,
    method: Literal["strapdown", "vqf"] = "strapdown",
    magnetometer: Flag = False,
    offset: Literal["none", "rest", "motion"] = "none",
    rest: NamedRest = NamedRest(),
    forward: Side | None = None,
    up: Side | None = None,
    opening: Opening = Opening(),
) -> Report:
    """Compute orientation over time: quaternions, inclination, heading and pitch.

    Parameters
    ----------
    recording : Path
        A corrected recording, or a raw recording with its calibration. For several recordings, or a folder of them,
        the output is a folder.
    output : Path
        File for time, quaternion and angles (.parquet, .csv or .csv.gz), or for quaternions (.sto, OpenSense).
    calibration : Path or None
        calibration.json of the device, for a raw recording. In a folder of calibrations, the newest file with its
        serial number is used.
    method : str
        strapdown, or vqf: a filter that computes the inclination from the accelerometers and tracks the offset, over the whole
        recording.
    magnetometer : bool
        With vqf, also use the magnetic field. Heading is then relative to magnetic east.
    offset : str
        "rest" subtracts the mean rate of the first (or the named) still phase. "motion" starts from that rest, if there
        is one, and estimates the offset from gravity while the device moves.
    forward : str or None
        Device axis that points forward on the upright segment. With `up`, this axis defines the pitch. Without both, the axes are
        +x and +z. If the calibration has a mounting, they are the axes of the segment, and orientation and angles refer to the
        segment.
    up : str or None
        Device axis that points up on the upright segment.
    """
    reads = (recording, calibration, opening.column_map)
    check_output(output, endings=tuple(ORIENTATION_WRITERS), reads=reads, beside=files_of(output)[1:])
    reader = Reader(opening, calibration, (recording,))
    model = reader.model
    with reading(0.4, recording):
        record = reader.read(recording)
    progress("integrating", 0.4)
    settings = OrientSettings(
        method=method, magnetometer=magnetometer, offset=offset, forward=forward or "+x",
        up=up or "+z", mounting=reader.mounting(forward, up),
    )  # fmt: skip
    record = reader.corrected(record, recording)
    if magnetometer and model is not None and model.magnetometer is None:
        reader.findings.append(magnetometer_not_calibrated())
    with named_columns(recording):
        gyro_model = None if model is None else model.gyro
        orientation = find_orientation(record, rest.still_in(record), settings, gyro_model=gyro_model)
    angles = (orientation.inclination, orientation.heading, orientation.pitch)
    write_orientation(orientation.time, orientation.q_nb, angles, output)
    if worn := settings.mounting:
        degrees = worn.uncertainty / RADIAN_PER_DEGREE
        reader.notes.append(
            f"The pitch refers to the {worn.place}. The calibration's mounting is uncertain by {degrees:.1f} deg "
            f"({worn.basis})."
        )
    return Report(
        title=f"Orientation of {recording.name}",
        answer=_answer(orientation),
        tables=[_angles(orientation)],
        details=[_tilt(orientation)],
        notes=reader.notes,
        findings=[*reader.findings, *orientation.findings],
        figures=[lambda: draw_orientation(orientation)],
        written=[output],
        data={
            "samples": len(orientation.time),
            "still_s": _still_s(orientation),
            "tilt_basis": orientation.tilt.basis,
            "offset_dps": orientation.offset / RADIAN_PER_DEGREE,
        },
    )


def _answer(orientation: Orientation) -> str:
    """Return the range of the pitch, and its 95 % limit at the least certain sample."""
    low, high = np.array([np.nanmin(orientation.pitch), np.nanmax(orientation.pitch)]) / RADIAN_PER_DEGREE
    text = f"The sagittal pitch ranges from {low:.1f} to {high:.1f} deg."
    limit = orientation.pitch_limit
    if limit is None or not np.isfinite(limit).any():
        return text
    worst, anchor = int(np.nanargmax(limit)), 0 if orientation.still is None else orientation.still.stop - 1
    after_s = abs(orientation.time[worst] - orientation.time[anchor])
    if limit[worst] >= np.pi:
        return f"{text} After {after_s:.0f} s the pitch is not known."
    return f"{text} After {after_s:.0f} s it is accurate to {two_digits(limit[worst] / RADIAN_PER_DEGREE)} deg (95 %)."


def _angles(orientation: Orientation) -> Table:
    angles = (("inclination", orientation.inclination), ("pitch", orientation.pitch), ("heading", orientation.heading))
    quantiles = (0.0, 0.5, 1.0)  # the pitch has gaps while the body's axis is too far from its plane
    rows = [(name, *(np.nanquantile(angle, quantiles) / RADIAN_PER_DEGREE).tolist()) for name, angle in angles]
    columns = ("angle", "minimum (deg)", "median (deg)", "maximum (deg)")
    note = f"{len(orientation.time)} samples. "
    if orientation.still is None:
        note += "The initial tilt is determined from gravity in motion."
    else:
        start, stop = _still_s(orientation)
        note += f"The initial tilt is determined from the rest at {start:.1f} to {stop:.1f} s."
    if orientation.tilt.basis != "calibration":
        note += f" Its uncertainty is {orientation.tilt.statement}."
    return Table(title="Angles", columns=columns, rows=rows, form=".2f", note=note)


def _tilt(orientation: Orientation) -> Table:
    """Return the uncertainty of the tilt by source, and of the offset."""
    tilt = orientation.tilt
    rows = [(f"tilt: {name}", value / RADIAN_PER_DEGREE, "deg") for name, value in tilt.parts]
    rows += [
        ("tilt, all sources", tilt.inclination_uncertainty / RADIAN_PER_DEGREE, "deg"),
        ("tilt, 95 %", tilt.expanded_uncertainty / RADIAN_PER_DEGREE, "deg"),
        ("gyroscope offset, all axes", orientation.offset_uncertainty / RADIAN_PER_DEGREE, "deg/s"),
    ]
    return Table(title="Standard uncertainty", columns=("source", "size", "unit"), rows=rows, form=".4f")


def _still_s(orientation: Orientation) -> list[float]:
    still = orientation.still
    return [] if still is None else [float(orientation.time[k]) for k in (still.start, still.stop - 1)]
