"""``undrift validate``: what a calibration is worth in degrees, against an orientation reference.

The summary has a table of errors, how far they exceed what follows from the calibration's covariance, what was done, and the course
of each trial; on request each level of correction, with the errors of a simulated device next to them.
"""

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from undrift.base.options import Files, Flag, OptionalOutput, Side, options, verb
from undrift.base.summary import Origin, Result, Section, Summary, at, figure_of, rows_section
from undrift.commands import Progress, part_of, reading, silent
from undrift.commands.batch import is_plain_folder, of_folder
from undrift.commands.calibration_file import choose_calibration
from undrift.commands.files import (
    Opening,
    Optics,
    Place,
    TableUse,
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
from undrift.errors import InputError, UndriftError
from undrift.findings import Verdict, told_apart
from undrift.units import RADIAN_PER_DEGREE

if TYPE_CHECKING:
    from undrift.calibration.reference import ReferenceSettings
    from undrift.model import Calibration
    from undrift.record import Record, Reference, Session
    from undrift.validation.agreement import Coverage, Validation
    from undrift.validation.levels import LevelTable
    from undrift.validation.trial import Figures, Trial, TrialSettings

SHOWN = {
    "rmse_total_deg": "total",
    "rmse_inclination_deg": "inclination",
    "rmse_pitch_deg": "pitch",
    "max_abs_pitch_deg": "pitch max",
    "end_total_deg": "end total",
    "end_inclination_deg": "end incl.",
    "lag_ms": "lag ms",
}
# shares of the time when all is read, when the fit to all recordings is made, and when they are judged before levels are compared
READ, ALL_FITTED, JUDGED = 0.3, 0.45, 0.55
SHOWN_SHARE = 0.0005  # a difference between shares that a percentage with one digit shows
_ALIGNED = {
    "auto": "the rotation between the device's case and the reference's body, from their rates, is removed where it exceeds "
    "{above_deg:g} deg",
    "level": "the rotation between the device's case and the markers, by the vertical at rest and their rates, is removed",
}
FURTHER = (
    ("rmse_heading_deg", "heading rmse (deg)"),
    ("drift_deg_per_min", "drift (deg/min)"),
    ("mean_pitch_deg", "pitch mean (deg)"),
    ("sd_pitch_deg", "pitch sd (deg)"),
    ("range_pitch_error_deg", "pitch range (deg)"),
    ("max_total_deg", "total max (deg)"),
    ("rmse_total_before_lag_deg", "total rmse, lag left in (deg)"),
    ("rmse_total_after_lag_deg", "total rmse, lag removed (deg)"),
    ("valid_optics_file", "optics seen, share of the file"),
    ("motion_s", "motion (s)"),
    ("turn_rate_rms_dps", "rate rms (deg/s)"),
)
PITCH_DEFINED = (
    "pitch %: share of the samples in which pitch is defined; it is left out where the body lies within 5 deg of its side, "
    "and near there pitch max may exceed the error in space"
)
OPTICS_SEEN = "optics %: share of the motion in which the reference saw the body, where alone errors count;"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Validated(Result):
    """Recordings compared with their references, and how."""

    result: "Validation"
    recordings: tuple[str, ...]  # File of each recording
    references: tuple[str, ...]  # File of each one's reference; empty where the recordings hold their own
    # That judged the recordings; the fit to all of them in leave-one-out; None where they were judged as they come
    calibration: "Calibration | None"
    source: str  # File of the calibration; empty where it was fitted to the references
    leave_one_out: bool  # Each recording was judged by a fit to the others
    verdict: Verdict  # Of the calibration, or of the fits to the others
    settings: "TrialSettings"  # Offset, ADC, axes of the pitch, search of the lag
    output: Path | None = None
    notes: tuple[str, ...] = ()  # which calibration was taken from a folder
    levels: "LevelTable | None" = None  # levels of correction, if asked for

    @property
    def name(self) -> str:
        """What the recordings were corrected by, in words."""
        fitted = "the fit to the others" if self.leave_one_out else "the fit to these recordings"
        return "no calibration" if self.calibration is None else self.source or fitted

    @property
    def offset(self) -> str:
        """The offset that was subtracted: none if no trial has a rest."""
        return self.settings.offset if any(trial.rest for trial in self.result.trials) else "none"

    @property
    def gravity(self) -> dict[str, Any]:
        """Local gravity of a calibration that was fitted here, and where it comes from."""
        if self.calibration is None or self.source:
            return {"gravity_m_s2": None, "gravity_source": None}
        source = dict(self.calibration.provenance.settings)["gravity"]
        return {"gravity_m_s2": self.calibration.gravity_m_s2, "gravity_source": source}

    @property
    def judged(self) -> Verdict | None:
        """The verdict, where recordings were corrected at all."""
        return None if self.calibration is None else self.verdict

    @property
    def data(self) -> dict[str, object]:
        """What JSON has, and validation.json."""
        from undrift.io.store import verdict_json

        fitted = self.calibration is not None and not self.source
        named = {"calibration": "reference" if fitted else self.source or None, "offset": self.settings.offset}
        asked = {"adc": self.settings.adc, "leave_one_out": self.leave_one_out}
        beside: dict[str, Any] = {"levels": levels_json(self.levels)} if self.levels else {}
        about = {"verdict": self.judged and verdict_json(self.judged)}
        return _validation_json(self.result) | named | asked | self.gravity | beside | about

    def summary(self) -> Summary:
        """Return the errors of each recording, and what was done to get them."""
        result, gravity = self.result, self.gravity
        notes = ["gravity {:.5f} m/s2 ({})".format(*gravity.values())] if gravity["gravity_source"] else []
        many, means = len(result.trials) > 1, [("mean", result.mean), ("median", result.median)]
        drawn = [figure_of("figures:trial_figure", trial) for trial in result.trials]
        first = figure_of("figures:draw_validation", result) if many else drawn[0]
        courses = (
            Section(title=one.recording, findings=one.findings, pictures=(course,), folded=True, on="page")
            for one, course in zip(result.trials, drawn, strict=True)
        )
        return Summary(
            title=f"Against the reference: {len(result.trials)} recording{'s' * many}",
            answer=_answer(result, self),
            data=self.data,
            pictures=(figure_of("figures:draw_level_errors", self.levels), first) if self.levels else (first,),
            sections=(
                *(levels_sections(self.levels) if self.levels else ()),
                *trials_sections(result.trials, means if many else (), offset=self.offset),
                *_expected(result),
                _remarks(self),
                method_section(self),
                recordings_section(self, result.trials),
                *(courses if many else ()),
            ),
            findings=tuple(item for trial in result.trials for item in trial.findings),
            verdict=self.judged,
            judged="the calibration",
            brief=True,
            notes=(*self.notes, *notes),
            written=(self.output,),
        )


@options
@dataclass(frozen=True, kw_only=True)
class Levels:
    """Levels of correction.

    Parameters
    ----------
    compare : bool
        Also judge the recordings at each level of correction: uncalibrated, constants, static table, all tables, the offset of the
        rest and of the motion subtracted; with a simulated device of the same calibration in the same motion.
    trials : Path or None
        Table in the folder, a row per recording with person, task, device and reference: each level of correction by gyroscopes and
        by VQF, over people, by task and by device.
    """

    compare: Flag = False
    trials: Path | None = None

    def judge(
        self, done: Validated, pairs: list[tuple["Record", "Reference"]], paths: Sequence[Path], progress: Progress
    ) -> "LevelTable":
        """Judge what was validated at each level; in leave-one-out each recording by the fit to the others."""
        import numpy as np

        from undrift.validation.levels import LevelTrial, judge_levels, simulate_trial_of

        left_out = [replace(done.calibration, gyro=h.fit.triad.model) for h in done.result.held_out if done.calibration]
        trials = list[LevelTrial]()
        for k, (record, reference) in enumerate(pairs):
            calibration, judged = left_out[k] if left_out else done.calibration, done.result.trials[k]
            simulated = None
            if calibration is not None and calibration.gyro is not None:
                applied = judged.mounting is not None and judged.mounting.applied
                mounting = judged.mounting.alignment.rotation if judged.mounting and applied else np.eye(3)
                with suppress(UndriftError):
                    simulated = simulate_trial_of(
                        record, reference, calibration, mounting=mounting, rng=np.random.default_rng(k)
                    )
            trials.append(
                LevelTrial(
                    recording=name_of(paths[k]),
                    record=record,
                    reference=reference,
                    calibration=calibration,
                    mounting=done.settings.mounting,
                    cluster=done.settings.align == "level",
                    simulated=simulated,
                )
            )
        return judge_levels(trials, settings=done.settings, progress=progress)


def _with_reference(record: Path, place: Path, stated: dict[str, Any]) -> dict[str, Any]:
    """Return what is stated of one recording of a folder: its reference is that of its name in the folder of references."""
    optics = stated.get("optics", Optics())
    if len(optics.reference) == 1 and is_plain_folder(optics.reference[0]):
        folder = optics.reference[0] / place.parent
        same = [path for path in sorted(folder.glob("*")) if name_of(path) == name_of(record)]
        if len(same) != 1:
            raise InputError(f"{record}: wanted one reference of its name in {folder}, got {len(same)}; name it so")
        return stated | {"optics": replace(optics, reference=(same[0],))}
    return stated


@verb
@of_folder("", _with_reference, alone=("calibrate_from",), whole=("trials",))
def validate(
    *records: Files,
    optics: Optics = Optics(),
    place: Place = Place(),
    calibration: Path | None = None,
    calibrate_from: Literal["reference"] | None = None,
    leave_one_out: Flag = False,
    mounting: Literal["each", "one"] | None = None,
    offset: Literal["none", "rest", "motion"] = "rest",
    adc: Literal["auto", "none"] = "auto",
    forward: Side | None = None,
    up: Side | None = None,
    applying: TableUse = TableUse(),
    max_lag_s: float = 5.0,
    levels: Levels = Levels(),
    output: OptionalOutput = None,
    opening: Opening = Opening(),
    progress: Progress = silent,
) -> Validated | PeopleValidated:
    """Compare recordings with an optical reference: lag, errors in degrees, levels of correction.

    Parameters
    ----------
    records : Path
        One or more recordings, one folder with session.toml, or a folder of recordings, each judged by itself, whose references
        have their names in a folder.
    optics : Optics
        The reference of each recording.
    place : Place
        With --calibrate-from: local gravity, and the device.
    calibration : Path or None
        calibration.json of the device, or a folder of calibrations: the newest one of the recordings' serial number.
    calibrate_from : str or None
        "reference" fits the gyroscopes to the references of these recordings, which must be of one device.
    leave_one_out : bool
        With --calibrate-from: each recording is judged by a fit to the others.
    mounting : str or None
        With --calibrate-from: "each" fits a small rotation between device and reference body for each recording, "one" states that
        they were mounted once. Without it: as session.toml says, or each.
    offset : str
        "rest" subtracts the mean rate of the first still phase, "motion" also what gravity shows from there on, or without any
        rest, as correct and orient do; "none" does not.
    adc : str
        "auto" corrects the quantisation of the codes where it shows and, in a fit to references, where that lowers the error on
        recordings that a fit has not seen: by two recordings or more, the held-out one apart. "none" leaves them.
    forward : str or None
        Body axis that points forward on the upright segment: with --up it defines the pitch. Without both they are +x and +z, and
        the readings are turned by the calibration's mounting, if there is one.
    up : str or None
        Body axis that points up on the upright segment.
    applying : TableUse
        How the tables of the calibration are applied.
    max_lag_s : float
        Largest lag between the clocks of recording and reference, either way, s.
    levels : Levels
        Levels of correction.
    output : Path or None
        Folder for validation.json, report.html and, with --calibrate-from, calibration.json.
    opening : Opening
        How to read foreign recordings.
    progress : callable
        Takes how far it is.
    """
    from undrift.calibration.reference import ReferenceSettings
    from undrift.sync import LagSettings
    from undrift.validation.trial import TrialSettings

    _check_asked((leave_one_out, mounting, place), calibrate_from, calibration, max_lag_s)
    check_folder(output)
    if levels.trials is not None:
        of_rows = {
            "compare": levels.compare,
            "calibration": calibration,
            "calibrate_from": calibrate_from,
            "mounting": mounting,
        }
        of_rows |= {"reference": optics != Optics(), "offset": offset != "rest", "policy": applying != TableUse()}
        if given := [name for name, value in of_rows.items() if value]:
            raise InputError(f"validate: `{given[0]}` cannot be combined with `trials`. Write it in the table.")
        if len(records) != 1:
            raise InputError(f"validate: `trials` needs one folder that contains the table, got {len(records)} paths.")
        common = TrialSettings(
            lag=LagSettings(longest_lag_s=max_lag_s), forward=forward or "+x", up=up or "+z", adc=adc
        )
        return validate_people(
            records[0], levels.trials, settings=common, forward=forward, up=up, opening=opening, output=output,
            progress=progress,
        )  # fmt: skip
    chosen = choose_calibration(calibration, records, opening)
    model, calibration = chosen.model, chosen.path
    settings = TrialSettings(
        offset=offset, adc=adc, forward=forward or "+x", up=up or "+z", mounting=worn_by(model, forward, up),
        power_on_s=applying.power_on_s, policy=applying.policy, lag=LagSettings(longest_lag_s=max_lag_s),
        align="level" if optics.of_cluster() and not calibrate_from else "auto",
    )  # fmt: skip
    with reading(progress, READ, *dict.fromkeys((*records, *optics.reference))):
        records, session = recordings_of(records, opening, place)
        pairs = optics.pairs(records, opening.like(model, calibration), command="validate", session=session)
    fit = ReferenceSettings(mounting=mounting or (session and session.mounting) or "each") if calibrate_from else None
    progress("aligning and integrating" if fit is None else "fitting to all recordings", READ)
    steps = part_of(progress, READ if fit is None else ALL_FITTED, JUDGED if levels.compare else 1.0)
    named = (records, optics.reference)
    validated = _judged(pairs, named, (calibration, model), settings, (leave_one_out, steps), fit, (place, session))
    validated = replace(validated, notes=chosen.notes)
    if levels.compare:
        validated = replace(validated, levels=levels.judge(validated, pairs, records, part_of(progress, JUDGED, 1.0)))
    if output is None:
        return validated
    return _write(validated, output, origin_of(*records, *optics.reference, calibration))


def _check_asked(
    of_fit: tuple[bool, str | None, Place], calibrate_from: str | None, calibration: Path | None, max_lag_s: float
) -> None:
    leave_one_out, mounting, place = of_fit
    given = {"leave_one_out": leave_one_out or None, "mounting": mounting} | asdict(place)
    asked = [name for name, value in given.items() if value not in (None, "")]
    if calibrate_from is None and asked:
        name = "--" + asked[0].replace("_", "-")
        raise InputError(f"validate: {name} wants `calibrate_from` reference; say both, or neither")
    if calibrate_from is not None and calibration is not None:
        raise InputError("validate: wanted `calibration` or `calibrate_from`, got both; choose one")
    if not 0.0 < max_lag_s < math.inf:
        raise InputError(f"`max_lag_s`: wanted more than 0 s, got {max_lag_s:g}; say how far the clocks may differ")


def _write(validated: Validated, folder: Path, origin: Origin) -> Validated:
    """Write validation.json, the page, and the calibration that was fitted."""
    from undrift.io.store import write_calibration

    validated = replace(validated, output=folder)
    folder.mkdir(exist_ok=True)
    save_json(folder / "validation.json", validated.data)
    at("undrift.report.page:write_page")(folder / "report.html", validated.summary(), origin)
    if validated.calibration is not None and not validated.source:
        made_from = replace(validated.calibration.provenance, inputs=origin.inputs)
        write_calibration(replace(validated.calibration, provenance=made_from), folder / "calibration.json")
    return validated


def _validation_json(result: "Validation") -> dict[str, object]:
    from undrift.io.store import findings_json

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
        "expected_inside": None if result.coverage is None else asdict(result.coverage),
    }


