"""Findings of a verdict, by code."""

from collections.abc import Iterable

from undrift.findings import Finding


def only(findings: Iterable[Finding], code: str) -> Finding:
    """Return the only finding with a code. Fail if there is no such finding or more than one."""
    (item,) = (item for item in findings if item.code == code)
    return item


def codes(findings: Iterable[Finding]) -> list[str]:
    return [item.code for item in findings]
