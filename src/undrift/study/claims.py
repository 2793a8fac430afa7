"""Claims of the note's abstract, validation and discussion, each with what a study shows of it.

A claim that one thing has less error than another holds where that is shown beyond the margin; it does not hold where the two are
shown to be equivalent, or the other way round; else it is not decidable. A claim that two are alike holds where they are shown to
be equivalent. Verdicts are the three of study/statistics.py. Of several comparisons all have to hold, or one where the claim is
that something fails in some use. Below, the tables that show them, and the other ways to calibrate.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

import numpy as np

from undrift.arrays import FloatArray
from undrift.base.summary import Cells, Section, interval, plain_words, rows_section, table_section
from undrift.findings import Finding, finding
from undrift.sim.motion.tasks import TaskName
from undrift.study import judge
from undrift.study.figure3 import NOTE_APART_DEG, DrawnRow
from undrift.study.outcome import StudyOutcome, TaskOutcome
from undrift.study.plan import MARGIN_DEG
from undrift.study.rivals import Method, RivalRow, Spread, TriadName
from undrift.study.statistics import Decision, Pair, compare_pairs, decide, decide_between

Holds = Literal["holds", "does not hold", "not decidable"]
SIT_TO_STAND: TaskName = "sit_to_stand"
NO_INTERVAL = (float("nan"), float("nan"))
HIGH_CORRELATION = 0.7  # from here on a correlation is commonly called high; the note states no limit
# What a verdict on "this one against the other" makes of a claim
LESS: dict[str, Holds] = {"better": "holds", "equivalent": "does not hold", "worse": "does not hold"}
MORE: dict[str, Holds] = {"worse": "holds", "equivalent": "does not hold", "better": "does not hold"}
ALIKE: dict[str, Holds] = {"equivalent": "holds", "better": "does not hold", "worse": "does not hold"}
NOT_MORE: dict[str, Holds] = {"equivalent": "holds", "better": "holds", "worse": "does not hold"}
NOT_LESS: dict[str, Holds] = {"equivalent": "holds", "worse": "holds", "better": "does not hold"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Evidence:
    """One comparison."""

    what: str
    value_deg: float
    interval_deg: tuple[float, float]  # 95 %; NaN where there is none
    test: str  # With its p, and on how many
    verdict: Holds  # Of the claim, by this alone


@dataclass(frozen=True, slots=True, kw_only=True)
class ClaimRow:
    """One claim."""

    claim: str  # In our words
    stands: str  # Where in the note
    printed: str  # Its number
    verdict: Holds
    evidence: tuple[Evidence, ...]
    lacks: Finding | None  # What the study does not have and the claim needs


class Claim(NamedTuple):
    """A claim and how a study is asked about it."""

    text: str
    stands: str
    ask: Callable[[StudyOutcome], tuple[Evidence, ...] | Finding]
    printed: str = ""
    any_holds: bool = False  # One comparison is enough


def claims_of(outcome: StudyOutcome) -> tuple[ClaimRow, ...]:
    """Return all claims with what a study shows of them; none for another device than the note's."""
    return () if not outcome.study.of_note else tuple(_row(claim, claim.ask(outcome)) for claim in CLAIMS)


def _row(claim: Claim, found: tuple[Evidence, ...] | Finding) -> ClaimRow:
    lacks, evidence = (found, ()) if isinstance(found, Finding) else (None, found)
    verdicts = {each.verdict for each in evidence}
    ways: tuple[Holds, Holds] = ("holds", "does not hold") if claim.any_holds else ("does not hold", "holds")
    enough, against = ways  # one comparison with the first, or all with the second
    verdict: Holds = enough if enough in verdicts else against if verdicts == {against} else "not decidable"
    return ClaimRow(
        claim=claim.text, stands=claim.stands, printed=claim.printed, verdict=verdict, evidence=evidence, lacks=lacks
    )


# ---- evidence


def _judged(what: str, found: Decision, meaning: dict[str, Holds], units: int, unit: str) -> Evidence:
    """Return a decision as evidence; its value is this one's error less the other's."""
    least = min(found.p_better, found.p_equivalent, found.p_worse)
    return Evidence(
        what=what,
        value_deg=-found.difference,
        interval_deg=(-found.interval[1], -found.interval[0]),
        test=f"three-sided paired t, margin {found.margin:g} deg, p {least:.2g}, {units} {unit}",
        verdict=meaning.get(found.verdict, "not decidable"),
    )


def _lacks(what: str) -> Finding:
    return finding("study.claim_lacks", "info", what=what)


