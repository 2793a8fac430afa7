"""Gyroscope against an orientation reference: mocap, a robot arm, anything that gives poses of the same body.

For readings u, the model is w = M (u - o) - G a with w the body rate that the reference saw. Rates are never
differentiated from poses: the readings are integrated over windows and compared with how far the reference turned
(``reference_windows``), so pose noise enters twice a window whatever the rate. Windows grow from 2 s, where the
linearisation is safe for a raw device, by doubling to 16 s: pose errors of 0.1 deg at both ends do not grow with the window,
the rotation that an error of M or o causes does. Recordings of one device are pooled. Long windows suit real optics, whose
errors wander with the pose; where pose and reading noise are white, ``weights="noise"`` reaches the least error that the
poses allow (``reference_chain``), a quarter less than long windows.

The offset at rest and the offset in motion are not the same number on real devices (rounding, vibration, g-sensitivity: 0.01
to 0.05 deg/s). So the offset of a recording is its own mean at rest plus a change from rest to motion that all recordings of
the device share, fitted jointly with M. A new recording needs only its own rest for the fit to apply.
"""

from collections.abc import Sequence

import numpy as np

from undrift.arrays import BoolArray, FloatArray
from undrift.calibration.fit.reference_chain import solve_chain
from undrift.calibration.fit.reference_solve import Solution, independent_windows, solve
from undrift.calibration.fit.reference_value import HeldOut, Offset, ReferenceFit, ReferenceSettings, Weights
from undrift.calibration.fit.reference_windows import GyroGuess, Recording, Windows, prepare, window_equations
from undrift.calibration.fit.result import TriadFit
from undrift.calibration.model import G_NAMES, MATRIX_NAMES, OFFSET_NAMES, AdcModel, TriadModel, Verdict
from undrift.errors import AlignmentError, Implausible, InputError
from undrift.record import Record, Reference
from undrift.sync import LagSettings

__all__ = ["HeldOut", "Offset", "ReferenceFit", "ReferenceSettings", "Weights", "fit_reference", "leave_one_out"]

LAG_SETTINGS = LagSettings()
REFERENCE_SETTINGS = ReferenceSettings()
_REFINEMENTS = 2  # passes at the longest window
_MOUNTING = 0.05  # matrices of single recordings may differ by this share before their mounting is taken to differ


def fit_reference(
    records: Sequence[Record],
    references: Sequence[Reference],
    *,
    settings: ReferenceSettings = REFERENCE_SETTINGS,
    adc: AdcModel | None = None,
    lag_settings: LagSettings = LAG_SETTINGS,
) -> ReferenceFit:
    """Fit matrix, in-motion offset and, on request, g-sensitivity of a gyroscope to references.

    Parameters
    ----------
    records : sequence of Record
        Recordings of one device in one mounting, one unit; each begins with a rest of 3 s or more.
    references : sequence of Reference
        Poses of the same body, one for each record, on their own clocks.
    settings : ReferenceSettings
        Windows, robustness, which offset.
    adc : AdcModel or None
        Rounding of the codes, undone before the fit.
    lag_settings : LagSettings
        Of the lag search.

    Returns
    -------
    ReferenceFit
        Model with covariance, residuals, ranges and lags.

    Raises
    ------
    InputError
        Sequences that do not match, or no gyroscope.
    AlignmentError
        A record and its reference share no motion, or the mounting differs between recordings.
    NotObservable
        The motion leaves a parameter undetermined.
    Implausible
        The matrix is left-handed.
    """
    prepared = prepare_all(records, references, settings=settings, adc=adc, lag_settings=lag_settings)
    return _fit(prepared, settings, records[0].gyro_unit)


