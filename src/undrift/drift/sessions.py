"""Sessions made ready for the drift fits: each reading once, in the calibration's units, codes restored, one switch-on a session.

A session in several recordings whose clock runs on from one to the next was switched on once, when the first began; a clock that
begins anew is another switch-on.

The fit takes sessions as independent. A copy of one would halve the variance and add a second switch-on; so would one log whose
rows were dealt out to two files. Those are known by their readings: between two rows of the one, the other lies in the middle but
for noise, in every channel, stretch by stretch. Two switch-ons differ in temperature, pose or offset by more than that.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import chain, product

import numpy as np

from undrift.arrays import BoolArray, FloatArray
from undrift.calibration.adc import restored
from undrift.drift.observe import RestBlocks
from undrift.drift.temperature import Temperature
from undrift.drift.thermometer_lag import without_lag, without_lag_smooth
from undrift.errors import InputError, NotObservable
from undrift.findings import finding
from undrift.model import Calibration, TriadModel, Verdict
from undrift.record import Record, Session
from undrift.units import RADIAN_PER_DEGREE, SI_UNIT, Quantity, is_physical, si_factor

_STRAY = 6.0  # standard deviations of a reading: further from the smooth course is a stray
_LEAST_NOISE_C = 0.05
_RESTLESS = 0.5 * RADIAN_PER_DEGREE  # rad/s, standard uncertainty of the mean of a block
_RUN = 16  # equal rows one after another: noise does not make them
_DISTINCT = 8  # of them: a stuck or coarse sensor repeats itself
_STRETCH = 64  # rows, over whose mean noise is small beside what two switch-ons differ by
_HOLE = 8.0  # steps: rows beyond are not between two of the other
_LIKE_NOISE = 2.0  # mean square of the stretches' means over that of noise
_SIGNIFICANT = 5.0  # standard deviations of the mean over all
_GAP_S = 60.0  # a clock that runs on after a longer pause is taken as another switch-on


def in_units_of(session: Session, calibration: Calibration) -> Session:
    """Return a session in the units that a calibration reads, with the half steps of truncated codes put back."""
    return replace(
        session, records=tuple(_prepared(record, k, calibration) for k, record in enumerate(session.records))
    )


def _prepared(record: Record, number: int, calibration: Calibration) -> Record:
    if record.state == "corrected":
        raise InputError(
            f"recording {number}: wanted raw readings, got a corrected record; a table is subtracted from the device's own readings"
        )
    units = {}
    for sensor, model in (("gyro", calibration.gyro), ("accel", calibration.accel)):
        unit = units[f"{sensor}_unit"] = getattr(record, f"{sensor}_unit")
        if getattr(record, sensor) is None or model is None or unit == model.unit_in:
            continue
        if not (is_physical(unit) and is_physical(model.unit_in)):
            raise InputError(
                f"recording {number}: wanted {sensor} readings in {model.unit_in}, the unit of the calibration, got {unit}; record "
                "as for the calibration, or calibrate in this unit"
            )
        units[f"{sensor}_unit"] = model.unit_in
    if units != {"gyro_unit": record.gyro_unit, "accel_unit": record.accel_unit}:
        record = replace(record.in_units(*units.values()), **units)
    return restored(record, calibration.adc)


def nominal_models(sessions: Sequence[Session]) -> Calibration:
    """Return a calibration that keeps the scale that the readings' units state, and knows no offset."""
    first = sessions[0]
    unit = next((r.gyro_unit for s in sessions for r in s.records if r.gyro is not None), None)
    if unit is None or not is_physical(unit):
        raise NotObservable(
            f"drift: wanted a calibration, or gyroscope readings in a physical unit, got {unit or 'none'}; give "
            "--calibration, or the scale of the columns"
        )
    return Calibration(
        device=first.serial or first.records[0].device,
        reference_temp_c=float("nan"),
        gravity_m_s2=first.gravity_m_s2,
        gyro=nominal_triad(unit, "rate"),
        verdict=Verdict(status="marginal", findings=(finding("calibration.nominal", "warn"),)),
        file_map=first.file_map,
    )


def nominal_triad(unit: str, quantity: Quantity) -> TriadModel:
    """Return the model of sensors that are what their unit says."""
    return TriadModel(
        method="nominal",
        unit_in=unit,
        unit_out=SI_UNIT[quantity],
        matrix=np.eye(3) * si_factor(unit, quantity),
        offset=np.zeros(3),
        covariance=np.zeros((12, 12)),
        rms_residual=0.0,
        count=0,
        rank=0,
        condition=1.0,
        valid_range=(-np.inf, np.inf),
    )


def accel_unit_of(sessions: Sequence[Session], device: Calibration) -> str:
    """Return the unit of the accelerometers' readings."""
    if device.accel is not None:
        return device.accel.unit_in
    units = {record.accel_unit for session in sessions for record in session.records if record.accel is not None}
    return units.pop() if len(units) == 1 else "count"


