"""undrift calibrate: real sessions written as session.toml, and the simulated bench."""

import json
from dataclasses import replace

import numpy as np
import pytest
from benchmarks.broad import DEVICES, trial
from benchmarks.in_motion import pairs

from testkit.command_line import contents
from testkit.data import data_path, needs_data, show
from testkit.stepper_jig import turned
from undrift.frames import quaternion_conjugate, quaternion_product
from undrift.io.formats import read_reference, write_record
from undrift.io.session import write_session
from undrift.io.store import read_calibration
from undrift.orientation import heading_of
from undrift.record import RateTable, Session, TemperatureSensitivity
from undrift.sim.bench_errors import BenchErrors
from undrift.sim.device.presets import random_device
from undrift.sim.motion.bench import BenchSettings
from undrift.sim.sessions import simulate_session
from undrift.units import RADIAN_PER_DEGREE as DEG

KEYS = {
    "kind",
    "format",
    "device",
    "reference_temp_c",
    "gravity_m_s2",
    "gyro",
    "accel",
    "drift",
    "adc",
    "noise",
    "verdict",
}
TRIAD_KEYS = {
    "method", "unit_in", "unit_out", "matrix", "offset", "g_sensitivity", "parameters", "covariance", "rms_residual", "count",
    "rank", "condition", "valid_range",
}  # fmt: skip
HEAD = '[session]\nkind = "calibration"\nserial = "{serial}"\ngravity_m_s2 = {gravity}\n'


def written(folder, serial, recordings, *, gravity=9.81, pieces=""):
    folder.mkdir()
    text = HEAD.format(serial=serial, gravity=gravity) + "".join(f"[[recording]]\n{entry}\n" for entry in recordings)
    (folder / "session.toml").write_text(text + pieces)
    return folder


@pytest.mark.slow
def test_three_boards_turned_by_hand(undrift, tmp_path):
    for unit in range(3):
        path = data_path("multipos_mpu9150", f"imu{unit}.log.gz")
        entry = (
            f'file = "{path}"\nsample_rate_hz = 100\nheader = false\ndelimiter = " "\n'
            'columns = { accel = [0, 1, 2], gyro = [3, 4, 5] }\nunits = { accel = "m/s2", gyro = "rad/s" }'
        )
        told = undrift.good("calibrate", written(tmp_path / f"{unit}", f"imu{unit}", [entry]), "--json").json()
        assert told.keys() >= KEYS
        assert told["accel"].keys() == told["gyro"].keys() >= TRIAD_KEYS
        assert told["accel"]["method"].startswith("multi-position")
        rms_mg = told["accel"]["rms_residual"] / 9.80665 * 1e3
        show(f"unit {unit}: |a| after the fit, mg rms", rms_mg, "0.30 (SOURCE.md: 0.17-0.29)")
        assert rms_mg <= 0.30
        assert told["verdict"]["status"] == "good"


@pytest.mark.slow
def test_the_xsens_logs_side_by_side_are_calibrated_as_published(undrift, tmp_path):
    files = [str(data_path("multipos_xsens", f"xsens_{name}.txt.gz")) for name in ("acc", "gyro")]
    entry = (
        f'file = {json.dumps(files)}\nheader = false\ndelimiter = " "\n'
        "columns = [{ time = 0, accel = [1, 2, 3] }, { time = 0, gyro = [1, 2, 3] }]\n"
        'units = { time = "s", accel = "count", gyro = "count" }'
    )
    session = written(tmp_path / "s", "xsens", [entry])
    answer = undrift.good("calibrate", session, "-o", tmp_path / "xsens.json")
    assert "verdict: good" in answer.out
    assert f"Wrote {tmp_path / 'xsens.json'}" in answer.out
    model = read_calibration(tmp_path / "xsens.json").accel
    per_g = model.scale_factor * 9.81
    show("counts per g", np.round(per_g, 0), "3983/4045/4028 within 2 % (SOURCE.md, another gravity)")
    np.testing.assert_allclose(per_g, [3983.0, 4045.0, 4028.0], rtol=0.03)
    assert model.rms_residual < 1.2e-3  # SOURCE.md: 0.10 mg rms


