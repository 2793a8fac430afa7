"""Effects between motion and reading, in order, each with its parameters and the function that applies it.

::

    lever arm -> scale -> non-linearity -> g-sensitivity -> offset -> thermal scale -> rate drift -> warm-up -> hysteresis
    -> white noise -> bias instability -> random walk -> amplifier -> low-pass -> sampling -> ADC

An effect that is None is switched off. Up to the low-pass, signals are in nominal input units (rad/s, m/s2), which is the output
divided by the nominal sensitivity. Without noise and non-linearity, at the reference temperature, the reading is
``u = S (C x + o) + null`` with S the gain of the whole chain and C the scale's matrix. D is the temperature above reference. Every
field has a unit, which is part of its key in files: ``{x}`` is the unit of the measured quantity (rad_s or m_s2), ``{out}`` the
unit of the output (v, count, dps, g ...). Signals are arrays of shape (N, 3), with a column per channel.

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
from dataclasses import MISSING, dataclass, field, fields, replace
from functools import lru_cache
from typing import Any, Literal, get_args

import numpy as np

from undrift.arrays import BoolArray, FloatArray, frozen
from undrift.errors import InputError
from undrift.frames import cross
from undrift.sim.motion.motion import Motion

# ---- Fields with a unit.

Shape = tuple[int | None, ...]


def quantity(
    unit: str = "", shape: Shape | None = None, default: Any = MISSING, *, least: float | None = None, of: Any = None
) -> Any:
    """Return a dataclass field with unit, shape, smallest value and, for a Literal, its choices."""
    return field(default=default, metadata={"unit": unit, "shape": shape, "least": least, "of": get_args(of)})


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Effect:
    """Base class of effects, which checks its fields, makes arrays read-only and repeats scalars for the three axes."""

    def __post_init__(self) -> None:
        for f in fields(self):
            shape, least, value = f.metadata.get("shape"), f.metadata.get("least"), getattr(self, f.name)
            name = f"{type(self).__name__}.{f.name}"
            if shape is not None:
                if not (isinstance(value, list) and value):  # lists from a file are checked below
                    value = value if None in shape or np.ndim(value) else np.full(shape, value)
                    value = value if np.size(value) else np.zeros([n or 0 for n in shape])
                value = frozen(value, shape, name)
                object.__setattr__(self, f.name, value)
            if least is not None and value is not None and not np.all(np.asarray(value) >= least):
                raise InputError(f"{name}: must be {least:g} or more, got {np.min(value):g}. Correct the device.")
            if (choices := f.metadata.get("of")) and value not in choices:
                raise InputError(f"{name}: must be one of {', '.join(choices)}, got '{value}'. Correct the device.")


# ---- ADC: code = round(v / step + inl(v)), step = span / 2^bits. The inl is a bow of 4 p (1 - p) over the span.

Rounding = Literal["nearest", "floor", "toward_zero"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Adc(Effect):
    """Converter of a triad."""

    bits: int = quantity("", least=1)  # width of a code
    reference: float = quantity("{out}", least=1e-300)  # reference, in the unit of the preceding stage
    # codes from -2^(bits - 1) to 2^(bits - 1) - 1, or from 0 to 2^bits - 1 if not signed
    signed: bool = quantity("", None, True)
    rounding: Rounding = quantity("", None, "nearest", of=Rounding)  # nearest, floor or toward_zero
    inl_lsb: FloatArray = quantity("", (3,), 0.0)  # (3,), height of the bow of the integral non-linearity, steps
    # True if the reading is the code (count), False if it is the code times the step, in the unit of the preceding stage
    codes: bool = quantity("", None, True)

    @property
    def step(self) -> float:
        """Code step, in the unit of the preceding stage."""
        return (2.0 if self.signed else 1.0) * self.reference / 2.0**self.bits

    @property
    def code_limits(self) -> tuple[float, float]:
        """Smallest and largest code."""
        half = 2.0 ** (self.bits - 1)
        return (-half, half - 1.0) if self.signed else (0.0, 2.0 * half - 1.0)


def converted(v: FloatArray, effect: Adc) -> tuple[FloatArray, BoolArray]:
    """Return the readings of a converter, and True for each clipped reading."""
    steps = v / effect.step
    low, high = effect.code_limits
    if effect.inl_lsb.any():
        place = (steps - low) / (high + 1.0 - low)
        steps = steps + effect.inl_lsb * 4.0 * place * (1.0 - place)
    code = rounded(steps, effect.rounding)
    is_clipped: BoolArray = (code < low) | (code > high)
    code = np.clip(code, low, high)
    return (code if effect.codes else code * effect.step), is_clipped


def rounded(steps: FloatArray, rounding: Rounding) -> FloatArray:
    """Return steps rounded to whole steps."""
    if rounding == "nearest":
        return np.rint(steps)
    return np.asarray(np.floor(steps) if rounding == "floor" else np.trunc(steps))


# ---- Amplifier: v = null + gain S x between its rails, with S the nominal sensitivity.


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Amplifier(Effect):
    """Gain and rails."""

    gain: float = quantity("", None, 1.0)  # output per output of the sensor
    null: float = quantity("{out}", None, 0.0)  # output at zero signal
    low: float = quantity("{out}", None, -math.inf)  # lower rail (infinite: no limit)
    high: float = quantity("{out}", None, math.inf)  # upper rail

    def __post_init__(self) -> None:
        Effect.__post_init__(self)
        if not (self.gain > 0.0 and self.low < self.null < self.high):
            raise InputError(
                f"amplifier: gain must be positive and null between the rails, got gain {self.gain:g} and null {self.null:g} "
                f"between {self.low:g} and {self.high:g}. Correct the device."
            )


WIRE = Amplifier()

# ---- Scene: input of all effects.


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scene:
    """Input of all effects, N samples."""

    time: FloatArray  # (N,), s
    step_s: float  # mean step of time, s
    temp_c: FloatArray  # (N,), temperature of the board, degC
    warmth: FloatArray  # (N,), temperature above the device's reference temperature, K
    age_s: FloatArray  # (N,), time since power-on, s
    rate_b: FloatArray = field(default_factory=lambda: np.empty((0, 3)))  # (N, 3), angular rate at the sample, rad/s
    angular_acceleration_b: FloatArray | None = None  # (N, 3), rad/s2
    force_b: FloatArray = field(default_factory=lambda: np.empty((0, 3)))  # (N, 3), at the body's origin, m/s2


@dataclass(slots=True, eq=False)
class Past:
    """Random generator and state of an effect, kept from one chunk of a signal to the next."""

    rng: np.random.Generator
    state: Any = None


def scene_of(motion: Motion, temp_c: FloatArray, reference_temp_c: float, power_on_s: float) -> Scene:
    """Return the scene of a motion."""
    time = motion.time
    step_s, age_s = float((time[-1] - time[0]) / (len(time) - 1)), time - time[0] + power_on_s
    vectors = {name: getattr(motion, name) for name in ("rate_b", "angular_acceleration_b", "force_b")}
    return Scene(time=time, step_s=step_s, temp_c=temp_c, warmth=temp_c - reference_temp_c, age_s=age_s, **vectors)


def check_even(scene: Scene, what: str) -> None:
    """Raise InputError if the samples are not evenly spaced."""
    steps = np.diff(scene.time)
    if np.abs(steps - scene.step_s).max(initial=0.0) > 1e-3 * scene.step_s:
        raise InputError(
            f"{what}: samples of the motion must be evenly spaced, got steps from {steps.min():.6g} to {steps.max():.6g} s. "
            "Sample the motion on an even grid."
        )


# ---- g-sensitivity: y = x + G f


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GSensitivity(Effect):
    """Apparent rate of a gyroscope due to specific force."""

    # (3, 3), apparent rate, rad/s per m/s2: row i for sensor i, columns x, y, z of b
    matrix: FloatArray = quantity("{x}_per_m_s2", (3, 3))

    def apply(self, x: FloatArray, scene: Scene, past: Past) -> FloatArray:
        """Return a signal plus the effect of specific force."""
        return np.asarray(x + scene.force_b @ self.matrix.T)


# ---- Thermal hysteresis: y = x + A (z - T) / w, where z follows T with a play of half-width w.


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ThermalHysteresis(Effect):
    """Difference of the offset between warming and cooling."""

    amplitude: FloatArray = quantity("{x}", (3,))  # (3,), half the width of the loop, rad/s or m/s2
    play_k: float = quantity("", None, 2.0, least=1e-9)  # Half-width of the play, K

    def apply(self, x: FloatArray, scene: Scene, past: Past) -> FloatArray:
        """Return a signal with thermal hysteresis."""
        follower = play(scene.temp_c, self.play_k, past.state)
        past.state = float(follower[-1])
        return x + np.outer((follower - scene.temp_c) / self.play_k, self.amplitude)


def play(temp_c: FloatArray, half_width: float, at: float | None = None) -> FloatArray:
    """Return the output of a play operator that follows a temperature, degC, starting from `at`."""
    if at is None and np.ptp(temp_c) == 0.0:
        return temp_c
    from undrift.kernels.device import follow_with_play

    follower = np.empty(len(temp_c))
    follow_with_play(np.ascontiguousarray(temp_c), half_width, float(temp_c[0]) if at is None else at, follower)
    return follower


# ---- Bias instability: density B^2 / (2 pi f) as Gauss-Markov processes a factor r apart [1]

RATIO = math.sqrt(10.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BiasInstability(Effect):
    """Flicker noise of the offset."""

    instability: FloatArray = quantity("{x}", (3,), least=0.0)  # (3,), B, rad/s or m/s2
    shortest_s: float = quantity("", None, 0.1, least=1e-9)  # time constant of the fastest process, s
    longest_s: float = quantity("", None, 1e4, least=1e-9)  # time constant of the slowest process, s

    @property
    def time_constants_s(self) -> FloatArray:
        """Time constants of the processes, s."""
        count = round(math.log(self.longest_s / self.shortest_s) / math.log(RATIO)) + 1
        return np.asarray(self.shortest_s * RATIO ** np.arange(count))

    def apply(self, x: FloatArray, scene: Scene, past: Past) -> FloatArray:
        """Return a signal plus flicker noise, from a stationary start or from the stored state (processes, 3)."""
        from undrift.kernels.device import add_process

        sd = self.instability * math.sqrt(math.log(RATIO) / math.pi)
        total, draws, states = np.array(x, order="C"), np.empty(x.shape), past.state
        for k, constant in enumerate(self.time_constants_s.tolist()):
            keep = math.exp(-scene.step_s / constant)
            past.rng.standard_normal(out=draws)
            fresh = math.sqrt(-math.expm1(-2.0 * scene.step_s / constant))
            last = np.zeros(3) if states is None else states[k]
            add_process(draws, keep, fresh, states is None, sd, last, total)
        return total


# ---- Lever arm: d_i = alpha x r_i + omega x (omega x r_i), added to the specific force at sensor i


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LeverArm(Effect):
    """Positions of the sensors."""

    # (3, 3), position of each sensor from the body's origin, with a row per sensor, m, frame b
    arms: FloatArray = quantity("m", (3, 3))

    def force(self, scene: Scene) -> FloatArray:
        """Return the force of each sensor in addition to the force at the origin, (N, 3 sensors, 3)."""
        if scene.angular_acceleration_b is None:
            raise InputError(
                "lever arm: the motion has no angular acceleration. Use a motion from poses or a task, or switch the lever arm off."
            )
        rate, arm = scene.rate_b[:, None, :], self.arms[None, :, :]
        return np.asarray(cross(scene.angular_acceleration_b[:, None, :], arm) + cross(rate, cross(rate, arm)))


# ---- Low-pass: H(s) = w^2 / (s^2 + w s / Q + w^2), exact for a first-order hold [2]

BUTTERWORTH = 1.0 / math.sqrt(2.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LowPass(Effect):
    """Second-order low-pass filter of each channel."""

    cutoff_hz: FloatArray = quantity("", (3,), least=1e-9)  # (3,), w / (2 pi), Hz
    quality: FloatArray = quantity("", (3,), BUTTERWORTH, least=1e-9)  # (3,), Q

    @property
    def group_delay_s(self) -> FloatArray:
        """Delay of slow signals, s, shape (3,)."""
        return np.asarray(1.0 / (self.quality * 2.0 * math.pi * self.cutoff_hz))

    def equations(self, step_s: float) -> list[tuple[FloatArray, FloatArray]]:
        """Return the coefficients b and a of each channel."""
        pairs = zip(self.cutoff_hz.tolist(), self.quality.tolist(), strict=True)
        return [difference_equation(cutoff, quality, step_s) for cutoff, quality in pairs]

    def apply(self, x: FloatArray, scene: Scene, past: Past) -> FloatArray:
        """Return a signal after the low-pass filter, which starts settled at the first sample."""
        from scipy.signal import lfilter

        check_even(scene, "low-pass")
        out, equations = np.empty_like(x), self.equations(scene.step_s)
        past.state = past.state or [
            np.array([1.0 - b[0], b[2] - a[2]]) * x[0, axis] for axis, (b, a) in enumerate(equations)
        ]
        for axis, (b, a) in enumerate(equations):
            out[:, axis], past.state[axis] = lfilter(b, a, x[:, axis], zi=past.state[axis])
        return out


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


# ---- White noise and random walk: y_k = x_k + N sqrt(f) n_k + sum_j<=k K / sqrt(f) m_j


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WhiteNoise(Effect):
    """Angle or velocity random walk."""

    # (3,), N, rad/s/sqrt(Hz) or m/s2/sqrt(Hz). The standard deviation of a sample is N sqrt(sample rate). The one-sided
    # density of a data sheet is sqrt(2) N.
    random_walk: FloatArray = quantity("{x}_per_sqrt_hz", (3,), least=0.0)

    def apply(self, x: FloatArray, scene: Scene, past: Past) -> FloatArray:
        """Return a signal plus white noise."""
        return np.asarray(x + past.rng.standard_normal(x.shape) * (self.random_walk / np.sqrt(scene.step_s)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RandomWalk(Effect):
    """Random walk of the offset, starting at the first sample."""

    bias_walk: FloatArray = quantity("{x}_per_sqrt_s", (3,), least=0.0)  # (3,), K, rad/s/sqrt(s) or m/s2/sqrt(s)

    def apply(self, x: FloatArray, scene: Scene, past: Past) -> FloatArray:
        """Return a signal plus a random walk."""
        steps = past.rng.standard_normal(x.shape) * (self.bias_walk * np.sqrt(scene.step_s))
        if past.state is None:
            past.state, steps[0] = np.zeros(3), 0.0
        walk = past.state + np.cumsum(steps, axis=0)
        past.state = walk[-1]
        return np.asarray(x + walk)


# ---- Non-linearity and asymmetry: y = x + q x^2 + c x^3 + (a / 2) |x|


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Nonlinearity(Effect):
    """Deviation of the output from a straight line."""

    quadratic: FloatArray = quantity("per_{x}", (3,), 0.0)  # (3,), q, per rad/s or per m/s2
    cubic: FloatArray = quantity("per_{x}_squared", (3,), 0.0)  # (3,), c, per (rad/s)^2 or per (m/s2)^2
    asymmetry: FloatArray = quantity("", (3,), 0.0)  # (3,), a, relative

    def bent(self, x: FloatArray) -> FloatArray:
        """Return a signal after non-linearity and asymmetry."""
        return np.asarray(x + x * x * (self.quadratic + self.cubic * x) + 0.5 * self.asymmetry * np.abs(x))

    def apply(self, x: FloatArray, scene: Scene, past: Past) -> FloatArray:
        """Return a signal after non-linearity and asymmetry."""
        return self.bent(x)


# ---- Offset and its thermal drift: y = x + o + c_1 D + c_2 D^2 + ...


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Offset(Effect):
    """Output at zero input."""

    constant: FloatArray = quantity("{x}", (3,), 0.0)  # (3,), at the reference temperature, rad/s or m/s2
    # (K, 3), coefficients of D, D^2, ... D^K, with a row per power, rad/s or m/s2 per K to that power
    per_k: FloatArray = quantity("{x}_by_power_of_k", (None, 3), ())

    def at(self, warmth: FloatArray | float) -> FloatArray:
        """Return the offset at a temperature above reference, K."""
        return self.constant + polynomial(self.per_k, np.asarray(warmth, dtype=float))

    def apply(self, x: FloatArray, scene: Scene, past: Past) -> FloatArray:
        """Return a signal plus the offset."""
        return x + (self.at(scene.warmth) if len(self.per_k) else self.constant)


def polynomial(coefficients: FloatArray, warmth: FloatArray) -> FloatArray:
    """Return ``sum_k c_k D^k`` for k = 1, 2, ... per axis."""
    total = np.zeros((*warmth.shape, 3))
    for row in coefficients[::-1]:
        total = (total + row) * warmth[..., None]
    return total


# ---- Rate-dependent drift, the note's dynamic drift: y = x + sum_pq c_pq x^p D^q, p = 1, 2, ...


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RateDrift(Effect):
    """Error that depends on rate and temperature."""

    # (P, Q, 3), c_pq with power p = 1..P of the rate and q = 0..Q-1 of the warmth, rad/s over (rad/s)^p K^q
    coefficients: FloatArray = quantity("{x}_by_powers_of_{x}_and_k", (None, None, 3))

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
        """Return a signal plus the drift."""
        return x + self.error(x, scene.warmth)


# ---- Sampling: channel i is taken at t_0 + (j / f) / (1 + c) + d_i + jitter_j

Averaging = Literal["instant", "interval"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sampling(Effect):
    """Clock of the device and timing of its converters."""

    # nominal sample rate, Hz, or None for the samples of the motion, moved by jitter, clock error and delays
    sample_rate_hz: float | None = quantity("", None, None, least=1e-9)
    clock_error: float = quantity("", None, 0.0, least=-0.5)  # c, relative (positive if the clock runs fast)
    jitter_s: float = quantity("", None, 0.0, least=0.0)  # standard deviation of the time of a sample, s
    gyro_delay_s: FloatArray = quantity("", (3,), 0.0)  # (3,), d, s
    accel_delay_s: FloatArray = quantity("", (3,), 0.0)  # (3,), d, s
    gyro_averaging: Averaging = quantity("", None, "interval", of=Averaging)  # instant or interval
    accel_averaging: Averaging = quantity("", None, "instant", of=Averaging)

    @property
    def on_grid(self) -> bool:
        """True if every reading is taken exactly at a sample of the motion."""
        moved = self.clock_error or self.jitter_s or self.gyro_delay_s.any() or self.accel_delay_s.any()
        return self.sample_rate_hz is None and not moved


def ticks_of(effect: Sampling, time: FloatArray, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Return recorded and true times (M,) of the samples within a motion, s, without the delays of the channels."""
    if effect.on_grid:
        return time, time
    stamped, rate = time, effect.sample_rate_hz
    if rate is not None:
        stamped = time[0] + np.arange(int((time[-1] - time[0]) * rate * 1.5) + 2) / rate
    true = time[0] + (stamped - time[0]) / (1.0 + effect.clock_error)
    true = true + effect.jitter_s * rng.standard_normal(len(true))
    delays = np.concatenate((effect.gyro_delay_s, effect.accel_delay_s, [0.0]))
    margin = 1e-9 * (time[-1] - time[0])  # of rounding
    inside = (true + delays.min() >= time[0] - margin) & (true + delays.max() <= time[-1] + margin)
    if inside.sum() < 2 or (np.diff(true[inside]) <= 0.0).any():
        raise InputError(
            f"sampling: at least two samples in order of time are required, got {int(inside.sum())} within the motion. "
            "Use a longer motion, or a jitter well below the sample period."
        )
    return stamped[inside], true[inside]


