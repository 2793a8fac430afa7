"""Observed: what a session shows before anything is fitted: rests, faces, turns, temperature."""

from dataclasses import dataclass, field, replace

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.fit.noise import block_size
from undrift.calibration.one_temperature import piece_temperature
from undrift.calibration.plausibility import check_gravity
from undrift.calibration.rest_mean import mean_of_rests
from undrift.calibration.stillness import check_counted_once, check_stills
from undrift.errors import InputError
from undrift.segments import StillSettings, faces_of, find_still, find_turns, still_means
from undrift.session import FACES, Session, Still, Turn
from undrift.units import Quantity, is_physical, si_factor

_FULL_TURN = 2.0 * np.pi  # rad
_NEAR_FULL = 0.1  # a turn this near a whole number, relative, counts as whole
_FEW = 9  # stills: with fewer, pauses that were too short are worth a word


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrateSettings:
    """Choices that a session file does not make.

    Parameters
    ----------
    still : StillSettings
        How still phases are found where the session states none.
    window_s : float
        Longest stretch of each face that is averaged, s.
    settle_s : float
        Start of each dwell that is thrown away, s.
    latitude_deg : float or None
        For the Earth's rate on a rate table, deg; None leaves it out.
    angle_uncertainty_deg : float
        Standard uncertainty of a turn by a known angle, deg.
    scale_tolerance : float
        How far a scale factor may be from the one the unit states, relative; physical units only.
    remove_offset : bool
        Mode paper has no offset column: take the offset off first, as the note's order of steps does.
    identify_adc : bool
        Look for the step and rounding of the codes.
    """

    still: StillSettings = field(default_factory=StillSettings)
    window_s: float = 6.0
    settle_s: float = 0.3
    latitude_deg: float | None = None
    angle_uncertainty_deg: float = 1.0
    scale_tolerance: float = 0.25
    remove_offset: bool = True
    identify_adc: bool = True


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Observed:
    """A session with its stills, stated or found.

    Parameters
    ----------
    session : Session
        As read.
    settings : CalibrateSettings
        Choices.
    stills : tuple of Still
        Stated in the session, else found; found ones carry a face where gravity shows one.
    found : bool
        True where they were found.
    reasons : tuple of str
        Why a recording gave none.
    """

    session: Session
    settings: CalibrateSettings
    stills: tuple[Still, ...]
    found: bool
    reasons: tuple[str, ...]

    @property
    def faced(self) -> tuple[Still, ...]:
        """Stills with a face."""
        return tuple(s for s in self.stills if s.face is not None)

    def rest_means(self) -> FloatArray:
        """Return the mean rate reading of each still, shape (P, 3).

        Returns
        -------
        array, shape (P, 3)
            Unit of the gyroscopes.
        """
        means = [
            still_means(record.gyro, [s for s in self.stills if s.recording == number])
            for number, record in enumerate(self.session.records)
            if record.gyro is not None
        ]
        return np.concatenate(means)

    def rest_rate(self) -> tuple[FloatArray, FloatArray]:
        """Return the mean rate reading over all rests and its variance.

        Rests that scatter beyond their own noise count by that scatter (``rest_mean.py``).

        Returns
        -------
        mean : array, shape (3,)
            Unit of the gyroscopes; NaN without rest.
        variance : array, shape (3,)
            Of that mean.
        """
        windows, sizes = [], []
        for still in self.stills:
            record = self.session.records[still.recording]
            if record.gyro is not None:
                window = record.gyro[still.start : still.stop]
                window = window[~np.isnan(window).any(axis=1)]
                if len(window):
                    windows.append(window)
                    sizes.append(block_size(record.sample_rate_hz))
        if not windows:
            return np.full(3, np.nan), np.full(3, np.nan)
        return mean_of_rests(windows, sizes)

    def mean_temperature(self) -> float:
        """Return the mean temperature over stills and turns.

        Returns
        -------
        float
            degC: set-points where stated, else the board's thermometer; NaN without either.
        """
        pieces: tuple[Still | Turn, ...] = (*self.stills, *self.session.turns)
        values = [piece_temperature(self.session, piece) for piece in pieces]
        known = [value for value in values if np.isfinite(value)]
        return float(np.mean(known)) if known else float("nan")

    def full_turns(self) -> tuple[Turn, ...]:
        """Return three full turns about x, y and z found between rests, with their angles.

        Each must be near a whole number of turns by the unit's own scale, about a single axis.

        Returns
        -------
        tuple of Turn
            Three, or none.
        """
        full: list[Turn] = []
        for number, record in enumerate(self.session.records):
            stills = [s for s in self.stills if s.recording == number]
            if record.gyro is None or not is_physical(record.gyro_unit) or len(stills) < 2:
                continue
            search = find_turns(record, stills)
            angles = search.rotation_angle * si_factor(record.gyro_unit, "rate")
            for turn, angle in zip(search.rotations, angles, strict=True):
                along = float(angle[np.argmax(np.abs(angle))])
                whole = round(along / _FULL_TURN)
                if turn.axis is not None and whole and abs(along - whole * _FULL_TURN) < _NEAR_FULL * abs(along):
                    full.append(replace(turn, angle=whole * _FULL_TURN))
        one_each = len(full) == 3 and {t.axis for t in full} == {"x", "y", "z"}
        return tuple(full) if one_each else ()

    def plateaus(self) -> int:
        """Return how many steady turns the recordings hold.

        Returns
        -------
        int
            Found in the data.
        """
        return sum(
            len(find_turns(record, [s for s in self.stills if s.recording == number]).plateaus)
            for number, record in enumerate(self.session.records)
            if record.gyro is not None
        )


