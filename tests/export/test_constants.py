"""Constants at one temperature: JSON and C header give what the corrector does there."""

import json
import re
import subprocess
from dataclasses import replace

import numpy as np
import pytest

from testkit.c_build import STRICT
from testkit.full_calibration import ROUNDINGS, STEPS, device, record, tables, with_magnetometer
from undrift.correction.correct import correct
from undrift.errors import InputError
from undrift.export import ExportOptions
from undrift.export.c import export_c
from undrift.export.constants import write_constants
from undrift.record import FileMap

U = np.array([100.0, -200.0, 300.0])


def corrected_at_40(made):
    """Return rate and specific force of one reading at 40 degC, without the dynamic table."""
    bare = replace(made, drift=replace(made.drift, dynamic=None))
    done = correct(record(2, gyro=np.tile(U, (2, 1)), accel=np.tile(U, (2, 1)), temp_c=np.full(2, 40.0)), bare)
    return done.gyro[0], done.accel[0]


def test_json_constants_correct_as_the_corrector_does():
    model = device(drift=tables(scale=STEPS[::2]))
    exported = write_constants(model, ExportOptions(temp_c=40.0), "a.json")
    content = json.loads(exported.files["a.json"])
    assert (content["kind"], content["format"], content["device"], content["temp_c"]) == (
        "undrift.constants",
        1,
        "A",
        40,
    )
    gyro, accel = content["gyro"], content["accel"]
    assert (gyro["unit_in"], gyro["unit_out"], accel["unit_out"]) == ("count", "rad/s", "m/s2")
    w, a = corrected_at_40(model)
    force = np.array(accel["matrix"]) @ (U - accel["offset"])
    np.testing.assert_allclose(force, a, rtol=1e-12)
    rate = np.array(gyro["matrix"]) @ (U - gyro["offset"]) - np.array(gyro["g_sensitivity"]) @ force
    np.testing.assert_allclose(rate, w, rtol=1e-12)
    not_carried = " | ".join(exported.not_carried)
    for part in ("static table", "dynamic table", "scale table", "uncertainties"):
        assert part in not_carried
    assert "g-sensitivity" not in not_carried
    assert "tables over temperature are evaluated at 40 degC" in exported.notes


def test_scale_of_the_map_is_noted():
    gain = [0.1, 0.1, -0.1]
    model = replace(device(), file_map=FileMap(json.dumps({"scale": {"accel": {"gain": gain, "offset": 0.0}}})))
    note = f"accel: apply the scale of the map first, gain {gain} and offset 0.0"
    assert note in write_constants(model, ExportOptions(), "a.json").notes
    assert note in export_c(model).notes


def test_c_header_holds_the_same_numbers(tmp_path):
    model = device(drift=tables(), device="A*/ x")
    options = ExportOptions(temp_c=40.0, prefix="foot")
    header = write_constants(model, options, "a.h").files["a.h"]
    (tmp_path / "a.h").write_text(header)
    (tmp_path / "main.c").write_text(
        '#include <stdio.h>\n#include "a.h"\nint main(void)\n{\n    const float *m = &foot_gyro_matrix[0][0];\n    int k;\n'
        '    for (k = 0; k < 9; k++) printf("%.9g\\n", (double)m[k]);\n'
        '    printf("%.9g %.9g ", (double)foot_gyro_offset[2], (double)foot_accel_matrix[2][1]);\n'
        '    printf("%.9g\\n", (double)foot_accel_offset[0]);\n'
        "    return foot_gyro_g_sensitivity[0][0] > 1e9f;\n}\n"
    )
    subprocess.run(["gcc", *STRICT, tmp_path / "main.c", "-o", tmp_path / "run"], check=True)
    got = subprocess.run([tmp_path / "run"], capture_output=True, text=True, check=True).stdout.split()
    content = json.loads(write_constants(model, options, "a.json").files["a.json"])
    wanted = [*np.ravel(content["gyro"]["matrix"]), content["gyro"]["offset"][2]]
    wanted += [content["accel"]["matrix"][2][1], content["accel"]["offset"][0]]
    np.testing.assert_allclose(np.array(got, float), wanted, rtol=1e-6)
    assert len(re.findall(r"[*]/", header.splitlines()[0] + header.splitlines()[1])) == 1


def test_a_triad_without_a_model_is_left_out_and_named():
    exported = write_constants(device(accel=None, drift=None), ExportOptions(), "a.json")
    assert json.loads(exported.files["a.json"])["accel"] is None
    assert "no accelerometer constants, because the calibration has no accelerometer model" in exported.notes


def test_a_temperature_outside_the_tables_is_refused():
    with pytest.raises(InputError) as caught:
        write_constants(device(drift=tables()), ExportOptions(temp_c=90.0), "a.json")
    assert caught.value.numbers == {"low": 18.0, "high": 75.0}


def test_parts_beyond_constants_are_named():
    model = device(drift=replace(tables(), lag_s=30.0, lag_smooth_s=5.0), adc=ROUNDINGS[2])
    model = with_magnetometer(replace(model, gyro=replace(model.gyro, moving_offset=np.full(3, 1e-3))))
    parts = " | ".join(write_constants(model, ExportOptions(temp_c=40.0), "a.json").not_carried)
    for text in ("code step", "from motion to rest", "magnetometer", "lag of 30 s"):
        assert text in parts
