"""Panel: the trace of a recording, drawn by uPlot in the browser, with its rests and turns.

The browser asks for a stretch of the trace by as many rows as it has pixels, and gets a frame, little-endian, columns gyro x y z,
accel x y z and the quaternion w x y z::

    at  type                what
    0   4 bytes             "UDF1"
    4   uint8               kind: 0 samples, 1 envelope (least and greatest of a few samples that follow each other)
    5   uint8               0
    6   uint16              columns M
    8   uint32              0
    12  uint32              rows N
    16  float64             time of the first row, s
    24  float32[N]          time of each row after the first, s
    ..  float32[M][N]       values, column by column; NaN is a gap. Of an envelope the least ones
    ..  float32[M][N]       of an envelope only: the greatest ones
"""

import math
import struct
from pathlib import Path
from typing import Any

import numpy as np
from nicegui.element import Element

from undrift.arrays import FloatArray

HEADER = struct.Struct("<4sBBHIId")
MAGIC = b"UDF1"
SAMPLES, ENVELOPE = 0, 1
STATIC = Path(__file__).parent / "static"


def encoded(time: FloatArray, values: FloatArray, bucket: int = 1) -> bytes:
    """Return rows as a frame: time (N,) s, values (N, M)."""
    kind, blocks = SAMPLES, [values]
    if bucket > 1:
        kind, starts = ENVELOPE, np.arange(0, len(time), bucket)
        blocks = [np.fmin.reduceat(values, starts, axis=0), np.fmax.reduceat(values, starts, axis=0)]
        time = time[starts]
    head = HEADER.pack(MAGIC, kind, 0, values.shape[1], 0, len(time), time[0])
    body = [(time - time[0]), *(block.T for block in blocks)]
    return head + b"".join(np.ascontiguousarray(part, dtype="<f4").tobytes() for part in body)


def trace_frame(path: Path, start: float, stop: float, rows: int) -> bytes:
    """Return a stretch of a trace, s since its first sample, as a frame of at most so many rows; ValueError if it is no trace."""
    table = np.load(path, mmap_mode="r")
    time = np.asarray(table["time"]) - table["time"][0]
    low, high = time.searchsorted((start, stop))
    part, time = table[max(low - 1, 0) : high + 1], time[max(low - 1, 0) : high + 1]
    bucket = max(1, math.ceil(len(part) / max(rows, 2)))
    q_nb = np.repeat(part["q_nb"][::bucket], bucket, axis=0)[: len(part)]  # an orientation has no least one
    return encoded(time, np.hstack((part["gyro"], part["accel"], q_nb)), bucket)


class Panel(Element, component="static/panel.js"):
    """Plots of a recording with its stretches; a stretch that is chosen is an event."""

    def __init__(self, trace: dict[str, Any]) -> None:
        super().__init__()
        self._props["trace"] = trace
        self.add_resource(STATIC)
