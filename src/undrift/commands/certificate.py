"""Calibration certificate: results with expanded uncertainty, budget by source, traceability and limits, as a PDF.

    u^2 = sum_i u_i^2        the shares u_i that the fit kept; their sum is the variance of the calibration's covariance
    nu  = n (u / u_r)^4      Welch-Satterthwaite; u_r repeatability, from the residuals of n spare equations, the others are known
    U   = k u                k = 2, below 50 degrees of freedom Student's t for 95.45 %

Scale factors and cross-axis terms are elements of the correction matrix, shares of a budget in per cent of its mean diagonal.

A limit L is kept, where one is given, by the readings before correction: e departure from nominal, largest over the axes::

    guard     within  |e| + U <= L     outside  |e| - U > L     between them neither is stated
    simple    within  |e| <= L         outside  otherwise
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from undrift import __version__
from undrift.base.options import Output, options, verb
from undrift.base.summary import Drawing, Result, Section, Summary, at, figure_of, months_after, rows_section
from undrift.calibration.settings import FITS
from undrift.commands.data_sheet import PART, SHOWN, Specification, nominal_of, sheet_words
from undrift.commands.files import check_output
from undrift.errors import InputError
from undrift.findings import most_consequential_first
from undrift.units import INHABITED_GRAVITY, RADIAN_PER_DEGREE, STANDARD_GRAVITY, is_physical, si_factor

if TYPE_CHECKING:
    from undrift.arrays import FloatArray
    from undrift.model import Calibration, DriftTables, TriadModel

ANSWERED_S, MG_PER_PERCENT = 60.0, 10.0  # of the answer; of a scale factor at one g
ANSWERED = (
    "The pitch after 60 s: tilt by gravity, the offset, and what it changes by from rest to motion (0.02 deg/s an axis, assumed, "
    "where no fit shows it). A turn adds the scale factor's share, heat and age of the device theirs."
)
COVERAGE, ENOUGH, STUDENT_TAIL = 2.0, 50.0, 0.97725  # k; degrees of freedom from which it holds; quantile of 95.45 %

# Row of the budget, how it is evaluated (GUM 4.2, 4.3), and which triads have it
SOURCE_ROWS = {
    "rate": ("Rig: stated rate", "B", "gyro"),
    "angle": ("Rig: stated angle of turns", "B", "gyro"),
    "axis": ("Rig: axis of turns", "B", "gyro"),
    "ripple": ("Rig: ripple and settling of the rate", "A", "gyro"),
    "mounting": ("Rig: mounting, level of the table and wobble", "A, B", "gyro"),
    "level": ("Level of the faces", "A", "accel"),
    "gravity": ("Local gravity", "B", "accel"),
    "nonlinearity": ("Quadratic terms of a data sheet's size", "B", "accel"),
    "temperature": ("Temperature during the session", "B", ""),
    "noise": ("Noise", "A", ""),
    "adc": ("ADC: rounding to codes", "B", ""),
    "instability": ("Fit: instability of the offset", "A", ""),
    "repeatability": ("Repeatability: scatter beyond the noise", "A", ""),
    "fit": ("Fit: sources not separated", "A, B", ""),
}
BLOCKS = {
    "scale": "scale factor", "cross": "cross-axis sensitivity", "offset": "offset", "g": "g-sensitivity",
    "moving": "offset in motion less that at rest", "code": "offset of codes",
}  # fmt: skip
OFFSETS = {"gyro": "zero-rate output", "accel": "zero-g offset"}
LONGEST = 200  # characters of what is stated
LABELS = {
    "number": "Certificate number", "laboratory": "Laboratory", "customer": "Customer", "operator": "Calibrated by",
    "due_date": "Due date", "ambient_temp_c": "Ambient temperature", "ambient_humidity_percent": "Relative humidity",
}  # fmt: skip
SIGNED = ("Date of issue", "Authorised by", "Signature")  # by hand always
JUDGED = ("quantity", "largest departure", "U", "limit", "unit", "result")
DECISIONS = ("within", "outside", "neither stated")
RULES = {
    "guard": "within, where departure and U together keep the limit; outside, where the departure less U exceeds it; between them "
    "neither is stated (guard band of U, ILAC-G8:09/2019)",
    "simple": "within, where the departure keeps the limit, whatever U; near the limit every second statement may be wrong "
    "(simple acceptance, ILAC-G8:09/2019)",
}


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Certified(Result):
    """A calibration of which a certificate was written."""

    calibration: "Calibration"
    output: Path
    content: dict[str, Any]  # of the certificate

    def summary(self) -> Summary:
        """Return the largest expanded uncertainties, and each of them as the certificate has it."""
        from undrift.io.store import verdict_json

        model, content = self.calibration, self.content
        named = {"file": str(self.output), "content_sha256": content["hash"]}
        named |= {key: content[key] for key in ("statement", "conformity", "triads")}
        fields, judged = [*content["head"], *content["ambient"]], content["conformity"]
        blank = ", ".join(label.lower() for label, text in fields if not text)
        lines = (*(f"{label}: {text}" for label, text in fields if text), f"Lines to fill in by hand: {blank}.")
        return Summary(
            title=f"Certificate of {model.device or 'a device'}",
            answer=answer_sentence(model),
            data=named | {"verdict": verdict_json(model.verdict)},
            pictures=(figure_of("certificate:draw_calibration", model),),
            sections=(
                uncertainty_section(model),
                rows_section("Statement of conformity", judged["rows"], text=tuple(judged["text"])),
                Section(title="What the laboratory states", text=lines),
            ),
            verdict=model.verdict,
            written=(self.output,),
            failed=model.verdict.status == "bad",
        )


@options
@dataclass(frozen=True, kw_only=True)
class Statement:
    """What the laboratory states, as ISO/IEC 17025 asks for; the certificate has a line to fill in by hand for the rest.

    Parameters
    ----------
    number : str
        Number of the certificate.
    laboratory : str
        Name and address of the laboratory.
    customer : str
        Name and address of the customer.
    operator : str
        Who calibrated.
    ambient_temp_c : str
        Temperature of the room, degC: 22.5 or LOW:HIGH.
    ambient_humidity_percent : str
        Relative humidity of the room, %: 45 or LOW:HIGH.
    decision_rule : str or None
        With limits: guard leaves U between a device and its limit, and is the default; simple leaves none.
    """

    number: str = ""
    laboratory: str = ""
    customer: str = ""
    operator: str = ""
    valid_months: Annotated[int | None, Parameter(help="Months after which the calibration is due again.")] = None
    ambient_temp_c: Annotated[str, Parameter(allow_leading_hyphen=True)] = ""
    ambient_humidity_percent: str = ""
    decision_rule: Literal["guard", "simple"] | None = None

    def entries(self, created: str) -> dict[str, str]:
        """Return what is stated by name, empty where it is not; ``created`` is the time of the calibration."""
        for name in ("number", "laboratory", "customer", "operator"):
            if not (text := getattr(self, name)).isprintable() or len(text) > LONGEST:
                raise InputError(
                    f"`{name}`: wanted one line of at most {LONGEST} characters, got {text[:20]!r}...; shorten it"
                )
        due, months = "", self.valid_months
        if months is not None:
            if not (1 <= months <= 1200 and _day(created)):
                got = f"{months} of a calibration from '{created or 'no date'}'"
                raise InputError(f"`valid_months`: wanted 1 to 1200 months from a date, got {got}; leave it out")
            due = months_after(datetime.fromisoformat(created), months).date().isoformat()
        texts = {name: getattr(self, name).strip() for name in ("number", "laboratory", "customer", "operator")}
        temp = _stretch("ambient_temp_c", self.ambient_temp_c, (-100.0, 200.0), " °C")
        humidity = _stretch("ambient_humidity_percent", self.ambient_humidity_percent, (0.0, 100.0), " %")
        return texts | {"due_date": due, "ambient_temp_c": temp, "ambient_humidity_percent": humidity}


def _stretch(option: str, text: str, limits: tuple[float, float], unit: str) -> str:
    """Return a value or its two ends LOW:HIGH with the unit, as they were stated; empty where nothing was."""
    try:
        ends = [float(end) for end in text.split(":")] if text else []
    except ValueError:
        ends = [math.nan]
    if len(ends) > 2 or ends != sorted(ends) or not all(limits[0] <= end <= limits[1] for end in ends):
        raise InputError(
            f"`{option}`: wanted a value or LOW:HIGH from {limits[0]:g} to {limits[1]:g}{unit}, got '{text}'; for example 21:23"
        )
    return " to ".join(f"{end:g}{unit}" for end in ends)


@verb
def certificate(
    calibration: Path,
    /,
    *,
    output: Output,
    statement: Statement = Statement(),
    specification: Specification = Specification(),
) -> Certified:
    """Write a calibration certificate: results with expanded uncertainty, budget by source, traceability, limits.

    The same calibration and statements give the same file, byte for byte. What is not stated is a line to fill in by hand.

    Parameters
    ----------
    calibration : Path
        calibration.json of the device.
    output : Path
        The file, named *.pdf.
    """
    from undrift.io.store import read_calibration

    check_output(output, endings=(".pdf",), reads=(calibration,))
    model = read_calibration(calibration)
    content = certificate_content(model, statement, specification)
    at("undrift.report.certificate:write_certificate")(model, output, content)
    return Certified(calibration=model, output=output, content=content)


def answer_sentence(calibration: "Calibration") -> str:
    """Return what the calibration is worth in a sentence, at 95 % on the worst axis: pitch after a minute, offset and gravity."""
    import numpy as np

    from undrift.correction.rest import IN_MOTION, moved_by

    worst = dict[tuple[str, str], float]()  # expanded uncertainty by triad and block: mg or deg/s, and per cent
    for name in ("accel", "gyro"):
        if (triad := getattr(calibration, name)) is not None:
            table, (per, _) = stated(triad, gravity_uncertainty(calibration, name)), _units(name, triad)
            for block in ("scale", "cross", "offset"):
                expanded = np.abs(per[block] * table.expanded[table.of_block(block)])
                worst[name, block] = float(expanded.max(initial=0.0))
    drift, zero = (worst.get((name, "offset"), 0.0) for name in ("gyro", "accel"))
    scale, cross = (MG_PER_PERCENT * worst.get(("accel", block), 0.0) for block in ("scale", "cross"))
    gravity, level, gyro = math.hypot(zero, scale), math.hypot(zero, cross), calibration.gyro
    # the offset of these methods is that in motion
    still = gyro is None or (gyro.method in IN_MOTION and gyro.moving_offset is None)
    moved = 0.0 if still else COVERAGE * moved_by(gyro) / math.sqrt(3.0) / RADIAN_PER_DEGREE
    pitch = math.hypot(ANSWERED_S * drift, ANSWERED_S * moved, level / 1e3 / RADIAN_PER_DEGREE)
    size, where = two_digits, "at the temperature of the calibration, 95 %"
    if not math.isfinite(pitch + gravity) or not drift + gravity:
        return "How well the calibration is known is not stated."
    if not drift:
        return f"Gravity is within {size(gravity)} mg ({where})."
    if not gravity:
        known = f"offset at rest {size(drift)} deg/s"
        return f"After {ANSWERED_S:g} s the pitch drifts by {size(pitch)} deg at most ({where}): {known}."
    known = f"offset at rest {size(drift)} deg/s, gravity within {size(gravity)} mg"
    return f"After {ANSWERED_S:g} s the pitch is good to {size(pitch)} deg; {known} ({where})."


def uncertainty_section(calibration: "Calibration") -> Section:
    """Return the expanded uncertainty of each kind of parameter, and what the answer is made of."""
    return Section(title="Expanded uncertainty", text=(uncertainty_sentence(calibration), ANSWERED))


def uncertainty_sentence(calibration: "Calibration") -> str:
    """Return the largest expanded uncertainty of each block of parameters in a sentence."""
    triads = [(name, triad) for name in ("accel", "gyro") if (triad := getattr(calibration, name)) is not None]
    words = "; ".join(expanded_words(*pair, gravity_uncertainty(calibration, pair[0])) for pair in triads)
    return f"Expanded uncertainty (95 %) at the temperature of the calibration: {words}."


def drawings_of(drift: "DriftTables | None") -> Iterator[tuple[str, Drawing]]:
    """Yield the name and the figure of each table over temperature."""
    if drift is not None and (drift.static is not None or drift.scale is not None):
        yield "tables", figure_of("certificate:draw_tables", drift)
    if drift is not None and drift.dynamic is not None:
        yield "dynamic", figure_of("drift:draw_dynamic", drift.dynamic)


# ---- results with their uncertainty


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ParameterTable:
    """The parameters of one triad with their uncertainty, in units of the triad; arrays are (P,)."""

    names: tuple[str, ...]
    value: "FloatArray"
    shares: "Mapping[str, FloatArray]"  # (P,) of each source
    standard: "FloatArray"  # combined standard uncertainty
    freedom: "FloatArray"  # effective degrees of freedom
    coverage: "FloatArray"  # k
    expanded: "FloatArray"  # U

    def of_block(self, block: str) -> list[int]:
        """Return the numbers of the parameters of a block of ``BLOCKS``."""
        return [n for n, name in enumerate(self.names) if block_of(name) == block]


def block_of(name: str) -> str:
    """Return the block that a parameter belongs to."""
    head, _, end = name.partition("_")
    return head if head != "m" else "scale" if end[0] == end[1] else "cross"


def gravity_uncertainty(calibration: "Calibration", triad: str = "accel") -> float:
    """Return the standard uncertainty of local gravity, relative: 0 where it was stated, or follows from a place."""
    import numpy as np

    known = triad == "gyro" or dict(calibration.provenance.settings).get("gravity") in ("stated", "latitude and height")
    return 0.0 if known else float(np.ptp(INHABITED_GRAVITY)) / math.sqrt(12.0) / calibration.gravity_m_s2


def stated(triad: "TriadModel", gravity: float = 0.0) -> ParameterTable:
    """Combine the shares of a triad's budget, and what gravity's uncertainty and quadratic terms add, and expand them."""
    import numpy as np

    from undrift.calibration.norm import QUADRATIC_SD

    sigma = triad.standard_uncertainty
    budget = triad.budget
    shares = {"fit": sigma} if budget is None else dict(zip(budget.sources, budget.uncertainty, strict=True))
    if gravity > 0.0:
        of_matrix = np.array([block_of(name) in ("scale", "cross") for name in triad.parameters])
        shares["gravity"] = np.where(of_matrix, gravity * np.abs(np.resize(triad.matrix.ravel(), len(sigma))), 0.0)
    if triad.method.startswith("six-face"):  # opposite faces read q g^2 as offset
        of_offset = np.where([block_of(name) == "offset" for name in triad.parameters], STANDARD_GRAVITY**2, 0.0)
        shares["nonlinearity"] = QUADRATIC_SD * of_offset * np.resize(triad.scale_factor, len(sigma))
    combined = np.sqrt(np.sum([part**2 for part in shares.values()], axis=0))
    freedom = np.full(len(sigma), np.inf)
    if "repeatability" in shares:
        spare, seen = max(1, triad.count - len(sigma)), shares["repeatability"] > 0.0
        freedom[seen] = spare * (combined[seen] / shares["repeatability"][seen]) ** 4
    coverage = coverage_factors(freedom)
    return ParameterTable(
        names=triad.parameters, value=triad.values, shares=shares, standard=combined, freedom=freedom, coverage=coverage,
        expanded=coverage * combined,
    )  # fmt: skip


def coverage_factors(freedom: "FloatArray") -> "FloatArray":
    """Return k for degrees of freedom (P,)."""
    import numpy as np
    from scipy.special import stdtrit

    return np.where(freedom >= ENOUGH, COVERAGE, stdtrit(np.minimum(freedom, 1e6), STUDENT_TAIL))


def certificate_content(
    calibration: "Calibration", statement: Statement = Statement(), specification: Specification = Specification()
) -> dict[str, Any]:
    """Return what the template sets: texts, rows of tables, names of pictures."""
    import numpy as np

    from undrift.io.store import content_hash

    triads = {name: triad for name in ("gyro", "accel") if (triad := getattr(calibration, name)) is not None}
    if not triads:
        raise InputError("certificate: wanted a calibrated gyroscope or accelerometer, got neither; calibrate first")
    for name, triad in triads.items():
        if not (triad.parameters and np.isfinite(triad.covariance).all() and triad.covariance.any()):
            raise InputError(
                f"certificate: wanted a covariance of the {NAMES[name].lower()}, got none; calibrate from recordings by undrift"
            )
    made = calibration.provenance
    entries = statement.entries(made.created)
    rows = [(label, entries[name]) for name, label in LABELS.items()]
    return {
        "statement": {name: text or None for name, text in entries.items()},
        "head": [*rows[:5], *((label, "") for label in SIGNED)],
        "ambient": rows[5:],
        "conformity": conformity(calibration, specification, statement.decision_rule),
        "device": calibration.device or "without serial number",
        "hash": content_hash(calibration),
        "date": made.created[:10] or "not stated",
        "day": _day(made.created),
        "version": dict(made.versions).get("undrift", __version__),
        "conditions": [*_conditions(calibration)],
        "procedure": [*_procedure(calibration, triads)],
        "triads": [_triad(name, triad, gravity_uncertainty(calibration, name)) for name, triad in triads.items()],
        "pictures": [name for name, _ in drawings_of(calibration.drift)],
        "traceability": [*_traceability(calibration, triads)],
        "limits": [*_limits(calibration, triads)],
        "verdict": calibration.verdict.status,
        "findings": [
            ": ".join(part for part in (item.headline, item.detail) if part)
            for item in most_consequential_first(calibration.verdict.findings)
            if item.level != "info"
        ],
        "inputs": [list(pair) for pair in made.inputs],
        "software": ", ".join(f"{name} {version}" for name, version in made.versions) or "not stated",
    }


NAMES = {"gyro": "Gyroscopes", "accel": "Accelerometers"}


def _day(created: str) -> list[int] | None:
    try:
        date = datetime.fromisoformat(created)
    except ValueError:
        return None
    return [date.year, date.month, date.day]


def _conditions(calibration: "Calibration") -> Iterator[tuple[str, str]]:
    settings = dict(calibration.provenance.settings)
    temp_c = calibration.reference_temp_c
    yield "Reference temperature", "not recorded" if math.isnan(temp_c) else f"{temp_c:.2f} °C"
    source = settings.get("gravity", "not stated")
    yield "Local gravity", f"{calibration.gravity_m_s2:.5f} m/s² (source: {source})"
    for name, label in (("stills", "Rests"), ("faces", "Faces up"), ("turns", "Turns")):
        if name in settings:
            yield label, settings[name]
    if calibration.drift is not None and calibration.drift.static is not None:
        nodes = calibration.drift.static.temp_c
        yield "Temperature of the drift table", f"{nodes[0]:.1f} °C to {nodes[-1]:.1f} °C"


def _words(method: str) -> str:
    return FITS[method].words if method in FITS else method


def _procedure(calibration: "Calibration", triads: "Mapping[str, TriadModel]") -> Iterator[tuple[str, str]]:
    for name, triad in triads.items():
        method, _, mode = triad.method.partition("/")
        fit = f"{_words(method)}; {mode or 'default'} fit of {triad.count} equations"
        rms, unit, factor = triad.rms_residual, *SHOWN[name]
        yield NAMES[name], f"{fit}, rank {triad.rank}, residual {rms * factor:.3g} {unit} rms"
    if calibration.adc is not None:
        yield "ADC", f"gyroscopes {calibration.adc.gyro_rounding}, accelerometers {calibration.adc.accel_rounding}"


# ---- departures before correction, and limits


def departures(name: str, triad: "TriadModel", kind: str, gravity: float = 0.0) -> "dict[str, FloatArray]":
    """Return how far the readings depart from nominal, and U, (2, P) by block, in the units of the budget; NaN where not known."""
    import numpy as np

    table, (per, _), nominal = stated(triad, gravity), _units(name, triad), nominal_of(name, triad, kind)
    values = {
        "scale": 100.0 * (triad.scale_factor / nominal - 1.0),
        "cross": (100.0 * triad.matrix / np.diag(triad.matrix).mean())[~np.eye(3, dtype=bool)],
        "offset": triad.offset / triad.scale_factor * SHOWN[name][1] + 0.0 * nominal,
    }
    expanded = {block: np.abs(per[block] * table.expanded[table.of_block(block)]) for block in values}
    return {
        block: np.stack((value, expanded[block] if len(expanded[block]) else 0.0 * value))
        for block, value in values.items()
    }


def conformity(calibration: "Calibration", specification: Specification, rule: str | None) -> dict[str, Any]:
    """Return rows and text of the statement of conformity; no rows where no limit is given."""
    kind, rows = specification.kind or calibration.provenance.text(PART), list[dict[str, str]]()
    for name, triad in ((one, getattr(calibration, one)) for one in NAMES):
        blocks = {} if triad is None else departures(name, triad, kind, gravity_uncertainty(calibration, name))
        for block, (value, expanded) in blocks.items():
            if (limit := specification.of(name, block)) is None:
                continue
            worst, result = int((abs(value) + expanded).argmax()), _decided(value, expanded, limit, rule)
            decided = result in DECISIONS
            figures = rounded(float(value[worst]), float(expanded[worst])) if decided else ("–", "–")
            label = f"{NAMES[name]}: {OFFSETS[name] if block == 'offset' else BLOCKS[block]}"
            cells = (label, *figures, f"{limit:g}", _units(name, triad)[1][block], result)
            rows.append(dict(zip(JUDGED, cells, strict=True)))
    if not rows and rule is not None:
        raise InputError("`decision_rule`: wanted a limit to decide by, got none; state `kind` or a limit")
    source = f"{sheet_words(specification.kind)}, but for those stated" if specification.kind else "stated"
    text = (
        f"Decision rule: {RULES[rule or 'guard']}.",
        f"Departures are the largest of the readings from nominal, before correction. Limits: {source}.",
    )
    return {"rule": (rule or "guard") if rows else None, "rows": rows, "text": list(text) if rows else []}


def _decided(value: "FloatArray", expanded: "FloatArray", limit: float, rule: str | None) -> str:
    """Return what is stated of departures (P,) with their U; see the module."""
    if not abs(value).max() < math.inf:
        return "nominal unknown"
    if not expanded.all():
        return "not calibrated"
    margin = 0.0 * expanded if rule == "simple" else expanded
    within, outside = (abs(value) + margin <= limit).all(), (abs(value) - margin > limit).any()
    return DECISIONS[0] if within else DECISIONS[1] if outside else DECISIONS[2]


# ---- results and budget of one triad


def _units(name: str, triad: "TriadModel") -> tuple[dict[str, float], dict[str, str]]:
    """Return how many units of the budget are one of the triad's, and the unit, by block."""
    import numpy as np

    scale = float(np.diag(triad.matrix).mean())
    unit, factor = SHOWN[name]
    per = dict.fromkeys(("scale", "cross"), 100.0 / scale) | dict.fromkeys(("offset", "code"), abs(scale) * factor)
    per |= {"g": factor * STANDARD_GRAVITY, "moving": factor}
    units = {"scale": "%", "cross": "%", "offset": unit, "g": f"{unit} per g", "moving": unit, "code": unit}
    return per, units


