"""The page of a trial for a person's file, and the band of its pitch."""

import re
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from testkit.pdf_text import pages_of, text_of
from undrift.calibration.calibrate import calibrate
from undrift.commands.orient import Oriented
from undrift.correction.correct import correct
from undrift.io.formats import read_record, write_record
from undrift.io.store import content_hash, read_calibration
from undrift.orientation import orient, sagittal_pitch
from undrift.record import Record
from undrift.sim.device.presets import random_device
from undrift.sim.sessions import simulate_session, simulate_trial


def test_one_page_has_angles_band_calibration_device_date_and_verdict(undrift, bench, tmp_path):
    words = ("orient", bench / "trial.parquet", "--calibration", bench / "calibration.json", "-o", tmp_path / "a.csv")
    answer = undrift.good(*words, "--pdf", tmp_path / "p.pdf").out
    values = undrift.good(*words, "--json").json()
    assert f"Wrote {tmp_path / 'p.pdf'}" in answer
    assert pages_of(tmp_path / "p.pdf") == 1
    text, calibration = text_of(tmp_path / "p.pdf"), read_calibration(bench / "calibration.json")
    assert answer.splitlines()[0] in text.replace("−", "-")
    assert "it is good to" in text
    for angle in ("inclination_deg", "pitch_deg"):
        assert all(f"{value:.2f}" in text for value in values[angle])
    for part in (calibration.device, content_hash(calibration), f"verdict {calibration.verdict.status}"):
        assert part in text
    assert re.search(r"Verdict: (good|marginal|bad)", text)
    assert re.search(r"Page made \d{4}-\d\d-\d\dT", text)
    assert "Recorded not stated by the recording" in text


def test_the_date_of_a_recording_is_that_of_its_clock(undrift, bench, tmp_path):
    record, start = read_record(bench / "corrected.parquet"), datetime(2026, 3, 1, 12, tzinfo=UTC).timestamp()
    names = ("gyro", "accel", "temp_c", "gyro_unit", "accel_unit", "frame", "state", "device", "accel_uncertainty")
    write_record(
        Record(time=record.time + start, **{name: getattr(record, name) for name in names}), tmp_path / "r.parquet"
    )
    undrift.good("orient", tmp_path / "r.parquet", "-o", tmp_path / "a.csv", "--pdf", tmp_path / "p.pdf")
    text = text_of(tmp_path / "p.pdf")
    assert "Recorded 2026-03-01T12:00:00+00:00" in text
    assert "none given: as the recording came" in text


@pytest.mark.slow
def test_a_filter_and_unknown_accelerometers_draw_no_band_and_say_so(undrift, bench, tmp_path):
    words = ("orient", bench / "corrected.parquet", "-o", tmp_path / "a.csv", "--method", "vqf")
    assert "it is good to" not in undrift.good(*words, "--pdf", tmp_path / "p.pdf").out
    assert "The filter states no uncertainty" in text_of(tmp_path / "p.pdf")
    raw = replace(read_record(bench / "corrected.parquet"), accel_uncertainty=None)
    write_record(raw, tmp_path / "raw.parquet")
    words = ("orient", tmp_path / "raw.parquet", "-o", tmp_path / "a.csv", "--pdf", tmp_path / "p.pdf")
    assert "it is good to" not in undrift.good(*words).out
    assert "Accelerometers that are not calibrated state no uncertainty" in text_of(tmp_path / "p.pdf")


def test_a_page_is_of_one_recording_and_is_a_pdf(undrift, bench, tmp_path):
    (tmp_path / "many").mkdir()
    write_record(read_record(bench / "corrected.parquet"), tmp_path / "many" / "a.parquet")
    words = ("orient", tmp_path / "many", "-o", tmp_path / "out", "--pdf", tmp_path / "p.pdf")
    assert "wanted a recording or a session" in undrift.refused(*words)
    one = ("orient", bench / "corrected.parquet", "-o", tmp_path / "a.csv", "--pdf")
    assert "wanted a name ending in .pdf" in undrift.refused(*one, tmp_path / "p.svg")
    assert not (tmp_path / "a.csv").exists()


@pytest.mark.slow
def test_the_band_holds_the_errors_of_simulated_trials():
    """95 % of errors are stated to lie within; of these eight devices, all samples together, at least nine in ten do."""
    within = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        device = random_device(rng)
        calibration = calibrate(simulate_session("bench", device, rng=rng))
        trial = simulate_trial("sit_to_stand", device, rng=rng)
        found = orient(correct(trial.record, calibration), gyro_model=calibration.gyro)
        done = Oriented(
            record=Path("r"), output=Path("o"), method="strapdown", orientation=found, calibration=calibration,
            earlier=(), notes=(),
        )  # fmt: skip
        truth = np.interp(found.time, trial.reference.time, sagittal_pitch(trial.reference.q_nb))
        assert done.band is not None
        within.append(np.abs(found.pitch - truth) <= done.band)
        assert np.degrees(done.band.max()) < 2.0  # a band that holds everything says nothing
    assert np.concatenate(within).mean() >= 0.9
