"""``undrift orient``: from rate and specific force to angles."""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from undrift.base.options import Flag, Output, Side, verb
from undrift.base.summary import Result, Section, Summary, figure_of, number
from undrift.commands import Progress, reading, silent
from undrift.commands.batch import of_folder
from undrift.commands.calibration_file import choose_calibration
from undrift.commands.files import NamedRest, Opening, TableUse, check_output, corrected, named_columns, worn_by

if TYPE_CHECKING:
    from undrift.arrays import FloatArray
    from undrift.findings import Finding
    from undrift.model import Calibration
    from undrift.orientation import Orientation
    from undrift.record import Still

NORMAL_95 = 1.96  # coverage factor for 95 % of the errors of an angle
_SHOWN = ("correct.offset_subtracted", "orient.north")  # on a terminal, though no warnings


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Oriented(Result):
    """The orientation of a recording, and what speaks against it."""

    record: Path
    output: Path
    method: str
    orientation: "Orientation"
    calibration: "Calibration | None"
    earlier: "tuple[Finding, ...]"  # of the correction
    notes: tuple[str, ...]

    @property
    def anchor(self) -> int:
        """Return the sample from which rates are integrated: the last of the rest, or the first."""
        return 0 if self.orientation.still is None else self.orientation.still.stop - 1

    @cached_property
    def band(self) -> "FloatArray | None":
        """Return the 95 % limit of the pitch error at each sample, rad: tilt, offset since the rest, scale. Return None
        for a filter, or if the uncertainty of the accelerometers is unknown.
        """
        import numpy as np

        angles, gyro = self.orientation, None if self.calibration is None else self.calibration.gyro
        if self.method != "strapdown" or angles.tilt.basis != "calibration":
            return None
        drift = angles.offset_uncertainty * np.abs(angles.time - angles.time[self.anchor])
        scale = 0.0 if gyro is None else gyro.relative_uncertainty
        parts = (
            angles.tilt.expanded_uncertainty,
            NORMAL_95 * drift,
            NORMAL_95 * scale * (angles.pitch - angles.pitch[self.anchor]),
        )
        band: FloatArray = np.sqrt(sum(np.square(component) for component in parts))
        return band

    @property
    def answer(self) -> str:
        """Return the range of the sagittal pitch, and its uncertainty at the less certain end."""
        import numpy as np

        angles, (low, _, high) = self.orientation, _spread(self.orientation.pitch)
        text = f"The sagittal pitch goes from {low:.1f} to {high:.1f} deg"
        if self.band is None or not np.isfinite(self.band).any():
            return f"{text}. Tilt at the start: {angles.tilt.statement}."
        worst, turn = int(np.nanargmax(self.band)), math.degrees(angles.tilt.expanded_uncertainty)
        text += f". After {abs(angles.time[worst] - angles.time[self.anchor]):.0f} s it is good to "
        offset = f"offset within {NORMAL_95 * math.degrees(angles.offset_uncertainty):.2g} deg/s"
        return f"{text}{math.degrees(self.band[worst]):.2g} deg (95 %): {offset}, gravity within {turn:.2g} deg."

    def summary(self) -> Summary:
        """Return angles, tilt and warnings."""
        from undrift.io.store import verdict_json

        orientation, data = self.orientation, _data(self.orientation)
        angles = (
            ("inclination", orientation.inclination),
            ("pitch", orientation.pitch),
            ("heading", orientation.heading),
        )
        rows = tuple((name, *(number(item) for item in _spread(angle))) for name, angle in angles)
        lines = (
            "tilt from "
            + (
                "the still phase {:.1f} to {:.1f} s".format(*data["still"])
                if orientation.still
                else "gravity in motion"
            )
            + f": {orientation.tilt.statement}",
            "inclination: {:.2f} to {:.2f} deg".format(*data["inclination_deg"]),
            "pitch: {:.2f} to {:.2f} deg".format(*data["pitch_deg"]),
        )
        uncertainty = f"Offset: standard uncertainty {data['offset_uncertainty_dps']:.4f} deg/s, all axes together."
        # A page shows all findings
        offset = tuple(item.text for item in orientation.findings if item.code in _SHOWN)
        warnings = tuple(f"warning: {item.text}" for item in orientation.findings if item.level != "info")
        heads, files = ("angle", "least (deg)", "median (deg)", "greatest (deg)"), f"{self.record} -> {self.output}"
        sections = [
            Section(title="Files", text=(f"{files}: {len(orientation.time)} samples",), on="terminal"),
            Section(title=f"Angles, {len(orientation.time)} samples", columns=heads, rows=rows, on="page"),
            Section(title="Method", text=(*lines, uncertainty)),
            Section(title="Offset, north and mounting", text=offset, on="terminal"),
            Section(title="Warnings", text=warnings, on="terminal"),
        ]
        verdict = None if self.calibration is None else self.calibration.verdict
        data |= {"verdict": verdict and verdict_json(verdict)}
        identity = {"method": self.method, "recording": str(self.record), "output": str(self.output)}
        return Summary(
            title=f"Orientation of {self.record.name}",
            answer=self.answer,
            data=data | identity | {"notes": (*(item.text for item in self.earlier), *self.notes)},
            pictures=(figure_of("figures:draw_orientation", orientation, self.band),),
            sections=tuple(sections),
            findings=orientation.findings,
            verdict=verdict,
            judged="the calibration",
            brief=True,
            notes=self.notes,
        )


