"""The page of the demo: what was held against the truth, the worn trial, what the virtual bench did, its fits, the study."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from undrift.report.drift import drift_sections, plus_minus
from undrift.report.figures import DEVICE, ERROR, LIMIT, OPTICS, envelope, new_figure, svg_of
from undrift.report.page import Section, calibration_sections, write_page
from undrift.report.study import NOTE, study_sections
from undrift.report.validation import trials_section
from undrift.units import RADIAN_PER_DEGREE

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from undrift.rig.folder import Piece
    from undrift.study.outcome import StudyOutcome
    from undrift.study.virtual_bench import BenchFit, BenchRun, Check
    from undrift.validation.trial import Trial

LEVEL_COLOURS = (LIMIT, ERROR, DEVICE)


def write_demo_report(
    path: Path,
    made: "tuple[BenchRun, BenchFit, tuple[Trial, ...]]",
    checks: tuple["Check", ...],
    study: "StudyOutcome",
) -> None:
    """Write the page of the demo."""
    run, fit, trials = made
    none, _, full = (trial.figures.max_abs_pitch_deg for trial in trials)
    write_page(
        path,
        title="undrift demo: the note's method on a virtual bench",
        lead="A wearable device is calibrated on an emulated rate table and in an emulated chamber, over sockets, and worn: the "
        f"pitch of a sit-to-stand errs by up to {none:.2f} deg with a constant calibration, by {full:.2f} deg with tuning tables. "
        f"{NOTE}",
        verdict=fit.drift.verdict,
        sections=(
            check_section(checks),
            worn_section(trials),
            trials_section(trials),
            bench_section(run),
            rates_section(run),
            *calibration_sections(fit.constant),
            *(replace(section, title=f"Over temperature: {section.title}") for section in drift_sections(fit.drift)),
            _study_lead(study),
            *study_sections(study),
        ),
    )


def check_section(checks: tuple["Check", ...]) -> Section:
    """Return the table of checks."""
    failed = sum(not check.passed for check in checks)
    count = len(checks)
    text = f"All {count} are kept." if not failed else f"{failed} of {count} are NOT kept."
    return Section(
        title="Held against the hidden truth",
        text=(
            f"The device is drawn by a seed; nothing that fits or corrects knows it, and only these lines look it up. {text}",
        ),
        columns=("figure", "value", "at most", "kept"),
        rows=tuple((c.name, f"{c.value:.2g}", f"{c.limit:.2g}", "yes" if c.passed else "NO") for c in checks),
    )


def worn_section(trials: tuple["Trial", ...]) -> Section:
    """Return the worn trial: pitch, and its error at each level of correction."""
    from undrift.study.virtual_bench import EXCURSION_K

    largest = [trial.figures.max_abs_pitch_deg for trial in trials]
    notes = tuple(dict.fromkeys(note for trial in trials for note in trial.notes))
    return Section(
        title="A sit-to-stand with the device warmed by its wearer",
        text=(
            f"The trial is simulated with the same device, after half an hour on a person, {EXCURSION_K:g} K above the bench. "
            f"The tables take {largest[0] - largest[-1]:.2f} deg off the largest error of the pitch against simulated optics (the "
            "note, Figure 3: more than 3.2) while the person moves. Integration begins half a second before and goes on in the "
            "stance after.",
            *(f"{note[0].upper()}{note[1:]}." for note in notes),
        ),
        pictures=(svg_of(draw_levels(trials)),),
    )


def draw_levels(trials: tuple["Trial", ...]) -> "Figure":
    """Draw the pitch as the optics saw it, and the error at each level of correction."""
    figure, (angle, error) = new_figure(2)
    angle.plot(*envelope(trials[0].time, trials[0].reference_pitch / RADIAN_PER_DEGREE), color=OPTICS)
    angle.set_ylabel("pitch (deg)")
    angle.set_title("as the optics saw it", loc="left", fontsize=9)
    for trial, colour in zip(trials, LEVEL_COLOURS, strict=True):
        course = envelope(trial.time, trial.error.pitch / RADIAN_PER_DEGREE)
        error.plot(*course, color=colour, label=trial.recording)
    error.axhline(0.0, color=OPTICS, linewidth=0.6)
    error.set_ylabel("error (deg)")
    error.set_xlabel("time (s)")
    error.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, borderaxespad=0.2, frameon=False)
    return figure


def bench_section(run: "BenchRun") -> Section:
    """Return what was emulated, and how it differs from a bench of metal."""
    plan = run.plan
    rows = tuple(
        (
            name,
            str(len(result.pieces)),
            str(sum(piece.purpose == "rate" for piece in result.pieces)),
            ", ".join(f"{temp:g}" for temp in protocol.temperatures_c) or "room, 25",
            f"{result.duration_s / 60.0:.1f}",
            result.rig,
        )
        for name, protocol, result in (("bench", plan.bench, run.bench), ("thermal", plan.thermal, run.thermal))
    )
    return Section(
        title="The virtual bench",
        text=(
            "Device: three ENC-03J-like gyroscopes and three 3031-like accelerometers, 12 bits, an LM335-like thermometer: the "
            "note's, whose offset wanders by 0.1 deg/s per kelvin. Table: a servo card of Galil's language with its control loop, "
            "encoder and amplifier. Both, the chamber and the hands that mount the device are reached over TCP by the drivers that "
            "drive hardware.",
            f"Emulated time ran {plan.speed:g} times as fast as the host's, {run.host_s:.0f} s in all. So that soaks take half a "
            f"minute in place of an hour, this chamber heats by 10 K a second, the board follows within seconds, and a set-point "
            f"counts as reached after {plan.soak.window_s:g} s within {plan.soak.tolerance_c:g} K and "
            f"{plan.soak.slope_c_per_min:g} K/min. Real ones need 0.1 K/min over five minutes.",
        ),
        columns=("run folder", "dwells", "of them turns", "set-points (degC)", "table time (min)", "rig"),
        rows=rows,
    )


def rates_section(run: "BenchRun") -> Section:
    """Return nominal against achieved rates of the bench run."""
    turns = [piece for piece in run.bench.pieces if piece.purpose == "rate"]
    nominal = sorted({piece.nominal_turn_rate for piece in turns})
    rows = tuple(
        (f"{rate / RADIAN_PER_DEGREE:+g}", *(_achieved(turns, rate, axis) for axis in run.plan.bench.axes))
        for rate in nominal
    )
    return Section(
        title="Rates that the encoder showed",
        text=(
            "Calibration uses the achieved rates: the slope of the encoder's positions over each dwell, by the card's own clock. "
            "Standard uncertainties behind +- come from the steps of the encoder and of that clock, 1/1024 s.",
        ),
        columns=("nominal (deg/s)", *(f"about {axis} (deg/s)" for axis in run.plan.bench.axes)),
        rows=rows,
    )


def _achieved(turns: "list[Piece]", rate: float, axis: str) -> str:
    held = [piece for piece in turns if piece.axis == axis and piece.nominal_turn_rate == rate]
    if not held:
        return ""
    uncertainty = float(np.hypot.reduce([piece.turn_rate_uncertainty for piece in held])) / len(held)
    mean = float(np.mean([piece.turn_rate for piece in held]))
    return plus_minus(mean / RADIAN_PER_DEGREE, uncertainty / RADIAN_PER_DEGREE)


def _study_lead(study: "StudyOutcome") -> Section:
    held = study.study
    names = ", ".join(task.name.replace("_", " ") for task in held.tasks)
    return Section(
        title="A reduced study",
        text=(
            f"Which calibration protocol is enough for a task? {study.runs} simulated calibrations for {names} and "
            f"{held.subjects} subjects; undrift study --preset note does the whole of it.",
        ),
    )
