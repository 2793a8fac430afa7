"""Findings: remarks about a result, written where they are raised. Each has a code, a level, a sentence, an action and numbers.

::

    finding(
        "six_face.tilt",
        "warn",
        f"The faces are tilted by {tilt_deg:.2f} deg (1 sigma).",
        "Align the fixture, or rest in nine or more free poses.",
        tilt_deg=tilt_deg,
    )

The sentence describes the finding, with number, unit and limit. The action is one instruction, or "" if there is nothing to do.
Values are the numbers that programs read.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import Field

from undrift.base.codec import As, FileTable, stored, to_null, tree_of
from undrift.base.spoken import spoken_finding

Level = Literal["info", "warn", "fail"]
Status = Literal["good", "marginal", "bad"]
Value = float | int | str | bool | tuple[float, ...] | tuple[str, ...]

SHOWN_FIRST = 3  # number of findings that are shown without details
_LEVELS = ("fail", "warn", "info")


def _plain(value: Any) -> Value:
    value = value.tolist() if hasattr(value, "tolist") else value
    return tuple(_plain(item) for item in value) if isinstance(value, list | tuple) else value  # type: ignore[return-value]


def _read_values(values: dict[str, Any]) -> dict[str, Value]:
    return {name: math.nan if value is None else _plain(value) for name, value in values.items()}


def _write_values(values: Mapping[str, Value]) -> dict[str, Any]:
    return {name: _without_nan(value) for name, value in values.items()}


def _without_nan(value: Any) -> Any:
    if isinstance(value, tuple):
        return [_without_nan(item) for item in value]
    return to_null(value) if isinstance(value, float) else value


@stored()
@dataclass(frozen=True, slots=True)
class Finding:
    """Remark of a fit.

    Parameters
    ----------
    code : str
        Stage and subject, for example "six_face.tilt".
    level : str
        info, warn or fail.
    values : mapping
        Numbers for programs. A unit that is not SI is part of the key ("tilt_deg").
    sentence : str
        Description of the finding, with number, unit and limit. In files, this is the key ``text``.
    action : str
        One instruction, or "".

    Examples
    --------
    >>> import numpy as np, undrift
    >>> rng = np.random.default_rng(7)
    >>> device = undrift.random_device(rng)
    >>> calibration = undrift.calibrate(undrift.simulate_session("six_face", device, rng=rng))
    >>> found = {finding.code: finding for finding in calibration.verdict.findings}
    >>> found["session.not_observable"].level, found["session.not_observable"].sentence
    ('info', 'The session does not determine the gyroscope.')
    """

    code: str
    level: Level
    values: Annotated[Mapping[str, Value], As(dict[str, Any], _read_values, _write_values)]
    sentence: Annotated[str, Field(alias="text")]
    action: str

    @property
    def text(self) -> str:
        """Return sentence and action. The command line and the page replace back-ticked arguments by their own words."""
        return spoken_finding(f"{self.sentence} {self.action}".rstrip())


def finding(code: str, level: Level, sentence: str, action: str = "", /, **values: Any) -> Finding:
    """Return a finding. Arrays become tuples, and numpy scalars become numbers."""
    return Finding(code, level, {name: _plain(value) for name, value in values.items()}, sentence, action)


def level_of(value: float, limits: tuple[float, float]) -> Level:
    """Return fail above the second of two limits, warn above the first, and info otherwise."""
    return "fail" if value > limits[1] else "warn" if value > limits[0] else "info"


def above(
    code: str, value: float, limits: tuple[float, float], sentence: str, action: str, /, **values: Any
) -> tuple[Finding, ...]:
    """Return a finding if a value exceeds the first of two limits. Otherwise the tuple is empty."""
    level = level_of(value, limits)
    return () if level == "info" else (finding(code, level, sentence, action, **values),)


def two_digits(value: float) -> str:
    """Return a number with two significant digits, or as a whole number from 100."""
    return f"{value:.2g}" if value < 99.5 else f"{value:.0f}"


def told_apart(value: float, form: str, limit: float) -> str:
    """Return a value formatted as, for example, ".2g", with more digits if rounding would move it to the other side of a limit."""
    start, _, kind = form.partition(".")
    for digits in range(int(kind[:-1]), 17):
        text = format(value, f"{start}.{digits}{kind[-1]}")
        excess = abs(float(text)) - abs(limit)
        if (excess > 0.0, excess < 0.0) == (abs(value) > abs(limit), abs(value) < abs(limit)):
            break
    return text


def most_consequential_first(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Return findings by level: fail, warn, info. Each text appears once."""
    once = {item.text: item for item in findings}.values()
    return tuple(sorted(once, key=lambda item: _LEVELS.index(item.level)))


class VerdictTable(FileTable, title="Verdict"):
    """Quality of a fit: good, marginal or bad, with the findings that explain it."""

    status: Status
    reasons: tuple[str, ...]
    findings: tuple[Finding, ...] = ()


@stored(
    form=As(
        VerdictTable,
        lambda table: Verdict(status=table.status, findings=table.findings),
        lambda verdict: tree_of(
            VerdictTable.model_construct(**{name: getattr(verdict, name) for name in VerdictTable.model_fields})
        ),
    )
)
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
    findings: tuple[Finding, ...] = ()

    @property
    def reasons(self) -> tuple[str, ...]:
        """Return the texts of the findings, starting with the most consequential."""
        return tuple(item.text for item in most_consequential_first(self.findings))

    @classmethod
    def of(cls, *findings: Finding) -> "Verdict":
        """Return the verdict from findings, each once: bad with any fail, otherwise marginal with any warn, otherwise good."""
        findings = tuple({item.text: item for item in findings}.values())
        levels = {item.level for item in findings}
        return cls(status="bad" if "fail" in levels else "marginal" if "warn" in levels else "good", findings=findings)

    def also(self, other: "Verdict") -> "Verdict":
        """Return the combined verdict: the worse status, and the findings of both verdicts without repetition."""
        worse = max(self.status, other.status, key=("good", "marginal", "bad").index)
        texts = {item.text for item in self.findings}
        new_findings = (item for item in other.findings if item.text not in texts)
        return Verdict(status=worse, findings=(*self.findings, *new_findings))
