"""``undrift mount``: from device axes to body axes."""

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

from undrift.base.options import Files, OptionalOutput, verb
from undrift.base.summary import Section, Summary
from undrift.commands.files import Opening, TableUse, check_output, corrected, named_columns
from undrift.errors import InputError
from undrift.units import RADIAN_PER_DEGREE

if TYPE_CHECKING:
    from undrift.arrays import FloatArray
    from undrift.model import BodyMounting, Calibration, Verdict
    from undrift.mounting import MountFit

Worn: TypeAlias = Literal["lower-back", "thigh", "shank", "foot", "wrist"]
Movement: TypeAlias = Literal["walk", "bow"]
NOT_WRITTEN = "No mounting was written: add a calibration, and -o calibration.json to keep it there"


@verb
def mount(
    *records: Files,
    worn: Worn,
    movement: Movement = "walk",
    calibration: Path | None = None,
    output: OptionalOutput = None,
    opening: Opening = Opening(),
) -> Summary:
    """Find how a device is worn: device axes to body axes.

    Parameters
    ----------
    records : Path
        Recordings without taking the device off: stand upright for 3 s, walk straight ahead for 8 s and halt, four
        times.
    worn : str
        Body segment on which the device is worn.
    movement : str
        Movement that determines forward: walk, or bow (the trunk leans forward).
    calibration : Path or None
        calibration.json of the device, for a raw recording, and to keep the mounting in.
    output : Path or None
        calibration.json with the mounting.
    """
    from undrift.io.store import read_calibration
    from undrift.mounting import find_mounting

    check_output(output, endings=(".json",), reads=(*records, opening.column_map))
    if output and not calibration:
        raise InputError(
            f"{output}: expected a calibration to add the mounting to, got none. Name it with `calibration`."
        )
    model = None if calibration is None else read_calibration(calibration)
    readings = []
    for path in records:
        with named_columns(path):
            readings.append(corrected(opening.like(model, calibration).read(path), path, model, TableUse())[0])
    return _mount_summary(find_mounting(readings, worn, movement), records, model, output)


def _mount_summary(
    fit: "MountFit", records: tuple[Path, ...], model: "Calibration | None", output: Path | None
) -> Summary:
    """Write the calibration with its mounting, and return which way the device's axes point."""
    from undrift.base.codec import tree_of
    from undrift.io.store import verdict_json, write_calibration

    worn, verdict = fit.mounting, fit.verdict
    basis = Section(title="Method", text=(worn.basis,) if worn else ())
    data: dict[str, Any] = {"mounting": worn and tree_of(worn), "output": None}
    about = Summary(
        title=f"Mounting by {', '.join(path.name for path in records)}",
        answer="The recording does not determine the whole mounting. Nothing was written.",
        data=data | {"verdict": verdict_json(verdict)}, sections=(basis,), verdict=verdict,
    )  # fmt: skip
    if worn is None:
        return about
    verdict = verdict.also(_rotation_text(worn, None if model is None else model.mounting))
    degrees = [float(x) for x in worn.covariance.diagonal() ** 0.5 / RADIAN_PER_DEGREE]
    turns = dict(zip(("roll", "pitch", "heading"), degrees, strict=True))
    sides = [_nearest(way) for way in worn.matrix]
    rows = tuple(
        (name, " ".join(f"{x:+.3f}" for x in way), side, f"{off:.1f}", turn, f"{turns[turn]:.2f}")
        for name, way, (side, off), turn in zip(("forward", "left", "up"), worn.matrix, sides, turns, strict=True)
    )
    if output is not None and model is not None:
        write_calibration(replace(model, mounting=worn), output)
    axes = ("body", "device x, y, z", "side", "angle to it (deg)", "turn", "uncertainty (deg)")
    data |= {"output": output and str(output), "uncertainty": {f"{turn}_deg": angle for turn, angle in turns.items()}}
    data |= {"sides": {"forward": sides[0][0], "up": sides[2][0]}, "statement": sides_of(worn)}
    return replace(
        about,
        answer=f"{sides_of(worn)}.",
        data=data | {"verdict": verdict_json(verdict)},
        sections=(Section(title="Body axes in the device", columns=axes, rows=rows), basis),
        verdict=verdict,
        written=(output,),
        after=() if output else (NOT_WRITTEN,),
        next=("orient", records[0], "--calibration", output, "-o", "angles.csv") if output else (),
    )


def sides_of(worn: "BodyMounting") -> str:
    """Return in a sentence which sides of the device point forward and up."""
    (forward, ahead), _, (up, upright) = (_nearest(way) for way in worn.matrix)
    return (
        f"{worn.place.capitalize().replace('-', ' ')}: side {forward} of the device points forward ({ahead:.1f} deg off) and {up} "
        f"up ({upright:.1f} deg off), with a standard uncertainty of {worn.uncertainty / RADIAN_PER_DEGREE:.1f} deg"
    )


def mounting_of(calibration: Path | None) -> str:
    """Return a sentence about the mounting in a calibration, or "" without a mounting."""
    from undrift.io.store import read_calibration

    worn = None if calibration is None else read_calibration(calibration).mounting
    return "" if worn is None else sides_of(worn)


def _nearest(way: "FloatArray") -> tuple[str, float]:
    """Return the side of the device nearest to a direction in b, and the angle between them, deg."""
    k = int(abs(way).argmax())
    return f"{'+-'[int(way[k] < 0.0)]}{'xyz'[k]}", math.degrees(math.acos(min(1.0, abs(float(way[k])))))


def _rotation_text(worn: "BodyMounting", before: "BodyMounting | None") -> "Verdict":
    """Return in words how the device is turned against the mounting before, or against +x forward and +z up."""
    from undrift.findings import Verdict, finding

    turn = worn.matrix if before is None else worn.matrix @ before.matrix.T
    degrees = math.degrees(math.acos(max(-1.0, min(1.0, (float(turn.trace()) - 1.0) / 2.0))))
    ways = ("upside down", "left and right swapped", "front and back swapped")
    how = ", ".join(way for way, cosine in zip(ways, turn.diagonal()[::-1], strict=True) if cosine < -0.7) or "turned"
    against = "+x forward and +z up" if before is None else "the mounting before"
    sentence = f"The device is {how}: {degrees:.0f} deg off {against}."
    action = "Look at the device: if it was not meant so, turn it and record again."
    look = finding("mount.look", "warn" if before else "info", sentence, action)
    return Verdict.of(*((look,) if degrees > 45.0 else ()))
