"""The note's Figure 3: what thermal drift costs a sit-to-stand in degrees of pitch, and what each table takes of it.

The device is the note's (enc03j_3031), calibrated on the bench at 25 degC; its tables come from a thermal session over 18 to 75
degC; it then stands up with a person 10 to 15 K warmer than it was calibrated at, an hour after power-on. Errors are those over an
acquisition of 4 s, by which DOMAIN 0.8 reads the note's 3.2 deg as 0.8 deg/s, that is 0.07 deg/s/K.

The typical unit has every error at half its tolerance: those 0.07 deg/s/K. Three more, in `make test-long` ten, are drawn with the
seeds 0, 1 and so on, none left out. They draw theirs from N(0, 0.07), cut off at 0.14, so that half of them drift by less than
0.05: their median stays below 3.2.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest

from testkit.data import show
from undrift.calibration.calibrate import calibrate
from undrift.drift.fit import fit_drift
from undrift.model import Calibration, DriftTables
from undrift.record import Record, Reference, Session
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.presets import preset, random_device
from undrift.sim.device.simulate import simulate_device
from undrift.sim.device.truth import true_tables
from undrift.sim.motion.bench import BenchSettings, bench_motion
from undrift.sim.motion.poses import see
from undrift.sim.motion.tasks import draw_task
from undrift.sim.thermal import ThermalSettings, simulate_thermal_session
from undrift.units import RADIAN_PER_DEGREE
from undrift.validation.trial import LEAD_S, Trial, validate_trial

CALIBRATED_C = 25.0
EXCURSIONS_K = (10.0, 12.5, 15.0)
SETTLED_S = 3600.0
ACQUISITION_S = 4.0
TablesOf = Callable[[DeviceModel, Calibration, np.random.Generator], DriftTables]
NAMES = ("none", "static", "static + dynamic")
BENCH = BenchSettings(turn_rates=tuple(rate * RADIAN_PER_DEGREE for rate in range(15, 91, 15)), dwell_s=1.5)
NODES_C = np.arange(18.0, 75.25, 0.5)
# Twelve soaks on the way up, two of the note's rates both ways, for speed; the wait for the chamber is not shortened.
RATES = tuple(rate * RADIAN_PER_DEGREE for rate in (45, 90))
THERMAL = ThermalSettings(bench=replace(BENCH, sample_rate_hz=50.0, turn_rates=RATES))


@dataclass(frozen=True)
class Rise:
    """A sit-to-stand at a temperature."""

    record: Record
    reference: Reference


def bench_session(device: DeviceModel, rng: np.random.Generator) -> Session:
    """Return the bench at the calibration temperature."""
    motion = bench_motion("bench", rng=rng, settings=BENCH)
    simulation = simulate_device(device, motion, rng=rng, temp_c=CALIBRATED_C, power_on_s=SETTLED_S)
    return Session(
        kind="calibration",
        serial=device.serial,
        gravity_m_s2=motion.gravity_m_s2,
        records=(simulation.record,),
        stills=motion.stills,
        turns=motion.turns,
    )


def rise(device: DeviceModel, temp_c: float, rng: np.random.Generator) -> Rise:
    """Return a sit-to-stand with its optics."""
    performed = draw_task("sit_to_stand", rng=rng)
    motion = performed.at(np.arange(round(performed.duration_s * 100.0)) / 100.0, 9.80665)
    simulation = simulate_device(device, motion, rng=rng, temp_c=temp_c, power_on_s=SETTLED_S)
    return Rise(simulation.record, see(performed, rng=rng))


def true_tables_of(device: DeviceModel, calibration: Calibration, rng: np.random.Generator) -> DriftTables:
    """Return the tables that are exact, over what the thermometer says: it is off by its trim and its own warmth."""
    tables = true_tables(device, NODES_C, np.radians(np.arange(-120.0, 121.0, 10.0)))
    off = device.thermometer.trim_error_c + device.thermometer.self_heating_c
    assert tables.static is not None
    assert tables.scale is not None
    assert tables.dynamic is not None
    return DriftTables(
        static=replace(tables.static, temp_c=NODES_C + off),
        scale=replace(tables.scale, temp_c=NODES_C + off),
        dynamic=replace(tables.dynamic, temp_c=NODES_C + off),
    )


def up_tables(device: DeviceModel, calibration: Calibration, rng: np.random.Generator) -> DriftTables:
    """Return the tables that soaks on the way up give: half the loop of the hysteresis stays in them."""
    return fitted(simulate_thermal_session("soak", device, rng=rng, settings=THERMAL), calibration)


def there_and_back_tables(device: DeviceModel, calibration: Calibration, rng: np.random.Generator) -> DriftTables:
    """Return the tables that soaks on the way up and down give."""
    return fitted(simulate_thermal_session("soak", device, rng=rng, settings=replace(THERMAL, back=True)), calibration)


def fitted(session: Session, calibration: Calibration) -> DriftTables:
    """Return the tables that a thermal session gives: offsets, and those of matrix and dynamic drift that are worth it."""
    drift = fit_drift([session], calibration).calibration.drift
    assert drift is not None
    return drift


def over_the_acquisition(trial: Trial) -> tuple[float, float]:
    """Return largest and rms pitch error over four seconds from the start of the integration, deg."""
    start_s = trial.motion.start_s - LEAD_S
    inside = (trial.time >= start_s) & (trial.time < start_s + ACQUISITION_S)
    error = np.degrees(trial.error.pitch[inside])
    return float(np.nanmax(np.abs(error))), float(np.sqrt(np.nanmean(error**2)))


def pitch_errors(
    device: DeviceModel, tables_of: TablesOf, *, seed: int, excursions_k: tuple[float, ...] = EXCURSIONS_K
) -> np.ndarray:
    """Return largest and rms pitch error for each excursion and each of ``NAMES``, deg, shape (E, 3, 2).

    One person stands up in one way at all excursions.
    """
    rng = np.random.default_rng([seed, 1])
    calibration = calibrate(bench_session(device, rng))
    tables = tables_of(device, calibration, rng)
    levels: tuple[Calibration, ...] = (
        calibration,
        replace(calibration, drift=DriftTables(static=tables.static)),
        replace(calibration, drift=tables),
    )
    errors = np.empty((len(excursions_k), len(levels), 2))
    for row, excursion_k in enumerate(excursions_k):
        trial = rise(device, CALIBRATED_C + excursion_k, np.random.default_rng([seed, 2]))
        for column, level in enumerate(levels):
            errors[row, column] = over_the_acquisition(validate_trial(trial.record, trial.reference, calibration=level))
    return errors


def print_table(name: str, errors: np.ndarray, excursions_k: tuple[float, ...] = EXCURSIONS_K) -> None:
    """Print largest and rms errors side by side."""
    for excursion_k, row in zip(excursions_k, errors, strict=True):
        cells = ", ".join(
            f"{level} {largest:.2f} / {rms:.2f}" for level, (largest, rms) in zip(NAMES, row, strict=True)
        )
        show(f"{name}, {excursion_k:g} K: largest / rms pitch error, deg", cells)


@pytest.mark.parametrize(
    "tables_of", [true_tables_of, up_tables, pytest.param(there_and_back_tables, marks=pytest.mark.slow)]
)
def test_typical_unit_gets_three_degrees_back_by_the_tables(tables_of: TablesOf) -> None:
    errors = pitch_errors(preset("enc03j_3031"), tables_of, seed=0)
    print_table(f"typical unit, {tables_of.__name__}", errors)
    fall = errors[:, 0] - errors[:, 2]
    show("fall from none to static + dynamic, largest and rms, deg", np.round(fall, 2).tolist(), 3.2)
    assert fall[:, 0].min() > 3.2  # the note's figure
    assert (errors[:, 2, 0] < errors[:, 1, 0]).all()
    # 0.05 deg/s of half the loop over 4 s, and as much as the true tables leave
    assert errors[:, 2, 0].max() < 0.3


@pytest.mark.slow
@pytest.mark.parametrize("units", [3, 10])
def test_drawn_units_keep_a_small_part_of_their_drift(units: int) -> None:
    middle = EXCURSIONS_K[1:2]
    errors = np.stack(
        [
            pitch_errors(
                random_device(np.random.default_rng(seed), grade="enc03j_3031"),
                up_tables,
                seed=seed,
                excursions_k=middle,
            )
            for seed in range(units)
        ]
    )
    for seed, own in enumerate(errors):
        print_table(f"unit {seed}", own, middle)
    print_table(f"median of {units} units", np.median(errors, axis=0), middle)
    fall = errors[:, 0, 0, 0] - errors[:, 0, 2, 0]
    show("fall of the largest error, unit by unit, deg", np.round(fall, 2).tolist())
    show("its median, deg", round(float(np.median(fall)), 2))
    # Half the loop, 0.1 deg/s at most by the preset's tolerance, over 4 s, and 0.1 deg that the true tables leave.
    assert errors[:, 0, 2, 0].max() < 0.5
    assert fall.min() > 0.0
    # N(0, 0.07 deg/s/K) cut off at two deviations has a median of 0.045: half of the units drift by 0.56 deg/s at 12.5 K, or
    # 2 deg in 3.5 s; what the quadratic term, 0.23 deg/s, takes or gives is within a third of it.
    assert np.median(fall) == pytest.approx(2.0, rel=0.4)
