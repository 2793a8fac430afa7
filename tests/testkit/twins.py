"""Slow plain-numpy twins of the kernels: the same equations, written for reading."""

import numpy as np

from undrift.model import Calibration, TriadModel
from undrift.units import si_factor


def table(nodes, values, x):
    """Linear between nodes, held at the ends."""
    values = np.asarray(values)
    flat = values.reshape(len(nodes), -1)
    return np.column_stack([np.interp(x, nodes, column) for column in flat.T]).reshape(len(x), *values.shape[1:])


def rounded(u, lsb, mode):
    if lsb is None or mode == "nearest":
        return u
    return u + 0.5 * lsb * (np.sign(u) * (np.abs(u) > 0.5 * lsb) if mode == "toward_zero" else 1.0)


def triad(u, temp, model: TriadModel, offsets, matrices, warm_up=0.0):
    """Steps 2 and 3: offsets and matrices are (nodes, values) or None."""
    offset = (model.offset if offsets is None else table(*offsets, temp)) + warm_up
    matrix = model.matrix[None] if matrices is None else table(*matrices, temp)
    return np.einsum("nij,nj->ni", np.broadcast_to(matrix, (len(u), 3, 3)), u - offset)


def extrapolated(nodes, marks, x):
    """Whether values drawn from a table at x draw on a marked node."""
    drawn = [[i for i in (k, k + 1) if nodes[k] <= v <= nodes[k + 1] and (v == nodes[i] or v not in nodes)]
             for v in x for k in [min(max(np.searchsorted(nodes, v) - 1, 0), len(nodes) - 2)]]  # fmt: skip
    return np.array([any(marks[i] for i in of) for of in drawn])


def corrected(calibration: Calibration, gyro, accel, temp, since=None):
    """The five steps of undrift.correct for readings in the calibration's own units: (rate, specific force)."""
    c, drift, adc = calibration, calibration.drift, calibration.adc
    static, scale, dynamic = (drift.static, drift.scale, drift.dynamic) if drift else (None, None, None)

    def of(table_, name):
        return None if table_ is None or getattr(table_, name) is None else (table_.temp_c, getattr(table_, name))

    a = None
    if accel is not None:
        u = accel if adc is None else rounded(accel, adc.accel_lsb, adc.accel_rounding)
        a = triad(u, temp, c.accel, of(static, "accel_offset"), of(scale, "accel_matrix"))
        a = a * si_factor(c.accel.unit_out, "accel")
    u = gyro if adc is None else rounded(gyro, adc.gyro_lsb, adc.gyro_rounding)
    warm_up = 0.0 if since is None else table(static.warm_up.power_on_s, static.warm_up.gyro_offset, since)
    w = triad(u, temp, c.gyro, of(static, "gyro_offset"), of(scale, "gyro_matrix"), warm_up)
    if c.gyro.g_sensitivity is not None:
        w = w - a @ c.gyro.g_sensitivity.T
    if dynamic is not None:
        from scipy.interpolate import RegularGridInterpolator

        t = np.clip(temp, dynamic.temp_c[0], dynamic.temp_c[-1])
        error = np.empty_like(w)
        for axis in range(3):
            at = np.column_stack((t, np.clip(w[:, axis], dynamic.turn_rate[0], dynamic.turn_rate[-1])))
            error[:, axis] = RegularGridInterpolator((dynamic.temp_c, dynamic.turn_rate), dynamic.error[..., axis])(at)
        w = w - error
    return w, a


def turning(rate, time):
    """1 while the rate, low-passed over 0.1 s, is above 2 deg/s, and half a second beyond."""
    low, last, out = rate[0], -np.inf, np.zeros(len(time))
    for k in range(len(time)):
        if k:
            step = time[k] - time[k - 1]
            low = low + (rate[k] - low) * step / (0.1 + step)
        last = time[k] if np.linalg.norm(low) > np.radians(2.0) else last
        out[k] = time[k] - last <= 0.5
    return out


def strapdown(gyro, time, q):
    """One scipy rotation after the other."""
    from scipy.spatial.transform import Rotation

    turned = [Rotation.from_quat(q, scalar_first=True)]
    for k in range(1, len(time)):
        turned.append(turned[-1] * Rotation.from_rotvec(gyro[k] * (time[k] - time[k - 1])))
    return np.array([r.as_quat(scalar_first=True) for r in turned])


def rotation_matrices(q: np.ndarray) -> np.ndarray:
    """Return matrices (..., 3, 3) of quaternions w-x-y-z."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_quat(q, scalar_first=True).as_matrix()


def carried_means(rate, force, of_rate, of_force, time, first, weight):
    """Weighted sums over windows: R f (K, 3), of (integral of R x_c dt) x R f (K, 3, 3 C), of R y_c (K, 3, 3 D)."""
    matrix = rotation_matrices(strapdown(rate, time, np.array([1.0, 0.0, 0.0, 0.0])))
    carried = np.einsum("nij,nj->ni", matrix, force)
    middle = 0.5 * (matrix + np.roll(matrix, 1, axis=0))
    by_rate = np.cumsum(np.einsum("nij,nc,n->nijc", middle, of_rate, np.diff(time, prepend=time[0])), axis=0)
    turned = np.cross(by_rate.reshape(len(time), 3, -1), carried[:, :, None], axis=1)
    fixed = np.einsum("nij,nc->nijc", matrix, of_force).reshape(len(time), 3, -1)
    sums = [[np.tensordot(weight, item[k : k + len(weight)], 1) for k in first] for item in (carried, turned, fixed)]
    return tuple(np.array(item) for item in sums)
