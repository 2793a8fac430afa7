"""Free poses and hand moves with temperature creep, 10 bit, flicker, quadratic terms and g-sensitivity, separately and
combined.

Slopes of offset and scale over temperature are drawn with the standard deviations of the fit: 0.5 mg/K, 0.05 deg/s/K
and 0.02 %/K. ``steep`` uses the bounds of data sheets, 0.8 mg/K and 0.032 %/K. Axes are defined as in the fit: z of the
accelerometers is the case's z, and y is in the case's y-z plane. The offset is the reading at zero input.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.erring_bench import ACROSS, Row, Tally, chain_that_errs, drawn_slope, even_rise, times, tripled
from undrift.calibration.calibrate import calibrate
from undrift.calibration.norm import QUADRATIC_SD
from undrift.calibration.settings import CalibrateSettings
from undrift.errors import NotObservable
from undrift.record import Session
from undrift.sim.device.effects import GSensitivity, Nonlinearity, ThermalScale
from undrift.sim.device.presets import random_device
from undrift.sim.device.simulate import simulate_device
from undrift.sim.device.truth import true_calibration
from undrift.sim.motion.bench import BenchSettings, bench_motion
from undrift.units import RADIAN_PER_DEGREE as DEG
from undrift.units import STANDARD_GRAVITY as G

FLICKER = (8.0 * DEG / 3600.0, 5e-5 * G)
RANGE = (500.0 * DEG, 2.0 * G)  # of 10 bits
COUNTS_PER_DPS = 16.4
SETTINGS = CalibrateSettings(identify_adc=False)


@dataclass(frozen=True)
class Case:
    """One bench."""

    creep_c: float = 0.0
    bits: int | None = None
    flicker: bool = False
    thermometer: bool = True
    warm_s: float | None = None  # Time constant of a rise that is not even
    step_c: float | None = None  # Of the thermometer
    steep: float = 1.0  # slopes over temperature, relative to the standard deviations of the fit
    quadratic: float = 0.0  # Standard deviation of the accelerometers' terms, per m/s2
    g_dps_per_g: float = 0.0  # each element of the gyroscopes' g-sensitivity
    poses: int = 18
    tripled: str = ""  # Source at three times its size: creep, codes, flicker, quadratic or g-sensitivity


STATED = Case(creep_c=1.0, bits=12, flicker=True, quadratic=QUADRATIC_SD, g_dps_per_g=0.1)
CASES = {
    "ideal": Case(),
    "creep 1 degC": Case(creep_c=1.0),
    "creep 1 degC, no thermometer": Case(creep_c=1.0, thermometer=False),
    "creep 4 degC": Case(creep_c=4.0),
    "10 bit": Case(bits=10),
    "flicker 8 deg/h, 0.05 mg": Case(flicker=True),
    "creep 1 degC, 12 bit, flicker": Case(creep_c=1.0, bits=12, flicker=True),
    "creep 1 degC, thermometer in steps of 1 degC": Case(creep_c=1.0, step_c=1.0),
    "creep 1 degC, slopes of 0.8 mg/K": Case(creep_c=1.0, steep=1.6),
    "creep 1 degC in 60 s": Case(creep_c=1.0, warm_s=60.0),
    "12 poses, quadratic 2e-4": Case(quadratic=2e-4, poses=12),
    "18 poses, quadratic 1e-4": Case(quadratic=1e-4),
    "18 poses, quadratic 5e-4": Case(quadratic=5e-4),
    "24 poses, quadratic 1e-4": Case(quadratic=1e-4, poses=24),
    "48 poses, quadratic 1e-4": Case(quadratic=1e-4, poses=48),
    "12 poses, g-sensitivity 0.1 deg/s/g": Case(g_dps_per_g=0.1, poses=12),
    "g-sensitivity 0.1 deg/s/g": Case(g_dps_per_g=0.1),
    "g-sensitivity 0.1 deg/s/g, creep 1 degC, flicker": Case(g_dps_per_g=0.1, creep_c=1.0, flicker=True),
    "all sources at their stated sizes": STATED,
    **tripled(STATED, ("creep", "codes", "flicker", "quadratic", "g-sensitivity")),
}


def rows(devices: int, seed: int) -> Iterator[Row]:
    """Yield two triads a case, three groups each."""
    for name in CASES:
        yield from rows_of(name, devices, seed)


def rows_of(name: str, devices: int, seed: int) -> Iterator[Row]:
    """Yield the rows of a case."""
    case, rng = CASES[name], np.random.default_rng(seed)
    tallies = Tally("poses, accelerometers", name), Tally("poses, gyroscopes", name)
    for _ in range(devices):
        session, truth = drawn(case, rng)
        try:
            calibration = calibrate(session, accel="multi-position", gyro="multi-position", settings=SETTINGS)
        except NotObservable:  # a refused fit has no result, so the row counts one device fewer
            continue
        for tally, model, (matrix, offset) in zip(tallies, (calibration.accel, calibration.gyro), truth, strict=True):
            assert model is not None
            observable = ACROSS if model is calibration.gyro else np.triu(ACROSS)
            tally.add_model(calibration.verdict, model, matrix, offset, observable)
    for tally in tallies:
        yield from tally.rows()


def drawn(case: Case, rng: np.random.Generator) -> tuple[Session, list[tuple[np.ndarray, np.ndarray]]]:
    """Return the session of a device, and matrix and offset of accelerometers and gyroscopes at its mean temperature."""
    device = random_device(rng)
    flicker = [size * times(case, "flicker") if case.flicker else None for size in FLICKER]
    span = [size * times(case, "codes") for size in RANGE]
    quadratic, g_dps_per_g = case.quadratic * times(case, "quadratic"), case.g_dps_per_g * times(case, "g-sensitivity")
    gyro, accel = (
        chain_that_errs(
            chain, bits=case.bits, span=span[k], flicker=flicker[k], random_walk=None, thermal_scale=drawn_slope(rng)
        )
        for k, chain in enumerate((device.gyro, device.accel))
    )
    if case.steep != 1.0:
        assert accel.offset is not None
        assert accel.thermal_scale is not None
        steeper = replace(accel.offset, per_k=case.steep * accel.offset.per_k)
        accel = replace(accel, offset=steeper, thermal_scale=ThermalScale(per_k=case.steep * accel.thermal_scale.per_k))
    bent = Nonlinearity(quadratic=rng.normal(0.0, quadratic, 3)) if quadratic else None
    feels = GSensitivity(matrix=rng.normal(0.0, g_dps_per_g * DEG / G, (3, 3))) if g_dps_per_g else None
    device = replace(device, gyro=replace(gyro, g_sensitivity=feels), accel=replace(accel, nonlinearity=bent))
    bench = BenchSettings(sample_rate_hz=50.0, poses=case.poses, still_s=4.0, first_still_s=10.0)
    motion = bench_motion("multi_position", rng=rng, settings=bench)
    temp_c = even_rise(case.creep_c * times(case, "creep"), len(motion))
    if case.warm_s is not None:
        temp_c = 25.0 - case.creep_c * np.exp(-motion.time / case.warm_s)
    if case.step_c is not None:
        device = replace(device, thermometer=replace(device.thermometer, step_c=case.step_c))
    simulated = simulate_device(device, motion, rng=rng, temp_c=temp_c)
    assert simulated.record.gyro is not None
    record = replace(simulated.record, gyro=simulated.record.gyro / COUNTS_PER_DPS, gyro_unit="dps")
    record = record if case.thermometer else replace(record, temp_c=None)
    session = Session(
        kind="calibration",
        serial=device.serial,
        gravity_m_s2=motion.gravity_m_s2,
        records=(record,),
        stills=motion.stills,
    )
    truth = true_calibration(device, temp_c=float(np.mean([temp_c[s.start : s.stop].mean() for s in motion.stills])))
    assert truth.gyro is not None
    assert truth.accel is not None
    orthogonal, upper = np.linalg.qr(truth.accel.matrix)
    sign = np.sign(np.diag(upper))
    offsets = [
        model.offset + chain.gain * (triad.of("instability").mean(axis=0) if case.flicker else 0.0)
        for model, chain, triad in (
            (truth.accel, device.accel, simulated.accel),
            (truth.gyro, device.gyro, simulated.gyro),
        )
    ]
    upper, gyro_matrix = sign[:, None] * upper, (orthogonal * sign).T @ truth.gyro.matrix * COUNTS_PER_DPS
    return session, [(upper, offsets[0]), (gyro_matrix, offsets[1] / COUNTS_PER_DPS)]