def instant(x: FloatArray, time: FloatArray, at: FloatArray, delay_s: FloatArray) -> FloatArray:
    """Return a signal at other times, with a cubic spline."""
    from scipy.interpolate import CubicSpline

    return np.stack([CubicSpline(time, x[:, k])(at + delay_s[k]) for k in range(3)], axis=1)


def interval(means: FloatArray, time: FloatArray, at: FloatArray, delay_s: FloatArray) -> FloatArray:
    """Return the mean of a signal since the previous sample, from its means over the steps of the motion."""
    from scipy.interpolate import CubicSpline

    integral = np.cumsum(means * np.diff(time, prepend=time[0])[:, None], axis=0)
    out = np.empty((len(at), 3))
    for k in range(3):
        taken = at + delay_s[k]
        before = np.concatenate(([taken[0] - (taken[1] - taken[0])], taken[:-1]))
        spline = CubicSpline(time, integral[:, k])
        early = np.minimum(before - time[0], 0.0) * means[0, k]
        out[:, k] = (spline(taken) - spline(np.maximum(before, time[0])) - early) / (taken - before)
    return out


def step_means(x: FloatArray, time: FloatArray) -> FloatArray:
    """Return the mean of a smooth signal over each step of its grid, from the integral of its cubic spline."""
    from scipy.interpolate import CubicSpline

    integral = np.asarray(CubicSpline(time, x).antiderivative()(time))
    return np.vstack((x[:1], np.diff(integral, axis=0) / np.diff(time)[:, None]))


