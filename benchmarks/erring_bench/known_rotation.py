"""Known rotation with temperature creep, low-pass, 10 bit, flicker, clock, angle and axis errors, each separately and
combined.

Gyroscopes drift by 0.05 deg/s/K and 0.02 %/K (standard deviation). Their bias instability is 8 deg/h, and the true
offset is then the mean over the session. 10 bits span +-500 deg/s. The uncertainties of angle and axis equal the errors
of the hand, or 0 without errors.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.erring_bench import Row, Tally, chain_that_errs, drawn_slope, even_rise, times, tripled
from undrift.calibration.known_rotation import calibrate_turns
from undrift.calibration.session import observe
from undrift.calibration.settings import CalibrateSettings
from undrift.calibration.six_face import calibrate_faces
from undrift.errors import Implausible
from undrift.model import Verdict
from undrift.record import Session, Still, Turn
from undrift.segments import StillSettings
from undrift.sim.device.effects import LowPass, PowerOnTransient
from undrift.sim.device.presets import FLOOR, random_device
from undrift.sim.device.simulate import simulate_device
from undrift.sim.device.truth import true_calibration
from undrift.sim.motion.bench import BenchErrors, BenchSettings, bench_motion
from undrift.units import RADIAN_PER_DEGREE as DEG

FLICKER = 8.0 * DEG / 3600.0 / FLOOR  # rad/s
RANGE = 500.0 * DEG  # of 10 bits, rad/s
ANGLE_DEG, AXIS_DEG = 1.0, 0.5
SURE_ANGLE_DEG, SURE_AXIS_DEG = 0.05, 0.03
WARM_UP_S = 60.0


@dataclass(frozen=True)
class Case:
    """One bench."""

    creep_c: float = 0.0  # Even rise over the session
    thermometer: bool = True
    cutoff_hz: float | None = None
    bits: int | None = None
    flicker: bool = False
    jitter_s: float = 0.0  # jitter of the time stamps
    by_hand: bool = False
    level: float = 0.0  # tilt of each face about each horizontal axis, rad
    whole_walk: bool = False  # Rate random walk of a consumer part
    faces_alone: bool = False  # no rests next to the turns are marked
    none_found: bool = False  # Nor does the search find one
    warm_up_dps: float = 0.0  # offset at the first sample, of either sign, with WARM_UP_S
    creep_s: float | None = None  # time constant of the rise, or None for a linear rise
    tripled: str = ""  # source at three times its size: creep, codes, flicker, angle, axis, level or walk
    sure: bool = False  # turned to 0.05 deg about axes true to 0.03 deg, with the uncertainties of turns by hand


ALL_BUT_CODES = Case(
    creep_c=1.0, cutoff_hz=4.0, flicker=True, jitter_s=2e-3, by_hand=True, level=0.2 * DEG, whole_walk=True
)
CASES = {
    "ideal": Case(),
    "creep 1 degC": Case(creep_c=1.0),
    "creep 1 degC, no thermometer": Case(creep_c=1.0, thermometer=False),
    "low-pass 4 Hz, sampled at 50 Hz": Case(cutoff_hz=4.0),
    "10 bit": Case(bits=10),
    "flicker 8 deg/h": Case(flicker=True),
    "creep 1 degC, flicker 8 deg/h": Case(creep_c=1.0, flicker=True),
    "rests on faces alone": Case(faces_alone=True),
    "rests on faces alone, flicker 8 deg/h": Case(faces_alone=True, flicker=True),
    "no rest beside the turns, flicker 8 deg/h": Case(faces_alone=True, none_found=True, flicker=True),
    "time stamps jitter 2 ms": Case(jitter_s=2e-3),
    "angle 1 deg, axis 0.5 deg": Case(by_hand=True),
    "level 0.2 deg": Case(level=0.2 * DEG),
    "stated as by hand, turned by a fixture": Case(by_hand=True, sure=True),
    "warm-up of 0.1 deg/s, 60 s": Case(warm_up_dps=0.1),
    "warm-up of 0.1 deg/s, 60 s, by hand": Case(warm_up_dps=0.1, by_hand=True),
    "creep 1 degC with 60 s, no thermometer": Case(creep_c=1.0, thermometer=False, creep_s=60.0),
    "creep 1 degC with 60 s": Case(creep_c=1.0, creep_s=60.0),
    "all but 10 bit": ALL_BUT_CODES,
    "all together": replace(ALL_BUT_CODES, bits=10),
    # stamps that jitter by 6 ms step back, and are refused
    **tripled(
        replace(ALL_BUT_CODES, bits=12), ("creep", "codes", "flicker", "angle", "axis", "level", "walk")
    ),
}  # fmt: skip


def rows(devices: int, seed: int) -> Iterator[Row]:
    """Yield three groups a case."""
    for name in CASES:
        yield from rows_of(name, devices, seed)


def rows_of(name: str, devices: int, seed: int) -> Iterator[Row]:
    """Yield the rows of a case."""
    case, rng, tally = CASES[name], np.random.default_rng(seed), Tally("known rotation", name)
    settings = CalibrateSettings(
        identify_adc=False,
        angle_uncertainty_deg=ANGLE_DEG * case.by_hand,
        axis_uncertainty_deg=AXIS_DEG * case.by_hand,
    )
    if case.none_found:
        settings = replace(settings, still=StillSettings(window_s=10.0))  # longer than any rest
    for _ in range(devices):
        session, matrix, offset = drawn(case, rng)
        observed = observe(session, settings)
        accel = calibrate_faces(observed, "affine")
        try:
            fit = calibrate_turns(observed, "affine", accel)
        except Implausible:  # coarse codes that repeat at the top of a turn look saturated: n is smaller
            continue
        tally.add_model(Verdict.of(*observed.findings).also(fit.verdict), fit.model, matrix, offset)
    yield from tally.rows()


def drawn(case: Case, rng: np.random.Generator) -> tuple[Session, np.ndarray, np.ndarray]:
    """Return the session of a device, its matrix, and the mean of its offset from the first to the last of rests and turns."""
    device = random_device(rng)
    slope, flicker = drawn_slope(rng), FLICKER * times(case, "flicker") if case.flicker else None
    low_pass = None if case.cutoff_hz is None else LowPass(cutoff_hz=np.full(3, case.cutoff_hz))
    walk = device.gyro.random_walk if case.whole_walk else None
    if walk is not None:
        walk = replace(walk, bias_walk=walk.bias_walk * times(case, "walk"))
    warm_up = case.warm_up_dps * DEG * rng.choice((-1.0, 1.0), 3) if case.warm_up_dps else np.zeros(3)
    transient = PowerOnTransient(amplitude=warm_up, time_constant_s=WARM_UP_S) if warm_up.any() else None
    effects = {"random_walk": walk, "thermal_scale": slope, "low_pass": low_pass, "warm_up": transient}
    gyro = chain_that_errs(device.gyro, bits=case.bits, span=RANGE * times(case, "codes"), flicker=flicker, **effects)
    accel = replace(device.accel, adc=None, random_walk=None, low_pass=low_pass)
    device = replace(device, gyro=gyro, accel=accel)
    angle_deg, axis_deg = (SURE_ANGLE_DEG, SURE_AXIS_DEG) if case.sure else (ANGLE_DEG, AXIS_DEG)
    axis = axis_deg * DEG * case.by_hand * times(case, "axis")
    errors = BenchErrors(face_tilt=case.level * times(case, "level"), hand_axis=axis)
    motion = bench_motion("ferraris", rng=rng, settings=BenchSettings(sample_rate_hz=50.0, errors=errors))
    temp_c = even_rise(case.creep_c * times(case, "creep"), len(motion))
    if case.creep_s is not None:
        temp_c = 25.0 + case.creep_c * (0.5 - np.exp(-motion.time / case.creep_s))
    simulated = simulate_device(device, motion, rng=rng, temp_c=temp_c)
    record = simulated.record if case.thermometer else replace(simulated.record, temp_c=None)
    record = replace(record, time=record.time + case.jitter_s * rng.standard_normal(len(record)))
    off = angle_deg * DEG * rng.standard_normal(len(motion.turns)) * case.by_hand * times(case, "angle")
    session = Session(
        kind="calibration",
        serial=device.serial,
        gravity_m_s2=motion.gravity_m_s2,
        records=(record,),
        stills=tuple(still for still in motion.stills if still.face is not None or not case.faces_alone),
        turns=tuple(replace(t, angle=(t.angle or 0.0) + float(d)) for t, d in zip(motion.turns, off, strict=True)),
    )
    pieces: tuple[Still | Turn, ...] = (*motion.stills, *motion.turns)
    mean_c = float(np.mean([temp_c[piece.start : piece.stop].mean() for piece in pieces]))
    truth = true_calibration(device, temp_c=mean_c).gyro
    assert truth is not None
    during = slice(min(piece.start for piece in pieces), max(piece.stop for piece in pieces))
    drift = np.zeros(3)
    for name, on in (("instability", case.flicker), ("random_walk", case.whole_walk), ("warm_up", warm_up.any())):
        drift = drift + (device.gyro.gain * simulated.gyro.of(name)[during].mean(axis=0) if on else 0.0)
    return session, truth.matrix, truth.offset + drift
