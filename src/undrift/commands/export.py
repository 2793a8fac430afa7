"""``undrift export``: what firmware and other programs read."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from undrift.base.options import Output
from undrift.commands.files import calibration_findings, check_output
from undrift.export import ExportOptions, find_target
from undrift.files import new_folder, write_together
from undrift.io.store import read_calibration
from undrift.report import Report, Table


def export(
    calibration: Path,
    /,
    *,
    target: str,
    output: Output,
    options: Annotated[ExportOptions, Parameter(name="*")] = ExportOptions(),
) -> Report:
    """Write a calibration for firmware or another program, and list the parts that the file does not contain.

    Parameters
    ----------
    calibration : Path
        calibration.json of the device, or a calibration of imucal.
    target : str
        c, arduino, constants, or a target of another package.
    output : Path
        The output file. For c it is the header, with the source next to it. For constants it is .json or a C header .h.
        For arduino it is a new folder, the library.
    options : ExportOptions
        Options that some targets take.
    """
    chosen = find_target(target)
    files = (output, *(output.with_suffix(ending) for ending in chosen.more))
    if not chosen.folder:
        for path, endings in zip(files, (chosen.endings, *((ending,) for ending in chosen.more)), strict=True):
            check_output(path, endings=endings, reads=(calibration,))
    model = read_calibration(calibration)
    exported = chosen.write(model, options, output.name)
    if chosen.folder:
        with new_folder(output) as draft:
            for name, text in exported.tree.items():
                (draft / name).parent.mkdir(parents=True, exist_ok=True)
                (draft / name).write_text(text, encoding="utf-8", newline="\n")
    else:
        write_together(dict(zip(files, (exported.text, *exported.more), strict=True)))
    lost = [(part,) for part in exported.not_carried]
    return Report(
        title=f"Calibration of {model.device or 'a device'} for {target}",
        answer=f"{output.name} contains the calibration" + (f", without {len(lost)} of its parts." if lost else "."),
        tables=[Table(title="Not contained", columns=("part",), rows=lost)],
        notes=exported.notes,
        findings=calibration_findings(model),
        written=files,
        data={"target": target},
    )