@verb
@of_folder(".parquet")
def orient(
    record: Path,
    /,
    *,
    output: Output,
    calibration: Path | None = None,
    method: Literal["strapdown", "vqf"] = "strapdown",
    magnetometer: Flag = False,
    offset: Literal["none", "rest", "motion"] = "none",
    named: NamedRest = NamedRest(),
    forward: Side | None = None,
    up: Side | None = None,
    opening: Opening = Opening(),
    progress: Progress = silent,
) -> Oriented:
    """Initial tilt, then strapdown or a filter: quaternions, inclination, heading, sagittal pitch.

    Parameters
    ----------
    record : Path
        A corrected recording, or a raw recording with its calibration. For a folder of recordings, the output is a
        folder.
    output : Path
        File for time, quaternion and angles (.parquet, .csv or .csv.gz), or for quaternions (.sto, OpenSense).
    calibration : Path or None
        calibration.json of the device, for a raw recording. In a folder of calibrations, the newest file of its serial
        number is used.
    method : str
        strapdown, or vqf: a filter that takes the inclination from the accelerometers and tracks the offset, over
        the whole recording.
    magnetometer : bool
        With vqf, also use the magnetic field. Heading is then relative to magnetic east.
    offset : str
        "rest" subtracts the mean rate of the first (or the named) still phase. "motion" starts from that rest, if there
        is one, and estimates the offset from gravity while the device moves.
    forward : str or None
        Device axis that points forward on the upright segment. With `up` it defines the pitch. Without both, the axes
        are +x and +z. If the calibration has a mounting, they are the axes of the segment, and orientation and angles
        refer to the segment.
    up : str or None
        Device axis that points up on the upright segment.
    """
    from undrift.findings import finding
    from undrift.io.write import ORIENTATION_WRITERS, files_of, write_orientation
    from undrift.orientation import OrientSettings
    from undrift.orientation import orient as find

    reads = (record, calibration, opening.column_map)
    check_output(output, endings=tuple(ORIENTATION_WRITERS), reads=reads, beside=files_of(output)[1:])
    chosen = choose_calibration(calibration, (record,), opening)
    model, calibration = chosen.model, chosen.path
    with reading(progress, 0.4, record):
        readings = opening.like(model, calibration).read(record)
    progress("integrating", 0.4)
    settings = OrientSettings(
        method=method, magnetometer=magnetometer, offset=offset, forward=forward or "+x",
        up=up or "+z", mounting=worn_by(model, forward, up),
    )  # fmt: skip
    with named_columns(record):
        readings, earlier, notes = corrected(readings, record, model, TableUse())
        if magnetometer and model is not None and model.magnetometer is None:
            earlier += (finding("orient.field", "warn"),)
        if worn := settings.mounting:
            degrees = math.degrees(worn.uncertainty)
            notes = (
                *notes,
                f"Pitch of the {worn.place} by the calibration's mounting, uncertain by {degrees:.1f} deg; {worn.basis}.",
            )
        rest = named.still_in(readings)
        orientation = find(readings, rest, settings, gyro_model=None if model is None else model.gyro)
    orientation = replace(
        orientation, findings=tuple({item.text: item for item in (*earlier, *orientation.findings)}.values())
    )
    write_orientation(
        orientation.time, orientation.q_nb, (orientation.inclination, orientation.heading, orientation.pitch), output
    )
    return Oriented(
        record=record, output=output, method=method, orientation=orientation, calibration=model, earlier=earlier,
        notes=(*chosen.notes, *notes),
    )  # fmt: skip


def _data(orientation: "Orientation") -> dict[str, Any]:
    from undrift.io.store import findings_json

    def times(still: "Still") -> list[float]:
        return [float(orientation.time[k]) for k in (still.start, still.stop - 1)]

    return {
        "samples": len(orientation.time),
        "still": orientation.still and times(orientation.still),
        "tilt_uncertainty_deg": math.degrees(orientation.tilt.inclination_uncertainty),
        "tilt_expanded_uncertainty_deg": math.degrees(orientation.tilt.expanded_uncertainty),
        "tilt_uncertainty_parts_deg": {name: math.degrees(value) for name, value in orientation.tilt.parts},
        "tilt_basis": orientation.tilt.basis,
        "offset_dps": orientation.offset * (180.0 / math.pi),
        "offset_uncertainty_dps": math.degrees(orientation.offset_uncertainty),
        "inclination_deg": _spread(orientation.inclination)[::2],
        "pitch_deg": _spread(orientation.pitch)[::2],
        "findings": findings_json(orientation.findings),
    }


def _spread(angle: "FloatArray") -> list[float]:
    """Return least, median and greatest, deg. Pitch has gaps if the body's axis leaves its plane."""
    import numpy as np

    return [math.degrees(float(f(angle))) for f in (np.nanmin, np.nanmedian, np.nanmax)]
