"""``undrift validate``: determine errors in degrees against an orientation reference, before and after a calibration."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Literal

from undrift.base.options import Files, Flag, OptionalOutput, Side
from undrift.calibration.calibrate import calibrate_to_references
from undrift.calibration.triads import check_triads
from undrift.commands.files import Opening, Optics, Reader, check_physical, named_columns, recordings_of
from undrift.commands.outputs import check_folder, name_of, origin_of, write_results
from undrift.commands.trials_table import validate_people
from undrift.errors import InputError
from undrift.findings import Finding
from undrift.io.store import write_calibration
from undrift.model import Calibration
from undrift.record import Mounting, Record, Reference, Session
from undrift.report import Report
from undrift.report.validation import Comparison, validation_report
from undrift.screen import part, progress, reading
from undrift.validation.agreement import MOUNTING_ABOVE, Validation, validate_leave_one_out, validate_trials
from undrift.validation.levels import LevelTable, LevelTrial, judge_levels
from undrift.validation.trial import TrialSettings, check_poses

READ, COMPARED = 0.3, 0.7  # progress after reading, and after comparing the recordings


def validate(
    *records: Files,
    optics: Optics = Optics(),
    calibration: Path | None = None,
    calibrate_from: Literal["reference"] | None = None,
    leave_one_out: Flag = False,
    offset: Literal["none", "rest", "motion"] = "rest",
    forward: Side | None = None,
    up: Side | None = None,
    max_lag_s: float = 5.0,
    trials: Path | None = None,
    output: OptionalOutput = None,
    opening: Opening = Opening(),
) -> Report:
    """Compare recordings with an optical reference: errors in degrees at each level of correction.

    Parameters
    ----------
    records : Path
        One or more recordings, one folder with session.toml, or with --trials the folder of the table.
    calibration : Path or None
        calibration.json of the device, or a folder of calibrations: the newest one with the recordings' serial number.
    calibrate_from : str or None
        "reference" fits the gyroscopes to the references of these recordings, which must be from one device. A session.toml can
        contain the serial number, local gravity, and `mounting = "one"`.
    leave_one_out : bool
        With --calibrate-from: each recording is compared after a fit to the others.
    offset : str
        "rest" subtracts the mean rate of the first still phase. "motion" starts from that rest, if there is one, and estimates
        the offset from gravity while the device moves. "none" subtracts nothing.
    forward : str or None
        Body axis that points forward on the upright segment. With --up it defines the pitch. Without both, the axes are +x and +z,
        and if the calibration has a mounting, the readings are rotated with it.
    up : str or None
        Body axis that points up on the upright segment.
    max_lag_s : float
        Largest lag between the clocks of recording and reference, in either direction, s.
    trials : Path or None
        Table in the folder, one row per recording with person, task, device and reference, for errors over people, by task and by
        device.
    output : Path or None
        Folder for validation.json, report.html and, with --calibrate-from, calibration.json.
    """
    if leave_one_out and calibrate_from is None:
        raise InputError("validate: `leave_one_out` requires `calibrate_from` reference. Give both, or neither.")
    if calibrate_from is not None and calibration is not None:
        raise InputError("validate: `calibration` and `calibrate_from` exclude each other. Give one of them.")
    if not 0.0 < max_lag_s < math.inf:
        raise InputError(
            f"`max_lag_s` must be more than 0 s, got {max_lag_s:g}. Give the largest lag between the clocks."
        )
    check_folder(output)
    settings = TrialSettings(longest_lag_s=max_lag_s, forward=forward or "+x", up=up or "+z")
    if trials is not None:
        options = {"calibration": calibration, "calibrate_from": calibrate_from, "reference": optics != Optics()}
        if conflicts := [name for name, value in (options | {"offset": offset != "rest"}).items() if value]:
            raise InputError(f"validate: `{conflicts[0]}` cannot be combined with `trials`. Write it in the table.")
        if len(records) != 1:
            raise InputError(f"validate: `trials` needs one folder that contains the table, got {len(records)} paths.")
        report, inputs = validate_people(records[0], trials, settings=settings, forward=forward, up=up, opening=opening)
        return _written(report, output, inputs, name="levels.json")
    reader = Reader(opening, calibration, records)
    with reading(READ, *dict.fromkeys((*records, *optics.reference))):
        records, session = recordings_of(records, opening)
        pairs = optics.pairs(records, reader, command="validate", session=session)
    settings = replace(
        settings,
        offset=offset,
        mounting=reader.mounting(forward, up),
        align="level" if optics.of_cluster() and not calibrate_from else "auto",
    )
    if reader.model is None:
        for (record, reference), path in zip(pairs, records, strict=True):
            _check_readings(record, reference, path, settings, physical=calibrate_from is None)
    model, mounting = reader.model, (session and session.mounting) or "each"
    if calibrate_from is not None:
        progress("fitting to all recordings", READ)
        model = _fit(pairs, session, mounting, settings.longest_lag_s)
    names = [name_of(path) for path in records]
    with part(READ, 1.0):
        result, levels, fits = _compare(pairs, names, model, settings, mounting if leave_one_out else None)
    references = [path.name for path in optics.reference] or [""] * len(records)
    compared = Comparison(
        result=result, levels=levels, settings=settings, calibration=model,
        source=reader.path.name if reader.path else "",
        files=tuple((path.name, reference) for path, reference in zip(records, references, strict=True)),
    )  # fmt: skip
    findings = fits if compared.fitted else tuple(reader.findings)
    notes = (*(session.notes if session else ()), *reader.notes)
    inputs = tuple(path for path in (*records, *optics.reference, reader.path) if path is not None)
    return _written(validation_report(compared, findings, notes), output, inputs, fitted=compared.fitted and model)


def _check_readings(
    record: Record, reference: Reference, path: Path, settings: TrialSettings, *, physical: bool
) -> None:
    """Without a calibration, raise for readings without a physical unit, and for columns that a fit would mistake for other
    axes."""
    if physical:
        check_physical(record, path)
    with named_columns(path):
        check_triads(record)
        check_poses(record, reference, settings.longest_lag_s)


def _fit(
    pairs: list[tuple[Record, Reference]],
    session: Session | None,
    mounting: Mounting,
    longest_lag_s: float,
) -> Calibration:
    """Return the calibration fitted to all references."""
    stated = session is not None and session.gravity_source != "standard"
    gravity_m_s2 = session.gravity_m_s2 if session is not None and stated else None
    records, references = [record for record, _ in pairs], [reference for _, reference in pairs]
    model = calibrate_to_references(
        records, references, mounting=mounting, longest_lag_s=longest_lag_s, gravity_m_s2=gravity_m_s2
    )
    return model if session is None else replace(model, device=session.serial or model.device)


def _compare(
    pairs: list[tuple[Record, Reference]],
    names: list[str],
    model: Calibration | None,
    settings: TrialSettings,
    leave_one_out: Mounting | None,
) -> tuple[Validation, LevelTable, tuple[Finding, ...]]:
    """Compare the recordings with one calibration, or each with the fit to the others, and at each level of correction.

    Also return the findings of the fits.
    """
    calibrations, findings = [model] * len(pairs), () if model is None else model.verdict.findings
    with part(0.0, COMPARED):
        if leave_one_out is None:
            result = validate_trials(pairs, calibrations=(model,), settings=settings, names=names, progress=progress)
        else:
            result = validate_leave_one_out(
                pairs, settings=settings, mounting=leave_one_out, names=names, progress=progress
            )
            if leave_one_out == "each":
                settings = replace(settings, align_above=min(settings.align_above, MOUNTING_ABOVE))
            calibrations = [model and replace(model, gyro=held_out.fit.triad.model) for held_out in result.held_out]
            findings = tuple(item for held_out in result.held_out for item in held_out.fit.triad.verdict.findings)
    trials = [
        LevelTrial(
            recording=name, record=record, reference=reference, calibration=calibration,
            mounting=settings.mounting, cluster=settings.align == "level", clocks=trial.clocks,
        )
        for name, (record, reference), calibration, trial in zip(names, pairs, calibrations, result.trials, strict=True)
    ]  # fmt: skip
    with part(COMPARED, 1.0):
        return result, judge_levels(trials, settings=settings, progress=progress), findings


def _written(
    report: Report,
    folder: Path | None,
    inputs: tuple[Path, ...],
    *,
    fitted: Calibration | Literal[False] | None = None,
    name: str = "validation.json",
) -> Report:
    """Write the JSON file, the page and the fitted calibration. Return the report with the names of the files."""
    if folder is None:
        return report
    origin = origin_of(*inputs)
    folder.mkdir(exist_ok=True)
    report = replace(report, written=[folder / name, folder / "report.html"])
    if fitted:
        made_from = replace(fitted.provenance, inputs=origin.inputs)
        write_calibration(replace(fitted, provenance=made_from), folder / "calibration.json")
        report = replace(report, written=[*report.written, folder / "calibration.json"])
    write_results(folder, report, "validate", origin, name=name)
    return report
