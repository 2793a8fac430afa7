"""Capture the readings of a guided session. Detect rests and the face that is up, and write the session's folder.

A device is at rest if `find_still` accepts its newest readings twice: with the threshold from the readings, and within four noise
floors of the quietest window. For counts, the limits are relative to gravity. The face that is up is the axis with the largest
share of the mean acceleration. Readings in counts have an unknown zero. With five captured faces, the zero is the centre of a
sphere through them. Before that, it is 0 if the mean readings at all rests have similar lengths and in one rest a single axis has
nearly the whole length, as for digital parts. Otherwise, it is the centre of a sphere through the readings while the device is
turned over all its sides. Only relative lengths are used, so that no scale is needed.
"""

import math
from collections import deque
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Literal, TypeVar, cast

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError
from undrift.io.session import write_session
from undrift.record import FACES, Face, Record, Session, Still, Turn, joined
from undrift.segments import BENCH_ACCEL_LIMIT, StillSettings, find_still, sample_count, sliding_moments, sphere_of
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, is_physical

Piece = TypeVar("Piece", Still, Turn)
State = Literal["no readings", "moving", "settling", "still", "captured", "wrong face", "tilted", "unknown face"]
COUNTDOWN_S, SETTLE_S = 6.0, 1.5  # duration of a captured rest, and of the rest before it, s
TILT_DEG = 12.0  # largest tilt of a face, measured with uncalibrated accelerometers, deg
SILENCE_S = 1.0  # host time without a new reading after which the device is silent, s
GAP_S, GAP_PERIODS = 0.1, 5.0  # longest silence of the device that is not a gap, s
KEEP_S = 120.0  # length of the kept readings while nothing is captured, s
BESIDE_S = 10.0  # time kept before the first piece of a recording, and after the last, s
CLOUD_S, CLOUD_POINTS = 0.25, 2000  # number of accelerometer means that determine the zero
ALIKE = 1.6  # largest spread of reading lengths with a zero of 0: within 0.2 g
# criteria for a sphere in a cloud: points, radius over noise, length of their mean side, least mean square of a side, spread of the
# points about it and distance of rests from it as shares of the radius (triads differ in scale by tens of percent)
LEAST_POINTS, NOISES, LOPSIDED, FLAT, THICK, OFF = 24, 10.0, 0.55, 0.05, 0.25, 0.5
LOOSE_DEG = 25.0  # smallest tilt that cannot be due to an error of the zero, for readings in counts
LEAST_REST_S = 1.0
UNKNOWN = "It is not known yet which face is up. Turn the device over all its sides once."


@dataclass(frozen=True, slots=True, kw_only=True)
class Light:
    """The current state of the device, as shown to the user."""

    state: State
    text: str  # reason and remedy
    face: Face | None = None  # face that is up
    left_s: float | None = None  # time until the capture during the countdown, s


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rest:
    """A current rest, which lasts until the newest reading, or a captured rest. Times are on the clock of the capture."""

    start_s: float
    stop_s: float
    mean: FloatArray  # (3,), mean reading of the accelerometers, raw

    @property
    def duration_s(self) -> float:
        """Return the duration, s."""
        return self.stop_s - self.start_s


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CapturedTurn:
    """A turn between two rests."""

    turn: Turn  # axis and angle; samples are determined when the turn is written
    before: Rest
    after: Rest
    reading: float  # integral about the axis, raw unit times s

    @property
    def way(self) -> str:
        """Return the name of the turn, for example ``+x`` for a turn about x by a positive angle."""
        return f"{'+' if (self.turn.angle or 0.0) > 0.0 else '-'}{self.turn.axis}"


