"""Figures of real recordings, on motions whose answer is known, and what is refused."""

from pathlib import Path

import numpy as np
import pytest

from testkit.data import show
from testkit.hand_turns import make_recording
from undrift.errors import FileFormatError, InputError
from undrift.io.reference import write_reference
from undrift.record import Reference
from undrift.sim.device.model import write_device
from undrift.sim.device.presets import preset
from undrift.sim.motion.tasks import draw_task
from undrift.study import real as real_module
from undrift.study.figure3 import Climate
from undrift.study.plan import note_study
from undrift.study.real import (
    MEASURES,
    REPETITION,
    CapturedTrial,
    CohortComparison,
    Stance,
    agreement_of,
    judge_real,
    motion_rows,
    read_real,
    read_stance,
    real_errors,
    repetitions,
    sway_figures,
    worn_in,
)
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

pytestmark = pytest.mark.usefixtures("computed_once")


def captured(seed: int = 3) -> CapturedTrial:
    """A simulated rising as a camera would give it."""
    task = draw_task("sit_to_stand", rng=np.random.default_rng(seed))
    time = np.arange(round(task.duration_s * 100.0)) / 100.0
    reference = Reference(time=time, q_nb=task.at(time, 9.80665).q_nb, position=task.position(time))
    return CapturedTrial(name="made", task="sit_to_stand", device=reference)


def test_repetitions_give_back_a_lean_its_rates_and_its_time() -> None:
    time = np.arange(0.0, 20.0, 0.01)
    phase = np.clip((time % 5.0) - 1.0, 0.0, 2.0)  # a lean of 2 s every 5 s
    pitch = np.radians(15.0) * (1.0 - np.cos(np.pi * phase))
    height = 0.5 + 0.25 * (1.0 - np.cos(np.pi * np.clip((time % 5.0) - 1.5, 0.0, 1.0)))
    found = repetitions(time, pitch, np.gradient(pitch, time), height)
    show("lean, deg; flexion, extension rate, deg/s; duration, s", np.round(found, 2).tolist())
    assert found.shape == (4, 4)
    # 30 deg as a raised cosine over 2 s: 15 pi deg/s either way; 5 deg/s are passed 0.034 s from its ends.
    np.testing.assert_allclose(found[:, 0], 30.0, atol=0.2)
    np.testing.assert_allclose(found[:, 1:3], 15.0 * np.pi, rtol=0.002)
    np.testing.assert_allclose(found[:, 3], 2.0 - 2.0 * 0.034, atol=0.021)


def test_a_body_that_does_not_rise_is_another_task() -> None:
    time = np.arange(0.0, 5.0, 0.01)
    with pytest.raises(InputError, match=r"wanted a body that rises by 0.05 m or more, got 0 m"):
        repetitions(time, np.zeros(500), np.zeros(500), np.ones(500))


def test_a_performance_of_the_cohort_lies_inside_the_cohort() -> None:
    rows = motion_rows((captured(),), subjects=30)
    for row in rows:
        show(f"{row.measure}, {row.unit}", f"{row.real:.1f} in {row.low:.1f} to {row.high:.1f}")
    assert tuple(row.measure for row in rows) == tuple(name for name, _ in REPETITION)
    assert sum(row.inside for row in rows) >= 3  # each is inside nineteen times in twenty
    assert not CohortComparison(
        trial="", task="", measure="", unit="", real=float("nan"), low=0.0, median=1.0, high=2.0
    ).inside


def test_a_device_worn_in_captures_agrees_with_their_optics_once_its_drift_is_off() -> None:
    worn = worn_in(tuple(captured(seed) for seed in range(3)))
    errors = {level: [r.error_max_deg for r in worn.rows if r.level == level] for level in ("none", "static", "full")}
    show("largest error none, static, full, deg", {k: np.round(v, 2).tolist() for k, v in errors.items()})
    assert max(errors["full"]) < 0.3 < min(errors["static"]) < min(errors["none"])
    assert [level for level, _ in worn.agreement] == ["none", "static", "full"]
    assert abs(worn.agreement[2][1].limits.bias) < 0.15


def test_fewer_than_three_trials_have_no_agreement() -> None:
    assert agreement_of("lean, deg", np.ones(2), np.ones(2)) is None


@pytest.mark.parametrize(("old", "new"), [("0.02", "0.01"), ("3.5", "inf"), ("2.5", "nan")])
def test_a_force_plate_table_with_gaps_or_times_out_of_order_is_refused(tmp_path, old, new) -> None:
    text = "Time[s]\tFx[N]\tFy[N]\tCOPx[cm]\tCOPy[cm]\n0.01\t1\t2\t3\t2.5\n0.02\t1\t2\t3.5\t4\n"
    (tmp_path / "plate.txt").write_text(text)
    assert read_stance(tmp_path / "plate.txt", mass_kg=60.0, condition="open on firm").time.tolist() == [0.01, 0.02]
    (tmp_path / "plate.txt").write_text(text.replace(old, new))
    with pytest.raises(InputError, match="wanted finite numbers at increasing times, got others; export"):
        read_stance(tmp_path / "plate.txt", mass_kg=60.0, condition="open on firm")


