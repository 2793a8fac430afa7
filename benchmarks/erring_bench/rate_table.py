"""Rate table with mounting, wobble, ripple, settling, 10 bit and flicker, separately and combined, with and without
accelerometers.

Every row except the ideal row draws the default errors of a fit: 0.1 deg of mounting about each axis, 0.1 deg of level,
0.01 deg of wobble, rates wrong by 1e-4 in common. Ripple, settling, codes, flicker and a larger wobble are not
specified in the fit. Dwells last 3 s, or a whole turn and 2 s more if the rate ripples. A consumer gyroscope's offset
walks in every row. Every device is calibrated twice: with its accelerometers, from six faces on a level plate, and
without. The true offset is the mean over the session, from the first to the last of turns and rests.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from benchmarks.erring_bench import Row, Tally, chain_that_errs, times, tripled
from undrift.arrays import FloatArray
from undrift.calibration.calibrate import calibrate
from undrift.calibration.settings import CalibrateSettings
from undrift.record import RateTable, Session, Still, Turn
from undrift.sim.device.effects import LeverArm, PowerOnTransient, RandomWalk
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.presets import random_device
from undrift.sim.device.simulate import simulate_device
from undrift.sim.motion.bench import BenchErrors, BenchSettings, bench_motion
from undrift.units import RADIAN_PER_DEGREE as DEG
from undrift.units import STANDARD_GRAVITY as G

WHOLE_S = 20.0  # a whole turn at the lowest rate, after the settling
RATES = tuple(rate * DEG for rate in (20.0, 45.0, 70.0, 90.0))
ARM = LeverArm(arms=np.tile((0.02, 0.01, -0.015), (3, 1)))
USUAL = BenchErrors(mount_tilt=0.1 * DEG, level=0.1 * DEG, table_rate=1e-4, wobble=0.01 * DEG)
FLICKER = (8.0 * DEG / 3600.0, 5e-4)  # rad/s, m/s2
RANGE = (300.0 * DEG, 3.0 * G)  # of 10 bits


@dataclass(frozen=True)
class Case:
    """A bench: the errors of the table, and the device."""

    table: BenchErrors
    bits: int | None = None
    flicker: bool = False
    g_sensitivity: bool = False
    warm_up_dps: float = 0.0  # of the offset at the first sample, either way, with 60 s
    walk_dps: float | None = None  # deg/s/sqrt(s), or None for a consumer device
    alone_deg: float | None = None  # mounting uncertainty without accelerometers, deg, or None for the default
    stated: RateTable = field(default_factory=RateTable)
    dwell_s: float = 3.0  # steady part of each rate, s
    tripled: str = ""  # Source at three times its size: a field of BenchErrors, codes, flicker or g-sensitivity


SETTINGS = CalibrateSettings(identify_adc=False)
EXACT = RateTable(table_level_deg=0.0, mount_tilt_deg=0.0, rate_uncertainty=0.0, wobble_deg=0.0)
WORST = replace(USUAL, wobble=0.1 * DEG, ripple=3e-3, excess=3e-3)
STATED = Case(USUAL, bits=12, flicker=True, g_sensitivity=True)
CASES = {
    "ideal table, stated as such": Case(BenchErrors(), stated=EXACT),
    "mounted 0.1 deg off per axis": Case(USUAL),
    "the same, faces off level by 0.05 deg": Case(replace(USUAL, face_tilt=0.05 * DEG)),
    "wobble 0.1 deg": Case(replace(USUAL, wobble=0.1 * DEG)),
    "rate ripples and settles late, 0.3 %": Case(replace(USUAL, ripple=3e-3, excess=3e-3), dwell_s=WHOLE_S),
    "10 bit": Case(USUAL, bits=10),
    "12 bit, no g-sensitivity": Case(USUAL, bits=12),
    "flicker 8 deg/h": Case(USUAL, flicker=True),
    "mounted 0.1 deg off, faces by 0.2 deg": Case(replace(USUAL, face_tilt=0.2 * DEG)),
    "mounted 0.3 deg off, faces by 0.05 deg": Case(
        replace(USUAL, mount_tilt=0.3 * DEG, face_tilt=0.05 * DEG), alone_deg=0.3
    ),
    "mounted 0.3 deg off, faces by 0.2 deg": Case(
        replace(USUAL, mount_tilt=0.3 * DEG, face_tilt=0.2 * DEG), alone_deg=0.3
    ),
    "walk of 5e-4 deg/s/sqrt(s)": Case(USUAL, walk_dps=5e-4),
    "warm-up of 0.1 deg/s, 60 s": Case(USUAL, warm_up_dps=0.1),
    "all together, 12 bit, g-sensitivity": Case(WORST, bits=12, flicker=True, g_sensitivity=True, dwell_s=WHOLE_S),
    "all sources at their stated sizes": STATED,
    **tripled(STATED, ("mount_tilt", "level", "table_rate", "wobble", "codes", "flicker", "g-sensitivity")),
}


def rows(devices: int, seed: int) -> Iterator[Row]:
    """Yield two fits a case, three groups each."""
    for name in CASES:
        yield from rows_of(name, devices, seed)


def rows_of(name: str, devices: int, seed: int) -> Iterator[Row]:
    """Yield the rows of a case."""
    case, rng = CASES[name], np.random.default_rng(seed)
    tallies = Tally("rate table, six faces", name), Tally("rate table alone", name)
    for _ in range(devices):
        device, session, offset = drawn(case, rng)
        alone = _without_accel(session)
        if case.alone_deg is not None:
            alone = replace(alone, rate_table=replace(case.stated, mount_tilt_deg=case.alone_deg))
        for tally, source in zip(tallies, (session, alone), strict=True):
            calibration = calibrate(source, settings=SETTINGS)
            assert calibration.gyro is not None
            tally.add_model(calibration.verdict, calibration.gyro, np.linalg.inv(device.gyro.forward_matrix), offset)
    for tally in tallies:
        yield from tally.rows()


def drawn(case: Case, rng: np.random.Generator) -> tuple[DeviceModel, Session, FloatArray]:
    """Return a device, its session, and the mean raw offset of its gyroscopes over the session."""
    device = random_device(rng)
    flicker = [size * times(case, "flicker") if case.flicker else None for size in FLICKER]
    span = [size * times(case, "codes") for size in RANGE]
    gyro, accel = (
        chain_that_errs(chain, bits=case.bits, span=span[k], flicker=flicker[k])
        for k, chain in enumerate((device.gyro, device.accel))
    )
    if gyro.g_sensitivity is not None:
        feels = replace(gyro.g_sensitivity, matrix=gyro.g_sensitivity.matrix * times(case, "g-sensitivity"))
        gyro = replace(gyro, g_sensitivity=feels if case.g_sensitivity else None)
    table = case.table
    if hasattr(table, case.tripled):
        table = replace(table, **{case.tripled: 3.0 * getattr(table, case.tripled)})
    if case.walk_dps is not None:
        gyro = replace(gyro, random_walk=RandomWalk(bias_walk=np.full(3, case.walk_dps * DEG)))
    if case.warm_up_dps:
        amplitude = case.warm_up_dps * DEG * rng.choice((-1.0, 1.0), 3)
        gyro = replace(gyro, warm_up=PowerOnTransient(amplitude=amplitude, time_constant_s=60.0))
    device = replace(device, gyro=gyro, accel=replace(accel, lever_arm=ARM))
    bench = BenchSettings(sample_rate_hz=50.0, turn_rates=RATES, dwell_s=case.dwell_s, errors=table)
    motion = bench_motion("bench", rng=rng, settings=bench)
    simulated = simulate_device(device, motion, rng=rng)
    session = Session(
        kind="calibration", serial=device.serial, gravity_m_s2=motion.gravity_m_s2, records=(simulated.record,),
        stills=motion.stills, turns=motion.turns, rate_table=case.stated,
    )  # fmt: skip
    pieces: list[Still | Turn] = [*motion.turns, *motion.stills]
    during = slice(min(p.start for p in pieces), max(p.stop for p in pieces))
    moved = sum(simulated.gyro.of(name)[during].mean(axis=0) for name in ("instability", "random_walk"))
    moved = moved + (simulated.gyro.of("warm_up")[during].mean(axis=0) if case.warm_up_dps else 0.0)
    return device, session, device.gyro.raw_offset + device.gyro.gain * moved


def _without_accel(session: Session) -> Session:
    return replace(session, records=tuple(replace(record, accel=None) for record in session.records))
