"""Thermal sessions of a simulated device in a simulated climatic chamber: soaks, ramps, warm-ups.

A programme of hours is simulated leg by leg. The device keeps its state between legs: its age, its hysteresis, its random walk and
the temperature of its thermometer. The state of the hysteresis depends only on the turning points of the temperature. Bias
instability, which is stationary, is drawn again for each leg.

Chamber: temperatures of set-point, air and board over time.

::

    |r'| <= ramp limit                                   r set-point, straight from one to the next
    a'' + 2 z a' / s + a / s^2 = r / s^2                 a air, with lag s and damping z (it overshoots if z < 1)
    b' = (a - b) / tau                                   b board
    soaked: |b'| < limit throughout the hold             otherwise the chamber waits longer

With x = (a, a', b, r, r'), the system is x' = A x, so a step h is exactly ``x <- expm(h A) x``. Ramps end on whole steps and are
never faster than the limit. Without a chamber, a board warms itself with two time constants, a fast one for die and package and a
slow one for board and case::

    b = end - (end - start) (p exp(-t / t_1) + (1 - p) exp(-t / t_2))

A leg is recorded without interruption. It is a visit to a set-point, a whole ramp or a whole warm-up.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal, get_args

import numpy as np

from undrift.arrays import FloatArray, Shape, freeze
from undrift.errors import InputError, check_positive
from undrift.record import FACES, Face, Record, Session, Still, Turn, joined
from undrift.sim.device.effects import Past, Scene, Thermometer
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.simulate import Simulated, Streams, draw_streams, simulate_device
from undrift.sim.motion.bench import BenchSettings, rest_on_faces, script_motion, steady_rates
from undrift.sim.motion.motion import Motion, Script, after_rest, unit_vector
from undrift.units import RADIAN_PER_DEGREE

# ---- Chamber: the temperature of its set-point, its air and the board in it, over time.

SECONDS_PER_MINUTE = 60.0


@dataclass(frozen=True, slots=True, kw_only=True)
class ChamberSettings:
    """Dynamics of a climatic chamber and of the board in it."""

    # largest slope of the set-point between soaks, degC/min (faster ramps shorten a programme but increase the lag)
    ramp_rate_c_per_min: float = 2.0
    air_lag_s: float = 60.0  # s in the air's equation, s
    damping: float = 0.7  # z in the air's equation: 1 and above never overshoots, 0.7 by 5 % of a sudden step
    board_lag_s: float = 240.0  # time constant tau of the board, s (some minutes for a bare board in moving air)
    soak_rate_c_per_min: float = 0.1  # The board is soaked while its temperature changes by less, degC/min
    # For how long it must do so, s, so that the turn of an overshoot does not pass for a soak
    soak_hold_s: float = 60.0
    longest_wait_s: float = 4.0 * 3600.0  # A soak that takes longer is an error, s
    step_s: float = 1.0  # Step of the profile, s

    def __post_init__(self) -> None:
        check_positive(self, "chamber", "Correct the settings", *self.__dataclass_fields__)


@dataclass(frozen=True, slots=True, kw_only=True)
class RampSettings:
    """A ramp up and back down."""

    low_c: float = 18.0  # Set-points at its ends, degC
    high_c: float = 75.0
    up_c_per_min: float = 1.0  # slope of the set-point, degC/min (with 0 down, the ramp ends at the top)
    down_c_per_min: float = 1.0
    hold_s: float = 600.0  # Wait at the top, and at the bottom in the end, s

    def __post_init__(self) -> None:
        if not (self.high_c > self.low_c and self.up_c_per_min > 0.0 and self.down_c_per_min >= 0.0):
            raise InputError(
                f"ramp: high_c must be above low_c, the rate up positive and the rate down 0 or more, got {self.low_c:g} to "
                f"{self.high_c:g} degC at {self.up_c_per_min:g} and {self.down_c_per_min:g} degC/min. Correct the settings."
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class WarmUpSettings:
    """A board that warms itself after power-on. The defaults are a fit to a recorded MPU-6050, true to 0.03 K rms."""

    start_c: float = 10.7  # Temperature at power-on and in the end, degC
    end_c: float = 29.1
    fast_share: float = 0.52  # p: how much of the way goes with the short time constant, 0 to 1
    fast_s: float = 150.0  # t_1 and t_2, s
    slow_s: float = 549.0
    duration_s: float = 2160.0  # Length, s

    def __post_init__(self) -> None:
        if not (0.0 <= self.fast_share <= 1.0 and min(self.fast_s, self.slow_s, self.duration_s) > 0.0):
            raise InputError(
                f"warm-up: share must be 0 to 1 and times positive, got {self.fast_share:g}, {self.fast_s:g}, "
                f"{self.slow_s:g} and {self.duration_s:g} s. Correct the settings."
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class SetPointVisit:
    """One visit to a set-point."""

    set_point_c: float  # degC
    begin_s: float  # When the chamber leaves the set-point before, s
    soaked_s: float  # When the board is soaked, s
    end_s: float  # When the visit ends, s


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Profile:
    """Temperatures of a programme, n steps."""

    time: Annotated[FloatArray, Shape("n")]  # (n,), s, evenly spaced from 0
    set_point_c: Annotated[FloatArray, Shape("n")]  # (n,), degC, or NaN without a chamber
    air_c: Annotated[FloatArray, Shape("n")]
    board_c: Annotated[FloatArray, Shape("n")]  # (n,), degC
    soaks: tuple[SetPointVisit, ...] = ()  # visits in order of time (empty for a ramp or a warm-up)

    def __post_init__(self) -> None:
        freeze(self)

    def turns_before(self, time_s: float) -> FloatArray:
        """Return the temperatures at which the board began and turned back: all that a play remembers, (k,) degC."""
        temps: FloatArray = self.board_c[self.time < time_s]
        if not len(temps):
            return temps
        temps = temps[np.concatenate(([True], np.diff(temps) != 0.0))]
        slope = np.sign(np.diff(temps))
        return np.asarray(temps[np.concatenate(([0], np.flatnonzero(slope[1:] != slope[:-1]) + 1)).astype(int)])


def soak_profile(
    set_points_c: tuple[float, ...], *, measured_s: float, settings: ChamberSettings | None = None
) -> Profile:
    """Return a programme of soaks: at each set-point wait until the board is soaked, then stay as long as measuring takes."""
    if not set_points_c:
        raise InputError("soaks: at least one set-point is required. Set temperatures in degC.")
    chamber = _Chamber(settings or ChamberSettings(), set_points_c[0])
    soaks = []
    for set_point_c in set_points_c:
        begin_s = chamber.now_s
        chamber.ramp_to(set_point_c, chamber.settings.ramp_rate_c_per_min)
        chamber.wait_for_soak()
        soaked_s = chamber.now_s
        chamber.wait(measured_s)
        soaks.append(SetPointVisit(set_point_c=set_point_c, begin_s=begin_s, soaked_s=soaked_s, end_s=chamber.now_s))
    return chamber.profile(tuple(soaks))


def ramp_profile(ramp: RampSettings, *, settings: ChamberSettings | None = None) -> Profile:
    """Return a ramp from low to high and back."""
    chamber = _Chamber(settings or ChamberSettings(), ramp.low_c)
    chamber.ramp_to(ramp.high_c, ramp.up_c_per_min)
    chamber.wait(ramp.hold_s)
    if ramp.down_c_per_min > 0.0:
        chamber.ramp_to(ramp.low_c, ramp.down_c_per_min)
        chamber.wait(ramp.hold_s)
    return chamber.profile(())


def warm_up_profile(warm_up: WarmUpSettings, *, step_s: float = 1.0) -> Profile:
    """Return the temperature of a board from power-on, without a chamber."""
    time = np.arange(math.ceil(warm_up.duration_s / step_s) + 1) * step_s
    lacking = warm_up.fast_share * np.exp(-time / warm_up.fast_s)
    lacking = lacking + (1.0 - warm_up.fast_share) * np.exp(-time / warm_up.slow_s)
    unknown = np.full(len(time), np.nan)
    board = warm_up.end_c - (warm_up.end_c - warm_up.start_c) * lacking
    return Profile(time=time, set_point_c=unknown, air_c=unknown, board_c=board)


class _Chamber:
    """A chamber at work: each order moves its clock on."""

    def __init__(self, settings: ChamberSettings, start_c: float) -> None:
        from scipy.linalg import expm

        self.settings, s, tau = settings, settings.air_lag_s, settings.board_lag_s
        flow = np.zeros((5, 5))
        flow[0, 1] = 1.0
        flow[1, [0, 1, 3]] = -1.0 / s**2, -2.0 * settings.damping / s, 1.0 / s**2
        flow[2, [0, 2]] = 1.0 / tau, -1.0 / tau
        flow[3, 4] = 1.0
        self.step = expm(flow * settings.step_s)
        self.states = [np.array([start_c, 0.0, start_c, start_c, 0.0])]

    @property
    def now_s(self) -> float:
        return (len(self.states) - 1) * self.settings.step_s

    @property
    def board_rate(self) -> float:
        """Slope of the board's temperature, degC/s."""
        return float(self.states[-1][0] - self.states[-1][2]) / self.settings.board_lag_s

    def wait(self, duration_s: float) -> None:
        for _ in range(math.ceil(duration_s / self.settings.step_s - 1e-9)):
            self.states.append(self.step @ self.states[-1])

    def ramp_to(self, set_point_c: float, rate_c_per_min: float) -> None:
        way = set_point_c - self.states[-1][3]
        steps = math.ceil(abs(way) / (rate_c_per_min / SECONDS_PER_MINUTE * self.settings.step_s) - 1e-9)
        if steps == 0:
            return
        duration_s = steps * self.settings.step_s
        self.states[-1] = self.states[-1] + [0.0, 0.0, 0.0, 0.0, way / duration_s]
        self.wait(duration_s)
        self.states[-1] = np.array([*self.states[-1][:3], set_point_c, 0.0])

    def wait_for_soak(self) -> None:
        limit, since = self.settings.soak_rate_c_per_min / SECONDS_PER_MINUTE, self.now_s
        calm = 0
        while calm * self.settings.step_s < self.settings.soak_hold_s:
            if self.now_s - since > self.settings.longest_wait_s:
                raise InputError(
                    f"soak: the slope must be below {self.settings.soak_rate_c_per_min:g} degC/min within "
                    f"{self.settings.longest_wait_s:g} s at {self.states[-1][3]:g} degC, got "
                    f"{abs(self.board_rate) * SECONDS_PER_MINUTE:.3g} degC/min. Wait longer, or allow a larger slope."
                )
            self.wait(self.settings.step_s)
            calm = calm + 1 if abs(self.board_rate) < limit else 0

    def profile(self, soaks: tuple[SetPointVisit, ...]) -> Profile:
        states = np.array(self.states)
        time = np.arange(len(states)) * self.settings.step_s
        return Profile(time=time, set_point_c=states[:, 3], air_c=states[:, 0], board_c=states[:, 2], soaks=soaks)