@pytest.mark.slow
def test_the_ferraris_session_with_its_stated_faces_and_turns(undrift, tmp_path):
    ranges = json.loads(data_path("ferraris_nilspod", "example_ferraris_session_list.json").read_text())
    pieces = ""
    for name, part in ranges.items():
        span = f"start_s = {part['start'] / 102.4}\nstop_s = {part['end'] / 102.4}\n"
        if name.endswith("rot"):
            pieces += f'[[turn]]\naxis = "{name[0]}"\nangle_deg = -360.0\n{span}'
        else:
            pieces += f'[[still]]\nface = "{"+" if name[2] == "p" else "-"}{name[0]}"\n{span}'
    entry = (
        f'file = "{data_path("ferraris_nilspod", "example_ferraris_session.csv")}"\nsample_rate_hz = 102.4\n'
        'columns = { gyro = ["gyr_x", "gyr_y", "gyr_z"], accel = ["acc_x", "acc_y", "acc_z"] }\n'
        'units = { gyro = "dps", accel = "m/s2" }'
    )
    told = undrift.good("calibrate", written(tmp_path / "s", "03f5", [entry], pieces=pieces), "--json").json()
    assert told["gyro"]["method"].startswith("known-rotation")
    assert told["accel"]["method"].startswith("six-face")
    scale = np.linalg.norm(np.linalg.inv(np.array(told["accel"]["matrix"])), axis=1)
    np.testing.assert_allclose(scale, [0.99674587, 1.00243762, 1.02339535], atol=3e-4)  # GOLDENS, K_a of imucal
    paper = undrift.good("calibrate", tmp_path / "s", "--mode", "paper", "--json").json()
    assert paper["accel"]["method"] == "six-face/paper"


@pytest.mark.slow
def test_eleven_still_recordings_are_one_session_and_the_verdict_says_what_was_not_seen(undrift, tmp_path):
    folder = data_path("multipos_mpu6050_bicycle")
    entries = [
        f'file = "{path}"\ncolumns = {{ time = "t_s", gyro = "gyro_rad_s", accel = "acc_raw", temp = "temp_degC" }}\n'
        'units = { time = "s", gyro = "rad/s", accel = "count", temp = "degC" }'
        for path in sorted(folder.glob("*.npz"))
    ]
    session = written(tmp_path / "s", "bicycle", entries, gravity=9.80665)
    assert "11 recordings" in undrift.good("info", session).out
    told = undrift.good("calibrate", session, "--json").json()
    assert told["verdict"]["status"] == "marginal"
    prior = "Prior used for the accelerometer's cross-axis terms xy and xz: the poses do not show them: 0 +- 1 %"
    assert any(reason.startswith(prior) for reason in told["verdict"]["reasons"])
    wide = undrift.good("calibrate", session, "--cross-axis-prior", "0.015", "--json").json()
    at = told["accel"]["parameters"].index("m_xy")
    sigma = [np.sqrt(answer["accel"]["covariance"][at][at]) for answer in (told, wide)]
    assert sigma[1] / sigma[0] == pytest.approx(1.5, rel=0.03)
    assert "wanted cross_axis_prior above 0" in undrift.refused("calibrate", session, "--cross-axis-prior", "-1")
    np.testing.assert_allclose(
        np.array(told["accel"]["offset"]) / 16.384, [58.0, -6.0, -123.0], atol=2.0
    )  # mg, SOURCE.md


def test_a_worn_recording_is_refused_for_want_of_a_still_phase(undrift, tmp_path):
    entry = (
        f'file = "{data_path("worn_lowback", "HA_001_Test11.csv.gz")}"\nsample_rate_hz = 100\n'
        'columns = { gyro = ["gyr_x", "gyr_y", "gyr_z"], accel = ["acc_x", "acc_y", "acc_z"] }\n'
        'units = { gyro = "dps", accel = "g" }'
    )
    session = written(tmp_path / "s", "worn", [entry])
    before = contents(tmp_path)
    assert "still" in undrift.refused("calibrate", session, "-o", tmp_path / "c.json")
    assert contents(tmp_path) == before