def expanded_words(name: str, triad: "TriadModel", gravity: float = 0.0) -> str:
    """Return the largest expanded uncertainty of each block in words: what a user of the calibration gets."""
    import numpy as np

    made, (per, units) = stated(triad, gravity), _units(name, triad)
    largest = {block: np.abs(per[block] * made.expanded[made.of_block(block)]).max(initial=0.0) for block in units}
    if not 0.0 < sum(largest.values()) < math.inf:
        return f"{NAMES[name].lower()} not known"
    parts = [f"{two_digits(largest['offset'])} {units['offset']} of {OFFSETS[name]}"] if largest["offset"] else []
    parts += [f"{two_digits(largest[block])} % of {BLOCKS[block]}" for block in ("scale", "cross") if largest[block]]
    held = [BLOCKS[block] for block in ("scale", "cross") if not largest[block]]
    return f"{NAMES[name].lower()} up to {', '.join(parts)}" + f" ({' and '.join(held)} not calibrated)" * bool(held)


def _triad(name: str, triad: "TriadModel", gravity: float) -> dict[str, Any]:
    made, (per, units) = stated(triad, gravity), _units(name, triad)
    blocks = [block for block in BLOCKS if made.of_block(block)]
    labels = BLOCKS | {"offset": OFFSETS[name]}
    return {
        "title": NAMES[name],
        "model": "corrected = M (raw − o)"
        + ("" if triad.g_sensitivity is None else " − G a")
        + ("" if triad.moving_offset is None else " − d in motion"),
        "separated": triad.budget is not None,
        "results": [_result(name, triad, made, n, per, units) for n in range(len(made.names))],
        "blocks": [f"{labels[block]} ({units[block]})" for block in blocks],
        "budget": [*_budget_rows(name, made, blocks, per)],
        "shares": _share_rows(made, per, units),
        "si": triad.unit_out,
        "student": bool((made.coverage > COVERAGE).any()),
    }


