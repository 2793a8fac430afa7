"""Temperature: what a recording says of the sensors' temperature, how far it is to be trusted, and its smooth course.

A board thermometer comes noisy, in steps of up to 1 degC, with gaps, stale or on the wrong scale. What a fit cannot use raises;
what it can use with care is named in the notes; the rest is smoothed over time (``course.py``). Its lag stays in
(``lag.py`` takes it off).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from undrift.arrays import BoolArray, FloatArray, frozen
from undrift.drift.temperature.course import Course, block_means, find_course, step_of
from undrift.drift.temperature.doubts import find_doubts, find_stale, standing_alone
from undrift.errors import InputError, NotObservable
from undrift.session import Session, Still, Turn

BOARD_C = (-40.0, 125.0)  # where parts of a board work

Source = Literal["column", "set-points"]


@dataclass(frozen=True, slots=True, kw_only=True)
class TemperatureSettings:
    """How a temperature is taken.

    Parameters
    ----------
    least_span_c : float
        Span that all recordings of the session together must have, K; 0 asks for none, where :func:`check_span` judges several
        sessions together.
    longest_gap_s : float
        Gaps up to this are bridged, s; longer ones stay NaN.
    most_missing : float
        Share of the readings that may be missing, 0 to 1.
    set_point_uncertainty_c : float
        Standard uncertainty of a stated set-point, K.
    """

    least_span_c: float = 2.0
    longest_gap_s: float = 10.0
    most_missing: float = 0.5
    set_point_uncertainty_c: float = 0.5


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Temperature:
    """The temperature of one recording, N samples.

    Parameters
    ----------
    temp_c : array, shape (N,)
        Smooth course, degC; NaN where it is not known.
    uncertainty_c : float
        Standard uncertainty of the course, root-mean-square, K; the thermometer's own trim and lag are not in it.
    noise_c : float
        Standard deviation of one reading, K; 0 for set-points.
    step_c : float
        Step in which the readings come, K; 0 where there is none.
    source : str
        "column" or "set-points".
    notes : tuple of str
        What looks wrong, a sentence each.
    """

    temp_c: FloatArray
    uncertainty_c: float
    noise_c: float
    step_c: float
    source: Source
    notes: tuple[str, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "temp_c", frozen(self.temp_c, (None,), "temp_c"))


def trusted_temperature(
    session: Session, index: int, *, settings: TemperatureSettings = TemperatureSettings()
) -> Temperature:
    """Return the temperature of one recording, smoothed, with what looks wrong about it.

    From the recording's column; where it has none, from the set-points of its stills and turns, and NaN outside them.

    Parameters
    ----------
    session : Session
        Of one device.
    index : int
        Which recording.
    settings : TemperatureSettings
        Limits.

    Returns
    -------
    Temperature
        Of each sample.

    Raises
    ------
    InputError
        No such recording; neither column nor set-points; all or most of the column missing; readings outside -40 to 125 degC.
    NotObservable
        A session whose temperature is constant or spans less than asked for.
    """
    if not 0 <= index < len(session.records):
        raise InputError(f"temperature: wanted recording 0 to {len(session.records) - 1}, got {index}")
    found = _found(session, index, settings)
    if settings.least_span_c > 0.0:
        _check_spans([_ends(session, k, found if k == index else None) for k in range(len(session.records))], settings)
    return found


def check_span(temperatures: Sequence[Temperature], *, settings: TemperatureSettings = TemperatureSettings()) -> float:
    """Return the span of temperatures together; raise where it is too small for a thermal fit.

    Parameters
    ----------
    temperatures : sequence of Temperature
        Of all recordings that one fit will use.
    settings : TemperatureSettings
        With the least span.

    Returns
    -------
    float
        K.

    Raises
    ------
    NotObservable
        None known, a constant, or a span below the least; says which.
    """
    return _check_spans([_extremes(temperature.temp_c) for temperature in temperatures], settings)


def _found(session: Session, index: int, settings: TemperatureSettings) -> Temperature:
    record = session.records[index]
    pieces = _pieces(session, index)
    if record.temp_c is not None:
        return _from_column(record.temp_c, record.time, pieces, f"temperature of recording {index}", settings)
    stated = [(piece, piece.temp_c) for piece in pieces if piece.temp_c is not None]
    if not stated:
        raise InputError(
            f"temperature of recording {index}: wanted a column (columns.temp) or set-points (temp_c of its stills and turns), got "
            "neither; map the thermometer's column or state temp_c"
        )
    temp_c = np.full(len(record), np.nan)
    for piece, set_point in stated:
        temp_c[piece.start : piece.stop] = set_point
    _check_board(temp_c, record.time, f"temperature of recording {index}")
    return Temperature(
        temp_c=temp_c,
        uncertainty_c=settings.set_point_uncertainty_c,
        noise_c=0.0,
        step_c=0.0,
        source="set-points",
        notes=(
            f"temperature of recording {index} is the chamber's set-point in {len(stated)} pieces: the sensors have it only "
            "once they have settled",
        ),
    )


def _pieces(session: Session, index: int) -> list[Still | Turn]:
    every: list[Still | Turn] = [*session.stills, *session.turns]
    return [piece for piece in every if piece.recording == index]


def _from_column(
    raw: FloatArray, time: FloatArray, pieces: list[Still | Turn], name: str, settings: TemperatureSettings
) -> Temperature:
    known = np.isfinite(raw)
    missing = 1.0 - float(known.mean())
    if missing > settings.most_missing or known.sum() < 2:
        raise InputError(
            f"{name}: wanted readings in {100 * (1 - settings.most_missing):g} % of the rows or more, got "
            f"{int(known.sum())} of {len(raw)} (the others NaN); map another column or leave it out and state set-points",
            missing=missing,
        )
    _check_board(raw, time, name)
    notes: list[str] = []
    step = step_of(raw[known])
    alone = standing_alone(raw, step)
    if alone.any():
        worst = float(np.ptp(raw[alone | np.roll(alone, 1)]))
        notes.append(
            f"{name}: {int(alone.sum())} readings stand alone, the first at {time[alone][0]:.6g} s, up to {worst:.3g} K apart: "
            "left out"
        )
    stale, said = find_stale(np.where(alone, np.nan, raw), time, step)
    notes += [f"{name}: {text}" for text in said]
    used = known & ~alone & ~stale
    course = find_course(raw[used], time[used], step)
    notes += [f"{name}: {text}" for text in find_doubts(raw[used], time[used], step, course.noise_c)]
    notes += _against_set_points(raw, pieces, name)
    temp_c, gaps = _bridged(course, used, time, settings.longest_gap_s)
    notes += [f"{name}: {text}" for text in gaps]
    return Temperature(
        temp_c=temp_c,
        uncertainty_c=course.uncertainty_c,
        noise_c=course.noise_c,
        step_c=step,
        source="column",
        notes=tuple(notes),
    )


def _check_board(temp_c: FloatArray, time: FloatArray, name: str) -> None:
    bad = np.flatnonzero((temp_c < BOARD_C[0]) | (temp_c > BOARD_C[1]))
    if len(bad):
        raise InputError(
            f"{name}: wanted {BOARD_C[0]:g} to {BOARD_C[1]:g} degC of a board, got {temp_c[bad[0]]:g} degC at {time[bad[0]]:.6g} s "
            f"({len(bad)} such); check units.temp and scale.temp",
            temp_c=float(temp_c[bad[0]]),
        )


def _against_set_points(raw: FloatArray, pieces: list[Still | Turn], name: str) -> list[str]:
    apart = [
        (float(np.nanmedian(raw[p.start : p.stop])) - p.temp_c, p.temp_c)
        for p in pieces
        if p.temp_c is not None and np.isfinite(raw[p.start : p.stop]).any()
    ]
    far = [(difference, stated) for difference, stated in apart if abs(difference) > 5.0]
    if not far:
        return []
    worst, stated = max(far, key=lambda pair: abs(pair[0]))
    return [
        f"{name}: implausible, the column reads {stated + worst:.1f} degC at a set-point of {stated:.1f} ({len(far)} of "
        f"{len(apart)} pieces over 5 K apart)"
    ]


def _bridged(course: Course, used: BoolArray, time: FloatArray, longest_s: float) -> tuple[FloatArray, list[str]]:
    """Return the course at every sample: gaps up to a length bridged, longer ones NaN."""
    temp_c = np.full(len(time), np.nan)
    temp_c[used] = course.temp_c
    gone = np.flatnonzero(~used)
    if len(gone) == 0:
        return temp_c, []
    at = np.flatnonzero(used)
    after = np.searchsorted(at, gone)
    inside = (after > 0) & (after < len(at))
    length = np.full(len(gone), np.inf)
    length[inside] = time[at[after[inside]]] - time[at[after[inside] - 1]]
    short = gone[length <= longest_s]
    temp_c[short] = np.interp(time[short], time[at], course.temp_c)
    left = len(gone) - len(short)
    said = f"{len(gone)} readings missing, {len(short)} in gaps of up to {longest_s:g} s bridged"
    return temp_c, [said + (f", {left} in longer ones left out" if left else "")]


def _ends(session: Session, index: int, found: Temperature | None) -> tuple[float, float]:
    """Return the lowest and highest temperature of a recording, noise averaged out; NaN where it says nothing."""
    if found is not None:
        return _extremes(found.temp_c)
    record = session.records[index]
    if record.temp_c is None:
        stated = [p.temp_c for p in _pieces(session, index) if p.temp_c is not None]
        return (min(stated), max(stated)) if stated else (np.nan, np.nan)
    known = np.isfinite(record.temp_c)
    if known.sum() < 2:
        return np.nan, np.nan
    return _extremes(block_means(record.time[known], record.temp_c[known])[1])


def _extremes(temp_c: FloatArray) -> tuple[float, float]:
    known = temp_c[np.isfinite(temp_c)]
    return (float(known.min()), float(known.max())) if len(known) else (np.nan, np.nan)


def _check_spans(ends: list[tuple[float, float]], settings: TemperatureSettings) -> float:
    known = [pair for pair in ends if pair[0] == pair[0]]
    if not known:
        raise NotObservable("thermal drift: wanted a recording with a known temperature, got none; map its column")
    low, high = min(pair[0] for pair in known), max(pair[1] for pair in known)
    span = high - low
    if span == 0.0:
        raise NotObservable(
            f"thermal drift: wanted temperatures that differ, got {low:.2f} degC throughout (constant); check that the column is "
            "the thermometer's, and record while the device warms",
            span_c=span,
        )
    if span < settings.least_span_c:
        raise NotObservable(
            f"thermal drift: wanted a span of {settings.least_span_c:g} degC or more, got {span:.2g} ({low:.2f} to {high:.2f}); "
            "record while the device warms or cools further",
            span_c=span,
        )
    return span