def _judged(
    pairs: list[tuple["Record", "Reference"]],
    named: tuple[tuple[Path, ...], tuple[Path, ...]],
    read: "tuple[Path | None, Calibration | None]",
    settings: "TrialSettings",
    how: tuple[bool, Progress],
    fit: "ReferenceSettings | None",
    where: "tuple[Place, Session | None]",
) -> Validated:
    """Return the validation by the calibration that was read or fitted to all recordings, or none."""
    from undrift.calibration.calibrate import calibrate_to_references
    from undrift.calibration.triads import check_triads
    from undrift.validation.agreement import MOUNTING_ABOVE, validate_leave_one_out, validate_trials
    from undrift.validation.trial import check_poses, check_scale

    (paths, references), (calibration, model), (leave_one_out, progress) = named, read, how
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
        there: Any = {"gravity_m_s2": None if source == "standard" else gravity_m_s2, "gravity_source": source}
        how_fitted: Any = {"adc": settings.adc, "settings": fit, "lag_settings": settings.lag}
        model = calibrate_to_references(records, held, **how_fitted, **there)
        model = replace(model, device=(place.serial if session is None else session.serial) or model.device)
    result = (
        validate_leave_one_out(pairs, settings=settings, fit_settings=fit, names=names, progress=progress)
        if leave_one_out and fit is not None
        else validate_trials(pairs, calibrations=(model,), settings=settings, names=names, progress=progress)
    )
    for trial in result.trials:
        check_scale(trial)
    if result.held_out and fit is not None and fit.mounting == "each":
        settings = replace(settings, align_above=min(settings.align_above, MOUNTING_ABOVE))
    verdict = Verdict() if model is None or result.held_out else model.verdict
    for left_out in result.held_out:
        verdict = verdict.also(left_out.fit.triad.verdict)
    return Validated(
        result=result,
        recordings=tuple(path.name for path in paths),
        references=tuple(path.name for path in references),
        calibration=model,
        source=calibration.name if calibration else "",
        leave_one_out=bool(result.held_out),
        verdict=verdict,
        settings=settings,
    )