def _result(
    name: str, triad: "TriadModel", made: ParameterTable, n: int, per: Mapping[str, float], units: Mapping[str, str]
) -> list[str]:
    """Return quantity, value with its unit, U, U in the units of the budget, k, and the value in SI units."""
    block, parameter = block_of(made.names[n]), made.names[n]
    unit_in, (shown_unit, per_si) = triad.unit_in, SHOWN[name]
    unit, factor = unit_in, 1.0
    if block in ("g", "moving"):
        unit, factor = units[block], per[block]
    elif block not in ("offset", "code"):
        unit, factor = f"{shown_unit} per {unit_in}", per_si
        if is_physical(unit_in):
            unit, factor = "1", 1.0 / si_factor(unit_in, "rate" if name == "gyro" else "accel")
    value, expanded = made.value[n] * factor, made.expanded[n] * abs(factor)
    shown, less = rounded(value, expanded)
    fixed = not expanded > 0.0
    relative = "–" if fixed else f"{two_digits(made.expanded[n] * abs(per[block]))} {units[block]}"
    coverage, scale = "–" if fixed else f"{made.coverage[n]:.2f}", 1.0
    if block in ("offset", "code"):
        scale = abs(per[block]) / per_si
    si = "–" if unit == "1" else rounded(made.value[n] * scale, made.expanded[n] * scale)[0]
    return [parameter, shown, unit, "held" if fixed else less, relative, coverage, si]


