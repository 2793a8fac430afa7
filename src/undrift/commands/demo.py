"""``undrift demo``: the note's method on a simulated bench, with a page and a summary.

Only table, chamber and device are simulated. Their data are written to run folders and read back. Fits and corrections
never use the true parameters. Only the checks at the end use them.
"""

import json
import math
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from undrift.base.options import WRITTEN, Flag, verb
from undrift.base.summary import Cells, Section, Summary, at, figure_of, plus_minus, table_section
from undrift.commands import Progress, part_of, silent
from undrift.commands.calibrate import calibration_sections
from undrift.commands.files import check_folder, origin_of, save_json
from undrift.errors import InputError
from undrift.units import RADIAN_PER_DEGREE

if TYPE_CHECKING:
    from undrift.programme import Protocol
    from undrift.rig.folder import RecordedDwell
    from undrift.rig.run import RunResult
    from undrift.sim.device.model import DeviceModel
    from undrift.study.virtual_bench import BenchFit, BenchRun, Check
    from undrift.validation.trial import Trial

SEED = 2007
RUNS = ("bench", "thermal")  # folders of an earlier demo
PAGES = ("report.html", "tables.html")  # the report, and the tables over temperature behind it
FILES = ("calibration.json", "trial.parquet", "reference.parquet", "corrected.parquet", *PAGES)
RECORDED, FITTED = 0.75, 0.9  # shares of the time when all is recorded, and when all is fitted


@verb
def demo(*, out: Annotated[Path, WRITTEN] = Path("demo"), quick: Flag = False, progress: Progress = silent) -> Summary:
    """Calibrate a device on a simulated bench, and correct a sit-to-stand recording.

    Parameters
    ----------
    out : Path
        Folder for the runs, calibration.json, the corrected trial, summary.json and two pages, report.html and tables.html.
    quick : bool
        Fewer rates and set-points: 20 seconds in place of 60.
    """
    from undrift.study.virtual_bench import bench_device, bench_plan, compare_with_truth, record_on_bench

    _check_fresh(out)
    device = bench_device()
    try:
        run = record_on_bench(bench_plan(quick=quick), device, out, tell=part_of(progress, 0.0, RECORDED))
    except InputError as error:
        if not isinstance(disk := error.__cause__, OSError):
            raise
        raise InputError(
            f"{out}: the recordings cannot be written ({disk.strerror or disk}). Free disk space and run the demo again."
        ) from disk
    progress("fitting calibration and tables, judging a worn trial", RECORDED)
    fit, trials = _judge_trials(device, out)
    progress("report", FITTED)
    overview = _summary(out, (run, fit, trials), compare_with_truth(fit, trials, device))
    origin = origin_of(out / "trial.parquet", out / "reference.parquet", out / "calibration.json")
    for name, page in zip(PAGES, (overview, _tables(fit)), strict=True):
        at("undrift.report.page:write_page")(out / name, page, origin)
    save_json(out / "summary.json", overview.data)
    return overview


def _check_fresh(out: Path) -> None:
    """Refuse a folder with other files, and delete the runs of an earlier demo."""
    check_folder(out)
    if out.is_dir() and any(out.iterdir()) and not _is_demo(out):
        raise InputError(
            f"{out}: expected a new folder or the folder of an earlier demo, got other files. Choose another folder."
        )
    out.mkdir(exist_ok=True)
    for name in RUNS:
        if (out / name).is_dir():
            shutil.rmtree(out / name)


def _is_demo(out: Path) -> bool:
    """Return whether a demo wrote here, or began to."""
    try:
        summary = json.loads((out / "summary.json").read_text())
        return isinstance(summary, dict) and "checks" in summary
    except (OSError, ValueError):
        return {path.name for path in out.iterdir()} <= {*RUNS, *FILES} and (out / "bench" / "protocol.toml").is_file()