def _largest_margin(outcome: StudyOutcome) -> float:
    held = outcome.study
    return held.margin_deg / MARGIN_DEG[held.objective] * MARGIN_DEG["maximum"]


def _largest_at_optimum(outcome: StudyOutcome) -> tuple[list[str], FloatArray]:
    """Return the tasks, and the largest errors at their optima of the subjects that all have, (n, k) deg."""
    held = [(task.surface, task.optimum.best) for task in outcome.tasks]
    lost = {subject for surface, _ in held for subject in surface.left_out}
    columns = []
    for surface, best in held:
        own = [number for number in range(outcome.study.subjects) if number not in surface.left_out]
        columns.append(surface.error("maximum", outcome.study.timing)[[number not in lost for number in own], best])
    return [surface.task for surface, _ in held], np.stack(columns, axis=1)


def _largest_in_sit_to_stand(outcome: StudyOutcome) -> tuple[Evidence, ...] | Finding:
    lacks = _lacks("a sit-to-stand, another task, and three subjects in both")
    if len(outcome.tasks) < 2:
        return lacks
    names, errors = _largest_at_optimum(outcome)
    if SIT_TO_STAND not in names or len(errors) < 3:
        return lacks
    own, rows = names.index(SIT_TO_STAND), []
    for k, name in enumerate(names):
        if k == own:
            continue
        words: Any = {"margin": _largest_margin(outcome), "level": outcome.study.level, "tests": len(names) - 1}
        found = decide_between(errors[:, own], errors[:, k], **words)
        rows.append(
            _judged(f"largest error, sit to stand less {plain_words(name)}", found, MORE, len(errors), "subjects")
        )
    return tuple(rows)


def _row_of_both(outcome: StudyOutcome) -> DrawnRow | Finding:
    rows = [row for row in outcome.figure3_drawn if row.correction == "full" and row.units > 3]
    return rows[0] if rows else outcome.rivals_missing or outcome.figure3_missing or _lacks("drawn units of Figure 3")


def _simulated_as_actual(outcome: StudyOutcome) -> tuple[Evidence, ...] | Finding:
    """Ask whether the median unit keeps within the note's difference: a sign test over the drawn units."""
    from scipy.stats import binomtest

    if isinstance(row := _row_of_both(outcome), Finding):
        return row
    shares = binomtest(row.within, row.units).proportion_ci(1.0 - outcome.study.level)
    verdict: Holds = "holds" if shares.low > 0.5 else "does not hold" if shares.high < 0.5 else "not decidable"
    return (
        Evidence(
            what="largest difference of the two errors, both tables: median unit",
            value_deg=row.apart_deg[1],
            interval_deg=NO_INTERVAL,
            test=f"{row.within} of {row.units} drawn units within {NOTE_APART_DEG:g} deg, sign test",
            verdict=verdict,
        ),
    )


def _correlated(outcome: StudyOutcome) -> tuple[Evidence, ...] | Finding:
    if isinstance(row := _row_of_both(outcome), Finding):
        return row
    low, high = row.correlation_interval
    return (
        Evidence(
            what="correlation of the two errors, both tables (no unit)",
            value_deg=row.correlation,
            interval_deg=(low, high),
            test=f"95 % interval over {row.units} drawn units against {HIGH_CORRELATION:g}, by Fisher's z",
            verdict="holds"
            if low > HIGH_CORRELATION
            else "does not hold"
            if high < HIGH_CORRELATION
            else "not decidable",
        ),
    )


def _drawn(outcome: StudyOutcome, less: str, more: str) -> tuple[Pair, int] | Finding:
    """Compare two compensations over the drawn units: first less second."""
    held = {row.correction: row.largest_deg for row in outcome.figure3_drawn}
    if len(held.get(less, ())) < 3:
        return outcome.rivals_missing or outcome.figure3_missing or _lacks("three drawn units of Figure 3")
    table = np.stack([held[less], held[more]], axis=1)
    return compare_pairs(table)[0], len(table)


def _compensation(less: str, more: str) -> Callable[[StudyOutcome], tuple[Evidence, ...] | Finding]:
    def ask(outcome: StudyOutcome) -> tuple[Evidence, ...] | Finding:
        found = _drawn(outcome, less, more)
        if isinstance(found, Finding):
            return found
        pair, units = found
        decision = decide(pair, units, of=0, margin=_largest_margin(outcome), level=outcome.study.level)
        return (_judged(f"largest error, {_WITH[less]} less {_WITH[more]}", decision, LESS, units, "drawn units"),)

    return ask


_WITH = {"none": "no tables", "static": "static table alone", "full": "both tables"}
DECREASE_DEG = 3.2  # the note's


