"""Calibrate as the note does it: faces, static drift over temperature, matrix, dynamic drift over rate and temperature.

The order is the one of the note's Figure 2: static drift first (not-a-knot splines over the set-points' rests), then the
matrix (eq. 6) at the set-point nearest to room temperature, then what is left over rate and temperature (bicubic spline). A
protocol without set-points gives the matrix and a constant offset alone.
"""

from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray, IntArray
from undrift.calibration.fit.linear import fit_paper
from undrift.calibration.fit.six_face import FaceMeans, SixFaceSettings, fit_six_face
from undrift.calibration.model import Calibration, DriftTables, DynamicDrift, StaticDrift, TriadModel
from undrift.drift.fit.spline import not_a_knot
from undrift.drift.observe.observations import RateSteps, RestBlocks
from undrift.errors import NotObservable
from undrift.sim.device.dwells import DwellReadings
from undrift.study.session import FACE, ROOM_TEMP_C, Imposed, rate_steps, rest_blocks
from undrift.units import STANDARD_GRAVITY

NODES_C = np.linspace(18.0, 75.0, 115)  # the note's tuning table: every 0.5 degC


@dataclass(frozen=True, slots=True, kw_only=True)
class NoteSettings:
    """Which of the note's corrections are made.

    Parameters
    ----------
    static : bool
        Table of offsets over temperature.
    dynamic : bool
        Table of rate errors over rate and temperature.
    """

    static: bool = True
    dynamic: bool = True


def calibrate_as_the_note(
    imposed: Imposed,
    readings: DwellReadings,
    *,
    unit_gyro: str,
    unit_accel: str,
    settings: NoteSettings = NoteSettings(),
) -> Calibration:
    """Calibrate a device from the dwells of a session.

    Parameters
    ----------
    imposed : Imposed
        What was done.
    readings : DwellReadings
        What the device said.
    unit_gyro, unit_accel : str
        Units of its readings.
    settings : NoteSettings
        Which tables are made.

    Returns
    -------
    Calibration
        With tables where the session had set-points.

    Raises
    ------
    NotObservable
        No rests, or rates that do not span three axes.
    """
    rests, steps = rest_blocks(imposed, readings), rate_steps(imposed, readings)
    if not len(rests):
        raise NotObservable("study: wanted rests at zero rate, got none; set bracket_s")
    soaks = np.unique(imposed.soak)
    temps, offsets, variances = _offsets(imposed, rests, soaks)
    home = int(np.argmin(np.abs(temps - ROOM_TEMP_C)))
    gyro = _matrix(steps, soaks[home], offsets[home], variances[home], unit_gyro)
    drift = None
    if len(soaks) > 1 and settings.static:
        curve = not_a_knot(temps, offsets, variances, NODES_C)
        static = StaticDrift(
            temp_c=NODES_C,
            gyro_offset=curve.value,
            gyro_extrapolated=np.abs(NODES_C - np.clip(NODES_C, temps[0], temps[-1])) > 0.5,
        )
        dynamic = _dynamic(steps, soaks, temps, offsets, gyro) if settings.dynamic else None
        drift = DriftTables(static=static, dynamic=dynamic)
    return Calibration(
        device="",
        reference_temp_c=float(temps[home]),
        gravity_m_s2=STANDARD_GRAVITY,
        gyro=gyro,
        accel=_accel(imposed, readings, unit_accel),
        drift=drift,
    )


def _offsets(imposed: Imposed, rests: RestBlocks, soaks: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    soak = imposed.soak[imposed.kind == 1]
    temps = np.array([rests.temp_c[soak == s].mean() for s in soaks])
    means = np.array([rests.gyro[soak == s].mean(axis=0) for s in soaks])
    variances = np.array([rests.gyro_variance[soak == s].sum(axis=0) / (soak == s).sum() ** 2 for s in soaks])
    return temps, means, variances


def _matrix(steps: RateSteps, soak: int, offset: FloatArray, variance: FloatArray, unit: str) -> TriadModel:
    rows = steps.soak == soak
    fit = fit_paper(
        steps.rate_b[rows],
        steps.gyro[rows] - offset,
        np.sqrt(steps.gyro_variance[rows]),
        method="rate-table/paper",
        unit_in=unit,
        unit_out="rad/s",
    )
    model = fit.model
    covariance = model.covariance.copy()
    covariance[9:12, 9:12] = np.diag(variance)
    return TriadModel(
        method=model.method,
        unit_in=unit,
        unit_out="rad/s",
        matrix=model.matrix,
        offset=offset,
        covariance=covariance,
        rms_residual=model.rms_residual,
        count=model.count,
        rank=model.rank,
        condition=model.condition,
        valid_range=model.valid_range,
    )


def _dynamic(
    steps: RateSteps, soaks: IntArray, temps: FloatArray, offsets: FloatArray, gyro: TriadModel
) -> DynamicDrift:
    """Bicubic: at each set-point a spline over the measured rate, then one over temperature at each node."""
    from scipy.interpolate import CubicSpline

    imposed = np.unique(np.round(np.abs(steps.rate_b).max(axis=1), 12))
    nodes = np.concatenate((-imposed[::-1], [0.0], imposed))
    error = np.zeros((len(soaks), len(nodes), 3))
    for k, soak in enumerate(soaks):
        rows = steps.soak == soak
        measured = (steps.gyro[rows] - offsets[k]) @ gyro.matrix.T
        for axis in range(3):
            own = np.abs(steps.rate_b[rows, axis]) > 0.0
            rate = np.concatenate((measured[own, axis], [0.0]))
            left = np.concatenate((measured[own, axis] - steps.rate_b[rows, axis][own], [0.0]))
            order = np.argsort(rate)
            curve = CubicSpline(rate[order], left[order], bc_type="not-a-knot")
            error[k, :, axis] = curve(np.clip(nodes, rate[order[0]], rate[order[-1]]))
    table_temps = np.unique(np.concatenate((temps, NODES_C[::10])))
    table_temps = table_temps[(table_temps >= temps[0]) & (table_temps <= temps[-1])]
    over_temp = CubicSpline(temps, error, axis=0, bc_type="not-a-knot") if len(temps) > 1 else None
    return DynamicDrift(
        temp_c=table_temps,
        turn_rate=nodes,
        error=np.repeat(error, 2, axis=0) if over_temp is None else over_temp(table_temps),
    )


def _accel(imposed: Imposed, readings: DwellReadings, unit: str) -> TriadModel | None:
    at = np.flatnonzero(imposed.kind == FACE)
    if not len(at):
        return None
    poses = FaceMeans(
        reading=readings.accel[at],
        faces=tuple(imposed.faces[i] for i in at),
        noise=np.sqrt(readings.accel_variance[at] / readings.samples[at, None]),
        unit=unit,
    )
    return fit_six_face(poses, gravity=STANDARD_GRAVITY, settings=SixFaceSettings(mode="affine")).model
