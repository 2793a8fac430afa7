"""A study by ``undrift validate``: people, tasks and devices beside optics, by each pipeline, as a paper reports it.

The folder holds ``trials.csv``, a row a recording. Columns: recording, person, task and device; reference, where the recording does
not hold its own; and where they are needed calibration, map, sensor, reference_map, reference_up and markers, as the options have
them. Files are relative to the table.
"""

import csv
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from undrift import __version__
from undrift.base.summary import Result, Section, Summary, at, figure_of, interval, number, plain
from undrift.commands import Progress, part_of, silent
from undrift.commands.files import Opening, Optics, check_folder, origin_of, save_json, worn_by
from undrift.errors import InputError, UndriftError
from undrift.files import read_bytes

if TYPE_CHECKING:
    from undrift.study.people import Group, PeopleStudy, PersonTrial


TABLE = "trials.csv"
NEEDED = ("recording", "person", "task", "device")
FILES = ("recording", "reference", "calibration", "map", "reference_map")
OPTIONAL = (*FILES[1:], "sensor", "reference_up", "markers")
METHODS = {"strapdown": "gyroscopes", "vqf": "VQF"}


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class StudyOfPeople(Result):
    """A validation over people, tasks and devices."""

    folder: Path
    study: "PeopleStudy"
    output: Path | None = None

    def summary(self) -> Summary:
        """Return the answer, a table of each task and device, agreement, and a paragraph of methods."""
        study = self.study
        names = list(dict.fromkeys(group.of for group in study.groups))
        every, *parts = (self._errors(name) for name in names)
        methods = Section(title="Methods, to cite", text=(self.methods(),), on="page")
        return Summary(
            title=f"Validation study: {self.folder.resolve().name}",
            answer=self._answer(),
            data=self.data,
            pictures=(figure_of("figures:draw_people", self),),
            sections=(
                every,
                *((warnings,) if (warnings := self._warnings()).text else ()),
                replace(self._agreement(["all"]), on="terminal"),
                *(replace(part, on="page") for part in parts),
                replace(self._agreement(names), on="page"),
                methods,
                self._trials(),
            ),
            written=() if self.output is None else (self.output / "study.json", self.output / "report.html"),
        )

    @property
    def data(self) -> dict[str, Any]:
        """What JSON has, and study.json."""
        from undrift.io.store import findings_json

        study = self.study
        trials = [{name: getattr(one, name) for name in NEEDED} for one in study.trials]
        errors = list[dict[str, Any]]()
        for one in study.errors:
            words = findings_json([item for _, item in one.findings])
            named = [{"recording": of[0], **each} for of, each in zip(one.findings, words, strict=True)]
            errors.append(asdict(replace(one, findings=())) | {"findings": named})
        about = {"quantity": study.quantity, "measure": study.measure, "margin_deg": study.margin_deg}
        groups = [asdict(one) for one in study.groups]
        return about | {"trials": trials, "groups": groups, "errors": errors, "methods": self.methods()}

    def _answer(self) -> str:
        study, every = self.study, [group for group in self.study.groups if group.of == "all" and group.trials]
        raw, whole = every[0], [group for group in every if group.trials == max(one.trials for one in every)]
        best = min(whole, key=lambda group: group.mean_deg)
        ends = f"{max(best.interval_deg[0], 0.0):.2f} to {best.interval_deg[1]:.2f}"  # an error is 0 at least
        spread = "" if best.people < 2 else f" [95 % {ends}]"
        return (
            f"least of {len(whole)} pipelines, {_named(best)}: {study.quantity} error {best.mean_deg:.2f} deg{spread}, "
            f"{_named(raw)} {raw.mean_deg:.2f}; {best.people} people, {best.trials} trials"
        )

    def _errors(self, name: str) -> Section:
        """Return the errors of one group, a row a pipeline and method."""
        study, rows = self.study, list[tuple[str, ...]]()
        for group in study.groups:
            if group.of == name and group.trials:
                judged = group.decision
                spread = (
                    f"{max(group.interval_deg[0], 0.0):.2f} to {group.interval_deg[1]:.2f}" if group.people > 1 else "–"
                )
                less = (number(judged.difference), judged.verdict) if judged else ("–", "–")
                count = f"{group.people} ({group.trials})"
                rows.append((_named(group), count, number(group.mean_deg), spread, number(group.median_deg), *less))
        heads = ("pipeline", "people (trials)", "error (deg)", "95 %", "median trial", "less than as read", "verdict")
        missing = (f"{one.pipeline}, {METHODS[one.method]}: {one.missing}" for one in study.errors if one.missing)
        text = (
            f"{study.quantity} error, root mean square over the motion, mean over people; better, equivalent or worse by a "
            f"margin of {study.margin_deg:g} deg, at 5 % over all rows, from three people on",
            *(dict.fromkeys(missing) if name == "all" else ()),
        )
        title = "All trials" if name == "all" else name[0].upper() + name[1:]
        return Section(title=title, columns=heads, rows=tuple(rows), text=text)

    def _warnings(self) -> Section:
        """Return what the trials warn of, once for each recording, with the first pipeline that does."""
        seen = dict[tuple[str, str], str]()
        for one in self.study.errors:
            for recording, item in one.findings:
                text = f"{Path(recording).name}, {one.pipeline}: {item.text}"
                seen.setdefault((recording, item.code), text)
        return Section(title="Warnings", text=tuple(seen.values()))

    def _agreement(self, names: list[str]) -> Section:
        """Return the agreement with the optics of each pipeline in each group."""
        study, rows = self.study, list[tuple[str, ...]]()
        for group in study.groups:
            if group.limits and group.icc and group.of in names:
                same = group.equivalence
                verdict = "–" if same is None else "equivalent" if same.verdict == "equivalent" else (
                    "not decidable" if same.verdict == "not decidable" else "differs"
                )  # fmt: skip
                limits = group.limits
                spread, bias = interval(limits.limits, "+.2f"), f"{round(limits.bias, 2) + 0.0:+.2f}"
                icc = (
                    f"{group.icc.value:.3f}",
                    interval(group.icc.interval),
                    number(group.icc.minimal_detectable_change),
                )
                rows.append((group.of, _named(group), bias, spread, *icc, verdict))
        heads = ("of", "pipeline", "bias (deg)", "95 % limits", "ICC(2,1)", "95 %", "MDC95 (deg)", "the optics")
        text = (
            f"agreement of sensor and optics on the {study.measure} of a trial: Bland and Altman's limits, ICC(2,1), smallest "
            f"change between two trials that is more than measurement error; equivalent: the mean difference of people is within "
            f"{study.margin_deg:g} deg by two one-sided tests at 5 %, from three people on; an ICC depends on how much the trials "
            "differ, and trials of one person are not independent",
        )
        return Section(title="Agreement with the optics", columns=heads, rows=tuple(rows), text=text)

    def _trials(self) -> Section:
        """Return the errors of each trial."""
        study = self.study
        heads = ("recording", "person", "task", "device", *(f"{o.pipeline}, {METHODS[o.method]}" for o in study.errors))
        columns = [getattr(one, f"{study.quantity}_deg") for one in study.errors]
        rows = (
            (one.recording, one.person, one.task, one.device, *(number(float(column[k])) for column in columns))
            for k, one in enumerate(study.trials)
        )
        return Section(
            title=f"{study.quantity} error of each trial (deg)", columns=heads, rows=tuple(rows), folded=True
        )

    def methods(self) -> str:
        """Return a paragraph that states what was done, for a paper."""
        study = self.study
        people, tasks, devices = (
            len({getattr(one, name) for one in study.trials}) for name in ("person", "task", "device")
        )
        others = sum(one.calibration is None for one in study.trials)
        own = (
            f"{len(study.trials) - others} recordings were corrected by a calibration of their device made beforehand"
            + (f", {others} by what the other recordings of their device show (leave one out)" if others else "")
        )
        return (
            f"{len(study.trials)} recordings of {people} people in {tasks} tasks with {devices} inertial sensors were compared "
            f"with optical motion capture by undrift {__version__}. {own}; the offset of the gyroscopes was left as it is, taken "
            "from the first rest, or estimated from gravity during the motion. Orientation was integrated from the gyroscopes "
            "(strapdown, started from the rest before the motion) or estimated by VQF (offline, without magnetometer), and "
            "compared after the lag between the clocks was removed where it exceeds 10 ms. Errors are root mean squares over the "
            f"motion of each trial ({study.quantity}), averaged by person; means over people are given with Student's 95 % "
            "interval, and paired differences are judged against a margin of "
            f"{study.margin_deg:g} deg by one two-sided and two one-sided t tests with Bonferroni's correction. Agreement on the "
            f"{study.measure} is given by Bland and Altman's 95 % limits, ICC(2,1) with its 95 % interval, and equivalence of the "
            f"means within {study.margin_deg:g} deg (two one-sided tests)."
        )