def rounded(value: float, uncertainty: float) -> tuple[str, str]:
    """Return a value and its uncertainty to two digits of the uncertainty."""
    if not uncertainty > 0.0:
        return f"{value:.6g}", "0"
    places = 1 - math.floor(math.log10(uncertainty))
    if 0 <= places <= 7:
        return f"{value:.{places}f}", f"{uncertainty:.{places}f}"
    power = math.floor(math.log10(max(abs(value), uncertainty)))
    digits = max(0, places + power)
    return f"{value / 10.0**power:.{digits}f}e{power}", f"{uncertainty / 10.0**power:.{digits}f}e{power}"


def two_digits(value: float) -> str:
    """Return a size to two digits, a dash for none."""
    mantissa, _, power = f"{value:#.2g}".partition("e")
    return f"{mantissa.removesuffix('.')}{power and f'e{int(power)}'}" if value > 0.0 else "–"


def rms_of(values: "FloatArray") -> float:
    """Return the root mean square."""
    return math.sqrt(float((values**2).mean()))


def _budget_rows(name: str, made: ParameterTable, blocks: list[str], per: Mapping[str, float]) -> Iterator[list[str]]:
    """Yield a row for each source: how it is evaluated, rms over the parameters of each block; then combined and expanded."""
    places = {block: made.of_block(block) for block in blocks}
    for source, (label, kind, only) in SOURCE_ROWS.items():
        if source == "gravity" and name == "accel" and source not in made.shares:
            yield [label, kind, *("not included" if block == "scale" else "–" for block in blocks)]
        share = made.shares.get(source)
        if share is None and (
            only not in ("", name)
            or source in ("angle", "axis", "fit", "gravity", "nonlinearity")
            or "fit" in made.shares
        ):
            continue
        cells = (0.0 if share is None else abs(per[b]) * rms_of(share[places[b]]) for b in blocks)
        yield [label, kind, *map(two_digits, cells)]
    for label, values in (("Combined standard uncertainty", made.standard), ("Expanded uncertainty", made.expanded)):
        yield [label, "", *(two_digits(abs(per[b]) * rms_of(values[places[b]])) for b in blocks)]


