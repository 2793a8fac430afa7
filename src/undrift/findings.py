"""Findings: the remarks of a fit, each a code with numbers. All sentences are in ``findings.toml``.

A fit returns ``finding("six_face.tilt", "warn", tilt_deg=0.6)``. Its text has three parts: a headline, one line of detail,
and one action. A verdict shows the most consequential findings first: by level (fail, warn, info), then by the rank of the code::

    1  numbers may be wrong             2  the uncertainty is larger, or incomplete
    3  a parameter was not observable   4  a note on the procedure, for the record

Templates are ``str.format`` strings over the finding's values. A tuple prints element by element: (0.1, 0.2) as "0.1, 0.2".
``{span_k:.1f|{limit_k}}`` adds digits until the number differs visibly from its limit: 2.04 K next to 2 K, not 2.0 K.
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
    """Headline, detail and action of one code."""

    rank: int  # 1 to 4, see the module
    headline: str
    detail: str = ""
    action: str = ""


class _Template(string.Formatter):
    """``str.format`` that prints tuples element by element, and adds digits to a number close to its limit."""

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
        excess = abs(float(text)) - abs(limit)
        if (excess > 0.0, excess < 0.0) == (abs(value) > abs(limit), abs(value) < abs(limit)):
            break
    return text


_TEMPLATE = _Template()


def _read_finding(keys: dict[str, Any]) -> "Finding":
    """Return a finding of a file from its code and values."""
    result = finding(keys["code"], keys["level"], **_filled(keys["values"]))
    try:
        _ = result.text
    except (KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"findings: {keys['code']} is not a finding of undrift, or lacks a value ({error})") from error
    return result


def _filled(value: Any) -> Any:
    """Return values of a file with NaN for null."""
    if isinstance(value, dict | list):
        return {k: _filled(v) for k, v in value.items()} if isinstance(value, dict) else [_filled(v) for v in value]
    return math.nan if value is None else value


@stored(whole=True, keys=("code", "level", "values", "text", "action"), read=_read_finding)
@dataclass(frozen=True, slots=True)
class Finding:
    """Remark of a fit: a code, its level and its numbers.

    Parameters
    ----------
    code : str
        Stage and subject, "six_face.tilt".
    level : str
        info, warn or fail.
    values : mapping
        Numbers and names that the sentences need. A unit that is not SI is part of the key ("tilt_deg").

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
        """Subject of the finding in a few words."""
        return self._filled(catalogue()[self.code].headline)

    @property
    def detail(self) -> str:
        """One line with the numbers. It may be empty."""
        return self._filled(catalogue()[self.code].detail)

    @property
    def action(self) -> str:
        """Recommended action. It may be empty."""
        return self._filled(catalogue()[self.code].action)

    @property
    def text(self) -> str:
        """Headline, detail and action in one line."""
        head = ": ".join(sentence for sentence in (self.headline, self.detail) if sentence)
        return "; ".join(sentence for sentence in (head, self.action) if sentence)

    def _filled(self, template: str) -> str:
        return _TEMPLATE.vformat(spoken_template(template), (), self.values)


def finding(code: str, level: Level, /, **values: Any) -> Finding:
    """Return a finding. Arrays become tuples, and numpy scalars become numbers."""
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
    """Quality of a fit: good, marginal or bad, with the findings that explain it.

    Parameters
    ----------
    status : str
        good, marginal or bad.
    findings : tuple of Finding
        Reasons for the status, parameters that were not observable, and the recordings that determine them.

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
        """Return the verdict of findings: bad if any is a fail, otherwise marginal if any is a warn, otherwise good."""
        levels = {item.level for item in findings}
        return cls(status="bad" if "fail" in levels else "marginal" if "warn" in levels else "good", findings=findings)

    def also(self, other: "Verdict") -> "Verdict":
        """Return the combined verdict: the worse status, and the findings of both without repetition."""
        worse = max(self.status, other.status, key=("good", "marginal", "bad").index)
        texts = {item.text for item in self.findings}
        new_findings = (item for item in other.findings if item.text not in texts)
        return Verdict(status=worse, findings=(*self.findings, *new_findings))


def level_of(value: float, limits: tuple[float, float]) -> Level:
    """Return fail above the second of two limits, warn above the first, and info otherwise."""
    return "fail" if value > limits[1] else "warn" if value > limits[0] else "info"


def above(code: str, value: float, limits: tuple[float, float], **shown: Any) -> tuple[Finding, ...]:
    """Return a finding if a value exceeds the first of two limits, passed on as ``wanted``. Otherwise the tuple is empty."""
    level = level_of(value, limits)
    return () if level == "info" else (finding(code, level, wanted=limits[0], **shown),)


@cache
def catalogue() -> dict[str, FindingText]:
    """Return the sentences of all codes."""
    return {code: FindingText(**entry) for code, entry in tomllib.loads(_SENTENCES.read_text(encoding="utf-8")).items()}