@pytest.mark.slow
def test_the_bench_is_calibrated_by_every_way_that_it_allows(undrift, bench, tmp_path):
    session = bench / "session"
    answer = undrift.good("calibrate", session)
    assert "Nothing was written" in answer.out
    for head in ("m x", "offset", "scale factor", "(count per rad/s)", "(count per m/s2)"):
        assert head in answer.out
    told = undrift.good("calibrate", session, "--json", "-o", tmp_path / "c.json").json()
    assert told["gyro"]["method"] == "rate-table/affine"
    assert json.loads((tmp_path / "c.json").read_text())["gyro"] == told["gyro"]
    for words in (["--accel", "six-face"], ["--gyro", "rate-table"], ["--mode", "affine"], ["--latitude-deg", "45"]):
        assert undrift.good("calibrate", session, *words, "--json").json()["verdict"]["status"] in ("good", "marginal")
    turned = undrift.good("calibrate", session, "--latitude-deg", "45", "--json").json()
    assert turned["gyro"]["offset"] != told["gyro"]["offset"]


@pytest.mark.slow
def test_a_way_that_the_session_does_not_allow_is_refused_and_poor_ones_are_fitted(undrift, bench):
    assert "wanted" in undrift.refused("calibrate", bench / "session", "--gyro", "known-rotation")
    ways = (["--accel", "multi-position"], ["--gyro", "multi-position"])  # nine poses on the faces: with the prior
    assert all(undrift.good("calibrate", bench / "session", *way).out for way in ways)


def judged(made, seen, verdict):
    """What the stage returns, with another verdict."""
    return replace(made, verdict=verdict), seen


@pytest.mark.slow
def test_a_bad_verdict_is_written_and_ends_with_one(undrift, bench, tmp_path, monkeypatch):

    from undrift.calibration import calibrate as procedure
    from undrift.findings import finding
    from undrift.model import Verdict

    good = procedure.calibrated
    bad = Verdict(status="bad", findings=(finding("earlier.text", "fail", text="the table slipped"),))
    monkeypatch.setattr(procedure, "calibrated", lambda *a, **k: judged(*good(*a, **k), bad))
    answer = undrift("calibrate", bench / "session", "-o", tmp_path / "c.json")
    assert (answer.code, answer.err) == (1, "")
    assert "verdict: bad\n  - the table slipped" in answer.out
    assert read_calibration(tmp_path / "c.json").verdict.status == "bad"


@pytest.mark.slow
def test_three_findings_are_shown_and_all_with_details(undrift, bench, monkeypatch):

    from undrift import findings
    from undrift.calibration import calibrate as procedure
    from undrift.model import Verdict

    for code, rank, action in (("a", 4, "record [more]"), ("b", 2, ""), ("c", 1, "")):
        detail = "{x_deg:.1f} deg" if code == "a" else ""
        monkeypatch.setitem(
            findings.catalogue(), f"test.{code}", findings.FindingText(rank, f"headline {code}", detail, action)
        )
    found = (
        findings.finding("test.a", "info", x_deg=1.0),
        findings.finding("test.b", "warn"),
        findings.finding("test.c", "warn"),
        findings.finding("test.c", "warn"),
        findings.finding("test.a", "fail", x_deg=2.0),
    )
    good = procedure.calibrated
    bad = Verdict(status="bad", findings=found)
    monkeypatch.setattr(procedure, "calibrated", lambda *a, **k: judged(*good(*a, **k), bad))
    first = [
        "verdict: bad",
        "  - headline a", "    2.0 deg", "    -> record [more]",
        "  - headline c",
        "  - headline b",
    ]  # fmt: skip
    last = ["  - headline a", "    1.0 deg", "    -> record [more]"]
    shown = undrift("calibrate", bench / "session").out
    assert "\n".join([*first, "  1 more: --details"]) in shown
    detailed = undrift("calibrate", bench / "session", "--details").out
    assert "\n".join([*first, *last]) in detailed
    assert "more: --details" not in detailed
    verdict = undrift("calibrate", bench / "session", "--json").json()["verdict"]
    assert verdict["findings"][0] == {
        "code": "test.a", "level": "info", "values": {"x_deg": 1.0}, "text": "headline a: 1.0 deg; record [more]",
        "action": "record [more]",
    }  # fmt: skip
    assert verdict["reasons"][0] == "headline a: 2.0 deg; record [more]"


