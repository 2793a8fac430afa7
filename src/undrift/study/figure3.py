"""The note's Figure 3: pitch error over time in a sit-to-stand, of the simulated and the actual device.

Each of the two is calibrated and judged by the product's own functions::

    bench session at 25 degC           -> calibrate    offset, matrix
    thermal session, soaks up and down -> fit_drift    tables
    trial, 10 to 15 K warmer           -> correct, orient, compare with the optics, lag removed (validate_trial)

The levels of correction are those of ``validation.levels`` except the first and the last: constants, static table, all tables, the
offset of the rest before the motion (no chamber), and both together. The last level is recommended. Errors are over the 4 s of
the acquisition, from the start of the integration. The note's 3.2 deg are 0.8 deg/s over this time. The board warms from
25 degC while it is worn, with a time constant of 10 min, and has been worn for half an hour. The correlation coefficient is between
the two errors over the acquisition.

The model of the study is a unit without some effects, and the actual device is the same unit with these effects::

    hysteresis      offset differs between warming and cooling               with the size of this kind of device
    thermometer     board thermometer lags behind the sensors                80 s, LM335 in still air
    adc_inl         integral non-linearity of the converter, a bow           2 LSB [assumed], gyroscopes and accelerometers
    g_sensitivity   rate reading under specific force                        with the size of this kind of device
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from undrift.arrays import FloatArray
from undrift.calibration.calibrate import calibrate
from undrift.drift.fit import fit_drift
from undrift.errors import InputError
from undrift.model import Calibration
from undrift.record import Record, Reference
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.presets import preset
from undrift.sim.device.simulate import simulate_device
from undrift.sim.motion.bench import BenchSettings
from undrift.sim.motion.motion import after_rest
from undrift.sim.motion.poses import OpticsSettings, see
from undrift.sim.motion.tasks import Task, draw_task
from undrift.sim.sessions import simulate_session
from undrift.sim.thermal import SET_POINTS_C, ThermalSettings, simulate_thermal_session
from undrift.study.case import WORN_S, on_the_clock
from undrift.study.recorded import SAMPLE_RATE_HZ
from undrift.study.sessions import ROOM_TEMP_C, SETTLED_S, WARM_C
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY
from undrift.validation.align import LEAD_S
from undrift.validation.levels import LEVEL_NAMES, LEVELS, judge_level
from undrift.validation.trial import Trial, TrialSettings

# ---- the simulated and the actual device

INL_LSB = 2.0  # [assumed] specification of 12-bit converters of the note's time
LEAST_LAG_S = 80.0  # LM335 in still air


def actual_device(unit: DeviceModel, *, hidden: bool = True) -> DeviceModel:
    """Return a unit with the effects that the study's model lacks, or without them (the study's model)."""
    chains: dict[str, Any] = {}
    for name, chain in (("gyro", unit.gyro), ("accel", unit.accel)):
        chains[name] = replace(
            chain,
            hysteresis=chain.hysteresis if hidden else None,
            g_sensitivity=chain.g_sensitivity if hidden else None,
            adc=chain.adc and replace(chain.adc, inl_lsb=np.full(3, INL_LSB if hidden else 0.0)),
        )
    lag_s = max(unit.thermometer.lag_s, LEAST_LAG_S) if hidden else 0.0
    return on_the_clock(replace(unit, **chains, thermometer=replace(unit.thermometer, lag_s=lag_s)))


# ---- the figure

COMPARED = LEVEL_NAMES[1:6]
FULL = COMPARED.index("all tables")
ACQUISITION_S = 4.0
WARMING_S = 600.0
BENCH = BenchSettings(turn_rates=tuple(rate * RADIAN_PER_DEGREE for rate in range(15, 91, 15)), dwell_s=1.5)
RATES = tuple(rate * RADIAN_PER_DEGREE for rate in (45, 90))  # two of the note's rates, in both directions
THERMAL = ThermalSettings(bench=replace(BENCH, sample_rate_hz=50.0, turn_rates=RATES))
OPTICS = OpticsSettings(gaps=0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Figure3:
    """Pitch error over the acquisition, N instants, for each of ``COMPARED``."""

    time: FloatArray  # (N,), time from the start of the acquisition, s
    reference_pitch: FloatArray  # (N,), pitch from the optics, deg
    simulated: FloatArray  # (5, N), pitch error of each level, deg
    actual: FloatArray  # (5, N), as above
    excursion_k: float  # temperature of the board minus temperature of the bench, K

    @property
    def simulated_max_deg(self) -> FloatArray:
        """Largest error of the simulated device at each level, (5,), deg."""
        return _largest(self.simulated)

    @property
    def actual_max_deg(self) -> FloatArray:
        """Largest error of the actual device at each level, (5,), deg."""
        return _largest(self.actual)

    @property
    def simulated_actual_max_deg(self) -> FloatArray:
        """Largest difference between the two errors at each level, (5,), deg (at most 0.15 in the note)."""
        return _largest(self.actual - self.simulated)

    @property
    def correlation(self) -> FloatArray:
        """Correlation coefficient of the two errors over the acquisition at each level, (5,)."""
        valid = np.isfinite(self.actual - self.simulated).all(axis=0)
        pairs = zip(self.simulated[:, valid], self.actual[:, valid], strict=True)
        return np.array([np.corrcoef(*pair)[0, 1] for pair in pairs])

    @property
    def decrease_deg(self) -> float:
        """Reduction of the actual device's largest error by both tables, deg (more than 3.2 in the note)."""
        return float(self.actual_max_deg[0] - self.actual_max_deg[2])


