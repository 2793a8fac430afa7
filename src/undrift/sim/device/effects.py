"""Effects between motion and reading, in order, each with its parameters and the function that applies it.

::

    lever arm -> scale -> non-linearity -> g-sensitivity -> offset -> thermal scale -> rate drift -> warm-up -> hysteresis
    -> white noise -> bias instability -> random walk -> amplifier -> low-pass -> sampling -> ADC

An effect that is None is switched off. Up to the low-pass, signals are in nominal input units (rad/s, m/s2), which is the output
divided by the nominal sensitivity. Without noise and non-linearity, at the reference temperature, the reading is
``u = S (C x + o) + null`` with S the gain of the whole chain and C the scale's matrix. D is the temperature above reference.
Parameters are in SI units. Signals are arrays of shape (N, 3), with a column per channel, and so are the parameters: a scalar
applies to all three channels.

References
----------
.. [1] IEEE Std 952-1997, annex C: bias instability, flat Allan deviation at sqrt(2 ln 2 / pi) B.
.. [2] C. F. Van Loan, "Computing integrals involving the matrix exponential", IEEE Trans. Automatic Control 23(3), 1978.
.. [3] R. P. Sallen and E. L. Key, "A practical method of designing RC active filters", IRE Trans. Circuit Theory 2(1), 1955.
.. [4] B. Barshan and H. F. Durrant-Whyte, "Inertial navigation systems for mobile robots", IEEE Trans. Robotics and
   Automation 11(3):328-342, 1995: C1 (1 - exp(-t / tau)) + C2 with A = C1 and C1 + C2 the settled offset.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cache, lru_cache
from typing import Annotated, Any, Literal, dataclass_transform, get_args, get_type_hints

import numpy as np

from undrift.arrays import BoolArray, FloatArray, Shape, freeze
from undrift.base.codec import AnyNumber, stored
from undrift.errors import InputError, check_choices
from undrift.frames import cross

# ---- parameters

Triple = Annotated[FloatArray, Shape(3)]  # (3,), one value per channel
Square = Annotated[FloatArray, Shape(3, 3)]
Powers = Annotated[FloatArray, Shape("k", 3)]  # one row per power of D, from the first
ZERO: Any = 0.0  # default of all three channels


@dataclass(frozen=True, slots=True)
class Least:
    """Annotation of a parameter: its smallest value."""

    value: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Effect:
    """Base class of effects, which checks its parameters, makes arrays read-only and repeats scalars for the three channels.

    The ``apply`` of an effect returns the signal (N, 3) after it, in nominal input units.
    """

    def __post_init__(self) -> None:
        cls: Any = type(self)
        for name, shape, _ in _marked(cls):
            if shape and np.ndim(getattr(self, name)) == 0:
                object.__setattr__(self, name, np.full(3, getattr(self, name)))
        freeze(self)
        check_choices(self, cls.__name__)
        for name, _, least in _marked(cls):
            if least and np.any((value := np.asarray(getattr(self, name), dtype=float)) < least.value):
                raise InputError(
                    f"{cls.__name__}.{name}: must be {least.value:g} or more, got {np.min(value):g}. Correct the device."
                )


@cache
def _marked(cls: type) -> tuple[tuple[str, Shape | None, Least | None], ...]:
    """Return name, shape and smallest value of each parameter with a required shape or a smallest value."""
    marks = {name: get_args(hint)[1:] for name, hint in get_type_hints(cls, include_extras=True).items()}
    rows = (
        (name, *(next((mark for mark in found if isinstance(mark, kind)), None) for kind in (Shape, Least)))
        for name, found in marks.items()
    )
    return tuple((name, shape, least) for name, shape, least in rows if shape or least)  # type: ignore[misc]


@dataclass_transform(frozen_default=True, kw_only_default=True, eq_default=False)
def effect(cls: type) -> Any:
    """Make a class a frozen dataclass that is stored in device.json with all its keys."""
    return stored(whole=True)(dataclass(frozen=True, slots=True, kw_only=True, eq=False)(cls))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scene:
    """Input of all effects, N samples."""

    time: FloatArray  # (N,), s
    step_s: float  # mean step of time, s
    temp_c: FloatArray  # (N,), temperature of the board, degC
    warmth: FloatArray  # (N,), temperature above the device's reference temperature, K
    age_s: FloatArray  # (N,), time since power-on, s
    rate_b: FloatArray = field(default_factory=lambda: np.empty((0, 3)))  # (N, 3), angular rate at the sample, rad/s
    angular_acceleration_b: FloatArray | None = None  # (N, 3), angular acceleration, rad/s2
    force_b: FloatArray = field(default_factory=lambda: np.empty((0, 3)))  # (N, 3), at the body's origin, m/s2


@dataclass(slots=True, eq=False)
class Past:
    """Random generator and state of an effect, kept from one chunk of a signal to the next."""

    rng: np.random.Generator
    state: Any = None


def check_even(scene: Scene, what: str) -> None:
    """Raise InputError if the samples are not evenly spaced."""
    steps = np.diff(scene.time)
    if np.abs(steps - scene.step_s).max(initial=0.0) > 1e-3 * scene.step_s:
        raise InputError(
            f"{what}: samples of the motion must be evenly spaced, got steps from {steps.min():.6g} to {steps.max():.6g} s. "
            "Sample the motion on an even grid."
        )


# ---- Lever arm: d_i = alpha x r_i + omega x (omega x r_i), added to the specific force at sensor i


@effect
class LeverArm(Effect):
    """Positions of the accelerometers."""

    arms: Square  # position of each sensor from the body's origin, one row per sensor, m, frame b

    def force(self, scene: Scene) -> FloatArray:
        """Return the force of each sensor in addition to the force at the origin, (N, 3 sensors, 3)."""
        if scene.angular_acceleration_b is None:
            raise InputError(
                "lever arm: the motion has no angular acceleration. Use a motion from poses or a task, or switch the lever arm off."
            )
        rate, arm = scene.rate_b[:, None, :], self.arms[None, :, :]
        return np.asarray(cross(scene.angular_acceleration_b[:, None, :], arm) + cross(rate, cross(rate, arm)))


# ---- Scale and axes: y = diag(1 + s) E x, where the rows of E are the sensor axes in b


@effect
class Scale(Effect):
    """Sensitivities and axes of a triad."""

    nominal_sensitivity: float  # value in the data sheet, output unit per rad/s or m/s2
    error: Triple = ZERO  # s, relative error of each sensor's sensitivity
    axes: Square = field(default_factory=lambda: np.eye(3))  # E, unit vector of each sensor in b, one row per sensor

    def __post_init__(self) -> None:
        Effect.__post_init__(self)
        length = np.linalg.norm(self.axes, axis=1)
        if (np.abs(length - 1.0) > 1e-9).any():
            raise InputError(
                f"scale: axes must be unit vectors, got lengths {np.array2string(length, precision=4)}. "
                "Enter the gain as the scale error."
            )
        if self.nominal_sensitivity <= 0.0:
            raise InputError(
                f"scale: nominal sensitivity must be positive, got {self.nominal_sensitivity:g}. To reverse an axis, change `axes`."
            )

    @property
    def matrix(self) -> FloatArray:
        """diag(1 + s) E, shape (3, 3)."""
        return np.asarray((1.0 + self.error)[:, None] * self.axes)

    def scaled(self, x: FloatArray, arm_force: FloatArray | None) -> FloatArray:
        """Return the output of the channels for a motion, and for the force at the position of each sensor."""
        if arm_force is None:
            return np.asarray(x @ self.matrix.T)
        along = x @ self.axes.T + np.einsum("ij,nij->ni", self.axes, arm_force)
        return np.asarray(along * (1.0 + self.error))


# ---- Non-linearity: y = x + q x^2


@effect
class Nonlinearity(Effect):
    """Deviation of the output from a straight line."""

    quadratic: Triple = ZERO  # q, per rad/s or per m/s2

    def bent(self, x: FloatArray) -> FloatArray:
        """Return a signal after the non-linearity is applied."""
        return np.asarray(x + x * x * self.quadratic)

    def apply(self, x: FloatArray, scene: Scene, past: Past) -> FloatArray:
        return self.bent(x)


# ---- g-sensitivity: y = x + G f


@effect
class GSensitivity(Effect):
    """Apparent rate of a gyroscope due to specific force."""

    matrix: Square  # apparent rate, rad/s per m/s2: row i for sensor i, columns x, y, z of b

    def apply(self, x: FloatArray, scene: Scene, past: Past) -> FloatArray:
        return np.asarray(x + scene.force_b @ self.matrix.T)


# ---- Offset and its thermal drift: y = x + o + c_1 D + c_2 D^2 + ...


@effect
class Offset(Effect):
    """Output at zero input."""

    constant: Triple = ZERO  # offset at the reference temperature, rad/s or m/s2
    # coefficients of D, D^2, ..., rad/s or m/s2 per K^k
    per_k: Powers = field(default_factory=lambda: np.zeros((0, 3)))

    def at(self, warmth: FloatArray | float) -> FloatArray:
        """Return the offset at a temperature above reference, K."""
        return self.constant + polynomial(self.per_k, np.asarray(warmth, dtype=float))

    def apply(self, x: FloatArray, scene: Scene, past: Past) -> FloatArray:
        return x + (self.at(scene.warmth) if len(self.per_k) else self.constant)


def polynomial(coefficients: FloatArray, warmth: FloatArray) -> FloatArray:
    """Return ``sum_k c_k D^k`` for k = 1, 2, ... per axis."""
    total = np.zeros((*warmth.shape, 3))
    for row in coefficients[::-1]:
        total = (total + row) * warmth[..., None]
    return total


# ---- Thermal scale: y = x (1 + k_1 D + k_2 D^2 + ...), which also applies to the offset


@effect
class ThermalScale(Effect):
    """Change of the sensitivity with temperature."""

    per_k: Powers  # relative change with D, D^2, ..., per K^k

    def factor(self, warmth: FloatArray | float) -> FloatArray:
        """Return the factor at a temperature above reference, K."""
        return 1.0 + polynomial(self.per_k, np.asarray(warmth, dtype=float))

    def apply(self, x: FloatArray, scene: Scene, past: Past) -> FloatArray:
        return x * self.factor(scene.warmth)


# ---- Rate-dependent drift, the note's dynamic drift: y = x + sum_pq c_pq x^p D^q, p = 1, 2, ...


@effect
class RateDrift(Effect):
    """Error that depends on rate and temperature."""

    # (P, Q, 3), c_pq with power p = 1..P of the rate and q = 0..Q-1 of the warmth, rad/s over (rad/s)^p K^q
    coefficients: Annotated[FloatArray, Shape("p", "q", 3)]

    def error(self, x: FloatArray, warmth: FloatArray) -> FloatArray:
        """Return e(x, T)."""
        total = np.zeros_like(x)
        for powers in self.coefficients[::-1]:
            inner = np.zeros_like(x)
            for row in powers[::-1]:
                inner = inner * warmth[:, None] + row
            total = (total + inner) * x
        return total

    def apply(self, x: FloatArray, scene: Scene, past: Past) -> FloatArray:
        return x + self.error(x, scene.warmth)


# ---- Warm-up: y = x - A exp(-t / tau), the difference from the settled offset [4]


@effect
class PowerOnTransient(Effect):
    """Offset over time since power-on."""

    amplitude: Triple  # change from power-on to the settled value, rad/s or m/s2
    time_constant_s: Annotated[float, Least(1e-9)]  # s

    def apply(self, x: FloatArray, scene: Scene, past: Past) -> FloatArray:
        return np.asarray(x - np.outer(np.exp(-scene.age_s / self.time_constant_s), self.amplitude))


# ---- Thermal hysteresis: y = x + A (z - T) / w, where z follows T with a play of half-width w


@effect
class ThermalHysteresis(Effect):
    """Difference between the offsets while warming and while cooling."""

    amplitude: Triple  # half the width of the loop, rad/s or m/s2
    play_k: Annotated[float, Least(1e-9)] = 2.0  # half-width of the play, K

    def apply(self, x: FloatArray, scene: Scene, past: Past) -> FloatArray:
        follower = play(scene.temp_c, self.play_k, past.state)
        past.state = float(follower[-1])
        return x + np.outer((follower - scene.temp_c) / self.play_k, self.amplitude)


def play(temp_c: FloatArray, half_width: float, start_c: float | None = None) -> FloatArray:
    """Return the output of a play operator that follows a temperature, degC."""
    if start_c is None and np.ptp(temp_c) == 0.0:
        return temp_c
    from undrift.sim.kernels import follow_with_play

    follower, start_c = np.empty(len(temp_c)), float(temp_c[0]) if start_c is None else start_c
    follow_with_play(np.ascontiguousarray(temp_c), half_width, start_c, follower)
    return follower


# ---- White noise and random walk: y_k = x_k + N sqrt(f) n_k + sum_j<=k K / sqrt(f) m_j


@effect
class WhiteNoise(Effect):
    """Angle or velocity random walk."""

    # N, rad/s/sqrt(Hz) or m/s2/sqrt(Hz). The standard deviation of a sample is N sqrt(sample rate). The one-sided density of a
    # data sheet is sqrt(2) N.
    random_walk: Annotated[FloatArray, Shape(3), Least(0.0)]

    def apply(self, x: FloatArray, scene: Scene, past: Past) -> FloatArray:
        return np.asarray(x + past.rng.standard_normal(x.shape) * (self.random_walk / np.sqrt(scene.step_s)))


@effect
class RandomWalk(Effect):
    """Random walk of the offset, starting at the first sample."""

    bias_walk: Annotated[FloatArray, Shape(3), Least(0.0)]  # K, rad/s/sqrt(s) or m/s2/sqrt(s)

    def apply(self, x: FloatArray, scene: Scene, past: Past) -> FloatArray:
        steps = past.rng.standard_normal(x.shape) * (self.bias_walk * np.sqrt(scene.step_s))
        if past.state is None:
            past.state, steps[0] = np.zeros(3), 0.0
        walk = past.state + np.cumsum(steps, axis=0)
        past.state = walk[-1]
        return np.asarray(x + walk)


# ---- Bias instability: density B^2 / (2 pi f) as Gauss-Markov processes a factor r apart [1]

RATIO = math.sqrt(10.0)


@effect
class BiasInstability(Effect):
    """Flicker noise of the offset."""

    instability: Annotated[FloatArray, Shape(3), Least(0.0)]  # B, rad/s or m/s2
    shortest_s: Annotated[float, Least(1e-9)] = 0.1  # time constant of the fastest process, s
    longest_s: Annotated[float, Least(1e-9)] = 1e4  # time constant of the slowest process, s

    @property
    def time_constants_s(self) -> FloatArray:
        """Time constants of the processes, s."""
        count = round(math.log(self.longest_s / self.shortest_s) / math.log(RATIO)) + 1
        return np.asarray(self.shortest_s * RATIO ** np.arange(count))

    def apply(self, x: FloatArray, scene: Scene, past: Past) -> FloatArray:
        from undrift.sim.kernels import add_process

        sd = self.instability * math.sqrt(math.log(RATIO) / math.pi)
        total, draws, states = np.array(x, order="C"), np.empty(x.shape), past.state
        for k, constant in enumerate(self.time_constants_s.tolist()):
            keep = math.exp(-scene.step_s / constant)
            past.rng.standard_normal(out=draws)
            fresh = math.sqrt(-math.expm1(-2.0 * scene.step_s / constant))
            last = np.zeros(3) if states is None else states[k]
            add_process(draws, keep, fresh, states is None, sd, last, total)
        return total


# ---- Amplifier: v = null + gain S x between its rails, with S the nominal sensitivity


@effect
class Amplifier(Effect):
    """Gain and rails."""

    gain: float = 1.0  # amplifier output per sensor output
    null: float = 0.0  # output at zero signal
    low: AnyNumber = -math.inf  # lower rail (infinite: no limit)
    high: AnyNumber = math.inf  # upper rail (infinite: no limit)

    def __post_init__(self) -> None:
        if not (self.gain > 0.0 and self.low < self.null < self.high):
            raise InputError(
                f"amplifier: gain must be positive and null between the rails, got gain {self.gain:g} and null {self.null:g} "
                f"between {self.low:g} and {self.high:g}. Correct the device."
            )


# ---- Low-pass: H(s) = w^2 / (s^2 + w s / Q + w^2), exact for a first-order hold [2]

BUTTERWORTH = 1.0 / math.sqrt(2.0)


@effect
class LowPass(Effect):
    """Second-order low-pass filter of each channel."""

    cutoff_hz: Annotated[FloatArray, Shape(3), Least(1e-9)]  # w / (2 pi), Hz
    quality: Annotated[FloatArray, Shape(3), Least(1e-9)] = field(default_factory=lambda: np.full(3, BUTTERWORTH))  # Q

    @property
    def group_delay_s(self) -> FloatArray:
        """Delay of slow signals, s, shape (3,)."""
        return np.asarray(1.0 / (self.quality * 2.0 * math.pi * self.cutoff_hz))

    def apply(self, x: FloatArray, scene: Scene, past: Past) -> FloatArray:
        check_even(scene, "low-pass")
        out, past.state = self.filtered(x, scene.step_s, past.state)
        return out

    def filtered(self, x: FloatArray, step_s: float, state: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
        """Return a filtered signal and the state (3, 2) after it. Without a state, the filter has settled at the first sample."""
        from undrift.sim.kernels import filter_columns

        pairs = zip(self.cutoff_hz.tolist(), self.quality.tolist(), strict=True)
        b, a = (np.array(rows) for rows in zip(*(difference_equation(*pair, step_s) for pair in pairs), strict=True))
        state = np.stack((1.0 - b[:, 0], b[:, 2] - a[:, 2]), axis=1) * x[0][:, None] if state is None else state.copy()
        out = np.array(x, order="C")
        filter_columns(b, a, state, out)
        return out, state


def sallen_key(cutoff_hz: float, parts: FloatArray) -> LowPass:
    """Return a Butterworth low-pass (equal resistors, C1 = 2 C2) with relative errors of its parts."""
    r1, r2, c1, c2 = np.moveaxis(1.0 + np.asarray(parts, dtype=float), -1, 0)
    root = np.sqrt(r1 * r2 * c1 * c2)
    return LowPass(cutoff_hz=cutoff_hz / root, quality=BUTTERWORTH * 2.0 * root / (c2 * (r1 + r2)))


@lru_cache(maxsize=64)
def difference_equation(cutoff_hz: float, quality: float, step_s: float) -> tuple[FloatArray, FloatArray]:
    """Return the coefficients of ``y_k = b0 u_k + b1 u_(k-1) + b2 u_(k-2) - a1 y_(k-1) - a2 y_(k-2)``."""
    from scipy.linalg import expm

    w, h = 2.0 * math.pi * cutoff_hz, step_s
    system = np.zeros((4, 4))
    system[:2, :2] = h * w * np.array([[0.0, 1.0], [-1.0, -1.0 / quality]])
    system[1, 2], system[2, 3] = h * w, 1.0
    grown = expm(system)
    e, now, rise = grown[:2, :2], grown[:2, 2], grown[:2, 3]
    first, last = now - rise, rise  # x_(k+1) = e x_k + first u_k + last u_(k+1)
    swap = np.array([[-e[1, 1], e[0, 1]], [e[1, 0], -e[0, 0]]])  # adj(z I - e) = z I + swap
    b = np.array([last[0], first[0] + (swap @ last)[0], (swap @ first)[0]])
    return b, np.array([1.0, -float(np.trace(e)), float(np.linalg.det(e))])


# ---- Sampling: channel i is sampled at t_0 + (j / f) / (1 + c) + d_i + jitter_j

Averaging = Literal["instant", "interval"]


@effect
class Sampling(Effect):
    """Clock of the device and timing of its converters."""

    # nominal sample rate, Hz, or None for the samples of the motion, shifted by jitter, clock error and delays
    sample_rate_hz: Annotated[float | None, Least(1e-9)] = None
    clock_error: Annotated[float, Least(-0.5)] = 0.0  # c, relative (positive if the clock runs fast)
    jitter_s: Annotated[float, Least(0.0)] = 0.0  # standard deviation of the time of a sample, s
    gyro_delay_s: Triple = ZERO  # d, s
    accel_delay_s: Triple = ZERO  # d, s
    gyro_averaging: Averaging = "interval"
    accel_averaging: Averaging = "instant"

    @property
    def on_grid(self) -> bool:
        """True if every reading is taken exactly at a sample of the motion."""
        moved = self.clock_error or self.jitter_s or self.gyro_delay_s.any() or self.accel_delay_s.any()
        return self.sample_rate_hz is None and not moved

    def ticks(self, time: FloatArray, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
        """Return recorded and true times (M,) of the samples within a motion, s, without the delays of the channels."""
        if self.on_grid:
            return time, time
        stamped, rate = time, self.sample_rate_hz
        if rate is not None:
            stamped = time[0] + np.arange(int((time[-1] - time[0]) * rate * 1.5) + 2) / rate
        true = time[0] + (stamped - time[0]) / (1.0 + self.clock_error)
        true = true + self.jitter_s * rng.standard_normal(len(true))
        delays = np.concatenate((self.gyro_delay_s, self.accel_delay_s, [0.0]))
        margin = 1e-9 * (time[-1] - time[0])  # margin for rounding
        inside = (true + delays.min() >= time[0] - margin) & (true + delays.max() <= time[-1] + margin)
        if inside.sum() < 2 or (np.diff(true[inside]) <= 0.0).any():
            raise InputError(
                f"sampling: at least two samples in order of time are required, got {int(inside.sum())} within the motion. "
                "Use a longer motion, or a jitter well below the sample period."
            )
        return stamped[inside], true[inside]


def sampled(
    x: FloatArray, time: FloatArray, taken_s: FloatArray, delay_s: FloatArray, averaging: Averaging
) -> FloatArray:
    """Return a signal at other times, with a cubic spline.

    If the device averages over the interval since the previous sample, x contains the means over the steps of the motion.
    """
    from scipy.interpolate import CubicSpline

    if averaging == "instant":
        return np.stack([CubicSpline(time, x[:, k])(taken_s + delay_s[k]) for k in range(3)], axis=1)
    integral = np.cumsum(x * np.diff(time, prepend=time[0])[:, None], axis=0)
    out = np.empty((len(taken_s), 3))
    for k in range(3):
        end = taken_s + delay_s[k]
        start = np.concatenate(([end[0] - (end[1] - end[0])], end[:-1]))
        spline = CubicSpline(time, integral[:, k])
        before_motion = np.minimum(start - time[0], 0.0) * x[0, k]
        out[:, k] = (spline(end) - spline(np.maximum(start, time[0])) - before_motion) / (end - start)
    return out


def step_means(x: FloatArray, time: FloatArray) -> FloatArray:
    """Return the mean of a smooth signal over each step of its grid, from the integral of its cubic spline."""
    from scipy.interpolate import CubicSpline

    integral = np.asarray(CubicSpline(time, x).antiderivative()(time))
    return np.vstack((x[:1], np.diff(integral, axis=0) / np.diff(time)[:, None]))


# ---- ADC: code = round(v / step + inl(v)), step = span / 2^bits. The inl is a bow of 4 p (1 - p) over the span.

Rounding = Literal["nearest", "floor", "toward_zero"]


@effect
class Adc(Effect):
    """Converter of a triad."""

    bits: Annotated[int, Least(1)]  # width of a code
    reference: Annotated[float, Least(1e-300)]  # reference value, in the unit of the preceding stage
    signed: bool = True  # codes from -2^(bits - 1) to 2^(bits - 1) - 1, or from 0 to 2^bits - 1 if not signed
    rounding: Rounding = "nearest"
    inl_lsb: Triple = ZERO  # height of the bow of the integral non-linearity, steps
    # True if the reading is the code (count), False if it is the code times the step, in the unit of the preceding stage
    codes: bool = True

    @property
    def step(self) -> float:
        """Code step, in the unit of the preceding stage."""
        return (2.0 if self.signed else 1.0) * self.reference / 2.0**self.bits

    @property
    def code_limits(self) -> tuple[float, float]:
        """Smallest and largest code."""
        half = 2.0 ** (self.bits - 1)
        return (-half, half - 1.0) if self.signed else (0.0, 2.0 * half - 1.0)

    def converted(self, v: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Return the readings, and True for each clipped reading."""
        steps = v / self.step
        low, high = self.code_limits
        if self.inl_lsb.any():
            share = (steps - low) / (high + 1.0 - low)
            steps = steps + self.inl_lsb * 4.0 * share * (1.0 - share)
        code = rounded(steps, self.rounding)
        is_clipped: BoolArray = (code < low) | (code > high)
        code = np.clip(code, low, high)
        return (code if self.codes else code * self.step), is_clipped