def _decrease(outcome: StudyOutcome) -> tuple[Evidence, ...] | Finding:
    found = _drawn(outcome, "none", "full")
    if isinstance(found, Finding):
        return found
    pair, units = found
    beyond = replace(pair, difference=pair.difference - DECREASE_DEG)
    decision = decide(beyond, units, of=1, margin=0.0, level=outcome.study.level)
    row = _judged(
        f"decrease of the largest error by both tables, against {DECREASE_DEG:g} deg",
        decision,
        LESS,
        units,
        "drawn units",
    )
    low, high = pair.interval
    return (replace(row, value_deg=pair.difference, interval_deg=(low, high)),)


def _rival(
    method: Method, meaning: dict[str, Holds], *triads: TriadName
) -> Callable[[StudyOutcome], tuple[Evidence, ...] | Finding]:
    def ask(outcome: StudyOutcome) -> tuple[Evidence, ...] | Finding:
        rows = [
            _judged(f"{_NAMES[row.triad]} {plain_words(worth.figure)}, {plain_words(method)} less {_AGAINST[row.triad]}",
                    worth.decision, meaning, row.units, "units")
            for row in outcome.rival_triads
            if row.method == method and row.triad in triads
            for worth in row.worth
            if worth.decision is not None
        ]  # fmt: skip
        return tuple(rows) or outcome.rivals_missing or _lacks("this method and the rate table on three units")

    return ask


_NAMES: dict[TriadName, str] = {"accel": "accelerometers alone:", "gyro": "gyroscopes alone: change of pitch,"}
_AGAINST: dict[TriadName, str] = {"accel": "six faces", "gyro": "rate table"}


def _parameters_matter(outcome: StudyOutcome) -> tuple[Evidence, ...] | Finding:
    rows = []
    for task in outcome.tasks:
        held = [(effect, effect.judged) for effect in task.optimum.effects if effect.judged is not None]
        if not held:
            continue
        effect, judged = max(held, key=lambda each: abs(each[1].widest.difference))
        verdicts = {each.verdict for _, each in held}
        verdict: Holds = "holds" if "better" in verdicts else "not decidable"
        verdict = "does not hold" if verdicts == {"equivalent"} else verdict
        what = f"{plain_words(task.surface.task)}: {judge.SYMBOLS[effect.name]}, value against value"
        row = _judged(what, judged.widest, {}, len(task.surface.error_rms_deg), "subjects")
        if row.value_deg < 0.0:  # which of the two values is the greater does not matter
            low, high = row.interval_deg
            row = replace(row, value_deg=-row.value_deg, interval_deg=(-high, -low))
        rows.append(replace(row, verdict=verdict))
    return tuple(rows) or _lacks("two values of a parameter or more")


def _as_table_1(outcome: StudyOutcome) -> tuple[Evidence, ...] | Finding:
    meaning: dict[str, Holds] = {"confirmed": "holds", "contradicted": "does not hold"}
    rows = []
    for task in outcome.tasks:
        if (note := task.note) is None or note.place is None or not np.isfinite(note.error_deg):
            continue
        what = f"{plain_words(task.surface.task)}: the note's protocol less the optimum"
        verdict = meaning.get(note.verdict, "not decidable")
        if note.place == task.optimum.best:
            rows.append(
                Evidence(
                    what=what,
                    value_deg=0.0,
                    interval_deg=NO_INTERVAL,
                    test="the same protocol; its values against the next ones",
                    verdict=verdict,
                )
            )
            continue
        found = _against(outcome, task, note.place)
        row = _judged(what, found, {}, len(task.surface.error_rms_deg), "subjects")
        rows.append(replace(row, verdict=verdict))
    return tuple(rows) or _lacks("the note's protocols among those that were tried")


def _against(outcome: StudyOutcome, task: TaskOutcome, place: int, tests: int = 1) -> Decision:
    """Compare a protocol with the optimum."""
    errors = task.surface.aimed(outcome.study)
    words: Any = {"margin": task.optimum.margin_deg, "level": outcome.study.level, "tests": tests}
    return decide_between(errors[:, place], errors[:, task.optimum.best], **words)