class Capture:
    """The data of a guided session: readings, faces, turns and the folder.

    All readings use the clock of the first connection. Readings of another connection follow after a gap.
    """

    def __init__(self, folder: Path, serial: str = "", *, gravity_m_s2: float | None = None) -> None:
        self.folder, self.serial, self.gravity_m_s2 = folder, serial, gravity_m_s2
        self.faces: dict[str, Rest] = {}
        self.turns: dict[str, CapturedTurn] = {}  # captured turns by direction
        self.saved = False  # True if the folder contains all captured data
        self.newest_s = (
            self.whole_from_s
        ) = -math.inf  # time of the newest reading, and of the first reading after the last gap
        self._readings: list[Record] = []
        self._key: object = None  # connection
        self._clock_s = 0.0  # time that is added to the clock of the connection
        self._heard_s = -math.inf  # host time of the newest reading
        self._cloud: deque[FloatArray] = deque(maxlen=CLOUD_POINTS)
        self._rests: deque[FloatArray] = deque(maxlen=64)
        self._noise = self._extent = 0.0  # noise of the accelerometers at rest, and longest side of the cloud, raw

    # ---- Readings

    def take(self, record: Record | None, now_s: float, key: object = None) -> None:
        """Add the newest readings, which may overlap earlier ones: now_s is on the host's clock, key identifies the connection."""
        if record is None:
            return
        if record.accel is None or record.gyro is None:
            raise InputError(
                "capture: gyroscope and accelerometer are both required, but one is missing. List both in the device's address."
            )
        latest = self._readings[-1] if self._readings else record
        if (latest.gyro_unit, latest.accel_unit) != (record.gyro_unit, record.accel_unit):
            raise InputError(
                f"capture: expected readings in {latest.accel_unit}, got {record.accel_unit}. Start a new session."
            )
        longest_s = _longest_s(record)
        if self._readings and (key is not self._key or record.time[-1] + self._clock_s < self.newest_s):
            self._clock_s = self.newest_s + 2.0 * longest_s - float(record.time[0])
        self._key = key
        time = record.time + self._clock_s
        first = int(np.searchsorted(time, self.newest_s, side="right"))
        if len(record) - first < 2:  # a single reading waits for the next one
            return
        gaps = np.flatnonzero(np.diff(time[first:], prepend=self.newest_s) > longest_s)
        if len(gaps):
            self.whole_from_s = float(time[first + gaps[-1]])
        self._readings.append(replace(record, time=time).part(first, len(record)))
        self._heard_s, self.newest_s = now_s, float(time[-1])
        self._add_to_cloud(self._readings[-1])
        self._forget()

    def _add_to_cloud(self, chunk: Record) -> None:
        step = max(1, round(CLOUD_S * chunk.sample_rate_hz))
        for first in range(0, len(chunk), step):
            mean = np.asarray(chunk.accel)[first : first + step].mean(axis=0)
            moved = not self._cloud or np.linalg.norm(mean - self._cloud[-1]) > 0.02 * self._extent
            if moved and np.isfinite(mean).all():
                self._cloud.append(mean)
                self._extent = float(np.ptp(np.array(self._cloud), axis=0).max())

    def _forget(self) -> None:
        """Drop old readings without a capture."""
        last_s = max((rest.stop_s for rest in self._captured_rests()), default=-math.inf)
        if self.newest_s - max(last_s, float(self._readings[0].time[0])) > 2.0 * KEEP_S:
            self._readings = [
                chunk
                for chunk in self._readings
                if chunk.time[0] < last_s + BESIDE_S or chunk.time[-1] > self.newest_s - KEEP_S
            ]

    def _captured_rests(self) -> list[Rest]:
        return [*self.faces.values(), *(rest for turn in self.turns.values() for rest in (turn.before, turn.after))]

    def _between(self, start_s: float, stop_s: float = math.inf) -> Record:
        chunks = joined([chunk for chunk in self._readings if chunk.time[-1] >= start_s and chunk.time[0] < stop_s])
        first, last = np.searchsorted(chunks.time, (start_s, stop_s)).tolist()
        return chunks.part(first, last)

    def tail(self, seconds: float) -> Record | None:
        """Return the newest readings since the last gap. Single lost readings are omitted."""
        if not self._readings:
            return None
        record = self._between(max(self.newest_s - seconds, self.whole_from_s))
        gyro, accel = np.asarray(record.gyro), np.asarray(record.accel)
        at = np.flatnonzero(~np.isnan(np.column_stack((gyro, accel))).any(axis=1))
        at = at[max(np.flatnonzero(np.diff(record.time[at]) > _longest_s(record)), default=-1) + 1 :]
        if len(at) in (len(record), 0, 1):
            return record if len(at) > 1 else None
        return replace(record, time=record.time[at], gyro=gyro[at], accel=accel[at], temp_c=None, mag_ut=None)

    def lost(self, start_s: float, stop_s: float) -> bool:
        """Return True if a reading was lost in a span of time."""
        return bool(np.isnan(np.asarray(self._between(start_s, stop_s).gyro)).any())

    # ---- Rest and face

    def silent(self, now_s: float) -> bool:
        """Return True if no readings have come recently."""
        return now_s - self._heard_s > SILENCE_S

    def rest(self) -> Rest | None:
        """Return the current rest. Return None while the device moves, or if there are too few readings."""
        record = self.tail(2.0 * (COUNTDOWN_S + SETTLE_S))
        if record is None:
            return None
        start, stop = 0, len(record)
        try:
            for still in (StillSettings(threshold_floors=4.0), StillSettings()):  # the quicker test first
                stills = find_still(record, still).stills
                if not stills or stills[-1].stop != stop:
                    return None
                start = max(start, stills[-1].start)
        except InputError:  # the readings are shorter than a window
            return None
        within = np.asarray(record.accel)[start:stop]
        mean = within.mean(axis=0)
        # computed first, because it distinguishes a cloud of noise from a sphere
        self._noise = float(np.linalg.norm(within.std(axis=0)))
        if self._varies_in_counts(within, mean, record.sample_rate_hz):
            return None
        rest = Rest(start_s=float(record.time[start]), stop_s=float(record.time[-1]), mean=mean)
        similar = (np.linalg.norm(mean - earlier) < 0.05 * np.linalg.norm(earlier) for earlier in self._rests)
        if rest.duration_s >= SETTLE_S and not any(similar):
            self._rests.append(mean)
        return rest

    def _varies_in_counts(self, accel: FloatArray, mean: FloatArray, sample_rate_hz: float) -> bool:
        """Return True if readings in counts vary too much for a bench, relative to gravity. For physical readings,
        `find_still` decides.
        """
        zero = None if self._is_physical else self._zero(mean)[0]
        if zero is None:
            return False
        usual, length = StillSettings(), float(np.linalg.norm(mean - zero))
        smooth = max(1, round(usual.smooth_s * sample_rate_hz))
        _, spread = sliding_moments(
            accel, min(sample_count(usual.window_s, sample_rate_hz), len(accel) - smooth + 1), smooth
        )
        return bool(spread.max() > BENCH_ACCEL_LIMIT / STANDARD_GRAVITY * length)

    def face_of(self, rest: Rest) -> tuple[Face | None, float]:
        """Return the face that is up in a rest, or None if it is not known, and its tilt beyond the limit, deg."""
        up, limit_deg = self.up(rest)
        if up is None:
            return None, 0.0
        axis = int(np.abs(up).argmax())
        tilt_deg = math.acos(min(1.0, abs(float(up[axis])))) / RADIAN_PER_DEGREE
        return FACES[2 * axis + (up[axis] < 0.0)], tilt_deg if tilt_deg > limit_deg else 0.0

    def up(self, rest: Rest) -> tuple[FloatArray | None, float]:
        """Return the direction of gravity in a rest, (3,), and the smallest tilt that exceeds its error, deg."""
        zero, limit_deg = self._zero(rest.mean)
        return None if zero is None else (rest.mean - zero) / np.linalg.norm(rest.mean - zero), limit_deg

    @property
    def _is_physical(self) -> bool:
        return is_physical(self._readings[-1].accel_unit)

    def _zero(self, mean: FloatArray) -> tuple[FloatArray | None, float]:
        """Return the reading of the accelerometers in free fall, (3,), or None if it is not observable."""
        if self._is_physical:
            return np.zeros(3), TILT_DEG
        if len(self.faces) >= 5:
            return sphere_of(np.array([captured.mean for captured in self.faces.values()]))[0], TILT_DEG
        rests = np.array([*self._rests, mean])
        length = np.linalg.norm(rests, axis=1)
        along = np.abs(rests).max(axis=1) / np.where(length > 0.0, length, 1.0)
        if length.max() < ALIKE * length.min() and along.max() > math.cos(LOOSE_DEG * RADIAN_PER_DEGREE):
            return np.zeros(3), TILT_DEG
        return _fit_zero_sphere(np.array(self._cloud), rests, self._noise), LOOSE_DEG

    # ---- captured readings

    def add_face(self, face: Face, rest: Rest) -> None:
        """Capture the newest part of a rest as a face, and replace an earlier capture of this face."""
        self.faces[face] = replace(rest, start_s=max(rest.start_s, rest.stop_s - COUNTDOWN_S))
        self.saved = False

    def add_turn(self, turn: CapturedTurn) -> None:
        """Capture a turn, and replace an earlier turn about the same axis in the same direction."""
        self.turns[turn.way] = turn
        self.saved = False

    def session(self) -> Session:
        """Return the captured data as a session, with a recording for each stretch of readings without a gap."""
        if not self.faces and not self.turns:
            raise InputError("session: expected a captured face or turn, got none. Capture one first.")
        whole = joined(self._readings)
        stills, turns = self._stills(whole), list[Turn]()
        for captured in self.turns.values():
            start, stop = _samples(whole, captured.before.stop_s, captured.after.start_s)
            turns.append(replace(captured.turn, start=start, stop=stop))
            stills = [replace(still, stop=start) if still.start < start < still.stop else still for still in stills]
        gaps = [0, *(1 + np.flatnonzero(np.diff(whole.time) > _longest_s(whole))).tolist(), len(whole)]
        pieces: list[Still | Turn] = [*stills, *turns]
        spans = list[tuple[int, int]]()  # start and stop of each recording, samples
        for first, last in pairwise(gaps):
            inside = [piece for piece in pieces if first <= piece.start < last]
            if inside:
                start_s = float(whole.time[min(piece.start for piece in inside)]) - BESIDE_S
                stop_s = float(whole.time[max(piece.stop for piece in inside) - 1]) + BESIDE_S
                start, stop = _samples(whole, start_s, stop_s)
                spans.append((max(start, first), min(stop, last)))

        def placed(piece: Piece) -> Piece:
            number = next(k for k, (start, stop) in enumerate(spans) if start <= piece.start < stop)
            start = piece.start - spans[number][0]
            return replace(piece, start=start, stop=start + piece.stop - piece.start, recording=number)

        return Session(
            kind="calibration",
            serial=self.serial or whole.device,
            gravity_m_s2=self.gravity_m_s2 or STANDARD_GRAVITY,
            gravity_source="stated" if self.gravity_m_s2 else "standard",
            records=tuple(whole.part(*span) for span in spans),
            stills=tuple(map(placed, sorted(stills, key=lambda still: still.start))),
            turns=tuple(map(placed, sorted(turns, key=lambda turn: turn.start))),
        )

    def _stills(self, whole: Record) -> list[Still]:
        """Return the faces, and the parts of rests next to turns that do not belong to another rest."""
        stills = list[Still]()
        for face, captured in self.faces.items():
            start, stop = _samples(whole, captured.start_s, captured.stop_s)
            stills.append(Still(start=start, stop=stop, face=cast(Face, face)))
        for rest in (rest for turn in self.turns.values() for rest in (turn.before, turn.after)):
            start, stop = _samples(whole, rest.start_s, rest.stop_s)
            for still in stills:
                if still.start < stop and start < still.stop:
                    start, stop = (still.stop, stop) if stop > still.stop else (start, min(stop, still.start))
            if stop - start >= LEAST_REST_S * whole.sample_rate_hz:
                stills.append(Still(start=start, stop=stop))
        return stills

    def save(self, session: Session | None = None) -> None:
        """Write the captured data to the folder, for ``undrift calibrate``."""
        content = self.session() if session is None else session
        write_session(content, self.folder)
        for path in self.folder.glob("recording_*.parquet"):
            if int(path.stem.rpartition("_")[2]) >= len(content.records):
                path.unlink()
        self.saved = True