def test_sway_of_a_sine_has_its_size_speed_and_frequency() -> None:
    time = np.arange(0.0, 60.0, 0.01)
    wave = np.sin(2.0 * np.pi * 0.4 * time)
    stance = Stance(
        name="sine",
        condition="closed on foam",
        time=time,
        acceleration=np.stack((0.05 * wave, 0.02 * wave), axis=1),
        pressure=np.stack((0.01 * wave, 0.0 * wave + 0.3), axis=1),
    )
    found = dict(zip((name for name, _ in MEASURES), sway_figures(stance), strict=True))
    assert found["centre of pressure AP, rms"] == pytest.approx(10.0 / np.sqrt(2.0), rel=1e-3)
    assert found["centre of pressure AP, range"] == pytest.approx(20.0, rel=1e-3)
    assert found["speed of the centre of pressure"] == pytest.approx(4.0 * 10.0 * 0.4, rel=0.01)  # 4 A f
    assert found["mean frequency AP"] == pytest.approx(0.4, abs=0.005)
    assert found["acceleration ML, rms"] == pytest.approx(20.0 / np.sqrt(2.0), rel=1e-3)
    short = Stance(
        name="short",
        condition="closed on foam",
        time=time[:1000],
        acceleration=stance.acceleration[:1000],
        pressure=stance.pressure[:1000],
    )
    assert np.isnan(sway_figures(short)).all()


def test_files_and_calls_that_do_not_serve_are_told(tmp_path: Path) -> None:
    other = tmp_path / "other.txt"
    other.write_text("Time\tA\tB\n0\t1\t2\n")
    with pytest.raises(InputError, match=r"wanted columns GRFNET_X, .* got Time, A, B; name them so"):
        read_stance(other, mass_kg=60.0, condition="open on firm")
    with pytest.raises(InputError, match="wanted a table of numbers under one line of names"):
        read_stance(tmp_path / "none.txt", mass_kg=60.0, condition="open on firm")
    with pytest.raises(InputError, match="wanted the person's mass in kg, got 0"):
        read_stance(other, mass_kg=0.0, condition="open on firm")


def foreign(folder: Path, *, with_map: bool = True) -> tuple[Path, Reference]:
    """Two trials in deg/s and g under other names, without a time column, and the file that names them."""
    text, held = "", None
    for k in range(2):
        record, reference = make_recording(np.random.default_rng(k), turn_s=20.0)
        assert record.gyro is not None
        assert record.accel is not None
        cells = np.column_stack((record.accel / STANDARD_GRAVITY, record.gyro / RADIAN_PER_DEGREE))
        np.savetxt(folder / f"t{k}.csv", cells, delimiter=";", header="ax;ay;az;wx;wy;wz", comments="", fmt="%.12g")
        write_reference(reference, folder / f"p{k}.parquet")
        mapped = 'map = "layout.toml"\n' if with_map else ""
        text += f'[[trial]]\nrecording = "t{k}.csv"\nreference = "p{k}.parquet"\ndevice = "F"\n{mapped}'
        held = held or reference
    rate_hz = 1.0 / float(np.median(np.diff(record.time)))
    (folder / "layout.toml").write_text(
        f'sample_rate_hz = {rate_hz!r}\ndelimiter = ";"\n'
        'columns = { gyro = ["wx", "wy", "wz"], accel = ["ax", "ay", "az"] }\nunits = { gyro = "dps", accel = "g" }\n'
    )
    (folder / "real.toml").write_text(text)
    assert held is not None
    return folder / "real.toml", held


