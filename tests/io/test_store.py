"""calibration.json: exact round trip, one-line refusals, never half a file."""

import json
import math
from dataclasses import fields, is_dataclass
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from undrift.base.codec import schema_of
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

finite = st.floats(allow_nan=False, allow_infinity=False)
gappy = st.floats(allow_nan=True, allow_infinity=False)
anything = st.floats()
roundings = st.sampled_from(["nearest", "floor", "toward_zero"])


def numbers(*shape: int, elements=gappy):
    return arrays(np.float64, shape, elements=elements)


def nodes(n: int):
    return st.lists(st.floats(-1e6, 1e6), min_size=n, max_size=n, unique=True).map(sorted)


@st.composite
def triads(draw):
    p = draw(st.integers(0, 21))
    return TriadModel(
        method=draw(st.text(max_size=8)),
        unit_in=draw(st.sampled_from(["count", "dps", "v"])),
        unit_out="rad/s",
        matrix=draw(numbers(3, 3)),
        offset=draw(numbers(3)),
        g_sensitivity=draw(st.none() | numbers(3, 3)),
        parameters=tuple(f"p{i}" for i in range(p)),
        covariance=draw(numbers(p, p)),
        rms_residual=draw(anything),
        count=draw(st.integers(0, 10**9)),
        rank=draw(st.integers(0, 21)),
        condition=draw(anything),
        valid_range=(draw(anything), draw(anything)),
    )


def marks(*shape: int):
    return arrays(np.bool_, shape)


@st.composite
def warm_ups(draw):
    times = draw(st.lists(st.floats(1e-3, 1e5), min_size=1, max_size=4, unique=True).map(sorted))
    offset = np.vstack((draw(numbers(len(times), 3)), np.zeros(3)))
    return WarmUp(power_on_s=[0.0, *times], gyro_offset=offset)


@st.composite
def drifts(draw):
    n, m = draw(st.integers(2, 4)), draw(st.integers(2, 4))
    none, smooth = st.none(), st.floats(1e-6, 1e4)
    static = st.builds(
        StaticDrift,
        temp_c=nodes(n),
        **{
            f"{triad}_{what}": none | numbers(n, 3) for triad in ("gyro", "accel") for what in ("offset", "uncertainty")
        },
        gyro_extrapolated=none | marks(n),
        accel_extrapolated=none | marks(n),
        gyro_hysteresis=none | numbers(3),
        warm_up=none | warm_ups(),
    )
    scale = st.builds(
        ScaleDrift,
        temp_c=nodes(n),
        **{
            f"{triad}_{what}": none | numbers(n, 3, 3)
            for triad in ("gyro", "accel")
            for what in ("matrix", "uncertainty")
        },
        gyro_extrapolated=none | marks(n),
        accel_extrapolated=none | marks(n),
    )
    dynamic = st.builds(
        DynamicDrift,
        temp_c=nodes(n),
        turn_rate=nodes(m),
        error=numbers(n, m, 3),
        uncertainty=none | numbers(n, m, 3),
        extrapolated=none | marks(n, m),
    )
    return DriftTables(
        static=draw(none | static),
        scale=draw(none | scale),
        dynamic=draw(none | dynamic),
        lag_s=draw(st.just(0.0) | smooth),
        lag_smooth_s=draw(smooth),
    )


def pairs():
    return st.dictionaries(st.text(max_size=5), st.text(max_size=5), max_size=3).map(lambda d: tuple(d.items()))


calibrations = st.builds(
    Calibration,
    device=st.text(max_size=10),
    reference_temp_c=gappy,
    gravity_m_s2=finite,
    gyro=st.none() | triads(),
    accel=st.none() | triads(),
    drift=st.none() | drifts(),
    adc=st.none()
    | st.builds(
        AdcModel,
        gyro_lsb=st.none() | numbers(3),
        accel_lsb=st.none() | numbers(3),
        gyro_rounding=roundings,
        accel_rounding=roundings,
    ),
    noise=st.none() | st.builds(NoiseModel, **{f.name: numbers(3) for f in fields(NoiseModel)}),
    verdict=st.builds(
        Verdict,
        status=st.sampled_from(["good", "marginal", "bad"]),
        findings=st.lists(st.text(max_size=20), max_size=3, unique=True).map(
            lambda texts: tuple(finding("imported.uncertainty", "info", program=text) for text in texts)
        ),
    ),
    provenance=st.builds(
        Provenance,
        inputs=st.lists(st.tuples(st.text(max_size=5), st.text(max_size=5)), max_size=3).map(tuple),
        settings=pairs(),
        versions=pairs(),
        created=st.text(max_size=25),
    ),
)


