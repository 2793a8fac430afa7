"""``undrift export``: write a calibration for firmware and other programs."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from undrift.base.options import Output
from undrift.commands.files import calibration_findings
from undrift.commands.outputs import check_output
from undrift.export import ExportOptions
from undrift.files import new_folder, write_together
from undrift.io.store import read_calibration
from undrift.report import Report, Table


def export(
    calibration: Path,
    /,
    *,
    target: Literal["c", "arduino", "constants"],
    output: Output,
    options: Annotated[ExportOptions, Parameter(name="*")] = ExportOptions(),
) -> Report:
    """Write a calibration for firmware or another program, and list the parts that the file does not contain.

    Parameters
    ----------
    calibration : Path
        calibration.json of the device, or a calibration of imucal.
    target : str
        c, arduino or constants.
    output : Path
        The output file. For c it is the header, with the source next to it. For constants it is .json or a C header .h.
        For arduino it is a new folder, the library.
    options : ExportOptions
        Options of some targets.
    """
    from undrift.export.arduino import write_arduino
    from undrift.export.c import write_c
    from undrift.export.constants import write_constants

    if target == "c":
        check_output(output, endings=(".h",), reads=(calibration,), beside=(output.with_suffix(".c"),))
    elif target == "constants":
        check_output(output, endings=(".json", ".h"), reads=(calibration,))
    model = read_calibration(calibration)
    write = {"c": write_c, "arduino": write_arduino, "constants": write_constants}[target]
    exported = write(model, options, output.name)
    if target == "arduino":
        _write_folder(output, exported.files)
        written = [output]
    else:
        written = [output.with_name(name) for name in exported.files]
        write_together(dict(zip(written, exported.files.values(), strict=True)))
    lost = [(part,) for part in exported.not_carried]
    return Report(
        title=f"Calibration of {model.device or 'a device'} for {target}",
        answer=f"{output.name} contains the {'calibration, except for the parts in the table' if lost else 'whole calibration'}.",
        tables=[Table(title="Not contained", columns=("part",), rows=lost)],
        notes=exported.notes,
        findings=calibration_findings(model),
        written=written,
        data={"target": target},
    )


def _write_folder(output: Path, files: Mapping[str, str]) -> None:
    with new_folder(output) as draft:
        for name, text in files.items():
            (draft / name).parent.mkdir(parents=True, exist_ok=True)
            (draft / name).write_text(text, encoding="utf-8", newline="\n")
