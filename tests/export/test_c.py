"""The exported C source against correction/correct.py: three arithmetics, every step of the model, extreme inputs, and what
is refused."""

import re
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from testkit.c_build import STRICT, bits_of, build, write
from testkit.data import show
from testkit.full_calibration import GAP, ROUNDINGS, STEPS, WILD, device, record, tables
from testkit.strategies import few
from undrift.correction.correct import correct_checked
from undrift.errors import InputError
from undrift.export import ExportOptions
from undrift.export.c import export_c, literal
from undrift.export.firmware import FULL_FORCE, FULL_RATE
from undrift.model import AdcModel, Provenance, StaticDrift, Verdict, WarmUp

KINDS = {
    "constant": {"drift": None},
    "without g": {"drift": tables(), "g": False},
    "even": {"drift": tables(), "adc": ROUNDINGS[1]},
    "scale": {"drift": tables(static=None, scale=STEPS[::2], dynamic=None), "adc": ROUNDINGS[2]},
    "searched": {"drift": tables(static=WILD, scale=WILD, dynamic=(WILD, np.array([-1.0, -0.31, 0.0, 0.7, 1.1])))},
    "filled": {"drift": tables(scale=np.array([10.0, 30.0, 80.0]), dynamic=(np.array([18.0, 20.0, 26.0, 75.0]), GAP))},
    "gyro table only": {"drift": tables(accel=False)},
    "physical": {"unit": "si", "drift": None},
    "codes": {"drift": None, "codes": np.array([0.4, -0.3, 0.7])},
}


def corrected(calibration, gyro, accel, temp_c, unit):
    r = record(len(temp_c), gyro=gyro, accel=accel, temp_c=temp_c, unit=unit)
    done = correct_checked(r, calibration, policy="hold")
    return done.record.gyro, done.record.accel, done.outside


def sizes_of(calibration, gyro, accel):
    """The size of the terms that are summed, per axis: what a rounding error of float is relative to."""
    terms = []
    for name, u in (("gyro", gyro), ("accel", accel)):
        m = getattr(calibration, name)
        drift, offset, gain = calibration.drift, np.abs(m.offset), np.abs(m.matrix)
        if drift is not None and drift.static is not None and getattr(drift.static, f"{name}_offset") is not None:
            offset = np.abs(getattr(drift.static, f"{name}_offset")).max(axis=0)
        if drift is not None and drift.scale is not None and getattr(drift.scale, f"{name}_matrix") is not None:
            gain = np.abs(getattr(drift.scale, f"{name}_matrix")).max(axis=0)
        terms.append((np.abs(u) + offset) @ gain.T)
    if calibration.gyro.g_sensitivity is not None:
        terms[0] = terms[0] + terms[1] @ np.abs(calibration.gyro.g_sensitivity).T
    if calibration.drift is not None and calibration.drift.dynamic is not None:
        terms[0] = terms[0] + np.abs(calibration.drift.dynamic.error).max()
    return terms


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_every_build_agrees_with_the_corrector(kind, tmp_path):
    options = dict(KINDS[kind])
    unit, codes = options.get("unit", "count"), options.pop("codes", None)
    calibration = device(**options)
    calibration = replace(calibration, gyro=replace(calibration.gyro, code_offset=codes))
    exported = export_c(calibration)
    r = record(4000, low=10.0, high=82.0, unit=unit)  # beyond the ends of the tables too
    bounds = {"fixed": (exported.gyro_bound, exported.accel_bound)}
    for arithmetic in ("double", "float", "fixed"):
        run = build(exported, tmp_path, arithmetic)
        inputs = run.inputs(r.gyro, r.accel, r.temp_c)
        gyro, accel, temp_c = run.real(inputs)
        w, a, status = run(inputs)
        w_python, a_python, outside = corrected(calibration, gyro, accel, temp_c, unit)
        np.testing.assert_array_equal((status & 1).astype(bool), outside)
        assert not (status & 4).any()
        if arithmetic == "fixed":
            limits = bounds["fixed"]
        else:  # float: 24 bits, 6e-8, a dozen operations in a row; double: far below the 1e-6 that is promised
            limits = [(1e-6 if arithmetic == "float" else 1e-13) * size for size in sizes_of(calibration, gyro, accel)]
        for name, c, python, limit in (("gyro", w, w_python, limits[0]), ("accel", a, a_python, limits[1])):
            ratio = float((np.abs(c - python) / limit).max())
            show(f"{kind}, {arithmetic}, {name}: worst error over its limit", f"{ratio:.3g}", 1)
            assert ratio <= 1.0
        if arithmetic == "double":  # of each value, wherever its terms do not cancel to less than a millionth
            large = np.abs(w_python) > 1e-6 * sizes_of(calibration, gyro, accel)[0]
            assert np.abs(w / np.where(large, w_python, np.nan) - 1.0)[large].max() < 1e-6