def _named(group: "Group") -> str:
    return f"{group.pipeline}, {METHODS[group.method]}"


# ---- the table of trials


def of_people(function: Callable[..., Any]) -> Callable[..., Any]:
    """Let ``validate`` take a folder with a table of trials where a study is asked for."""

    @wraps(function)
    def called(*given: Any, **stated: Any) -> Any:
        comparing = stated.get("comparing")
        if not (comparing and comparing.study):
            return function(*given, **stated)
        known = ("comparing", "output", "opening", "progress", "forward", "up", "max_lag_s", "adc")
        for name, value in stated.items():
            if name not in known and value not in (None, False, ()) and not _is_default(value):
                raise InputError(
                    f"validate: `{name}` and `study` together say two things; {TABLE} states the former, a row a recording"
                )
        return _study(given, stated)

    return called


def _is_default(value: Any) -> bool:
    try:
        return bool(value == type(value)())
    except TypeError:
        return False


def _study(given: tuple[Any, ...], stated: dict[str, Any]) -> StudyOfPeople:
    from undrift.study.figure3 import NOTE_APART_DEG
    from undrift.study.people import study_people
    from undrift.sync import LagSettings
    from undrift.validation.trial import TrialSettings

    if len(given) != 1 or not (given[0] / TABLE).is_file():
        got = given[0] if len(given) == 1 else f"{len(given)} paths"
        raise InputError(
            f"validate: wanted one folder with {TABLE} for a study, got {got}; write a row a recording with columns "
            f"{', '.join(NEEDED)} and reference"
        )
    output: Path | None = stated.get("output")
    check_folder(output)
    progress: Progress = stated.get("progress", silent)
    lag = LagSettings(longest_lag_s=stated.get("max_lag_s", LagSettings().longest_lag_s))
    settings = TrialSettings(
        lag=lag, forward=stated.get("forward") or "+x", up=stated.get("up") or "+z", adc=stated.get("adc", "auto")
    )
    folder, comparing = cast("Path", given[0]), stated["comparing"]
    comparing.check()
    rows, trials = list(_rows(folder / TABLE)), list["PersonTrial"]()
    _check_rows(folder / TABLE, rows)
    for k, row in enumerate(rows):
        progress(f"reading {row['recording']}", 0.3 * k / len(rows))
        trials.append(_trial(folder, row, stated))
    study = study_people(trials, margin_deg=NOTE_APART_DEG, settings=settings, progress=part_of(progress, 0.3, 1.0))
    result = StudyOfPeople(folder=folder, study=study, output=output)
    if output is not None:
        output.mkdir(exist_ok=True)
        save_json(output / "study.json", plain(result.data))
        read = (folder / TABLE, *(folder / row[name] for row in rows for name in FILES if row[name]))
        at("undrift.report.page:write_page")(output / "report.html", result.summary(), origin_of(*dict.fromkeys(read)))
    return result