# ---- sections


def _answer(result: "Validation", method: Validated) -> str:
    """Return what the orientation is worth, in a sentence."""
    removed = {
        "rest": "the offset of the first still phase removed",
        "motion": "the offset that gravity shows in motion removed",
    }
    parts = []
    if method.leave_one_out:
        parts = ["calibrated with the other recordings"]
    elif method.calibration is not None:
        parts = [f"calibrated with {method.source}" if method.source else "calibrated with these same recordings"]
    if method.settings.offset == "motion" or not parts:
        done = method.settings.offset in removed and any(trial.rest for trial in result.trials)
        parts += [f"with {removed[method.settings.offset]}" if done else "uncorrected"]
    figures, over = result.median, f", median of {len(result.trials)} recordings" if len(result.trials) > 1 else ""
    return (
        f"Orientation is wrong by {figures.rmse_total_deg:.2g} deg rms in total and {figures.rmse_inclination_deg:.2g} deg in "
        f"inclination over the motion{over}, {', '.join(parts)}."
    )


def _remarks(validated: Validated) -> Section:
    """Return what was noticed of each recording, as a terminal shows it."""
    trials, lines = validated.result.trials, []
    for note in dict.fromkeys(item.text for trial in trials for item in trial.findings):
        noted = [trial.recording for trial in trials if note in (item.text for item in trial.findings)]
        who = "every recording" if 1 < len(noted) == len(trials) else ", ".join(noted)
        lines.append(f"{who}: {note}")
    if validated.calibration is not None and not validated.source and not validated.leave_one_out:
        lines.append("these recordings made the calibration that they judge: say `leave_one_out` for an honest figure")
    return Section(title="Remarks", text=tuple(lines), on="terminal")


