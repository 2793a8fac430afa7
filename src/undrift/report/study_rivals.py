"""More of a study's page: rates to dwell at, the note's Discussion as an experiment, real recordings."""

from typing import TYPE_CHECKING

import numpy as np

from undrift.report.page import Section

if TYPE_CHECKING:
    from undrift.study.outcome import StudyOutcome
    from undrift.study.real import BesideRow, Pairwise, RealErrors, RealOutcome, Worn
    from undrift.study.rivals import DesignRow, RivalRow, Spread

MANY = 8  # rates; more are told by their ends
TOLD_S = 10.0  # of motion, for which a rate error is told as an angle


def design_sections(rows: "tuple[DesignRow, ...]") -> tuple[Section, ...]:
    """Return the section on rates to dwell at."""
    if not rows:
        return ()
    held = [row for row in rows if row.degree == max(rows, key=lambda r: r.degree).degree]
    return (
        Section(
            title="Rates to dwell at: D- and I-optimal sets against the uniform grid",
            text=(
                "All sets have the grid's dwelling time and greatest rate. D: the coefficients together are known best; I: the "
                "rate is wrong by least over the task, whose rates are those of the cohort about the axis of the pitch. "
                "Efficiency: what the uniform grid has of the set's information; 0.5 needs twice the time, above 1 the grid is "
                "the better by that measure. The error is that of the white noise of the dwells through the fitted curve; "
                "what the offset wanders comes on top, whatever the rates.",
                *(_meaning(row, rows) for row in held if row.criterion == "I"),
            ),
            columns=(
                "task",
                "curve",
                "set",
                "time at rates of an axis (deg/s)",
                "grid's D-efficiency",
                "grid's I-efficiency",
                "dwells",
                "each (s)",
                "rate error (deg/s)",
            ),
            rows=tuple(_design_row(row) for row in rows),
        ),
    )


def _meaning(best: "DesignRow", rows: "tuple[DesignRow, ...]") -> str:
    curve = _curve(best.degree)
    own = [row for row in rows if (row.task, row.degree) == (best.task, best.degree)]
    even = next(row for row in own if row.criterion == "uniform")
    text = (
        f"{_words(best.task)}, {curve}: the I-optimal set reaches the error of {best.grid} grid in "
        f"{100.0 * best.i_efficiency_uniform:.0f} % of its dwelling time"
    )
    if best.error_dps is not None and even.error_dps is not None:
        text += f" (or {best.error_dps:.2g} in place of {even.error_dps:.2g} deg/s in the same: "
        text += f"{TOLD_S * abs(even.error_dps - best.error_dps):.1g} deg in {TOLD_S:g} s of motion, were it all of one sign)"
    beyond = "" if best.beyond == 0.0 else f" {100.0 * best.beyond:.2g} % of the task's rates are above the grid's."
    return f"{text}.{beyond}"


def _design_row(row: "DesignRow") -> tuple[str, ...]:
    pairs = [f"{100.0 * share:.0f} % at {rate:.3g}" for rate, share in zip(row.turn_rate_dps, row.share, strict=True)]
    rates = ", ".join(pairs)
    if len(pairs) > MANY:
        rates = f"{len(pairs)} rates from {row.turn_rate_dps[0]:.3g} to {row.turn_rate_dps[-1]:.3g}, equal shares"
    even = row.criterion == "uniform"
    return (
        _words(row.task),
        _curve(row.degree),
        f"{row.grid} grid" if even else f"{row.criterion}-optimal",
        rates,
        "" if even else f"{row.d_efficiency_uniform:.2f}",
        "" if even else f"{row.i_efficiency_uniform:.2f}",
        f"{row.dwells}",
        "not told" if row.dwell_s is None else f"{row.dwell_s:g}",
        "not told" if row.error_dps is None else f"{row.error_dps:.2g}",
    )


def _curve(degree: int) -> str:
    return {1: "line", 3: "cubic"}.get(degree, f"degree {degree}")


def rival_sections(outcome: "StudyOutcome") -> tuple[Section, ...]:
    """Return the section on other ways to calibrate."""
    title = "The note's Discussion as an experiment: other ways to calibrate"
    if not outcome.rivals:
        return (Section(title=title, text=(f"Not made: {outcome.rivals_missing}.",)),)
    units = outcome.rivals[0].units
    first = outcome.rivals[0].task
    kind = "the note's kind, in place of the one device," if outcome.study.worn else f"{outcome.study.device}"
    return (
        Section(
            title=title,
            text=(
                f"{units} units of {kind} calibrated by each method in about the time of the note's rate table, then worn in the "
                "same tasks at the temperature of the calibration: median [least to greatest] of the pitch error over the "
                "units. The change of pitch since the motion began leaves the tilt at the start, which the accelerometers "
                "give, out. Where a method cannot calibrate a triad, the data sheet stands in. Refused: units whose "
                "tilt at the start could not be taken, gravity being too long or too short; they are in no figure.",
            ),
            columns=(
                "task",
                "method",
                "calibrates",
                "min",
                "rms (deg)",
                "max (deg)",
                "max of the change (deg)",
                "refused",
            ),
            rows=tuple(_rival_row(row) for row in outcome.rivals),
        ),
        Section(
            title="What each way cannot see",
            columns=("method", "in the words of its fit, first unit"),
            rows=tuple(
                (_words(row.method), "; ".join(row.said)) for row in outcome.rivals if row.task == first and row.said
            ),
            words=True,
        ),
    )


