"""Contents of a session before a fit: rests, faces, turns and temperature.

``observe`` uses the given stills of a session, or detects and labels them, and checks them (quality.py). ``at_one_temperature``
selects the pieces of one set-point, because a constant matrix applies at one temperature only.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from undrift import segments
from undrift.arrays import FloatArray
from undrift.calibration.codes import code_steps, code_variance, device_adc, restored, unknown_rounding
from undrift.calibration.plausibility import SCALE_TOLERANCE, saturated
from undrift.calibration.quality import (
    CUT_OFF_SHARE,
    SAME_TEMPERATURE_K,
    check_counted_once,
    check_stills,
    check_turns,
    mean_reading,
    piece_name,
    piece_temperatures,
    saturated_turns,
    whole_readings,
)
from undrift.calibration.settings import CalibrateSettings
from undrift.calibration.triads import check_agreement, check_force
from undrift.errors import InputError, NotObservable
from undrift.findings import Finding, finding
from undrift.fit.gls import block_size, noise_of_means, solve
from undrift.fit.triad import TriadFit
from undrift.model import AdcModel
from undrift.record import FACES, Record, Session, Still, Turn
from undrift.units import RADIAN_PER_DEGREE, is_physical, si_factor

SWEEP_THROUGH_ZERO = "Add slow turns in both directions about each axis, so that the readings pass through zero."
FULL_TURN = 2.0 * np.pi  # rad
FREE_POSES_SHARE = 0.1  # largest share of free poses among rests that count as rests on faces
CUT_OFF_S = 0.3  # a recording that turns throughout this last part is cut off
ROOM_C = 25.0
ONE_TEMPERATURE = "Record at one temperature, or fit tables over temperature with undrift drift."


# ---- mean rate over several rests
#
# m_p = m + c_p z + e_p + d_p       rest p: drift c_p with temperature, z ~ N(0, 1), noise e, scatter d between rests
#
# The variance of e_p comes from block means within the rests. Blocks of half a second reveal flicker and filters, which single
# samples do not, and blocks of an eighth of a rest reveal drift. The scatter between rests is an excess variance: the offset is
# different after each switch-on.

LONG_BLOCKS = 8  # blocks per rest


def mean_of_rests(
    windows: Sequence[FloatArray], sizes: Sequence[int], creep: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return the mean reading over rests and its variance: windows (N, 3), block sizes, c (P,) -> (3,), (3,)."""
    means = np.array([window.mean(axis=0) for window in windows])
    variances = np.array([window.var(axis=0) / max(1, len(window) - 1) for window in windows])
    long = [max(size, len(window) // LONG_BLOCKS) for window, size in zip(windows, sizes, strict=True)]
    for lengths in (sizes, long):
        if (noise := noise_of_means(windows, lengths)) is not None:
            variances = np.maximum(variances, noise**2)
    c = np.zeros(len(means)) if creep is None else creep
    ones, mean, variance = np.ones(len(means)), np.zeros(3), np.zeros(3)
    for axis in range(3):
        floor = max(1e-24 * float(np.abs(means[:, axis]).max()) ** 2, 1e-300)  # readings without noise
        sources = {"noise": np.maximum(variances[:, axis], floor), "creep": np.outer(c, c)}
        fit = solve(ones[:, None], means[:, axis], sources, excess={"rests": ones})
        mean[axis], variance[axis] = fit.theta[0], fit.covariance[0, 0]
    return mean, variance


# ---- one temperature


def at_one_temperature(session: Session) -> tuple[Session, tuple[Finding, ...]]:
    """Return a session with the pieces of one temperature.

    If stills and turns form groups more than 3 K apart, only groups with at least half as many pieces as the largest are
    considered, and the one nearest to 25 degC is used. If it lacks faces, stills of the nearest group with most faces are added.
    sources.py adds the error of their temperature.
    """
    pieces: tuple[Still | Turn, ...] = (*session.stills, *session.turns)
    temps = piece_temperatures(session, pieces)
    order = np.argsort(temps)
    separated = np.diff(temps[order]) > SAME_TEMPERATURE_K
    if np.isnan(temps).any() or not separated.any():
        return session, ()
    group = np.empty(len(temps), dtype=np.int64)
    group[order] = np.concatenate(([0], np.cumsum(separated)))
    counts = np.bincount(group)
    means = np.bincount(group, temps) / counts
    nearest = min(np.flatnonzero(2 * counts >= counts.max()), key=lambda k: abs(means[k] - ROOM_C))
    face = [piece.face if isinstance(piece, Still) else None for piece in pieces]
    faces = [len({face[n] for n in np.flatnonzero(group == k)} - {None}) for k in range(len(counts))]
    fullest = min(range(len(counts)), key=lambda k: (-faces[k], abs(means[k] - means[nearest])))
    used = group == nearest
    if faces[nearest] < faces[fullest]:
        used |= (group == fullest) & np.array([piece_face is not None for piece_face in face])
    selected = [piece for piece, use in zip(pieces, used, strict=True) if use]
    sentence = (
        f"Stills and turns form {len(counts)} groups from {means.min():.1f} to {means.max():.1f} degC. Only the {len(selected)} "
        f"pieces at {temps[used].mean():.1f} degC were used."
    )
    return replace(
        session,
        stills=tuple(piece for piece in selected if isinstance(piece, Still)),
        turns=tuple(piece for piece in selected if isinstance(piece, Turn)),
    ), (finding("session.temperature", "warn", sentence, ONE_TEMPERATURE, groups=len(counts)),)


def spans_of(records: Sequence[Record], pieces: Sequence[Still | Turn]) -> FloatArray:
    """Return start and stop of each stretch (P, 2), s, on a common clock with the recordings in sequence."""
    begins = np.concatenate(([0.0], np.cumsum([record.duration_s for record in records])))
    clocks = [begin + record.time - record.time[0] for begin, record in zip(begins[:-1], records, strict=True)]
    ends = [clocks[piece.recording][[piece.start, piece.stop - 1]] for piece in pieces]
    return np.array(ends).reshape(-1, 2)


# ---- contents of a session


@dataclass(frozen=True, kw_only=True, eq=False)
class Observed:
    """A session with its stills, given or detected."""

    session: Session
    settings: CalibrateSettings
    stills: tuple[Still, ...]  # given, otherwise detected (with a face if gravity determines it)
    found: bool  # True if the stills were detected
    findings: tuple[Finding, ...] = ()
    searches: tuple[segments.StillSearch, ...] = ()  # one for each recording if the stills were detected
    adc: AdcModel | None = None  # rounding of the converter, already corrected

    @property
    def faced(self) -> tuple[Still, ...]:
        """Return the stills with a face."""
        return tuple(still for still in self.stills if still.face is not None)

    @property
    def sorted_stills(self) -> tuple[Still, ...]:
        """Return the stills in order of time."""
        return tuple(sorted(self.stills, key=lambda still: (still.recording, still.start)))

    @property
    def mostly_faces(self) -> bool:
        """Return True if there are rests on all six faces and few other rests."""
        free = len(self.stills) - len(self.faced)
        return {still.face for still in self.faced} == set(FACES) and free <= FREE_POSES_SHARE * len(self.stills)

    def rest_rate(self, creep: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
        """Return the mean rate reading over all rests and its variance, (3,) each. ``creep`` (P,) is the drift of each rest."""
        records = self.session.records
        windows = [whole_readings(records[s.recording].gyro, s.start, s.stop) for s in self.stills]
        rests = [k for k, window in enumerate(windows) if len(window)]
        if not rests:
            return np.full(3, np.nan), np.full(3, np.nan)
        windows = [windows[k] for k in rests]
        sizes = [block_size(records[self.stills[k].recording].sample_rate_hz) for k in rests]
        mean, variance = mean_of_rests(windows, sizes, None if creep is None else creep[rests])
        # the rounding error of the offset is equal in all rests
        scatter = np.mean([window.var(axis=0) for window in windows], axis=0)
        return mean, variance + code_variance(code_steps(records, rate=True), scatter, windows)

    def mean_temperature(self) -> float:
        """Return the mean temperature over stills and turns, or NaN if it was not recorded."""
        temps = piece_temperatures(self.session, (*self.stills, *self.session.turns))
        return float(np.nanmean(temps)) if np.isfinite(temps).any() else float("nan")

    def unused_stills(self, used: Sequence[Still | Turn]) -> tuple[Still, ...]:
        """Return the stills at the fit's temperature that share no samples with a piece used by the fit, or with a turn."""
        candidates, occupied = list(self.stills), [*used, *self.session.turns]
        for number, record in enumerate(() if self.found else self.session.records):
            with suppress(InputError):  # the still is shorter than a window
                candidates += segments.find_still(record, self.settings.still, recording=number).stills
        unused: list[Still] = []
        for still in candidates:
            if not any(
                p.recording == still.recording and p.start < still.stop and still.start < p.stop for p in occupied
            ):
                unused.append(still)
                occupied.append(still)
        temps, fit_temps = piece_temperatures(self.session, unused), piece_temperatures(self.session, used)
        if self.session.kind == "thermal" and not np.isfinite(temps).all():
            return ()
        middle = float(np.nanmean(fit_temps)) if np.isfinite(fit_temps).any() else np.nan
        return tuple(
            s for s, temp_c in zip(unused, temps, strict=True) if not abs(temp_c - middle) > SAME_TEMPERATURE_K
        )

    # ---- turns between rests

    @cached_property
    def turn_searches(self) -> tuple[tuple[Record, segments.TurnSearch], ...]:
        """Return the recordings with gyroscopes, and their detected turns."""
        return tuple(
            (record, segments.find_turns(record, [s for s in self.stills if s.recording == number]))
            for number, record in enumerate(self.session.records)
            if record.gyro is not None
        )

    def plateaus(self) -> tuple[Turn, ...]:
        """Return the steady turns that the recordings contain."""
        return tuple(turn for _, search in self.turn_searches for turn in search.plateaus)

    def turns_of(self, angle: float) -> tuple[Turn, ...]:
        """Return the turns between rests by a known angle, rad, with sign and axis from the gyroscope.

        In physical units, their reading is near the known angle. In counts, full turns are the largest motions.
        """
        candidates: list[tuple[Turn, float]] = []
        for record, search in self.turn_searches:
            physical, full_turns = is_physical(record.gyro_unit), round(angle / FULL_TURN, 6).is_integer()
            factor = si_factor(record.gyro_unit, "rate") if physical else 1.0
            for turn, reading in zip(search.rotations, search.rotation_angle, strict=True):
                main_angle = factor * float(reading[np.argmax(np.abs(reading))])
                matches = abs(abs(main_angle) - angle) < SCALE_TOLERANCE * angle if physical else full_turns
                if turn.axis is not None and matches:
                    candidates.append((replace(turn, angle=float(np.copysign(angle, main_angle))), abs(main_angle)))
        most = max((size for _, size in candidates), default=0.0)
        return tuple(
            turn for turn, size in candidates if size * (1.0 + SCALE_TOLERANCE) > most * (1.0 - SCALE_TOLERANCE)
        )

    def with_turns(self) -> "Observed":
        """Return the session with its turns by the known angle. Raise, with the likely cause, if an axis has no turn."""
        angle_deg, cause = self.settings.turn_angle_deg, ""
        if angle_deg is None or self.session.turns:
            return self
        for record, search in self.turn_searches:
            check_agreement(record)
            size, last = np.linalg.norm(np.asarray(record.gyro), axis=1), round(CUT_OFF_S * record.sample_rate_hz)
            if search.rotations and size[-last:].min() > CUT_OFF_SHARE * size.max():
                cause = ": a recording still turns at its end, so that its last turn is cut off"
        turns = self.turns_of(angle_deg * RADIAN_PER_DEGREE)
        if axes := [axis for axis in ("x", "y", "z") if axis not in {turn.axis for turn in turns}]:
            raise NotObservable(
                f"turns by {angle_deg:g} deg: expected one or more about x, y and z with a rest before and after, got none about "
                f"{', '.join(axes)}{cause}. Record them and hold each pose for 3 s, or omit the angle.",
                count=len(turns),
            )
        return replace(self, session=replace(self.session, turns=turns))

    def without_saturated_turns(self) -> tuple["Observed", tuple[Finding, ...]]:
        """Return a session without turns in which a gyroscope is stuck at the end of its range, and a finding about these turns."""
        session, numbers = self.session, saturated_turns(self.session, self.settings.settle_s)
        if not numbers:
            return self, ()
        names = tuple(piece_name(session, session.turns[k], k, what="turn") for k in numbers)
        sound = tuple(turn for k, turn in enumerate(session.turns) if k not in numbers)
        omitted = saturated("turns", len(numbers), len(session.turns), names)
        return replace(self, session=replace(session, turns=sound)), (omitted,)


def look(session: Session, settings: CalibrateSettings) -> Observed:
    """Return a session with given stills, or with detected and labelled stills, without any check."""
    if session.stills:
        return Observed(session=session, settings=settings, stills=session.stills, found=False)
    searches = segments.find_poses(session.records, settings.still)
    stills = labelled(session, tuple(still for search in searches for still in search.stills))
    return Observed(session=session, settings=settings, stills=stills, found=True, searches=searches)


def observe(session: Session, settings: CalibrateSettings) -> Observed:
    """Return a session without truncation, with given or detected stills and turns. Raise if they fail the checks."""
    check_alike(session)
    check_counted_once(session.records)
    for record in session.records:
        check_force(record)
    adc = device_adc(session.records) if settings.identify_adc else None
    step = unknown_rounding(session.records) if settings.identify_adc else 0.0
    session = replace(session, records=tuple(restored(record, adc) for record in session.records))
    observed = look(session, settings)
    findings = [
        finding(
            "session.no_still",
            "warn",
            f"Recording {number} has {search.reason}.",
            "Support the device and hold each pose for 3 s or more.",
            recording=number,
        )
        for number, search in enumerate(observed.searches)
        if search.reason
    ]
    findings += check_stills(session, observed.stills, listed=not observed.found)
    findings += check_turns(session, observed.stills, settings.settle_s)
    if step:
        unit = session.records[0].gyro_unit
        sentence = (
            "It is not known whether the codes of the gyroscope are truncated toward zero. If they are, the offset in motion "
            f"differs from the offset at rest by half a step ({step / 2.0:.3g} {unit}), and the pitch after a minute of motion "
            "can exceed its limit."
        )
        findings.append(finding("session.rounding_unknown", "info", sentence, SWEEP_THROUGH_ZERO, step=step))
    return replace(observed, findings=tuple(findings), adc=adc).with_turns()


def check_alike(session: Session) -> None:
    """Raise unless all recordings have the same triads in the same units."""
    for triad in ("gyro", "accel"):
        units = {getattr(r, f"{triad}_unit") if getattr(r, triad) is not None else "none" for r in session.records}
        if len(units) > 1:
            raise InputError(
                f"{triad}: all recordings of a session need readings in one unit, got {', '.join(sorted(units))}. Map the columns "
                "of all recordings alike, or calibrate the recordings separately."
            )


def labelled(session: Session, stills: tuple[Still, ...]) -> tuple[Still, ...]:
    """Return stills with the face that points up, if gravity determines it."""
    physical = is_physical(session.records[0].accel_unit)
    with_force = [still for still in stills if session.records[still.recording].accel is not None]
    if not with_force or (not physical and len(with_force) < 5):
        return stills  # the zero of counts is unknown unless the poses lie on a common sphere
    means = [mean_reading(session.records[s.recording].accel, s.start, s.stop) for s in with_force]
    faces = dict(zip(with_force, segments.faces_of(np.array(means), centred=physical), strict=True))
    return tuple(replace(still, face=faces.get(still)) for still in stills)


def with_offset(fit: TriadFit, offset: FloatArray, variance: FloatArray) -> TriadFit:
    """Return a fit to readings with their offset, from a fit without it. Offset and variance (3,) are in the unit of the
    readings."""
    covariance = np.array(fit.model.covariance)
    covariance[9:12, 9:12] = np.diag(variance)
    return replace(fit, model=replace(fit.model, offset=offset, covariance=covariance, budget=None))
