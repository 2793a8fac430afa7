"""A person's recording with the markers of a rigid cluster on the same body, as files."""

import numpy as np

from testkit.trc_text import trc
from undrift.frames import rotate
from undrift.io.formats import write_record

CLUSTER = {  # body frame, m
    "l_psis": (0.0, 0.05, 0.0),
    "r_psis": (0.0, -0.05, 0.0),
    "l_asis": (0.15, 0.1, 0.02),
    "r_asis": (0.15, -0.1, -0.02),
}


def write_trial(folder, person, task, record, reference):
    """Write a recording and its markers, z up; return the names of both files."""
    centre = np.zeros((len(reference.time), 3)) if reference.position is None else reference.position
    points = np.stack([centre + rotate(reference.q_nb, np.array([at])) for at in CLUSTER.values()], axis=1)
    names = f"data/{person}/imu_{task}.parquet", f"data/{person}/optics_{task}.trc"
    (folder / names[0]).parent.mkdir(parents=True, exist_ok=True)
    write_record(record, folder / names[0])
    text = trc(points, list(CLUSTER), rate=reference.sample_rate_hz, first=float(reference.time[0]))
    (folder / names[1]).write_bytes(text.encode())
    return names
