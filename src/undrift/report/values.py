"""Reports of values that can be displayed (``undrift.shown``)."""

from collections.abc import Callable
from functools import singledispatch
from typing import TYPE_CHECKING, Any

from undrift.calibration.noise import NoiseFit
from undrift.drift.fit import DriftFit
from undrift.model import Calibration
from undrift.orientation import Orientation
from undrift.record import Record
from undrift.report.calibration import calibration_report
from undrift.report.drift import drift_report
from undrift.report.figures import draw_allan, draw_orientation, draw_record, draw_validation, trial_figure
from undrift.report.report import Report, Table
from undrift.validation.agreement import Validation
from undrift.validation.trial import Trial

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@singledispatch
def report_of(value: object) -> Report:
    """Return the report of a value."""
    raise TypeError(f"{type(value).__name__} has no report")


report_of.register(Calibration, calibration_report)
report_of.register(DriftFit, drift_report)


def _register(kind: type, draw: Callable[[Any], "Figure"]) -> None:
    """Register a type of value that is shown as a table of its facts and a figure."""

    def report_of_facts(value: Any) -> Report:
        rows = [*value.facts().items()]
        table = Table(title=kind.__name__, columns=("", "value"), rows=rows)
        return Report(title=kind.__name__, answer="", tables=[table], figures=[lambda: draw(value)])

    report_of.register(kind, report_of_facts)


_register(Record, draw_record)
_register(NoiseFit, draw_allan)
_register(Orientation, draw_orientation)
_register(Trial, trial_figure)
_register(Validation, draw_validation)
