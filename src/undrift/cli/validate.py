"""``undrift validate``: what a calibration is worth in degrees, against an orientation reference."""

import math
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from undrift.cli.common import (
    CalibrationDetails,
    Files,
    Flag,
    Json,
    Opening,
    Optics,
    OptionalOutput,
    Place,
    Policy,
    Report,
    Side,
    Steps,
    check_folder,
    check_physical,
    check_report,
    name_of,
    named_columns,
    origin_of,
    recordings_of,
    save_json,
    say,
    show_table,
    show_verdict,
    write_json,
)
from undrift.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable

    from undrift.calibration.reference import ReferenceSettings
    from undrift.model import Calibration
    from undrift.record import Record, Reference, Session
    from undrift.report.page import Origin
    from undrift.report.validation import Method
    from undrift.validation.agreement import Validation
    from undrift.validation.trial import Trial, TrialSettings

SHOWN = {
    "rmse_total_deg": "total",
    "rmse_inclination_deg": "inclination",
    "rmse_pitch_deg": "pitch",
    "max_abs_pitch_deg": "pitch max",
    "end_total_deg": "end total",
    "end_inclination_deg": "end incl.",
    "lag_ms": "lag ms",
}
ALL_FITTED = 0.25  # share of the time of leave-one-out that the fit to all recordings takes
SHOWN_SHARE = 0.0005  # a difference between shares that a percentage with one digit shows


def validate(
    *records: Files,
    optics: Optics = Optics(),
    place: Place = Place(),
    calibration: Path | None = None,
    calibrate_from: Literal["reference"] | None = None,
    leave_one_out: Flag = False,
    mounting: Literal["each", "one"] | None = None,
    offset: Literal["none", "rest"] | None = None,
    adc: Literal["auto", "none"] = "auto",
    forward: Side = "+x",
    up: Side = "+z",
    power_on_s: float | None = None,
    policy: Policy = "raise",
    max_lag_s: float = 5.0,
    output: OptionalOutput = None,
    report: Report = None,
    opening: Opening = Opening(),
    details: CalibrationDetails = False,
    json: Json = False,
) -> int:
    """Compare recordings with an optical reference: lag, errors in degrees, agreement over trials.

    Parameters
    ----------
    records : Path
        One or more recordings, or one folder with session.toml.
    optics : Optics
        The reference of each recording.
    place : Place
        With --calibrate-from: local gravity, and the device.
    calibration : Path or None
        calibration.json of the device.
    calibrate_from : str or None
        "reference" fits the gyroscopes to the references of these recordings, which must be of one device.
    leave_one_out : bool
        With --calibrate-from: each recording is judged by a fit to the others.
    mounting : str or None
        With --calibrate-from: "each" fits a small rotation between device and reference body for each recording, "one" states that
        they were mounted once. Without it: as session.toml says, or each.
    offset : str or None
        "rest" subtracts the mean rate of the first still phase, as correct and orient do, "none" does not. Without a
        calibration: rest.
    adc : str
        "auto" corrects the quantisation of the codes where it shows and, with --calibrate-from, where that lowers the error on
        recordings that a fit has not seen: by two recordings or more, the held-out one apart. "none" leaves them.
    forward : str
        Body axis that points forward on the upright segment: with --up it defines the pitch.
    up : str
        Body axis that points up on the upright segment.
    power_on_s : float or None
        Time since power-on at the first sample of each recording, s; without it no warm-up is subtracted.
    policy : str
        Temperatures outside a tuning table: refuse (raise), hold the table's end, or leave a gap (nan). Where no
        temperature was recorded the result is a gap under each, and a warning says for how long.
    max_lag_s : float
        Largest lag between the clocks of recording and reference, either way, s.
    output : Path or None
        Folder for validation.json, report.html and, with --calibrate-from, calibration.json.
    report : Path or None
        Report page to write: .html; without a folder.
    opening : Opening
        How to read foreign recordings.
    """
    from undrift.calibration.reference import ReferenceSettings
    from undrift.io.store import read_calibration
    from undrift.sync import LagSettings
    from undrift.validation.trial import TrialSettings

    _check_asked((leave_one_out, mounting, place), calibrate_from, calibration, max_lag_s)
    check_folder(output)
    check_report(report, reads=(*records, *optics.reference, calibration))
    chosen = offset or ("none" if calibration or calibrate_from else "rest")
    settings = TrialSettings(
        offset=chosen, adc=adc, forward=forward, up=up, power_on_s=power_on_s, policy=policy,
        lag=LagSettings(longest_lag_s=max_lag_s),
    )  # fmt: skip
    with Steps("validate") as shown:
        model = None if calibration is None else read_calibration(calibration)
        records, held = recordings_of(records, opening, place)
        pairs = optics.pairs(records, opening.like(model, calibration), command="validate", session=held)
        fit = ReferenceSettings(mounting=mounting or (held and held.mounting) or "each") if calibrate_from else None
        shown("aligning and integrating", 0.02)
        progress = shown.part(ALL_FITTED, 1.0) if leave_one_out else None
        named = (records, optics.reference)
        result, method = _judged(pairs, named, (calibration, model), settings, progress, fit, (place, held))
    made = _validation_json(result) | {"calibration": calibration.name if calibration else calibrate_from}
    made |= {"offset": chosen, "adc": adc, "leave_one_out": leave_one_out} | _gravity(method)
    _write((output, report), result, made, method, origin_of(*records, *optics.reference, calibration))
    if json:
        write_json(made, "validate")
    else:
        _show(result, chosen, in_sample=calibrate_from is not None and not leave_one_out)
        if details and method.calibration is not None:
            show_verdict(method.verdict, details=True)
        say(*_written(output, report, _gravity(method)))
    return 0


