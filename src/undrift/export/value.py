"""Exported: a text for another program, and what that program cannot do with the calibration."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Exported:
    """A file for another program.

    Parameters
    ----------
    text : str
        The file.
    not_carried : tuple of str
        What the calibration holds and the file does not, one sentence each, with its size where it has one.
    notes : tuple of str
        What the reader of the file must know or do.
    """

    text: str
    not_carried: tuple[str, ...]
    notes: tuple[str, ...] = ()
