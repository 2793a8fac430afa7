"""TRC text for tests."""

import numpy as np


def trc(points, labels, *, rate=100.0, unit="m", tabs=3, first=0.0):
    """Points (N, M, 3) as TRC text; NaN becomes empty cells. ``tabs`` between labels as different programs have them."""
    n, m = points.shape[:2]
    lines = [
        "PathFileType\t4\t(X/Y/Z)\tx.trc",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        f"{rate}\t{rate}\t{n}\t{m}\t{unit}\t{rate}\t1\t{n}",
        "Frame#\tTime\t" + ("\t" * tabs).join(labels),
        "\t\t" + "\t".join(f"{a}{k + 1}" for k in range(m) for a in "XYZ"),
        "",
    ]
    for k in range(n):
        cells = ["" if np.isnan(v) else repr(float(v)) for v in points[k].ravel()]
        lines.append(f"{k + 1}\t{first + k / rate!r}\t" + "\t".join(cells))
    return "\r\n".join(lines) + "\r\n"