def assert_same(a: object, b: object, where: str = "calibration") -> None:
    """Equal to the last bit, NaN equal to NaN, minus zero not equal to zero."""
    if is_dataclass(a):
        assert type(a) is type(b), where
        for field in fields(a):
            assert_same(getattr(a, field.name), getattr(b, field.name), f"{where}.{field.name}")
    elif isinstance(a, np.ndarray):
        assert a.shape == b.shape, where
        assert a.dtype == b.dtype, where
        both_nan = np.isnan(a) & np.isnan(b)
        assert (
            (both_nan | ((a == b) & (np.signbit(a) == np.signbit(b)))).all() if a.dtype != bool else (a == b).all()
        ), where
    elif isinstance(a, tuple) and a and isinstance(a[0], float):
        for x, y in zip(a, b, strict=True):
            assert_same(x, y, where)
    elif isinstance(a, float):
        assert (math.isnan(a) and math.isnan(b)) or (a == b and math.copysign(1, a) == math.copysign(1, b)), where
    else:
        assert a == b, where


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


@pytest.mark.slow
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(calibration=calibrations)
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


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"kind": "undrift.device"}, "wanted kind 'undrift.calibration', got 'undrift.device'"),
        ({"format": 2}, "wanted format 1, got 2; read it with the undrift that wrote it"),
        ({"format": True}, "wanted format 1, got True"),
        ({"colour": "red"}, "got at colour: Extra inputs are not permitted"),
        ({"device": None}, "got at device: Input should be a valid string"),
        ({"gravity_m_s2": "9.81"}, "got at gravity_m_s2: Input should be a valid number"),
        ({"verdict": {"status": "fine", "reasons": []}}, "got at verdict.status: Input should be 'good', 'marginal' or 'bad'"),
    ],
)  # fmt: skip
def test_a_key_that_is_not_of_the_format_is_refused_by_name(change: dict, text: str, tmp_path: Path) -> None:
    path = tmp_path / "calibration.json"
    path.write_text(json.dumps(calibration_json(example()) | change))
    with pytest.raises(FileFormatError) as caught:
        read_calibration(path)
    assert text in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("content", "text"),
    [
        ("{", "wanted JSON"),
        ('{"kind": NaN}', "NaN, which is no JSON number"),
        ("[1, 2]", "wanted kind 'undrift.calibration', got None"),
        ("\x00\x01", "wanted JSON"),
        ("[" * 100_000, "wanted JSON"),
    ],
)
def test_a_file_that_is_not_a_calibration_is_refused_on_one_line(content: str, text: str, tmp_path: Path) -> None:
    path = tmp_path / "calibration.json"
    path.write_text(content)
    with pytest.raises(FileFormatError, match=text) as caught:
        read_calibration(path)
    assert "\n" not in str(caught.value)


def test_bytes_that_are_no_text_and_files_that_are_not_there_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "calibration.json"
    path.write_bytes(b"\xff\xfe\x80")
    with pytest.raises(FileFormatError, match="wanted JSON"):
        read_calibration(path)
    with pytest.raises(FileFormatError, match="No such file"):
        read_calibration(tmp_path / "absent.json")


def test_a_covariance_of_another_size_is_refused(tmp_path: Path) -> None:
    content = calibration_json(example())
    content["accel"]["covariance"] = [[1.0]]
    (tmp_path / "c.json").write_text(json.dumps(content))
    with pytest.raises(FileFormatError, match=r"TriadModel.covariance: wanted shape \(12, 12\), got \(1, 1\)"):
        read_calibration(tmp_path / "c.json")
    content["accel"]["covariance"] = [[1.0], [1.0, 2.0]]
    (tmp_path / "c.json").write_text(json.dumps(content))
    with pytest.raises(FileFormatError, match="inhomogeneous"):
        read_calibration(tmp_path / "c.json")


