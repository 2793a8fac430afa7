"""Panel: frames hold the trace, by the test's own decoder; what it draws with is here, with its licence."""

import re
import struct
from typing import Any

import numpy as np

from undrift.web.panel import HEADER, MAGIC, STATIC, encoded, trace_frame


def decoded(data: bytes) -> dict[str, Any]:
    """Take a frame apart as the head of panel.py describes it, byte by byte."""
    assert data[:4] == b"UDF1"
    kind, zero = data[4], data[5]
    columns = int.from_bytes(data[6:8], "little")
    number, rows = int.from_bytes(data[8:12], "little"), int.from_bytes(data[12:16], "little")
    (start,) = struct.unpack_from("<d", data, 16)
    floats = [struct.unpack_from("<f", data, at)[0] for at in range(24, len(data), 4)]
    assert zero == 0
    assert len(floats) == rows * (1 + columns * (1 + kind))
    blocks = [floats[first : first + rows] for first in range(0, len(floats), rows)]
    time, least, most = blocks[0], blocks[1 : 1 + columns], blocks[1 + columns :]
    return {"kind": kind, "number": number, "time": [start + t for t in time], "least": least, "most": most}


def test_samples_and_envelopes_are_laid_out_as_the_head_of_the_file_says():
    time, values = 3.0 + np.arange(7) * 0.25, np.arange(14.0).reshape(7, 2)
    values[2, 1] = values[6, 0] = np.nan
    plain = decoded(encoded(time, values))
    assert (plain["kind"], plain["number"], plain["most"]) == (0, 0, [])
    assert plain["time"] == time.tolist()
    np.testing.assert_array_equal(np.array(plain["least"]).T, values)
    envelope = decoded(encoded(time, values, 3))
    assert (envelope["kind"], envelope["number"]) == (1, 0)
    assert envelope["time"] == [3.0, 3.75, 4.5]
    np.testing.assert_array_equal(envelope["least"], [[0.0, 6.0, np.nan], [1.0, 7.0, 13.0]])
    np.testing.assert_array_equal(envelope["most"], [[4.0, 10.0, np.nan], [3.0, 11.0, 13.0]])


def test_a_trace_is_sent_by_as_many_rows_as_are_asked_for_least_and_greatest_of_each(tmp_path) -> None:
    table = np.zeros(1000, dtype=[("time", "f8"), ("gyro", "f4", 3), ("accel", "f4", 3), ("q_nb", "f4", 4)])
    table["time"] = 1.7e9 + np.arange(1000) / 100.0
    table["gyro"][:, 1], table["accel"][500, 2] = np.sin(np.arange(1000)), 9.0
    table["accel"][:, 0], table["q_nb"][:, 0] = np.nan, np.arange(1000)
    np.save(tmp_path / "trace.npy", table)
    whole = decoded(trace_frame(tmp_path / "trace.npy", 0.0, 99.0, 100))
    assert (whole["kind"], len(whole["time"]), whole["time"][0]) == (1, 100, 0.0)
    assert (whole["least"][5][50], whole["most"][5][50], max(whole["most"][5][:50])) == (0.0, 9.0, 0.0)
    for k in range(100):
        lines = np.sin(np.arange(10 * k, 10 * k + 10)).astype("f4")
        assert (whole["least"][1][k], whole["most"][1][k]) == (lines.min(), lines.max())
    assert whole["least"][6] == whole["most"][6] == [10.0 * k for k in range(100)]  # orientations that there were
    assert np.isnan(whole["least"][3]).all()
    part = decoded(trace_frame(tmp_path / "trace.npy", 5.0, 5.2, 100))
    assert part["kind"] == 0  # every reading
    np.testing.assert_allclose(part["time"], np.arange(4.99, 5.205, 0.01), atol=1e-5)


def test_the_plotting_library_is_here_with_its_licence_and_version() -> None:
    named = dict(re.findall(r"^\| (\w+) \| .* \| ([\d.]+) \| MIT", (STATIC / "README.md").read_text(), re.M))
    folders = {path.name for path in STATIC.iterdir() if path.is_dir()}
    assert set(named) == folders
    assert f"(v{named['uplot']})" in (STATIC / "uplot" / "uPlot.iife.min.js").read_text()[:100]
    assert (STATIC / "uplot" / "LICENSE").read_text().startswith("The MIT License (MIT)")


def test_nothing_in_the_folder_asks_elsewhere() -> None:
    for path in [*STATIC.glob("*.js"), *STATIC.glob("*.css"), *(STATIC / "uplot").glob("*.min.*")]:
        asked = re.findall(r"""(?:src|href|import|fetch\(|url\()\s*[=(]?\s*["']?https?://""", path.read_text())
        assert asked == [], path


def test_the_page_reads_the_frames_that_the_server_writes() -> None:
    script = (STATIC / "panel.js").read_text()
    assert f"getUint32(0) !== 0x{int.from_bytes(MAGIC, 'big'):x}" in script
    read = dict(re.findall(r"(\w+) = view\.get(?:Uint8|Uint16|Uint32|Float64)\((\d+)", script))
    assert {"rows": "12", "start": "16"}.items() <= read.items()
    assert f"new Float32Array(buffer, {HEADER.size})" in script
