"""The trace of a recording that the page Check draws: readings, rests, faces and turns."""

import numpy as np
import pytest

from undrift.calibration.calibrate import calibrate
from undrift.commands.bench.trace import trace_of
from undrift.commands.files import Opening
from undrift.correction.correct import correct
from undrift.io.formats import write_record
from undrift.sim.device.presets import random_device
from undrift.sim.sessions import simulate_session
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY


@pytest.mark.slow
def test_a_trace_holds_readings_rests_and_turns(tmp_path):
    rng = np.random.default_rng(7)
    device = random_device(rng)
    made = calibrate(simulate_session("bench", device, rng=rng))
    (raw,) = simulate_session("ferraris", device, rng=rng, labelled=False).records
    record = correct(raw, made)
    for name, one in (("counts", raw), ("si", record)):
        write_record(one, tmp_path / f"{name}.parquet")
    counted, shown = (trace_of(tmp_path / f"{name}.parquet", Opening()) for name in ("counts", "si"))
    assert counted["units"] == {"gyro": "count", "accel": "count"}
    assert shown["units"] == {"gyro": "deg/s", "accel": "g"}
    assert shown["time"][0] == 0.0
    assert shown["time"][-1] == pytest.approx(record.time[-1] - record.time[0])
    for name, size in (("gyro", RADIAN_PER_DEGREE), ("accel", STANDARD_GRAVITY)):
        drawn, values = np.array(shown["readings"][name]), getattr(record, name) / size
        assert drawn.shape == (3, len(shown["time"]))
        assert len(shown["time"]) <= 1000
        np.testing.assert_allclose(drawn.min(axis=1), values.min(axis=0), rtol=1e-4)  # no peak is lost
        np.testing.assert_allclose(drawn.max(axis=1), values.max(axis=0), rtol=1e-4)
    rests = [label for kind, label, *_ in shown["stretches"] if kind == "still"]
    assert (len(rests), len(set(rests))) == (12, 6)
    assert sum(kind == "turn" for kind, *_ in shown["stretches"]) == 11
    assert shown["at_rest"]["accel"] == pytest.approx(1.0, abs=0.01)
    assert shown["at_rest"]["gyro"] < 0.1