def test_trials_in_foreign_columns_and_units_are_read_and_judged_as_the_same_ones_in_our_own(tmp_path: Path) -> None:
    path, reference = foreign(tmp_path)
    (device,) = read_real(path).devices
    known = [make_recording(np.random.default_rng(k), turn_s=20.0)[0] for k in range(2)]
    for (read, _), own in zip(device.pairs, known, strict=True):
        assert (read.gyro_unit, read.accel_unit) == ("dps", "g")
        np.testing.assert_allclose(read.in_si().gyro, own.gyro, rtol=0.0, atol=1e-9)  # 12 digits in the file
        np.testing.assert_allclose(read.in_si().accel, own.accel, rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(np.diff(read.time), np.diff(own.time), rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(
        device.pairs[0][1].q_nb, reference.q_nb, rtol=0.0, atol=1e-14
    )  # made of length one again
    levels = real_errors((device,))
    assert [(level.level, level.rounding) for level in levels] == [
        (name, "none found") for name in ("none", "rest", "calibrated")
    ]  # readings of many digits
    totals = {level.level: level.median.rmse_total_deg for level in levels}
    show("a perfect device in foreign columns, median total error, deg", totals)
    assert totals["none"] < 0.5  # half a sample at up to 3 rad/s: the lag is left in


@pytest.mark.slow
def test_a_map_that_is_missing_or_does_not_fit_is_told_with_the_file(tmp_path: Path) -> None:
    path, _ = foreign(tmp_path, with_map=False)
    with pytest.raises(FileFormatError, match=r"real\.toml: .*t0\.csv: columns: wanted names such as"):
        read_real(path)
    path, _ = foreign(tmp_path)
    layout = tmp_path / "layout.toml"
    layout.write_text(layout.read_text().replace('"wx"', '"vx"'))
    with pytest.raises(FileFormatError, match=r"real\.toml: .*vx"):
        read_real(path)
    layout.unlink()
    with pytest.raises(FileFormatError, match=r"real\.toml: .*layout\.toml"):
        read_real(path)


ACTUAL = """
[actual]
device = "twin.json"
warm_up = "warm_up.csv"
map = "warm_up.toml"
kind = "mpu6050"
room_c = 15.0
set_points_c = [12.0, 18.0, 24.0]
"""


def with_twin(folder: Path, text: str = ACTUAL) -> Path:
    """A device.json, a board that warms from 11 to 29 degC with 0.03 deg/s/K about y, and the file that names them."""
    write_device(preset("xsens_mti1"), folder / "twin.json")
    temp = np.linspace(11.0, 29.0, 5000)
    cells = np.zeros((5000, 8))
    cells[:, 0] = 100.0 * np.arange(5000)
    cells[:, 2] = 0.03 * (temp - 15.0) * 16.4
    cells[:, 6] = 16384.0
    cells[:, 7] = temp
    names = "ms,gx,gy,gz,ax,ay,az,die"
    np.savetxt(folder / "warm_up.csv", cells, delimiter=",", header=names, comments="", fmt="%.10g")
    (folder / "warm_up.toml").write_text(
        'columns = { time = "ms", gyro = ["gx", "gy", "gz"], accel = ["ax", "ay", "az"], temp = "die" }\n'
        'units = { time = "ms", gyro = "dps", accel = "g", temp = "degC" }\n'
        f"scale = {{ gyro = {{ gain = {1.0 / 16.4!r} }}, accel = {{ gain = {1.0 / 16384.0!r} }} }}\n"
    )
    (folder / "real.toml").write_text(text)
    return folder / "real.toml"


def test_a_twin_with_the_offsets_of_a_warm_up_is_the_actual_device_of_figure_3(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    held = read_real(with_twin(tmp_path))
    assert held.actual is not None
    assert held.actual.range_c == pytest.approx(
        (11.18, 28.46), abs=0.01
    )  # means of 10 s, 0.36 K each, the last not whole
    offset = held.actual.device.gyro.offset
    assert offset is not None
    np.testing.assert_allclose(
        np.degrees(offset.at(12.5)) - np.degrees(offset.constant), [0.0, 0.375, 0.0], rtol=0.0, atol=1e-6
    )
    asked = []

    def known(unit, **words):  # type: ignore[no-untyped-def]  # figure3 itself: test_figure3.py
        asked.append((unit, words))
        return "made"

    monkeypatch.setattr(real_module, "figure3", known)
    study = note_study(quick=True, subjects=3)
    assert judge_real(held, study).figure3 == "made"
    ((unit, words),) = asked
    assert unit is held.actual.model
    assert (unit.serial, words["actual"]) == ("mpu6050-typical", held.actual.device)
    assert (words["climate"], words["excursion_k"]) == (Climate(15.0, (12.0, 18.0, 24.0)), 12.5)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (
            "room_c = 15.0",
            "room_c = 9.0",
            r"wanted room_c and set_points_c within its 11\.2 to 28\.5 degC, got 9 to 24",
        ),
        ("24.0]", "40.0]", r"within its 11\.2 to 28\.5 degC, got 12 to 40; change them"),
        ('"mpu6050"', '"mpu"', "preset: wanted one of .*, got 'mpu'"),
    ],
)
def test_a_twin_beyond_its_warm_up_or_of_no_kind_is_refused(tmp_path: Path, old: str, new: str, said: str) -> None:
    with pytest.raises(FileFormatError, match=rf"real\.toml: .*{said}"):
        read_real(with_twin(tmp_path, ACTUAL.replace(old, new)))


def test_a_trial_hotter_than_the_warm_up_is_a_finding_and_the_rest_stands(tmp_path: Path) -> None:
    found = judge_real(
        read_real(with_twin(tmp_path, ACTUAL.replace("15.0", "20.0"))), note_study(quick=True, subjects=3)
    )
    assert found.figure3 is None
    (lack,) = (item.text for item in found.lacks if "twin" in item.text)
    assert "wanted the trial within 28.5 degC of the warm-up, got 32.5" in lack
