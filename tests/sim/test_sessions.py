"""Sessions and trials as undrift gets them."""

import numpy as np

from testkit.demo_session import demo_session
from testkit.quiet import without_noise
from undrift.sim.device.presets import random_device
from undrift.sim.motion.bench import BenchSettings
from undrift.sim.motion.tasks import GROUP_SIZE, cohort
from undrift.sim.sessions import simulate_session, simulate_trial


def test_a_session_without_labels_keeps_its_readings() -> None:
    device = random_device(np.random.default_rng(1))
    settings = BenchSettings(still_s=1.0)
    labelled, bare = (
        simulate_session("ferraris", device, rng=np.random.default_rng(2), settings=settings, labelled=flag)
        for flag in (True, False)
    )
    assert (len(labelled.stills), len(labelled.turns)) == (12, 3)
    assert (bare.stills, bare.turns) == ((), ())
    np.testing.assert_array_equal(labelled.records[0].gyro, bare.records[0].gyro)


def test_temperature_rises_evenly_from_start_to_end() -> None:
    device = without_noise(random_device(np.random.default_rng(1)))
    session = simulate_session(
        "six_face", device, rng=np.random.default_rng(2), settings=BenchSettings(still_s=1.0), temp_c=(20.0, 30.0)
    )
    np.testing.assert_allclose(session.records[0].temp_c, np.linspace(20.0, 30.0, len(session.records[0])))


def test_a_trial_holds_record_reference_and_truth_of_one_motion() -> None:
    trial = simulate_trial("sit_to_stand", random_device(np.random.default_rng(1)), rng=np.random.default_rng(2))
    assert len(trial.record) == len(trial.motion)
    assert trial.reference.valid.mean() > 0.95
    assert trial.record.gyro_unit == "count"


def test_a_subject_performs_the_trial_its_own_way() -> None:
    device = random_device(np.random.default_rng(1))
    short, tall = sorted(cohort("testing", rng=np.random.default_rng(3)), key=lambda person: person.height)[
        :: GROUP_SIZE - 1
    ]
    rises = []
    for subject in (short, tall):
        trial = simulate_trial("sit_to_stand", device, rng=np.random.default_rng(2), subject=subject)
        position = trial.reference.position
        assert position is not None
        rises.append(float(np.nanmedian(position[-50:, 2])))
    # 0.21 of 1.52 m and of 1.83 m; the cameras' noise of tenths of a millimetre is averaged
    np.testing.assert_allclose(rises, [0.21 * 1.52, 0.21 * 1.83], atol=1e-3)


def test_the_demo_is_a_three_minute_session_in_counts_with_a_thermometer() -> None:
    demo = demo_session(np.random.default_rng(0))
    record = demo.session.records[0]
    assert 150.0 < record.duration_s < 200.0
    assert (record.gyro_unit, record.accel_unit) == ("count", "count")
    assert np.abs(record.gyro).max() < 32767  # type: ignore[arg-type]
    assert len(demo.session.turns) == 36
    assert record.temp_c is not None
    assert len(np.unique(record.temp_c)) > 2
