"""``undrift mount``: from device axes to body axes, and the angle of a joint between two devices."""

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias

from cyclopts import Parameter

from undrift.base.options import Files, OptionalOutput, verb
from undrift.base.summary import Section, Summary, figure_of
from undrift.commands.files import NamedRest, Opening, TableUse, check_output, corrected, named_columns
from undrift.errors import InputError
from undrift.units import RADIAN_PER_DEGREE

if TYPE_CHECKING:
    from undrift.arrays import FloatArray
    from undrift.model import BodyMounting, Calibration, Verdict
    from undrift.mounting import HingeFit, MountFit

Worn: TypeAlias = Literal["lower-back", "thigh", "shank", "foot", "wrist"]
Posture: TypeAlias = Literal["standing", "sitting"]
Movement: TypeAlias = Literal["walk", "bow", "squat", "raise"]
NOT_WRITTEN = "No mounting was written: add a calibration, and -o calibration.json to keep it there"


@verb
def mount(
    *records: Files,
    worn: Worn | None = None,
    joint: Literal["knee", "elbow"] | None = None,
    posture: Posture = "standing",
    movement: Movement = "walk",
    calibration: Annotated[tuple[Path, ...], Parameter(show_default=False)] = (),
    named: NamedRest = NamedRest(),
    output: OptionalOutput = None,
    opening: Opening = Opening(),
) -> Summary:
    """Find how a device is worn: device axes to body axes; or the axis and the angle of a joint between two devices.

    Parameters
    ----------
    records : Path
        Recordings of one wearing: stand upright for 3 s, walk straight ahead for 8 s and halt, four times. With --joint two on
        one clock, of the segment above the joint and of that below it, in any motion.
    worn : str or None
        Where the device is worn.
    joint : str or None
        The joint between two devices, as a hinge.
    posture : str
        What the wearer does while still: standing, or sitting upright.
    movement : str
        What shows forward: walk; bow, the trunk leans forward; squat; or raise, the straight limb goes forward.
    calibration : Path
        calibration.json of the device, for a raw recording, and to keep the mounting in; with --joint one for each device.
    output : Path or None
        calibration.json with the mounting; with --joint the angle over time as .csv.
    """
    from undrift.correction.rest import named_rest
    from undrift.io.store import read_calibration
    from undrift.mounting import find_mounting, fit_hinge

    needed = (2, 2) if joint else (len(records), 1)
    if (worn is None) == (joint is None) or len(records) != needed[0] or len(calibration) not in (0, needed[1]):
        got = f"{len(records)} recordings, {len(calibration)} calibrations, worn {worn or 'nowhere'}, joint {joint or 'none'}"
        raise InputError(
            "mount: wanted `worn` and recordings of one device, or `joint`, two recordings and no calibration or one of each, got "
            f"{got}; state one of them"
        )
    check_output(output, endings=(".csv",) if joint else (".json",), reads=(*records, opening.column_map))
    if worn and output and not calibration:
        raise InputError(f"{output}: wanted a calibration to add the mounting to, got none; name it (`calibration`)")
    files = (calibration or (None,)) * (1 if joint and calibration else len(records))
    models = [None if path is None else read_calibration(path) for path in files]
    readings = []
    for path, file, model in zip(records, files, models, strict=True):
        with named_columns(path):
            readings.append(corrected(opening.like(model, file).read(path), path, model, TableUse())[0])
    still = named_rest(readings[0], named.stretch)
    span = None if still is None else (float(readings[0].time[still.start]), float(readings[0].time[still.stop - 1]))
    if joint:
        worn_both = tuple(model.mounting for model in models if model is not None and model.mounting is not None)
        by = (worn_both[0], worn_both[1]) if len(worn_both) == 2 and still is None else None
        return _hinge_summary(fit_hinge(readings[0], readings[1], joint, by, span), records, output)
    fit = find_mounting(readings, worn or "lower-back", posture, movement, span)
    return _mount_summary(fit, records, models[0], output)


