"""The trace of a recording that the page Check draws: readings, rests, turns, and the orientation that gravity shows."""

from dataclasses import replace

import numpy as np
import pytest

from undrift.arrays import window_sums
from undrift.calibration.calibrate import calibrate
from undrift.commands.bench.trace import write_trace
from undrift.commands.files import Opening
from undrift.correction.correct import correct
from undrift.frames import quaternion_conjugate, quaternion_product, rotate, rotation_vector
from undrift.io.formats import write_record
from undrift.sim.device.presets import random_device
from undrift.sim.motion.motion import unit_vector
from undrift.sim.sessions import simulate_session
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY


@pytest.mark.slow
def test_trace_holds_readings_orientation_rests_and_turns(tmp_path):
    rng = np.random.default_rng(7)
    device = random_device(rng)
    made = calibrate(simulate_session("bench", device, rng=rng))
    (raw,) = simulate_session("ferraris", device, rng=rng, labelled=False).records
    record = correct(raw, made)
    for name, one in (("counts", raw), ("si", record)):
        write_record(one, tmp_path / f"{name}.parquet")
    told = {
        name: write_trace(tmp_path / f"{name}.parquet", Opening(), tmp_path / f"{name}.npy")
        for name in ("counts", "si")
    }
    trace, counted = np.load(tmp_path / "si.npy"), np.load(tmp_path / "counts.npy")
    np.testing.assert_array_equal(trace["time"], record.time)
    np.testing.assert_allclose(trace["gyro"], record.gyro / RADIAN_PER_DEGREE, rtol=1e-6, atol=1e-5)
    np.testing.assert_allclose(trace["accel"], record.accel / STANDARD_GRAVITY, rtol=1e-6, atol=1e-6)
    np.testing.assert_array_equal(counted["accel"], raw.accel)
    shown = told["si"]
    assert (shown["units"], told["counts"]["units"]) == (
        {"gyro": "deg/s", "accel": "g"}, {"gyro": "count", "accel": "count"}
    )  # fmt: skip
    assert shown["span_s"] == (record.time[0], record.time[-1])
    rests = [label for kind, label, why, *_ in shown["stretches"] if kind == "still" and not why]
    assert (len(rests), len(set(rests))) == (12, 6)
    assert shown["at_rest"]["accel"] == pytest.approx(1.0, abs=0.01)
    assert shown["at_rest"]["gyro"] < 0.1
    for kind, label, _, start, stop in shown["stretches"]:
        if kind == "still":  # the orientation has that face up
            up = rotate(trace["q_nb"][int(50.0 * (start + stop))].astype(float), unit_vector(label))
            assert up == pytest.approx([0.0, 0.0, 1.0], abs=0.02)


TILT, SCALED = "the drawing shows tilt alone, and is rough", "gravity gives the drawing their scale, so it is rough"


@pytest.mark.slow
@pytest.mark.parametrize(("change", "span", "words"), [
    ("none", None, SCALED), ("left out", None, f"{SCALED}. Nothing is drawn in a gap; its heading begins anew after one"),
    ("no force reads 20000", None, SCALED), ("gyroscope x reversed", None, TILT), ("one rest", (0.0, 5.0), TILT),
    ("one rest, no force reads 20000", (0.0, 5.0), ""),
])  # fmt: skip
def test_counts_show_how_the_device_lay_by_gravity(tmp_path, change, span, words):
    rng = np.random.default_rng(7)
    device = random_device(rng)
    made = calibrate(simulate_session("bench", device, rng=rng))
    (raw,) = simulate_session("ferraris", device, rng=rng, labelled=False).records
    raw = raw if span is None else raw.between(*span)
    record = replace(
        raw,
        accel=raw.accel + (20_000.0 if "20000" in change else 0.0),
        gyro=raw.gyro * ((-1.0, 1.0, 1.0) if "reversed" in change else 1.0),
    )
    write_record(record, tmp_path / "counts.parquet")
    out = "30:50" if change == "left out" else ""
    shown = write_trace(tmp_path / "counts.parquet", Opening(leave_out=out), tmp_path / "trace.npy")
    trace = np.load(tmp_path / "trace.npy")
    known = ~np.isnan(trace["q_nb"]).any(axis=1)
    assert shown["lying"] == (f"The readings have no physical unit: {words}." if words else "")
    assert known.mean() == pytest.approx(0.8 if out else 1.0 if words else 0.0, abs=0.01)
    assert sum(kind == "turn" for kind, *_ in shown["stretches"]) == (0 if span else 8 if out else 11)  # a gap is none
    q = trace["q_nb"].astype(float)
    for kind, label, why, start, stop in shown["stretches"]:
        if kind == "still" and words and not why:
            up = rotate(q[int(50.0 * (start + stop))], unit_vector(label or "+x"))
            assert up == pytest.approx(
                [0.0, 0.0, 1.0], abs=0.03 if span is None else 0.1
            )  # an offset that one rest does not show
    if SCALED in words:  # and it turns as far as the device did: over half a second, by the rates
        far = np.linalg.norm(rotation_vector(quaternion_product(quaternion_conjugate(q[:-50]), q[50:])), axis=1)
        truth = np.linalg.norm(window_sums(np.asarray(correct(raw, made).gyro), 50)[:-1], axis=1) / 100.0
        both = ~np.isnan(far)
        assert (far[both] @ truth[both]) / (truth[both] @ truth[both]) == pytest.approx(1.0, abs=0.05)