def _judge_trials(device: "DeviceModel", out: Path) -> tuple["BenchFit", tuple["Trial", ...]]:
    """Fit calibration and tables, and judge a worn trial."""
    from undrift.correction.correct import correct_checked
    from undrift.io.formats import read_record, read_reference, write_record
    from undrift.io.reference import write_reference
    from undrift.io.session import read_session
    from undrift.io.store import read_calibration, write_calibration
    from undrift.study.figure3 import judge_compared
    from undrift.study.virtual_bench import fit_bench, worn_trial

    fit = fit_bench(read_session(out / "bench"), read_session(out / "thermal"))
    write_calibration(fit.drift.calibration, out / "calibration.json")
    trial = worn_trial(device, seed=SEED)
    write_record(trial[0], out / "trial.parquet")
    write_reference(trial[1], out / "reference.parquet")
    record = read_record(out / "trial.parquet")  # judge the data that are on the disk
    corrected = correct_checked(record, read_calibration(out / "calibration.json"))
    write_record(corrected.record, out / "corrected.parquet")
    return fit, judge_compared(fit.drift.calibration, record, read_reference(out / "reference.parquet"))


def _summary(
    out: Path, results: "tuple[BenchRun, BenchFit, tuple[Trial, ...]]", checks: "tuple[Check, ...]"
) -> Summary:
    from undrift.io.store import calibration_json

    run, fit, trials = results
    none, _, full, rest, both = (f"{trial.figures.max_abs_pitch_deg:.2f} deg" for trial in trials)
    return Summary(
        title="undrift demo: the note's method on a simulated bench",
        answer=f"Largest pitch error over the {trials[0].figures.motion_s:.1f} s of a sit-to-stand: {none} with a constant "
        f"calibration, {rest} with the offset of a rest before the motion, {full} with tables over temperature, {both} with both.",
        data={
            "calibration": calibration_json(fit.drift.calibration),
            "checks": [{"name": c.name, "value": c.value, "limit": c.limit, "pass": c.passed} for c in checks],
        },
        pictures=(figure_of("figures:draw_levels", trials),),
        verdict=fit.drift.verdict,
        findings=trials[-1].findings,  # of the recommended level: tables remove the remaining errors of constants
        sections=(_worn_section(trials), _checks(checks), *_details(run, fit), _more()),
        written=(out,),
        after=(f"look at {out / 'report.html'}",),
        failed=not all(check.passed for check in checks),
    )


def _details(run: "BenchRun", fit: "BenchFit") -> Iterator[Section]:
    for section in (_bench(run), _rates(run), *calibration_sections(fit.constant)):
        yield replace(section, folded=True)


def _tables(fit: "BenchFit") -> Summary:
    """Return the page with the tables over temperature."""
    from undrift.commands.drift import drift_summary

    return drift_summary(fit.drift)


def _more() -> Section:
    """Name what else there is to see."""
    return Section(
        title="Tables over temperature, and the study",
        text=(
            "The page tables.html has the tables over temperature, with their residuals and the verdict.",
            "undrift study --preset note finds the cheapest calibration session that is good enough for a task.",
        ),
    )


def _checks(checks: tuple["Check", ...]) -> Section:
    failed = sum(not check.passed for check in checks)
    passed = f"All {len(checks)} pass." if not failed else f"{failed} of {len(checks)} FAIL."
    cells: Cells[Check] = (
        ("figure", lambda check: check.name),
        ("value", lambda check: f"{check.value:.2g}"),
        ("at most", lambda check: f"{check.limit:.2g}"),
        ("passed", lambda check: "yes" if check.passed else "NO"),
    )
    text = f"The device is drawn at random from a seed. Only these checks use its true parameters. The fits do not. {passed}"
    return table_section("Compared with the hidden truth", checks, cells, text=(text,))


