"""undrift certificate: a PDF from the bench's calibration, and what is refused without a trace."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.collections import PolyCollection

from testkit.command_line import contents
from undrift.calibration.calibrate import calibrate
from undrift.commands.certificate import Statement, certificate_content, conformity, departures
from undrift.commands.data_sheet import Specification
from undrift.errors import InputError
from undrift.io.session import write_session
from undrift.io.store import content_hash, read_calibration, write_calibration
from undrift.report.certificate import draw_calibration, write_certificate
from undrift.sim.device.presets import random_device_of
from undrift.sim.sessions import simulate_session


def test_writes_a_pdf_and_says_its_hash(undrift, bench, tmp_path):
    output = tmp_path / "c.pdf"
    answer = undrift.good("certificate", bench / "calibration.json", "-o", output, "--json").json()
    assert output.read_bytes().startswith(b"%PDF-")
    assert list(contents(tmp_path)) == ["c.pdf"]
    assert answer["content_sha256"] == content_hash(read_calibration(bench / "calibration.json"))
    assert [triad["title"] for triad in answer["triads"]] == ["Gyroscopes", "Accelerometers"]


def without_covariance(content):
    content["accel"]["covariance"] = [[None] * 12 for _ in range(12)]
    del content["accel"]["budget"]


def without_triads(content):
    content["gyro"] = content["accel"] = None


@pytest.mark.parametrize(
    ("change", "output", "text"),
    [
        (
            lambda content: content.update(kind="undrift.device"),
            "c.pdf",
            "wanted kind 'undrift.calibration', got 'undrift.device'",
        ),
        (without_covariance, "c.pdf", "wanted a covariance of the accelerometers, got none; calibrate from recordings"),
        (without_triads, "c.pdf", "wanted a calibrated gyroscope or accelerometer, got neither"),
        (lambda content: None, "c.txt", "wanted a name ending in .pdf"),
        (lambda content: None, "nowhere/c.pdf", "wanted a folder that exists, got none named"),
        (
            lambda content: content["gyro"]["budget"].popitem(),
            "c.pdf",
            "wanted squares that sum to the diagonal of the covariance",
        ),
    ],
)
def test_refuses_in_one_line_and_writes_nothing(undrift, bench, tmp_path, change, output, text):
    content = json.loads((bench / "calibration.json").read_text())
    change(content)
    (tmp_path / "given.json").write_text(json.dumps(content))
    assert text in undrift.refused("certificate", tmp_path / "given.json", "-o", tmp_path / output)
    assert list(contents(tmp_path)) == ["given.json"]


# ---- what the laboratory states

STATED = (
    "--number",
    "K-117",
    "--laboratory",
    "Motion laboratory, Bern",
    "--operator",
    "R. Muster",
    "--valid-months",
    "6",
)


def test_what_is_not_stated_is_a_line_and_never_invented(undrift, bench, tmp_path):
    answer = undrift.good("certificate", bench / "calibration.json", "-o", tmp_path / "c.pdf", "--json").json()
    assert set(answer["statement"].values()) == {None}
    assert answer["conformity"] == {"rule": None, "rows": [], "text": []}
    content = certificate_content(read_calibration(bench / "calibration.json"))
    assert {text for _, text in (*content["head"], *content["ambient"])} == {""}
    assert [label for label, _ in content["head"]][-3:] == ["Date of issue", "Authorised by", "Signature"]


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("--number", "two\nlines"), "--number: wanted one line of at most 200 characters"),
        (("--laboratory", "x" * 201), "--laboratory: wanted one line of at most 200 characters"),
        (("--valid-months", "0"), "--valid-months: wanted 1 to 1200 months from a date, got 0"),
        (("--ambient-temp-c", "warm"), "--ambient-temp-c: wanted a value or LOW:HIGH from -100 to 200 °C, got 'warm'"),
        (("--ambient-temp-c", "23:21"), "wanted a value or LOW:HIGH"),
        (
            ("--ambient-humidity-percent", "101"),
            "--ambient-humidity-percent: wanted a value or LOW:HIGH from 0 to 100 %",
        ),
        (("--decision-rule", "simple"), "--decision-rule: wanted a limit to decide by, got none"),
        (("--limit-accel-offset-mg", "0"), "--limit-accel-offset-mg: wanted a limit above 0, got 0"),
        (("--kind", "mpu9999"), "wanted one of enc03j_3031, mpu6050"),
    ],
)
def test_what_cannot_stand_on_a_certificate_is_refused(undrift, bench, tmp_path, words, text):
    assert text in undrift.refused("certificate", bench / "calibration.json", "-o", tmp_path / "c.pdf", *words)
    assert contents(tmp_path) == {}


def test_months_of_a_calibration_without_a_date_are_refused(bench):
    model = read_calibration(bench / "calibration.json")
    undated = replace(model, provenance=replace(model.provenance, created=""))
    with pytest.raises(InputError, match="wanted 1 to 1200 months from a date, got 6 of a calibration from 'no date'"):
        certificate_content(undated, Statement(valid_months=6))


# ---- conformity


@pytest.fixture(scope="module")
def unit():
    """A unit of a part, and its calibration on a bench."""
    rng = np.random.default_rng(20)
    device = random_device_of("mpu6050", rng)
    return device, calibrate(simulate_session("bench", device, rng=rng))


@pytest.mark.slow
def test_a_unit_that_its_data_sheet_allows_lies_within_its_limits(undrift, unit, tmp_path):
    write_calibration(unit[1], tmp_path / "c.json")
    words = ("certificate", tmp_path / "c.json", "-o", tmp_path / "c.pdf", "--kind", "mpu6050")
    judged = undrift.good(*words, "--json").json()["conformity"]
    assert judged["rule"] == "guard"
    assert [row["result"] for row in judged["rows"]] == ["within"] * 6
    assert [(row["limit"], row["unit"]) for row in judged["rows"]] == [
        ("3", "%"), ("2", "%"), ("20", "deg/s"), ("3", "%"), ("2", "%"), ("50", "mg"),
    ]  # fmt: skip
    tight = undrift.good(*words, "--limit-gyro-offset-dps", "1e-3", "--report", tmp_path / "c.html").out
    assert re.search(r"Gyroscopes: zero-rate output .* 0\.001 +deg/s +outside", tight)
    page = (tmp_path / "c.html").read_text()
    assert "Statement of conformity" in page
    assert "guard band of U, ILAC-G8:09/2019" in page
    assert "data sheet of mpu6050 as its preset states it (gyro read in the sheet; offset drift assumed" in page
    assert "compare with the sheet before judging by it" in page


@pytest.mark.parametrize(
    ("limit", "rule", "result"),
    [
        (1.01, "guard", "within"),
        (0.99, "guard", "neither stated"),
        (0.99, "simple", "within"),
        (0.79, "guard", "outside"),
        (0.89, "simple", "outside"),
    ],
)
def test_the_rule_decides_by_the_departure_and_its_uncertainty(unit, limit, rule, result):
    value, expanded = departures("gyro", unit[1].gyro, "mpu6050")["scale"]
    worst = (abs(value) + expanded).argmax()
    size, u = abs(value[worst]), expanded[worst]
    least = {1.01: size + 1.01 * u, 0.99: size + 0.99 * u, 0.79: size - 1.01 * u, 0.89: size - 0.01 * u}[limit]
    judged = conformity(unit[1], Specification(kind="mpu6050", limit_gyro_scale_percent=float(least)), rule)
    assert judged["rows"][0]["result"] == result


def test_counts_of_no_stated_part_have_no_nominal_value(unit):
    judged = conformity(unit[1], Specification(limit_gyro_scale_percent=1.0, limit_gyro_cross_percent=5.0), None)
    assert [row["result"] for row in judged["rows"]] == ["nominal unknown", "within"]
    gyro = unit[1].gyro
    rests = replace(gyro, parameters=gyro.parameters[9:12], covariance=gyro.covariance[9:12, 9:12], budget=None)
    offsets = replace(unit[1], gyro=rests)
    judged = conformity(offsets, Specification(kind="mpu6050"), None)
    assert [row["result"] for row in judged["rows"]][:3] == ["not calibrated", "not calibrated", "within"]


def test_counts_stand_beside_rad_per_second(unit):
    gyro = unit[1].gyro
    triad = certificate_content(unit[1])["triads"][0]
    row = next(row for row in triad["results"] if row[0] == "offset_y")
    assert (row[2], triad["si"]) == ("count", "rad/s")
    assert float(row[6]) == pytest.approx(gyro.offset[1] * np.diag(gyro.matrix).mean(), rel=1e-2)
    row = next(row for row in triad["results"] if row[0] == "m_xx")
    assert float(row[6]) == pytest.approx(gyro.matrix[0, 0], rel=1e-3)


def test_no_zero_of_a_certificate_has_a_sign(unit, tmp_path, monkeypatch):
    import typst

    given = []
    monkeypatch.setattr(typst, "compile", lambda text, **how: given.append(how["sys_inputs"]["content"]) or b"%PDF-")
    small = unit[1].gyro.matrix.copy()
    small[0, 1] = -1e-12
    write_certificate(replace(unit[1], gyro=replace(unit[1].gyro, matrix=small)), tmp_path / "c.pdf")
    assert next(row for row in json.loads(given[0])["triads"][0]["results"] if row[0] == "m_xy")[1].startswith("0.0")
    assert not re.search(r'"-0(\.0+)?"', given[0])


# ---- the picture beside the data sheet


def test_a_calibration_that_names_its_part_is_drawn_with_the_limits_of_the_data_sheet(undrift, unit, tmp_path):
    write_session(simulate_session("bench", unit[0], rng=np.random.default_rng(20)), tmp_path / "session")
    words = ("calibrate", tmp_path / "session", "-o", tmp_path / "c.json", "--report", tmp_path / "c.html")
    undrift.good(*words, "--kind", "mpu6050")
    made = read_calibration(tmp_path / "c.json")
    assert made.provenance.text("kind") == "mpu6050"
    page = (tmp_path / "c.html").read_text()
    assert "departures from the scale factor that the data sheet of mpu6050 states" in page
    assert "limits of the data sheet of mpu6050" in page
    matrix, offset = draw_calibration(made).axes[:2]
    heights, (offsets,) = (
        [
            float(np.ptp(one.get_paths()[0].vertices[:, 1])) / 2.0
            for one in panel.collections
            if isinstance(one, PolyCollection)
        ]
        for panel in (matrix, offset)
    )
    assert heights == pytest.approx([3.0, 2.0, 2.0, 2.0, 3.0, 2.0, 2.0, 2.0, 3.0])  # %, of scale and across axes
    assert offsets == pytest.approx(20.0 * 16.4)  # counts, of 20 deg/s
    points = matrix.lines[0].get_ydata()[[0, 4, 8]]
    assert points == pytest.approx(
        -100.0 * unit[0].gyro.scale.error, abs=0.2
    )  # the matrix undoes what the sensor errs by
