"""Tasks: human-like motion of a worn device, as functions of time.

Three angles and three coordinates are courses, which are sums of terms with analytic derivatives::

    R_nb = Rz(yaw) Ry(pitch) Rx(roll)                     x forward, y left, z up; pitch forward is positive
    w_b  = (roll' - yaw' sin p,  pitch' cos r + yaw' cos p sin r,  yaw' cos p cos r - pitch' sin r),   w_b' from it
    p    = c + R_nb r                                     c coordinates, r lever arm of the device from their reference point
    f_b  = R_nb^T (c'' + g z) + w' x r + w x (w x r)

A task can be evaluated at any time, so device and optics each use their own sample times.

Tasks (each performance draws its parameters at random):

``sit_to_stand``   The trunk leans forward through a via-point, returns and sways, at up to 90 deg/s.
``step``           Rising a step, with lean, shift of weight, rise and impact of each foot, at up to 45 deg/s.
``posturography``  Quiet stance on foam with eyes closed, a degree of sway for 50 s, at up to 5 deg/s.
``free``           Vigorous turns about all axes for a minute, for a fit to optics.

The three limits are from the note's Table 1, for its category of subjects. A performance beyond them is drawn again.
docs/motions.md lists model, numbers and sources.

Sway of quiet stance: an inverted pendulum that is stabilised with a delayed controller and disturbed by filtered noise. Its angle
is a Gaussian process with a known spectrum. Gains are in units of m g h, J / (m g h) = 1.147 h / g, and the torque noise is white
noise after a first-order low-pass with the time constant tau_n::

    theta / noise = 1 / ((1.147 h/g) s^2 - 1 + (kp + kd s + ki / s) exp(-s tau)) / (1 + tau_n s),   s = 2 pi j f

The process is simulated as a sum of sinusoids, one per geometric frequency band, with Rayleigh amplitudes and random phases, scaled
to an rms.

Subjects have an age, a height, a category and habits, which are a separate root of random numbers. A quantity of a performance is
drawn again until it is within its bounds::

    x = mean + sd (0.8 h + 0.6 z)       h the subject's habit for this quantity, z drawn each time, 0.8^2 + 0.6^2 = 1

A category contains the mean, standard deviation, minimum and maximum of each quantity. A subject has the same habits h in every
category. The defaults of ``Category`` are the numbers of level_2, the note's thirty subjects. They are assumed, except for three
bounds of the note's Table 1. Other categories use them for missing quantities. docs/motions.md lists numbers and publications.
"""

import math
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias, cast, get_args

import numpy as np
from annotated_types import Gt

from undrift.arrays import FloatArray
from undrift.base.codec import stored, tree_of, value_of
from undrift.errors import InputError
from undrift.frames import cross, quaternion_conjugate, quaternion_product, rotate
from undrift.sim.device.simulate import Streams, draw_streams
from undrift.sim.motion.motion import (
    Burst,
    Course,
    CourseTerm,
    Motion,
    Step,
    Sway,
    ViaPoint,
    course_at,
    mean_rate,
    turn_quaternion,
)
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY


@dataclass(frozen=True, slots=True, kw_only=True)
class Task:
    """A motion that can be evaluated at any time."""

    name: str  # name of the task
    duration_s: float  # duration of a recording of the task, s
    moving_s: tuple[float, float]  # start and end of the motion, s
    roll: Course = ()  # Angles, rad
    pitch: Course = ()  # Angles, rad
    yaw: Course = ()  # Angles, rad
    forward: Course = ()  # coordinates in n of the point at which ``arm_b`` starts, m
    left: Course = ()
    up: Course = ()
    # position of the device relative to that point, m (zero: the point is the device)
    arm_b: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def at(self, time: FloatArray, gravity_m_s2: float) -> Motion:
        """Return the motion at given times (N,), s."""
        roll, pitch, yaw = course_at(self.roll, time), course_at(self.pitch, time), course_at(self.yaw, time)
        q = self._orientation(roll[0], pitch[0], yaw[0])
        rate, spin_up = _euler_rate(roll, pitch, yaw)
        arm = np.array(self.arm_b)
        push = np.stack([course_at(course, time)[2] for course in (self.forward, self.left, self.up)], axis=1)
        force = rotate(quaternion_conjugate(q), push + np.array([0.0, 0.0, gravity_m_s2]))
        force = force + cross(spin_up, arm) + cross(rate, cross(rate, arm))
        return Motion(
            time=time,
            q_nb=q,
            rate_b=rate,
            mean_rate_b=mean_rate(time, q, rate[0]),
            angular_acceleration_b=spin_up,
            force_b=force,
            gravity_m_s2=gravity_m_s2,
            moving=((time >= self.moving_s[0]) & (time <= self.moving_s[1])).astype(float),
        )

    def position(self, time: FloatArray) -> FloatArray:
        """Return the position of the device: time (N,) s -> (N, 3) m."""
        base = np.stack([course_at(course, time)[0] for course in (self.forward, self.left, self.up)], axis=1)
        q = self._orientation(*(course_at(course, time)[0] for course in (self.roll, self.pitch, self.yaw)))
        return base + rotate(q, np.broadcast_to(self.arm_b, (len(time), 3)))

    @staticmethod
    def _orientation(roll: FloatArray, pitch: FloatArray, yaw: FloatArray) -> FloatArray:
        x, y, z = np.eye(3)
        return quaternion_product(
            turn_quaternion(z, yaw), quaternion_product(turn_quaternion(y, pitch), turn_quaternion(x, roll))
        )