@pytest.mark.slow
def test_settings_of_the_fit_are_options(undrift, bench, tmp_path):
    def made(*words):
        return undrift.good("calibrate", bench / "session", *words, "--json").json()

    words = ["--window-s", "4", "--settle-s", "0.5", "--angle-uncertainty-deg", "2", "--axis-uncertainty-deg", "1"]
    plain, chosen = made(), made(*words)
    names = ("window_s", "settle_s", "angle_uncertainty_deg", "axis_uncertainty_deg")
    assert [dict(plain["provenance"]["settings"])[name] for name in names] == ["6", "0.3", "1", "0.5"]
    assert [dict(chosen["provenance"]["settings"])[name] for name in names] == ["4", "0.5", "2", "1"]
    assert plain["accel"]["offset"] != chosen["accel"]["offset"]
    assert plain["gyro"]["offset"] != chosen["gyro"]["offset"]


@pytest.mark.slow
def test_filters_of_faces_and_dwells_are_options(undrift, bench):
    def made(*words):
        return undrift.good("calibrate", bench / "session", *words, "--json").json()

    plain, chosen = made(), made("--polynomial-degree", "2", "--spline-cutoff-hz", "5")
    names = ("polynomial_degree", "spline_cutoff_hz")
    assert [dict(plain["provenance"]["settings"])[name] for name in names] == ["1", "none"]
    assert [dict(chosen["provenance"]["settings"])[name] for name in names] == ["2", "5"]
    assert plain["gyro"]["matrix"] != chosen["gyro"]["matrix"]
    assert "wanted spline_cutoff_hz above 0 Hz" in undrift.refused(
        "calibrate", bench / "session", "--spline-cutoff-hz", "0"
    )
    assert "polynomial_degree and settle_s of 0 or more" in undrift.refused(
        "calibrate", bench / "session", "--polynomial-degree", "-1"
    )


@pytest.mark.slow
def test_a_report_page_shows_matrices_and_verdict(undrift, bench, tmp_path):
    page = tmp_path / "c.html"
    assert f"Wrote {page}" in undrift.good("calibrate", bench / "session", "--report", page).out
    text = page.read_text()
    for part in ("<h3>Gyroscopes: rate-table/affine", "scale factor (count per rad/s)", "gravity 9.8"):
        assert part in text
    assert "wanted a name ending in .html" in undrift.refused(
        "calibrate", bench / "session", "--report", tmp_path / "c.pdf"
    )


@pytest.mark.parametrize("word", ["session", "session/session.toml"])
def test_a_session_is_named_by_its_folder_or_its_file(undrift, bench, word):
    assert undrift.good("calibrate", bench / word, "--json").json()["verdict"]["status"] == "good"


