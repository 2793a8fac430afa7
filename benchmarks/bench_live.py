"""Live readings of 2 kHz x 10 channels from a socket to the device's clock, against the ten minutes that they take."""

import binascii
import socket
import threading
import time

import numpy as np

from benchmarks.figure import Figure
from undrift.live.recorder import Recorder
from undrift.live.transports import source_at

ROWS, RATE = 1_200_000, 2000
CHANNELS = "count,gyro_x,gyro_y,gyro_z,accel_x,accel_y,accel_z,mag_x,mag_y,mag_z,temp"
QUERY = f"?format=frame&pack=<I10h&checksum=crc16&rate={RATE}&temp_scale=0.1&channels={CHANNELS}"


def run() -> list[Figure]:
    """Measure.

    Returns
    -------
    list of Figure
        Seconds, processor time per second of readings, and what was lost.
    """
    data = _frames()
    with socket.create_server(("127.0.0.1", 0)) as listener:
        sender = threading.Thread(target=_send, args=(listener, data))
        sender.start()
        wall, used = time.perf_counter(), time.process_time()
        with Recorder(source_at(f"tcp://127.0.0.1:{listener.getsockname()[1]}{QUERY}")) as recorder:
            while recorder.timeline.readings < ROWS and time.perf_counter() < wall + 120.0:
                time.sleep(0.01)
        readings = recorder.timeline.readings
        wall, used = time.perf_counter() - wall, time.process_time() - used
        sender.join()
    return [
        Figure("ten minutes of 2 kHz x 10 channels, socket to device clock", wall, "s", "<= 20"),
        Figure("processor time of it over the ten minutes", used / (ROWS / RATE), "x", "<= 0.02"),
        Figure("readings lost on the way", ROWS - readings, "", "<= 0"),
    ]


def _frames() -> bytes:
    body = np.zeros(ROWS, dtype=[("sync", "V2"), ("count", "<u4"), ("values", "<i2", 10), ("crc", "<u2")])
    body["sync"], body["count"] = np.void(b"\xaa\x55"), np.arange(ROWS)
    body["values"] = np.random.default_rng(0).integers(-250, 250, (ROWS, 10))
    raw = body.view("u1").reshape(ROWS, -1)
    body["crc"] = [binascii.crc_hqx(row, 0xFFFF) for row in raw[:, 2:26]]
    return body.tobytes()


def _send(listener: socket.socket, data: bytes) -> None:
    client, _ = listener.accept()
    with client:
        client.sendall(data)
        client.settimeout(120.0)
        client.recv(1)  # until the other side has done
