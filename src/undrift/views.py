"""How a value shows itself: a picture drawn by report, and a small table in a notebook.

A value is below what draws it, so the picture stands here by its place, "package.module:function", and is imported when it is asked
for, as ``undrift`` imports its own names.
"""

import importlib
from abc import ABC, abstractmethod
from html import escape
from typing import Any, Protocol

PICTURES = {
    "Record": "undrift.report.figures:draw_record",
    "Calibration": "undrift.report.certificate:draw_calibration",
    "NoiseFit": "undrift.report.figures:draw_allan",
    "DriftFit": "undrift.report.drift:draw_drift",
    "Orientation": "undrift.report.figures:draw_orientation",
    "Trial": "undrift.report.validation:trial_figure",
    "Validation": "undrift.report.validation:draw_validation",
}


class Picture(Protocol):
    """A matplotlib Figure, as far as one needs it without matplotlib's types."""

    def savefig(self, fname: Any, **how: Any) -> None:
        """Write the picture, by the ending of the name."""


def at(place: str) -> Any:
    """Return the object of a place, "package.module:name"."""
    module, _, name = place.partition(":")
    return getattr(importlib.import_module(module), name)


class Shown(ABC):
    """A value that draws itself and is a table in a notebook."""

    __slots__ = ()

    def plot(self) -> Picture:
        """Draw the value as a matplotlib Figure: a notebook shows it, ``savefig`` writes it."""
        drawn: Picture = at(PICTURES[type(self).__name__])(self)
        return drawn

    @abstractmethod
    def _rows(self) -> dict[str, str]:
        """Return the rows of the table: what, and its value with unit."""

    def _repr_html_(self) -> str:
        rows = "".join(
            f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>" for name, value in self._rows().items()
        )
        return f"<table><caption>{type(self).__name__}</caption>{rows}</table>"
