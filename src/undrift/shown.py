"""Values that can be displayed as text, as a page in a notebook, as a report, and as a figure.

``report/values.py`` contains the code. This module imports all stages, so it is imported only when a value is shown, and only here.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from undrift.report.report import Report


class Shown:
    """A value with a report and a figure."""

    __slots__ = ()

    def summary(self) -> "Report":
        """Return the report of the value: its answer, tables, findings and figures."""
        from undrift.report.values import report_of

        return report_of(self)

    def plot(self) -> "Figure":
        """Draw the value as a matplotlib Figure. A notebook shows it, and ``savefig`` writes it to a file."""
        return self.summary().figures[0]()

    def __str__(self) -> str:
        return str(self.summary())

    def _repr_html_(self) -> str:
        return self.summary()._repr_html_()
