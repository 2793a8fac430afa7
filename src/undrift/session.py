"""Session: the recordings of one calibration, and where in them the device stood still or turned.

Ranges are sample numbers, half-open [start, stop). A face names the sensor axis that points up: it reads +g.
"""

from dataclasses import dataclass
from typing import Literal

from undrift.errors import InputError
from undrift.record import Record

Face = Literal["+x", "-x", "+y", "-y", "+z", "-z"]
Axis = Literal["x", "y", "z"]
Kind = Literal["calibration", "thermal", "static"]
FACES: tuple[Face, ...] = ("+x", "-x", "+y", "-y", "+z", "-z")


@dataclass(frozen=True, slots=True, kw_only=True)
class Still:
    """A stretch in which the device did not move.

    Parameters
    ----------
    start, stop : int
        Samples [start, stop).
    face : str or None
        Axis that points up; None for a free pose.
    recording : int
        Which record of the session.
    temp_c : float or None
        Chamber set-point, degC, where there is no temperature column.
    """

    start: int
    stop: int
    face: Face | None = None
    recording: int = 0
    temp_c: float | None = None

    def __post_init__(self) -> None:
        _check_range(self.start, self.stop, "still")


@dataclass(frozen=True, slots=True, kw_only=True)
class Turn:
    """A stretch in which the device turned: at a steady rate, through a known angle, or freely.

    Parameters
    ----------
    start, stop : int
        Samples [start, stop).
    axis : str or None
        Case axis of the turn; None for a free rotation.
    turn_rate : float or None
        Achieved steady rate about +axis, rad/s (rate table).
    angle : float or None
        Angle turned about +axis, rad (known rotation).
    recording : int
        Which record of the session.
    temp_c : float or None
        Chamber set-point, degC.
    """

    start: int
    stop: int
    axis: Axis | None = None
    turn_rate: float | None = None
    angle: float | None = None
    recording: int = 0
    temp_c: float | None = None

    def __post_init__(self) -> None:
        _check_range(self.start, self.stop, "turn")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Session:
    """The recordings of one device and what was done to it.

    Parameters
    ----------
    kind : str
        calibration, thermal or static.
    serial : str
        Device serial number.
    gravity_m_s2 : float
        Local gravity, m/s2.
    records : tuple of Record
        One or more recordings.
    stills : tuple of Still
        As stated in the file; empty when they are to be found in the data.
    turns : tuple of Turn
        Likewise.
    inputs : tuple of (str, str)
        File name and sha256 of every file that was read.
    """

    kind: Kind
    serial: str
    gravity_m_s2: float
    records: tuple[Record, ...]
    stills: tuple[Still, ...] = ()
    turns: tuple[Turn, ...] = ()
    inputs: tuple[tuple[str, str], ...] = ()

    def __post_init__(self) -> None:
        if not self.records:
            raise InputError("session: wanted one recording or more, got none; add a [[recording]] to session.toml")
        if not 9.7 < self.gravity_m_s2 < 9.9:
            raise InputError(
                f"session: wanted local gravity between 9.7 and 9.9 m/s2, got {self.gravity_m_s2:g}; "
                "give gravity_m_s2, or latitude_deg and height_m"
            )
        pieces: tuple[Still | Turn, ...] = (*self.stills, *self.turns)
        for piece in pieces:
            if not 0 <= piece.recording < len(self.records) or piece.stop > len(self.records[piece.recording]):
                raise InputError(
                    f"session: wanted samples inside a recording, got [{piece.start}, {piece.stop}) of recording "
                    f"{piece.recording}; check start_s and stop_s"
                )


def _check_range(start: int, stop: int, what: str) -> None:
    if not 0 <= start < stop:
        raise InputError(f"{what}: wanted samples 0 <= start < stop, got [{start}, {stop}); check its start and stop")