def leave_one_out(
    records: Sequence[Record],
    references: Sequence[Reference],
    *,
    settings: ReferenceSettings = REFERENCE_SETTINGS,
    adc: AdcModel | None = None,
    lag_settings: LagSettings = LAG_SETTINGS,
) -> tuple[HeldOut, ...]:
    """Fit every recording's model to all others of the device, and judge it there.

    Parameters
    ----------
    records : sequence of Record
        Two or more recordings of one device.
    references : sequence of Reference
        One for each record.
    settings : ReferenceSettings
        As in ``fit_reference``.
    adc : AdcModel or None
        Rounding of the codes, undone before the fit.
    lag_settings : LagSettings
        Of the lag search.

    Returns
    -------
    tuple of HeldOut
        One for each recording, in order.

    Raises
    ------
    InputError
        Fewer than two recordings, and all that ``fit_reference`` raises.
    """
    if len(records) < 2:
        raise InputError(
            f"leave one out: wanted two recordings of a device or more, got {len(records)}; add recordings"
        )
    prepared = prepare_all(records, references, settings=settings, adc=adc, lag_settings=lag_settings)
    unit = records[0].gyro_unit
    return tuple(
        _judge(i, prepared[i], _fit([*prepared[:i], *prepared[i + 1 :]], settings, unit), settings)
        for i in range(len(prepared))
    )


def prepare_all(
    records: Sequence[Record],
    references: Sequence[Reference],
    *,
    settings: ReferenceSettings,
    adc: AdcModel | None,
    lag_settings: LagSettings,
) -> list[Recording]:
    """Make the recordings of one device ready for the fit.

    Parameters
    ----------
    records, references : sequence
        One reference for each record.
    settings : ReferenceSettings
        Stride and g-sensitivity are used here.
    adc : AdcModel or None
        Rounding to undo.
    lag_settings : LagSettings
        Of the lag search.

    Returns
    -------
    list of Recording
        In order.

    Raises
    ------
    InputError
        Sequences that do not match, or units that differ.
    """
    if not records or len(records) != len(references):
        raise InputError(
            f"reference: wanted one reference for each record, got {len(records)} records and {len(references)} references"
        )
    units = sorted({r.gyro_unit for r in records})
    if len(units) > 1:
        raise InputError(
            f"reference: wanted one unit for all recordings of a device, got {', '.join(units)}; convert them"
        )
    return [
        prepare(
            record,
            reference,
            stride_s=settings.stride_s,
            adc=adc,
            with_accel=settings.g_sensitivity,
            lag_settings=lag_settings,
        )
        for record, reference in zip(records, references, strict=True)
    ]


def _fit(prepared: Sequence[Recording], settings: ReferenceSettings, unit: str) -> ReferenceFit:
    offsets = [np.zeros(3) if settings.offset == "common" else p.rest_offset for p in prepared]
    guess = _first_guess(prepared, settings)
    keep = np.ones(21 if settings.g_sensitivity else 12)
    keep[9:12] = settings.offset != "rest"
    solution, used = None, settings.window_s
    for length in _lengths(settings):
        reach = max(1, round(length / settings.stride_s))
        windows = [window_equations(p, guess, o, reach) for p, o in zip(prepared, offsets, strict=True)]
        if solution is not None and independent_windows(windows, reach) <= keep.sum() / 3.0:
            break  # too short for longer windows: stay with the last ones
        solution, used = solve(windows, keep=keep, huber=settings.huber, reach=reach), length
        guess = _moved(guess, solution.step)
    for _ in range(_REFINEMENTS if settings.weights == "noise" else 0):
        windows = [window_equations(p, guess, o, 1) for p, o in zip(prepared, offsets, strict=True)]
        solution, used = solve_chain(prepared, windows, keep=keep, huber=settings.huber), settings.stride_s
        guess = _moved(guess, solution.step)
    if solution is None or np.linalg.det(guess.matrix) <= 0.0:
        raise Implausible(
            f"reference: wanted a right-handed matrix, got a determinant of {np.linalg.det(guess.matrix):.3g}; "
            "one axis of the readings or of the reference is reversed"
        )
    return _result(prepared, settings, unit, guess, solution, used)