@st.composite
def calibrations(draw):
    """Random devices: units, gains over five decades, tables of any shape, rounding, g-sensitivity."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    gain = 10.0 ** draw(st.floats(-5.0, 0.0))

    def nodes(low, high, most):
        count = draw(st.integers(2, most))
        if draw(st.booleans()):
            return np.linspace(low, high, count)
        return np.sort(rng.choice(np.arange(200), count, replace=False)) * (high - low) / 200.0 + low

    static = nodes(-20.0, 80.0, 30) if draw(st.booleans()) else None
    scale = nodes(-10.0, 70.0, 9) if draw(st.booleans()) else None
    dynamic = (nodes(0.0, 60.0, 9), nodes(-6.0, 6.0, 20)) if draw(st.booleans()) else None
    drift = tables(static=static, scale=scale, dynamic=dynamic, accel=draw(st.booleans()))
    made = device(g=draw(st.booleans()), drift=drift, adc=draw(st.sampled_from(ROUNDINGS)))
    size = draw(st.sampled_from([0.0, 1.0, 30.0, 12000.0]))
    gyro = replace(made.gyro, matrix=made.gyro.matrix * 1e3 * gain, offset=rng.normal(size=3) * size)
    accel = replace(made.accel, matrix=made.accel.matrix * 2e2 * gain, offset=rng.normal(size=3) * size)
    if drift.scale is not None:
        s = drift.scale
        s = replace(
            s,
            gyro_matrix=s.gyro_matrix * 1e3 * gain,
            accel_matrix=None if s.accel_matrix is None else s.accel_matrix * 2e2 * gain,
        )
        made = replace(made, drift=replace(drift, scale=s))
    return replace(made, gyro=gyro, accel=accel)


def at(calibration, name, temp_c):
    """Matrix and offset of a triad at each temperature."""
    model, drift = getattr(calibration, name), calibration.drift
    matrix = np.tile(model.matrix, (len(temp_c), 1, 1))
    offset = np.tile(model.offset, (len(temp_c), 1))
    if drift.static is not None and (y := getattr(drift.static, f"{name}_offset")) is not None:
        offset = np.column_stack([np.interp(temp_c, drift.static.temp_c, c) for c in y.T])
    if drift.scale is not None and (y := getattr(drift.scale, f"{name}_matrix")) is not None:
        flat = [np.interp(temp_c, drift.scale.temp_c, c) for c in y.reshape(-1, 9).T]
        matrix = np.column_stack(flat).reshape(-1, 3, 3)
    return matrix, offset


@pytest.mark.slow
@settings(few, max_examples=12)
@given(calibrations(), st.integers(0, 1000))
def test_fixed_point_stays_within_its_stated_bound(tmp_path_factory, calibration, seed):
    exported = export_c(calibration)
    run = build(exported, tmp_path_factory.mktemp("c"), "fixed", "-O0")
    rng = np.random.default_rng(seed)
    room = [2.0 ** (31 - bits) for bits in bits_of(exported)]

    temp_c = rng.uniform(-40.0, 90.0, 400)

    def readings(name, full, held):
        matrix, offset = at(calibration, name, temp_c)
        true = rng.uniform(-full, full, (400, 3)) * rng.choice([1.0, 0.1, 0.01], (400, 1))
        u = np.linalg.solve(matrix, true[..., None])[..., 0]
        least = ((0.999 * held - np.abs(offset)) / np.abs(u)).min(axis=1)  # codes that the format holds
        return u * np.minimum(1.0, least)[:, None] + offset

    inputs = run.inputs(readings("gyro", FULL_RATE, room[0]), readings("accel", FULL_FORCE, room[1]), temp_c)
    gyro, accel, temp_c = run.real(inputs)
    w, a, status = run(inputs)
    w_python, a_python, _ = corrected(calibration, gyro, accel, temp_c, "count")
    # the bound is stated for results of at most 2000 deg/s and 16 g, and for what nothing limited
    a_holds = (np.abs(a_python) <= FULL_FORCE).all(axis=1) & (status & 4 == 0)
    w_holds = (np.abs(w_python) <= FULL_RATE).all(axis=1) & a_holds
    assert w_holds.mean() > 0.3
    assert (np.abs(a - a_python)[a_holds] <= exported.accel_bound).all()
    assert (np.abs(w - w_python)[w_holds] <= exported.gyro_bound).all()


EXTREMES = np.array([-(2**31), -(2**31) + 1, -65536, -1, 0, 1, 65535, 2**30, 2**31 - 1])


@pytest.mark.parametrize("kind", ["even", "searched", "loud"])
@pytest.mark.parametrize("arithmetic", ["float", "fixed"])
def test_extreme_inputs_do_nothing_undefined(kind, arithmetic, tmp_path):
    made = device(**KINDS["without g" if kind == "loud" else kind])
    if kind == "loud":  # results that 32 bits do not hold
        made = replace(
            made, gyro=replace(made.gyro, matrix=made.gyro.matrix * 1e4, g_sensitivity=np.full((3, 3), -9.0))
        )
    exported = export_c(made)
    run = build(
        exported, tmp_path, arithmetic, "-O1", "-fsanitize=undefined,float-cast-overflow", "-fno-sanitize-recover=all"
    )
    rng = np.random.default_rng(2)
    if arithmetic == "fixed":
        inputs = rng.choice(EXTREMES, (4000, 7)).astype("i4")
        inputs[:9, :] = EXTREMES[:, None]
    else:
        wild = np.array([0.0, -0.0, np.inf, -np.inf, np.nan, 1e30, -1e30, 1e-30, 25.0])
        inputs = rng.choice(wild, (4000, 7)).astype("f4" if arithmetic == "float" else "f8")
    w, a, status = run(inputs)
    assert ((status >= 0) & (status <= 7)).all()
    if arithmetic == "fixed":
        assert np.abs(np.column_stack((w, a))).max() <= 2.0**15
        assert (status & 4).any() == (kind == "loud")


def test_a_saturated_result_has_the_sign_of_the_exact_one(tmp_path):
    calibration = device(g=False, drift=None)
    calibration = replace(calibration, gyro=replace(calibration.gyro, matrix=np.eye(3) * 100.0))
    run = build(export_c(calibration), tmp_path, "fixed")
    w, _, status = run(run.inputs([[3e4, -3e4, 1.0]], [[0.0] * 3], [25.0]))
    assert status.tolist() == [4]
    assert w[0, 0] == pytest.approx(2.0**15, abs=1e-4)
    assert w[0, 1] == pytest.approx(-(2.0**15), abs=1e-4)


def test_a_reading_at_the_end_of_its_range_does_not_saturate_for_its_offset(tmp_path):
    made = device(g=False, drift=None)
    made = replace(made, gyro=replace(made.gyro, offset=np.array([9000.0, -9000.0, 16000.0])))
    exported = export_c(made)
    run = build(exported, tmp_path, "fixed")
    inputs = run.inputs([[-32768.0, 32767.0, -32768.0]], [[0.0] * 3], [25.0])
    w, _, status = run(inputs)
    gyro, accel, temp_c = run.real(np.repeat(inputs, 2, axis=0))
    assert status.tolist() == [0]
    python = corrected(made, gyro, accel, temp_c, "count")[0][0]
    assert (np.abs(w[0] - python) <= 1.5 * exported.gyro_bound).all()  # up to 48 rad/s; stated for 35


def test_the_output_may_be_the_input_and_two_devices_fit_into_one_program(tmp_path):
    one, two = export_c(device()), export_c(device(g=False), ExportOptions(prefix="other"), header_name="other.h")
    write(one, tmp_path)
    (tmp_path / "other.h").write_text(two.header)
    (tmp_path / "other.c").write_text(two.source)
    (tmp_path / "main.c").write_text(
        '#include "undrift.h"\n#include "other.h"\nint main(void)\n{\n'
        "    undrift_t u[3] = {1, 2, 3}, v[3] = {4, 5, 6}, w[3], a[3];\n    other_t x[3] = {1, 2, 3}, y[3] = {4, 5, 6};\n"
        "    (void)undrift_correct(u, v, 25, w, a);\n    (void)undrift_correct(u, v, 25, u, v);\n"
        "    (void)other_correct(x, y, 25, x, y);\n"
        "    return u[0] == w[0] && u[2] == w[2] && v[1] == a[1] && x[0] != u[0] ? 0 : 1;\n}\n"
    )
    words = ["gcc", *STRICT, *(tmp_path / f for f in ("undrift.c", "other.c", "main.c")), "-o", tmp_path / "both"]
    subprocess.run(words, check=True)
    assert subprocess.run([tmp_path / "both"], check=False).returncode == 0


@pytest.mark.parametrize("arithmetic", ["float", "double", "fixed"])
def test_constants_have_the_size_that_is_stated_and_there_is_no_state_and_no_library(arithmetic, tmp_path):
    exported = export_c(device(**KINDS["searched"]))
    write(exported, tmp_path)
    words = ["gcc", *STRICT, "-O0", "-c", f"-DUNDRIFT_{arithmetic.upper()}", tmp_path / "undrift.c"]
    subprocess.run([*words, "-o", tmp_path / "u.o"], check=True)
    symbols = subprocess.run(["nm", "-S", tmp_path / "u.o"], capture_output=True, text=True, check=True).stdout
    assert not re.findall(r" [UbBdDC] ", symbols)  # nothing undefined, nothing writable
    stated = next(c for c in exported.costs if c.arithmetic == arithmetic)
    assert sum(int(size, 16) for size in re.findall(r"^\S+ (\S+) r ", symbols, re.M)) == stated.table_bytes
    assert (
        f"{stated.table_bytes} + {stated.code_bytes} = {stated.flash_bytes} bytes, {stated.cycles} cycles"
        in exported.header
    )
    words[words.index("-O0")] = "-Os"
    subprocess.run([*words, "-o", tmp_path / "s.o"], check=True)
    sections = subprocess.run(["size", "-A", tmp_path / "s.o"], capture_output=True, text=True, check=True).stdout
    code = int(re.findall(r"^\.text\s+(\d+)", sections, re.M)[0])
    show(
        f"{arithmetic}: code on this machine, bytes",
        code,
        f"estimate {stated.code_bytes} for another processor, factor 2",
    )
    assert 0.5 < code / stated.code_bytes < 2.0 or arithmetic == "double"  # double is done by a library there


def test_the_header_says_what_a_reader_must_know():
    calibration = device(
        drift=tables(), verdict=Verdict(status="marginal"), provenance=Provenance(created="2026-01-02T03:04:05Z")
    )
    header = export_c(calibration, ExportOptions(fixed=True), date="2026-05-06").header
    for text in ("sensor A", "2026-01-02", "2026-05-06", "marginal", "rad/s", "m/s2", "degC", "frame b", "count",
                 "18 to 75 degC", "Order of the steps", "bytes", "cycles", "Cortex-M4F", "at most"):  # fmt: skip
        assert text in header, text
    assert "#define UNDRIFT_FIXED\n" in header
    assert max(len(line) for line in header.splitlines()) <= 130


def test_a_serial_number_cannot_break_out_of_the_comment(tmp_path):
    evil = device(device="A*/ int x; /* ??/\n#error \\")
    build(export_c(evil), tmp_path, "float")


def test_what_is_not_carried_is_listed():
    static = StaticDrift(
        temp_c=[0.0, 1.0], gyro_offset=np.zeros((2, 3)), gyro_hysteresis=[1.0, 2.0, 3.0],
        warm_up=WarmUp(power_on_s=[0.0, 60.0], gyro_offset=[[1.0, 1.0, 1.0], [0.0, 0.0, 0.0]]),
    )  # fmt: skip
    drift = replace(tables(), static=static, lag_s=30.0, lag_smooth_s=5.0)
    exported = export_c(device(drift=drift, adc=ROUNDINGS[1]))
    said = " | ".join(exported.not_carried)
    assert "lag" not in said
    assert "the thermometer's lag of 30 s is removed by undrift_temperature" in " ".join(exported.notes)
    assert "power-on" not in said
    assert "uncertainties" in said
    assert "uncertainties" in exported.header
    for text in ("hysteresis", "code step", "g-sensitivity", "dynamic table", "gains"):
        assert text not in said


@pytest.mark.slow
@pytest.mark.parametrize("arithmetic", ["float", "double", "fixed"])
def test_a_triad_without_a_model_is_nominal_in_the_unit_that_is_named_as_it_is_in_python(arithmetic, tmp_path):
    for name, unit in (("accel", "g"), ("accel", None), ("gyro", "dps")):
        made = device(**{name: None})
        exported = export_c(made, ExportOptions(**({} if unit is None else {f"{name}_unit": unit})))
        run = build(exported, tmp_path, arithmetic)
        r = record(300, **{f"{name}_unit": {"g": "g", "dps": "deg/s", None: "m/s2"}[unit]})
        r = replace(r, **{name: getattr(r, name) * 0.003, "temp_c": np.full(300, 25.0)})  # 3 g rms
        inputs = run.inputs(r.gyro, r.accel, r.temp_c)
        gyro, accel, _ = run.real(inputs)
        python = correct_checked(replace(r, gyro=gyro, accel=accel), made, policy="hold").record
        w, a, status = run(inputs)
        assert not status.any()
        share = {"float": 1e-6, "double": 1e-13, "fixed": 0.0}[
            arithmetic
        ]  # of the largest; fixed point has its own bound
        for c, wanted, bound in ((w, python.gyro, exported.gyro_bound), (a, python.accel, exported.accel_bound)):
            limit = bound if arithmetic == "fixed" else share * (np.abs(wanted).max() + 30.0)  # offsets of 30 cancel
            assert (np.abs(c - wanted) <= limit).all(), (name, unit)


def test_the_header_says_the_unit_of_a_triad_without_a_model_and_defines_its_bits():
    exported = export_c(device(accel=None), ExportOptions(accel_unit="g"))
    assert "accelerometers have no model: nominal values are passed on; accel_raw is taken as g" in exported.notes
    assert "accel_raw: g, temperatures without a table" in exported.header
    assert "#define UNDRIFT_ACCEL_RAW_BITS 16" in exported.header
    assert "accel_raw is taken as m/s2" in export_c(device(accel=None)).header
    exported = export_c(device(gyro=None))
    assert "#define UNDRIFT_GYRO_RAW_BITS 16" in exported.header
    assert "gyroscopes have no model: nominal values are passed on; gyro_raw is taken as rad/s" in exported.notes
    with pytest.raises(
        InputError, match="wanted no unit of the accel, whose model is for count, got g; leave accel_unit out"
    ):
        export_c(device(), ExportOptions(accel_unit="g"))
    with pytest.raises(InputError, match="wanted a physical unit of the accel, which has no model, got count"):
        export_c(device(accel=None), ExportOptions(accel_unit="count"))


def test_unsigned_codes_get_the_room_that_they_need(tmp_path):
    made = device(g=False, drift=None)
    made = replace(made, gyro=replace(made.gyro, offset=np.array([33124.2, 33275.2, 32364.4])))
    exported = export_c(made)
    assert bits_of(exported) == (14, 16)
    run = build(exported, tmp_path, "fixed")
    inputs = run.inputs([[65535.0, 0.0, 32768.0]], [[0.0] * 3], [25.0])
    w, _, status = run(inputs)
    gyro, accel, temp_c = run.real(np.repeat(inputs, 2, axis=0))
    assert status.tolist() == [0]
    assert (np.abs(w[0] - corrected(made, gyro, accel, temp_c, "count")[0][0]) <= exported.gyro_bound).all()
    assert bits_of(export_c(made, ExportOptions(gyro_raw_bits=10))) == (10, 16)


def test_what_is_refused():
    with pytest.raises(
        InputError, match="wanted a model of gyroscopes or accelerometers, got neither; calibrate first"
    ):
        export_c(device(gyro=None, accel=None))
    bad = device(drift=None)
    with pytest.raises(InputError, match="wanted numbers throughout the model of the gyro, got 3 NaN"):
        export_c(replace(bad, gyro=replace(bad.gyro, offset=np.full(3, np.nan))))
    for prefix in ("Undrift", "1a", "a-b", "", "a" * 40):
        with pytest.raises(InputError, match="wanted a prefix of lower-case letters"):
            export_c(bad, ExportOptions(prefix=prefix))
    with pytest.raises(InputError, match="wanted 0 to 30 bits behind the point of a reading, got 31"):
        export_c(bad, ExportOptions(accel_raw_bits=31))
    with pytest.raises(InputError, match="fixed point, gyro: wanted gains that 32 bits hold"):
        export_c(replace(bad, gyro=replace(bad.gyro, matrix=np.eye(3) * 1e9)))
    big = replace(bad, gyro=replace(bad.gyro, offset=np.full(3, 4e4)))
    with pytest.raises(InputError, match="wanted offsets that leave room in 32 bits with 16 bits behind the point"):
        export_c(big, ExportOptions(gyro_raw_bits=16))
    close = StaticDrift(temp_c=[20.0, 20.0 + 1e-6, 75.0], gyro_offset=np.zeros((3, 3)))
    with pytest.raises(InputError, match="wanted nodes within 32767 and more than 1/65536 apart"):
        export_c(device(drift=replace(tables(), static=close)))
    with pytest.raises(InputError, match="wanted numbers that float holds, got 1e\\+300"):
        literal(1e300)
    adc = AdcModel(gyro_lsb=[1e12] * 3, gyro_rounding="floor")
    with pytest.raises(InputError, match="wanted offsets that leave room"):
        export_c(device(drift=None, adc=adc), ExportOptions(gyro_raw_bits=0))
