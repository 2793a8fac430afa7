"""``undrift export``: what firmware and other programs read."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from undrift.base.options import Details, Json, Output
from undrift.cli.common import say, show_table, show_verdict, write_json
from undrift.commands.files import check_output
from undrift.errors import FileFormatError, InputError
from undrift.export import ExportOptions, find_target
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

if TYPE_CHECKING:
    from undrift.model import Calibration


def export(
    calibration: Path,
    /,
    *,
    target: str,
    output: Output,
    options: Annotated[ExportOptions, Parameter(name="*")] = ExportOptions(),
    details: Details = False,
    json: Json = False,
) -> int:
    """Write calibrations for firmware and other programs, and list what they cannot carry.

    Parameters
    ----------
    calibration : Path
        calibration.json of the device, or a calibration of imucal.
    target : str
        c, px4, ardupilot, fusion, imucal, ros, undrift (a calibration of imucal as calibration.json), or a target of
        another package.
    output : Path
        The file; for c the header, whose source is written beside it.
    options : ExportOptions
        Options that some targets take.
    """
    from undrift.files import write_whole
    from undrift.io.store import findings_json, verdict_json

    if options.fixed and options.double:
        raise InputError("export: wanted --fixed or --double, got both; the source holds both, name the default")
    chosen = find_target(target)
    files = (output, *(output.with_suffix(ending) for ending in chosen.more))
    for path, endings in zip(files, (chosen.endings, *((ending,) for ending in chosen.more)), strict=True):
        check_output(path, endings=endings, reads=(calibration,))
    model = _read(calibration)
    made = chosen.write(model, options, output.name)
    for path, text in zip(files, (made.text, *made.more), strict=True):
        write_whole(path, text)
    if json:
        write_json(
            {
                "target": target,
                "files": [str(path) for path in files],
                "not_carried": made.not_carried,
                "notes": made.notes,
                "findings": findings_json(made.findings),
                **made.figures,
                "verdict": verdict_json(model.verdict),
            },
            "export",
        )
    else:
        _show_builds(made.figures)
        say(*(f"not carried: {text}" for text in made.not_carried), *(f"note: {text}" for text in made.notes))
        show_verdict(model.verdict, details=details)
        say(*(f"Wrote {path}" for path in files))
    return 1 if model.verdict.status == "bad" else 0


def _read(path: Path) -> "Calibration":
    """Read a calibration of this package or of imucal."""
    from undrift.export.programs import import_imucal
    from undrift.io.store import read_calibration

    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, ValueError):
        text = ""  # read_calibration reports what is wrong
    if not re.search(r'"cal_type"\s*:', text):
        return read_calibration(path)
    try:
        return import_imucal(text, device=path.stem)
    except FileFormatError as error:
        raise FileFormatError(f"{path}: {error}") from error


def _show_builds(figures: Mapping[str, Any]) -> None:
    """Show memory, time and the error bound of C builds."""
    builds, bound = figures.get("builds"), figures.get("fixed_point_bound")
    if not builds or not bound:
        return
    keys = {"table_bytes": "tables (bytes)", "flash_bytes": "flash (bytes, estimated)", "cycles": "cycles (estimated)"}
    if any(build["lead_cycles"] for build in builds):
        keys["lead_cycles"] = "and of the lag (estimated)"
    rows = [(build["arithmetic"], *(str(build[key]) for key in keys)) for build in builds]
    show_table("builds", ("arithmetic", *keys.values()), rows)
    gyro, accel = bound["gyro_rad_s"] / RADIAN_PER_DEGREE, bound["accel_m_s2"] / STANDARD_GRAVITY * 1e3
    say(
        f"fixed point, gyroscopes: within {gyro:.2g} deg/s of exact arithmetic",
        f"fixed point, accelerometers: within {accel:.2g} mg of exact arithmetic",
    )