@pytest.mark.slow
def test_the_command_overrules_the_rate_table_of_the_session(undrift, tmp_path):
    rng = np.random.default_rng(7)
    session = simulate_session("rate_table", random_device(rng), rng=rng, settings=BenchSettings(turn_rates=(0.5, 1.5)))
    folder = tmp_path / "s"
    write_session(replace(session, rate_table=RateTable(mount_tilt_deg=0.5, rate_uncertainty=0.004)), folder)
    stated = undrift.good("calibrate", folder, "--json").json()
    words = (
        "--mount-tilt-deg",
        "0.2",
        "--rate-uncertainty",
        "0.002",
        "--table-level-deg",
        "0.3",
        "--wobble-deg",
        "0.04",
    )
    asked = undrift.good("calibrate", folder, *words, "--json").json()
    relative = []
    for answer in (stated, asked):
        gyro = answer["gyro"]
        sigma = np.sqrt(np.diag(gyro["covariance"])[:9]).reshape(3, 3) / np.diag(gyro["matrix"])
        relative.append((sigma[0, 1], sigma[0, 0]))
    # of a gyroscope's cross-axis term without accelerometers' faces, and of its scale: what is stated, the rest is noise
    np.testing.assert_allclose(relative, [(0.5 * DEG, 0.004), (0.2 * DEG, 0.002)], rtol=0.1)
    names = ("table_level_deg", "mount_tilt_deg", "rate_uncertainty", "wobble_deg")
    held = [dict(answer["provenance"]["settings"]) for answer in (stated, asked)]
    assert [held[0][name] for name in names] == ["0.1", "0.5", "0.004", "0.01"]
    assert [held[1][name] for name in names] == ["0.3", "0.2", "0.002", "0.04"]
    assert "wanted mount_tilt_deg from 0 to 10, got -1" in undrift.refused(
        "calibrate", folder, "--mount-tilt-deg", "-1"
    )


@pytest.mark.slow
def test_the_command_overrules_the_temperature_sensitivities_of_the_session(undrift, tmp_path):
    rng = np.random.default_rng(7)
    device = random_device(rng)
    session = simulate_session(
        "six_face",
        device,
        rng=rng,
        settings=BenchSettings(errors=BenchErrors(face_tilt=0.3 * DEG)),
        temp_c=(22.0, 28.0),
    )
    folder = tmp_path / "s"
    write_session(replace(session, sensitivity=TemperatureSensitivity(accel_offset_mg_per_k=1.0)), folder)
    stated = undrift.good("calibrate", folder, "--json").json()
    words = ("--accel-offset-mg-per-k", "0.25", "--span-limit-k", "8", "--accel-scale-percent-per-k", "0.03")
    words += ("--gyro-offset-dps-per-k", "0.04", "--gyro-scale-percent-per-k", "0.01", "--unrecorded-span-k", "2")
    asked = undrift.good("calibrate", folder, *words, "--json").json()
    at = stated["accel"]["parameters"].index("offset_x")
    sigma = [np.sqrt(answer["accel"]["covariance"][at][at]) for answer in (stated, asked)]
    assert 2.0 < sigma[0] / sigma[1] < 4.0  # four times the prior; faces off level by 0.3 deg hardly narrow it
    codes = [{item["code"] for item in answer["verdict"]["findings"]} for answer in (stated, asked)]
    assert ["session.temperature_creep" in found for found in codes] == [True, False]
    held = [dict(answer["provenance"]["settings"]) for answer in (stated, asked)]
    assert (held[0]["accel_offset_mg_per_k"], held[0]["span_limit_k"]) == ("1", "2")
    names = ("accel_offset_mg_per_k", "span_limit_k", "accel_scale_percent_per_k", "gyro_offset_dps_per_k")
    names += ("gyro_scale_percent_per_k", "unrecorded_span_k")
    assert [held[1][name] for name in names] == ["0.25", "8", "0.03", "0.04", "0.01", "2"]
    named = dict(undrift.good("calibrate", folder, "--kind", "enc03j_3031", "--json").json()["provenance"]["settings"])
    assert (named["gyro_scale_percent_per_k"], named["thermometer_lag_s"]) == ("0.175925", "80")
    assert "wanted one of enc03j_3031" in undrift.refused("calibrate", folder, "--kind", "lm335")
    refused = undrift.refused("calibrate", folder, "--accel-offset-mg-per-k", "-1")
    assert "wanted accel_offset_mg_per_k from 0 to 100, got -1" in refused


