"""The protocol form: what is typed becomes protocol.toml, errors are the reader's own, the forecast is the command's."""

import io

import pytest

from undrift.cli.app import run
from undrift.errors import InputError
from undrift.rig.programme import read_protocol
from undrift.units import RADIAN_PER_DEGREE as DPS
from undrift.web.rate_table import ProtocolForm

NOBODY = "galil:tcp://127.0.0.1:9"


def test_the_defaults_are_a_protocol_of_six_faces_and_three_axes(tmp_path):
    path = tmp_path / "protocol.toml"
    path.write_text(ProtocolForm().toml())
    protocol = read_protocol(path)
    assert (protocol.name, len(protocol.faces), protocol.axes) == ("rate table", 6, ("x", "y", "z"))
    assert (protocol.dwell_s, protocol.bracket_s, protocol.temperatures_c) == (6.0, 6.0, ())
    assert [round(rate / DPS) for rate in protocol.turn_rates()][-6:] == [15, 30, 45, 60, 75, 90]


def test_what_is_typed_is_what_is_read(tmp_path):
    form = ProtocolForm(
        name='a "quoted"\nname',
        faces=("+z", "-z"),
        axes=("z",),
        face_s=" 2,5 ",
        order="random",
        temperatures_c="18; 30.5 45",
        soak_c_per_min="0.2",
        acceleration_dps2="1000",
    )
    path = tmp_path / "protocol.toml"
    path.write_text(form.toml())
    protocol = read_protocol(path)
    assert (protocol.name, protocol.faces, protocol.axes) == ('a "quoted"\nname', ("+z", "-z"), ("z",))
    assert (protocol.face_s, protocol.order, protocol.temperatures_c) == (2.5, "random", (18.0, 30.5, 45.0))
    assert (protocol.soak_c_per_min, round(protocol.acceleration / DPS)) == (0.2, 1000)


@pytest.mark.parametrize("temperatures", ["", "20, 40"])
def test_the_forecast_is_the_one_of_the_command(temperatures, tmp_path, capsys, monkeypatch):
    form = ProtocolForm(temperatures_c=temperatures)
    (tmp_path / "protocol.toml").write_text(form.toml())
    monkeypatch.setattr("sys.stdin", io.StringIO("n\n"))
    words = ["--rig", NOBODY, "--device", "tcp://127.0.0.1:9", "-o", str(tmp_path / "run")]
    assert run(["rig", "run", str(tmp_path / "protocol.toml"), *words]) == 2
    found = form.check(NOBODY)
    total = f"{round(found.total_s) // 3600:d}:{round(found.total_s) // 60 % 60:02d}:{round(found.total_s) % 60:02d}"
    err = capsys.readouterr().err
    assert f"\n{found.dwells} dwells, " in err
    assert f"with {found.mountings} mountings and the chamber about {total}\n" in err
    assert found.turn_rate / DPS == pytest.approx(90.0)
    assert (found.dwells, found.mountings) == (96 if temperatures else 48, 6)


@pytest.mark.parametrize(
    ("typed", "message"),
    [
        ({"dwell_s": "soon"}, "[rates], seconds: wanted a valid number, got 'soon'"),
        ({"turn_rate_max_dps": ""}, "[rates], turn_rate_max_dps: wanted a valid number, got ''"),
        ({"turn_rate_min_dps": "nan"}, "[rates], turn_rate_min_dps: wanted a valid number, got 'nan'"),
        ({"turn_rate_step_dps": "0"}, "turn_rate_step_dps: wanted greater than 0, got 0.0"),
        ({"turn_rate_step_dps": "14"}, "wanted a step that divides 75, got 14; try 15"),
        ({"temperatures_c": "30, 18"}, "wanted rising temperatures, got others"),
        ({"temperatures_c": "warm"}, "[temperatures], set_points_c 1: wanted a valid number, got 'warm'"),
        ({"turn_rate_max_dps": "900", "turn_rate_step_dps": "885"}, "wanted at most 360 deg/s, got 900"),
        ({"acceleration_dps2": "1e6"}, "acceleration: wanted at most 5000 deg/s2"),
        ({"faces": (), "axes": ()}, "wanted faces, rates or turns, got none"),
        ({"cutoff_hz": "-1"}, "wanted cutoff_hz of 0.001 or more, got -1"),
        ({"order": "upward"}, "order: wanted 'alternating' or 'random', got 'upward'"),
    ],
)
def test_what_is_wrong_is_said_in_the_readers_words_without_a_file(typed, message):
    with pytest.raises(InputError) as caught:
        ProtocolForm(**typed).check(NOBODY)
    assert message in str(caught.value)
    assert "/" not in str(caught.value).replace("deg/s", "")
    assert "protocol.toml" not in str(caught.value)


def test_rates_of_a_person_and_an_address_that_is_none_are_refused():
    with pytest.raises(InputError, match="which no operator holds"):
        ProtocolForm().check("manual:")
    with pytest.raises(InputError, match="rig: wanted one of galil:"):
        ProtocolForm().check("lathe:")
    assert ProtocolForm(axes=()).check("manual:").dwells == 6