def _share_rows(made: ParameterTable, per: Mapping[str, float], units: Mapping[str, str]) -> dict[str, Any]:
    """Return the same for each parameter, one column a source."""
    heads = [source for source in SOURCE_ROWS if source in made.shares]
    rows = []
    for n, parameter in enumerate(made.names):
        block = block_of(parameter)
        factor = abs(per[block])
        values = (*(made.shares[head][n] for head in heads), made.standard[n])
        rows.append([parameter, units[block], *(two_digits(factor * value) for value in values)])
    return {"heads": heads, "rows": rows}


def departures_words(name: str, triad: "TriadModel", kind: str = "") -> str:
    """Return what the departures of ``draw_calibration`` are from, and whose limits are shaded."""
    limits = f" Shaded: limits of the {sheet_words(kind)}." if kind else ""
    if is_physical(triad.unit_in):
        ideal = f"departures from the unit of the readings, {triad.unit_in}: what is wrong without calibration."
    elif math.isfinite(nominal_of(name, triad, kind)):
        ideal = f"departures from the scale factor that the data sheet of {kind} states."
    else:
        ideal = f"departures from the mean scale factor of the three axes; readings in {triad.unit_in} state no other."
    return f"{NAMES[name]}: {ideal}{limits}"


# ---- words: nothing that the calibration does not state


