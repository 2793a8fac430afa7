"""The page of the demo: comparison with the truth, the worn trial, the virtual bench, its fits, the study."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from undrift.base.summary import Cells, Origin, Section, Summary, plain_words, plus_minus, table_section
from undrift.commands.calibrate import calibration_sections
from undrift.commands.drift import drift_sections
from undrift.commands.study_sections import NOTE, SLOPE_OF_THE_NOTE, sections_of
from undrift.commands.validate import trials_section
from undrift.report.figures import OPTICS, compared_style, entitle, envelope, legend_above, new_figure, svg_of
from undrift.report.page import write_page
from undrift.units import RADIAN_PER_DEGREE

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from undrift.rig.folder import Piece
    from undrift.rig.programme import Protocol
    from undrift.rig.run import RunResult
    from undrift.study.outcome import StudyOutcome
    from undrift.study.virtual_bench import BenchFit, BenchRun, Check
    from undrift.validation.trial import Trial


def write_demo_report(
    path: Path,
    made: "tuple[BenchRun, BenchFit, tuple[Trial, ...]]",
    checks: tuple["Check", ...],
    study: "StudyOutcome",
    origin: Origin | None = None,
) -> None:
    """Write the page of the demo."""
    run, fit, trials = made
    none, _, full, rest, both = (f"{trial.figures.max_abs_pitch_deg:.2f} deg" for trial in trials)
    sections = (
        trials_section(trials),
        _bench(run),
        _rates(run),
        *calibration_sections(fit.constant),
        *(replace(section, title=f"Over temperature: {section.title}") for section in drift_sections(fit.drift)),
        _study_lead(study),
        *sections_of(study),
    )
    summary = Summary(
        title="undrift demo: the note's method on a virtual bench",
        answer=f"Largest pitch error over the {trials[0].figures.motion_s:.1f} s of a sit-to-stand: {none} with a constant "
        f"calibration, {rest} re-zeroed at a rest before the motion, {full} with tuning tables, {both} with both.",
        pictures=(svg_of(_draw_worn(trials)),),
        verdict=fit.drift.verdict,
        findings=tuple(item for trial in trials for item in trial.findings),
        sections=(_worn(trials), _checks(checks), *(replace(section, folded=True) for section in sections)),
    )
    write_page(path, summary, origin)


def _checks(checks: tuple["Check", ...]) -> Section:
    failed = sum(not check.passed for check in checks)
    passed = f"All {len(checks)} pass." if not failed else f"{failed} of {len(checks)} FAIL."
    cells: Cells[Check] = (
        ("figure", lambda check: check.name),
        ("value", lambda check: f"{check.value:.2g}"),
        ("at most", lambda check: f"{check.limit:.2g}"),
        ("passed", lambda check: "yes" if check.passed else "NO"),
    )
    text = f"The device is drawn by a seed. Fits and corrections do not know it; these checks alone do. {passed}"
    return table_section("Compared with the hidden truth", checks, cells, text=(text,))


def _draw_worn(trials: tuple["Trial", ...]) -> "Figure":
    """Draw the pitch of the worn trial, and its error at each level of correction: over the motion, as the figures are."""
    figure, (angle, error) = new_figure(2)
    seen = trials[0].moving > 0.0
    angle.plot(*envelope(trials[0].time[seen], trials[0].reference_pitch[seen] / RADIAN_PER_DEGREE), color=OPTICS)
    angle.set_ylabel("pitch (deg)")
    entitle(figure, "Pitch over the motion of a sit-to-stand by the optics, and its error at each level of correction")
    for k, trial in enumerate(trials):
        moving = trial.moving > 0.0
        course = envelope(trial.time[moving], trial.error.pitch[moving] / RADIAN_PER_DEGREE)
        error.plot(*course, label=trial.recording, **compared_style(k))
    error.axhline(0.0, color=OPTICS, linewidth=0.6)
    error.set(xlabel="time (s)", ylabel="error (deg)")
    legend_above(error)
    return figure


def _worn(trials: tuple["Trial", ...]) -> Section:
    """Say what the worn trial shows."""
    from undrift.study.virtual_bench import EXCURSION_K

    largest = [trial.figures.max_abs_pitch_deg for trial in trials]
    after = np.nanmax(np.abs(trials[0].error.pitch)) / RADIAN_PER_DEGREE
    return Section(
        title="A sit-to-stand with the device warmed by its wearer",
        text=(
            f"A wearable device is calibrated on an emulated rate table and in an emulated chamber, over sockets, and worn. {NOTE}",
            f"Simulated with the same device after half an hour on a person, {EXCURSION_K:g} K above the bench. While the person "
            f"moves, the tables remove {largest[0] - largest[2]:.2f} deg of the largest pitch error against simulated optics (the "
            f"note, Figure 3: more than 3.2). The offset re-zeroed at the rest before leaves {largest[3]:.2f} deg: scale and "
            "dynamic drift. Integration begins half a second before the motion. In the stance after it, which is in none of these "
            f"figures, the error with a constant calibration grows to {after:.1f} deg.",
            SLOPE_OF_THE_NOTE,
        ),
    )


def _bench(run: "BenchRun") -> Section:
    """Show what was emulated, and how it differs from a real bench."""
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
        "whose offset drifts by 0.1 deg/s per kelvin. Table: a servo card of Galil's language with its control loop, encoder and "
        "amplifier. Device, table, chamber and mounting are reached over TCP by the drivers for hardware.",
        f"Emulated time ran {plan.speed:g} times as fast as the host's, {run.host_s:.0f} s in all. The chamber heats by 10 K a "
        f"second and the board follows within seconds. A set-point counts as reached after {SOAK.window_s:g} s within "
        f"{SOAK.tolerance_c:g} K and {SOAK.slope_c_per_min:g} K/min; a real one needs 0.1 K/min over five minutes.",
    )
    return table_section("The virtual bench", ((plan.bench, run.bench), (plan.thermal, run.thermal)), cells, text=text)


def _rates(run: "BenchRun") -> Section:
    """Show nominal and achieved rates of the bench run."""
    turns = [piece for piece in run.bench.pieces if piece.purpose == "rate"]
    axes = run.plan.bench.axes
    nominal = sorted({piece.nominal_turn_rate for piece in turns})
    return Section(
        title="Rates that the encoder showed",
        text=(
            "Calibration uses the achieved rates: the slope of the encoder's positions over each dwell, by the card's own clock. "
            "Standard uncertainties behind +- come from the steps of the encoder and of that clock, 1/1024 s.",
        ),
        columns=("nominal (deg/s)", *(f"about {axis} (deg/s)" for axis in axes)),
        rows=tuple(
            (f"{rate / RADIAN_PER_DEGREE:+g}", *(_achieved(turns, rate, axis) for axis in axes)) for rate in nominal
        ),
    )


def _achieved(turns: "list[Piece]", rate: float, axis: str) -> str:
    held = [piece for piece in turns if piece.axis == axis and piece.nominal_turn_rate == rate]
    if not held:
        return ""
    uncertainty = float(np.hypot.reduce([piece.turn_rate_uncertainty for piece in held])) / len(held)
    mean = float(np.mean([piece.turn_rate for piece in held]))
    return plus_minus(mean / RADIAN_PER_DEGREE, uncertainty / RADIAN_PER_DEGREE)


def _study_lead(study: "StudyOutcome") -> Section:
    names = ", ".join(plain_words(task.name) for task in study.study.tasks)
    return Section(
        title="A reduced study",
        text=(
            f"Which calibration protocol is enough for a task? {study.runs} simulated calibrations for {names} and "
            f"{study.study.subjects} subjects; undrift study --preset note does all of it.",
        ),
    )