def _worn_section(trials: tuple["Trial", ...]) -> Section:
    """Return the text about the worn trial."""
    import numpy as np

    from undrift.report.study import NOTE, SLOPE_OF_THE_NOTE
    from undrift.study.virtual_bench import EXCURSION_K

    largest = [trial.figures.max_abs_pitch_deg for trial in trials]
    after = np.nanmax(np.abs(trials[0].error.pitch)) / RADIAN_PER_DEGREE
    return Section(
        title="A sit-to-stand task with a device warmed by its wearer",
        text=(
            f"A wearable device is calibrated on a simulated rate table and in a simulated chamber. Then a simulated "
            f"person wears it. {NOTE}",
            f"The person has worn the device for half an hour, and it is {EXCURSION_K:g} K warmer than on the bench. During the "
            f"motion, the tables remove {largest[0] - largest[2]:.2f} deg of the largest pitch error against simulated optics (the "
            f"note, Figure 3: more than 3.2). Without tables, but with the offset of the rest before the motion, {largest[3]:.2f} "
            "deg are left, from scale and dynamic drift. Integration begins half a second before the motion. After "
            "the motion the "
            "person stays upright. These figures do not include that time. With a constant "
            "calibration the error then grows to "
            f"{after:.1f} deg.",
            SLOPE_OF_THE_NOTE,
        ),
    )


def _bench(run: "BenchRun") -> Section:
    """Return the text about the simulated bench and its differences from a real bench."""
    from undrift.study.virtual_bench import SOAK

    plan = run.plan
    cells: Cells[tuple[Protocol, RunResult]] = (
        ("run folder", lambda row: row[0].name),
        ("dwells", lambda row: str(len(row[1].pieces))),
        ("of them turns", lambda row: str(sum(piece.purpose == "rate" for piece in row[1].pieces))),
        ("set-points (degC)", lambda row: ", ".join(f"{t:g}" for t in row[0].temperatures_c) or "room, 25"),
        ("table time (min)", lambda row: f"{row[1].duration_s / 60.0:.1f}"),
        ("rig", lambda row: row[1].rig),
    )
    text = (
        "Device: three ENC-03J-like gyroscopes and three 3031-like accelerometers, 12 bits, an LM335-like thermometer: the note's, "
        "whose offset drifts by 0.1 deg/s per kelvin. Table: the note's servo, with its control loop, encoder and amplifier. "
        "A run drives them as it drives hardware.",
        "Simulated time does not wait for this computer. The chamber heats by 10 K a "
        f"second and the board follows within seconds. A set-point counts as reached after {SOAK.window_s:g} s within "
        f"{SOAK.tolerance_c:g} K and {SOAK.slope_c_per_min:g} K/min. A real chamber needs 0.1 K/min over five minutes.",
    )
    return table_section(
        "The simulated bench", ((plan.bench, run.bench), (plan.thermal, run.thermal)), cells, text=text
    )


def _rates(run: "BenchRun") -> Section:
    """Show nominal and achieved rates of the bench run."""
    turns = [piece for piece in run.bench.pieces if piece.purpose == "rate"]
    axes = run.plan.bench.axes
    nominal = sorted({piece.nominal_turn_rate for piece in turns})
    return Section(
        title="Rates that the encoder showed",
        text=(
            "Calibration uses the achieved rates: the slope of the encoder's positions over each dwell. "
            "Standard uncertainties behind +- come from the steps of the encoder.",
        ),
        columns=("nominal (deg/s)", *(f"about {axis} (deg/s)" for axis in axes)),
        rows=tuple(
            (f"{rate / RADIAN_PER_DEGREE:+g}", *(_achieved(turns, rate, axis) for axis in axes)) for rate in nominal
        ),
    )


def _achieved(turns: "list[RecordedDwell]", rate: float, axis: str) -> str:
    matches = [piece for piece in turns if piece.axis == axis and piece.nominal_turn_rate == rate]
    if not matches:
        return ""
    uncertainty = math.hypot(*(piece.turn_rate_uncertainty for piece in matches)) / len(matches)
    mean = math.fsum(piece.turn_rate for piece in matches) / len(matches)
    return plus_minus(mean / RADIAN_PER_DEGREE, uncertainty / RADIAN_PER_DEGREE)