def _mount_summary(
    fit: "MountFit", records: tuple[Path, ...], model: "Calibration | None", output: Path | None
) -> Summary:
    """Write the calibration with its mounting, and return which way the device's axes point."""
    from undrift.base.codec import tree_of
    from undrift.io.store import verdict_json, write_calibration

    worn, verdict, basis = fit.mounting, fit.verdict, Section(title="How it was found", text=fit.basis)
    data: dict[str, Any] = {"mounting": worn and tree_of(worn), "basis": fit.basis, "output": None}
    about = Summary(
        title=f"Mounting by {', '.join(path.name for path in records)}",
        answer="How the device is worn is not shown whole; nothing was written.",
        data=data | {"verdict": verdict_json(verdict)}, sections=(basis,), verdict=verdict, failed=verdict.status == "bad",
    )  # fmt: skip
    if worn is None:
        return about
    verdict = verdict.also(_turned(worn, None if model is None else model.mounting))
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
    data |= {"output": output and str(output), "uncertainty": {f"{turn}_deg": one for turn, one in turns.items()}}
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
        f"up ({upright:.1f} deg off); standard uncertainty {worn.uncertainty / RADIAN_PER_DEGREE:.1f} deg"
    )


def mounting_of(calibration: Path | None) -> str:
    """Return in a sentence the mounting that a calibration keeps; empty where it keeps none."""
    from undrift.io.store import read_calibration

    worn = None if calibration is None else read_calibration(calibration).mounting
    return "" if worn is None else sides_of(worn)


def _nearest(way: "FloatArray") -> tuple[str, float]:
    """Return the side of the device nearest to a direction in b, and the angle between them, deg."""
    k = int(abs(way).argmax())
    return f"{'+-'[int(way[k] < 0.0)]}{'xyz'[k]}", math.degrees(math.acos(min(1.0, abs(float(way[k])))))


def _turned(worn: "BodyMounting", before: "BodyMounting | None") -> "Verdict":
    """Return in words how the device is turned against the mounting before, or against +x forward and +z up."""
    from undrift.findings import Verdict, finding

    turn = worn.matrix if before is None else worn.matrix @ before.matrix.T
    degrees = math.degrees(math.acos(max(-1.0, min(1.0, (float(turn.trace()) - 1.0) / 2.0))))
    ways = ("upside down", "left and right swapped", "front and back swapped")
    how = ", ".join(way for way, cosine in zip(ways, turn.diagonal()[::-1], strict=True) if cosine < -0.7) or "turned"
    against = "+x forward and +z up" if before is None else "the mounting before"
    one = finding("mount.turned", "warn" if before else "info", how=how.capitalize(), degrees=degrees, against=against)
    return Verdict.of(*((one,) if degrees > 45.0 else ()))


def _hinge_summary(fit: "HingeFit", records: tuple[Path, ...], output: Path | None) -> Summary:
    """Write the angle over time, and return its span and the axes."""
    from undrift.files import write_whole
    from undrift.io.store import verdict_json

    angle, off = fit.angle / RADIAN_PER_DEGREE, fit.uncertainty / RADIAN_PER_DEGREE
    uncertain = fit.angle_uncertainty / RADIAN_PER_DEGREE
    rows = tuple(
        (path.name, " ".join(f"{x:+.3f}" for x in axis), f"{off:.1f}")
        for path, axis in zip(records, fit.axes, strict=True)
    )
    if output is not None:
        lines = (f"{t:.6f},{x:.4f}" for t, x in zip(fit.time.tolist(), angle.tolist(), strict=True))
        write_whole(output, "\n".join(("time_s,angle_deg", *lines, "")))
    zero = (
        "posture from {:.1f} to {:.1f} s".format(*fit.straight_s)
        if fit.straight_s
        else "upright posture of both mountings"
    )
    return Summary(
        title=f"Angle of the {fit.joint} by {records[0].name} and {records[1].name}",
        answer=f"{fit.joint.capitalize()}: {angle.min():.1f} to {angle.max():.1f} deg, standard uncertainty {uncertain:.1f} deg.",
        data={
            "joint": fit.joint, "axes": fit.axes, "axes_uncertainty_deg": off, "angle_deg": [angle.min(), angle.max()],
            "angle_uncertainty_deg": uncertain, "straight_s": fit.straight_s, "output": output and str(output),
            "verdict": verdict_json(fit.verdict),
        },
        pictures=(figure_of("figures:draw_angle", fit.time, angle, fit.straight_s, f"flexion of the {fit.joint} (deg)"),),
        sections=(
            Section(title="Axis of the joint", columns=("device", "x, y, z", "uncertainty (deg)"), rows=rows),
            Section(title="Straight", text=(f"0 deg is the {zero}",)),
        ),
        verdict=fit.verdict,
        written=(output,),
        failed=fit.verdict.status == "bad",
    )  # fmt: skip