def _lengths(settings: ReferenceSettings) -> list[float]:
    lengths = [settings.window_s]
    if settings.weights == "noise":
        return lengths  # a start for the chain
    while lengths[-1] * 2.0 <= settings.longest_window_s:
        lengths.append(lengths[-1] * 2.0)
    if lengths[-1] < settings.longest_window_s:
        lengths.append(settings.longest_window_s)
    return lengths + [lengths[-1]] * _REFINEMENTS


def _first_guess(prepared: Sequence[Recording], settings: ReferenceSettings) -> GyroGuess:
    # The lag search has fitted rate = A u + c for every recording; no errors-in-variables care is needed for a start.
    matrices = np.array([p.lag.matrix for p in prepared])
    matrix = matrices.mean(axis=0)
    size = float(np.linalg.norm(matrix, 2))
    worst = float(np.abs(matrices - matrix).max()) / size
    if worst > _MOUNTING:
        raise AlignmentError(
            f"reference: wanted one mounting for all recordings, got matrices that differ by {worst:.0%}; fit recordings with "
            "other marker clusters or other sensors apart",
            difference=worst,
        )
    constants = [
        np.zeros(3)
        if settings.offset == "rest"
        else -p.lag.constant - matrix @ p.rest_offset * (settings.offset == "motion")
        for p in prepared
    ]
    return GyroGuess(matrix=matrix, constant=np.mean(constants, axis=0), g_sensitivity=np.zeros((3, 3)))


def _moved(guess: GyroGuess, step: FloatArray) -> GyroGuess:
    g = step[12:].reshape(3, 3) if len(step) > 12 else np.zeros((3, 3))
    return GyroGuess(
        matrix=guess.matrix + step[:9].reshape(3, 3),
        constant=guess.constant + step[9:12],
        g_sensitivity=guess.g_sensitivity + g,
    )


def _result(
    prepared: Sequence[Recording],
    settings: ReferenceSettings,
    unit: str,
    guess: GyroGuess,
    solution: Solution,
    window_s: float,
) -> ReferenceFit:
    inverse = np.linalg.inv(guess.matrix)
    motion_offset = inverse @ guess.constant
    rest = np.array([p.rest_offset for p in prepared])
    base = np.zeros(3) if settings.offset == "common" else rest.mean(axis=0)
    covariance = _carried(guess, inverse, solution.covariance)
    if settings.offset != "common":
        spread = np.array([p.rest_uncertainty for p in prepared])
        covariance[range(9, 12), range(9, 12)] += (spread**2).sum(axis=0) / len(prepared) ** 2
    seen = [(p.gyro[m] - base - motion_offset) @ guess.matrix.T for p in prepared for m in (_moving(p),)]
    model = TriadModel(
        method=f"reference/{settings.offset}",
        unit_in=unit,
        unit_out="rad/s",
        matrix=guess.matrix,
        offset=base + motion_offset,
        g_sensitivity=guess.g_sensitivity if settings.g_sensitivity else None,
        parameters=(*MATRIX_NAMES, *OFFSET_NAMES, *(G_NAMES if settings.g_sensitivity else ())),
        covariance=covariance,
        rms_residual=float(np.sqrt((solution.residuals**2).mean())) / window_s,
        count=solution.residuals.size,
        rank=solution.rank,
        condition=solution.condition,
        valid_range=(min(float(w.min()) for w in seen), max(float(w.max()) for w in seen)),
    )
    return ReferenceFit(
        triad=TriadFit(model=model, residuals=solution.residuals, verdict=_verdict(model, solution, rest, settings)),
        motion_offset=np.zeros(3) if settings.offset == "common" else motion_offset,
        rest_offsets=rest,
        lags_s=np.array([p.lag.seconds for p in prepared]),
        lag_uncertainties_s=np.array([p.lag.standard_uncertainty for p in prepared]),
        turn_rates_rms=np.array([np.sqrt((w**2).sum(axis=1).mean()) for w in seen]),
        window_s=window_s,
        window_rms=solution.scale,
        offset_mode=settings.offset,
    )


