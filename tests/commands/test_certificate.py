"""undrift certificate: a PDF from the bench's calibration, and what is refused without a trace."""

import json

import pytest

from testkit.command_line import contents
from undrift.io.store import content_hash, read_calibration


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
