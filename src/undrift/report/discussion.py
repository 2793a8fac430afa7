"""The note's Discussion on a page: other ways to calibrate, each triad alone, and what becomes of its claims."""

from typing import TYPE_CHECKING

from undrift.base.summary import Cells, Section, interval, plain_words, rows_section, table_section

if TYPE_CHECKING:
    from undrift.study.outcome import StudyOutcome
    from undrift.study.rivals import RivalRow, Spread
    from undrift.study.statistics import Decision


def rival_sections(outcome: "StudyOutcome") -> tuple[Section, ...]:
    """Return the sections on other ways to calibrate."""
    title = "The note's Discussion as an experiment: other ways to calibrate"
    if not outcome.rivals:
        missing = outcome.rivals_missing
        return (Section(title=title, findings=(missing,) if missing else ()),)
    first = outcome.rivals[0]
    kind = "the note's kind, in place of the one device," if outcome.study.worn else outcome.study.device
    cells: Cells[RivalRow] = (
        ("task", lambda row: plain_words(row.task)),
        ("method", lambda row: plain_words(row.method)),
        ("calibrates", lambda row: ", ".join(row.observable) or "nothing"),
        ("min", lambda row: f"{row.minutes:.1f}"),
        ("rms (deg)", lambda row: _spread(row.error_rms_deg)),
        ("max (deg)", lambda row: _spread(row.error_max_deg)),
        ("max of the change (deg)", lambda row: _spread(row.change_max_deg)),
        ("refused", lambda row: f"{row.refused} of {row.units}"),
    )
    text = (
        f"{first.units} units of {kind} calibrated by each method in about the time of the note's rate table, then worn in the "
        "same tasks at the temperature of the calibration: median [least to greatest] of the pitch error over the units.",
        "The change of pitch since the motion began excludes the tilt at the start, which the accelerometers give. Where a "
        "method cannot calibrate a triad, the data sheet is used. Refused units, whose gravity at rest is too far from the local "
        "value, have no figure.",
    )
    limits: Cells[RivalRow] = (
        ("method", lambda row: plain_words(row.method)),
        ("findings of its fit, first unit", lambda row: "; ".join(row.notes)),
    )
    noted = [row for row in outcome.rivals if row.task == first.task and row.notes]
    return (
        table_section(title, outcome.rivals, cells, text=text),
        *(_triads(outcome, name) for name in ("accel", "gyro")),
        table_section("What each method cannot observe", noted, limits, words=True),
    )


def _triads(outcome: "StudyOutcome", name: str) -> Section:
    """Return one triad by each method, against the truth."""
    held = [row for row in outcome.rival_triads if row.triad == name]
    if not held:
        return Section(title="")
    unit, gyro = ("deg/s", True) if name == "gyro" else ("m/s2", False)
    rows = []
    for row in held:
        cells = {
            "method": "six faces, of the table's session"
            if row.method == "rate_table" and not gyro
            else plain_words(row.method),
            "calibrated": f"{row.calibrated} of {row.units}",
            "scale (%)": _spread(row.scale_percent),
            "cross-axis (%)": _spread(row.cross_axis_percent),
            f"offset ({unit})": _spread(row.offset),
        }
        for worth in row.worth:
            figure = f"change of pitch, {plain_words(worth.figure)}" if gyro else worth.figure
            cells |= {f"{figure} (deg)": _spread(worth.error_deg), f"{figure}: verdict": _verdict(worth.decision)}
        rows.append(cells)
    text = (
        "Errors against the true device: largest of the axes or terms of a unit, median [least to greatest] over the units. "
        "Cross-axis terms include the alignment to the case. Not calibrated: the data sheet, with what rests add.",
        "Largest change of pitch from the start, with accelerometers that are exact."
        if gyro
        else "Tilt: root-mean-square over 26 directions of gravity.",
        f"Verdict against the {'rate table' if gyro else 'six faces'} with the margin of a largest error: difference, negative "
        "where the method is worse, and its 95 % interval. All verdicts of this table together are wrong in at most "
        f"{100.0 * outcome.study.level:g} % of studies.",
    )
    return rows_section("Gyroscopes alone" if gyro else "Accelerometers alone", rows, text=text)


def _verdict(found: "Decision | None") -> str:
    if found is None:
        return ""
    return f"{found.verdict}: {found.difference:.3f} [{interval(found.interval)}]"


def _spread(spread: "Spread") -> str:
    if spread.median != spread.median:
        return "no unit"
    return f"{spread.median:.3f} [{spread.least:.3f} to {spread.greatest:.3f}]"


# ---- claims


def claims_section(outcome: "StudyOutcome") -> Section:
    """Return each claim of the note beside what the study shows of it."""
    from undrift.study.claims import claims_of

    rows = []
    for row in claims_of(outcome):
        head = {
            "claim of the note": row.claim,
            "stands in": row.stands,
            "its number": row.printed,
            "verdict": row.verdict,
        }
        if row.lacks is not None:
            rows.append(head | {"here": row.lacks.text, "deg [95 %]": "", "test": "", "by itself": ""})
        for each in row.evidence:
            there = each.interval_deg[0] == each.interval_deg[0]
            value = f"{each.value_deg:.3f}" + (f" [{interval(each.interval_deg)}]" if there else "")
            rows.append(head | {"here": each.what, "deg [95 %]": value, "test": each.test, "by itself": each.verdict})
            head = dict.fromkeys(head, "")
    text = (
        "A claim that one error is less than another holds where that is shown beyond the margin. It does not hold where the two "
        "are shown to be equivalent, or the other way round. All comparisons of a claim have to hold; of a method that does not "
        "suit, or an optimum that depends on the task, one has to.",
    )
    return rows_section("Claims of the note", rows, text=text, words=True)