@pytest.mark.parametrize(("sensor", "code"), [("bno", 0), ("lsm", 1)])
def test_a_rate_table_about_one_axis_is_written_and_a_wrong_conversion_ends_with_one(undrift, tmp_path, sensor, code):
    """Rimu_Test_Jig: the ST sensor was converted with 30.5 in place of 35 mdeg/s a code (SOURCE.md), the Bosch one well."""
    record, turns = turned("giro_test_filt", sensor)
    write_session(
        Session(kind="calibration", serial="jig", gravity_m_s2=9.81, records=(record,), turns=turns), tmp_path / "s"
    )
    answer = undrift("calibrate", tmp_path / "s", "--details", "-o", tmp_path / "c.json")
    assert answer.code == code
    assert ("Implausible scale factor of gyroscope y" in answer.out) == bool(code)
    assert "Gyroscope x, z: nominal scale kept" in answer.out
    made = read_calibration(tmp_path / "c.json").gyro
    off = made.forward_matrix[1, 1] * np.pi / 180.0 - 1.0
    show(f"{sensor}: scale of y off by", f"{100 * off:.2f} %", "0.4 % or -15 %")
    assert abs(off) > 0.1 if code else abs(off) < 0.005  # never the identity in silence
    assert made.standard_uncertainty[0] / made.matrix[0, 0] == pytest.approx(0.03, rel=0.1)


@pytest.mark.slow
def test_gyroscopes_are_left_out_on_the_command_line_and_the_next_command_stays(undrift, bench, tmp_path):
    answer = undrift.good("calibrate", bench / "session", "--gyro", "none", "-o", tmp_path / "c.json")
    assert "Not complete: no model of the gyroscopes, whose readings stay raw" in answer.out
    assert read_calibration(tmp_path / "c.json").gyro is None
    told = undrift.good("calibrate", bench / "session", "--gyro", "none", "--json").json()
    assert (told["gyro"], told["lacking"]) == (None, ["gyroscopes"])
    assert undrift.good("calibrate", bench / "session", "--json").json()["lacking"] == []
    assert "got none" not in undrift.refused("calibrate", bench / "session", "--gyro", "rest")  # counts have no scale


def test_a_calibration_without_accelerometers_is_not_offered_for_correct_and_says_what_is_missing(undrift, tmp_path):
    session = simulate_session("bench", random_device(np.random.default_rng(7)), rng=np.random.default_rng(8))
    four = replace(session, stills=tuple(still for still in session.stills if still.face not in ("-y", "+x")))
    write_session(four, tmp_path / "s")
    answer = undrift.good("calibrate", tmp_path / "s", "-o", tmp_path / "c.json")
    assert "Next: undrift correct" not in answer.out
    assert "Not complete: no model of the accelerometers" in answer.out
    first = answer.out[answer.out.index("verdict: ") :].splitlines()[1:3]
    assert first[0] == "  - Accelerometer not observable"
    assert first[1].endswith("faces without a rest: +x, -y")
    assert undrift.good("calibrate", tmp_path / "s", "--json").json()["lacking"] == ["accelerometers"]


@pytest.mark.slow
@needs_data
def test_recordings_in_motion_calibrate_both_triads_and_state_the_offset_of_each(undrift, tmp_path):
    files = []
    for number, (record, _) in enumerate(pairs("chain")):
        files.append(tmp_path / f"{number}.csv")
        write_record(record, files[-1])
    made = tmp_path / "by_motion.json"
    called = undrift("calibrate", *files, "--from", "motion", "-o", made, "--json")
    printed = called.json()
    assert (called.code, printed["verdict"]["status"]) == (0, "marginal")
    assert printed["gyro"]["method"] == printed["accel"]["method"] == "motion"
    assert [one["recording"] for one in printed["motion"]] == ["0.csv", "1.csv"]
    show("offset of each recording, deg/s", [np.round(one["offset_dps"], 3).tolist() for one in printed["motion"]])
    for one in printed["motion"]:
        np.testing.assert_allclose(
            one["offset_dps"], (-0.54, -0.20, -0.60), atol=3 * max(one["offset_uncertainty_dps"])
        )
    assert read_calibration(made).gyro.matrix[0, 0] == pytest.approx(1.0, abs=0.01)
    words = undrift.good("calibrate", *files, "--from", "motion").out
    assert "Gyroscopes' offset of each recording, deg/s" in words
    assert "hold the device with each of these axes up, then down" in words


