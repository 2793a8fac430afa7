"""Capture the readings of a guided session. Detect rests and the face that is up, and write the session's folder.

A device is at rest if `find_still` accepts its newest readings twice: with the threshold from the readings, and within
four noise floors of the quietest window. In counts, the limits are shares of gravity. The face that is up is the axis
with the largest share of the mean acceleration. Readings in counts have an unknown zero. With five captured faces, the
zero is the centre of a sphere through them. Before that, it is 0 if all rests have similar lengths and in one of them a
single axis reads nearly all, as for digital parts. Otherwise it is the centre of a sphere through the readings from
turning the device over all its sides. Only relative lengths are used, so that no scale is needed.
"""

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError
from undrift.io.session import write_session
from undrift.record import FACES, Face, Record, Session, Still, Turn, joined
from undrift.segments import BENCH_ACCEL_LIMIT, StillSettings, find_still, sample_count, sliding_moments, sphere_of
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, is_physical

State = Literal["no readings", "moving", "settling", "still", "captured", "wrong face", "tilted", "unknown face"]
COUNTDOWN_S, SETTLE_S = 6.0, 1.5  # rest that is captured, and rest before that
TILT_DEG = 12.0  # largest tilt of a face, as the uncalibrated accelerometers read it
SILENCE_S = 1.0  # host time without a new reading that counts as none
GAP_S, GAP_PERIODS = 0.1, 5.0  # a longer silence of the device ends a stretch of readings
KEEP_S = 120.0  # of readings in which nothing is captured
BESIDE_S = 10.0  # kept before the first piece of a stretch, and behind the last
CLOUD_S, CLOUD_POINTS = 0.25, 2000  # means of the accelerometers that show their zero
ALIKE = 1.6  # lengths of readings that share a zero of 0, within 0.2 g
# of a cloud that shows a sphere: points, radius over noise, length of their mean side, least mean square of a side, spread of the
# points about it and distance of rests from it as shares of the radius (triads differ in scale by tens of percent)
LEAST_POINTS, NOISES, LOPSIDED, FLAT, THICK, OFF = 24, 10.0, 0.55, 0.05, 0.25, 0.5
LOOSE_DEG = 25.0  # tilt that exceeds an error of the zero, of readings in counts
LEAST_REST_S = 1.0
UNKNOWN = "Which face is up is not known yet. Turn the device over all its sides once."


@dataclass(frozen=True, slots=True, kw_only=True)
class Light:
    """The current state of the device, as shown to the user."""

    state: State
    text: str  # Why, and what to do
    face: Face | None = None  # That is up now
    left_s: float | None = None  # Until the capture, while it counts down


@dataclass(frozen=True, slots=True, kw_only=True)
class CapturedSpan:
    """A stretch of time in which something was captured."""

    stretch: int  # Number of the stretch of readings
    start_s: float  # On the device's clock
    stop_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class CapturedFace(CapturedSpan):
    """A rest with a face up."""

    face: Face
    mean: tuple[float, float, float]  # mean of the accelerometers, raw


@dataclass(frozen=True, slots=True, kw_only=True)
class CapturedTurn(CapturedSpan):
    """A turn between two rests."""

    turn: Turn  # axis and angle; its samples are determined again when it is written
    before: CapturedSpan
    after: CapturedSpan
    reading: float  # Integral about the axis, raw unit times s


@dataclass(frozen=True, slots=True, kw_only=True)
class Rest:
    """A rest that lasts until the newest reading."""

    start_s: float  # On the device's clock
    stop_s: float
    mean: FloatArray  # (3,), of the accelerometers, raw

    @property
    def duration_s(self) -> float:
        """Return the duration, s."""
        return self.stop_s - self.start_s


@dataclass(slots=True)
class _Stretch:
    number: int
    parts: list[Record] = field(default_factory=list)

    def record(self, start_s: float = -math.inf, stop_s: float = math.inf) -> Record:
        """Return its readings in a span of time."""
        stretch = joined([chunk for chunk in self.parts if chunk.time[-1] >= start_s and chunk.time[0] < stop_s])
        first, last = np.searchsorted(stretch.time, (start_s, stop_s)).tolist()
        return stretch.part(first, last)


