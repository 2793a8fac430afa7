"""``undrift export``: what firmware and other programs read."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from undrift.base.options import Output, verb
from undrift.base.summary import Section, Summary, figure_of, rows_section
from undrift.commands.files import check_output
from undrift.errors import InputError
from undrift.export import ExportOptions, find_target
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

if TYPE_CHECKING:
    pass

BUILD = {"table_bytes": "tables (bytes)", "flash_bytes": "flash (bytes, estimated)", "cycles": "cycles (estimated)"}


@verb
def export(
    calibration: Path,
    /,
    *,
    target: str,
    output: Output,
    options: Annotated[ExportOptions, Parameter(name="*")] = ExportOptions(),
) -> Summary:
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
    from undrift.files import write_together
    from undrift.io.store import findings_json, read_calibration, verdict_json

    if options.fixed and options.double:
        raise InputError("export: wanted `fixed` or `double`, got both; the source holds both, name the default")
    chosen = find_target(target)
    files = (output, *(output.with_suffix(ending) for ending in chosen.more))
    for path, endings in zip(files, (chosen.endings, *((ending,) for ending in chosen.more)), strict=True):
        check_output(path, endings=endings, reads=(calibration,))
    model = read_calibration(calibration)
    exported = chosen.write(model, options, output.name)
    write_together(dict(zip(files, (exported.text, *exported.more), strict=True)))
    lost = len(exported.not_carried)
    return Summary(
        title=f"Calibration of {model.device or 'a device'} for {target}",
        answer=f"{output.name} carries the calibration" + (f" but {lost} of its parts." if lost else "."),
        data={
            "target": target,
            "files": [str(path) for path in files],
            "not_carried": exported.not_carried,
            "notes": exported.notes,
            "findings": findings_json(exported.findings),
            **exported.figures,
            "verdict": verdict_json(model.verdict),
        },
        pictures=(figure_of("certificate:draw_calibration", model),),
        sections=(
            *_builds(exported.figures),
            Section(title="Not carried", text=tuple(f"not carried: {text}" for text in exported.not_carried)),
        ),
        verdict=model.verdict,
        notes=exported.notes,
        written=files,
        failed=model.verdict.status == "bad",
    )


def _builds(figures: Any) -> tuple[Section, ...]:
    """Return memory, time and the error bound of C builds; nothing of other targets."""
    builds, bound = figures.get("builds"), figures.get("fixed_point_bound")
    if not builds or not bound:
        return ()
    keys = BUILD | ({"lead_cycles": "and of the lag (estimated)"} if any(one["lead_cycles"] for one in builds) else {})
    rows = [{"arithmetic": one["arithmetic"]} | {head: str(one[key]) for key, head in keys.items()} for one in builds]
    gyro, accel = bound["gyro_rad_s"] / RADIAN_PER_DEGREE, bound["accel_m_s2"] / STANDARD_GRAVITY * 1e3
    text = (
        f"fixed point, gyroscopes: within {gyro:.2g} deg/s of exact arithmetic",
        f"fixed point, accelerometers: within {accel:.2g} mg of exact arithmetic",
    )
    return (rows_section("builds", rows, text=text),)
