"""Other programs on the readings of a job, run by the Python of a separate environment.

``python rivals.py JOB.npz OUT.npz``. The environment contains ahrs, allantools, imucal and vqf. This file does not
import undrift. A job has a ``kind`` and the arrays that are the parameters of its function.
"""

import sys
from importlib.metadata import version

import numpy as np


def orientation(gyr, acc, hz):
    """Return quaternions body to level frame, z up, of each filter with its own defaults: gyr rad/s, acc m/s2, (N, 3)."""
    from ahrs.filters import Madgwick, Mahony
    from vqf import VQF, offlineVQF

    gyr, acc = np.ascontiguousarray(gyr), np.ascontiguousarray(acc)
    return {
        f"Madgwick, ahrs {version('ahrs')}": Madgwick(gyr=gyr, acc=acc, frequency=float(hz)).Q,
        f"Mahony, ahrs {version('ahrs')}": Mahony(gyr=gyr, acc=acc, frequency=float(hz)).Q,
        f"Mahony without its integral, ahrs {version('ahrs')}": Mahony(
            gyr=gyr, acc=acc, frequency=float(hz), k_I=1e-12
        ).Q,
        f"VQF {version('vqf')}, as it comes": VQF(1.0 / hz).updateBatch(gyr, acc)["quat6D"],
        f"VQF {version('vqf')}, offline": offlineVQF(gyr, acc, None, 1.0 / hz)["quat6D"],
    }


def six_faces(faces, gravity):
    """Return matrix and offset of accelerometers, a = matrix (u - offset). faces (6, 3) are means of +x, -x, +y, -y,
    +z, -z.

    imucal also requires three turns. They are replaced by 360 deg of an ideal gyroscope, which the accelerometers do
    not measure.
    """
    from imucal import FerrarisCalibration, FerrarisSignalRegions

    hold = {
        f"acc_{axis}_{side}": np.tile(faces[2 * k + (side == "a")], (2, 1))
        for k, axis in enumerate("xyz")
        for side in "pa"
    }
    still = {f"gyr_{axis}_{side}": np.zeros((2, 3)) for axis in "xyz" for side in "pa"}
    turns = {f"acc_{axis}_rot": hold[f"acc_{axis}_p"][:1] for axis in "xyz"}
    rates = {f"gyr_{axis}_rot": -360.0 * np.eye(3)[[k]] for k, axis in enumerate("xyz")}
    calibration = FerrarisCalibration(grav=float(gravity)).compute(
        FerrarisSignalRegions(**hold, **still, **turns, **rates), 1.0, "a.u.", "deg/s"
    )
    matrix = np.linalg.inv(calibration.R_a) @ np.linalg.inv(calibration.K_a)
    return {f"imucal {version('imucal')}": np.column_stack((matrix, calibration.b_a))}


def allan(values, hz, taus):
    """Return the overlapping Allan deviation of each column at the times, (3, T)."""
    from allantools import oadev

    deviations = [oadev(column, rate=float(hz), data_type="freq", taus=taus)[1] for column in values.T]
    return {f"allantools {version('allantools')}": np.array(deviations)}


if __name__ == "__main__":
    with np.load(sys.argv[1]) as job:
        given = {name: job[name] for name in job.files}
    made = {"orientation": orientation, "six_faces": six_faces, "allan": allan}[str(given.pop("kind"))](**given)
    np.savez(sys.argv[2], **made)