# ---- Scale, cross-axis, misalignment: y = (I + X) diag(1 + s) E x, where the rows of E are the sensor axes in b.


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scale(Effect):
    """Sensitivities, axes and crosstalk of a triad."""

    nominal_sensitivity: float = quantity("{out}_per_{x}")  # value in the data sheet, output unit per rad/s or m/s2
    error: FloatArray = quantity("", (3,), 0.0)  # (3,), relative error of each sensor's sensitivity
    # (3, 3), unit vector of each sensor in b, with a row per sensor
    axes: FloatArray = quantity("", (3, 3), ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)))
    # (3, 3), relative crosstalk from channel j (column) to channel i (row)
    cross_axis: FloatArray = quantity("", (3, 3), 0.0)

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
        """(I + X) diag(1 + s) E, shape (3, 3)."""
        return np.asarray((np.eye(3) + self.cross_axis) @ ((1.0 + self.error)[:, None] * self.axes))


def scaled(x: FloatArray, effect: Scale, extra: FloatArray | None = None) -> FloatArray:
    """Return the output of the channels for a motion."""
    if extra is None:
        return np.asarray(x @ effect.matrix.T)
    along = x @ effect.axes.T + np.einsum("ij,nij->ni", effect.axes, extra)
    return np.asarray((along * (1.0 + effect.error)) @ (np.eye(3) + effect.cross_axis).T)


