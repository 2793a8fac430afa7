"""Soaks of a simulated chamber, recorded in other ways: a record for each set-point, or without temperatures."""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from undrift.record import Session


def _with_visits(session: Session, change: Callable[[Any, int, int], Any]) -> tuple[np.ndarray, dict[str, Any]]:
    """Return the edges of the visits in the record, and labels changed with the number and the first sample of their visit."""
    gaps = np.flatnonzero(np.diff(session.records[0].time) > 1.0) + 1
    edges = np.array([0, *gaps, len(session.records[0])])
    labels = {}
    for name in ("stills", "turns"):
        pieces = getattr(session, name)
        visits = np.searchsorted(edges, [piece.start for piece in pieces], "right") - 1
        labels[name] = tuple(change(piece, int(k), int(edges[k])) for piece, k in zip(pieces, visits, strict=True))
    return edges, labels


def a_record_for_each_visit(session: Session) -> Session:
    def moved(piece: Any, visit: int, first: int) -> Any:
        return replace(piece, start=piece.start - first, stop=piece.stop - first, recording=visit)

    edges, labels = _with_visits(session, moved)
    parts = tuple(session.records[0].part(a, b) for a, b in pairwise(edges))
    return replace(session, records=parts, **labels)


def without_temperature(session: Session, set_points_c: tuple[float, ...]) -> Session:
    _, labels = _with_visits(session, lambda piece, visit, first: replace(piece, temp_c=set_points_c[visit]))
    return replace(session, records=(replace(session.records[0], temp_c=None),), **labels)