def _percent(share: float) -> str:
    return f"{100.0 * share:.1f}"


def trials_sections(
    trials: "Sequence[Trial]", summaries: "Sequence[tuple[str, Figures]]" = (), *, offset: str = ""
) -> tuple[Section, Section]:
    """Return the tables of errors, one row a trial: the main ones, and the others for the page."""
    named = (*((trial.recording, trial.figures) for trial in trials), *summaries)
    rows = [
        (name, *(f"{getattr(x, key):.2f}" for key in SHOWN), _percent(x.pitch_defined), _percent(x.valid_optics))
        for name, x in named
    ]
    others = [{"recording": name} | {head: f"{getattr(x, key):.2f}" for key, head in FURTHER} for name, x in named]
    lines = [PITCH_DEFINED] if any(x.pitch_defined < 1.0 for _, x in named) else []
    least = min(trial.figures.valid_optics_file for trial in trials)
    if least < min(trial.figures.valid_optics for trial in trials) - SHOWN_SHARE:
        lines.append(f"{OPTICS_SEEN} of the whole file it is {_percent(least)} %{' or more' * (len(trials) > 1)}")
    errors = Section(
        title="error against the reference in deg: rmse over the motion, largest, median after it"
        + (f" (offset: {offset})" if offset else ""),
        columns=("recording", *SHOWN.values(), "pitch %", "optics %"),
        rows=tuple(rows),
        text=tuple(lines),
    )
    return errors, rows_section("Further errors", others, folded=True)


