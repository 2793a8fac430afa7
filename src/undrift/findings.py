"""Findings: what a fit noticed, as a code with numbers; this file alone turns a code into sentences.

A fit returns ``finding("rate_table.mounting", "warn", angle_deg=0.3)``. Its text has three parts: a headline, one line of detail,
and one action. A verdict shows the most consequential findings first: by level (fail, warn, info), then by the rank of the code::

    1  numbers may be wrong          2  uncertainty is larger, or not complete
    3  something was not observable  4  what was done, for the record

Templates are ``str.format`` strings over the finding's values; a tuple prints element by element: (0.1, 0.2) as "0.1, 0.2".
"""

import string
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

Level = Literal["info", "warn", "fail"]
Value = float | int | str | bool | tuple[float, ...] | tuple[str, ...]

SHOWN_FIRST = 3  # findings that a person sees without asking for details
_LEVELS = ("fail", "warn", "info")


class Entry(NamedTuple):
    """The sentences of one code."""

    rank: int  # 1 to 4, see the module
    headline: str
    detail: str = ""
    action: str = ""


class _Template(string.Formatter):
    """``str.format`` that prints tuples element by element."""

    def format_field(self, value: Any, format_spec: str) -> str:
        if isinstance(value, tuple):
            return ", ".join(self.format_field(item, format_spec) for item in value)
        return str(super().format_field(value, "" if isinstance(value, str) else format_spec))


_TEMPLATE = _Template()


@dataclass(frozen=True, slots=True)
class Finding:
    """What a fit noticed: a code, how much it matters, and its numbers.

    Parameters
    ----------
    code : str
        Stage and matter, "six_face.tilt".
    level : str
        info, warn or fail.
    values : mapping
        Numbers and names that the sentences need; the unit stands in the key ("tilt_deg") unless SI.
    """

    code: str
    level: Level
    values: Mapping[str, Value] = field(default_factory=dict)

    @property
    def headline(self) -> str:
        """What it is, in a few words."""
        return self._filled(CATALOGUE[self.code].headline)

    @property
    def detail(self) -> str:
        """One line with the numbers; may be empty."""
        return self._filled(CATALOGUE[self.code].detail)

    @property
    def action(self) -> str:
        """What to do about it; may be empty."""
        return self._filled(CATALOGUE[self.code].action)

    @property
    def text(self) -> str:
        """Headline, detail and action in one line."""
        head = ": ".join(part for part in (self.headline, self.detail) if part)
        return "; ".join(part for part in (head, self.action) if part)

    def _filled(self, template: str) -> str:
        return _TEMPLATE.vformat(template, (), self.values)


def finding(code: str, level: Level, /, **values: Any) -> Finding:
    """Return a finding; arrays become tuples, numpy scalars become numbers."""
    return Finding(code, level, {name: _plain(value) for name, value in values.items()})


def _plain(value: Any) -> Value:
    value = value.tolist() if hasattr(value, "tolist") else value
    return tuple(_plain(item) for item in value) if isinstance(value, list | tuple) else value  # type: ignore[return-value]


