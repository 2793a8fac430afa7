"""Findings: what a fit noticed, as a code with numbers; ``findings.toml`` alone holds the sentences.

A fit returns ``finding("six_face.tilt", "warn", tilt_deg=0.6)``. Its text has three parts: a headline, one line of detail,
and one action. A verdict shows the most consequential findings first: by level (fail, warn, info), then by the rank of the code::

    1  numbers may be wrong          2  uncertainty is larger, or not complete
    3  something was not observable  4  what was done, for the record

Templates are ``str.format`` strings over the finding's values; a tuple prints element by element: (0.1, 0.2) as "0.1, 0.2".
``{span_k:.1f|{limit_k}}`` has as many digits more as show on which side of the limit it is: 2.04 K beside 2 K, not 2.0 K.
"""

import math
import string
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

from undrift.base.codec import Key, stored
from undrift.base.spoken import spoken_template
from undrift.errors import InputError

Level = Literal["info", "warn", "fail"]
Status = Literal["good", "marginal", "bad"]
Value = float | int | str | bool | tuple[float, ...] | tuple[str, ...]

_SENTENCES = Path(__file__).with_name("findings.toml")
SHOWN_FIRST = 3  # findings that a person sees without asking for details
_LEVELS = ("fail", "warn", "info")


class FindingText(NamedTuple):
    """The sentences of one code."""

    rank: int  # 1 to 4, see the module
    headline: str
    detail: str = ""
    action: str = ""


class _Template(string.Formatter):
    """``str.format`` that prints tuples element by element, and a number beside its limit."""

    def format_field(self, value: Any, format_spec: str) -> str:
        if isinstance(value, tuple):
            return ", ".join(self.format_field(item, format_spec) for item in value)
        form, _, limit = format_spec.partition("|")
        if limit and not isinstance(value, str):
            return told_apart(value, form, float(limit))
        return str(super().format_field(value, "" if isinstance(value, str) else form))


def told_apart(value: float, form: str, limit: float) -> str:
    """Return a value by a form like ".2g", with more digits where its size would else be on another side of a limit's."""
    start, _, kind = form.partition(".")
    for digits in range(int(kind[:-1]), 17):
        text = format(value, f"{start}.{digits}{kind[-1]}")
        shown = abs(float(text)) - abs(limit)
        if (shown > 0.0, shown < 0.0) == (abs(value) > abs(limit), abs(value) < abs(limit)):
            break
    return text


_TEMPLATE = _Template()


def _read(keys: dict[str, Any]) -> "Finding":
    """Return a finding of a file from its code and values."""
    made = finding(keys["code"], keys["level"], **_filled(keys["values"]))
    try:
        _ = made.text
    except (KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"findings: {keys['code']} is not a finding of undrift, or lacks a value ({error})") from error
    return made


def _filled(held: Any) -> Any:
    """Return values of a file with NaN for null."""
    if isinstance(held, dict | list):
        return {k: _filled(v) for k, v in held.items()} if isinstance(held, dict) else [_filled(v) for v in held]
    return math.nan if held is None else held


@stored(whole=True, keys=("code", "level", "values", "text", "action"), read=_read)
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

    Examples
    --------
    >>> import numpy as np, undrift
    >>> rng = np.random.default_rng(7)
    >>> device = undrift.random_device(rng)
    >>> calibration = undrift.calibrate(undrift.simulate_session("six_face", device, rng=rng))
    >>> finding = calibration.verdict.findings[0]
    >>> finding.code, finding.level, finding.headline
    ('session.not_observable', 'info', 'Gyroscope not observable')
    """

    code: str
    level: Level
    values: Annotated[Mapping[str, Value], Key(form=dict[str, Any])] = field(default_factory=dict)

    @property
    def headline(self) -> str:
        """What it is, in a few words."""
        return self._filled(catalogue()[self.code].headline)

    @property
    def detail(self) -> str:
        """One line with the numbers; may be empty."""
        return self._filled(catalogue()[self.code].detail)

    @property
    def action(self) -> str:
        """What to do about it; may be empty."""
        return self._filled(catalogue()[self.code].action)

    @property
    def text(self) -> str:
        """Headline, detail and action in one line."""
        head = ": ".join(part for part in (self.headline, self.detail) if part)
        return "; ".join(part for part in (head, self.action) if part)

    def _filled(self, template: str) -> str:
        return _TEMPLATE.vformat(spoken_template(template), (), self.values)


def finding(code: str, level: Level, /, **values: Any) -> Finding:
    """Return a finding; arrays become tuples, numpy scalars become numbers."""
    return Finding(code, level, {name: _plain(value) for name, value in values.items()})


def _plain(value: Any) -> Value:
    value = value.tolist() if hasattr(value, "tolist") else value
    return tuple(_plain(item) for item in value) if isinstance(value, list | tuple) else value  # type: ignore[return-value]


def most_consequential_first(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Return findings by level and rank, each text once."""
    once = {item.text: item for item in findings}.values()
    return tuple(sorted(once, key=lambda item: (_LEVELS.index(item.level), catalogue()[item.code].rank)))


@stored(whole=True, keys=("status", "reasons", "findings"))
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Verdict:
    """What a fit is worth: good, marginal or bad, and the findings that say why.

    Parameters
    ----------
    status : str
        good, marginal or bad.
    findings : tuple of Finding
        Why; also what was not observable and which recording would show it.

    Examples
    --------
    >>> import numpy as np, undrift
    >>> rng = np.random.default_rng(7)
    >>> device = undrift.random_device(rng)
    >>> calibration = undrift.calibrate(undrift.simulate_session("six_face", device, rng=rng))
    >>> calibration.verdict.status
    'good'
    """

    status: Status = "good"
    findings: Annotated[tuple[Finding, ...], Key(optional=True)] = ()

    @property
    def reasons(self) -> tuple[str, ...]:
        """The findings as texts, most consequential first."""
        return tuple(item.text for item in most_consequential_first(self.findings))

    @classmethod
    def of(cls, *findings: Finding) -> "Verdict":
        """Return the verdict that follows from findings: bad with a fail, marginal with a warn, else good."""
        levels = {item.level for item in findings}
        return cls(status="bad" if "fail" in levels else "marginal" if "warn" in levels else "good", findings=findings)

    def also(self, other: "Verdict") -> "Verdict":
        """Return both verdicts as one: the worse status, all findings, each once."""
        worse = max(self.status, other.status, key=("good", "marginal", "bad").index)
        known = {item.text for item in self.findings}
        others = (item for item in other.findings if item.text not in known)
        return Verdict(status=worse, findings=(*self.findings, *others))


def level_of(value: float, limits: tuple[float, float]) -> Level:
    """Return warn above the first of two limits, fail above the second, else info."""
    return "fail" if value > limits[1] else "warn" if value > limits[0] else "info"


def above(code: str, value: float, limits: tuple[float, float], **shown: Any) -> tuple[Finding, ...]:
    """Return the finding of a value above the first of two limits, ``wanted``; none below it."""
    level = level_of(value, limits)
    return () if level == "info" else (finding(code, level, wanted=limits[0], **shown),)


@cache
def catalogue() -> dict[str, FindingText]:
    """Return the sentences of every code."""
    return {code: FindingText(**entry) for code, entry in tomllib.loads(_SENTENCES.read_text(encoding="utf-8")).items()}
