"""Recordings that were not used to build undrift: what is determined, against each SOURCE.md, and what is refused."""

import numpy as np
from scipy.io import loadmat

from testkit.data import data_path, show
from undrift.calibration.norm import QUADRATIC_SD, fit_norm
from undrift.units import STANDARD_GRAVITY as G


def test_matrix_and_offset_of_24_poses_leave_the_residual_that_is_stated() -> None:
    raw = G * loadmat(data_path("poses_and_turns_cvut", "acc24.mat"))["ACC_meas"].T
    fit = fit_norm(raw, gravity=G, variances=np.full(raw.shape, 1e-8), quadratic_sd=QUADRATIC_SD)
    written = np.linalg.norm((raw - fit.offset) @ fit.matrix.T, axis=1) - G
    np.testing.assert_allclose(fit.residuals, written, atol=1e-9)  # rounding
    rms_mg = float(np.sqrt(np.mean(written**2))) / (1e-3 * G)
    show("poses_and_turns_cvut: rms length of 24 poses, mg", f"{rms_mg:.2f} stated and left", 0.44)
    show("  of it, uncertainty of a corrected reading, mg", f"{fit.uncertainty / (1e-3 * G):.2f}", 2.0)
    assert rms_mg < 0.44  # a linear fit of the publication leaves 0.43
    assert fit.uncertainty < 2e-3 * G
