"""Which gyroscope fit a session allows, in this order.

rate-table       turns with an achieved rate about x, y and z
known-rotation   turns with an angle, or three full turns found between rests
multi-position   moves between nine still phases or more
rest             the offset alone, where the unit is physical
"""

from dataclasses import replace
from typing import Literal

import numpy as np

from undrift.calibration.fit.dwells import DwellSettings, dwell_means, middles
from undrift.calibration.fit.gravity_turns import check_turns_gravity
from undrift.calibration.fit.known_rotation import KnownRotationSettings, fit_known_rotation, rotation_data
from undrift.calibration.fit.noise import block_size, noise_of_means
from undrift.calibration.fit.rate_axes import fit_rate_axes, scale_verdict, told_axis
from undrift.calibration.fit.rate_outlier import check_dwells
from undrift.calibration.fit.rate_rests import RestMeans, fit_with_rests
from undrift.calibration.fit.rate_table import RateTableSettings, fit_rate_table, imposed_rates
from undrift.calibration.fit.result import TriadFit
from undrift.calibration.model import TriadModel, Verdict
from undrift.calibration.observed import Observed
from undrift.calibration.outcome import Outcome, with_offset
from undrift.errors import CalibrationError, NotObservable
from undrift.session import Turn
from undrift.units import RADIAN_PER_DEGREE, is_physical, si_factor

_LEAST_STILLS = 9

GyroMethod = Literal["rate-table", "known-rotation", "multi-position", "rest"]


def calibrate_gyro(seen: Observed, method: GyroMethod | None, *, paper: bool, accel: TriadFit | None) -> Outcome:
    """Fit the gyroscopes by the method asked for, or by the best that the session allows.

    Parameters
    ----------
    seen : Observed
        Session, stills and turns.
    method : str or None
        rate-table, known-rotation, multi-position or rest; None chooses.
    paper : bool
        True for the note's equations and the closed form.
    accel : TriadFit or None
        Accelerometer of the same session; turns by hand need it.

    Returns
    -------
    Outcome
        Fit, or the reasons why there is none.

    Raises
    ------
    NotObservable
        A method that was asked for lacks its recordings.
    """
    if all(r.gyro is None for r in seen.session.records):
        if method is not None:
            raise NotObservable(f"gyroscope by {method}: wanted gyroscope readings, got none; map their columns")
        return Outcome()
    if method is not None:
        outcome = _by(method, seen, paper, accel)
        if outcome.fit is None:
            raise NotObservable(f"gyroscope by {method}: " + "; ".join(outcome.reasons))
        return _held_to_unit(outcome)
    return _held_to_unit(_chosen(seen, paper, accel))


def _held_to_unit(outcome: Outcome) -> Outcome:
    if outcome.fit is None:
        return outcome
    model = outcome.fit.model
    verdict = outcome.fit.verdict.also(scale_verdict(model.scale_factor, model.unit_in))
    return replace(outcome, fit=replace(outcome.fit, verdict=verdict))


def _by(method: GyroMethod, seen: Observed, paper: bool, accel: TriadFit | None) -> Outcome:
    if method == "rate-table":
        return _rate_table(seen, paper, accel)
    if method == "known-rotation":
        return _known_rotation(seen, paper, accel)
    return _multi_position(seen) if method == "multi-position" else _rest(seen)


def _chosen(seen: Observed, paper: bool, accel: TriadFit | None) -> Outcome:
    rated = sorted({t.axis or "?" for t in seen.session.turns if t.turn_rate is not None})
    angled = any(t.angle is not None for t in seen.session.turns)
    said: list[str] = []
    if rated:
        outcome = _rate_table(seen, paper, accel)
        if outcome.fit is not None:
            return outcome
        said.extend(outcome.reasons)
    elif angled or seen.full_turns():
        outcome = _known_rotation(seen, paper, accel)
        if outcome.fit is not None:
            return outcome
        said.extend(outcome.reasons)
    else:
        plateaus = seen.plateaus()
        if len(seen.stills) >= _LEAST_STILLS:
            outcome = _multi_position(seen) if not plateaus else _despite_plateaus(seen)
            if outcome.fit is not None:
                return outcome
            said.extend(outcome.reasons if not plateaus else ())
        if plateaus:
            said.append(
                f"gyroscope: {plateaus} steady turns were found; state the turn_rate_dps and axis of each to use them"
            )
    return _rest(seen).after(*said)


def _rate_table(seen: Observed, paper: bool, accel: TriadFit | None) -> Outcome:
    settings = RateTableSettings(
        mode="paper" if paper else "affine",
        latitude_deg=seen.settings.latitude_deg,
        scale_tolerance=seen.settings.scale_tolerance,
    )
    dwells = dwell_means(seen.session.records, seen.session.turns, DwellSettings(settle_s=seen.settings.settle_s))
    stated = sorted(set(dwells.axis))
    if 0 < len(stated) < 3:
        shown = fit_rate_axes(dwells, settings)
        odd = [r for fit in shown for r in scale_verdict(np.array([fit.scale_factor]), dwells.unit, fit.axis).reasons]
        alone = (
            f"turns at known rates about {' and '.join(stated)} alone do not show the other axes: mount the device on "
        )
        alone += "each axis in turn"
        return Outcome(reasons=tuple(f"gyroscope: {r}" for r in (alone, *(told_axis(fit) for fit in shown), *odd)))
    rests = None if accel is None else _rest_means(seen, accel.model)
    check_dwells(
        dwells,
        imposed_rates(dwells, settings.latitude_deg),
        rests=rests,
        numbers=tuple(k for k, t in enumerate(seen.session.turns, 1) if t.axis is not None and t.turn_rate is not None),
    )
    if not (paper and seen.settings.remove_offset):
        fit = fit_rate_table(dwells, settings)
        if not paper:
            fit = fit_with_rests(fit, dwells, rests, latitude_deg=settings.latitude_deg)
        return Outcome(fit=fit, method="rate-table")
    offset, variance = seen.rest_rate()
    if np.isnan(offset).any():
        offset = np.asarray(dwells.reading.mean(axis=0))  # both signs of every rate cancel
        variance = np.full(3, np.nan) if dwells.noise is None else (dwells.noise**2).mean(axis=0) / len(dwells.axis)
    fit = fit_rate_table(dwells.less(offset), settings)
    return Outcome(fit=with_offset(fit, offset, variance), method="rate-table")


