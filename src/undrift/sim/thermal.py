"""Thermal sessions of a simulated device in a simulated climatic chamber: soaks, ramps, warm-ups.

Chamber: temperatures of set-point, air and board over time.

::

    |r'| <= ramp limit                                   r set-point, straight from one to the next
    a'' + 2 z a' / s + a / s^2 = r / s^2                 a air, with lag s and damping z (it overshoots if z < 1)
    b' = (a - b) / tau                                   b board
    soaked: |b'| < limit throughout the hold             otherwise the chamber waits longer

With x = (a, a', b, r, r'), the system is x' = A x, so a step h is exactly ``x <- expm(h A) x``. Ramps end on whole steps and are
never faster than the limit. Without a chamber, a board warms up by itself with two time constants, a fast one for die and package
and a slow one for board and case::

    b = end - (end - start) (p exp(-t / t_1) + (1 - p) exp(-t / t_2))

A leg is recorded without interruption: a visit to a set-point, a whole ramp or a whole warm-up. Between legs, the device keeps its
age, its hysteresis (which depends only on the turning points of the temperature), its random walk and the temperature of its
thermometer. Bias instability, which is stationary, is drawn again for each leg.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple, get_args

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError, check_positive
from undrift.record import FACES, Face, Record, Session, joined
from undrift.sim.device.effects import Past, Scene, Thermometer
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.simulate import Simulated, Streams, draw_streams, simulate_device
from undrift.sim.motion.bench import BenchSettings, rest_on_faces, steady_rates
from undrift.sim.motion.motion import Motion, Script, after_rest, unit_vector
from undrift.units import RADIAN_PER_DEGREE

# ---- temperatures of set-point, air and board over time

STEP_S = 1.0  # time step of a profile, s
SECONDS_PER_MINUTE = 60.0
SOAK_RATE_C_PER_MIN = 0.1  # a board is soaked while its temperature changes by less than this, degC/min
MAX_WAIT_S = 4.0 * 3600.0  # longest wait for a soak, s
POWER_ON_S = 3600.0  # age of the device at the start of a programme, s (a warm-up starts at power-on)
# time constants of a board that warms up by itself: a fit to a recorded MPU-6050, accurate to 0.03 K rms
FAST_SHARE, FAST_S, SLOW_S = 0.52, 150.0, 549.0


@dataclass(frozen=True, slots=True, kw_only=True)
class ChamberSettings:
    """Dynamics of a climatic chamber and of the board in it."""

    # largest slope of the set-point between soaks, degC/min (faster ramps shorten a programme but increase the lag)
    ramp_rate_c_per_min: float = 2.0
    air_lag_s: float = 60.0  # s in the air's equation, s
    damping: float = 0.7  # z in the air's equation: no overshoot for 1 and above, 5 % of a sudden step for 0.7
    board_lag_s: float = 240.0  # time constant tau of the board, s (some minutes for a bare board in moving air)
    # duration for which a board must stay soaked, s, so that the turn of an overshoot does not count
    soak_hold_s: float = 60.0

    def __post_init__(self) -> None:
        check_positive(self, "chamber", "Correct the settings", *self.__dataclass_fields__)


class Profile(NamedTuple):
    """Temperatures of the board in a programme, n steps."""

    time: FloatArray  # (n,), evenly spaced times from 0, s
    board_c: FloatArray  # (n,), temperatures, degC
    soaked_s: tuple[float, ...] = ()  # time at which the board is soaked, for each visit to a set-point, s

    def turns_before(self, time_s: float) -> FloatArray:
        """Return the temperatures at which the board started and reversed, (k,) degC. They are the memory of a play operator."""
        temps: FloatArray = self.board_c[self.time < time_s]
        if not len(temps):
            return temps
        temps = temps[np.concatenate(([True], np.diff(temps) != 0.0))]
        slope = np.sign(np.diff(temps))
        return np.asarray(temps[np.concatenate(([0], np.flatnonzero(slope[1:] != slope[:-1]) + 1)).astype(int)])


class ThermalChamber:
    """A chamber in operation: each command advances its clock."""

    def __init__(self, settings: ChamberSettings, start_c: float) -> None:
        from scipy.linalg import expm

        self.settings, s, tau = settings, settings.air_lag_s, settings.board_lag_s
        flow = np.zeros((5, 5))
        flow[0, 1] = 1.0
        flow[1, [0, 1, 3]] = -1.0 / s**2, -2.0 * settings.damping / s, 1.0 / s**2
        flow[2, [0, 2]] = 1.0 / tau, -1.0 / tau
        flow[3, 4] = 1.0
        self.step = expm(flow * STEP_S)
        self.states = [np.array([start_c, 0.0, start_c, start_c, 0.0])]

    @property
    def now_s(self) -> float:
        return (len(self.states) - 1) * STEP_S

    @property
    def board_c_per_min(self) -> float:
        """Absolute slope of the board's temperature."""
        return SECONDS_PER_MINUTE * abs(float(self.states[-1][0] - self.states[-1][2])) / self.settings.board_lag_s

    def wait(self, duration_s: float) -> None:
        for _ in range(math.ceil(duration_s / STEP_S - 1e-9)):
            self.states.append(self.step @ self.states[-1])

    def ramp_to(self, set_point_c: float, rate_c_per_min: float) -> None:
        change = set_point_c - self.states[-1][3]
        steps = math.ceil(abs(change) / (rate_c_per_min / SECONDS_PER_MINUTE * STEP_S) - 1e-9)
        if steps == 0:
            return
        self.states[-1] = self.states[-1] + [0.0, 0.0, 0.0, 0.0, change / (steps * STEP_S)]
        self.wait(steps * STEP_S)
        self.states[-1] = np.array([*self.states[-1][:3], set_point_c, 0.0])

    def wait_for_soak(self) -> None:
        start_s, calm_s = self.now_s, 0.0
        while calm_s < self.settings.soak_hold_s:
            if self.now_s - start_s > MAX_WAIT_S:
                raise InputError(
                    f"soak: the slope must be below {SOAK_RATE_C_PER_MIN:g} degC/min within {MAX_WAIT_S:g} s at "
                    f"{self.states[-1][3]:g} degC, got {self.board_c_per_min:.3g} degC/min. Reduce the lags of the chamber."
                )
            self.wait(STEP_S)
            calm_s = calm_s + STEP_S if self.board_c_per_min < SOAK_RATE_C_PER_MIN else 0.0

    def profile(self, soaked_s: Sequence[float] = ()) -> Profile:
        board_c = np.array(self.states)[:, 2]
        return Profile(np.arange(len(board_c)) * STEP_S, board_c, tuple(soaked_s))


