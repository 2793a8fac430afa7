"""calibration.json: exact round trip, one-line refusals, never half a file."""

import json
import math
from dataclasses import fields, is_dataclass
from pathlib import Path

import numpy as np
import pytest

from undrift.errors import FileFormatError, InputError
from undrift.findings import finding
from undrift.io.store import calibration_json, read_calibration, write_calibration
from undrift.model import (
    AdcModel,
    Calibration,
    DriftTables,
    DynamicDrift,
    NoiseModel,
    Provenance,
    ScaleDrift,
    StaticDrift,
    TriadModel,
    Verdict,
    WarmUp,
)

AWKWARD = (math.nan, 0.1 + 0.2, -0.0, 5e-324, 1.7976931348623157e308)  # floats that a text may lose


def numbers(*shape: int) -> np.ndarray:
    """Random numbers of any size, and the awkward ones among them."""
    values = np.random.default_rng(sum(shape)).normal(size=shape) * 10.0 ** np.random.default_rng(1).integers(
        -9, 9, shape
    )
    values.flat[: len(AWKWARD)] = AWKWARD[: values.size]
    return values


def triad() -> TriadModel:
    return TriadModel(
        method="table/µ", unit_in="count", unit_out="rad/s", matrix=numbers(3, 3), offset=numbers(3), g_sensitivity=numbers(3, 3),
        parameters=("p0", "p1", "p2"), covariance=numbers(3, 3), rms_residual=math.inf, count=10**9, rank=3, condition=-math.inf,
        valid_range=(-math.inf, math.nan),
    )  # fmt: skip


def full() -> Calibration:
    """A calibration with every part and every optional table."""
    marks, temp_c = np.array([True, False]), [-20.5, 60.0]
    static = StaticDrift(
        temp_c=temp_c, gyro_offset=numbers(2, 3), accel_offset=numbers(2, 3), gyro_uncertainty=numbers(2, 3),
        accel_uncertainty=numbers(2, 3), gyro_extrapolated=marks, accel_extrapolated=marks, gyro_hysteresis=numbers(3),
        warm_up=WarmUp(power_on_s=[0.0, 1e-3, 9e4], gyro_offset=np.vstack((numbers(2, 3), np.zeros(3)))),
    )  # fmt: skip
    scale = ScaleDrift(
        temp_c=temp_c, gyro_matrix=numbers(2, 3, 3), accel_matrix=numbers(2, 3, 3), gyro_uncertainty=numbers(2, 3, 3),
        accel_uncertainty=numbers(2, 3, 3), gyro_extrapolated=marks, accel_extrapolated=marks,
    )  # fmt: skip
    dynamic = DynamicDrift(
        temp_c=temp_c, turn_rate=[-1.0, 1.0], error=numbers(2, 2, 3), uncertainty=numbers(2, 2, 3), extrapolated=np.eye(2) > 0
    )  # fmt: skip
    return Calibration(
        device='A"1\n', reference_temp_c=math.nan, gravity_m_s2=9.81, gyro=triad(), accel=triad(),
        drift=DriftTables(static=static, scale=scale, dynamic=dynamic, lag_s=80.0, lag_smooth_s=1.0),
        adc=AdcModel(gyro_lsb=numbers(3), accel_lsb=numbers(3), gyro_rounding="floor", accel_rounding="toward_zero"),
        noise=NoiseModel(**{f.name: numbers(3) for f in fields(NoiseModel)}),
        verdict=Verdict(status="marginal", findings=(finding("a.b", "info", "p.", "q.", x=1.5, axes=("a",)),)),
        provenance=Provenance(inputs=(("a", "b"),), settings=(("c", ""),), versions=(("d", "e"),), created="2026"),
    )  # fmt: skip


def assert_same(a: object, b: object, where: str = "calibration") -> None:
    """Equal to the last bit, NaN equal to NaN, minus zero not equal to zero."""
    if is_dataclass(a):
        assert type(a) is type(b), where
        for field in fields(a):
            assert_same(getattr(a, field.name), getattr(b, field.name), f"{where}.{field.name}")
    elif isinstance(a, np.ndarray):
        assert (a.shape, a.dtype, a.tobytes()) == (b.shape, b.dtype, b.tobytes()), where
    else:
        assert repr(a) == repr(b), where


def example(**changes: object) -> Calibration:
    model = TriadModel(
        method="six-face/affine",
        unit_in="count",
        unit_out="m/s2",
        matrix=np.eye(3) * 0.1,
        offset=[1.0, 2.0, 3.0],
        covariance=np.zeros((12, 12)),
        rms_residual=0.01,
        count=18,
        rank=12,
        condition=1.5,
        valid_range=(-9.8, 9.8),
    )
    values = {"device": "A", "reference_temp_c": 25.0, "gravity_m_s2": 9.81, "accel": model, **changes}
    return Calibration(**values)


@pytest.mark.parametrize("calibration", [full(), example()], ids=["full", "least"])
def test_a_calibration_reads_back_to_the_last_bit(calibration: Calibration, tmp_path: Path) -> None:
    path = tmp_path / "calibration.json"
    write_calibration(calibration, path)
    assert_same(calibration, read_calibration(path))


def test_the_file_has_the_keys_of_the_format_and_null_for_nan(tmp_path: Path) -> None:
    path = tmp_path / "calibration.json"
    write_calibration(example(reference_temp_c=math.nan, adc=AdcModel(gyro_lsb=[1, 1, 1])), path)
    content = json.loads(path.read_text())
    assert content == calibration_json(read_calibration(path))
    assert list(content) == [
        "kind", "format", "device", "reference_temp_c", "gravity_m_s2", "gyro", "accel", "drift", "adc", "noise", "verdict",
        "provenance",
    ]  # fmt: skip
    assert content["kind"] == "undrift.calibration"
    assert content["format"] == 1
    assert content["reference_temp_c"] is None
    assert content["adc"] == {"lsb": [1, 1, 1], "rounding": "nearest", "accel_lsb": None, "accel_rounding": "nearest"}
    assert '"offset": [1.0, 2.0, 3.0]' in path.read_text(), "vectors stand on one line"


@pytest.mark.parametrize("name", ["lag_s", "lag_smooth_s"])
def test_a_lag_below_zero_is_refused_in_value_and_file(name: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="lag_s and lag_smooth_s must be"):
        DriftTables(**{name: -1.0})
    content = calibration_json(example(drift=DriftTables(**{"lag_smooth_s": 1.0, name: 2.0})))
    assert content["drift"][name] == 2.0
    content["drift"][name] = -1.0
    (tmp_path / "c.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match=r"lag_smooth_s positive if there is a lag, got 3 and 0. "):
        DriftTables(lag_s=3.0)
    with pytest.raises(FileFormatError, match=f"at drift.{name}: expected greater than or equal to 0"):
        read_calibration(tmp_path / "c.json")
