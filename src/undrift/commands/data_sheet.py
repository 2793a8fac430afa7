"""Typical noise of a part from its data sheet, by the name of its preset."""

import re
from typing import TYPE_CHECKING

from undrift.base.summary import at

if TYPE_CHECKING:
    from undrift.sim.device.presets import Grade

PART = "kind"  # setting of a calibration's origin
TRUST = {"found": "read in the sheet", "known": "recalled", "known-low": "recalled, uncertain", "calc": "computed"}


def sheet_of(kind: str) -> "Grade":
    """Return what the data sheet of a part states, by the name of its preset."""
    grade: Grade = at("undrift.sim.device.presets:preset_grade")(kind)
    return grade


def sheet_words(kind: str) -> str:
    """Return the name of a data sheet, and how far its figures are to be trusted."""
    trust = re.sub("known-low|known|found|calc", lambda tag: TRUST[tag[0]], sheet_of(kind).source_tag.partition(":")[0])
    return f"data sheet of {kind} as its preset states it ({trust}; compare with the sheet before judging by it)"