def soak_profile(set_points_c: tuple[float, ...], measured_s: float, settings: ChamberSettings) -> Profile:
    """Return a programme of soaks: wait at each set-point until the board is soaked, then for the time of the measurement."""
    if not set_points_c:
        raise InputError("soaks: at least one set-point is required. Set temperatures in degC.")
    chamber, soaked_s = ThermalChamber(settings, set_points_c[0]), []
    for set_point_c in set_points_c:
        chamber.ramp_to(set_point_c, settings.ramp_rate_c_per_min)
        chamber.wait_for_soak()
        soaked_s.append(chamber.now_s)
        chamber.wait(measured_s)
    return chamber.profile(soaked_s)


# ---- motion at each temperature, on the clock of the chamber

ThermalKind = Literal["soak", "ramp", "warm_up"]

SET_POINTS_C = (18.0, *(float(temp) for temp in range(25, 76, 5)))  # the note's range, every 5 K from 25 degC on
# rates for sit-to-stand including both limits, 36 with both signs
INCLUSIVE_RATES = tuple(rate * RADIAN_PER_DEGREE for rate in range(5, 91, 5))
BENCH = BenchSettings(sample_rate_hz=50.0, turn_rates=INCLUSIVE_RATES)


@dataclass(frozen=True, slots=True, kw_only=True)
class ThermalSettings:
    """Settings of a thermal session."""

    # motion at a set-point; without ``turn_rates`` the table is omitted
    bench: BenchSettings = BENCH
    chamber: ChamberSettings = ChamberSettings()
    set_points_c: tuple[float, ...] = SET_POINTS_C  # set-points in the order of the visits, degC
    back: bool = False  # repeat the set-points in opposite order, which reveals hysteresis and doubles the duration
    faces: Literal["one", "six"] = "one"  # rest with +z up at each set-point, or with each axis up and down
    ramp_c: tuple[float, float] = (18.0, 75.0)  # set-points at the ends of a ramp up and back down, degC
    ramp_c_per_min: float = 1.0  # slope of the set-point in a ramp, degC/min
    ramp_hold_s: float = 600.0  # wait at the top of a ramp, and at its end, s
    # temperatures of a board that warms up by itself, at power-on and at the end, degC
    warm_up_c: tuple[float, float] = (10.7, 29.1)
    warm_up_s: float = 2160.0  # duration of a warm-up, s


