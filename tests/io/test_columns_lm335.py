"""The voltage of an LM335 is a temperature, trimmed at one point; what it cannot have said is refused."""

import math

import pytest

from undrift.errors import FileFormatError, InputError
from undrift.io.columns import ColumnMap, Trim
from undrift.io.formats import read_record
from undrift.io.session import read_session
from undrift.units import canonical_unit, temp_offset

HEAD = "t,gx,gy,gz,T\n"
MAP = {
    "time": "t",
    "gyro": ("gx", "gy", "gz"),
    "temp": "T",
    "time_unit": "s",
    "gyro_unit": "dps",
    "temp_unit": "lm335_v",
}


def written(tmp_path, volts, head=HEAD):
    rows = [f"{0.1 * k:g},0,0,{k},{v}" for k, v in enumerate(volts)]
    path = tmp_path / "log.csv"
    path.write_text(head + "\n".join(rows) + "\n")
    return path


def test_ten_millivolts_a_kelvin(tmp_path):
    path = written(tmp_path, (2.7315, 2.9815, 3.4815))
    assert read_record(path, ColumnMap(**MAP)).temp_c == pytest.approx(
        [0.0, 25.0, 75.0], abs=1e-9
    )  # 0.010 V/K, data sheet


def test_its_own_column_name_needs_no_map(tmp_path):
    path = written(tmp_path, (2.9815, 2.9915), "time_s,gyro_x_dps,gyro_y_dps,gyro_z_dps,temp_lm335_v\n")
    assert read_record(path).temp_c == pytest.approx([25.0, 26.0], abs=1e-9)


def test_a_trim_turns_the_line_about_absolute_zero(tmp_path):
    path = written(tmp_path, (2.9925, 3.0925))  # says 26.1 and 36.1 degC
    made = read_record(path, ColumnMap(**MAP, temp_trim=Trim(reads_c=26.1, true_c=25.0)))
    assert made.temp_c == pytest.approx([25.0, 25.0 + 10.0 * 298.15 / 299.25], abs=1e-9)


def test_a_session_file_states_scale_unit_and_trim(tmp_path):
    written(tmp_path, (2442, 2450))  # codes of 5 V / 4096
    (tmp_path / "session.toml").write_text(
        '[session]\nkind = "thermal"\nserial = "A"\ngravity_m_s2 = 9.81\n[[recording]]\nfile = "log.csv"\n'
        'columns = { time = "t", gyro = ["gx", "gy", "gz"], temp = "T" }\n'
        'units = { time = "s", gyro = "count", temp = "LM335_V" }\n'
        "scale = { temp = { gain = 0.001220703125 } }\ntemp_trim = { reads_c = 25.0, true_c = 24.0 }\n"
    )
    (record,) = read_session(tmp_path).records
    said = 2442 * 5.0 / 4096 * 100.0
    assert record.temp_c[0] == pytest.approx(said * 297.15 / 298.15 - 273.15, abs=1e-9)


@pytest.mark.parametrize("bad", ["0", "25", "-2.98"])
def test_what_an_lm335_cannot_say_is_refused(tmp_path, bad):
    path = written(tmp_path, (2.98, bad))
    words = rf"column 'T': wanted 2.33 to 3.98 V of an LM335 .*, got {bad} V in data row 2 \(1 such\); check its wiring"
    with pytest.raises(FileFormatError, match=words):
        read_record(path, ColumnMap(**MAP))


def test_an_empty_cell_is_a_gap_only_on_request(tmp_path):
    path = written(tmp_path, (2.98, ""))
    with pytest.raises(InputError, match="got 1 empty or NaN cells, first in data row 2"):
        read_record(path, ColumnMap(**MAP))
    assert math.isnan(read_record(path, ColumnMap(**MAP, gaps="keep")).temp_c[1])


@pytest.mark.parametrize(
    ("trim", "changes", "words"),
    [
        ((200.0, 25.0), {}, r"temp_trim.reads_c: wanted -40 to 125 degC, got 200"),
        ((25.0, float("nan")), {}, r"temp_trim.true_c: wanted -40 to 125 degC, got nan"),
        ((50.0, 25.0), {}, "temp_trim: wanted a reading within 20 K of the truth, got 50 for 25"),
        ((26.0, 25.0), {"temp_unit": "degC"}, 'temp_trim: wanted units.temp = "lm335_v" beside it, got degC'),
        ((26.0, 25.0), {"temp": None}, 'temp_trim: wanted units.temp = "lm335_v"'),
    ],
)
def test_a_trim_that_cannot_be_is_refused(trim, changes, words):
    with pytest.raises(InputError, match=words):
        ColumnMap(**{**MAP, **changes}, temp_trim=Trim(reads_c=trim[0], true_c=trim[1]))


def test_plain_volts_are_no_temperature():
    with pytest.raises(InputError, match=r'units.temp: wanted degC, got v; .*or "lm335_v" for an LM335 in V'):
        ColumnMap(**{**MAP, "temp_unit": "v"})
    with pytest.raises(InputError, match="temp: wanted a physical unit, got v"):
        temp_offset(canonical_unit("volt", "temp"))
