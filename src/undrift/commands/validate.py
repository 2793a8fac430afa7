"""``undrift validate``: errors in degrees against an orientation reference, before and after a calibration."""

import math
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from undrift.base.options import Files, Flag, OptionalOutput, Side, verb
from undrift.base.summary import Result, Section, Summary, at, figure_of
from undrift.commands import Progress, part_of, reading, silent
from undrift.commands.calibration_file import choose_calibration
from undrift.commands.files import (
    Opening,
    Optics,
    Place,
    check_folder,
    check_physical,
    name_of,
    named_columns,
    origin_of,
    recordings_of,
    save_json,
    worn_by,
)
from undrift.commands.levels import PeopleValidated, levels_json, levels_sections, validate_people
from undrift.errors import InputError
from undrift.findings import Verdict, told_apart
from undrift.units import RADIAN_PER_DEGREE

if TYPE_CHECKING:
    from undrift.model import Calibration
    from undrift.record import Mounting, Record, Reference, Session
    from undrift.validation.agreement import Validation
    from undrift.validation.levels import LevelTable
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
READ, COMPARED = 0.3, 0.55  # shares of the time when all is read, and when the recordings are compared
PITCH_DEFINED = (
    "pitch %: share of the samples in which pitch is defined. It is left out where the body lies within 5 deg of its side, and "
    "near there pitch max may exceed the error in space."
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Validated(Result):
    """Recordings compared with their references."""

    result: "Validation"
    levels: "LevelTable"
    files: tuple[tuple[str, str], ...]  # each recording and its reference, empty if the recording contains it
    calibration: "Calibration | None"  # that was read, or fitted to all recordings
    source: str  # file of the calibration, empty if it was fitted to the references
    verdict: Verdict  # of the calibration, or of the fits to the others
    settings: "TrialSettings"
    output: Path | None = None
    notes: tuple[str, ...] = ()  # which calibration was taken from a folder

    @property
    def judged(self) -> Verdict | None:
        """The verdict, if there is a calibration."""
        return None if self.calibration is None else self.verdict

    @property
    def fitted(self) -> bool:
        """Whether the calibration was fitted to the references."""
        return self.calibration is not None and not self.source

    @property
    def data(self) -> dict[str, object]:
        """Content of the JSON output and of validation.json."""
        from undrift.io.store import findings_json, verdict_json

        trials = [
            {"recording": trial.recording}
            | asdict(trial.figures)
            | {"expected_end_deg": trial.expected and trial.expected.end_total_deg}
            | {"expected": trial.expected and asdict(trial.expected), "within_expected": trial.within_expected}
            | {"rest": trial.rest and trial.rest.figures, "findings": findings_json(trial.findings)}
            for trial in self.result.trials
        ]
        return {
            "trials": trials,
            "mean": asdict(self.result.mean),
            "median": asdict(self.result.median),
            "levels": levels_json(self.levels),
            "calibration": "reference" if self.fitted else self.source or None,
            "leave_one_out": bool(self.result.held_out),
            "offset": self.settings.offset,
            "verdict": self.judged and verdict_json(self.judged),
        }

    def summary(self) -> Summary:
        """Return the errors before and after, and how they were determined."""
        trials = self.result.trials
        many = len(trials) > 1
        courses = [figure_of("figures:trial_figure", trial) for trial in trials]
        first = figure_of("figures:draw_validation", self.result) if many else courses[0]
        sections = [trials_section(trials, self.result if many else None), *_expected(trials), *_remarks(trials)]
        sections += [*levels_sections(self.levels), self._method(), self._recordings()]
        for trial, course in zip(trials, courses, strict=True):
            one = Section(title=trial.recording, findings=trial.findings, pictures=(course,), folded=True, on="page")
            sections += [one] if many else []
        return Summary(
            title=f"Against the reference: {len(trials)} recording{'s' * many}",
            answer=self._answer(),
            data=self.data,
            pictures=(first, figure_of("figures:draw_level_errors", self.levels)),
            sections=tuple(sections),
            findings=tuple(item for trial in trials for item in trial.findings),
            verdict=self.judged,
            judged="the calibration",
            brief=True,
            notes=self.notes,
            written=(self.output,),
        )

    def _answer(self) -> str:
        """Return the error before and after, and whether it is within the predicted limits."""
        import numpy as np

        result, quantity = self.result, self.levels.quantity
        before = self.levels.errors[0].error_deg  # the first level is uncalibrated
        parts = [f"{np.nanmedian(before):.3g} deg raw"] if np.isfinite(before).any() else []
        if self.calibration is not None or self._is_zeroed():
            parts.append(f"{getattr(result.median, f'rmse_{quantity}_deg'):.2g} deg {self._correction()}")
        over = f", median of {len(result.trials)} recordings" if len(result.trials) > 1 else ""
        answer = f"{quantity.capitalize()} error {', '.join(parts)} (rms over the motion{over})."
        within = [trial.within_expected for trial in result.trials if trial.within_expected is not None]
        if within:
            count = f" ({sum(within)} of {len(within)} recordings)" if len(within) > 1 else ""
            answer += f" Within the predicted limits: {'yes' if all(within) else 'no'}{count}."
        return answer

    def _is_zeroed(self) -> bool:
        return any(trial.rest is not None for trial in self.result.trials)

    def _correction(self) -> str:
        """Return what was done to the readings, in words."""
        words = f"calibrated with {self.source}" if self.source else "calibrated with these same recordings"
        if self.result.held_out:
            words = "calibrated with the other recordings"
        zeroed = {"rest": "offset of the rest subtracted", "motion": "offset from motion subtracted"}
        subtracted = zeroed.get(self.settings.offset, "") if self._is_zeroed() else ""
        return ", ".join(part for part in (words if self.calibration else "", subtracted) if part)

    def _method(self) -> Section:
        """Return how the errors were determined."""
        from undrift.validation.align import LEAD_S, REST_S
        from undrift.validation.trial import END_S, OWN_LAG_S

        settings = self.settings
        above = f" if it exceeds {settings.align_above / RADIAN_PER_DEGREE:g} deg" if settings.align == "auto" else ""
        text = [
            f"Readings: {self._correction() or 'as they are'}.",
            f"Start: tilt from the specific force and heading from the reference, over the last {REST_S:g} s of rest. From "
            f"{LEAD_S:g} s before the motion on, orientation is integrated from the gyroscopes only.",
            f"Lag: a lag of up to {OWN_LAG_S * 1e3:g} ms is the sensor's own and stays in the errors. A longer lag is removed.",
            f"Mounting: the rotation between device and reference is removed{above}.",
            f"Pitch: in the plane of {settings.forward} (forward) and {settings.up} (up)"
            + (", readings turned by the mounting of the calibration." if settings.mounting else "."),
            f"Errors: root mean square over the motion, and the median of the {END_S:g} s after it (end).",
        ]
        if self.fitted and self.calibration and not self.result.held_out:
            text.append("The calibration was fitted to these recordings. Use --leave-one-out for an unbiased error.")
        return Section(title="Method", text=tuple(text), on="page")

    def _recordings(self) -> Section:
        """Return the motion, the lag and the mounting of each recording."""
        heads = ("recording", "reference", "motion (s)", "lag (ms)", "in the errors", "mounting (deg)")
        rows = []
        for (file, reference), trial in zip(self.files, self.result.trials, strict=True):
            motion, lag, mounting = trial.motion, trial.lag, "not observable"
            if trial.mounting is not None:
                angle_deg = trial.mounting.angle / RADIAN_PER_DEGREE
                mounting = f"{angle_deg:.1f}, {'removed' if trial.mounting.applied else 'left in'}"
            late = f"{lag.seconds * 1e3:.2f} +- {lag.standard_uncertainty * 1e3:.2f}"
            span = f"{motion.start_s:.1f} to {motion.stop_s:.1f}"
            rows.append((file, reference or "the same file", span, late, "no" if trial.lag_undone else "yes", mounting))
        return Section(title="Recordings", columns=heads, rows=tuple(rows), on="page")


@verb
def validate(
    *records: Files,
    optics: Optics = Optics(),
    calibration: Path | None = None,
    calibrate_from: Literal["reference"] | None = None,
    leave_one_out: Flag = False,
    gravity_m_s2: float | None = None,
    offset: Literal["none", "rest", "motion"] = "rest",
    forward: Side | None = None,
    up: Side | None = None,
    max_lag_s: float = 5.0,
    trials: Path | None = None,
    output: OptionalOutput = None,
    opening: Opening = Opening(),
    progress: Progress = silent,
) -> Validated | PeopleValidated:
    """Compare recordings with an optical reference: errors in degrees at each level of correction.

    Parameters
    ----------
    records : Path
        One or more recordings, one folder with session.toml, or with --trials the folder of the table.
    optics : Optics
        The reference of each recording.
    calibration : Path or None
        calibration.json of the device, or a folder of calibrations: the newest one of the recordings' serial number.
    calibrate_from : str or None
        "reference" fits the gyroscopes to the references of these recordings, which must be of one device. A session.toml can state
        its serial number, local gravity, and that it was mounted once.
    leave_one_out : bool
        With --calibrate-from: each recording is compared after a fit to the others.
    gravity_m_s2 : float or None
        With --calibrate-from: local gravity, m/s2; standard gravity is assumed, and reported, where nothing is given.
    offset : str
        "rest" subtracts the mean rate of the first still phase, "motion" also what gravity shows from there on, or without any
        rest, as correct and orient do. "none" does not.
    forward : str or None
        Body axis that points forward on the upright segment: with --up it defines the pitch. Without both they are +x and +z, and
        the readings are turned by the calibration's mounting, if there is one.
    up : str or None
        Body axis that points up on the upright segment.
    max_lag_s : float
        Largest lag between the clocks of recording and reference, either way, s.
    trials : Path or None
        Table in the folder, a row per recording with person, task, device and reference: errors over people, by task and by device.
    output : Path or None
        Folder for validation.json, report.html and, with --calibrate-from, calibration.json.
    opening : Opening
        How to read foreign recordings.
    progress : callable
        Called with the work and its share.
    """
    from undrift.validation.trial import TrialSettings

    for name, value in (("leave_one_out", leave_one_out), ("gravity_m_s2", gravity_m_s2)):
        if value and calibrate_from is None:
            raise InputError(f"validate: `{name}` requires `calibrate_from` reference. Give both, or neither.")
    if calibrate_from is not None and calibration is not None:
        raise InputError("validate: `calibration` and `calibrate_from` exclude each other. Give one of them.")
    if not 0.0 < max_lag_s < math.inf:
        raise InputError(
            f"`max_lag_s` must be more than 0 s, got {max_lag_s:g}. Give the largest lag between the clocks."
        )
    check_folder(output)
    settings = TrialSettings(longest_lag_s=max_lag_s, forward=forward or "+x", up=up or "+z")
    if trials is not None:
        in_table = {"calibration": calibration, "calibrate_from": calibrate_from, "reference": optics != Optics()}
        if given := [name for name, value in (in_table | {"offset": offset != "rest"}).items() if value]:
            raise InputError(f"validate: `{given[0]}` cannot be combined with `trials`. Write it in the table.")
        if len(records) != 1:
            raise InputError(f"validate: `trials` needs one folder that contains the table, got {len(records)} paths.")
        return validate_people(
            records[0],
            trials,
            settings=settings,
            forward=forward,
            up=up,
            opening=opening,
            output=output,
            progress=progress,
        )
    chosen = choose_calibration(calibration, records, opening)
    with reading(progress, READ, *dict.fromkeys((*records, *optics.reference))):
        records, session = recordings_of(records, opening, Place(gravity_m_s2=gravity_m_s2))
        pairs = optics.pairs(records, opening.like(chosen.model, chosen.path), command="validate", session=session)
    settings = replace(
        settings,
        offset=offset,
        mounting=worn_by(chosen.model, forward, up),
        align="level" if optics.of_cluster() and not calibrate_from else "auto",
    )
    for (record, reference), path in zip(pairs, records, strict=True):
        if chosen.model is None:
            _check_readings(record, reference, path, settings, physical=calibrate_from is None)
    model, mounting = chosen.model, (session and session.mounting) or "each"
    if calibrate_from is not None:
        progress("fitting to all recordings", READ)
        model = _fit(pairs, session, gravity_m_s2, mounting, settings.longest_lag_s)
    names, steps = [name_of(path) for path in records], part_of(progress, READ, 1.0)
    validated = _compare(pairs, names, model, settings, mounting if leave_one_out else None, steps)
    references = [path.name for path in optics.reference] or [""] * len(records)
    files = tuple((path.name, reference) for path, reference in zip(records, references, strict=True))
    source = chosen.path.name if chosen.path else ""
    validated = replace(validated, files=files, source=source, notes=chosen.notes, output=output)
    if output is not None:
        _write(validated, output, (*records, *optics.reference, chosen.path))
    return validated


def _check_readings(
    record: "Record", reference: "Reference", path: Path, settings: "TrialSettings", *, physical: bool
) -> None:
    """Refuse readings without a calibration in no physical unit, and columns that a fit would take for axes of its own."""
    from undrift.calibration.triads import check_triads
    from undrift.validation.trial import check_poses

    if physical:
        check_physical(record, path)
    with named_columns(path):
        check_triads(record)
        check_poses(record, reference, settings.longest_lag_s)


def _fit(
    pairs: list[tuple["Record", "Reference"]],
    session: "Session | None",
    gravity_m_s2: float | None,
    mounting: "Mounting",
    longest_lag_s: float,
) -> "Calibration":
    """Return the device calibrated by all references."""
    from undrift.calibration.calibrate import calibrate_to_references

    place: dict[str, Any] = {"gravity_m_s2": gravity_m_s2}
    if session is not None and session.gravity_source != "standard":
        place = {"gravity_m_s2": session.gravity_m_s2}
    records, references = [record for record, _ in pairs], [reference for _, reference in pairs]
    model = calibrate_to_references(records, references, mounting=mounting, longest_lag_s=longest_lag_s, **place)
    return model if session is None else replace(model, device=session.serial or model.device)


def _compare(
    pairs: list[tuple["Record", "Reference"]],
    names: list[str],
    model: "Calibration | None",
    settings: "TrialSettings",
    leave_one_out: "Mounting | None",
    progress: Progress,
) -> Validated:
    """Compare the recordings by a calibration, or each by the fit to the others, and at each level of correction."""
    from undrift.validation.agreement import MOUNTING_ABOVE, validate_leave_one_out, validate_trials
    from undrift.validation.levels import LevelTrial, judge_levels

    how: dict[str, Any] = {"names": names, "progress": part_of(progress, 0.0, COMPARED)}
    verdict, calibrations = Verdict() if model is None else model.verdict, [model] * len(pairs)
    if leave_one_out is None:
        result = validate_trials(pairs, calibrations=(model,), settings=settings, **how)
    else:
        result = validate_leave_one_out(pairs, settings=settings, mounting=leave_one_out, **how)
        if leave_one_out == "each":
            settings = replace(settings, align_above=min(settings.align_above, MOUNTING_ABOVE))
        calibrations = [model and replace(model, gyro=held_out.fit.triad.model) for held_out in result.held_out]
        verdict = Verdict()
        for held_out in result.held_out:
            verdict = verdict.also(held_out.fit.triad.verdict)
    trials = [
        LevelTrial(
            recording=name, record=record, reference=reference, calibration=calibration,
            mounting=settings.mounting, cluster=settings.align == "level", clocks=trial.clocks,
        )
        for name, (record, reference), calibration, trial in zip(names, pairs, calibrations, result.trials, strict=True)
    ]  # fmt: skip
    levels = judge_levels(trials, settings=settings, progress=part_of(progress, COMPARED, 1.0))
    return Validated(
        result=result, levels=levels, files=(), calibration=model, source="", verdict=verdict, settings=settings
    )


def _write(validated: Validated, folder: Path, inputs: tuple[Path | None, ...]) -> None:
    """Write validation.json, the page, and the calibration that was fitted."""
    from undrift.io.store import write_calibration

    origin = origin_of(*inputs)
    folder.mkdir(exist_ok=True)
    save_json(folder / "validation.json", validated.data)
    at("undrift.report.page:write_page")(folder / "report.html", validated.summary(), origin)
    if validated.fitted and validated.calibration is not None:
        made_from = replace(validated.calibration.provenance, inputs=origin.inputs)
        write_calibration(replace(validated.calibration, provenance=made_from), folder / "calibration.json")


# ---- sections


def trials_section(trials: "tuple[Trial, ...]", result: "Validation | None" = None) -> Section:
    """Return the errors, one row a trial, with mean and median if a result is given."""
    named = [(trial.recording, trial.figures) for trial in trials]
    named += [("mean", result.mean), ("median", result.median)] if result else []
    rows = []
    for name, figures in named:
        shares = (f"{100.0 * share:.1f}" for share in (figures.pitch_defined, figures.valid_optics))
        rows.append((name, *(f"{getattr(figures, key):.2f}" for key in SHOWN), *shares))
    return Section(
        title="Error against the reference in deg: rms over the motion, largest, median after it",
        columns=("recording", *SHOWN.values(), "pitch %", "optics %"),
        rows=tuple(rows),
        text=(PITCH_DEFINED,) if any(figures.pitch_defined < 1.0 for _, figures in named) else (),
    )


def _expected(trials: "tuple[Trial, ...]") -> tuple[Section, ...]:
    """Return the errors beside their predicted limits."""
    rows = []
    for trial in trials:
        if (expected := trial.expected) is not None:
            pairs = (
                (trial.figures.rmse_total_deg, expected.rmse_at_most_deg),
                (trial.figures.end_total_deg, expected.end_at_most_deg),
            )
            cells = [cell for x, most in pairs for cell in (told_apart(x, ".2f", most), told_apart(most, ".2f", x))]
            rows.append((trial.recording, *cells, "yes" if trial.within_expected else "no"))
    heads = ("recording", "total rms", "rms at most", "end total", "end at most", "within")
    text = (
        "Predicted from the uncertainty of the calibration and from what changes between recordings of a device: 95 % of the "
        "errors are at most as large.",
    )
    title = "Predicted limits in deg"
    return (Section(title=title, columns=heads, rows=tuple(rows), text=text),) if rows else ()


def _remarks(trials: "tuple[Trial, ...]") -> tuple[Section, ...]:
    """Return the findings of the recordings, as a terminal shows them."""
    lines = []
    for note in dict.fromkeys(item.text for trial in trials for item in trial.findings):
        noted = [trial.recording for trial in trials if note in (item.text for item in trial.findings)]
        lines.append(f"{'every recording' if 1 < len(noted) == len(trials) else ', '.join(noted)}: {note}")
    return (Section(title="Remarks", text=tuple(lines), on="terminal"),) if lines else ()