# ---- ThermalSettings: how a thermal session is performed, and what of it is written down.

ThermalKind = Literal["soak", "ramp", "warm_up"]

SET_POINTS_C = (18.0, *(float(temp) for temp in range(25, 76, 5)))  # the note's range, every 5 K from 25 degC on
INCLUSIVE_RATES = tuple(
    rate * RADIAN_PER_DEGREE for rate in range(5, 91, 5)
)  # rates for sit-to-stand with both limits, 36 with both signs
BENCH = BenchSettings(sample_rate_hz=50.0, turn_rates=INCLUSIVE_RATES)


@dataclass(frozen=True, slots=True, kw_only=True)
class ThermalSettings:
    """Settings of a thermal session."""

    # motion at a set-point: sample rate (50 Hz), gravity, still_s (6 s a face), rates of the table (5 to 90 deg/s by
    # 5, each in both directions, or none to omit the table), ramp_s and dwell_s (0.5 and 3 s), tilt of the faces (0)
    bench: BenchSettings = BENCH
    chamber: ChamberSettings = ChamberSettings()
    set_points_c: tuple[float, ...] = SET_POINTS_C  # in the order of the visits, degC
    back: bool = False  # visit them again in the opposite order: reveals hysteresis, takes twice as long
    faces: Literal["one", "six"] = "one"  # rest with +z up at each set-point, or with each axis up and down
    one_record: bool = True  # one record, or one for each set-point on the same clock
    ramp: RampSettings = RampSettings()
    warm_up: WarmUpSettings = WarmUpSettings()
    power_on_s: float = 3600.0  # age of the device at the start of the programme, s (a warm-up starts at power-on)
    drop_temperature: bool = False  # no temperature column: stills and turns state their set-points

    def __post_init__(self) -> None:
        if self.power_on_s < 0.0:
            raise InputError(f"thermal: power_on_s must be 0 or more, got {self.power_on_s:g} s. Correct the settings.")