class Capture:
    """The data of a guided session: readings, faces, turns and the folder."""

    def __init__(self, folder: Path, serial: str = "", *, gravity_m_s2: float | None = None) -> None:
        self.folder, self.serial, self.gravity_m_s2 = folder, serial, gravity_m_s2
        self.faces: dict[Face, CapturedFace] = {}
        self.turns: list[CapturedTurn] = []
        self.saved = False  # True if the folder contains all captured data
        self._stretches: list[_Stretch] = []
        self._key: object = None
        self._heard_s = -math.inf  # host time of the newest reading
        self.newest_s = -math.inf  # its time on the device's clock
        self._cloud: deque[FloatArray] = deque(maxlen=CLOUD_POINTS)
        self._rests: deque[FloatArray] = deque(maxlen=64)
        self._noise = self._extent = (
            0.0  # raw: noise of the accelerometers at rest, and longest side of the cloud of readings
        )

    # ---- Readings

    def take(self, record: Record | None, now_s: float, key: object = None) -> None:
        """Add the newest readings, which may overlap earlier ones: now_s on the host's clock, key of the connection."""
        if record is None:
            return
        if record.accel is None or record.gyro is None:
            raise InputError(
                "capture: gyroscope and accelerometer are both required, but one is missing. Name both in the device's address."
            )
        latest = self._stretches[-1].parts[-1] if self._stretches else record
        if (latest.gyro_unit, latest.accel_unit) != (record.gyro_unit, record.accel_unit):
            raise InputError(
                f"capture: expected readings in {latest.accel_unit}, got {record.accel_unit}. Start a new session."
            )
        if key is not self._key or record.time[-1] < self.newest_s:  # another connection, whose clock is its own
            self._key, self.newest_s = key, -math.inf
        longest_s, first = _longest_s(record), int(np.searchsorted(record.time, self.newest_s, side="right"))
        ends = [*(first + 1 + np.flatnonzero(np.diff(record.time[first:]) > longest_s)).tolist(), len(record)]
        for stop in ends:
            if stop - first >= 2:  # a single reading waits for the next
                if record.time[first] - self.newest_s > longest_s:
                    self._stretches.append(_Stretch(self._stretches[-1].number + 1 if self._stretches else 0))
                self._keep(record.part(first, stop), max(1, round(CLOUD_S * record.sample_rate_hz)))
                self._heard_s, self.newest_s = now_s, float(record.time[stop - 1])
            first = stop
        if self._stretches:
            self._forget()

    def _keep(self, chunk: Record, step: int) -> None:
        self._stretches[-1].parts.append(chunk)
        for first in range(0, len(chunk), step):
            mean = np.asarray(chunk.accel)[first : first + step].mean(axis=0)
            moved = not self._cloud or np.linalg.norm(mean - self._cloud[-1]) > 0.02 * self._extent
            if moved and np.isfinite(mean).all():
                self._cloud.append(mean)
                self._extent = float(np.ptp(np.array(self._cloud), axis=0).max())

    def _forget(self) -> None:
        """Drop readings in which nothing was captured for long."""
        now = self._stretches[-1]
        pieces = {piece.stretch for piece in self._pieces()}
        self._stretches = [stretch for stretch in self._stretches if stretch is now or stretch.number in pieces]
        last = max((piece.stop_s for piece in self._pieces() if piece.stretch == now.number), default=-math.inf)
        newest = float(now.parts[-1].time[-1])
        if newest - max(last, float(now.parts[0].time[0])) < 2.0 * KEEP_S:
            return
        fresh = _Stretch(now.number + 1, [chunk for chunk in now.parts if chunk.time[-1] > newest - KEEP_S])
        now.parts = [chunk for chunk in now.parts if chunk.time[0] < last + BESIDE_S]
        self._stretches = [*(self._stretches if now.parts else self._stretches[:-1]), fresh]

    def _pieces(self) -> Iterator[CapturedSpan]:
        yield from self.faces.values()
        yield from self.turns

    @property
    def stretch(self) -> int:
        """Return the number of the stretch of the newest readings."""
        return self._stretches[-1].number if self._stretches else -1

    def tail(self, seconds: float) -> Record | None:
        """Return the newest readings since the last gap. Single lost readings are left out."""
        return _drop_lost_rows(self._stretches[-1].record(self.newest_s - seconds)) if self._stretches else None

    def lost(self, start_s: float, stop_s: float) -> bool:
        """Return True if a reading of the newest stretch was lost in a span of time."""
        return bool(np.isnan(np.asarray(self._stretches[-1].record(start_s, stop_s).gyro)).any())

    # ---- Rest and face

    def silent(self, now_s: float) -> bool:
        """Return True if no readings have come recently."""
        return now_s - self._heard_s > SILENCE_S

    def rest(self, seconds: float | None = None) -> Rest | None:
        """Return the current rest. Return None while the device moves, or if there are too few readings."""
        record = self.tail(2.0 * (COUNTDOWN_S + SETTLE_S) if seconds is None else seconds)
        if record is None:
            return None
        start, stop = 0, len(record)
        try:
            for still in (StillSettings(threshold_floors=4.0), StillSettings()):  # the quicker one first
                stills = find_still(record, still).stills
                if not stills or stills[-1].stop != stop:
                    return None
                start = max(start, stills[-1].start)
        except InputError:  # shorter than a window
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
        """Return True if readings in counts vary by more than a bench allows, as shares of gravity. `find_still` judges
        physical readings.
        """
        zero = None if is_physical(self._stretches[-1].parts[-1].accel_unit) else self._zero(mean)[0]
        if zero is None:
            return False
        usual, length = StillSettings(), float(np.linalg.norm(mean - zero))
        smooth = max(1, round(usual.smooth_s * sample_rate_hz))
        _, spread = sliding_moments(
            accel, min(sample_count(usual.window_s, sample_rate_hz), len(accel) - smooth + 1), smooth
        )
        return bool(spread.max() > BENCH_ACCEL_LIMIT / STANDARD_GRAVITY * length)

    def face_of(self, rest: Rest) -> tuple[Face | None, float]:
        """Return the face that is up in a rest, None where nothing shows it, and how far it is tilted beyond the limit, deg."""
        up, limit_deg = self.up(rest)
        if up is None:
            return None, 0.0
        axis = int(np.abs(up).argmax())
        tilt_deg = math.acos(min(1.0, abs(float(up[axis])))) / RADIAN_PER_DEGREE
        return FACES[2 * axis + (up[axis] < 0.0)], tilt_deg if tilt_deg > limit_deg else 0.0

    def up(self, rest: Rest) -> tuple[FloatArray | None, float]:
        """Return the direction of gravity in a rest, (3,), and the tilt that exceeds an error of it, deg."""
        zero, limit_deg = self._zero(rest.mean)
        return None if zero is None else (rest.mean - zero) / np.linalg.norm(rest.mean - zero), limit_deg

    def _zero(self, mean: FloatArray) -> tuple[FloatArray | None, float]:
        """Return the reading of the accelerometers in free fall, (3,), or None if it is not observable."""
        if is_physical(self._stretches[-1].parts[-1].accel_unit):
            return np.zeros(3), TILT_DEG
        if len(self.faces) >= 5:
            return sphere_of(np.array([captured.mean for captured in self.faces.values()]))[0], TILT_DEG
        rests = np.array([*self._rests, mean])
        length = np.linalg.norm(rests, axis=1)
        along = np.abs(rests).max(axis=1) / np.where(length > 0.0, length, 1.0)
        if length.max() < ALIKE * length.min() and along.max() > math.cos(LOOSE_DEG * RADIAN_PER_DEGREE):
            return np.zeros(3), TILT_DEG
        return _fit_zero_sphere(np.array(self._cloud), rests, self._noise), LOOSE_DEG

    # ---- What is captured

    def add_face(self, face: Face, rest: Rest) -> None:
        """Capture the newest of a rest as a face, in place of the one before."""
        start_s, (x, y, z) = max(rest.start_s, rest.stop_s - COUNTDOWN_S), rest.mean.tolist()
        captured = CapturedFace(stretch=self.stretch, start_s=start_s, stop_s=rest.stop_s, face=face, mean=(x, y, z))
        self.faces = {**self.faces, face: captured}
        self.saved = False

    def add_turn(self, turn: CapturedTurn) -> None:
        """Capture a turn, in place of an earlier turn about the same axis in the same direction."""
        same = [other for other in self.turns if way_of(other) == way_of(turn)]
        self.turns = [*(other for other in self.turns if other not in same), turn]
        self.saved = False

    def session(self) -> Session:
        """Return the captured data as a session."""
        pieces = list(self._pieces())
        used = [stretch for stretch in self._stretches if any(piece.stretch == stretch.number for piece in pieces)]
        if not used:
            raise InputError("session: expected a captured face or turn, got none. Capture one first.")
        records, number = list[Record](), dict[int, int]()
        for stretch in used:
            captures = [piece for piece in pieces if piece.stretch == stretch.number]
            starts = [p.before.start_s if isinstance(p, CapturedTurn) else p.start_s for p in captures]
            stops = [p.after.stop_s if isinstance(p, CapturedTurn) else p.stop_s for p in captures]
            number[stretch.number] = len(records)
            records.append(stretch.record(min(starts) - BESIDE_S, max(stops) + BESIDE_S))

        def samples(piece: CapturedSpan) -> tuple[int, int]:
            time = records[number[piece.stretch]].time
            start, stop = np.searchsorted(time, (piece.start_s, piece.stop_s)).tolist()
            return start, max(stop, start + 1)

        stills = [
            Still(start=start, stop=stop, face=captured.face, recording=number[captured.stretch])
            for captured in self.faces.values()
            for start, stop in [samples(captured)]
        ]
        for piece in (rest for captured in self.turns for rest in (captured.before, captured.after)):
            start, stop = samples(piece)
            at = number[piece.stretch]
            for still in stills:  # a rest between two turns counts once, and readings of a face belong to the face
                if still.recording == at and still.start < stop and start < still.stop:
                    start, stop = (still.stop, stop) if stop > still.stop else (start, min(stop, still.start))
            if stop - start >= LEAST_REST_S * records[at].sample_rate_hz:
                stills.append(Still(start=start, stop=stop, recording=at))
        turns = []
        for captured in self.turns:
            start, stop = samples(captured)
            turns.append(replace(captured.turn, start=start, stop=stop, recording=number[captured.stretch]))
        for turn in turns:
            stills = [
                replace(still, stop=turn.start)
                if still.recording == turn.recording and still.start < turn.start < still.stop
                else still
                for still in stills
            ]
        return Session(
            kind="calibration",
            serial=self.serial or records[0].device,
            gravity_m_s2=self.gravity_m_s2 or STANDARD_GRAVITY,
            gravity_source="stated" if self.gravity_m_s2 else "standard",
            records=tuple(records),
            stills=tuple(sorted(stills, key=lambda still: (still.recording, still.start))),
            turns=tuple(sorted(turns, key=lambda turn: (turn.recording, turn.start))),
        )

    def save(self, session: Session | None = None) -> None:
        """Write the captured data to the folder, for ``undrift calibrate``."""
        content = self.session() if session is None else session
        write_session(content, self.folder)
        for path in self.folder.glob("recording_*.parquet"):
            if int(path.stem.rpartition("_")[2]) >= len(content.records):
                path.unlink()
        self.saved = True


def _fit_zero_sphere(cloud: FloatArray, rests: FloatArray, noise: float) -> FloatArray | None:
    """Return the centre of the sphere that the readings of a device lie on that was turned over all its sides.

    A device that was shaken or knocked leaves a ball of points with its rest inside, or most of them on one side.
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


def _drop_lost_rows(record: Record) -> Record | None:
    """Return a record without lost rows, from the last longer loss on, or None if all rows were lost."""
    at = np.flatnonzero(~np.isnan(np.column_stack((record.gyro, record.accel))).any(axis=1))  # type: ignore[arg-type]
    if len(at) == len(record) or len(at) < 2:
        return record if len(at) else None
    at = at[max(np.flatnonzero(np.diff(record.time[at]) > _longest_s(record)), default=-1) + 1 :]
    if len(at) < 2:
        return None
    gyro, accel = np.asarray(record.gyro)[at], np.asarray(record.accel)[at]
    return replace(record, time=record.time[at], gyro=gyro, accel=accel, temp_c=None, mag_ut=None)


def way_of(captured: CapturedTurn) -> str:
    """Return which turn it is: ``+x`` for one about x by a positive angle."""
    return f"{'+' if (captured.turn.angle or 0.0) > 0.0 else '-'}{captured.turn.axis}"
