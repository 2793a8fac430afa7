"""``undrift study``: find the calibration session that is good enough for a task, with simulated devices and people."""

import io
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from typing import Literal

import pyarrow as pa
import pyarrow.parquet as pq

from undrift.base.options import Output
from undrift.base.workers import executor
from undrift.commands.outputs import check_folder, origin_of, write_results
from undrift.errors import InputError
from undrift.files import write_whole
from undrift.programme import write_protocol
from undrift.report import Report
from undrift.report.study import chosen_sessions, file_stem, study_report
from undrift.screen import progress
from undrift.study.figure3 import figure3
from undrift.study.judge import StudyOutcome, breakdown_session, judge, with_test
from undrift.study.judge import chosen_sessions as sessions_to_test
from undrift.study.methods import compare_methods
from undrift.study.plan import Study, note_study, read_study, with_categories
from undrift.study.run import Run, run_chosen, run_effects, run_study, with_checked_fits

RUN, EFFECTS, TESTING, METHODS = 0.7, 0.8, 0.9, 0.97  # progress at the end of each stage
EFFECT_DEVICES = 10  # largest number of devices whose error is split by source


def study(
    plan: Path | None = None,
    /,
    *,
    output: Output = Path("study"),
    preset: Literal["note"] | None = None,
    target_deg: float | None = None,
    categories: str | None = None,
    subjects: int | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
) -> Report:
    """Calibrate simulated devices with named sessions, and find the cheapest session whose error in a task is good enough.

    Parameters
    ----------
    plan : Path or None
        study.toml: tasks, people, device, sessions. See docs/study.md.
    output : Path
        Folder for report.html, summary.json, runs.parquet and a protocol.toml for each answer that needs a rate table.
    preset : str or None
        "note" instead of a plan: the technical note's three tasks, with its fits.
    target_deg : float or None
        Error that is good enough for 95 % of devices, deg. The default is the plan's value, otherwise 0.5, 1 and 2.
    categories : str or None
        Categories of people, separated by commas: level_1 to level_4 (level_2 is the note's), young, elderly, impaired, parkinson,
        and the categories in the plan. Each category performs every task.
    subjects : int or None
        Number of devices, each on a different person. The default is the plan's value, otherwise 30.
    workers : int or None
        Number of processes on this machine. The default is one per processor.
    scheduler : str or None
        Address of a Dask scheduler whose workers are used, for example tcp://host:8786.
    """
    if (plan is None) == (preset is None):
        raise InputError(
            f"study: expected a study.toml or `preset` note, got {'both' if plan else 'neither'}. Give one."
        )
    planned = _planned(plan, target_deg, categories, subjects)
    check_folder(output)
    if output.is_dir() and any(output.iterdir()) and not (output / "runs.parquet").is_file():
        raise InputError(f"{output}: this folder contains other files. Choose a new folder, or the folder of a study.")
    with executor(workers, scheduler) as spread:
        progress("comparing a shipped fit with a new one", 0.0)
        figures = spread(partial(figure3, seed=planned.seed), [] if preset is None else [planned.typical_unit()])
        planned = with_checked_fits(planned, spread)
        runs = run_study(planned, spread, lambda done, total: progress(f"device {done} of {total}", RUN * done / total))
        outcome = judge(planned, runs)
        progress("switching off errors one at a time", RUN)
        split = tuple((task.task.key, breakdown_session(task)) for task in outcome.tasks)
        devices = range(min(EFFECT_DEVICES, outcome.subjects))
        effects = [run for batch in spread(partial(run_effects, planned, split), devices) for run in batch]
        progress("testing the answers on the other group of people", EFFECTS)
        chosen, tested = sessions_to_test(outcome), list[Run]()
        if chosen and all(task.motion is None for task in planned.tasks):
            numbers = range(outcome.subjects)
            tested = [run for batch in spread(partial(run_chosen, planned.other(), chosen), numbers) for run in batch]
        outcome = with_test(outcome, tested, effects)
        progress("comparing methods and rivals", TESTING)
        if preset is not None:
            outcome = replace(outcome, methods=compare_methods(planned, spread, min(EFFECT_DEVICES, outcome.subjects)))
        progress("Figure 3", METHODS)
        figure = next(iter(figures), None)
    report = study_report(outcome, figure, output)
    output.mkdir(exist_ok=True)
    _write_runs(outcome, output / "runs.parquet")
    for session in chosen_sessions(outcome):
        if session.protocol is not None:
            protocol = session.protocol.named(file_stem(session)).with_faces_at_room()
            write_protocol(protocol, output / f"{file_stem(session)}.toml")
    write_results(output, report, "study", origin_of(plan))
    return report


def _planned(plan: Path | None, target_deg: float | None, categories: str | None, subjects: int | None) -> Study:
    planned = note_study() if plan is None else read_study(plan)
    if target_deg is not None:
        if not target_deg > 0.0:
            raise InputError(f"study: `target_deg` must be above 0, got {target_deg:g}.")
        planned = replace(planned, target_deg=(target_deg,))
    if subjects is not None:
        if subjects < 3:
            raise InputError(f"study: `subjects` must be 3 or more, got {subjects}.")
        planned = replace(
            planned, subjects=subjects, subjects_max=max(subjects, planned.subjects_max if plan else subjects)
        )
    return planned if categories is None else with_categories(planned, [name.strip() for name in categories.split(",")])


def _write_runs(outcome: StudyOutcome, path: Path) -> None:
    buffer = io.BytesIO()
    columns = {field.name: [getattr(run, field.name) for run in outcome.runs] for field in fields(Run)}
    pq.write_table(pa.table(columns), buffer)
    write_whole(path, buffer.getvalue())