def _carried(guess: GyroGuess, inverse: FloatArray, covariance: FloatArray) -> FloatArray:
    # From (M, d, G) to (M, o, G) with o = M^-1 d: do = M^-1 dd - M^-1 dM o.
    jacobian = np.eye(len(covariance))
    jacobian[9:12, 9:12] = inverse
    jacobian[9:12, :9] = -np.kron(inverse, inverse @ guess.constant)
    carried: FloatArray = jacobian @ covariance @ jacobian.T
    return carried


def _moving(recording: Recording) -> BoolArray:
    inside: BoolArray = (recording.time >= recording.motion.start_s) & (recording.time < recording.motion.stop_s)
    return inside


def _verdict(model: TriadModel, solution: Solution, rest: FloatArray, settings: ReferenceSettings) -> Verdict:
    reasons = []
    sigma = model.standard_uncertainty
    scale = float(np.linalg.norm(model.matrix, 2))
    if sigma[:9].max() > 2e-3 * scale:
        reasons.append(
            f"the matrix is known to {sigma[:9].max() / scale:.2%} only; record longer, with more turning about every axis"
        )
    if settings.offset == "motion" and len(rest) > 1:
        spread = rest.std(axis=0, ddof=1).max() * scale
        if spread > 5e-4:  # rad/s: 0.03 deg/s
            reasons.append(
                f"the offset at rest differs by {np.degrees(spread):.3f} deg/s between recordings; warm the device up before each"
            )
    if model.g_sensitivity is not None and (np.abs(model.g_sensitivity).reshape(-1) < 3.0 * sigma[12:]).all():
        reasons.append("no g-sensitivity could be told from zero; leave it out")
    return Verdict(status="marginal" if reasons else "good", reasons=tuple(reasons))


def _judge(number: int, recording: Recording, fit: ReferenceFit, settings: ReferenceSettings) -> HeldOut:
    model = fit.model_at_rest_offset(recording.rest_offset)
    reach = max(1, round(settings.window_s / settings.stride_s))
    g = np.zeros((3, 3)) if model.g_sensitivity is None else model.g_sensitivity
    plain = GyroGuess(matrix=_rigid(model.matrix), constant=np.zeros(3), g_sensitivity=np.zeros((3, 3)))
    fitted = GyroGuess(matrix=model.matrix, constant=np.zeros(3), g_sensitivity=g)
    before = _rms(window_equations(recording, plain, recording.rest_offset, reach))
    after = _rms(window_equations(recording, fitted, model.offset, reach))
    rate = np.abs((recording.gyro[_moving(recording)] - model.offset) @ model.matrix.T)
    limit = max(abs(model.valid_range[0]), abs(model.valid_range[1]))
    beyond = float((rate > limit).any(axis=1).mean())
    rms = float(np.sqrt((rate**2).sum(axis=1).mean()))
    most = float(fit.turn_rates_rms.max())
    extrapolation = ""
    if beyond > 0.0 or rms > 1.5 * most:
        extrapolation = (
            f"turns at up to {np.degrees(rate.max()):.0f} deg/s, {np.degrees(rms):.0f} rms; the fit has seen "
            f"{np.degrees(limit):.0f} deg/s, {np.degrees(most):.0f} rms: extrapolated"
        )
    return HeldOut(recording=number, fit=fit, model=model, before=before, after=after, extrapolation=extrapolation)


def _rigid(matrix: FloatArray) -> FloatArray:
    # The nearest rotation times the nominal scale: what a raw device in that mounting would have been taken for.
    left, singular, right = np.linalg.svd(matrix)
    scale = float(np.exp(np.log(singular).mean()))
    nominal = 1.0 if 0.5 < scale < 2.0 else scale
    rigid: FloatArray = nominal * left @ right
    return rigid


def _rms(windows: Windows) -> float:
    return float(np.sqrt((windows.turn**2).sum(axis=1).mean()))
