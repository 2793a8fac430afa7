"""``undrift demo``: the note's method on an emulated bench over real sockets, a reduced study, a page and a summary.

Table, chamber and device are emulated, the rest is not: what they say goes over TCP into run folders and is read back, and
nothing that fits or corrects knows the truth. The truth serves the checks at the end alone.
"""

import json as text_json
import shutil
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from undrift.base.options import Flag, Report
from undrift.cli.common import say, say_over, write_json
from undrift.commands.files import check_folder, check_report, origin_of, save_json
from undrift.errors import InputError

if TYPE_CHECKING:
    from undrift.sim.device.model import DeviceModel
    from undrift.study.outcome import StudyOutcome
    from undrift.study.virtual_bench import BenchFit, Check
    from undrift.validation.trial import Trial

SEED = 2007
RUNS = ("bench", "thermal", "study")  # folders of an earlier demo
FILES = ("calibration.json", "trial.parquet", "reference.parquet", "corrected.parquet", "report.html")
STUDY_HOST_S = {False: 18.0, True: 3.0}  # forecasts, host s
REST_HOST_S = {False: 6.0, True: 3.0}
SHOWN_EVERY_S = 2.0  # where stderr is not a terminal


def demo(*, out: Path = Path("demo"), quick: Flag = False, report: Report = None, json: Flag = False) -> int:
    """Calibrate a device on an emulated bench, correct a worn sit-to-stand, find a protocol by a small study.

    Parameters
    ----------
    out : Path
        Folder for the runs, calibration.json, the corrected trial, the study, report.html and summary.json.
    quick : bool
        Fewer rates, set-points and subjects: 20 seconds in place of 90.
    report : Path or None
        Copy of report.html to write: .html.
    json : bool
        summary.json on stdout too.
    """
    from undrift.commands.study import study_json
    from undrift.io.store import calibration_json
    from undrift.report.demo import write_demo_report
    from undrift.study.virtual_bench import bench_device, bench_plan, compare_with_truth, record_on_bench

    check_report(report)
    _check_fresh(out)
    device, plan = bench_device(), bench_plan(quick=quick)
    after_s = STUDY_HOST_S[quick] + REST_HOST_S[quick]
    shown = _Shown()
    try:
        run = record_on_bench(plan, device, out, tell=lambda what, left_s: shown(what, left_s + after_s))
        shown("fitting calibration and tables, judging a worn trial", after_s)
        fit, trials = _judged(device, out)
        study = _studied(quick, out, shown)
        checks = compare_with_truth(fit, trials, device)
        shown("report", 0.5 * REST_HOST_S[quick])
        origin = origin_of(out / "trial.parquet", out / "reference.parquet", out / "calibration.json")
        for page in (out / "report.html", *([report] if report else [])):
            write_demo_report(page, (run, fit, trials), checks, study, origin)
    finally:
        shown.end()
    summary = {
        "calibration": calibration_json(fit.drift.calibration),
        "study": study_json(study),
        "checks": [{"name": c.name, "value": c.value, "limit": c.limit, "pass": c.passed} for c in checks],
    }
    save_json(out / "summary.json", summary)
    if json:
        write_json(summary, "demo")
    else:
        _tell(out, trials, checks)
    return 0 if all(check.passed for check in checks) else 1


def _check_fresh(out: Path) -> None:
    """Refuse a folder that holds somebody's own files; take away the runs of an earlier demo."""
    check_folder(out)
    if out.is_dir() and any(out.iterdir()) and not _is_demo(out):
        raise InputError(
            f"{out}: wanted a new folder, or that of an earlier demo, got one with other files; name another"
        )
    out.mkdir(exist_ok=True)
    for name in RUNS:
        if (out / name).is_dir():
            shutil.rmtree(out / name)


def _is_demo(out: Path) -> bool:
    """Return whether a demo wrote here, or began to."""
    try:
        summary = text_json.loads((out / "summary.json").read_text())
        return isinstance(summary, dict) and "checks" in summary
    except (OSError, ValueError):
        return {path.name for path in out.iterdir()} <= {*RUNS, *FILES} and (out / "bench" / "journal.jsonl").is_file()


def _judged(device: "DeviceModel", out: Path) -> tuple["BenchFit", tuple["Trial", ...]]:
    """Fit calibration and tables, and judge a worn trial."""
    from undrift.correction.correct import correct_checked
    from undrift.io.formats import read_record, read_reference, write_record
    from undrift.io.reference import write_reference
    from undrift.io.session import read_session
    from undrift.io.store import read_calibration, write_calibration
    from undrift.study.virtual_bench import fit_bench, judge_levels, worn_trial

    fit = fit_bench(read_session(out / "bench"), read_session(out / "thermal"))
    write_calibration(fit.drift.calibration, out / "calibration.json")
    made = worn_trial(device, seed=SEED)
    write_record(made[0], out / "trial.parquet")
    write_reference(made[1], out / "reference.parquet")
    record = read_record(out / "trial.parquet")  # what is judged is read from the disk
    corrected = correct_checked(record, read_calibration(out / "calibration.json"))
    write_record(corrected.record, out / "corrected.parquet")
    return fit, judge_levels(fit, record, read_reference(out / "reference.parquet"))


def _studied(quick: bool, out: Path, shown: "_Shown") -> "StudyOutcome":
    from undrift.study.outcome import Course, judge_study
    from undrift.study.plan import note_study
    from undrift.study.run import InProcess, choose_executor

    # the note's study, reduced: a sit-to-stand brings Figure 3 with it, which the quick demo leaves out
    plan = note_study(subjects=4 if quick else 8, seed=SEED, quick=True)
    plan = replace(plan, tasks=plan.tasks[1:2]) if quick else plan

    def progress(what: str, share: float) -> None:
        shown(f"study: {what}", (1.0 - 0.5 * share) * STUDY_HOST_S[quick] + 0.5 * REST_HOST_S[quick])

    executor = InProcess() if quick else choose_executor(None, None)
    return judge_study(plan, executor, out / "study", course=Course(progress))


def _tell(out: Path, trials: tuple["Trial", ...], checks: tuple["Check", ...]) -> None:
    say(
        *(
            f"{'pass' if check.passed else 'FAIL'}  {check.name}: {check.value:.2g} (at most {check.limit:.2g})"
            for check in checks
        ),
        *(
            f"      pitch over the motion of the worn sit-to-stand, {trial.recording}: "
            f"{trial.figures.max_abs_pitch_deg:.2f} deg at most, {trial.figures.rmse_pitch_deg:.2f} deg rms"
            for trial in trials
        ),
        f"Wrote {out}: look at {out / 'report.html'}",
    )


class _Shown:
    """Says on stderr what is being done and how long it will take: one line written over on a terminal, else now and then one."""

    def __init__(self) -> None:
        self._live = sys.stderr.isatty()
        self._next_s = 0.0

    def __call__(self, what: str, left_s: float) -> None:
        now_s = time.monotonic()
        if now_s < self._next_s:
            return
        self._next_s = now_s + (0.1 if self._live else SHOWN_EVERY_S)
        line = f"{left_s:3.0f} s left  {what}"
        say_over(line) if self._live else say(line, err=True)

    def end(self) -> None:
        """Clear the line."""
        if self._live:
            sys.stderr.write("\r\x1b[K")