# ---- Thermal scale: y = x (1 + k_1 D + k_2 D^2 + ...), which also applies to the offset.


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ThermalScale(Effect):
    """Change of the sensitivity with temperature."""

    # (K, 3), relative change with D, D^2, ... D^K, with a row per power, per K to that power
    per_k: FloatArray = quantity("by_power_of_k", (None, 3))

    def factor(self, warmth: FloatArray | float) -> FloatArray:
        """Return the factor at a temperature above reference, K."""
        return 1.0 + polynomial(self.per_k, np.asarray(warmth, dtype=float))

    def apply(self, x: FloatArray, scene: Scene, past: Past) -> FloatArray:
        """Return a signal times the factor at its temperature."""
        return x * self.factor(scene.warmth)


# ---- Thermometer: felt' = (T + s (1 - exp(-t / lag)) - felt) / lag, exact for a straight T

TRIM_TEMP_C = 25.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Thermometer(Effect):
    """A board thermometer."""

    trim_error_c: float = quantity("", None, 0.0)  # reading minus truth at 25 degC, K
    slope_error: float = quantity("", None, 0.0)  # relative error of the slope
    lag_s: float = quantity("", None, 0.0, least=0.0)  # time constant, s (0: no lag)
    self_heating_c: float = quantity("", None, 0.0)  # settled self-heating, K
    noise_c: float = quantity("", None, 0.0, least=0.0)  # standard deviation of a sample, K
    step_c: float = quantity("", None, 0.0, least=0.0)  # step of the reading, K (0: no steps)
    zero_c: float = quantity("", None, 0.0)  # temperature of code 0, degC
    rounding: Rounding = quantity("", None, "nearest", of=Rounding)  # nearest, floor or toward_zero

    def shown(self, temp_c: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Return the readings of a thermometer at a temperature, degC, with trim and slope errors, noise and steps."""
        reading: FloatArray = temp_c + self.trim_error_c + self.slope_error * (temp_c - TRIM_TEMP_C)
        if self.noise_c > 0.0:
            reading = reading + rng.normal(0.0, self.noise_c, len(reading))
        if self.step_c == 0.0:
            return reading
        return rounded((reading - self.zero_c) / self.step_c, self.rounding) * self.step_c + self.zero_c

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
        from scipy.signal import lfilter

        check_even(scene, "thermometer")
        ratio = scene.step_s / self.lag_s
        keep = math.exp(-ratio)
        mean = -math.expm1(-ratio) / ratio  # of the weight over a step
        b = [1.0 - mean, mean - keep]
        lagging = np.asarray(lfilter(b, [1.0, -keep], temp, zi=[keep * state_c + b[1] * before])[0])
        past.state = float(lagging[-1]), float(temp[-1])
        return lagging + heating


# ---- Warm-up: y = x - A (1 + k D) exp(-t / tau), the difference from the settled offset [4]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PowerOnTransient(Effect):
    """Offset over time since power-on."""

    amplitude: FloatArray = quantity("{x}", (3,))  # (3,), change from power-on to the settled value, rad/s or m/s2
    time_constant_s: float = quantity("", least=1e-9)  # s
    per_k: FloatArray = quantity("", (3,), 0.0)  # (3,), relative change of the amplitude with temperature, per K

    def apply(self, x: FloatArray, scene: Scene, past: Past) -> FloatArray:
        """Return a signal plus the warm-up transient."""
        fading = np.exp(-scene.age_s / self.time_constant_s)[:, None]
        return np.asarray(x - self.amplitude * (1.0 + np.outer(scene.warmth, self.per_k)) * fading)


# ---- The chain


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SensorChain(Effect):
    """Triad of sensors of the same kind."""

    unit: str = quantity("")  # unit of the reading: count, v, dps, rad/s, g, m/s2
    scale: Scale = quantity("")  # sensitivity, axes, crosstalk
    lever_arm: LeverArm | None = quantity("", None, None)  # Accelerometers
    nonlinearity: Nonlinearity | None = quantity("", None, None)  # With asymmetry
    g_sensitivity: GSensitivity | None = quantity("", None, None)  # Gyroscopes
    offset: Offset | None = quantity("", None, None)  # With its thermal drift
    thermal_scale: ThermalScale | None = quantity("", None, None)  # Sensitivity over temperature
    rate_drift: RateDrift | None = quantity("", None, None)  # e(omega, T)
    warm_up: PowerOnTransient | None = quantity("", None, None)  # b(t, T)
    hysteresis: ThermalHysteresis | None = quantity("", None, None)  # hysteresis of the offset over temperature
    white_noise: WhiteNoise | None = quantity("", None, None)  # Angle or velocity random walk
    instability: BiasInstability | None = quantity("", None, None)  # Flicker of the offset
    random_walk: RandomWalk | None = quantity("", None, None)  # random walk of the offset
    amplifier: Amplifier | None = quantity("", None, None)  # Gain and rails
    low_pass: LowPass | None = quantity("", None, None)  # Analogue, second order
    adc: Adc | None = quantity("", None, None)  # Converter

    @property
    def _amplified(self) -> Amplifier:
        return self.amplifier or WIRE

    @property
    def _per_code(self) -> float:
        return self.adc.step if self.adc and self.adc.codes else 1.0

    @property
    def gain(self) -> float:
        """Nominal gain of the whole chain, unit of the reading per rad/s or m/s2."""
        return self.scale.nominal_sensitivity * self._amplified.gain / self._per_code

    @property
    def null(self) -> float:
        """Reading at zero signal, unit of the reading."""
        return self._amplified.null / self._per_code

    @property
    def forward_matrix(self) -> FloatArray:
        """Unit of the reading per rad/s or m/s2 of each case axis at the reference temperature, shape (3, 3)."""
        return np.asarray(self.gain * self.scale.matrix)

    @property
    def raw_offset(self) -> FloatArray:
        """Reading at zero input and reference temperature, unit of the reading, shape (3,)."""
        return np.asarray(self.null + self.gain * (self.offset.constant if self.offset else np.zeros(3)))

    @property
    def rails(self) -> FloatArray:
        """Signal at the rails of the amplifier, nominal input units, (2,)."""
        amplifier = self._amplified
        total = amplifier.gain * self.scale.nominal_sensitivity
        return (np.array([amplifier.low, amplifier.high]) - amplifier.null) / total

    @property
    def full_scale(self) -> float:
        """Largest rate or force in the range of amplifier and converter, rad/s or m/s2."""
        limits = self.rails
        if self.adc:
            codes = np.array(self.adc.code_limits) * self.adc.step - self._amplified.null
            limits = np.vstack((limits, codes / (self._amplified.gain * self.scale.nominal_sensitivity)))
        return float((limits * [-1.0, 1.0]).min())

    def stages(self, x: FloatArray, scene: Scene, pasts: Mapping[str, Past]) -> Iterator[tuple[str, FloatArray]]:
        """Yield each active effect before the converter, in order, with the signal after it."""
        arm = self.lever_arm.force(scene) if self.lever_arm else np.zeros((1, 3, 3))
        own_force = np.einsum("nii->ni", arm)
        for name in effects_of(self):
            if name == "lever_arm":
                x = x + own_force
            elif name == "scale":  # x already includes the force of each sensor along its axis
                x = scaled(x - own_force, self.scale, arm) if self.lever_arm else scaled(x, self.scale)
            elif name == "amplifier":
                x = np.clip(x, *self.rails)
            elif name != "adc":
                x = getattr(self, name).apply(x, scene, pasts[name])
            if name != "adc":
                yield name, x

    def reading(self, x: FloatArray) -> FloatArray:
        """Return a signal after the amplifier, which is the reading or the input of the converter."""
        return self._amplified.null + self._amplified.gain * self.scale.nominal_sensitivity * x

    def shifted(self, by: FloatArray) -> "SensorChain":
        """Return the same sensors with an additional offset (3,), rad/s or m/s2."""
        offset = self.offset or Offset()
        return replace(self, offset=replace(offset, constant=offset.constant + by))

    def without_noise(self) -> "SensorChain":
        """Return the same sensors without noise, rounding and range limits. The unit of the reading does not change."""
        step = self._per_code
        free = Amplifier(gain=self._amplified.gain / step, null=self.null)
        needed = self.amplifier is not None or step != 1.0
        quiet = dict.fromkeys(("white_noise", "instability", "random_walk", "adc"))
        return replace(self, **quiet, amplifier=free if needed else None)  # type: ignore[arg-type]


def effects_of(chain: SensorChain) -> tuple[str, ...]:
    """Return the names of the active effects, in order."""
    names = [f.name for f in fields(chain) if f.name not in ("unit", "scale") and getattr(chain, f.name) is not None]
    at = names.index("lever_arm") + 1 if "lever_arm" in names else 0
    return (*names[:at], "scale", *names[at:])