def rounded(steps: FloatArray, rounding: Rounding) -> FloatArray:
    """Return values in steps, rounded to whole steps."""
    return {"nearest": np.rint, "floor": np.floor, "toward_zero": np.trunc}[rounding](steps)


# ---- Thermometer: felt' = (T + s (1 - exp(-t / lag)) - felt) / lag, exact for a linear T


@effect
class Thermometer(Effect):
    """A board thermometer."""

    trim_error_c: float = 0.0  # reading minus truth, K
    lag_s: Annotated[float, Least(0.0)] = 0.0  # time constant, s (0: no lag)
    self_heating_c: float = 0.0  # settled self-heating, K
    noise_c: Annotated[float, Least(0.0)] = 0.0  # standard deviation of a sample, K
    step_c: Annotated[float, Least(0.0)] = 0.0  # step size of the reading, K (0: no steps)
    zero_c: float = 0.0  # temperature of code 0, degC

    def shown(self, temp_c: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Return the readings of a thermometer at a temperature, degC, with trim error, noise and steps."""
        reading: FloatArray = temp_c + self.trim_error_c
        if self.noise_c > 0.0:
            reading = reading + rng.normal(0.0, self.noise_c, len(reading))
        return np.rint((reading - self.zero_c) / self.step_c) * self.step_c + self.zero_c if self.step_c else reading

    def felt(self, scene: Scene, past: Past) -> FloatArray:
        """Return the temperature of the thermometer, degC, with lag and self-heating."""
        temp = scene.temp_c
        if self.lag_s == 0.0:
            return temp + self.self_heating_c
        heating: FloatArray = self.self_heating_c * -np.expm1(-scene.age_s / self.lag_s)
        state_c, before = past.state or (float(temp[0]), float(temp[0]))
        if past.state is None and np.ptp(temp) == 0.0:
            past.state = state_c, before
            return temp + heating
        from undrift.sim.kernels import filter_columns

        check_even(scene, "thermometer")
        ratio = scene.step_s / self.lag_s
        keep = math.exp(-ratio)
        mean = -math.expm1(-ratio) / ratio  # mean of the weight over a step
        b, a = np.array([[1.0 - mean, mean - keep, 0.0]]), np.array([[1.0, -keep, 0.0]])
        column = np.array(temp)[:, None]
        filter_columns(b, a, np.array([[keep * state_c + b[0, 1] * before, 0.0]]), column)
        lagging = column[:, 0]
        past.state = float(lagging[-1]), float(temp[-1])
        return lagging + heating


# ---- The chain


@effect
class SensorChain(Effect):
    """Triad of sensors of the same kind. Its fields are the effects in the order in which they apply, or None if switched off."""

    unit: str  # unit of the reading: count, v, dps, rad/s, g, m/s2
    lever_arm: LeverArm | None = None
    scale: Scale
    nonlinearity: Nonlinearity | None = None
    g_sensitivity: GSensitivity | None = None
    offset: Offset | None = None
    thermal_scale: ThermalScale | None = None
    rate_drift: RateDrift | None = None
    warm_up: PowerOnTransient | None = None
    hysteresis: ThermalHysteresis | None = None
    white_noise: WhiteNoise | None = None
    instability: BiasInstability | None = None
    random_walk: RandomWalk | None = None
    amplifier: Amplifier | None = None
    low_pass: LowPass | None = None
    adc: Adc | None = None

    @property
    def _amplified(self) -> Amplifier:
        return self.amplifier or Amplifier()

    @property
    def _per_code(self) -> float:
        return self.adc.step if self.adc and self.adc.codes else 1.0

    @property
    def _amplified_sensitivity(self) -> float:
        return self.scale.nominal_sensitivity * self._amplified.gain

    @property
    def gain(self) -> float:
        """Nominal gain of the whole chain, unit of the reading per rad/s or m/s2."""
        return self._amplified_sensitivity / self._per_code

    @property
    def null(self) -> float:
        """Reading at zero signal, unit of the reading."""
        return self._amplified.null / self._per_code

    @property
    def forward_matrix(self) -> FloatArray:
        """Forward matrix at the reference temperature, unit of the reading per rad/s or m/s2 along each case axis, shape (3, 3)."""
        return np.asarray(self.gain * self.scale.matrix)

    @property
    def raw_offset(self) -> FloatArray:
        """Reading at zero input and reference temperature, unit of the reading, shape (3,)."""
        return np.asarray(self.null + self.gain * (self.offset.constant if self.offset else np.zeros(3)))

    @property
    def rails(self) -> FloatArray:
        """Signal at the rails of the amplifier, nominal input units, (2,)."""
        amplifier = self._amplified
        return (np.array([amplifier.low, amplifier.high]) - amplifier.null) / self._amplified_sensitivity

    @property
    def full_scale(self) -> float:
        """Largest rate or force in the range of amplifier and converter, rad/s or m/s2."""
        limits = self.rails
        if self.adc:
            codes = np.array(self.adc.code_limits) * self.adc.step - self._amplified.null
            limits = np.vstack((limits, codes / self._amplified_sensitivity))
        return float((limits * [-1.0, 1.0]).min())

    def stages(self, x: FloatArray, scene: Scene, pasts: Mapping[str, Past]) -> Iterator[tuple[str, FloatArray]]:
        """Yield each active effect before the converter, in order, with the signal after it."""
        arm = self.lever_arm.force(scene) if self.lever_arm else np.zeros((1, 3, 3))
        own_force = np.einsum("nii->ni", arm)
        for name in effects_of(self):
            if name == "adc":
                return
            if name == "lever_arm":
                x = x + own_force
            elif name == "scale":  # x already includes the force of each sensor along its axis
                x = self.scale.scaled(x - own_force, arm) if self.lever_arm else self.scale.scaled(x, None)
            elif name == "amplifier":
                x = np.clip(x, *self.rails)
            else:
                x = getattr(self, name).apply(x, scene, pasts[name])
            yield name, x

    def converted(self, x: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Return the readings of a signal after the low-pass, and True for each reading that the converter clips."""
        output = self._amplified.null + self._amplified_sensitivity * x
        return self.adc.converted(output) if self.adc else (output, np.zeros(x.shape, dtype=bool))

    def shifted(self, by: FloatArray) -> "SensorChain":
        """Return the same sensors with an additional offset (3,), rad/s or m/s2."""
        offset = self.offset or Offset()
        return replace(self, offset=replace(offset, constant=offset.constant + by))


def effects_of(chain: SensorChain) -> tuple[str, ...]:
    """Return the names of the active effects, in order."""
    return tuple(f.name for f in fields(chain) if f.name != "unit" and getattr(chain, f.name) is not None)
