"""``undrift export``: what firmware and other programs read."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from undrift.cli.common import Flag
from undrift.errors import FileFormatError, InputError
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

if TYPE_CHECKING:
    from undrift.export.c import ExportedC
    from undrift.model import Calibration

Target = Literal["c", "px4", "ardupilot", "fusion", "imucal", "ros", "undrift"]
ENDINGS: dict[str, tuple[str, ...]] = {
    "c": (".h",),
    "px4": (".params", ".param"),
    "ardupilot": (".param", ".parm", ".params"),
    "fusion": (".h",),
    "imucal": (".json",),
    "ros": (".yaml", ".yml"),
    "undrift": (".json",),
}


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Choices:
    """What some targets are told besides the calibration.

    Parameters
    ----------
    fixed : bool
        c: fixed point where the build defines nothing; the source holds all three arithmetics anyway.
    double : bool
        c: double where the build defines nothing.
    prefix : str
        c: what every name begins with, in lower case.
    gyro_raw_bits : int or None
        c, fixed point: bits behind the point of a gyroscope reading; chosen from the offsets where not given.
    accel_raw_bits : int or None
        c, fixed point: the same of an accelerometer reading.
    gyro_unit : str or None
        c: unit of the gyroscope readings where the calibration has no model of them; rad/s where not given.
    accel_unit : str or None
        c: the same of the accelerometer readings; m/s2 where not given.
    sensor : int
        px4, ardupilot: which inertial sensor of the autopilot, from 0.
    gyro_dps_per_unit : float or None
        px4, ardupilot: deg/s that the autopilot's driver makes of one count or volt.
    accel_g_per_unit : float or None
        px4, ardupilot: g that it makes of one count or volt.
    temp_c : float or None
        Where to read tables that the target has no place for, degC; the reference temperature where not given.
    """

    fixed: Flag = False
    double: Flag = False
    prefix: str = "undrift"
    gyro_raw_bits: int | None = None
    accel_raw_bits: int | None = None
    gyro_unit: str | None = None
    accel_unit: str | None = None
    sensor: int = 0
    gyro_dps_per_unit: float | None = None
    accel_g_per_unit: float | None = None
    temp_c: float | None = None


def export(
    calibration: Path,
    /,
    *,
    target: Target,
    output: Annotated[Path, Parameter(name=["--output", "-o"])],
    choices: Choices = Choices(),
    json: Flag = False,
) -> int:
    """Write what firmware and other programs read, and say what they cannot carry.

    Parameters
    ----------
    calibration : Path
        calibration.json of the device, or a calibration of imucal.
    target : str
        What to write for; undrift turns a calibration of imucal into calibration.json.
    output : Path
        The file; for c the header, whose source is written beside it.
    choices : Choices
        What some targets are told besides.
    json : bool
        One JSON object on stdout.

    Returns
    -------
    int
        0, or 1 when the calibration's own verdict is bad.
    """
    from undrift.cli.common import checked_output, write_json
    from undrift.files import write_whole
    from undrift.io.store import write_calibration

    if choices.fixed and choices.double:
        raise InputError("export: wanted --fixed or --double, got both; the source holds both, name the default")
    files = (output, output.with_suffix(".c")) if target == "c" else (output,)
    checked_output(output, endings=ENDINGS[target], reads=(calibration,))
    for other in files[1:]:
        checked_output(other, endings=(".c",), reads=(calibration,))
    model = read_any(calibration)
    if target == "undrift":
        write_calibration(model, output)
        told: dict[str, object] = {"not_carried": (), "notes": ()}
    else:
        texts, told = _export(model, target, choices, output.name)
        for path, text in zip(files, texts, strict=True):
            write_whole(path, text)
    told = {"target": target, "files": [str(path) for path in files], **told}
    if json:
        write_json({**told, "verdict": {"status": model.verdict.status, "reasons": model.verdict.reasons}})
    else:
        _show(told, model)
    return 1 if model.verdict.status == "bad" else 0


def read_any(path: Path) -> "Calibration":
    """Read a calibration of this package or of imucal.

    Parameters
    ----------
    path : Path
        JSON.

    Returns
    -------
    Calibration
        The device's model.

    Raises
    ------
    FileFormatError
        Neither of the two.
    """
    from undrift.export.programs import import_imucal
    from undrift.io.store import read_calibration

    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, ValueError):
        return read_calibration(path)  # says what is wrong
    if not re.search(r'"cal_type"\s*:', text):
        return read_calibration(path)
    try:
        return import_imucal(text, device=path.stem)
    except FileFormatError as error:
        raise FileFormatError(f"{path}: {error}") from error


def _export(
    model: "Calibration", target: Target, choices: Choices, name: str
) -> tuple[tuple[str, ...], dict[str, object]]:
    """The texts, and what there is to tell of them."""
    if target == "c":
        return _export_c(model, choices, name)
    if target in ("px4", "ardupilot"):
        from undrift.export.autopilots import AutopilotSettings, export_ardupilot, export_px4

        gyro, accel = choices.gyro_dps_per_unit, choices.accel_g_per_unit
        settings = AutopilotSettings(
            sensor=choices.sensor,
            gyro_nominal=None if gyro is None else gyro * RADIAN_PER_DEGREE,
            accel_nominal=None if accel is None else accel * STANDARD_GRAVITY,
            temp_c=choices.temp_c,
        )
        made = export_px4(model, settings) if target == "px4" else export_ardupilot(model, settings)
    else:
        from undrift.export.programs import export_fusion, export_imucal, export_ros

        to = export_fusion if target == "fusion" else export_imucal if target == "imucal" else export_ros
        made = to(model, temp_c=choices.temp_c)
    return (made.text,), {"not_carried": made.not_carried, "notes": made.notes}


def _export_c(model: "Calibration", choices: Choices, name: str) -> tuple[tuple[str, ...], dict[str, object]]:
    from datetime import UTC, datetime

    from undrift.export.c import CSettings, export_c

    if not re.fullmatch(r"[\w.-]+", name, re.ASCII):
        raise InputError(
            f"{name}: wanted a file name of letters, digits, -, _ and . for a C header, got others; rename it"
        )
    made = export_c(
        model,
        CSettings(
            default="fixed" if choices.fixed else "double" if choices.double else "float",
            prefix=choices.prefix,
            header_name=name,
            gyro_raw_bits=choices.gyro_raw_bits,
            accel_raw_bits=choices.accel_raw_bits,
            gyro_unit=choices.gyro_unit,
            accel_unit=choices.accel_unit,
            date=datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
        ),
    )
    return (made.header, made.source), {"not_carried": made.not_carried, "notes": made.notes, **_c_figures(made)}


def _c_figures(made: "ExportedC") -> dict[str, object]:
    bounds = (("gyro_rad_s", made.gyro_bound), ("accel_m_s2", made.accel_bound))
    return {
        "builds": [
            {
                "arithmetic": c.arithmetic,
                "table_bytes": c.table_bytes,
                "flash_bytes": c.flash_bytes,
                "cycles": c.cycles,
                "lead_cycles": c.lead_cycles,
            }
            for c in made.costs
        ],
        "fixed_point_bound": {name: bound.max() for name, bound in bounds},
    }


def _show(told: "dict[str, object]", model: "Calibration") -> None:
    from undrift.cli.common import console, show_verdict, table

    out = console()
    builds, bound = told.get("builds"), told.get("fixed_point_bound")
    if isinstance(builds, list) and isinstance(bound, dict):
        heads = ["arithmetic", "tables (bytes)", "flash (bytes, estimated)", "cycles (estimated)"]
        keys = ["table_bytes", "flash_bytes", "cycles"]
        if any(b["lead_cycles"] for b in builds):
            heads, keys = [*heads, "and of the lag (estimated)"], [*keys, "lead_cycles"]
        shown = table("builds", *heads)
        for b in builds:
            shown.add_row(b["arithmetic"], *(str(b[key]) for key in keys))
        out.print(shown, markup=False)
        gyro, accel = bound["gyro_rad_s"], bound["accel_m_s2"]
        out.print(f"fixed point, gyroscopes: within {gyro / RADIAN_PER_DEGREE:.2g} deg/s of exact arithmetic")
        out.print(f"fixed point, accelerometers: within {accel / STANDARD_GRAVITY * 1e3:.2g} mg of exact arithmetic")
    for head, key in (("not carried", "not_carried"), ("note", "notes")):
        texts = told[key]
        for text in texts if isinstance(texts, tuple) else ():
            out.print(f"{head}: {text}", markup=False)
    show_verdict(model.verdict)
    files = told["files"]
    for path in files if isinstance(files, list) else ():
        out.print(f"Wrote {path}", markup=False)
