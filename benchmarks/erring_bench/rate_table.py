"""Rate table: mounting, wobble, ripple and settling, 10 bit, flicker, each alone and all together, with and without accelerometers.

The table is off level by 0.1 deg and its rates are wrong by 1e-4 in every row but the ideal one; the fit states that and 0.1 deg of
mounting, its defaults, and is told nothing of wobble, ripple, settling, codes and flicker. Every device is calibrated twice: with
its accelerometers, by six faces on a level plate, and without. Offsets are those of the whole session where they flicker.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.erring_bench import Row, Tally
from undrift.calibration.calibrate import calibrate
from undrift.calibration.observe import CalibrateSettings
from undrift.record import Session
from undrift.sim.device.effects import Adc, BiasInstability, SensorChain
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.presets import random_device
from undrift.sim.device.simulate import simulate_device
from undrift.sim.motion.bench import BenchSettings, TableErrors, bench_motion
from undrift.units import RADIAN_PER_DEGREE as DEG
from undrift.units import STANDARD_GRAVITY as G

RATES = tuple(rate * DEG for rate in (20.0, 45.0, 70.0, 90.0))
ARM_M = (0.02, 0.01, -0.015)
USUAL = TableErrors(level_sd=0.1 * DEG, rate_sd=1e-4)
FLICKER = (8.0 * DEG / 3600.0, 5e-4)  # rad/s, m/s2
RANGE = (300.0 * DEG, 3.0 * G)  # of 10 bits


@dataclass(frozen=True)
class Case:
    """One bench: what the table does wrong, and the device."""

    table: TableErrors
    bits: int | None = None
    flicker: bool = False
    g_sensitivity: bool = False
    settings: CalibrateSettings = CalibrateSettings(identify_adc=False)


EXACT = CalibrateSettings(
    identify_adc=False, table_level_deg=0.0, mount_tilt_deg=0.0, rate_uncertainty=0.0, wobble_deg=0.0
)
WORST = replace(USUAL, mount_tilt_sd=0.1 * DEG, wobble_sd=0.1 * DEG, ripple_sd=3e-3, excess_sd=3e-3)
CASES = {
    "ideal, stated as such": Case(TableErrors(), settings=EXACT),
    "mounted 0.1 deg off per axis": Case(replace(USUAL, mount_tilt_sd=0.1 * DEG)),
    "mounted 0.1 deg off, faces within 0.05 deg": Case(replace(USUAL, mount_tilt_sd=0.1 * DEG)),
    "wobble 0.1 deg": Case(replace(USUAL, wobble_sd=0.1 * DEG, mount_tilt_sd=0.1 * DEG)),
    "rate ripples and settles late, 0.3 %": Case(
        replace(USUAL, ripple_sd=3e-3, excess_sd=3e-3, mount_tilt_sd=0.1 * DEG)
    ),
    "10 bit": Case(replace(USUAL, mount_tilt_sd=0.1 * DEG), bits=10),
    "flicker 8 deg/h": Case(replace(USUAL, mount_tilt_sd=0.1 * DEG), flicker=True),
    "all together": Case(WORST, bits=12, flicker=True, g_sensitivity=True),
}


def rows(devices: int, seed: int) -> Iterator[Row]:
    """Yield two fits a case, three groups each."""
    for name in CASES:
        yield from rows_of(name, devices, seed)


def rows_of(name: str, devices: int, seed: int) -> Iterator[Row]:
    """Yield the rows of one case."""
    case, rng = CASES[name], np.random.default_rng(seed)
    tallies = Tally("rate table, six faces", name), Tally("rate table alone", name)
    tilt = 0.05 * DEG if "faces" in name else 0.0
    for _ in range(devices):
        device, session, offset = drawn(case, tilt, rng)
        for tally, given in zip(tallies, (session, _without_accel(session)), strict=True):
            made = calibrate(given, settings=case.settings)
            assert made.gyro is not None
            away = made.gyro.matrix - np.linalg.inv(device.gyro.forward_matrix)
            sigma, own = made.gyro.standard_uncertainty, np.eye(3, dtype=bool)
            stated = sigma[:9].reshape(3, 3)
            size = float(np.abs(np.diag(made.gyro.matrix)).mean())
            tally.add(
                made.verdict,
                scale=(away[own] / size, stated[own] / size),
                cross_axis=(away[~own] / size, stated[~own] / size),
                offset=((made.gyro.offset - offset) * size, sigma[9:12] * size),
            )
    for tally in tallies:
        yield from tally.rows()


def drawn(case: Case, tilt_sd: float, rng: np.random.Generator) -> tuple[DeviceModel, Session, np.ndarray]:
    """Return a device, its session, and the offset of its gyroscopes in it, raw."""
    device = random_device(rng)
    flicker = FLICKER if case.flicker else (None, None)
    device = replace(
        device,
        gyro=_chain(
            device.gyro, case, flicker[0], RANGE[0], g_sensitivity=device.gyro.g_sensitivity if case.g_sensitivity else None
        ),
        accel=_chain(device.accel, case, flicker[1], RANGE[1]),
    )
    bench = BenchSettings(
        sample_rate_hz=50.0, turn_rates=RATES, table=case.table, lever_arm_b=ARM_M, tilt_sd=tilt_sd
    )
    motion = bench_motion("bench", rng=rng, settings=bench)
    shown = simulate_device(device, motion, rng=rng)
    session = Session(
        kind="calibration", serial=device.serial, gravity_m_s2=motion.gravity_m_s2, records=(shown.record,),
        stills=motion.stills, turns=motion.turns,
    )  # fmt: skip
    return device, session, device.gyro.raw_offset + device.gyro.gain * shown.gyro.of("instability").mean(axis=0)


def _chain(chain: SensorChain, case: Case, flicker: float | None, span: float, **more: Any) -> SensorChain:
    adc = None
    if case.bits is not None:
        adc = Adc(bits=case.bits, reference=span * chain.gain, codes=False)
    instability = None if flicker is None else BiasInstability(instability=np.full(3, flicker))
    return replace(chain, adc=adc, random_walk=None, instability=instability, **more)


def _without_accel(session: Session) -> Session:
    return replace(session, records=tuple(replace(record, accel=None) for record in session.records))
