"""Gyroscopes that feel gravity, told by rests in several poses at one temperature, where the calibration does not know.

Means of rests (``rests.py``), reading u in a cell of temperature and corrected specific force a, ::

    u_r = m_cell + H a_r + P_pose + E_r + noise and wander          G = M H, what ``correct`` takes off as M (u - offset) - G a

H by least squares within cells; P, what poses leave of that, and E have their variances from the same rests, and all of it is in
the covariance of H, widened for few poses by Student's factor. H is kept where its nine elements are larger, by that covariance,
than chance makes them once in a thousand. A G that the calibration has is kept, and nothing is estimated: it counts once.
"""

from dataclasses import replace

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.model import G_NAMES, Calibration, TriadModel, Verdict
from undrift.drift.fit.cells import gather
from undrift.drift.fit.offsets import known_variance, specific_force
from undrift.drift.fit.rests import RestScatter, about_cells, excess, in_poses, pooled
from undrift.drift.fit.weigh import widening_of
from undrift.drift.observe.observations import RestBlocks
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, si_factor

_CHANCE = 1e-3
_LEAST_SEEN = 0.3  # of the best seen direction of gravity: a worse one is not told
_TOLD = 0.1  # singular value, in root rests of a pose: below, poses differ by what drifts in gravity's reading alone
_LEAST_SPARE = 1  # poses beyond those that H takes


def with_felt_gravity(rests: RestBlocks, device: Calibration) -> tuple[Calibration, Verdict]:
    """Give a calibration the g-sensitivity that rests in several poses show.

    Parameters
    ----------
    rests : RestBlocks
        In the units of the calibration.
    device : Calibration
        Of both triads; one that has a g-sensitivity keeps it.

    Returns
    -------
    calibration : Calibration
        The same where the rests do not tell.
    verdict : Verdict
        How large it is.
    """
    model = device.gyro
    if model is None or device.accel is None or model.g_sensitivity is not None:
        return device, Verdict()
    blocks = rests.taken(np.flatnonzero(np.isfinite(rests.gyro).all(axis=1) & np.isfinite(rests.accel).all(axis=1)))
    force = specific_force(blocks, device)
    if not len(blocks) or force is None:
        return device, Verdict()
    between = gather(
        blocks,
        blocks.gyro,
        known_variance(blocks.gyro_variance),
        direction=np.zeros(len(blocks)),
        regressors=np.zeros((len(blocks), 0)),
        step_error=blocks.gyro_step_error,
    ).between
    felt = None if between is None else _felt(between, force)
    if between is None or felt is None:
        return device, Verdict()
    known = _with_g(model, *felt)
    size = float(np.abs(known.g_sensitivity).max()) * si_factor(model.unit_out, "rate")  # type: ignore[arg-type]
    told = (
        f"the gyroscopes feel gravity, by up to {size * STANDARD_GRAVITY / RADIAN_PER_DEGREE:.2g} (deg/s)/g: told by rests in "
        f"{between.poses} poses, part of the calibration now, and taken off by the corrected specific force"
    )
    return replace(device, gyro=known), Verdict(reasons=(told,))


def _felt(between: RestScatter, force: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """Return H, shape (3, 3), raw unit per m/s2, and the covariance of each row, shape (3, 3, 3); None where it is not told."""
    members = between.members
    about, poses = about_cells(members), in_poses(members)
    seen = about @ np.array([force[rows].mean(axis=0) for rows in members.rows])
    size = np.linalg.svd(seen, compute_uv=False)
    if len(size) < 3 or size[-1] < _LEAST_SEEN * size[0]:
        return None
    taken = np.linalg.pinv(seen) @ about
    beside = about - seen @ taken
    spare = int(np.linalg.matrix_rank(beside @ poses, tol=_TOLD))
    if spare < _LEAST_SPARE:
        return None
    covariance = between.covariance + (between.rest**2)[:, None, None] * np.eye(len(seen))
    of_pose = _inverse(beside @ poses) @ beside
    left = pooled(excess(of_pose, of_pose @ poses, between.mean, covariance), spare)
    covariance = covariance + left[:, None, None] * (poses @ poses.T)
    found = (taken @ between.mean).T
    known = widening_of(spare + 2.0) * np.einsum("ij,kjl,ml->kim", taken, covariance, taken)
    square = sum(float(h @ np.linalg.solve(c, h)) for h, c in zip(found, known, strict=True))
    return (found, known) if square > _least_square() else None


def _inverse(columns: FloatArray) -> FloatArray:
    """Return the pseudo-inverse without what is told by next to nothing."""
    left, size, right = np.linalg.svd(columns, full_matrices=False)
    told = size > _TOLD
    inverse: FloatArray = (right[told].T / size[told]) @ left[:, told].T
    return inverse


def _least_square() -> float:
    from scipy.special import chdtri

    return float(chdtri(len(G_NAMES), _CHANCE))


def _with_g(model: TriadModel, felt: FloatArray, known: FloatArray) -> TriadModel:
    count = len(model.parameters)
    covariance = np.zeros((count + len(G_NAMES), count + len(G_NAMES)))
    covariance[:count, :count] = model.covariance
    m = model.matrix
    covariance[count:, count:] = np.einsum("ak,bk,kij->aibj", m, m, known).reshape(len(G_NAMES), len(G_NAMES))
    return replace(model, g_sensitivity=m @ felt, parameters=(*model.parameters, *G_NAMES), covariance=covariance)