# ---- Programme: what is done with the device at which temperature, as motions on the clock of the chamber.

Work = Callable[[Script], None]  # writes the work at a set-point
Leg = tuple[Motion, SetPointVisit | None]  # recording without interruption on the chamber's clock, and its visit


def programme_of(kind: ThermalKind, settings: ThermalSettings, streams: Streams) -> tuple[Profile, list[Leg]]:
    """Return the temperatures and the motions at each of them, in order of time."""
    bench = settings.bench
    if kind in ("ramp", "warm_up"):
        profile = (
            ramp_profile(settings.ramp, settings=settings.chamber)
            if kind == "ramp"
            else warm_up_profile(settings.warm_up, step_s=settings.chamber.step_s)
        )
        script = Script(bench.sample_rate_hz, unit_vector("+z"))
        script.still(float(profile.time[-1]), "+z")
        return profile, [(script_motion(script, bench), None)]
    draw = streams.of("tilt")
    faces: tuple[Face, ...] = FACES if settings.faces == "six" else ("+z",)

    def work(script: Script) -> None:
        rest_on_faces(script, bench, faces, draw)
        if bench.turn_rates:
            steady_rates(script, bench, streams)

    return _visits(settings, work)


def _visits(settings: ThermalSettings, work: Work) -> tuple[Profile, list[Leg]]:
    rate = settings.bench.sample_rate_hz
    points = settings.set_points_c + (settings.set_points_c[::-1] if settings.back else ())
    profile = soak_profile(points, measured_s=_length_s(settings, work), settings=settings.chamber)
    legs: list[Leg] = []
    up = unit_vector("+z")
    q = Script(rate, up).q
    for soak in profile.soaks:
        script = Script(rate, up)
        script.q = q
        work(script)
        q, motion = script.q, script_motion(script, settings.bench)
        legs.append((replace(motion, time=motion.time + round(soak.soaked_s * rate) / rate), soak))
    return profile, legs