def most_consequential_first(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Return findings by level and rank, each text once."""
    once = {item.text: item for item in findings}.values()
    return tuple(sorted(once, key=lambda item: (_LEVELS.index(item.level), CATALOGUE[item.code].rank)))


CATALOGUE: dict[str, Entry] = {
    # ---- any file written before findings had codes
    "earlier.text": Entry(4, "{text}"),
    # ---- calibration: session, stills, temperature
    # ---- calibration: six faces
    # ---- calibration: rate table
    # ---- calibration: known rotation
    # ---- calibration: multi-position
    # ---- calibration: reference
    # ---- calibration: noise and ADC
    # ---- drift: sessions and temperature
    # ---- drift: offsets over temperature
    # ---- drift: scale and dynamic drift
    # ---- drift: accelerometers
    # ---- correction
    "correct.no_temperature": Entry(
        1,
        "{seconds:.1f} s without a temperature",
        "the drift table cannot be evaluated there; the result is a gap (NaN) under every policy",
        "fill in the temperature",
    ),
    "correct.outside": Entry(
        1,
        "{seconds:.1f} s outside the drift table",
        "{low_c:.1f} to {high_c:.1f} degC were recorded (thermometer lag subtracted: {lag_s:g} s)",
        "extend the table by a thermal session at these temperatures",
    ),
    "correct.extrapolated": Entry(
        2,
        "{seconds:.1f} s where the drift table is extrapolated",
        "standard uncertainty there up to {uncertainty}",
        "extend the thermal session to these temperatures and rates",
    ),
    "correct.extrapolated_unstated": Entry(
        2,
        "{seconds:.1f} s where the drift table is extrapolated",
        "the table states no uncertainty there",
        "extend the thermal session to these temperatures and rates",
    ),
    "correct.departure": Entry(
        1,
        "Temperature far from the reference temperature",
        "by up to {departure_c:.1f} degC from {reference_c:.1f} degC; constant offsets hold within {span_c:g} degC",
        "fit a drift table (undrift drift)",
    ),
    "correct.turn_rate": Entry(
        1,
        "Turn rate outside the dynamic drift table",
        "{least_dps:.1f} to {greatest_dps:.1f} deg/s; the table ends at {first_dps:.1f} and {last_dps:.1f} deg/s and is held there",
        "extend the table by turns at these rates",
    ),
    "correct.beyond_range": Entry(
        1,
        "{sensor}: {percent:.3g} % of the samples exceed the calibrated range",
        "by more than a tenth: range {low:.3g} to {high:.3g} {unit}, worst {worst:.4g} {unit}; the model is extrapolated",
        "calibrate over a wider range",
    ),
    "correct.no_model": Entry(
        3, "{sensor}: the calibration has no model", "nominal values were passed on", "calibrate the {sensor} as well"
    ),
    "correct.device": Entry(
        1,
        "Recording and calibration name different devices",
        "recording {recorded}, calibration {calibrated}",
        "check that both belong together",
    ),
    "correct.hysteresis": Entry(
        2,
        "Hysteresis is not corrected",
        "half-width up to {half_width_dps:.2g} deg/s; the table holds the mean of warming and cooling",
    ),
    "correct.warm_up": Entry(
        1,
        "No warm-up was subtracted",
        "up to {largest_dps:.2g} deg/s, zero from {end_s:g} s after power-on",
        "state the time since power-on at the first sample",
    ),
    # ---- validation
    # ---- twin
    # ---- recordings (undrift info)
    # ---- study
    "study.subjects_left_out": Entry(
        2, "Subjects left out", "no protocol calibrated the device of subject {subjects} of surface.parquet"
    ),
    "study.runs_missing": Entry(
        2, "Runs missing", "{missing} of {runs}: the protocol could not calibrate the device and is no candidate"
    ),
    "study.mixed_model": Entry(
        2,
        "Mixed model for parameters with missing runs",
        "{parameters}. It assumes that runs are missing at random; failures are not, so it favours the value that failed",
    ),
    "study.flat_minimum": Entry(
        4,
        "Flat minimum",
        "{alike} of {protocols} protocols are as good as the optimum over {subjects} subjects (paired t, Holm)",
        "use the shortest session",
    ),
    "study.as_good": Entry(
        4,
        "Protocols as good as the optimum",
        "{alike} of {protocols} over {subjects} subjects (paired t, Holm)",
    ),
    "study.shorter_session": Entry(
        4,
        "Shortest session as good as the optimum",
        "{saved_min:.1f} min shorter; rms error {difference_deg:+.4f} deg, not significant",
    ),
    "study.deciding": Entry(
        4,
        "Parameters that decide the error",
        "{parameters} (best to worst {span_deg:.3f} deg; p {p_holm:.2g} after Holm)",
    ),
    "study.none_decides": Entry(4, "No parameter decides the error", "least p {p_holm:.2g} after Holm"),
    "study.not_tested": Entry(4, "Parameters not tested", "one value of each, or no difference between subjects"),
    "study.value_not_tried": Entry(4, "Not tried", "{parameter} {value_dps:.4g} deg/s ({reason})"),
    "study.halving": Entry(
        4,
        "Successive halving",
        "{protocols} protocols met {subjects} subjects; {runs} runs, full grid {grid}",
    ),
    "study.note_is_optimum": Entry(
        4, "The note's protocol is the optimum", "{alike} of {others} other protocols are as good"
    ),
    "study.note_as_good": Entry(
        4,
        "The note's protocol is as good as the optimum",
        "{error_deg:.3f} against {optimum_deg:.3f} deg. {subjects} subjects detect differences above {detectable_deg:.3f} deg",
    ),
    "study.note_worse": Entry(
        3,
        "The note's protocol is worse than the optimum",
        "{error_deg:.3f} against {optimum_deg:.3f} deg; no single parameter explains it",
    ),
    "study.note_worse_by_one": Entry(
        3,
        "The note's protocol is worse than the optimum",
        "{error_deg:.3f} against {optimum_deg:.3f} deg. "
        "{parameter} {ours:.4g} in place of {note:.4g} {unit} alone removes {gain_deg:.3f} deg",
    ),
    "study.note_not_tried": Entry(4, "The note's protocol was not tried"),
    "study.note_uncalibrated": Entry(3, "The note's protocol left a device uncalibrated"),
}