def _euler_rate(roll: FloatArray, pitch: FloatArray, yaw: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return w_b and its derivative from angles and their first two derivatives, each (3, N)."""
    sr, cr, sp, cp = np.sin(roll[0]), np.cos(roll[0]), np.sin(pitch[0]), np.cos(pitch[0])
    along, across = yaw[1] * cp, yaw[2] * cp - yaw[1] * pitch[1] * sp  # yaw' cos p and its derivative
    rate = np.stack((roll[1] - yaw[1] * sp, pitch[1] * cr + along * sr, along * cr - pitch[1] * sr), axis=1)
    spin_up = np.stack(
        (
            roll[2] - yaw[2] * sp - yaw[1] * pitch[1] * cp,
            pitch[2] * cr + across * sr + roll[1] * rate[:, 2],
            across * cr - pitch[2] * sr - roll[1] * rate[:, 1],
        ),
        axis=1,
    )
    return rate, spin_up


# ---- Sway of quiet stance: an inverted pendulum, stabilised by a delayed controller and disturbed by filtered noise.

BAND_HZ = (0.015, 2.5)
LINES = 48
SWELL_S = 2.5
Spectrum = Callable[[FloatArray], FloatArray]
GYRATION = 1.147  # J / (m h^2) of 66 kg m2, 76 kg, 0.87 m [known-low]


# controller of stance, gains in m g h
PROPORTIONAL, DERIVATIVE, INTEGRAL = (
    1.45,
    0.40,
    0.05,
)  # [known-low] 1.1-1.7; [known-low] 4-5 Nm s/deg over 649 Nm; [assumed]
DELAY_S = 0.17  # [known-low]
NOISE_S = 1.5  # time constant of the torque noise, [assumed] for a rate to angle ratio of 1.2 / 0.9 rad/s


def sway_spectrum(
    frequency_hz: FloatArray, centre_height: float, kp: float = PROPORTIONAL, noise_s: float = NOISE_S
) -> FloatArray:
    """Return the power spectral density (N,) of the angle, up to a constant, for the height of the body's centre over the ankles,
    m."""
    s = 2.0j * math.pi * frequency_hz
    torque = (kp + DERIVATIVE * s + INTEGRAL / s) * np.exp(-s * DELAY_S)
    pendulum = GYRATION * centre_height / STANDARD_GRAVITY * s * s - 1.0
    return np.asarray(np.abs((pendulum + torque) * (1.0 + noise_s * s)) ** -2)


def draw_sway(draw: np.random.Generator, spectrum: Spectrum, *, rms: float, span: tuple[float, float]) -> Sway:
    """Draw a stretch of sway, rad, as sinusoids with a spectrum over frequency, Hz."""
    edges = np.geomspace(*BAND_HZ, LINES + 1)
    frequencies = edges[:-1] + np.diff(edges) * draw.uniform(size=LINES)
    amplitudes = np.sqrt(spectrum(frequencies) * np.diff(edges)) * draw.rayleigh(size=LINES)
    phases = draw.uniform(0.0, 2.0 * math.pi, LINES)
    plain = Sway(tuple(amplitudes.tolist()), tuple(frequencies.tolist()), tuple(phases.tolist()), *span, SWELL_S)
    scale = rms / float(np.std(plain.at(np.arange(span[0], span[1], 0.1 / BAND_HZ[1]))[0]))
    return replace(plain, amplitudes=tuple((scale * amplitudes).tolist()))


# ---- Categories of subjects: parameters of the tasks' models.

CategoryName = Literal["level_1", "level_2", "level_3", "level_4", "young", "elderly", "impaired", "parkinson"]
DEFAULT: CategoryName = "level_2"
Range = tuple[float, float, float]  # minimum, mean and maximum
Spread = tuple[float, float, float, float]  # mean, standard deviation, minimum and maximum
BELOW_ZERO = ("sitting_deg", "standing_deg", "upright_deg")  # quantities that may be


@stored()
@dataclass(frozen=True, slots=True, kw_only=True)
class Category:
    """Numbers of the three tasks for a category of people."""

    label: str  # name for display
    age_years: Range | None = None  # minimum, mean and maximum (by default the note's Table 2, by group)
    height_m: Range | None = None  # minimum, mean and maximum, m
    # age for the numbers below (each further year adds 0.3 % to durations and 1 % to sway)
    typical_age_years: Annotated[float, Gt(0.0)]
    # largest rate about any axis in sit-to-stand, step and posturography, deg/s (a faster performance is drawn again)
    most_dps: tuple[float, float, float] = (90.0, 45.0, 5.0)
    # mean, standard deviation, minimum and maximum (by default the last two are 2.5 standard deviations from the mean)
    rise_s: Spread = (2.3, 0.5, 1.5, 4.0)  # duration of sit-to-stand, s
    # time at which the trunk turns back, share of the duration
    turn_share: Spread = (0.40, 0.05, 0.3, 0.5)
    flexion_deg: Spread = (32.0, 7.0, 15.0, 50.0)  # peak pitch at L5, deg
    sitting_deg: Spread = (5.0, 5.0, -10.0, 20.0)  # first pitch, deg
    standing_deg: Spread = (3.0, 3.0, -6.0, 12.0)  # last pitch, also of a step, deg
    settling_ratio: Annotated[float, Gt(0.0)] = 1.0  # sway after rising, relative to level_2
    step_s: Spread = (2.0, 0.4, 1.2, 3.2)  # duration of a step, s
    lean_deg: Spread = (12.0, 4.0, 3.0, 25.0)  # forward lean in a step, deg
    roll_deg: Spread = (5.0, 2.0, 1.0, 10.0)  # lateral lean in a step, deg
    # quiet stance, eyes closed on foam: rms of pitch, roll and yaw, deg
    sway_deg: tuple[Spread, Spread, Spread] = ((0.9, 0.3, 0.3, 1.8), (0.6, 0.2, 0.2, 1.2), (0.4, 0.1, 0.1, 0.8))
    upright_deg: Spread = (3.0, 2.0, -3.0, 9.0)  # mean pitch of quiet stance, deg
    # stiffness in m g h, which determines the spectrum together with noise_s
    stiffness_mgh: Spread = (1.45, 0.08, 1.25, 1.6)
    noise_s: Annotated[float, Gt(0.0)] = NOISE_S  # time constant of the torque noise, s

    def __post_init__(self) -> None:
        for name in Category.__dataclass_fields__:
            value = getattr(self, name)
            for row in value if name == "sway_deg" else (value,) * isinstance(value, tuple):
                least, mean, greatest = row if len(row) == 3 else (row[2], row[0], row[3])
                rising = least <= mean <= greatest or name == "most_dps"
                if not rising or min(row[1:2] if name in BELOW_ZERO else row) <= 0.0:
                    raise InputError(
                        f"{name}: minimum, mean and maximum must increase and be positive, got {list(row)}. Enter mean, standard "
                        "deviation, minimum and maximum, or minimum, mean and maximum of ages and heights."
                    )


CATEGORIES: dict[CategoryName, Category] = {
    cast(CategoryName, name): value_of(Category, entry, name)
    for name, entry in tomllib.loads(Path(__file__).with_name("categories.toml").read_text("utf-8")).items()
}
Kind: TypeAlias = CategoryName | Category  # named category, or a category of a laboratory


def numbers_of(category: Kind) -> Category:
    """Return the numbers of a category."""
    return category if isinstance(category, Category) else CATEGORIES[category]


REACH_SD = 2.5  # default distance of minimum and maximum from the mean, standard deviations


def category_tree(name: str, table: dict[str, Any]) -> dict[str, Any]:
    """Return all keys of a category. Missing keys are taken from the category named by ``like``."""

    def bounded(value: Any) -> Any:
        if not isinstance(value, list) or not all(isinstance(item, int | float) for item in value):
            return [bounded(item) for item in value] if isinstance(value, list) else value
        return [*value, *(value[0] + side * REACH_SD * value[1] for side in (-1, 1))] if len(value) == 2 else value

    like = table.get("like", DEFAULT)
    if name in CATEGORIES or not name.isidentifier() or like not in CATEGORIES:
        raise InputError(
            f"category.{name}: the name must consist of letters and digits and not be {', '.join(CATEGORIES)}, and `like` must be "
            f"one of these, got {name} like {like}. Rename it."
        )
    values = {key: bounded(value) for key, value in table.items() if key != "like"}
    if isinstance(ages := values.get("age_years"), list) and len(ages) == 3:
        values = {"typical_age_years": ages[1]} | values
    return {**tree_of(CATEGORIES[like]), "label": name.replace("_", " "), **values}


# ---- Subjects: people who perform a task, and the two groups of thirty in the note's Table 2.

Group = Literal["simulation", "testing"]
GROUP_SIZE = 30  # Table 2 and the text: thirty subjects
HABIT, TRIAL = 0.8, 0.6  # weights of the habit and of the individual performance, chosen


@dataclass(frozen=True, slots=True, kw_only=True)
class Subject:
    """A person who performs tasks."""

    number: int  # number in the group, from 1
    group: Group  # simulation or testing
    age_years: float  # Years
    height: float  # m
    habits: Streams  # random streams of the person's habits
    category: Kind = DEFAULT  # category from whose numbers the performances are drawn


TABLE_2: dict[
    Group, tuple[Range, Range]
] = {  # [note] Table 2: ages, years, and heights, m (both groups have Tinetti level 2)
    "simulation": ((45.0, 62.0, 84.0), (1.50, 1.66, 1.85)),
    "testing": ((45.0, 65.0, 83.0), (1.52, 1.67, 1.83)),
}
TYPICAL_HEIGHT = 1.665  # mean of the two groups, for performances without a subject


def cohort(group: Group, *, rng: np.random.Generator, category: Kind = DEFAULT) -> tuple[Subject, ...]:
    """Draw the thirty subjects of a group. The same generator gives the same habits in every category."""
    for got, choices in ((group, get_args(Group)), (category, get_args(CategoryName))):
        if got not in choices and not isinstance(got, Category):
            raise InputError(f"cohort: unknown group or category '{got}'. Use one of {', '.join(choices)}.")
    streams, numbers = draw_streams(rng), numbers_of(category)
    age_range, height_range = TABLE_2[group]
    if numbers.age_years and numbers.height_m:
        age_range, height_range = numbers.age_years, numbers.height_m
    ages = _spread(age_range, streams.of(f"{group} age")).tolist()
    heights = _spread(height_range, streams.of(f"{group} height")).tolist()
    roots = streams.of(f"{group} habits")
    return tuple(
        Subject(number=k + 1, group=group, age_years=age, height=height, habits=draw_streams(roots), category=category)
        for k, (age, height) in enumerate(zip(ages, heights, strict=True))
    )


def _spread(row: Range, draw: np.random.Generator) -> np.ndarray:
    low, mean, high = row
    unit = np.concatenate(([0.0, 1.0], draw.beta(2.0, 2.0, GROUP_SIZE - 2)))
    wanted = (mean - low) / (high - low)
    small, large = 0.05, 20.0  # the mean of u^k falls as k grows
    for _ in range(60):
        k = 0.5 * (small + large)
        small, large = (k, large) if np.mean(unit**k) > wanted else (small, k)
    return np.asarray(draw.permutation(low + (high - low) * unit**k))


@dataclass(frozen=True, slots=True)
class Performance:
    """Random numbers for a performance by a person."""

    draw: np.random.Generator  # random generator of this performance
    subject: Subject | None = None  # person with habits, or None for an unknown person of typical age and height

    @property
    def category(self) -> Category:
        """Category from whose numbers performances are drawn."""
        return numbers_of(self.subject.category if self.subject else DEFAULT)

    @property
    def older(self) -> float:
        """Years beyond the typical age of the category."""
        typical = self.category.typical_age_years
        return (self.subject.age_years if self.subject else typical) - typical

    @property
    def height(self) -> float:
        """Height, m."""
        return self.subject.height if self.subject else TYPICAL_HEIGHT

    def number(self, name: str, mean: float, sd: float, low: float, high: float) -> float:
        """Draw one quantity within its bounds."""
        habit = _bounded_normal(self.subject.habits.of(name)) if self.subject else None
        while True:
            z = float(self.draw.normal())
            value = mean + sd * (z if habit is None else HABIT * habit + TRIAL * z)
            if low <= value <= high:
                return value


def _bounded_normal(draw: np.random.Generator) -> float:
    while True:  # within 2 sd: a habit far outside its bounds could never be performed
        z = float(draw.normal())
        if abs(z) <= 2.0:
            return z


# ---- Library of tasks: motions of subjects in a test trial, each drawn at random.

TaskName = Literal["sit_to_stand", "posturography", "free", "step"]
DEGREE = RADIAN_PER_DEGREE
POSTUROGRAPHY_S = 50.0
MOST_DRAWS = 1000  # largest number of draws until a performance is within the bound of its category
# peak of the acceleration's spectrum over the sine's frequency, for an envelope that peaks at half a period
LOUDEST = 1.385


def draw_task(
    name: TaskName,
    *,
    rng: np.random.Generator,
    subject: Subject | None = None,
    rest_s: float = 6.0,
    pace: float = 1.0,
) -> Task:
    """Draw one performance of a task."""
    if name not in get_args(TaskName):
        raise InputError(f"task: unknown task '{name}'. Use one of {', '.join(get_args(TaskName))}.")
    who = Performance(draw_streams(rng).of(name), subject)
    if name == "free":
        return _free(who.draw, rest_s, pace)
    perform, most_dps = {
        "sit_to_stand": (_sit_to_stand, who.category.most_dps[0]),
        "step": (_step, who.category.most_dps[1]),
        "posturography": (_posturography, who.category.most_dps[2]),
    }[name]
    for _ in range(MOST_DRAWS):
        task = perform(who, rest_s)
        if np.abs(task.at(np.arange(*task.moving_s, 0.02), STANDARD_GRAVITY).rate_b).max() <= most_dps * DEGREE:
            return task
    raise InputError(
        f"{name}, {who.category.label}: none of {MOST_DRAWS} motions is below {most_dps:g} deg/s. Increase most_dps, "
        "or use longer durations or smaller angles."
    )


def with_six_rests(task: Task) -> Task:
    """Return the task, followed by rests of 3 s on each of the six sides of the device."""
    half_turns = {"roll": (0.5, 0.5, 0.5, 0.5, 0.0, 0.0, 0.0), "pitch": (0.0, 0.0, 0.0, 0.0, 0.5, -1.0, 0.5)}
    steps = {
        name: tuple(Step(task.duration_s + 6.0 * k, 3.0, math.pi * turn) for k, turn in enumerate(turns) if turn)
        for name, turns in half_turns.items()
    }
    stop = task.duration_s + 39.0
    moving_s, roll, pitch = (task.moving_s[0], stop), (*task.roll, *steps["roll"]), (*task.pitch, *steps["pitch"])
    return replace(task, duration_s=stop + 3.0, moving_s=moving_s, roll=roll, pitch=pitch)


def _slowness(who: Performance) -> float:
    return 1.0 + 0.003 * who.older  # [assumed] 3 % in ten years


def _sit_to_stand(who: Performance, rest_s: float) -> Task:
    numbers = who.category
    duration = who.number("sit_to_stand duration", *numbers.rise_s) * _slowness(who)
    flexion = duration * who.number("sit_to_stand peak time", *numbers.turn_share)
    lean = who.number("sit_to_stand lean", *numbers.flexion_deg) * DEGREE
    sitting = who.number("sit_to_stand first pitch", *numbers.sitting_deg) * DEGREE
    standing = who.number("sit_to_stand last pitch", *numbers.standing_deg) * DEGREE
    turn, stop = rest_s + flexion, rest_s + duration + who.draw.uniform(0.5, 1.5)
    off = turn - 0.1  # the person leaves the seat shortly before the trunk turns back
    return Task(
        name="sit_to_stand",
        duration_s=stop + rest_s,
        moving_s=(rest_s, stop),
        roll=(_there_and_back(who, "sit_to_stand roll", rest_s, duration), *_settling(who, 0.4, turn, stop)),
        pitch=(
            Step(-2.0, 1.0, sitting),
            ViaPoint(rest_s, flexion, duration - flexion, lean, standing - sitting - lean),
            *_settling(who, 0.5, turn, stop),
        ),
        yaw=(_there_and_back(who, "sit_to_stand yaw", rest_s, duration), *_settling(who, 0.3, turn, stop)),
        forward=(Step(rest_s, 0.52 * duration, 0.18 * who.height),),
        up=(Step(off, 0.42 * duration, 0.21 * who.height),),
    )


def _there_and_back(who: Performance, name: str, start_s: float, duration_s: float) -> CourseTerm:
    size = who.number(name, 0.0, 1.5, -3.0, 3.0) * DEGREE
    return ViaPoint(start_s, 0.45 * duration_s, 0.55 * duration_s, size, -size)


def _settling(who: Performance, amplitude_deg: float, start_s: float, stop_s: float) -> tuple[Sway, ...]:
    amplitude = 0.5 * amplitude_deg * DEGREE * who.category.settling_ratio
    return _waves(who.draw, 2, amplitude, (0.4, 1.2), (start_s, stop_s), 0.45 * (stop_s - start_s))


def _step(who: Performance, rest_s: float) -> Task:
    numbers = who.category
    duration = who.number("step duration", *numbers.step_s) * _slowness(who)
    lean = who.number("step lean", *numbers.lean_deg) * DEGREE
    shift = who.number("step roll", *numbers.roll_deg) * DEGREE * who.draw.choice((-1.0, 1.0))
    first, second = rest_s + 0.35 * duration, rest_s + 0.95 * duration  # impacts of the two feet
    stop = rest_s + duration + 1.0
    side = 0.03 * np.sign(shift)
    return Task(
        name="step",
        duration_s=stop + rest_s,
        moving_s=(rest_s, stop),
        roll=(
            ViaPoint(rest_s, 0.22 * duration, 0.28 * duration, shift, -shift),
            ViaPoint(rest_s + 0.5 * duration, 0.22 * duration, 0.28 * duration, -0.7 * shift, 0.7 * shift),
        ),
        pitch=(
            Step(-2.0, 1.0, who.number("step pitch", *numbers.standing_deg) * DEGREE),
            ViaPoint(rest_s, 0.4 * duration, 0.6 * duration, lean, -lean),
            *_settling(who, 0.5, rest_s + 0.5 * duration, stop),
        ),
        yaw=(_there_and_back(who, "step yaw", rest_s, duration),),
        forward=(Step(rest_s + 0.1 * duration, 0.8 * duration, 0.28), *_knocks(who, 0.4, (first, second))),
        left=(
            ViaPoint(rest_s, 0.25 * duration, 0.25 * duration, -side, side),
            ViaPoint(rest_s + 0.5 * duration, 0.25 * duration, 0.25 * duration, side, -side),
        ),
        up=(Step(first, 0.5 * duration, 0.17), *_knocks(who, 1.0, (first, second))),
    )


def _knocks(who: Performance, share: float, instants_s: tuple[float, ...]) -> tuple[Burst, ...]:
    """Return bursts with drawn peak accelerations, m/s2, and drawn frequencies at which their acceleration spectra peak."""
    bursts = []
    for start_s in instants_s:
        acceleration, frequency_hz = share * who.draw.uniform(1.0, 2.0), who.draw.uniform(5.0, 15.0)
        unit = Burst(1.0, frequency_hz / LOUDEST, 0.0, 0.5 * LOUDEST / frequency_hz)
        largest = float(np.abs(unit.at(np.linspace(0.0, 8.0 * unit.peak_s, 2001))[2]).max())
        bursts.append(replace(unit, amplitude=acceleration / largest, start_s=start_s))
    return tuple(bursts)


def _posturography(who: Performance, rest_s: float) -> Task:
    span = (rest_s, rest_s + POSTUROGRAPHY_S)
    # [assumed] L5 at 0.58 and ankles at 0.04 of the height (the centre of the body is also there)
    arm = 0.54 * who.height
    numbers = who.category
    older = 1.0 + 0.01 * who.older  # [assumed] sway rises by a per cent a year
    kp = who.number("stance stiffness", *numbers.stiffness_mgh)
    spectrum = partial(sway_spectrum, centre_height=arm, kp=kp, noise_s=numbers.noise_s)
    pitch, roll, yaw = (
        who.number(f"sway {name}", *spread) * older * DEGREE
        for name, spread in zip(("pitch", "roll", "yaw"), numbers.sway_deg, strict=True)
    )
    return Task(
        name="posturography",
        duration_s=span[1] + rest_s,
        moving_s=span,
        roll=(draw_sway(who.draw, spectrum, rms=roll, span=span),),
        pitch=(
            Step(-2.0, 1.0, who.number("stance pitch", *numbers.upright_deg) * DEGREE),
            draw_sway(who.draw, spectrum, rms=pitch, span=span),
        ),
        yaw=(draw_sway(who.draw, spectrum, rms=yaw, span=span),),
        arm_b=(0.0, 0.0, arm),
    )


def _free(draw: np.random.Generator, rest_s: float, pace: float) -> Task:
    span, band_hz = (rest_s, rest_s + 60.0), (0.1 * pace, 0.9 * pace)
    return Task(
        name="free",
        duration_s=span[1] + rest_s,
        moving_s=span,
        roll=_waves(draw, 6, 12.0 * DEGREE, band_hz, span),
        pitch=_waves(draw, 6, 12.0 * DEGREE, band_hz, span),
        yaw=_waves(draw, 6, 15.0 * DEGREE, band_hz, span),
        forward=_waves(draw, 4, 0.05, (0.2, 0.9 * pace), span),
        left=_waves(draw, 4, 0.05, (0.2, 0.9 * pace), span),
        up=_waves(draw, 4, 0.03, (0.2, 0.9 * pace), span),
    )


def _waves(
    draw: np.random.Generator,
    count: int,
    amplitude: float,
    band_hz: tuple[float, float],
    span: tuple[float, float],
    swell_s: float = 1.0,
) -> tuple[Sway, ...]:
    frequencies = draw.uniform(*band_hz, count)
    amplitudes = amplitude * draw.uniform(0.5, 1.5, count)
    phases = draw.uniform(0.0, 2.0 * math.pi, count)
    return (Sway(tuple(amplitudes.tolist()), tuple(frequencies.tolist()), tuple(phases.tolist()), *span, swell_s),)