def ramp_profile(settings: ThermalSettings) -> Profile:
    """Return a ramp from low to high and back."""
    low_c, high_c = settings.ramp_c
    chamber = ThermalChamber(settings.chamber, low_c)
    for set_point_c in (high_c, low_c):
        chamber.ramp_to(set_point_c, settings.ramp_c_per_min)
        chamber.wait(settings.ramp_hold_s)
    return chamber.profile()


def warm_up_profile(settings: ThermalSettings) -> Profile:
    """Return the temperature of a board from power-on, without a chamber."""
    start_c, end_c = settings.warm_up_c
    time = np.arange(math.ceil(settings.warm_up_s / STEP_S) + 1) * STEP_S
    lacking = FAST_SHARE * np.exp(-time / FAST_S) + (1.0 - FAST_SHARE) * np.exp(-time / SLOW_S)
    return Profile(time, end_c - (end_c - start_c) * lacking)


def _programme(kind: ThermalKind, settings: ThermalSettings, streams: Streams) -> tuple[Profile, list[Motion]]:
    """Return the temperatures and the motion of each leg, in order of time."""
    bench, rate_hz, up = settings.bench, settings.bench.sample_rate_hz, unit_vector("+z")
    if kind != "soak":
        profile = ramp_profile(settings) if kind == "ramp" else warm_up_profile(settings)
        script = Script(rate_hz, up)
        script.still(float(profile.time[-1]), "+z")
        return profile, [script.motion(bench.gravity_m_s2)]
    draw = streams.of("tilt")
    faces: tuple[Face, ...] = FACES if settings.faces == "six" else ("+z",)

    def write(script: Script) -> None:
        rest_on_faces(script, bench, faces, draw)
        if bench.turn_rates:
            steady_rates(script, bench, streams)

    rehearsal = Script(rate_hz, up)  # only for the duration of a visit; its tilts are not used
    rehearsal.still(1.0)
    before = rehearsal.samples
    write(rehearsal)
    points = settings.set_points_c + (settings.set_points_c[::-1] if settings.back else ())
    profile = soak_profile(points, (rehearsal.samples - before) / rate_hz, settings.chamber)
    legs, q = list[Motion](), Script(rate_hz, up).q
    for soaked_s in profile.soaked_s:
        script = Script(rate_hz, up)
        script.q = q
        write(script)
        q, motion = script.q, script.motion(bench.gravity_m_s2)
        legs.append(replace(motion, time=motion.time + round(soaked_s * rate_hz) / rate_hz))
    return profile, legs


# ---- readings of the device

RUN_IN_S = 2.0  # at the temperature of the leg, so that the filters settle