def coverage_text(coverage: "Coverage") -> str:
    """Return how many of the observed errors are no larger than stated."""
    return (
        f"not larger than expected (95 %, at most): end error {coverage.end_inside} of {coverage.ends}, total error over the "
        f"motion {coverage.rmse_inside} of {coverage.trials}"
    )


def _expected(result: "Validation") -> tuple[Section, ...]:
    """Return observed and expected errors, deg, one row a trial: end total, then total over the motion."""
    if result.coverage is None:
        return ()
    heads = ("recording", "end total (deg)", "expected", "at most", "total rmse (deg)", "expected rmse", "rmse at most")
    rows = list[tuple[str, ...]]()
    for trial in result.trials:
        if (made := trial.expected) is not None:
            end = (trial.figures.end_total_deg, made.end_total_deg, made.end_at_most_deg)
            rmse = (trial.figures.rmse_total_deg, made.rmse_total_deg, made.rmse_at_most_deg)
            pairs = ((told_apart(x, ".2f", most), f"{y:.2f}", told_apart(most, ".2f", x)) for x, y, most in (end, rmse))
            rows.append((trial.recording, *(cell for cells in pairs for cell in cells)))
    text = (
        "Expected: root mean square of the errors that follow from the calibration's covariance and from what changes between "
        "recordings of a device. At most: 95 % of the errors are no larger.",
        coverage_text(result.coverage),
    )
    title = "observed and expected errors in deg (at most: 95 %)"
    return (Section(title=title, columns=heads, rows=tuple(rows), text=text),)