def _rest_means(seen: Observed, accel: TriadModel) -> RestMeans | None:
    """Return readings at rest and specific forces, None where a recording lacks a triad or there is no rest."""
    records, rests = seen.session.records, sorted(seen.stills, key=lambda still: still.recording)
    parts = [records[s.recording].part(s.start, s.stop) for s in rests]
    if not rests or any(r.accel is None or r.gyro is None or np.isnan(r.gyro).any() for r in parts):
        return None
    windows = [part.gyro for part in parts if part.gyro is not None]
    noise = noise_of_means(windows, [block_size(part.sample_rate_hz) for part in parts])
    turning = [t for t in seen.session.turns if t.axis is not None and t.turn_rate is not None]
    turns = [records[t.recording].part(t.start, t.stop) for t in turning]
    if noise is None or not turns or any(turn.accel is None for turn in turns):
        return None
    dwell_force, force = (
        (np.array([np.nanmean(part.accel, axis=0) for part in group]) - accel.offset) @ accel.matrix.T  # type: ignore[arg-type]
        for group in (turns, parts)
    )
    return RestMeans(
        dwell_force=dwell_force,
        reading=np.array([window.mean(axis=0) for window in windows]),
        force=force,
        noise=noise,
        time=middles(records, rests),
    )


def _known_rotation(seen: Observed, paper: bool, accel: TriadFit | None) -> Outcome:
    if all(r.accel is None for r in seen.session.records):
        return Outcome(
            reasons=(
                "gyroscope: turns by known angles need accelerometer readings at rest on six faces, to tell what gravity adds to "
                "the gyroscopes: map the accel columns, or turn at known rates",
            )
        )
    if accel is None or len({s.face for s in seen.faced}) < 6:
        return Outcome(reasons=("gyroscope: turns by known angles need rests on all six faces too: record them",))
    turns = tuple(t for t in seen.session.turns if t.angle is not None)
    said: tuple[str, ...] = ()
    if not turns:
        turns = seen.full_turns()
        if not turns:
            return Outcome(
                reasons=(
                    "gyroscope: wanted one turn by a known angle about each axis, got none; turn the device once about x, y and z "
                    "between two rests and state angle_deg",
                )
            )
        said = (f"gyroscope: three full turns were found and taken as {_told(turns)}; state angle_deg to be sure",)
    data = rotation_data(seen.session.records, seen.stills, turns, matrix=accel.model.matrix, offset=accel.model.offset)
    settings = KnownRotationSettings(
        mode="paper" if paper else "affine",
        angle_uncertainty=seen.settings.angle_uncertainty_deg * RADIAN_PER_DEGREE,
        scale_tolerance=seen.settings.scale_tolerance,
    )
    fit = fit_known_rotation(data, gravity=seen.session.gravity_m_s2, settings=settings)
    check_turns_gravity(seen.session.records, seen.stills, accel.model, fit.model)
    return Outcome(fit=fit, method="known-rotation", reasons=said)


def _told(turns: tuple[Turn, ...]) -> str:
    return ", ".join(f"{t.axis} {(t.angle or 0.0) / RADIAN_PER_DEGREE:+.0f} deg" for t in turns)


def _multi_position(seen: Observed) -> Outcome:
    from undrift.calibration.fit.multi_position import fit_multi_position_session

    try:
        fit = fit_multi_position_session(seen.session)
    except NotObservable as error:
        return Outcome(reasons=(f"gyroscope by {error}",))
    if fit.gyro is None:
        own = fit.accel.verdict.reasons
        return Outcome(reasons=tuple(r for r in fit.verdict.reasons if r not in own))
    return Outcome(fit=fit.gyro, method="multi-position")


def _despite_plateaus(seen: Observed) -> Outcome:
    # Slow moves between poses are steady too; on a rate table without its rates the poses do not serve, for any reason.
    try:
        return _multi_position(seen)
    except CalibrationError:
        return Outcome()


def _rest(seen: Observed) -> Outcome:
    offset, variance = seen.rest_rate()
    unit = seen.session.records[0].gyro_unit
    if np.isnan(offset).any() or not is_physical(unit):
        return Outcome(reasons=("gyroscope not observable: record turns by known rates or angles",))
    covariance = np.zeros((12, 12))
    covariance[9:, 9:] = np.diag(variance)
    factor = si_factor(unit, "rate")
    residuals = (seen.rest_means() - offset) * factor
    model = TriadModel(
        method="rest",
        unit_in=unit,
        unit_out="rad/s",
        matrix=factor * np.eye(3),
        offset=offset,
        covariance=covariance,
        rms_residual=float(np.sqrt((residuals**2).mean())),
        count=residuals.size,
        rank=3,
        condition=1.0,
        valid_range=(0.0, 0.0),
    )
    reason = "offset alone: the scale is the unit's own and was not checked; record turns by known rates or angles"
    fit = TriadFit(model=model, residuals=residuals, verdict=Verdict(status="marginal", reasons=(reason,)))
    return Outcome(fit=fit, method="rest")