def _check_asked(
    of_fit: tuple[bool, str | None, Place], calibrate_from: str | None, calibration: Path | None, max_lag_s: float
) -> None:
    leave_one_out, mounting, place = of_fit
    given = {"leave_one_out": leave_one_out or None, "mounting": mounting} | asdict(place)
    asked = [name for name, value in given.items() if value not in (None, "")]
    if calibrate_from is None and asked:
        name = "--" + asked[0].replace("_", "-")
        raise InputError(f"validate: {name} wants --calibrate-from reference; say both, or neither")
    if calibrate_from is not None and calibration is not None:
        raise InputError("validate: wanted --calibration or --calibrate-from, got both; choose one")
    if not 0.0 < max_lag_s < math.inf:
        raise InputError(f"--max-lag-s: wanted more than 0 s, got {max_lag_s:g}; say how far the clocks may differ")


def _gravity(method: "Method") -> dict[str, object]:
    """Return local gravity of a calibration that was fitted here, and where it comes from."""
    made = method.calibration
    if made is None or method.source:
        return {"gravity_m_s2": None, "gravity_source": None}
    return {"gravity_m_s2": made.gravity_m_s2, "gravity_source": dict(made.provenance.settings)["gravity"]}


def _written(folder: Path | None, page: Path | None, gravity: dict[str, object]) -> list[str]:
    named = ["gravity {:.5f} m/s2 ({})".format(*gravity.values())] if gravity["gravity_source"] else []
    named += [] if page is None else [f"Wrote {page}"]
    return named if folder is None else [*named, f"Wrote {folder}: look at report.html"]


def _write(
    places: tuple[Path | None, Path | None],
    result: "Validation",
    made: dict[str, object],
    method: "Method",
    origin: "Origin",
) -> None:
    from undrift.io.store import write_calibration
    from undrift.report.validation import write_validation_report

    folder, page = places
    if page is not None:
        write_validation_report(result, method, page, origin)
    if folder is not None:
        folder.mkdir(exist_ok=True)
        write_validation_report(result, method, folder / "report.html", origin)
        save_json(folder / "validation.json", made)
        if method.calibration is not None and not method.source:
            made_from = replace(method.calibration.provenance, inputs=origin.inputs)
            write_calibration(replace(method.calibration, provenance=made_from), folder / "calibration.json")


def _validation_json(result: "Validation") -> dict[str, object]:
    from undrift.io.store import findings_json

    agreement = None
    if result.agreement is not None:
        limits, absolute = result.agreement.limits, result.agreement.absolute
        agreement = {
            "quantity": "mean inclination of a trial",
            "bias_deg": limits.bias,
            "bias_interval_deg": limits.bias_interval,
            "limits_deg": limits.limits,
            "icc": absolute.value,
            "icc_interval": absolute.interval,
            "icc_kind": absolute.kind,
            "sem_deg": absolute.standard_error_of_measurement,
            "mdc95_deg": absolute.minimal_detectable_change,
        }
    trials = [
        {"recording": t.recording}
        | asdict(t.figures)
        | {"expected": None if t.expected is None else asdict(t.expected), "rest": t.rest and t.rest.figures}
        | {"notes": [item.text for item in t.findings], "findings": findings_json(t.findings)}
        for t in result.trials
    ]
    return {
        "trials": trials,
        "mean": asdict(result.mean),
        "median": asdict(result.median),
        "agreement": agreement,
        "expected_inside": None if result.coverage is None else asdict(result.coverage),
    }


def _check_scale(trial: "Trial") -> None:
    """Refuse a device with over twice or under half the rate of its reference: degrees for radians, most likely."""
    import numpy as np

    times = 1.0 / float(np.linalg.norm(trial.lag.matrix, ord=2))  # the matrix maps readings to the reference's rate
    if not 0.5 < times < 2.0:
        raise InputError(
            f"{trial.recording}: wanted rates in the unit that is stated, got {times:.3g} times those of the reference; check the "
            "unit and the scale of the gyroscope"
        )


