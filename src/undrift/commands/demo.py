"""``undrift demo``: the note's method on a simulated bench, with a page and a summary.

Only table, chamber and device are simulated. Their data are written to run folders and read back. Fits and corrections
never use the true parameters. Only the checks at the end use them.
"""

import json
import shutil
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import numpy as np

from undrift.base.options import WRITTEN, Flag
from undrift.calibration.calibrate import calibrate
from undrift.commands.outputs import check_folder, origin_of, write_results
from undrift.correction.correct import correct_checked
from undrift.drift.fit import DriftFit, fit_drift
from undrift.errors import InputError
from undrift.findings import finding
from undrift.io.formats import write_record
from undrift.io.reference import write_reference
from undrift.io.session import read_session
from undrift.io.store import calibration_json, write_calibration
from undrift.programme import Protocol
from undrift.report import Report, Table
from undrift.report.figures import draw_levels
from undrift.report.study import NOTE, SLOPE_OF_THE_NOTE
from undrift.rig.run import RunResult
from undrift.screen import part, progress
from undrift.sim.device.model import DeviceModel
from undrift.study.figure3 import judge_compared
from undrift.study.sessions import WARM_C
from undrift.study.virtual_bench import (
    SOAK,
    SOAK_C_PER_MIN,
    Check,
    bench_device,
    bench_protocols,
    compare_with_truth,
    record_on_bench,
    worn_trial,
)
from undrift.units import RADIAN_PER_DEGREE
from undrift.validation.trial import Trial

SEED = 2007
RUNS = ("bench", "thermal")  # folders of an earlier demo
FILES = ("trial.parquet", "reference.parquet", "calibration.json", "corrected.parquet", "report.html")
RECORDED, FITTED = 0.75, 0.9  # progress of the demo after recording, and after fitting
BENCH = (
    "Device: three ENC-03J-like gyroscopes and three 3031-like accelerometers, 12 bits and an LM335-like thermometer, as in the "
    "note. Its offset drifts by 0.1 deg/s per kelvin. Table: the note's servo, with its control loop, encoder and "
    "amplifier. A run drives them like hardware. Simulated time does not depend on this computer. The chamber heats by 10 K per "
    "second, and the board follows within seconds. A set-point counts as reached after "
    f"{SOAK.window_s:g} s within {SOAK.tolerance_c:g} K and {SOAK_C_PER_MIN:g} K/min. A real chamber needs 0.1 K/min "
    "over five minutes."
)


def demo(*, out: Annotated[Path, WRITTEN] = Path("demo"), quick: Flag = False) -> Report:
    """Calibrate a device on a simulated bench, and correct a sit-to-stand recording.

    Parameters
    ----------
    out : Path
        Folder for the runs, calibration.json, the corrected trial, summary.json and report.html.
    quick : bool
        Use fewer rates and set-points, which takes 20 seconds instead of 60.
    """
    _check_fresh(out)
    device = bench_device()
    try:
        with part(0.0, RECORDED):
            protocols = bench_protocols(quick=quick)
            runs = record_on_bench(protocols, device, out, tell=progress)
    except InputError as error:
        if not isinstance(disk := error.__cause__, OSError):
            raise
        raise InputError(
            f"{out}: the recordings cannot be written ({disk.strerror or disk}). Free disk space and run the demo again."
        ) from disk
    progress("fitting calibration and tables, judging a worn trial", RECORDED)
    fit, trials = _judge_trials(device, out)
    progress("report", FITTED)
    report = _report(out, _bench(protocols, runs), fit, trials, compare_with_truth(fit, trials, device))
    write_results(out, report, "demo", origin_of(*(out / name for name in FILES[:3])))
    return report


def _check_fresh(out: Path) -> None:
    """Raise for a folder with other files, and delete the runs of an earlier demo, even if it was interrupted."""
    check_folder(out)
    names = {path.name for path in out.iterdir()} if out.is_dir() else set()
    with suppress(OSError, ValueError, AttributeError):
        is_demo = json.loads((out / "summary.json").read_text()).get("kind") == "undrift.demo"
        names = set() if is_demo else names
    if names and not (names <= {*RUNS, *FILES} and (out / "bench" / "protocol.toml").is_file()):
        raise InputError(
            f"{out}: expected a new folder or the folder of an earlier demo, got other files. Choose another folder."
        )
    out.mkdir(exist_ok=True)
    for name in RUNS:
        if (out / name).is_dir():
            shutil.rmtree(out / name)