def test_a_value_that_would_not_read_back_is_not_written(tmp_path: Path) -> None:
    path = tmp_path / "calibration.json"
    with pytest.raises(InputError, match="wanted a calibration that reads back, got at gravity_m_s2"):
        write_calibration(example(gravity_m_s2=math.nan), path)
    twice = Provenance(settings=(("mode", "paper"), ("mode", "affine")))
    with pytest.raises(InputError, match="wanted each of the settings once"):
        write_calibration(example(provenance=twice), path)
    assert list(tmp_path.iterdir()) == []


def test_a_write_that_fails_leaves_the_old_file_and_no_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "calibration.json"
    write_calibration(example(), path)
    before = path.read_bytes()

    def full(handle: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(InputError, match=r"calibration\.json: wanted room for \d+ bytes more on the disk"):
        write_calibration(example(device="B"), path)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_a_folder_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="wanted a folder to write to, got No such file or directory"):
        write_calibration(example(), tmp_path / "absent" / "calibration.json")


def test_tables_without_the_later_keys_are_written_as_before(tmp_path: Path) -> None:
    static = StaticDrift(temp_c=[20.0, 30.0], gyro_offset=np.ones((2, 3)))
    dynamic = DynamicDrift(temp_c=[20.0, 30.0], turn_rate=[-1.0, 1.0], error=np.zeros((2, 2, 3)))
    drift = calibration_json(example(drift=DriftTables(static=static, dynamic=dynamic)))["drift"]
    assert list(drift) == ["static", "scale", "dynamic"]
    assert list(drift["static"]) == ["temp_c", "gyro_offset", "accel_offset"]
    assert drift["scale"] is None
    assert list(drift["dynamic"]) == ["temp_c", "turn_rate", "error"]


def test_a_mark_is_true_or_false_and_each_node_has_one(tmp_path: Path) -> None:
    static = StaticDrift(temp_c=[20.0, 30.0], gyro_offset=np.ones((2, 3)), gyro_extrapolated=[True, False])
    content = calibration_json(example(drift=DriftTables(static=static)))
    path = tmp_path / "c.json"
    for marks_, text in (
        ([1, 0], "at drift.static.gyro_extrapolated.0: Input should be a valid boolean"),
        ([True], r"StaticDrift.gyro_extrapolated: wanted shape \(2,\), got \(1,\); one mark for each node"),
    ):
        content["drift"]["static"]["gyro_extrapolated"] = marks_
        path.write_text(json.dumps(content))
        with pytest.raises(FileFormatError, match=text):
            read_calibration(path)


def test_a_warm_up_begins_at_power_on_and_ends_at_zero() -> None:
    with pytest.raises(InputError, match="wanted nodes from 0 s to an offset of zero, got 5 s and 0 at the end"):
        WarmUp(power_on_s=[5.0, 9.0], gyro_offset=np.zeros((2, 3)))
    with pytest.raises(InputError, match="got 0 s and 2 at the end; put the settled offset into the static table"):
        WarmUp(power_on_s=[0.0, 9.0], gyro_offset=[[5.0, 5.0, 5.0], [0.0, -2.0, 0.0]])


@pytest.mark.parametrize("name", ["lag_s", "lag_smooth_s"])
def test_a_lag_below_zero_is_refused_in_value_and_file(name: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="wanted lag_s and lag_smooth_s of 0 s or more"):
        DriftTables(**{name: -1.0})
    content = calibration_json(example(drift=DriftTables(**{"lag_smooth_s": 1.0, name: 2.0})))
    assert content["drift"][name] == 2.0
    content["drift"][name] = -1.0
    (tmp_path / "c.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match="with a lag the smoothing above 0, got 3 and 0; "):
        DriftTables(lag_s=3.0)
    with pytest.raises(FileFormatError, match=f"at drift.{name}: Input should be greater than or equal to 0"):
        read_calibration(tmp_path / "c.json")


def test_the_schema_names_every_key_that_is_written() -> None:
    schema = schema_of(Calibration)
    assert set(schema["properties"]) == {
        *calibration_json(example()),
        "file_map",
        "magnetometer",
        "mounting",
    }  # these where there is one
    assert schema["additionalProperties"] is False
    assert set(schema["$defs"]["TriadModel"]["required"]) == set(calibration_json(example())["accel"])