def _judged(
    pairs: list[tuple["Record", "Reference"]],
    named: tuple[tuple[Path, ...], tuple[Path, ...]],
    read: "tuple[Path | None, Calibration | None]",
    settings: "TrialSettings",
    leave_one_out: "Callable[[str, float], None] | None",
    fit: "ReferenceSettings | None",
    where: "tuple[Place, Session | None]",
) -> tuple["Validation", "Method"]:
    """Return the validation, and how it was made: by the calibration that was read or fitted to all recordings, or none."""
    from undrift.calibration.calibrate import calibrate_to_references
    from undrift.correction.consistency import check_triads
    from undrift.model import Verdict
    from undrift.report.validation import Method
    from undrift.validation.agreement import MOUNTING_ABOVE, validate_leave_one_out, validate_trials
    from undrift.validation.trial import check_poses

    (paths, references), (calibration, model) = named, read
    records, held, names = [pair[0] for pair in pairs], [pair[1] for pair in pairs], [name_of(path) for path in paths]
    for readings, reference, path in zip(records, held, paths, strict=True):
        if calibration is None and fit is None:
            check_physical(readings, path)
        if calibration is None:  # a fit would take exchanged or reversed columns for its own axes
            with named_columns(path):
                check_triads(readings)
                check_poses(readings, reference, settings)
    if fit is not None:
        place, session = where
        gravity_m_s2, source = place.gravity() if session is None else (session.gravity_m_s2, session.gravity_source)
        model = calibrate_to_references(
            records,
            held,
            adc=settings.adc,
            settings=fit,
            lag_settings=settings.lag,
            gravity_m_s2=None if source == "standard" else gravity_m_s2,
            gravity_source=source,
        )
        model = replace(model, device=(place.serial if session is None else session.serial) or model.device)
    result = (
        validate_leave_one_out(pairs, settings=settings, fit_settings=fit, names=names, progress=leave_one_out)
        if leave_one_out is not None and fit is not None
        else validate_trials(pairs, calibrations=(model,), settings=settings, names=names)
    )
    for trial in result.trials:
        _check_scale(trial)
    if result.held_out and fit is not None and fit.mounting == "each":
        settings = replace(settings, align_above=min(settings.align_above, MOUNTING_ABOVE))
    verdict = Verdict() if model is None or result.held_out else model.verdict
    for left_out in result.held_out:
        verdict = verdict.also(left_out.fit.triad.verdict)
    return result, Method(
        recordings=tuple(path.name for path in paths),
        references=tuple(path.name for path in references),
        calibration=model,
        source=calibration.name if calibration else "",
        leave_one_out=bool(result.held_out),
        verdict=verdict,
        settings=settings,
    )


def _show(result: "Validation", offset: str, *, in_sample: bool) -> None:
    from undrift.report.validation import OPTICS_SEEN, PITCH_DEFINED, coverage_text, expected_rows

    figures_of = [(trial.recording, trial.figures) for trial in result.trials]
    if len(figures_of) > 1:
        figures_of += [("mean", result.mean), ("median", result.median)]
    rows = [
        (
            name,
            *(f"{getattr(figures, key):.2f}" for key in SHOWN),
            *(_percent(share) for share in (figures.pitch_defined, figures.valid_optics)),
        )
        for name, figures in figures_of
    ]
    title = f"error against the reference in deg: rmse over the motion, largest, median after it (offset: {offset})"
    show_table(title, ("recording", *SHOWN.values(), "pitch %", "optics %"), rows)
    lines = []
    if result.coverage is not None:
        columns = ("recording", "end total", "expected", "at most", "total", "expected", "at most")
        show_table("observed and expected errors in deg (at most: 95 %)", columns, expected_rows(result.trials))
        lines.append(coverage_text(result.coverage))
    if result.agreement is not None:
        limits, icc = result.agreement.limits, result.agreement.absolute
        lines.append(
            f"agreement on mean inclination over {limits.count} trials: bias {limits.bias:+.2f} deg, 95 % limits "
            f"{limits.limits[0]:+.2f} to {limits.limits[1]:+.2f} deg; {icc.kind} {icc.value:.3f} "
            f"[{icc.interval[0]:.3f}, {icc.interval[1]:.3f}]"
        )
    if any(figures.pitch_defined < 1.0 for _, figures in figures_of):
        lines.append(PITCH_DEFINED.replace("Pitch defined", "pitch %"))
    least = min(trial.figures.valid_optics_file for trial in result.trials)
    if least < min(trial.figures.valid_optics for trial in result.trials) - SHOWN_SHARE:
        whole = f"{_percent(least)} %" + (" or more" if len(result.trials) > 1 else "")
        lines.append(f"{OPTICS_SEEN.replace('Optics seen', 'optics %')} of the whole file it is {whole}")
    if in_sample:
        lines.append("these recordings made the calibration that they judge: say --leave-one-out for an honest figure")
    for note in dict.fromkeys(item.text for trial in result.trials for item in trial.findings):
        noted = [trial.recording for trial in result.trials if note in (item.text for item in trial.findings)]
        who = "every recording" if 1 < len(noted) == len(result.trials) else ", ".join(noted)
        lines.append(f"  {who}: {note}")
    say(*lines)


def _percent(share: float) -> str:
    return f"{100.0 * share:.1f}"
