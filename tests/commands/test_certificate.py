"""undrift certificate: a page from the bench's calibration, and what is refused without a trace."""

from dataclasses import replace

import numpy as np
import pytest

from testkit.command_line import contents
from undrift.calibration.calibrate import calibrate
from undrift.io.store import content_hash, read_calibration
from undrift.report.certificate import certificate_report, departures
from undrift.sim.device.presets import random_device
from undrift.sim.sessions import simulate_session


def test_writes_a_page_and_says_its_hash(undrift, bench, tmp_path):
    output = tmp_path / "c.html"
    answer = undrift.good("certificate", bench / "calibration.json", "-o", output, "--json").json()
    assert "<h1>Calibration certificate</h1>" in output.read_text()
    assert list(contents(tmp_path)) == ["c.html"]
    assert answer["data"]["content_sha256"] == content_hash(read_calibration(bench / "calibration.json"))
    assert {"accelerometers_results", "gyroscopes_results", "gyroscopes_uncertainty_budget"} <= answer["tables"].keys()


def test_refuses_another_ending_in_one_line_and_writes_nothing(undrift, bench, tmp_path):
    assert "name ending in .html" in undrift.refused(
        "certificate", bench / "calibration.json", "-o", tmp_path / "c.txt"
    )
    assert list(contents(tmp_path)) == []


# ---- what the laboratory states

STATED = ("--number", "K-117", "--laboratory", "Motion laboratory, Bern", "--operator", "R. Muster")


def test_statements_are_on_the_page_and_the_rest_are_blank_lines(undrift, bench, tmp_path):
    words = ("certificate", bench / "calibration.json", "-o", tmp_path / "c.html", *STATED)
    stated = undrift.good(*words, "--json").data()["statement"]
    assert [*stated.values()] == ["K-117", "Motion laboratory, Bern", "R. Muster"]
    page = (tmp_path / "c.html").read_text()
    for text in stated.values():
        assert f"<dd>{text}</dd>" in page
    assert page.count('class="blank"') == 7


@pytest.mark.parametrize("text", ["gyro_ofset_dps = 1", "accel_offset_mg = 0", "accel_offset_mg = 'x'", "accel ="])
def test_limits_that_are_none_are_refused(undrift, bench, tmp_path, text):
    (tmp_path / "limits.toml").write_text(text)
    out = ("-o", tmp_path / "c.html", "--limits", tmp_path / "limits.toml")
    assert "limits.toml: expected" in undrift.refused("certificate", bench / "calibration.json", *out)


def test_limits_are_decided_by_the_departure(unit):
    made = unit[1]
    gyro = replace(
        made.gyro, unit_in="dps", matrix=made.gyro.matrix * 0.0 + np.eye(3) * 0.0174532925 / 1.02, offset=np.ones(3)
    )
    value, expanded = departures("gyro", gyro)["scale"]
    assert value == pytest.approx(2.0, rel=1e-3)
    assert expanded > 0.0
    (judged,) = certificate_report(replace(made, gyro=gyro), {"gyro_scale_percent": 2.1, "gyro_offset_dps": 0.5}).tables
    assert [row[-1] for row in judged.rows] == ["within", "outside"]


def test_counts_have_no_nominal_scale(unit):
    (judged,) = certificate_report(unit[1], {"gyro_scale_percent": 1.0, "gyro_cross_percent": 5.0}).tables
    assert [row[-1] for row in judged.rows] == ["nominal unknown", "within"]


# ---- conformity


@pytest.fixture(scope="module")
def unit():
    """A unit of a part, and its calibration on a bench."""
    rng = np.random.default_rng(20)
    device = random_device(rng, grade="mpu6050")
    return device, calibrate(simulate_session("bench", device, rng=rng))
