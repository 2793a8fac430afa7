"""The exported C source against correction/correct.py: float and double, every step of the model, extreme inputs, and what
is refused."""

import re
import subprocess
from dataclasses import replace

import numpy as np
import pytest

from testkit.c_build import STRICT, UNDEFINED, build, write
from testkit.data import show
from testkit.full_calibration import GAP, ROUNDINGS, STEPS, WILD, device, record, tables
from undrift.correction.correct import correct_checked
from undrift.errors import InputError
from undrift.export import ExportOptions
from undrift.export.c import export_c, literal
from undrift.model import Provenance, Verdict

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
    for arithmetic in ("double", "float"):
        run = build(exported, tmp_path, arithmetic)
        inputs = run.inputs(r.gyro, r.accel, r.temp_c)
        gyro, accel, temp_c = run.real(inputs)
        w, a, status = run(inputs)
        w_python, a_python, outside = corrected(calibration, gyro, accel, temp_c, unit)
        np.testing.assert_array_equal((status & 1).astype(bool), outside)
        # float: 24 bits, 6e-8, a dozen operations in a row; double: far below the 1e-6 that is promised
        limits = [(1e-6 if arithmetic == "float" else 1e-13) * size for size in sizes_of(calibration, gyro, accel)]
        for name, c, python, limit in (("gyro", w, w_python, limits[0]), ("accel", a, a_python, limits[1])):
            ratio = float((np.abs(c - python) / limit).max())
            show(f"{kind}, {arithmetic}, {name}: worst error over its limit", f"{ratio:.3g}", 1)
            assert ratio <= 1.0
        if arithmetic == "double":  # of each value, wherever its terms do not cancel to less than a millionth
            large = np.abs(w_python) > 1e-6 * sizes_of(calibration, gyro, accel)[0]
            assert np.abs(w / np.where(large, w_python, np.nan) - 1.0)[large].max() < 1e-6


@pytest.mark.parametrize("kind", ["even", "searched"])
@pytest.mark.parametrize("arithmetic", ["float", "double"])
def test_extreme_inputs_do_nothing_undefined(kind, arithmetic, tmp_path):
    exported = export_c(device(**KINDS[kind]))
    run = build(exported, tmp_path, arithmetic, *UNDEFINED)
    rng = np.random.default_rng(2)
    wild = np.array([0.0, -0.0, np.inf, -np.inf, np.nan, 1e30, -1e30, 1e-30, 25.0])
    inputs = rng.choice(wild, (4000, 7)).astype("f4" if arithmetic == "float" else "f8")
    _, _, status = run(inputs)
    assert ((status >= 0) & (status <= 3)).all()


def test_output_may_be_the_input(tmp_path):
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


@pytest.mark.parametrize("arithmetic", ["float", "double"])
def test_there_is_no_state_and_no_library(arithmetic, tmp_path):
    write(export_c(device(**KINDS["searched"])), tmp_path)
    words = ["gcc", *STRICT, "-O0", "-c", f"-DUNDRIFT_{arithmetic.upper()}", tmp_path / "undrift.c"]
    subprocess.run([*words, "-o", tmp_path / "u.o"], check=True)
    symbols = subprocess.run(["nm", "-S", tmp_path / "u.o"], capture_output=True, text=True, check=True).stdout
    assert not re.findall(r" [UbBdDC] ", symbols)  # nothing undefined, nothing writable


def test_the_header_says_what_a_reader_must_know():
    calibration = device(
        drift=tables(), verdict=Verdict(status="marginal"), provenance=Provenance(created="2026-01-02T03:04:05Z")
    )
    header = export_c(calibration, date="2026-05-06").header
    for text in ("sensor A", "2026-01-02", "2026-05-06", "marginal", "rad/s", "m/s2", "degC", "frame b", "count",
                 "18 to 75 degC", "Order of the steps"):  # fmt: skip
        assert text in header, text
    assert "defined(UNDRIFT_DOUBLE)" in header
    assert max(len(line) for line in header.splitlines()) <= 130


def test_a_serial_number_cannot_break_out_of_the_comment(tmp_path):
    evil = device(device="A*/ int x; /* ??/\n#error \\")
    build(export_c(evil), tmp_path, "float")


@pytest.mark.slow
@pytest.mark.parametrize("arithmetic", ["float", "double"])
def test_triad_without_a_model_is_nominal_as_in_python(arithmetic, tmp_path):
    for name, unit in (("accel", "m/s2"), ("gyro", "rad/s")):
        model = device(**{name: None})
        run = build(export_c(model), tmp_path, arithmetic)
        r = record(300, **{f"{name}_unit": unit})
        r = replace(r, **{name: getattr(r, name) * 0.003, "temp_c": np.full(300, 25.0)})  # 3 g rms
        inputs = run.inputs(r.gyro, r.accel, r.temp_c)
        gyro, accel, _ = run.real(inputs)
        python = correct_checked(replace(r, gyro=gyro, accel=accel), model, policy="hold").record
        w, a, status = run(inputs)
        assert not status.any()
        share = {"float": 1e-6, "double": 1e-13}[arithmetic]  # of the largest
        for c, wanted in ((w, python.gyro), (a, python.accel)):
            limit = share * (np.abs(wanted).max() + 30.0)  # offsets of 30 cancel
            assert (np.abs(c - wanted) <= limit).all(), (name, unit)


def test_uncertainty_is_the_only_part_left_out():
    (part,) = export_c(device(drift=tables(), adc=ROUNDINGS[1])).not_carried
    assert "uncertainties" in part


def test_what_is_refused():
    with pytest.raises(InputError, match="no model of"):
        export_c(device(gyro=None, accel=None))
    bad = device(drift=None)
    with pytest.raises(InputError, match="gyro contains 3 NaN"):
        export_c(replace(bad, gyro=replace(bad.gyro, offset=np.full(3, np.nan))))
    for prefix in ("Undrift", "1a", "a-b", "", "a" * 40):
        with pytest.raises(InputError, match="prefix must be"):
            export_c(bad, ExportOptions(prefix=prefix))
    with pytest.raises(InputError, match=r"1e\+300 is beyond"):
        literal(1e300)