def _largest(errors: FloatArray) -> FloatArray:
    return np.asarray(np.nanmax(np.abs(errors), axis=1))


def figure3(unit: DeviceModel | None = None, *, seed: int = 0, back: bool = False) -> Figure3:
    """Compute the note's Figure 3 for a unit as the study models it, and for the same unit with the effects that this model lacks.

    Both devices are calibrated, worn in the same task, which is recorded with optics, and compared. Each has a generator for the
    sessions and one for the trial.
    """
    unit, person = unit or preset("enc03j_3031"), np.random.default_rng([seed, 0])
    performed = draw_task("sit_to_stand", rng=person)
    reference = see(performed, rng=person, settings=OPTICS)
    trials = list[tuple[Trial, ...]]()
    for number, device in ((1, actual_device(unit, hidden=False)), (2, actual_device(unit))):
        full = calibrated(device, rng=np.random.default_rng([seed, number, 0]), back=back)
        rng = np.random.default_rng([seed, number, 1])
        trials.append(judge_compared(full, worn_record(device, performed, rng=rng), reference))
    simulated, actual = trials
    start_s = max(device[FULL].motion.start_s - device[FULL].lag.seconds - LEAD_S for device in trials)
    inside = (simulated[FULL].time >= start_s) & (simulated[FULL].time < start_s + ACQUISITION_S)
    simulated_deg, actual_deg = (
        np.array([trial.error.pitch[inside] for trial in device]) / RADIAN_PER_DEGREE for device in trials
    )
    return Figure3(
        time=actual[FULL].time[inside] - start_s,
        reference_pitch=actual[FULL].reference_pitch[inside] / RADIAN_PER_DEGREE,
        simulated=simulated_deg,
        actual=actual_deg,
        excursion_k=WARM_C,
    )


def judge_compared(full: Calibration, record: Record, reference: Reference) -> tuple[Trial, ...]:
    """Compare a worn trial with the optics for each of ``COMPARED``."""
    trials = list[Trial]()
    for level in LEVELS[1:6]:
        trial = judge_level(level, record, reference, full, TrialSettings())
        if isinstance(trial, str):
            raise InputError(f"Figure 3, {level.name}: {trial}")
        trials.append(trial)
    return tuple(trials)


# ---- calibration and wearing of a device


def calibrated(device: DeviceModel, *, rng: np.random.Generator, back: bool = True) -> Calibration:
    """Calibrate a device on the simulated bench and in the simulated chamber."""
    bench: Any = {"settings": BENCH, "temp_c": ROOM_TEMP_C, "power_on_s": SETTLED_S}
    none = calibrate(simulate_session("bench", device, rng=rng, **bench))
    settings = replace(THERMAL, back=back, set_points_c=SET_POINTS_C)
    thermal = simulate_thermal_session("soak", device, rng=rng, settings=settings)
    return fit_drift((thermal,), none).calibration


def worn_record(device: DeviceModel, performed: Task, *, rng: np.random.Generator) -> Record:
    """Return the readings of a device in a task after half an hour on a person, at the temperature reached by then."""
    before = round(WORN_S * SAMPLE_RATE_HZ)
    moved = performed.at(np.arange(round(performed.duration_s * SAMPLE_RATE_HZ)) / SAMPLE_RATE_HZ, STANDARD_GRAVITY)
    motion = after_rest(moved, np.arange(before, 0, -1) / SAMPLE_RATE_HZ)  # still until the task begins
    share = -np.expm1(-(motion.time + WORN_S) / WARMING_S) / -np.expm1(-WORN_S / WARMING_S)
    record = simulate_device(device, motion, rng=rng, temp_c=ROOM_TEMP_C + WARM_C * share, power_on_s=SETTLED_S).record
    return record.part(before, len(record))