def method_section(method: Validated) -> Section:
    """Return what was done, one row a choice."""
    from undrift.validation.trial import LEAD_S, OWN_LAG_S, REST_S

    settings, made = method.settings, method.calibration
    verdict = Verdict() if made is None else method.verdict
    rows = {
        "calibration": _calibration(method),
        "its verdict": "" if made is None else verdict.status,
        "gyroscope's offset": _offset(method),
        "ADC's rounding": _adc(method),
        "start": f"tilt from the specific force, heading from the reference, both over the last {REST_S:g} s of rest or "
        f"less; from {LEAD_S:g} s before the motion the gyroscope alone; without a rest from the reference's first second",
        "pitch": f"in the body's plane of {settings.forward} (forward) and {settings.up} (up)"
        + (", readings turned by the calibration's mounting" if settings.mounting else ""),
        "lag": f"searched up to {settings.lag.longest_lag_s:g} s either way; one up to {OWN_LAG_S * 1e3:g} ms is "
        "the sensor's own and stays in the figures, a longer one is removed",
        "mounting": _ALIGNED[settings.align].format(above_deg=settings.align_above / RADIAN_PER_DEGREE),
    }
    made_of = tuple(row for row in rows.items() if row[1])
    return Section(title="Method", columns=("step", "choice"), rows=made_of, words=True, on="page")