def since_power_on(rests: RestBlocks, sessions: Sequence[Session]) -> RestBlocks:
    """Return the blocks with the time since their device was switched on, not since their recording began."""
    power_on_s = rests.power_on_s.copy()
    for number, session in enumerate(sessions):
        rows = np.flatnonzero(rests.session == number)
        power_on_s[rows] += _ages(session.records)[
            np.searchsorted(session.begins_s, rests.time[rows], side="right") - 1
        ]
    return replace(rests, power_on_s=power_on_s)


def _ages(records: Sequence[Record]) -> FloatArray:
    """Return how long before each record its device was switched on, s."""
    ages, first = np.zeros(len(records)), records[0].time[0]
    for k in range(1, len(records)):
        if records[k].time[0] <= records[k - 1].time[-1]:
            first = records[k].time[0]
        ages[k] = records[k].time[0] - first
    return ages


def check_at_rest(rests: RestBlocks, device: Calibration) -> None:
    """Refuse blocks of rest in which the device moved all the time: a log that never lies still looks even throughout."""
    if device.gyro is None or not np.isfinite(rests.gyro_variance).any():
        return
    factor = si_factor(device.gyro.unit_out, "rate") / device.gyro.scale_factor
    known = np.sqrt(np.nanmedian(rests.gyro_variance, axis=0)) * factor
    if np.nanmax(known) > _RESTLESS:
        dps = float(np.nanmax(known)) / RADIAN_PER_DEGREE
        raise NotObservable(
            f"rests: wanted stretches at rest, got none: readings move so much that the mean of ten seconds is known to {dps:.2g} "
            "deg/s only; leave the device still while its temperature changes",
            deg_per_s=dps,
        )


def sensor_course(trusted: Sequence[Temperature], session: Session, lag_s: float) -> list[FloatArray]:
    """Return the temperature of the sensors in each recording: the thermometer's lag taken off where a thermometer was read."""
    return [
        t.temp_c if t.source != "column" else without_lag_smooth(t.temp_c, record.time, lag_s=lag_s)
        for t, record in zip(trusted, session.records, strict=True)
    ]


def met_in_use(
    sessions: Sequence[Session],
    trusted: Sequence[Sequence[Temperature]],
    course: Sequence[Sequence[FloatArray]],
    lag_s: float,
    smooth_s: float,
) -> list[FloatArray]:
    """Return the extremes, (2,) degC each, that ``correct`` would look up: readings are noisier than their smooth course."""
    ends: list[FloatArray] = []
    for session, own, smooth in zip(sessions, trusted, course, strict=True):
        for record, found, settled in zip(session.records, own, smooth, strict=True):
            if record.temp_c is None or found.source != "column":
                continue
            met, gain = record.temp_c, 1.0
            if lag_s > 0.0:
                met, gain = without_lag(met, record.time, lag_s=lag_s, smooth_s=smooth_s)[0], lag_s / smooth_s
            far = _STRAY * gain * max(found.noise_c, found.step_c, _LEAST_NOISE_C)
            near = met[np.abs(met - settled) <= far]  # a gap is near nothing
            if len(near):
                ends.append(np.array([near.min(), near.max()]))
    return ends


# ---- recordings cut from one switch-on are put together


def one_power_on(sessions: Sequence[Session]) -> list[Session]:
    """Put recordings together whose clock runs on from one to the next: the device was not switched off between them."""
    chains: list[list[int]] = []
    for k in sorted(range(len(sessions)), key=lambda k: (sessions[k].records[0].time[0], k)):
        before = [chain for chain in chains if _continues(sessions[chain[-1]], sessions[k])]
        if before:
            max(before, key=lambda chain: sessions[chain[-1]].records[-1].time[-1]).append(k)
        else:
            chains.append([k])
    return [
        replace(
            sessions[group[0]],
            records=tuple(record for k in group for record in sessions[k].records),
            inputs=tuple(named for k in group for named in sessions[k].inputs),
        )
        for group in sorted(chains, key=min)
    ]


def _continues(earlier: Session, later: Session) -> bool:
    pause = later.records[0].time[0] - earlier.records[-1].time[-1]
    return bool(0.0 < pause <= _GAP_S and earlier.serial == later.serial)


# ---- data given twice are refused


def check_once(sessions: Sequence[Session]) -> None:
    """Refuse data that were given twice."""
    first: dict[str, str] = {}
    for number, session in enumerate(sessions):
        names = {digest: _called(number, name) for name, digest in _files(session)}
        for digest, here in names.items():
            if digest in first:
                raise _twice(first[digest], here, "the same file")
        first |= names
    records = [
        [(_called(number, _name(session, k)), record) for k, record in enumerate(session.records)]
        for number, session in enumerate(sessions)
    ]
    for b in range(1, len(sessions)):
        for ours, theirs in product(chain.from_iterable(records[:b]), records[b]):
            _check_pair(*ours, *theirs)