def _depends_on_task(outcome: StudyOutcome) -> tuple[Evidence, ...] | Finding:
    """Use the cut-off of one task's optimum in another, the rates of that other's optimum kept: rates are tried in no two tasks."""
    asked = []
    for task in outcome.tasks:
        surface, best = task.surface, task.optimum.best
        rates = np.stack([getattr(surface, name) for name in judge.PARAMETERS[1:]], axis=1)
        same = np.isclose(rates, rates[best]).all(axis=1) & np.isfinite(surface.aimed(outcome.study)).all(axis=0)
        for other in outcome.tasks:
            wanted = float(other.surface.cutoff_hz[other.optimum.best])
            places = np.flatnonzero(same)
            place = int(places[np.argmin(np.abs(np.log(surface.cutoff_hz[places] / wanted)))])
            if other is not task and place != best:
                asked.append((task, other, place))
    rows = []
    for task, other, place in asked:
        found = _against(outcome, task, place, len(asked))
        cutoff = f"{task.surface.cutoff_hz[place]:g} Hz"
        what = f"{plain_words(task.surface.task)}: cut-off {cutoff}, of {plain_words(other.surface.task)}, less its own"
        rows.append(_judged(what, found, MORE, len(task.surface.error_rms_deg), "subjects"))
    return tuple(rows) or _lacks("two tasks whose optima have different cut-offs")


CLAIMS = (
    Claim(
        "The errors of simulated and actual device differ by 0.15 deg at most",
        "Abstract, III",
        _simulated_as_actual,
        printed="0.15 deg",
    ),
    Claim("Simulated and actual observations are highly correlated", "Abstract, IV (1)", _correlated),
    Claim(
        "Compensation of the drift significantly improves the accuracy",
        "Abstract, IV (2)",
        _compensation("full", "none"),
    ),
    Claim("It decreases the error by more than 3.2 deg", "III, Figure 3", _decrease, printed="> 3.2 deg"),
    Claim("The dynamic tables take off more than the static ones", "III, Figure 3", _compensation("full", "static")),
    Claim("The largest errors are those of the sit-to-stand", "III", _largest_in_sit_to_stand),
    Claim(
        "The parameters of the calibration change the error in each task",
        "III, IV (1), Table 1",
        _parameters_matter,
        printed="p 0.048, 0.040, 0.049",
    ),
    Claim("The optimum has the printed parameters", "Table 1", _as_table_1),
    Claim("The optimum depends on the task", "I, III, Table 1", _depends_on_task, any_holds=True),
    Claim(
        "An inclined plane calibrates accelerometers no better than six faces",
        "II.B",
        _rival("inclined_plane", NOT_LESS, "accel"),
    ),
    Claim("A piston calibrates accelerometers as six faces do", "II.B, IV", _rival("piston", ALIKE, "accel")),
    Claim("A trolley is not accurate", "IV", _rival("trolley", MORE, "accel")),
    Claim(
        "An inclined plane does not suit a device with gyroscopes",
        "IV",
        _rival("inclined_plane", MORE, "gyro"),
        any_holds=True,
    ),
    Claim("A piston does not suit a device with gyroscopes", "IV", _rival("piston", MORE, "gyro"), any_holds=True),
    Claim("Optics are sufficiently accurate", "IV", _rival("mocap", NOT_MORE, "accel", "gyro")),
    Claim("A robot arm is sufficiently accurate", "IV", _rival("robot_arm", NOT_MORE, "accel", "gyro")),
    Claim(
        "Optics and a robot arm cost more than is justified",
        "IV",
        lambda outcome: _lacks("prices: a study has errors and minutes"),
    ),
)


# ---- the note's Discussion: other ways to calibrate, each triad alone, and what becomes of its claims


def rival_sections(outcome: StudyOutcome) -> tuple[Section, ...]:
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
        ("rms (deg)", lambda row: _over_units(row.error_rms_deg)),
        ("max (deg)", lambda row: _over_units(row.error_max_deg)),
        ("max of the change (deg)", lambda row: _over_units(row.change_max_deg)),
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


def _triads(outcome: StudyOutcome, name: str) -> Section:
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
            "scale (%)": _over_units(row.scale_percent),
            "cross-axis (%)": _over_units(row.cross_axis_percent),
            f"offset ({unit})": _over_units(row.offset),
        }
        for worth in row.worth:
            figure = f"change of pitch, {plain_words(worth.figure)}" if gyro else worth.figure
            cells |= {f"{figure} (deg)": _over_units(worth.error_deg), f"{figure}: verdict": _verdict(worth.decision)}
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


def _verdict(found: Decision | None) -> str:
    if found is None:
        return ""
    return f"{found.verdict}: {found.difference:.3f} [{interval(found.interval)}]"


def _over_units(spread: Spread) -> str:
    if spread.median != spread.median:
        return "no unit"
    return f"{spread.median:.3f} [{spread.least:.3f} to {spread.greatest:.3f}]"


# ---- claims


def claims_section(outcome: StudyOutcome) -> Section:
    """Return each claim of the note beside what the study shows of it."""
    if not outcome.study.of_note:
        return Section(title="")
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