def _rows(table: Path) -> Iterator[dict[str, str]]:
    """Yield the rows of the table, every column that there may be in each."""
    reader = csv.DictReader(read_bytes(table).decode("utf-8-sig", "replace").splitlines())
    heads = [head.strip() for head in reader.fieldnames or ()]
    lacking, unknown = [x for x in NEEDED if x not in heads], [x for x in heads if x not in (*NEEDED, *OPTIONAL)]
    if lacking or unknown:
        got = f"no {', '.join(lacking)}" if lacking else f"also {', '.join(unknown)}"
        raise InputError(
            f"{table}: wanted columns {', '.join(NEEDED)}, and of {', '.join(OPTIONAL)}, got {got}; correct the heads"
        )
    empty, rows = dict.fromkeys((*NEEDED, *OPTIONAL), ""), 0
    for line, row in enumerate(reader, start=2):
        cells = empty | {head.strip(): (value or "").strip() for head, value in row.items() if head}
        if missing := [name for name in NEEDED if not cells[name]]:
            raise InputError(
                f"{table}: wanted {', '.join(missing)} in line {line}, got none; fill it in, or leave the line out"
            )
        rows += 1
        yield cells
    if not rows:
        raise InputError(f"{table}: wanted a row for each recording, got none; add them")


def _check_rows(table: Path, rows: list[dict[str, str]]) -> None:
    """Refuse a recording that stands twice, which would correct itself, and a device that is calibrated in some rows alone."""
    names = [(row["recording"], row["sensor"]) for row in rows]
    if twice := sorted({name for name, _ in names if names.count((name, _)) > 1}):
        raise InputError(f"{table}: wanted each recording once, got {twice[0]} in several rows; leave one")
    for device in dict.fromkeys(row["device"] for row in rows):
        calibrated = [bool(row["calibration"]) for row in rows if row["device"] == device]
        if any(calibrated) and not all(calibrated):
            raise InputError(
                f"{table}: wanted a calibration in every row of device {device} or in none, got {sum(calibrated)} of "
                f"{len(calibrated)}; fill it in"
            )


def _trial(folder: Path, row: dict[str, str], stated: dict[str, Any]) -> "PersonTrial":
    """Read one row's recording, reference and calibration."""
    from undrift.io.store import read_calibration
    from undrift.study.people import PersonTrial

    paths = {name: folder / row[name] if row[name] else None for name in FILES}
    recording = cast("Path", paths["recording"])
    reference = (paths["reference"],) if paths["reference"] else ()
    optics = Optics(
        reference=reference, reference_map=paths["reference_map"], markers=row["markers"] or None,
        reference_up=cast("Any", row["reference_up"] or None),
    )  # fmt: skip
    model = read_calibration(paths["calibration"]) if paths["calibration"] else None
    opening: Opening = stated.get("opening", Opening())
    how = replace(opening, column_map=paths["map"] or opening.column_map, sensor=row["sensor"] or opening.sensor)
    try:
        (pair,) = optics.pairs((recording,), how.like(model, paths["calibration"]), command="validate")
    except UndriftError as error:
        raise InputError(f"{folder / TABLE}, {row['recording']}: {error}") from error
    about = {name: row[name] for name in NEEDED}
    worn = worn_by(model, stated.get("forward"), stated.get("up"))
    return PersonTrial(**about, pair=pair, calibration=model, cluster=optics.of_cluster(), mounting=worn)