def _check_pair(name: str, one: Record, other_name: str, other: Record) -> None:
    if equal := _same_readings(one, other):
        raise _twice(name, other_name, equal)
    if _dealt_out(one, other):
        raise InputError(
            f"drift: wanted one recording for each switch-on, got rows of one log in turn in {name} and {other_name}: "
            "between the times of one lie those of the other, with the same course; put them into one file by time, or "
            "leave one out"
        )


def _same_readings(one: Record, other: Record) -> str:
    """Return what is equal in two records; nothing where they differ."""
    if (one.gyro is None) != (other.gyro is None) or (one.accel is None) != (other.accel is None):
        return ""
    ours, theirs = _rows(one), _rows(other)
    if len(ours) == len(theirs) >= _RUN and np.array_equal(ours, theirs, equal_nan=True) and _varies(ours):
        return f"all {len(ours)} readings are equal"
    if one.time[0] > other.time[-1] or other.time[0] > one.time[-1]:
        return ""
    _, at, there = np.intersect1d(one.time, other.time, assume_unique=True, return_indices=True)
    equal: BoolArray = (ours[at] == theirs[there]).all(axis=1)
    edges = np.flatnonzero(np.diff(np.concatenate(([False], equal, [False])).astype(np.int8)))
    for start, stop in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        if stop - start >= _RUN and _varies(ours[at[start:stop]]):
            return f"{stop - start} readings one after another are equal, from {one.time[at[start]]:g} s on"
    return ""


def _dealt_out(one: Record, other: Record) -> bool:
    """Whether two records are rows of one log: their times interleave, and each goes where the other goes."""
    if (one.gyro is None) != (other.gyro is None) or (one.accel is None) != (other.accel is None):
        return False
    ours, theirs = (_rows(r) if r.temp_c is None else np.column_stack((_rows(r), r.temp_c)) for r in (one, other))
    here = np.flatnonzero((other.time > one.time[0]) & (other.time < one.time[-1]))
    if len(here) < 2 * _STRETCH or ours.shape[1] != theirs.shape[1]:
        return False
    after = np.searchsorted(one.time, other.time[here])
    step = one.time[after] - one.time[after - 1]
    between = (one.time[after] > other.time[here]) & (step <= _HOLE * float(np.median(np.diff(other.time))))
    if between.mean() < 0.9:  # the same times, or holes
        return False
    here, after = here[between], after[between]
    share = ((other.time[here] - one.time[after - 1]) / step[between])[:, None]
    off = theirs[here] - (1.0 - share) * ours[after - 1] - share * ours[after]
    known = np.isfinite(off).all(axis=1)
    off, after = off[known], after[known]
    count = len(off) // _STRETCH
    varies = np.ptp(off, axis=0) > 0.0 if len(off) else np.zeros(0, bool)
    if count < 2 or not varies.any():
        return False
    means = off[: count * _STRETCH].reshape(count, _STRETCH, -1).mean(axis=1)
    rows = np.array([len(np.unique(part)) for part in np.split(after[: count * _STRETCH], count)])
    # White noise s2 in both: s2 (1 + 2/3) in a difference, s2 / n + s2 / m in the mean over n rows of one and m of the other.
    expected = (off.var(axis=0) / (1.0 + 2.0 / 3.0)) * (1.0 / _STRETCH + 1.0 / rows)[:, None]
    like = (means**2).mean(axis=0) <= _LIKE_NOISE * expected.mean(axis=0)
    even = np.abs(means.mean(axis=0)) <= _SIGNIFICANT * np.sqrt(expected.mean(axis=0) / count)
    return bool((like & even).all())


def _varies(rows: FloatArray) -> bool:
    """Whether 16 rows one after another hold 8 different ones, somewhere; looked at from 8 rows to 8 rows."""
    starts = range(0, len(rows) - _RUN + 1, _DISTINCT)
    return any(len(np.unique(rows[k : k + _RUN], axis=0)) >= _DISTINCT for k in starts)


def _rows(record: Record) -> FloatArray:
    return np.column_stack([part for part in (record.gyro, record.accel) if part is not None])


def _files(session: Session) -> list[tuple[str, str]]:
    """Return name and sha256 of the recordings; what describes a session may well be equal in two."""
    return [(name, digest) for name, digest in session.inputs if not name.endswith(".toml")]


def _name(session: Session, recording: int) -> str:
    files = _files(session)
    return files[recording][0] if len(files) == len(session.records) else f"recording {recording}"


def _called(session: int, name: str) -> str:
    return f"session {session + 1} ({name})"


def _twice(one: str, other: str, what: str) -> InputError:
    return InputError(
        f"drift: wanted every reading once, got the same data in {one} and {other}: {what}; leave one out, as twice the same "
        "would only make the uncertainty too small"
    )
