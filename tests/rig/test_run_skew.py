"""A skew mounting from protocol to tables: +x, +y and +z alike up, one mounting heated in place of three."""

from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np
import pytest

from testkit.rig_bench import DPS, GAIN, OFFSET, Device, Oven, emulated, run
from undrift.calibration.calibrate import calibrate
from undrift.drift.fit import fit_drift
from undrift.drift.rate_steps import CROSS_PER_K
from undrift.errors import Implausible, InputError, NotObservable, RigFault
from undrift.io.session import read_session
from undrift.rig.programme import Dwell, Mount, Protocol, Soak, forecast_of, programme_of, read_protocol, write_protocol

SKEW = Protocol(
    face_s=2.0,
    turn_rate_min=30.0 * DPS,
    turn_rate_max=120.0 * DPS,
    turn_rate_step=30.0 * DPS,
    dwell_s=2.0,
    bracket_s=2.0,
    temperatures_c=(15.0, 35.0, 50.0, 65.0),
    faces_at="room",
    heated_axis="xyz",
)
PER_K = np.array([1e-3, -7e-4, 4e-4])  # of each scale factor
OFFSET_PER_K = np.array([0.02, -0.03, 0.05])  # deg/s
CORNER = np.ones(3) / np.sqrt(3.0)
TILT = np.array([4e-3, -3e-3, -1e-3])  # rad: of the skew mounting


class Board(Device):
    """The same device with a thermometer that scale factors and offsets follow, on a wedge that is off."""

    def __init__(self, emulator, hands, *, oven, corner=CORNER + np.cross(TILT, CORNER)):
        super().__init__(emulator, hands)
        self.oven, self.corner = oven, corner / np.linalg.norm(corner)

    def up(self):
        return self.corner if self.hands.up == "+xyz" else super().up()

    def stop(self):
        record, warmth = super().stop(), self.oven.temp_c - 25.0
        gyro = (record.gyro - OFFSET) * (1.0 + PER_K * warmth) + OFFSET + OFFSET_PER_K * warmth
        temp_c = self.oven.temp_c + 0.01 * self.rng.normal(size=len(record))
        return replace(record, gyro=gyro, temp_c=temp_c)


def ran(folder, protocol=SKEW, *, report=lambda time_s, progress: None, **board):
    oven = Oven()
    with emulated() as emulator:
        readings = partial(Board, oven=oven, **board)
        say = lambda progress: report(emulator.now(), progress)  # noqa: E731
        return run(emulator, folder, protocol, chamber=oven, readings=readings, report=say)


@pytest.fixture(scope="module")
def skewed(tmp_path_factory):
    folder, phases = tmp_path_factory.mktemp("skew"), []
    result, hands = ran(folder, report=lambda time_s, progress: phases.append((time_s, progress.phase)))
    soaked_s = sum(after[0] - at[0] for at, after in pairwise(phases) if at[1] == "soaking")
    return result, hands, soaked_s, read_session(folder)


def test_one_mounting_is_heated_and_turned_at_room_temperature_first(tmp_path):
    programme = programme_of(SKEW)
    ups = [step.up for step in programme.steps if isinstance(step, Mount)]
    assert ups == [*SKEW.faces, "+xyz"]
    assert [step.temp_c for step in programme.steps if isinstance(step, Soak)] == list(SKEW.temperatures_c)
    turned = [
        (step.axis, step.temp_c) for step in programme.steps if isinstance(step, Dwell) and step.purpose == "rate"
    ]
    assert list(dict.fromkeys(turned)) == [(axis, None) for axis in ("x", "y", "z", "xyz")] + [
        ("xyz", temp_c) for temp_c in SKEW.temperatures_c
    ]
    last = [step for step in programme.steps if isinstance(step, Mount)][-1]
    assert str(last) == "mount +xyz up (on a wedge: +x, +y and +z of the case each 54.7 deg from straight up)"
    write_protocol(SKEW, tmp_path / "protocol.toml")
    written = read_protocol(tmp_path / "protocol.toml")
    assert (written.heated_axis, written.axes, written.faces_at) == ("xyz", ("x", "y", "z"), "room")
    assert programme_of(written).duration_s == pytest.approx(programme.duration_s, rel=1e-9)


