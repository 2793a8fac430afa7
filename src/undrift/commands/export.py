"""``undrift export``: what firmware and other programs read."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from undrift.base.options import Output, verb
from undrift.base.summary import Section, Summary, figure_of
from undrift.commands.files import check_output
from undrift.export import ExportOptions, find_target


@verb
def export(
    calibration: Path,
    /,
    *,
    target: str,
    output: Output,
    options: Annotated[ExportOptions, Parameter(name="*")] = ExportOptions(),
) -> Summary:
    """Write a calibration for firmware or another program, and list the parts that the file does not contain.

    Parameters
    ----------
    calibration : Path
        calibration.json of the device.
    target : str
        c, constants, or a target of another package.
    output : Path
        The output file. For c it is the header, with the source next to it. For constants it is .json or a C header .h.
    options : ExportOptions
        Options that some targets take.
    """
    from undrift.files import write_together
    from undrift.io.store import read_calibration, verdict_json

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
        answer=f"{output.name} contains the calibration" + (f", without {lost} of its parts." if lost else "."),
        data={
            "target": target,
            "files": [str(path) for path in files],
            "not_carried": exported.not_carried,
            "notes": exported.notes,
            **exported.figures,
            "verdict": verdict_json(model.verdict),
        },
        pictures=(figure_of("calibration:draw_calibration", model),),
        sections=(
            Section(title="Not contained", text=tuple(f"not contained: {text}" for text in exported.not_carried)),
        ),
        verdict=model.verdict,
        notes=exported.notes,
        written=files,
    )
