"""Shipped fits: they give the errors of the fits themselves, and stale ones are refused."""

from dataclasses import replace

import numpy as np
import pytest

from undrift.model import DriftTables, DynamicDrift, ScaleDrift, StaticDrift
from undrift.study import run as run_module
from undrift.study.case import pitch_errors_deg
from undrift.study.plan import Study, StudyTask
from undrift.study.run import StudyDevice, with_checked_fits
from undrift.study.sessions import ROOM_TEMP_C, SESSIONS
from undrift.study.shipped import FILE, agree, pack, shipped_fits, unpack, write_fits

STUDY = Study(tasks=(StudyTask(name="sit_to_stand"),), sessions=(SESSIONS["hand"],))
HAND = SESSIONS["hand"]
TEMP_C = np.arange(18.0, 75.5, 0.5)


@pytest.fixture(scope="module")
def device():
    return StudyDevice(STUDY, 0)


def with_tables(calibration):
    bend = 1.0 + 1e-3 * (TEMP_C - 25.0) + 2e-5 * (TEMP_C - 25.0) ** 2
    rate = np.linspace(-1.6, 1.6, 9)
    error = 1e-3 * np.sin(0.1 * TEMP_C[::4, None, None]) * rate[:, None] * np.ones(3)
    return replace(
        calibration,
        drift=DriftTables(
            static=StaticDrift(temp_c=TEMP_C, gyro_offset=bend[:, None] * calibration.gyro.offset),
            scale=ScaleDrift(temp_c=TEMP_C, gyro_matrix=bend[:, None, None] * calibration.gyro.matrix),
            dynamic=DynamicDrift(temp_c=TEMP_C[::4], turn_rate=rate, error=error),
        ),
    )


def test_a_fit_from_the_file_leaves_the_same_error(device, tmp_path, monkeypatch):
    for calibration in (device.calibration(HAND), with_tables(device.calibration(HAND))):
        write_fits({7: pack(calibration)}, {"seed": "0"}, tmp_path / "fits.parquet")
        monkeypatch.setattr("undrift.study.shipped.FILE", tmp_path / "fits.parquet")
        shipped_fits.cache_clear()
        read = unpack(shipped_fits()[7], device.worn, ROOM_TEMP_C)
        shipped_fits.cache_clear()
        (case,) = device.cases(STUDY.tasks[0])
        for offset in ("rest", "none"):
            errors = [pitch_errors_deg(case, each, offset) for each in (calibration, read)]
            np.testing.assert_allclose(*errors, atol=1e-3)  # deg: a hundredth of the margin


def test_a_failed_fit_is_shipped_as_failed(device):
    assert unpack(pack(None), device.worn, ROOM_TEMP_C) is None
    assert not agree(pack(None), pack(device.calibration(HAND)))


def test_a_key_depends_on_seed_bench_device_and_session(device):
    bench = replace(STUDY.bench, level=0.01)
    others = [
        StudyDevice(replace(STUDY, seed=1), 0), StudyDevice(replace(STUDY, bench=bench), 0), StudyDevice(STUDY, 1),
        StudyDevice(STUDY.other(), 0),
    ]  # fmt: skip
    keys = {each.key(HAND) for each in (device, *others)} | {device.key(SESSIONS["hand, warm"]), device.key("optics")}
    assert len(keys) == 7
    assert device.key(replace(HAND, name="mine")) == device.key(HAND)
    assert StudyDevice(replace(STUDY, fit="paper"), 0).key(HAND) == device.key(HAND)  # turns by hand have one fit


@pytest.mark.parametrize("stale", [False, True])
def test_stale_fits_are_refused(device, stale, monkeypatch):
    fit = pack(device.calibration(HAND))
    shipped = {name: array * (1.01 if stale else 1.0) for name, array in fit.items()}
    monkeypatch.setattr(run_module, "shipped_fits", lambda: {device.key(HAND): shipped})
    assert with_checked_fits(STUDY, map).shipped is not stale
    assert not with_checked_fits(replace(STUDY, offset="motion"), map).shipped  # needs uncertainties


@pytest.mark.slow
@pytest.mark.skipif(not FILE.exists(), reason="no fits in the package: python -m benchmarks.ship_fits makes them")
def test_the_fits_in_the_package_are_those_of_this_version():
    assert with_checked_fits(Study(tasks=STUDY.tasks), map).shipped