def _samples(record: Record, start_s: float, stop_s: float) -> tuple[int, int]:
    start, stop = np.searchsorted(record.time, (start_s, stop_s)).tolist()
    return start, max(stop, start + 1)


def _fit_zero_sphere(cloud: FloatArray, rests: FloatArray, noise: float) -> FloatArray | None:
    """Return the centre of a sphere through the readings of a device that was turned over all its sides.

    The readings of a shaken or knocked device form a ball with the rest inside, or lie mostly on one side.
    """
    if len(cloud) < LEAST_POINTS:
        return None
    zero, radius = sphere_of(cloud)
    length = np.linalg.norm(cloud - zero, axis=1)
    sides = (cloud - zero) / length[:, None]
    all_around = (
        np.linalg.norm(sides.mean(axis=0)) < LOPSIDED and np.linalg.eigvalsh(sides.T @ sides / len(sides))[0] > FLAT
    )
    off = np.abs(np.linalg.norm(rests - zero, axis=1) - radius)
    is_sphere = length.std() < THICK * radius and off.max() < OFF * radius
    return zero if all_around and is_sphere and radius > NOISES * noise else None


def _longest_s(record: Record) -> float:
    """Return the longest silence within a stretch of readings, s."""
    return max(GAP_S, GAP_PERIODS * float(np.median(np.diff(record.time))))
