"""Recordings and their references, read in pairs."""

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from undrift.cli.opening import Opening
from undrift.errors import InputError

if TYPE_CHECKING:
    from undrift.record import Record, Reference


def read_pairs(
    records: tuple[Path, ...],
    reference: tuple[Path, ...],
    labels: tuple[str, ...] | None,
    up: Literal["y", "z"] | None,
    opening: Opening,
    *,
    command: str,
) -> list[tuple["Record", "Reference"]]:
    """Read recordings and the reference of each.

    Parameters
    ----------
    records : tuple of Path
        Recordings.
    reference : tuple of Path
        One for each, in the same order; none where every recording is a BROAD file, which holds its own.
    labels : tuple of str or None
        Markers of one rigid cluster, for C3D and TRC.
    up : str or None
        Laboratory axis that points up, for C3D and TRC.
    opening : Opening
        How to read foreign recordings.
    command : str
        Who asks, for the error.

    Returns
    -------
    list of tuple
        Record and Reference.

    Raises
    ------
    InputError
        Another number of references than recordings, and all that the readers raise.
    """
    from undrift.io.detect import detect

    if not reference and all(detect(record) == "broad" for record in records):
        reference = records
    if len(reference) != len(records):
        raise InputError(
            f"{command}: wanted one reference for each recording, got {len(reference)} for {len(records)}; "
            "say --reference once for each, in the same order"
        )
    return [(opening.read(record), _poses(poses, labels, up)) for record, poses in zip(records, reference, strict=True)]


def _poses(path: Path, labels: tuple[str, ...] | None, up: Literal["y", "z"] | None) -> "Reference":
    """Read a reference; what a file of markers needs is asked for in the words of the command line."""
    from undrift.io.detect import detect
    from undrift.io.markers import pose_from_cluster
    from undrift.io.reference import read_markers, read_reference

    if detect(path) not in ("trc", "c3d"):
        return read_reference(path)
    try:
        markers = read_markers(path, up=up)
    except InputError as error:
        if up is not None or "points up" not in str(error):
            raise
        raise InputError(
            f"{path}: wanted the axis that points up, got none; say --reference-up y or --reference-up z"
        ) from error
    if labels is None:
        raise InputError(
            f"{path}: wanted the labels of one rigid cluster, got none; say --markers with three or more, commas between, of "
            f"{', '.join(markers.labels)}"
        )
    return pose_from_cluster(markers, labels)