@pytest.mark.slow
def test_the_forecast_is_what_the_table_needs(skewed):
    result, hands, soaked_s, _ = skewed
    programme = programme_of(SKEW)
    assert hands.mounted == [*SKEW.faces, "+xyz"]
    assert result.duration_s - soaked_s == pytest.approx(forecast_of(programme).rig_s, rel=0.02)
    assert len(result.pieces) == len(programme.dwells)


@pytest.mark.slow
def test_calibrate_and_drift_find_the_scale_of_three_axes_over_temperature(skewed):
    session = skewed[-1]
    assert {still.face for still in session.stills} == {*SKEW.faces, "+xyz"}
    assert {turn.axis for turn in session.turns} == {"x", "y", "z", "xyz"}
    calibration = calibrate(session)
    assert "session.skew" in {item.code for item in calibration.verdict.findings}
    assert np.abs(calibration.gyro.matrix @ GAIN / DPS - np.eye(3)).max() < 5e-4
    fit = fit_drift([session], calibration)
    codes = {item.code for item in fit.verdict.findings}
    assert "drift.scale_skew" in codes
    assert "drift.scale_not_observable" not in codes
    table = fit.choice.scale.drift
    seen = ~table.gyro_extrapolated
    assert table.temp_c[seen].min() <= 15.0
    assert table.temp_c[seen].max() >= 65.0
    true = GAIN[None] * (1.0 + PER_K * (table.temp_c[:, None] - 25.0))[:, :, None]
    left = np.einsum("nij,njk->nik", table.gyro_matrix, true) / DPS - np.eye(3)
    assert np.abs(left[seen]).max() < 1e-3
    stated = table.gyro_uncertainty[seen] / table.gyro_matrix[seen][:, range(3), range(3), None]
    diagonal = np.abs(np.diagonal(left[seen], axis1=1, axis2=2)) / np.diagonal(stated, axis1=1, axis2=2)
    assert diagonal.max() < 2.5
    far = np.abs(table.temp_c[seen] - 25.0)
    least = np.sqrt(2.0) * CROSS_PER_K * far  # what a cross-axis term may hide
    assert (np.diagonal(stated, axis1=1, axis2=2) > 0.9 * least[:, None]).all()
    assert fit.choice.scale.percent_per_k == pytest.approx(100.0 * PER_K, abs=2e-3)


def test_a_session_of_a_skew_mounting_alone_takes_a_calibration_of_before(skewed, tmp_path):
    calibration = calibrate(skewed[-1])
    alone = replace(SKEW, faces=(), axes=("xyz",), heated_axis=None, temperatures_c=(15.0, 35.0, 50.0))
    ran(tmp_path, alone)
    session = read_session(tmp_path)
    with pytest.raises(
        NotObservable, match=r"wanted turns about x, y and z or rests on faces, got \d+ turns and rests in a skew"
    ):
        calibrate(session)
    scale = fit_drift([session], calibration).choice.scale
    assert scale.percent_per_k == pytest.approx(100.0 * PER_K, abs=2e-3)
    unknown = replace(calibration, reference_temp_c=float("nan"))
    fit = fit_drift([session], unknown)
    assert fit.choice is None
    (why,) = (item for item in fit.verdict.findings if item.code == "drift.tables_not_observable")
    assert "or a calibration of a known temperature, got neither" in why.text


@pytest.mark.slow
def test_a_device_mounted_another_way_is_refused_at_the_table_and_in_the_fit(tmp_path):
    wrong = CORNER * (1.0, 1.0, -1.0)
    with pytest.raises(RigFault, match=r"wanted \+xyz up in .*, got gravity along another axis; mount it again"):
        ran(tmp_path / "table", corner=wrong)
    ran(tmp_path / "fit", corner=CORNER)
    session = read_session(tmp_path / "fit")
    turns = tuple(replace(t, turn_rate=-t.turn_rate) if t.axis == "xyz" else t for t in session.turns)
    with pytest.raises(Implausible, match="skew mounting: wanted turns about"):
        fit_drift([replace(session, turns=turns)], calibrate(session))


@pytest.mark.parametrize("wrong", [{"temperatures_c": ()}, {"faces_at": "every"}])
def test_an_axis_for_the_set_points_wants_these_and_faces_before_the_chamber_is_used(wrong):
    with pytest.raises(InputError, match="beside an axis for these, got"):
        replace(SKEW, **wrong)