def simulate_thermal_session(
    kind: ThermalKind,
    device: DeviceModel,
    *,
    rng: np.random.Generator,
    settings: ThermalSettings = ThermalSettings(),
) -> Session:
    """Return a thermal session of a simulated device.

    Parameters
    ----------
    kind : str
        ``soak``: at each set-point a rest in one face or six, then steady rates in both directions about three axes. ``ramp``: at
        rest, up and down at a given slope. ``warm_up``: at rest from power-on, no chamber.
    device : DeviceModel
        The sensors.
    rng : Generator
        Draws tilts and noise.
    settings : ThermalSettings
        Temperatures, bench and chamber.

    Returns
    -------
    Session
        Session of kind thermal with one recording.

    Raises
    ------
    InputError
        If the kind is unknown, or if a board does not reach its set-point in time.

    Examples
    --------
    >>> import numpy as np, undrift
    >>> rng = np.random.default_rng(7)
    >>> device = undrift.random_device(rng)
    >>> session = undrift.simulate_thermal_session("warm_up", device, rng=rng)
    >>> session.kind
    'thermal'
    """
    if kind not in get_args(ThermalKind):
        raise InputError(f"thermal: unknown kind '{kind}'. Use one of {', '.join(get_args(ThermalKind))}.")
    power_on_s = 0.0 if kind == "warm_up" else POWER_ON_S
    profile, legs = _programme(kind, settings, draw_streams(rng))
    scene = Scene(
        time=profile.time,
        step_s=STEP_S,
        temp_c=profile.board_c,
        warmth=profile.board_c,
        age_s=profile.time + power_on_s,
    )
    thermometer = device.thermometer
    sensor_temp_c = thermometer.felt(scene, Past(rng))
    records: list[Record] = []
    labels: dict[str, list[Any]] = {"stills": [], "turns": []}
    walks: dict[str, FloatArray] = {name: np.zeros(3) for name in ("gyro", "accel")}
    previous_s = 0.0
    for motion in legs:
        streams, gap_s = draw_streams(rng), max(float(motion.time[0]) - previous_s, 0.0)
        for name in walks:  # these effects continue while nothing is recorded
            effect = getattr(device, name).random_walk
            if effect is not None:
                steps = streams.of(f"{name}_walk").standard_normal(3)
                walks[name] = walks[name] + steps * effect.bias_walk * np.sqrt(gap_s)
        offsets: dict[str, Any] = {
            name: getattr(device, name).shifted(walk) for name, walk in walks.items() if walk.any()
        }
        simulated, first = _simulate_leg(motion, profile, replace(device, **offsets), power_on_s, rng)
        walks = {name: walks[name] + getattr(simulated, name).of("random_walk")[-1] for name in walks}
        previous_s, true_time = float(motion.time[-1]), simulated.true_time
        readings = np.interp(true_time, profile.time, sensor_temp_c)
        record = replace(simulated.record, temp_c=thermometer.shown(readings, draw_streams(rng).of("thermometer")))
        offset = sum(map(len, records))
        for name, pieces in labels.items():
            pieces += [_placed(piece, motion, true_time[first:], offset) for piece in getattr(motion, name)]
        records.append(record.part(first, len(record)))
    return Session(
        kind="thermal",
        serial=device.serial,
        gravity_m_s2=settings.bench.gravity_m_s2,
        records=(joined(records),),
        stills=tuple(labels["stills"]),
        turns=tuple(labels["turns"]),
    )


def _simulate_leg(
    motion: Motion, profile: Profile, device: DeviceModel, power_on_s: float, rng: np.random.Generator
) -> tuple[Simulated, int]:
    """Return the readings of a run-in and a leg, and the number of the leg's first sample."""
    start_s, step_s = float(motion.time[0]), 1.0 / motion.sample_rate_hz
    turns = profile.turns_before(start_s)
    temp_c = np.interp(motion.time, profile.time, profile.board_c)
    if len(turns):
        count = len(turns) + round(RUN_IN_S / step_s)
        motion = after_rest(motion, np.arange(count, 0, -1) * step_s)
        temp_c = np.concatenate((turns, np.full(count - len(turns), temp_c[0]), temp_c))
    age_s = power_on_s + float(motion.time[0])
    plain = replace(device, thermometer=Thermometer())
    simulated = simulate_device(plain, motion, rng=rng, temp_c=temp_c, power_on_s=age_s)
    return simulated, int(np.searchsorted(simulated.true_time, start_s - 1e-3 * step_s))


def _placed(piece: Any, motion: Motion, true_time: FloatArray, offset: int) -> Any:
    """Return a label in samples of a record that begins at an offset. The clock of the device may be inaccurate."""
    slack = 1e-3 / motion.sample_rate_hz
    start, stop = (
        offset + (len(true_time) if edge >= len(motion) else int(np.searchsorted(true_time, motion.time[edge] - slack)))
        for edge in (piece.start, piece.stop)
    )
    return replace(piece, start=start, stop=stop)