def _judge_trials(device: DeviceModel, out: Path) -> tuple[DriftFit, tuple[Trial, ...]]:
    """Fit calibration and tables, and judge a worn trial at each level of correction."""
    bench, thermal = read_session(out / "bench"), read_session(out / "thermal")
    fit = fit_drift((bench, thermal), calibrate(bench))
    write_calibration(fit.calibration, out / "calibration.json")
    record, reference = worn_trial(device, seed=SEED)
    write_record(record, out / "trial.parquet")
    write_reference(reference, out / "reference.parquet")
    write_record(correct_checked(record, fit.calibration).record, out / "corrected.parquet")
    return fit, judge_compared(fit.calibration, record, reference)


def _report(out: Path, bench: Table, fit: DriftFit, trials: tuple[Trial, ...], checks: tuple[Check, ...]) -> Report:
    none, _, full, rest, both = (f"{trial.figures.max_abs_pitch_deg:.2f} deg" for trial in trials)
    truth = Table(
        title="Compared with the hidden truth",
        columns=("figure", "value", "at most", "passed"),
        rows=[(check.name, check.value, check.limit, check.passed) for check in checks],
        form=".2g",
        note="The device is drawn at random from a seed. Only these checks use its true parameters.",
    )
    findings = [*fit.verdict.findings, *trials[-1].findings]  # findings of the recommended level
    if failed := [check.name for check in checks if not check.passed]:
        sentence = f"{len(failed)} of {len(checks)} checks against the hidden truth fail: {', '.join(failed)}."
        findings.append(finding("demo.check", "fail", sentence, "Please report this.", failed=len(failed)))
    return Report(
        title="undrift demo: the note's method on a simulated bench",
        answer=f"Largest pitch error over the {trials[0].figures.motion_s:.1f} s of a sit-to-stand: {none} with a constant "
        f"calibration, {rest} with the offset of a rest before the motion, {full} with tables over temperature, {both} "
        "with both.",
        tables=[_levels(trials), truth],
        details=[bench],
        notes=[NOTE],
        findings=findings,
        judged=True,
        figures=[lambda: draw_levels(trials)],
        written=[out / "report.html", out / "calibration.json", out / "corrected.parquet"],
        data={
            "calibration": calibration_json(fit.calibration),
            "checks": [{"name": c.name, "value": c.value, "limit": c.limit, "pass": c.passed} for c in checks],
        },
        next_command=("info", out / "calibration.json", "--report", "calibration.html"),
    )


def _levels(trials: tuple[Trial, ...]) -> Table:
    """Return the pitch error at each level of correction."""
    largest = [trial.figures.max_abs_pitch_deg for trial in trials]
    final_deg = np.nanmax(np.abs(trials[0].error.pitch)) / RADIAN_PER_DEGREE
    note = (
        "A wearable device is calibrated on a simulated rate table and in a simulated chamber. Then a simulated person "
        f"wears it for half an hour, and it is {WARM_C:g} K warmer than on the bench. During the motion, the tables "
        f"remove {largest[0] - largest[2]:.2f} deg of the largest pitch error (the note, Figure 3: more than 3.2). Without "
        f"tables, but with the offset of the rest before the motion, {largest[3]:.2f} deg are left, from scale and dynamic "
        "drift. After the motion the person stays upright. These figures do not include that time. With a constant "
        f"calibration the error then grows to {final_deg:.1f} deg. {SLOPE_OF_THE_NOTE}"
    )
    return Table(
        title="A sit-to-stand task with a device warmed by its wearer",
        columns=("correction", "largest pitch error (deg)", "pitch error, rms (deg)"),
        rows=[(trial.recording, trial.figures.max_abs_pitch_deg, trial.figures.rmse_pitch_deg) for trial in trials],
        form=".2f",
        note=note,
    )


def _bench(protocols: tuple[Protocol, ...], runs: tuple[RunResult, ...]) -> Table:
    """Return the runs on the simulated bench."""
    rows = [
        (
            protocol.name,
            len(result.pieces),
            sum(piece.purpose == "rate" for piece in result.pieces),
            ", ".join(f"{temp:g}" for temp in protocol.temperatures_c) or "room, 25",
            result.duration_s / 60.0,
            result.rig,
        )
        for protocol, result in zip(protocols, runs, strict=True)
    ]
    columns = ("run folder", "dwells", "of them turns", "set-points (degC)", "table time (min)", "rig")
    return Table(title="The simulated bench", columns=columns, rows=rows, form=".1f", note=BENCH)
