"""The page of a study."""

from pathlib import Path
from typing import TYPE_CHECKING

from undrift.report.page import write_page

if TYPE_CHECKING:
    from undrift.study.outcome import StudyOutcome


def write_study_report(outcome: "StudyOutcome", path: Path) -> None:
    """Write the page of a study.

    Parameters
    ----------
    outcome : StudyOutcome
        What came out.
    path : Path
        The .html file.
    """
    write_page(path, title="Study", lead=outcome.study.name, sections=())
