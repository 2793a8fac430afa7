"""Files in the layout of Kiel's validation set, made from a recording and its reference."""

import numpy as np
from scipy.io import savemat

from undrift.frames import rotate
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

CLUSTER = {  # body frame, m
    "l_psis": (0.0, 0.05, 0.0),
    "r_psis": (0.0, -0.05, 0.0),
    "l_asis": (0.15, 0.1, 0.02),
    "r_asis": (0.15, -0.1, -0.02),
}


def write_kiel(folder, person, task, record, reference):
    """Write a person's task; return the names of both files. Another sensor reads nothing."""
    worn = {"acc": record.in_si().accel / STANDARD_GRAVITY, "gyro": record.in_si().gyro / RADIAN_PER_DEGREE}
    arrays = {name: np.stack([np.zeros_like(values), values], axis=2) for name, values in worn.items()}
    imu = arrays | {"magn": arrays["gyro"], "fs": record.sample_rate_hz, "calibration_file": "imu_calibration_1.mat"}
    imu["imu_location"] = np.array(["head", "pelvis"], dtype=object)
    centre = np.zeros((len(reference.time), 3)) if reference.position is None else reference.position
    points = np.stack([centre + rotate(reference.q_nb, np.array([at])) for at in CLUSTER.values()], axis=2)
    residual = np.where(np.isfinite(points[:, :1]), 0.4, -1.0)
    optics = {"pos": np.concatenate((1e3 * np.nan_to_num(points), residual), axis=1)}
    optics |= {"fs": reference.sample_rate_hz, "calibration_file": "omc_calibration_1.mat"}
    optics["marker_location"] = np.array(list(CLUSTER), dtype=object)
    names = f"data/{person}/imu/imu_{task}.mat", f"data/{person}/optical/omc_{task}.mat"
    for name, data in zip(names, (imu, optics), strict=True):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        savemat(folder / name, {"data": data}, do_compression=True)
    return names
