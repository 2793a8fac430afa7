"""``undrift orient``: from rate and specific force to angles."""

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from undrift.cli.common import (
    CalibrationDetails,
    Json,
    Opening,
    Output,
    Policy,
    Report,
    Side,
    check_output,
    check_physical,
    check_report,
    named_columns,
    origin_of,
    say,
    show_verdict,
    write_json,
)

if TYPE_CHECKING:
    from undrift.arrays import FloatArray
    from undrift.findings import Finding
    from undrift.model import Calibration
    from undrift.orientation import Orientation
    from undrift.record import Record, Still


def orient(
    record: Path,
    /,
    *,
    output: Output,
    calibration: Path | None = None,
    method: Literal["strapdown", "vqf"] = "strapdown",
    offset: Literal["none", "rest", "still"] = "none",
    still_start_s: float | None = None,
    still_stop_s: float | None = None,
    heading_deg: float = 0.0,
    forward: Side = "+x",
    up: Side = "+z",
    body: str = "sensor",
    power_on_s: float | None = None,
    policy: Policy = "raise",
    opening: Opening = Opening(),
    report: Report = None,
    details: CalibrationDetails = False,
    json: Json = False,
) -> int:
    """Initial tilt, then strapdown or a filter: quaternions, inclination, heading, sagittal pitch.

    Parameters
    ----------
    record : Path
        A corrected recording, or a raw one with --calibration.
    output : Path
        Time, quaternion and angles as .parquet, .csv, .csv.gz or .mat; quaternions as .sto (OpenSense) or
        sub-.._task-.._tracksys-.._motion.tsv (BIDS).
    calibration : Path or None
        calibration.json of the device, for a raw recording.
    method : str
        strapdown, or vqf: a filter that takes the inclination from the accelerometers and tracks the offset; it needs
        undrift[orientation].
    offset : str
        "rest" subtracts the mean rate of the first still phase (or the named one), "still" that of every still phase, linear
        between them.
    still_start_s : float or None
        Start of a stretch at rest, s on the recording's own clock; without it the first still phase is found.
    still_stop_s : float or None
        End of that stretch.
    heading_deg : float
        Heading at the still phase, deg.
    forward : str
        Device axis that points forward on the upright segment: with --up it defines the pitch.
    up : str
        Device axis that points up on the upright segment.
    body : str
        Name of the body in .sto and BIDS, of the OpenSim model: pelvis heads the column pelvis_imu.
    power_on_s : float or None
        Time since power-on at the first sample, s; without it no warm-up is subtracted.
    policy : str
        Temperatures outside a tuning table: refuse (raise), hold the table's end, or leave a gap (nan). Where no
        temperature was recorded the result is a gap under each, and a warning says for how long.
    opening : Opening
        How to read a foreign recording.
    report : Path or None
        Report page to write: .html.
    """
    from undrift.correction.rest import named_rest
    from undrift.io.store import read_calibration
    from undrift.io.write import ORIENTATION_WRITERS, files_of, write_orientation
    from undrift.orientation import OrientSettings
    from undrift.orientation import orient as find
    from undrift.report.commands import write_orient_report

    reads = (record, calibration, opening.column_map)
    check_output(output, endings=tuple(ORIENTATION_WRITERS), reads=reads, beside=files_of(output)[1:])
    check_report(report, reads=reads)
    held = None if calibration is None else read_calibration(calibration)
    readings = opening.like(held, calibration).read(record)
    with named_columns(record):
        readings, earlier, notes = _corrected(readings, record, held, policy, power_on_s)
    models = {} if held is None else {"gyro_model": held.gyro}
    settings = OrientSettings(method=method, offset=offset, heading=math.radians(heading_deg), forward=forward, up=up)
    with named_columns(record):
        found = find(readings, named_rest(readings, (still_start_s, still_stop_s)), settings, **models)
    found = replace(found, findings=tuple({one.text: one for one in (*earlier, *found.findings)}.values()))
    angles = (found.inclination, found.heading, found.pitch)
    write_orientation(found.time, found.q_nb, angles, output, body=body)
    made = _as_json(found) | {"method": method}
    lines = _lines(found, made, notes)
    if report is not None:
        write_orient_report(report, found, record.name, remarks=lines, origin=origin_of(*reads))
    if json:
        notes = (*(one.text for one in earlier), *notes)  # as files of scripts have it: both together
        write_json(made | {"recording": str(record), "output": str(output), "notes": notes}, "orient")
        return 0
    wrote = [f"Wrote {report}"] if report else []
    say(f"{record} -> {output}: {made['samples']} samples", *(f"  {line}" for line in lines), *wrote)
    if details and held is not None:
        show_verdict(held.verdict, details=True)
    return 0


def _corrected(
    readings: "Record", path: Path, held: "Calibration | None", policy: Policy, power_on_s: float | None
) -> "tuple[Record, tuple[Finding, ...], tuple[str, ...]]":
    """Return the readings by their calibration, if there is one, what speaks against them, and notes."""
    from undrift.correction.correct import correct_checked
    from undrift.correction.coverage import find_beyond

    if held is None:
        check_physical(readings, path)
        return readings, (), ()
    done = correct_checked(readings, held, policy=policy, power_on_s=power_on_s)
    beyond = (item for one in find_beyond(done.record, held) for item in one.findings)
    return done.record, (*(one for one in done.findings if one.level == "warn"), *beyond), done.notes


def _lines(found: "Orientation", made: dict[str, Any], notes: tuple[str, ...]) -> tuple[str, ...]:
    """Return what was found, in lines for a person."""
    return (
        "tilt from the still phase {:.1f} to {:.1f} s: ".format(*made["still"]) + found.tilt.statement,
        "inclination: {:.2f} to {:.2f} deg".format(*made["inclination_deg"]),
        "pitch: {:.2f} to {:.2f} deg".format(*made["pitch_deg"]),
        *(f"warning: {one.text}" for one in found.findings if one.level != "info"),
        *(f"note: {note}" for note in notes),
    )


def _as_json(found: "Orientation") -> dict[str, Any]:
    from undrift.io.store import findings_json

    def times(still: "Still") -> list[float]:
        return [float(found.time[k]) for k in (still.start, still.stop - 1)]

    return {
        "samples": len(found.time),
        "still": times(found.still),
        "tilt_uncertainty_deg": math.degrees(found.tilt.inclination_uncertainty),
        "tilt_expanded_uncertainty_deg": math.degrees(found.tilt.expanded_uncertainty),
        "tilt_uncertainty_parts_deg": {name: math.degrees(part) for name, part in found.tilt.parts},
        "tilt_basis": found.tilt.basis,
        "offset_dps": found.offset * (180.0 / math.pi),
        "offset_uncertainty_dps": math.degrees(found.offset_uncertainty),
        "rests": [times(still) for still in found.rests],
        "rest_offsets_dps": found.rest_offsets * (180.0 / math.pi),
        "inclination_deg": _span(found.inclination),
        "pitch_deg": _span(found.pitch),
        "findings": findings_json(found.findings),
    }


def _span(angle: "FloatArray") -> tuple[float, float]:
    """Return least and greatest, deg; pitch has gaps where the body's axis leaves its plane."""
    import numpy as np

    return math.degrees(float(np.nanmin(angle))), math.degrees(float(np.nanmax(angle)))
