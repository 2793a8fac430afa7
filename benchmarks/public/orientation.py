"""BROAD: remaining orientation error of each calibration, by strapdown and with filters of other programs on the same
readings.

Each trial is corrected with a fit to the *other* trials of its device. Strapdown starts from the reference. Filters
process the whole recording with their defaults, and their heading is aligned in the rest before the motion.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from benchmarks.broad import DEVICES, pairs
from benchmarks.from_motion import by_vqf, end_errors
from benchmarks.public.table import Row, Table, by_others
from undrift.calibration.calibrate import calibrate_from_motion
from undrift.calibration.codes import device_adc
from undrift.calibration.reference import leave_one_out
from undrift.correction.correct import correct
from undrift.correction.motion import fit_motion
from undrift.correction.rest import find_rest_offset
from undrift.model import Calibration
from undrift.record import Record
from undrift.units import STANDARD_GRAVITY
from undrift.validation.trial import OffsetChoice, TrialSettings, validate_trial

SOURCE = (
    "BROAD, Laidig et al., Data 6(7), 72, 2021, CC BY 4.0: the eight available trials, two minutes each, three devices"
)
OPTICS, MOTION = "calibrated with optics, other trials", "calibrated from motion only, other trials"
# The result of leave-one-out includes the offset from the held-out trial's rest
STEPS: tuple[tuple[str, OffsetChoice], ...] = (("as read", "none"), ("offset of the rest", "rest"), (OPTICS, "none"),
    (OPTICS, "motion"), (MOTION, "rest"), (MOTION, "motion"))  # fmt: skip
OWN = "settings of the fit were chosen on BROAD trials; constants on the device's other trials"
NOTHING = "nothing: defaults of the program"
OFFSETS = {"none": "", "rest": "", "motion": ", offset of the recording from its motion"}


def calibrations(numbers: Sequence[str]) -> dict[str, list[Calibration | None]]:
    """Return what each trial of a device is corrected by, from its other trials."""
    every = pairs(numbers)
    records, references = [p[0] for p in every], [p[1] for p in every]
    adc = device_adc(records)
    optics: list[Calibration | None] = [
        Calibration(
            device="", reference_temp_c=np.nan, gravity_m_s2=STANDARD_GRAVITY, gyro=single.model, adc=adc,
            verdict=single.fit.triad.verdict,
        )
        for single in leave_one_out(records, references, adc=adc)
    ]  # fmt: skip
    motion: list[Calibration | None] = [
        calibrate_from_motion([other for other in records if other is not record]) for record in records
    ]
    return {OPTICS: optics, MOTION: motion}


def without_offset(record: Record, calibration: Calibration | None, offset: OffsetChoice) -> Record:
    """Return the corrected readings, SI, without the offset that the recording shows."""
    done = record.in_si() if calibration is None else correct(record, calibration)
    gyro = np.asarray(done.gyro)
    rest = None if offset == "none" else find_rest_offset(done)
    if rest is not None and offset == "rest":
        gyro = gyro - rest.rate
    if offset == "motion":
        gyro = gyro - fit_motion(done, rest, None if calibration is None else calibration.gyro).offset.at(done.time)
    return replace(done, gyro=gyro)


def errors() -> Iterator[tuple[str, str, str, tuple[float, float]]]:
    """Yield method, program, trial and end error, total and inclination, deg."""
    for numbers in DEVICES.values():
        models = calibrations(numbers)
        for name, offset in STEPS:
            for k, (number, pair) in enumerate(zip(numbers, pairs(numbers), strict=True)):
                calibration = models[name][k] if name in models else None
                judged = validate_trial(*pair, calibration=calibration, settings=TrialSettings(offset=offset))
                method = name + OFFSETS[offset]
                figures = judged.figures
                yield method, "strapdown", number, (figures.end_total_deg, figures.end_inclination_deg)
                if calibration is not None:
                    yield method, "undrift orient, VQF", number, by_vqf(judged, *pair, calibration, offset)
                fed = without_offset(pair[0], calibration, offset)
                readings = {"gyr": np.asarray(fed.gyro), "acc": np.asarray(fed.accel)}
                for program, q in by_others("orientation", **readings, hz=fed.sample_rate_hz).items():
                    yield method, program, number, end_errors(judged, fed, pair[1], fed.time, q)


def tables() -> Iterator[Table]:
    """Yield total error and inclination."""
    results: dict[tuple[str, str], dict[str, tuple[float, float]]] = {}
    for method, program, number, ends in errors():
        results.setdefault((method, program), {})[number] = ends
        print(f"{number} {method}, {program}: {ends[0]:.2f} deg, inclination {ends[1]:.2f}", flush=True)
    recordings = [number for numbers in DEVICES.values() for number in numbers]
    for k, (name, title) in enumerate((("end", "Orientation at the end"), ("inclination", "Inclination at the end"))):
        yield Table(
            name=name,
            title=f"{title} of two minutes of motion (BROAD)",
            unit="deg",
            what="The error against the optics is the median of three seconds after the motion.",
            source=SOURCE,
            recordings=recordings,
            rows=[
                Row(
                    method=method,
                    program=program,
                    values=[ends[number][k] for number in recordings],
                    tuned=_tuned(method, program),
                )
                for (method, program), ends in results.items()
            ],
        )


def _tuned(method: str, program: str) -> str:
    parts = [OWN] if method.startswith((OPTICS, MOTION)) else []
    if program != "strapdown" and not program.startswith("undrift"):
        parts.append(f"filter on {NOTHING}")
    return "; ".join(parts) or "nothing"