def recordings_section(method: Validated, trials: "tuple[Trial, ...]") -> Section:
    """Return what was found of each recording before it was judged, one row a recording."""
    references = method.references or ("the same file",) * len(trials)
    rows = []
    for file, reference, trial in zip(method.recordings, references, trials, strict=True):
        mounting = "not observable"
        if trial.mounting is not None:
            angle_deg = trial.mounting.alignment.angle / RADIAN_PER_DEGREE
            mounting = f"{angle_deg:.1f}, {'removed' if trial.mounting.applied else 'left in'}"
        rows.append(
            {
                "recording": file,
                "reference": reference,
                "motion (s)": f"{trial.motion.start_s:.1f} to {trial.motion.stop_s:.1f}",
                "lag found (ms)": f"{trial.lag.seconds * 1e3:.2f} +- {trial.lag.standard_uncertainty * 1e3:.2f}",
                "lag in the figures": "removed" if trial.lag_undone else "left in",
                "mounting (deg)": mounting,
                "optics seen, whole file (%)": _percent(trial.figures.valid_optics_file),
            }
        )
    rests = (f"{trial.recording}: {item.text}" for trial in trials if trial.rest for item in trial.rest.findings)
    text = ("The motion, over which the errors count, is shaded in each figure of errors.", *rests)
    return rows_section("Recordings", rows, text=text, on="page")


def _calibration(method: Validated) -> str:
    made = method.calibration
    if made is None:
        return "none: readings in the unit of their file"
    if method.leave_one_out:
        return "leave-one-out: each recording judged by a gyroscope fit to the references of the others"
    if not method.source:
        return "gyroscope fitted to the references of these same recordings, so figures are optimistic: use `leave_one_out`"
    triads = [f"{name} by {t.method}" for name, t in (("gyroscope", made.gyro), ("accelerometer", made.accel)) if t]
    tables = "" if made.drift is None else ", with tables over temperature"
    return f"{method.source} of {made.device or 'a device without a name'}: {', '.join(triads)}{tables}"


def _offset(method: Validated) -> str:
    rest = "the mean rate of the first still phase is subtracted"
    if method.settings.offset == "motion":
        rest = "what gravity shows in motion, beside the first still phase, is subtracted"
    if method.leave_one_out:
        fitted = "the fit's: each recording's rest before the motion, if there is one, and the motion of the others"
        return f"{fitted}; {rest}" if method.settings.offset == "motion" else fitted
    if method.settings.offset != "none":
        return rest if method.calibration is None else f"the calibration's, and {rest} after it"
    return "not corrected" if method.calibration is None else "the calibration's alone"


def _adc(method: Validated) -> str:
    if method.settings.adc == "none":
        return "left in"
    made = method.calibration
    if made is None:
        return "corrected where the codes show it; see the notes of the recording"
    if made.adc is None:
        return "unknown to the calibration: left in"
    names = ("gyroscope", "accelerometer")
    rounded = [(name, one.rounding) for name, one in zip(names, made.triads, strict=True) if one.lsb is not None]
    words = [f"{name} {rounding.replace('_', ' ')}" for name, rounding in rounded]
    return f"corrected by the calibration ({', '.join(words)})"