def _length_s(settings: ThermalSettings, work: Work) -> float:
    """Return the duration of the work at a set-point, s, from a rehearsal whose tilts are not used."""
    script = Script(settings.bench.sample_rate_hz, unit_vector("+z"))
    script.still(1.0)
    before = script.samples
    work(script)
    if script.samples == before:
        raise InputError("thermal: the work at the set-points has no length. Give still_s or rates.")
    return (script.samples - before) / settings.bench.sample_rate_hz


# ---- Thermal sessions of a simulated device: soaks, ramps, warm-ups, poses at several temperatures.

RUN_IN_S = 2.0  # at the leg's own temperature, for the filters to settle
PLAIN = Thermometer()
Walks = tuple[FloatArray, FloatArray]  # of the gyroscopes and the accelerometers


def simulate_thermal_session(
    kind: ThermalKind, device: DeviceModel, *, rng: np.random.Generator, settings: ThermalSettings | None = None
) -> Session:
    """Return a thermal session of a simulated device.

    Parameters
    ----------
    kind : str
        ``soak``: at each set-point a rest in one face or six, then steady rates both ways about three axes. ``ramp``: at rest,
        up and down at a rate. ``warm_up``: at rest from power-on, no chamber.
    device : DeviceModel
        The sensors.
    rng : Generator
        Draws tilts, poses and noise.
    settings : ThermalSettings, optional
        How it is performed.

    Returns
    -------
    Session
        Of kind thermal. Where the temperature column was left out, stills and turns state their set-point.

    Raises
    ------
    InputError
        An unknown kind; a board that does not reach its set-point in time.

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
    chosen = settings or ThermalSettings()
    chosen = replace(chosen, power_on_s=0.0) if kind == "warm_up" else chosen
    profile, legs = programme_of(kind, chosen, draw_streams(rng))
    records, stills, turns = _read(profile, legs, device, chosen, rng)
    return Session(
        kind="thermal",
        serial=device.serial,
        gravity_m_s2=chosen.bench.gravity_m_s2,
        records=records,
        stills=stills,
        turns=turns,
    )


def _read(
    profile: Profile, legs: list[Leg], device: DeviceModel, settings: ThermalSettings, rng: np.random.Generator
) -> tuple[tuple[Record, ...], tuple[Still, ...], tuple[Turn, ...]]:
    """Return the recordings of the legs with labels, as a record per leg or as a single record."""
    records: list[Record] = []
    stills: list[Any] = []
    turns: list[Any] = []
    thermometer = device.thermometer
    scene = Scene(
        time=profile.time,
        step_s=float(profile.time[-1] / (len(profile.time) - 1)),
        temp_c=profile.board_c,
        warmth=profile.board_c,
        age_s=profile.time + settings.power_on_s,
    )
    sensor_temp_c = thermometer.felt(scene, Past(rng))
    walked: Walks = (np.zeros(3), np.zeros(3))
    ended_s = 0.0
    for leg in legs:
        time = leg[0].time
        walked = _walked_on(device, walked, float(time[0]) - ended_s, rng)
        gyro, accel = (
            chain.shifted(by) if chain.random_walk else chain
            for chain, by in zip((device.gyro, device.accel), walked, strict=True)
        )
        simulated, first = _simulated(
            leg[0], profile, replace(device, gyro=gyro, accel=accel), settings.power_on_s, rng
        )
        walked = (walked[0] + simulated.gyro.of("random_walk")[-1], walked[1] + simulated.accel.of("random_walk")[-1])
        ended_s = float(time[-1])
        temp_readings = thermometer.shown(
            np.interp(simulated.true_time, profile.time, sensor_temp_c), draw_streams(rng).of("thermometer")
        )
        record = replace(simulated.record, temp_c=None if settings.drop_temperature else temp_readings)
        recording, offset = (0, sum(map(len, records))) if settings.one_record else (len(records), 0)
        for labels, entries in ((leg[0].stills, stills), (leg[0].turns, turns)):
            entries += _labels(labels, leg, simulated.true_time[first:], recording, offset, settings)
        records.append(record.part(first, len(record)))
    if not settings.one_record:
        return tuple(records), tuple(stills), tuple(turns)
    return (joined(records),), tuple(stills), tuple(turns)


def _simulated(
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
    simulated = simulate_device(replace(device, thermometer=PLAIN), motion, rng=rng, temp_c=temp_c, power_on_s=age_s)
    return simulated, int(np.searchsorted(simulated.true_time, start_s - 1e-3 * step_s))


def _walked_on(device: DeviceModel, walked: Walks, gap_s: float, rng: np.random.Generator) -> Walks:
    """Return where the random walks are after a time in which nothing was recorded."""
    streams, span = draw_streams(rng), np.sqrt(max(gap_s, 0.0))
    gyro, accel = (
        at + streams.of(name).standard_normal(3) * (chain.random_walk.bias_walk * span if chain.random_walk else 0.0)
        for name, chain, at in (("gyro_walk", device.gyro, walked[0]), ("accel_walk", device.accel, walked[1]))
    )
    return gyro, accel


def _labels(
    labels: tuple[Any, ...], leg: Leg, true_time: FloatArray, recording: int, offset: int, settings: ThermalSettings
) -> list[Any]:
    """Return the labels of a leg in samples of its record, which begins at an offset: the device's clock may be another."""
    motion, soak = leg
    time, slack = motion.time, 1e-3 / motion.sample_rate_hz

    def sample(edge: int) -> int:
        return offset + (len(true_time) if edge >= len(time) else int(np.searchsorted(true_time, time[edge] - slack)))

    set_point_c = soak.set_point_c if settings.drop_temperature and soak is not None else None
    return [
        replace(x, start=sample(x.start), stop=sample(x.stop), temp_c=set_point_c, recording=recording) for x in labels
    ]
