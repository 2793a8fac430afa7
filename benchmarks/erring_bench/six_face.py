"""Six faces with temperature creep, level, 10 bit and flicker errors, separately and combined.

Slopes of offset and scale over temperature are drawn with the standard deviations of the fit, 0.5 mg/K and 0.02 %/K. 10
bits span +-2 g. Accelerometers flicker by 0.05 mg, and the true offset is then the mean over the session. A plate
tilted by more than 0.5 deg always gives a finding.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.erring_bench import Row, Tally, chain_that_errs, drawn_slope, even_rise, times, tripled
from undrift.calibration.session import observe
from undrift.calibration.settings import CalibrateSettings
from undrift.calibration.six_face import calibrate_faces
from undrift.model import Verdict
from undrift.record import Session
from undrift.sim.device.presets import random_device
from undrift.sim.device.simulate import simulate_device
from undrift.sim.device.truth import true_calibration
from undrift.sim.motion.bench import BenchErrors, BenchSettings, bench_motion
from undrift.units import RADIAN_PER_DEGREE as DEG
from undrift.units import STANDARD_GRAVITY as G

FLICKER = 5e-5 * G  # m/s2
RANGE = 2.0 * G  # of 10 bits
COUNTS_PER_DPS = 16.4
SETTINGS = CalibrateSettings(identify_adc=False)


@dataclass(frozen=True)
class Case:
    """One bench."""

    creep_c: float = 0.0  # Even rise over the session
    level: float = 0.0  # Standard deviation of each face about each horizontal axis, rad
    bits: int | None = None
    flicker: bool = False
    thermometer: bool = True
    tripled: str = ""  # Source at three times its size: creep, level, codes or flicker


TOGETHER = Case(creep_c=1.0, level=0.2 * DEG, bits=10, flicker=True)
CASES = {
    "ideal": Case(),
    "creep 1 degC": Case(creep_c=1.0),
    "creep 1 degC, no thermometer": Case(creep_c=1.0, thermometer=False),
    "creep 4 degC": Case(creep_c=4.0),
    "level 0.1 deg": Case(level=0.1 * DEG),
    "level 0.5 deg": Case(level=0.5 * DEG),
    "level 0.1 deg, creep 1 degC": Case(level=0.1 * DEG, creep_c=1.0),
    "10 bit": Case(bits=10),
    "flicker 0.05 mg": Case(flicker=True),
    "all together": TOGETHER,
    **tripled(TOGETHER, ("creep", "level", "codes", "flicker")),
}


def rows(devices: int, seed: int) -> Iterator[Row]:
    """Yield three groups a case."""
    for name in CASES:
        yield from rows_of(name, devices, seed)


def rows_of(name: str, devices: int, seed: int) -> Iterator[Row]:
    """Yield the rows of a case."""
    case, rng, tally = CASES[name], np.random.default_rng(seed), Tally("six faces", name)
    for _ in range(devices):
        session, matrix, offset = drawn(case, rng)
        observed = observe(session, SETTINGS)
        fit = calibrate_faces(observed, "affine")
        tally.add_model(Verdict.of(*observed.findings).also(fit.verdict), fit.model, matrix, offset)
    yield from tally.rows()


def drawn(case: Case, rng: np.random.Generator) -> tuple[Session, np.ndarray, np.ndarray]:
    """Return the session of a device, and its matrix and offset at the mean temperature of its faces."""
    device = random_device(rng)
    flicker = FLICKER * times(case, "flicker") if case.flicker else None
    span = RANGE * times(case, "codes")
    accel = chain_that_errs(
        device.accel, bits=case.bits, span=span, flicker=flicker, random_walk=None, thermal_scale=drawn_slope(rng)
    )
    device = replace(device, accel=accel)
    errors = BenchErrors(face_tilt=case.level * times(case, "level"))
    motion = bench_motion("six_face", rng=rng, settings=BenchSettings(sample_rate_hz=50.0, errors=errors))
    temp_c = even_rise(case.creep_c * times(case, "creep"), len(motion))
    simulated = simulate_device(device, motion, rng=rng, temp_c=temp_c)
    record = simulated.record if case.thermometer else replace(simulated.record, temp_c=None)
    assert record.gyro is not None
    record = replace(record, gyro=record.gyro / COUNTS_PER_DPS, gyro_unit="dps")
    session = Session(
        kind="calibration",
        serial=device.serial,
        gravity_m_s2=motion.gravity_m_s2,
        records=(record,),
        stills=motion.stills,
    )
    mean_c = float(np.mean([temp_c[still.start : still.stop].mean() for still in motion.stills]))
    truth = true_calibration(device, temp_c=mean_c).accel
    assert truth is not None
    offset = (
        truth.offset
        if not case.flicker
        else truth.offset + device.accel.gain * simulated.accel.of("instability").mean(axis=0)
    )
    return session, truth.matrix, offset
