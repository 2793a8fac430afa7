"""``undrift mount``: determine the rotation from device axes to body axes."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from undrift.base.codec import tree_of
from undrift.base.options import Files, OptionalOutput
from undrift.commands.files import Opening, Reader
from undrift.commands.outputs import check_output
from undrift.errors import InputError
from undrift.io.store import write_calibration
from undrift.model import BodyMounting
from undrift.mounting import Movement, Worn, check_turned, find_mounting, nearest_side, statement_of
from undrift.record import Record
from undrift.report import Report, Table
from undrift.screen import progress
from undrift.units import RADIAN_PER_DEGREE


def mount(
    *records: Files,
    worn: Worn,
    movement: Movement = "walk",
    calibration: Path | None = None,
    output: OptionalOutput = None,
    opening: Opening = Opening(),
) -> Report:
    """Determine how a device is worn: the rotation from device axes to body axes.

    Parameters
    ----------
    records : Path
        Recordings in which the device is not taken off: stand upright for 3 s, walk straight ahead for 8 s and halt, four times.
    worn : str
        Body segment on which the device is worn.
    movement : str
        Movement that determines forward: walk, or bow (the trunk leans forward).
    calibration : Path or None
        calibration.json of the device, for raw recordings, and as input for the output file.
    output : Path or None
        calibration.json with the mounting.
    """
    check_output(output, endings=(".json",), reads=(*records, opening.column_map))
    if output and not calibration:
        raise InputError(
            f"{output}: expected a calibration to which the mounting is added, got none. Give it with `calibration`."
        )
    reader, readings = Reader(opening, calibration, records), list[Record]()
    model = reader.model
    for k, path in enumerate(records):
        progress(f"reading {path.name}", 0.5 * k / len(records))
        readings.append(reader.corrected(reader.read(path), path))
    progress("finding steps and stances", 0.5)
    fit = find_mounting(readings, worn, movement)
    title, findings = f"Mounting from {', '.join(path.name for path in records)}", fit.verdict.findings
    mounting = fit.mounting
    if mounting is None:
        answer = "The recordings do not determine how the device is worn. No file was written."
        return Report(
            title=title, answer=answer, notes=reader.notes, findings=findings, judged=True, data={"mounting": None}
        )
    if output is not None and model is not None:
        write_calibration(replace(model, mounting=mounting), output)
    return Report(
        title=title,
        answer=statement_of(mounting),
        tables=[_axes(mounting)],
        notes=[
            *reader.notes,
            *([] if output else ["Not saved: add --calibration and -o calibration.json to keep the mounting."]),
        ],
        findings=[*findings, *check_turned(mounting, reader.mounting(None, None)), *reader.findings],
        judged=True,
        written=[output] if output else [],
        data={"mounting": tree_of(mounting)},
        next_command=["orient", records[0], "--calibration", output, "-o", "angles.csv"] if output else [],
    )


def _axes(worn: BodyMounting) -> Table:
    uncertainty = np.sqrt(np.diag(worn.covariance)) / RADIAN_PER_DEGREE
    rows = []
    for name, turn, way, sigma in zip(
        ("forward", "left", "up"), ("roll", "pitch", "heading"), worn.matrix, uncertainty, strict=True
    ):
        side, angle = nearest_side(way)
        rows.append((name, *way.tolist(), side, angle / RADIAN_PER_DEGREE, turn, float(sigma)))
    columns = ("body", "device x", "device y", "device z", "side", "angle to it (deg)", "turn", "uncertainty (deg)")
    form = dict.fromkeys(columns[1:4], "+.3f") | {"angle to it (deg)": ".1f", "uncertainty (deg)": ".2f"}
    return Table(title="Body axes in the device", columns=columns, rows=rows, form=form, note=f"Basis: {worn.basis}.")
