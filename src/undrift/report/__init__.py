"""Reports of commands with their tables and figures, on a terminal, as a page and as JSON."""

from undrift.report.report import Cell, Estimate, Report, Table

__all__ = ["Cell", "Estimate", "Report", "Table"]