def _rival_row(row: "RivalRow") -> tuple[str, ...]:
    return (
        _words(row.task),
        _words(row.method),
        ", ".join(row.observable) or "nothing",
        f"{row.minutes:.1f}",
        *(_spread(spread) for spread in (row.error_rms_deg, row.error_max_deg, row.change_max_deg)),
        f"{row.refused} of {row.units}",
    )


def _spread(spread: "Spread") -> str:
    if not np.isfinite(spread.median):
        return "no unit"
    return f"{spread.median:.3f} [{spread.least:.3f} to {spread.greatest:.3f}]"


def real_sections(real: "RealOutcome | None") -> tuple[Section, ...]:
    """Return the sections on real recordings."""
    if real is None:
        return ()
    made = [
        *(_trials(real.errors) if real.errors else ()),
        *_beside("Real recordings: captured people beside the cohort", real.motions),
        *(() if real.worn is None else (_worn(real.worn),)),
        *_beside("Real recordings: stance on a force plate beside the cohort's sway", real.sways),
    ]
    if real.lacks:
        made.append(Section(title="Real recordings: what is not there", text=tuple(f"{lack}." for lack in real.lacks)))
    return tuple(made)


def _trials(levels: "tuple[RealErrors, ...]") -> tuple[Section, ...]:
    rows: list[tuple[str, ...]] = [
        (
            trial.recording,
            level.level,
            level.rounding,
            f"{trial.figures.rmse_total_deg:.2f}",
            f"{trial.figures.rmse_inclination_deg:.2f}",
            _number(trial.figures.max_abs_pitch_deg),
            _number(trial.figures.end_total_deg),
        )
        for level in levels
        for trial in level.trials
    ]
    rows += [
        (
            "median",
            level.level,
            level.rounding,
            *(_number(v) for v in (level.rmse_total_deg, level.rmse_inclination_deg)),
            *(_number(v) for v in (level.max_abs_pitch_deg, level.end_total_deg)),
        )
        for level in levels
    ]
    return (
        Section(
            title="Real recordings: devices worn beside optics",
            text=(
                "none: no offset taken off; rest: less the mean rate of the first rest; calibrated: a gyroscope fit to the other "
                "trials of the same device, which never saw the one that is judged.",
                _rounding(levels),
                *(
                    _agreement(f"{level.level}, rounding {level.rounding}", level.agreement)
                    for level in levels
                    if level.agreement is not None
                ),
            ),
            columns=(
                "recording",
                "level",
                "converter's rounding",
                "total rms (deg)",
                "inclination rms",
                "largest pitch error",
                "total at the end",
            ),
            rows=tuple(rows),
        ),
    )


def _rounding(levels: "tuple[RealErrors, ...]") -> str:
    if levels[0].rounding == "none found":
        return "The codes of no recording show that the converter rounds: all are taken as they come."
    return (
        "Converters that cut off what is below a step leave half a step as an offset. Rounding undone: the half step that the "
        "codes show is given back, at all three levels; left in: at none. Compare levels with the same treatment alone."
    )


def _agreement(level: str, held: "Pairwise") -> str:
    limits, icc = held.limits, held.icc
    return (
        f"{level}: {held.quantity}: bias {limits.bias:.2f}, limits of agreement {limits.limits[0]:.2f} to "
        f"{limits.limits[1]:.2f} ({limits.count} trials); ICC(2,1) {icc.value:.4f} [{icc.interval[0]:.4f}, "
        f"{icc.interval[1]:.4f}]."
    )


def _beside(title: str, rows: "tuple[BesideRow, ...]") -> tuple[Section, ...]:
    if not rows:
        return ()
    lacks = dict.fromkeys(f"{row.trial}: {row.said}." for row in rows if row.said)
    return (
        Section(
            title=title,
            text=(
                "Other people than the cohort: nothing is paired, a figure is within the cohort's 95 % or not.",
                *lacks,
            ),
            columns=("trial", "task", "measure", "real", "cohort's median", "cohort's 95 %", "inside"),
            rows=tuple(
                (
                    row.trial,
                    _words(row.task),
                    f"{row.measure} ({row.unit})",
                    _number(row.real),
                    f"{row.median:.2f}",
                    f"{row.low:.2f} to {row.high:.2f}",
                    "" if not np.isfinite(row.real) else "yes" if row.inside else "no",
                )
                for row in rows
            ),
        ),
    )


def _worn(worn: "Worn") -> Section:
    return Section(
        title="Real recordings: the simulated device worn in the captured motions",
        text=(
            "Pitch that the device would show against the optics, without compensation, static alone and in full.",
            *(_agreement(level, held) for level, held in worn.agreement),
        ),
        columns=(
            "trial",
            "compensation",
            "rms (deg)",
            "max (deg)",
            "lean, optics (deg)",
            "lean, device (deg)",
            "length (s)",
            "saturated (%)",
        ),
        rows=tuple(
            (
                row.trial,
                row.level,
                f"{row.error_rms_deg:.2f}",
                f"{row.error_max_deg:.2f}",
                f"{row.lean_optics_deg:.1f}",
                f"{row.lean_device_deg:.1f}",
                f"{row.length_s:.1f}",
                f"{100.0 * row.saturated:.1f}",
            )
            for row in worn.rows
        ),
    )


def _number(value: float) -> str:
    return f"{value:.2f}" if np.isfinite(value) else "not told"


def _words(text: str) -> str:
    return text.replace("_", " ")