def _traceability(calibration: "Calibration", triads: "Mapping[str, TriadModel]") -> Iterator[str]:
    settings = dict(calibration.provenance.settings)
    yield "The results are traceable to the reference values below, and no further. The user stated them, or accepted defaults."
    methods = {name: triad.method.partition("/")[0] for name, triad in triads.items()}
    if methods.get("gyro") == "rate-table":
        named = (
            ("rate_uncertainty", "rates in common", "(relative)"), ("mount_tilt_deg", "mounting", "deg"),
            ("table_level_deg", "level of the table", "deg"), ("wobble_deg", "wobble", "deg"),
        )  # fmt: skip
        each = ", ".join(f"{label} {settings[key]} {unit}" for key, label, unit in named if key in settings)
        yield f"Rates: those stated for the rate table. Standard uncertainties: {each or 'not stated'}."
    elif methods.get("gyro") == "known-rotation":
        angle, axis = (settings.get(f"{name}_uncertainty_deg", "not stated") for name in ("angle", "axis"))
        yield f"Angles: those stated for the turns. Standard uncertainties: angle {angle} deg, axis of the turns {axis} deg."
    elif "gyro" in methods and methods["gyro"] != "rest":
        yield f"Gyroscopes: {_words(methods['gyro'])}; see the procedure."
    if "accel" in triads:
        source, how, (least, most) = settings.get("gravity", "not stated"), "taken as exact", INHABITED_GRAVITY
        if u := gravity_uncertainty(calibration):
            how = f"assumed; standard uncertainty {100.0 * u:.2f} % (uniform, {least:.3f} to {most:.3f} m/s²) is in the budget"
        yield (
            f"Local gravity: {calibration.gravity_m_s2:.5f} m/s² (source: {source}), {how}. "
            "A relative error of it is the same relative error of the accelerometers' scale factor."
        )
    yield "This document states no certificate of these references and claims no accreditation."