def observe(session: Session, settings: CalibrateSettings) -> Observed:
    """Take a session's stills as stated, or find and label them.

    Parameters
    ----------
    session : Session
        As read.
    settings : CalibrateSettings
        How stills are found.

    Returns
    -------
    Observed
        Stills, faces and reasons.

    Raises
    ------
    Implausible
        The specific force at rest is not gravity: wrong unit or range; a still that does not rest.
    InputError
        Units that cannot be compared; a recording, still or turn that is there twice.
    """
    session = in_one_unit(session)
    check_counted_once(session)
    stills = session.stills
    reasons: list[str] = []
    if not stills:
        stills, reasons = _found(session, settings.still)
        stills = _labelled(session, stills)
        if len(stills) < _FEW and len({s.face for s in stills} - {None}) < len(FACES):
            short = [_told_short(session, number, stills, settings.still) for number in range(len(session.records))]
            reasons += filter(None, short)
    for number, record in enumerate(session.records):
        own = [s for s in stills if s.recording == number]
        if own and record.accel is not None and is_physical(record.accel_unit):
            check_gravity(still_means(record.accel, own) * si_factor(record.accel_unit, "accel"), session.gravity_m_s2)
    reasons += check_stills(session, stills, stated=bool(session.stills))
    return Observed(session=session, settings=settings, stills=stills, found=not session.stills, reasons=tuple(reasons))


def in_one_unit(session: Session) -> Session:
    """Return the session with each triad in one unit: that of the first recording that has the triad.

    Parameters
    ----------
    session : Session
        As read.

    Returns
    -------
    Session
        The same where the units are alike.

    Raises
    ------
    InputError
        Counts or volts beside another unit: nothing tells what a count is.
    """
    quantities: tuple[Quantity, Quantity] = ("rate", "accel")
    wanted = [_common_unit(session, quantity) for quantity in quantities]
    records = tuple(
        replace(r.in_units(wanted[0], wanted[1]), gyro_unit=wanted[0], accel_unit=wanted[1])
        if (r.gyro_unit, r.accel_unit) != (wanted[0], wanted[1])
        else r
        for r in session.records
    )
    return replace(session, records=records)


def _common_unit(session: Session, quantity: Quantity) -> str:
    rate = quantity == "rate"
    units = [
        (number, record.gyro_unit if rate else record.accel_unit)
        for number, record in enumerate(session.records)
        if (record.gyro if rate else record.accel) is not None
    ]
    if not units:
        return session.records[0].gyro_unit if rate else session.records[0].accel_unit
    first, unit = units[0]
    for number, other in units:
        if other != unit and not (is_physical(other) and is_physical(unit)):
            raise InputError(
                f"recording {number}: wanted {'gyro' if rate else 'accel'} readings in {unit} as in recording {first}, got "
                f"{other}; nothing tells how they compare: give all recordings one unit, or the scale of the columns"
            )
    return unit


def _found(session: Session, settings: StillSettings) -> tuple[tuple[Still, ...], list[str]]:
    stills: tuple[Still, ...] = ()
    reasons: list[str] = []
    for number, record in enumerate(session.records):
        search = find_still(record, settings, recording=number)
        stills = (*stills, *search.stills)
        if not search.stills:
            reasons.append(f"recording {number}: {search.reason}")
    return stills, reasons


def _told_short(session: Session, number: int, stills: tuple[Still, ...], settings: StillSettings) -> str:
    # Pauses too short for a still, seen through a window of a fifth of its length.
    record = session.records[number]
    shorter = replace(settings, window_s=settings.window_s / 5.0, min_duration_s=settings.min_duration_s / 10.0)
    own = [s for s in stills if s.recording == number]
    if not own:  # nothing shows what this device's rest looks like; the search has said why
        return ""
    short = [
        s
        for s in find_still(record, shorter, recording=number).stills
        if not any(s.start < o.stop and o.start < s.stop for o in own)
    ]
    if len(short) < 3:
        return ""
    return (
        f"recording {number}: {len(short)} pauses were shorter than the {settings.window_s + settings.min_duration_s:g} s that a "
        "pose must be held; hold each for 3 s or more"
    )


def _labelled(session: Session, stills: tuple[Still, ...]) -> tuple[Still, ...]:
    unit = session.records[0].accel_unit
    if any(r.accel is None or r.accel_unit != unit for r in session.records):
        return stills
    if not stills or (not is_physical(unit) and len(stills) < 5):
        return stills  # counts have no zero to tell a direction from, unless poses share a sphere
    means = [
        still_means(accel, [still])[0]
        for still in stills
        if (accel := session.records[still.recording].accel) is not None
    ]
    faces = faces_of(np.array(means), centred=is_physical(unit))
    return tuple(replace(still, face=face) for still, face in zip(stills, faces, strict=True))
