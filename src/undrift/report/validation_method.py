"""What was done before a validation's figures: calibration, offset, ADC, lag, mounting, and which samples count."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from undrift.calibration.model import Verdict
from undrift.report.page import Section
from undrift.units import RADIAN_PER_DEGREE

if TYPE_CHECKING:
    from undrift.calibration.model import Calibration
    from undrift.validation import Trial, TrialSettings

_ALIGNED = {
    "auto": "the rotation between the device's case and the reference's body, from their rates, is undone where it exceeds 5 deg",
    "rates": "the rotation between the device's case and the reference's body, from their rates, is undone",
    "none": "the device's case is taken for the reference's body",
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Method:
    """What was asked of a validation.

    Parameters
    ----------
    recordings : tuple of str
        File of each recording.
    references : tuple of str
        File of each one's reference; empty where the recordings hold their own.
    calibration : Calibration or None
        That judged the recordings; the fit to all of them in leave-one-out; None where they were judged as they come.
    source : str
        File of the calibration; empty where it was fitted to the references.
    leave_one_out : bool
        Each recording was judged by a fit to the others.
    verdict : Verdict
        Of the calibration, or of the fits to the others.
    settings : TrialSettings
        Offset, ADC, axes of the pitch, search of the lag.
    """

    recordings: tuple[str, ...]
    references: tuple[str, ...]
    calibration: "Calibration | None"
    source: str
    leave_one_out: bool
    verdict: Verdict
    settings: "TrialSettings"


def method_section(method: Method) -> Section:
    """Return what was done, one row a choice.

    Parameters
    ----------
    method : Method
        What was asked.

    Returns
    -------
    Section
        In words.
    """
    settings = method.settings
    rows = [("calibration", _calibration(method))]
    if method.calibration is not None:
        rows += [("its verdict", method.verdict.status), *(("", reason) for reason in method.verdict.reasons)]
    rows += [
        ("gyroscope's offset", _offset(method)),
        ("ADC's rounding", _adc(method)),
        (
            "start",
            f"tilt from the specific force, heading from the reference, both over the last {settings.rest_s:g} s of rest or less; "
            f"from {settings.lead_s:g} s before the motion the gyroscope alone",
        ),
        ("pitch", f"in the body's plane of {settings.forward} (forward) and {settings.up} (up)"),
        (
            "lag",
            f"looked for up to {settings.lag.longest_lag_s:g} s either way; one up to {settings.undo_lag_above_s * 1e3:g} ms is "
            "the sensor's own and stays in the figures, a longer one is undone",
        ),
        ("mounting", _ALIGNED[settings.align]),
    ]
    return Section(title="What was done", columns=("what", "how"), rows=tuple(rows), words=True)


def recordings_section(method: Method, trials: "tuple[Trial, ...]") -> Section:
    """Return what was found of each recording before it was judged, one row a recording.

    Parameters
    ----------
    method : Method
        What was asked.
    trials : tuple of Trial
        Recordings judged, in the same order.

    Returns
    -------
    Section
        Files, motion, lag, mounting, and how much of the whole file the reference saw.
    """
    references = method.references or ("the same file",) * len(trials)
    return Section(
        title="Recordings",
        text=("The motion, over which the errors count, is shaded in each figure of errors.",),
        columns=(
            "recording",
            "reference",
            "motion (s)",
            "lag found (ms)",
            "lag in the figures",
            "mounting (deg)",
            "optics seen, whole file (%)",
        ),
        rows=tuple(
            (file, reference, *_found(trial))
            for file, reference, trial in zip(method.recordings, references, trials, strict=True)
        ),
    )


def _found(trial: "Trial") -> tuple[str, ...]:
    lag = trial.lag
    return (
        f"{trial.motion.start_s:.1f} to {trial.motion.stop_s:.1f}",
        f"{lag.seconds * 1e3:.2f} +- {lag.standard_uncertainty * 1e3:.2f}",
        "undone" if trial.lag_undone else "left in",
        _mounting(trial),
        f"{100.0 * trial.figures.valid_optics_file:.1f}",
    )


def _mounting(trial: "Trial") -> str:
    if trial.mounting is None:
        return "not seen"
    return (
        f"{trial.mounting.alignment.angle / RADIAN_PER_DEGREE:.1f}, {'undone' if trial.mounting.applied else 'left in'}"
    )


def _calibration(method: Method) -> str:
    made = method.calibration
    if made is None:
        return "none: readings as they come, in the unit of their file"
    if method.leave_one_out:
        return "leave-one-out: each recording judged by a gyroscope fit to the references of the others"
    if not method.source:
        return "gyroscope fitted to the references of these same recordings, which flatters the figures: --leave-one-out does not"
    triads = [f"{name} by {t.method}" for name, t in (("gyroscope", made.gyro), ("accelerometer", made.accel)) if t]
    tables = "" if made.drift is None else ", with tables over temperature"
    return f"{method.source} of {made.device or 'a device without a name'}: {', '.join(triads)}{tables}"


def _offset(method: Method) -> str:
    rest = "the mean rate of the rest before the motion was taken off"
    if method.leave_one_out:
        return "the fit's: each recording's rest before the motion, and what the others' motion added"
    if method.settings.offset == "rest":
        return rest if method.calibration is None else f"the calibration's, and {rest} after it"
    return "left as it is" if method.calibration is None else "the calibration's alone"


def _adc(method: Method) -> str:
    if method.settings.adc == "none":
        return "left in"
    made = method.calibration
    if made is None:
        return "given back where the codes show one; the recording's notes say where"
    if made.adc is None:
        return "none known to the calibration: left in"
    words = [
        f"{name} {rounding.replace('_', ' ')}"
        for name, lsb, rounding in (
            ("gyroscope", made.adc.gyro_lsb, made.adc.gyro_rounding),
            ("accelerometer", made.adc.accel_lsb, made.adc.accel_rounding),
        )
        if lsb is not None
    ]
    return f"as the calibration knows it ({', '.join(words)}): what the codes lost was given back"