def _limits(calibration: "Calibration", triads: "Mapping[str, TriadModel]") -> Iterator[str]:
    if calibration.magnetometer is not None:
        yield "The magnetometer is not part of this certificate."
    for name, triad in triads.items():
        low, high = (value * (1.0 if name == "accel" else SHOWN[name][1]) for value in triad.valid_range)
        unit = "m/s²" if name == "accel" else "deg/s"
        if high > low:
            yield f"{NAMES[name]}: calibrated from {low:.4g} to {high:.4g} {unit}, at steady values; not covered beyond."
    if "accel" in triads:
        method, size = triads["accel"].method, "of a data sheet's size (2e-4 per m/s²) is included in U of their offset"
        held = "is part of their offset, and not included in U"
        if method.startswith(("six-face", "multi-position")):
            six = method.startswith("six-face")
            held = f"{size}; 18 free poses would show it" if six else f"{size}, as far as the poses leave it open"
        yield f"The accelerometers are taken as linear within 1 g. A quadratic term {held}."
    tables = calibration.drift
    if tables is None or tables.static is None:
        yield "Offsets hold at the reference temperature. Change with temperature is not included in U."
    else:
        nodes = tables.static.temp_c
        yield f"Drift tables hold from {nodes[0]:.1f} to {nodes[-1]:.1f} °C. U of the results is that at the reference temperature."
    yield "Change with time, shock and supply voltage are not included. Calibrate again when a known rest reads otherwise."
