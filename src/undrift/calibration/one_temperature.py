"""One temperature: of a session that visits several set-points, the pieces at one of them.

A constant matrix and offset hold at one temperature. Where the stated stills and turns fall into groups of temperature more than
3 K apart, the group nearest to 25 degC serves, of those that hold at least half as many pieces as the largest; the others are for
the drift tables.
"""

from dataclasses import replace

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.session import Session, Still, Turn

APART_C = 3.0
ROOM_C = 25.0


def at_one_temperature(session: Session) -> tuple[Session, tuple[str, ...]]:
    """Return a session with the stated pieces of one temperature.

    Parameters
    ----------
    session : Session
        As read.

    Returns
    -------
    session : Session
        The same where its pieces are of one temperature, or do not tell.
    said : tuple of str
        What was left out, if anything.
    """
    pieces: tuple[Still | Turn, ...] = (*session.stills, *session.turns)
    temps = np.array([piece_temperature(session, piece) for piece in pieces])
    if len(pieces) < 2 or np.isnan(temps).any() or np.ptp(temps) <= APART_C:
        return session, ()
    group = _groups(temps)
    counts = np.bincount(group)
    if len(counts) == 1:
        return session, ()
    means = np.bincount(group, temps) / counts
    able = np.flatnonzero(2 * counts >= counts.max())
    chosen = int(able[np.argmin(np.abs(means[able] - ROOM_C))])
    kept = group == chosen
    stills = tuple(s for s, keep in zip(session.stills, kept[: len(session.stills)], strict=True) if keep)
    turns = tuple(t for t, keep in zip(session.turns, kept[len(session.stills) :], strict=True) if keep)
    said = (
        f"the session visits {len(counts)} temperatures from {means.min():.1f} to {means.max():.1f} degC: its {counts[chosen]} "
        f"stills and turns at {means[chosen]:.1f} degC were used; undrift drift makes tables of all"
    )
    return replace(session, stills=stills, turns=turns), (said,)


def piece_temperature(session: Session, piece: Still | Turn) -> float:
    """Return the temperature of a still or turn.

    Parameters
    ----------
    session : Session
        Its session.
    piece : Still or Turn
        Which.

    Returns
    -------
    float
        degC: the set-point where stated, else the mean of the board's thermometer; NaN without either.
    """
    if piece.temp_c is not None:
        return piece.temp_c
    column = session.records[piece.recording].temp_c
    if column is None or not np.isfinite(column[piece.start : piece.stop]).any():
        return float("nan")
    return float(np.nanmean(column[piece.start : piece.stop]))


def _groups(temps: FloatArray) -> IntArray:
    """Number the temperatures from cold to warm, a new number after each gap."""
    order = np.argsort(temps)
    number = np.concatenate(([0], np.cumsum(np.diff(temps[order]) > APART_C)))
    group = np.empty(len(temps), dtype=np.int64)
    group[order] = number
    return group