@pytest.mark.slow
@needs_data
def test_a_magnetometer_is_calibrated_by_the_same_motion_and_gives_a_heading_from_north(undrift, tmp_path):
    for number in DEVICES["C"]:
        record, _ = trial(number)
        channels = {name: getattr(record, name)[::3] for name in ("time", "gyro", "accel", "mag_ut")}
        write_record(replace(record, **channels), tmp_path / f"{number}.csv")
    made, words = tmp_path / "c.json", ("calibrate", tmp_path / "03.csv", "--from", "motion")
    shown = undrift.good(*words, "--magnetometer", "-o", made, "--report", tmp_path / "c.html").out
    assert "axes of the gyroscopes, which it lags by 1" in shown
    assert "Magnetic field of each recording" in shown
    assert "Magnetometer: motion" in (tmp_path / "c.html").read_text()
    (figures,) = undrift.good(*words, "--magnetometer", "--json").json()["motion"]
    assert (figures["recording"], figures["disturbed_percent"]) == ("03.csv", pytest.approx(0.0, abs=5.0))
    assert 30.0 < figures["field_ut"] < 60.0
    assert 60.0 < figures["below_horizon_deg"] < 70.0
    mag = read_calibration(made).magnetometer
    np.testing.assert_allclose(mag.model.offset, (-0.31, 1.02, -1.59), atol=0.15)
    assert np.linalg.det(mag.model.matrix) == pytest.approx(1.0)
    assert "--magnetometer are for" in undrift.refused("calibrate", tmp_path / "03.csv", "--magnetometer")
    turned = ("orient", tmp_path / "24.csv", "--calibration", made, "-o", tmp_path / "o.csv", "--magnetometer")
    shown = undrift.good(*turned, "--method", "vqf").out
    assert "Heading is relative to magnetic east" in shown
    found = read_reference(tmp_path / "o.csv")
    apart = quaternion_product(found.q_nb[:2000], quaternion_conjugate(trial("24")[1].q_nb[: 3 * 2000 : 3]))
    assert np.degrees(np.nanmedian(np.abs(heading_of(apart)))) < 4.0  # east-north-up of the optics
    assert "the method vqf and no heading" in undrift.refused(*turned)
    undrift.good(*words, "-o", tmp_path / "plain.json")
    bare = [str(word).replace("c.json", "plain.json") for word in turned]
    assert "The magnetometer is not calibrated" in undrift.good(*bare, "--method", "vqf").out
    alone = ("orient", tmp_path / "24.csv", "-o", tmp_path / "raw.csv", "--magnetometer", "--method", "vqf")
    assert "The magnetometer is not calibrated" in undrift.good(*alone).out  # raw readings, as their file says


@needs_data
def test_options_that_motion_alone_cannot_use_are_refused(undrift, tmp_path):
    record, _ = pairs("chain")[0]
    write_record(record, tmp_path / "walk.csv")
    refused = undrift(
        "calibrate", tmp_path / "walk.csv", "--from", "motion", "--turn-deg", "360", "-o", tmp_path / "c.json"
    )
    assert refused.code == 2
    assert "has no use for" in refused.err
    assert "--turn-deg" in refused.err
    assert not (tmp_path / "c.json").exists()
    for words, name in ((("--keep-offset",), "--keep-offset"), (("--settle-s", "2"), "--settle-s")):
        assert name in undrift.refused("calibrate", tmp_path / "walk.csv", "--from", "motion", *words)
