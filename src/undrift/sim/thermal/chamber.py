"""Chamber: the temperature of its set-point, its air and the board in it, over time.

::

    |r'| <= ramp limit                                   r set-point, straight from one to the next
    a'' + 2 z a' / s + a / s^2 = r / s^2                 a air: s its lag, z its damping; it overshoots where z < 1
    b' = (a - b) / tau                                   b board
    soaked: |b'| < limit throughout the hold             for the rest of the way the chamber waits

With x = (a, a', b, r, r') all of it is x' = A x, so a step h is ``x <- expm(h A) x`` exactly: ramps end on whole steps, never
faster than the limit. Without a chamber a board warms itself, in two terms: die and package first, board and case later::

    b = end - (end - start) (p exp(-t / t_1) + (1 - p) exp(-t / t_2))
"""

import math
from dataclasses import dataclass, field

import numpy as np

from undrift.arrays import FloatArray, frozen
from undrift.errors import InputError

SECONDS_PER_MINUTE = 60.0


@dataclass(frozen=True, slots=True, kw_only=True)
class ChamberSettings:
    """What a climatic chamber and the board in it can do.

    Parameters
    ----------
    ramp_rate_c_per_min : float
        The most that a set-point moves between soaks, degC/min; faster ramps shorten a programme, and lag costs more.
    air_lag_s : float
        s in the air's equation, s.
    damping : float
        z in the air's equation: 1 and above never overshoots, 0.7 by 5 % of a sudden step.
    board_lag_s : float
        tau, s; a bare board in moving air has some minutes.
    soak_rate_c_per_min : float
        The board is soaked while its temperature changes by less, degC/min.
    soak_hold_s : float
        For how long it must do so, s, so that the turn of an overshoot does not pass for a soak.
    longest_wait_s : float
        A soak that takes longer is an error, s.
    step_s : float
        Step of the profile, s.
    """

    ramp_rate_c_per_min: float = 2.0
    air_lag_s: float = 60.0
    damping: float = 0.7
    board_lag_s: float = 240.0
    soak_rate_c_per_min: float = 0.1
    soak_hold_s: float = 60.0
    longest_wait_s: float = 4.0 * 3600.0
    step_s: float = 1.0

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            if not getattr(self, name) > 0.0:
                raise InputError(f"chamber: wanted {name} above 0, got {getattr(self, name):g}; correct the settings")


@dataclass(frozen=True, slots=True, kw_only=True)
class RampSettings:
    """A ramp up and back down.

    Parameters
    ----------
    low_c, high_c : float
        Set-points at its ends, degC.
    up_c_per_min, down_c_per_min : float
        How fast the set-point moves, degC/min; 0 down ends the ramp at the top.
    hold_s : float
        Wait at the top, and at the bottom in the end, s.
    """

    low_c: float = 18.0
    high_c: float = 75.0
    up_c_per_min: float = 1.0
    down_c_per_min: float = 1.0
    hold_s: float = 600.0

    def __post_init__(self) -> None:
        if not (self.high_c > self.low_c and self.up_c_per_min > 0.0 and self.down_c_per_min >= 0.0):
            raise InputError(
                f"ramp: wanted high_c above low_c, a rate up above 0 and one down of 0 or more, got {self.low_c:g} to "
                f"{self.high_c:g} degC at {self.up_c_per_min:g} and {self.down_c_per_min:g} degC/min; correct the settings"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class WarmUpSettings:
    """A board that warms itself after power-on. The defaults are a fit to a recorded MPU-6050, true to 0.03 K rms.

    Parameters
    ----------
    start_c, end_c : float
        Temperature at power-on and in the end, degC.
    fast_share : float
        p: how much of the way goes with the short time constant, 0 to 1.
    fast_s, slow_s : float
        t_1 and t_2, s.
    duration_s : float
        Length, s.
    """

    start_c: float = 10.7
    end_c: float = 29.1
    fast_share: float = 0.52
    fast_s: float = 150.0
    slow_s: float = 549.0
    duration_s: float = 2160.0

    def __post_init__(self) -> None:
        if not (0.0 <= self.fast_share <= 1.0 and min(self.fast_s, self.slow_s, self.duration_s) > 0.0):
            raise InputError(
                f"warm-up: wanted a share of 0 to 1 and times above 0 s, got {self.fast_share:g}, {self.fast_s:g}, "
                f"{self.slow_s:g} and {self.duration_s:g} s; correct the settings"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class Soak:
    """One visit to a set-point.

    Parameters
    ----------
    set_point_c : float
        degC.
    begin_s : float
        When the chamber leaves the set-point before, s.
    soaked_s : float
        When the board is soaked, s.
    end_s : float
        When the visit ends, s.
    """

    set_point_c: float
    begin_s: float
    soaked_s: float
    end_s: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Profile:
    """Temperatures of a programme, n steps.

    Parameters
    ----------
    time : array, shape (n,)
        s, evenly spaced from 0.
    set_point_c, air_c : array, shape (n,)
        degC; NaN where there is no chamber.
    board_c : array, shape (n,)
        degC.
    soaks : tuple of Soak
        In order of time; none in a ramp or a warm-up.
    """

    time: FloatArray
    set_point_c: FloatArray
    air_c: FloatArray
    board_c: FloatArray
    soaks: tuple[Soak, ...] = ()

    def __post_init__(self) -> None:
        n = len(self.time)
        for name in ("time", "set_point_c", "air_c", "board_c"):
            object.__setattr__(self, name, frozen(getattr(self, name), (n,), f"Profile.{name}"))

    def board_at(self, time: FloatArray) -> FloatArray:
        """Return the temperature of the board, straight between steps.

        Parameters
        ----------
        time : array, shape (N,)
            s; before the start and after the end it stays as it is there.

        Returns
        -------
        array, shape (N,)
            degC.
        """
        return np.interp(time, self.time, self.board_c)

    def turns_before(self, time_s: float) -> FloatArray:
        """Return the temperatures at which the board began and turned back: all that a play remembers.

        Parameters
        ----------
        time_s : float
            s.

        Returns
        -------
        array, shape (k,)
            degC, of the time before, in order; empty at the start.
        """
        seen: FloatArray = self.board_c[self.time < time_s]
        if not len(seen):
            return seen
        moved = np.concatenate(([True], np.diff(seen) != 0.0))
        seen = seen[moved]
        slope = np.sign(np.diff(seen))
        turned = np.flatnonzero(slope[1:] != slope[:-1]) + 1
        ends: FloatArray = seen[np.concatenate(([0], turned)).astype(int)]
        return ends


def soak_profile(
    set_points_c: tuple[float, ...],
    *,
    measured_s: float,
    settings: ChamberSettings | None = None,
) -> Profile:
    """Return a programme of soaks: at each set-point wait until the board is soaked, then stay as long as measuring takes.

    Parameters
    ----------
    set_points_c : tuple of float
        degC, in the order of the visits; the chamber has settled at the first.
    measured_s : float
        Stay at each once soaked, s; rounded up to whole steps.
    settings : ChamberSettings, optional
        Of the chamber.

    Returns
    -------
    Profile
        With one Soak for each set-point.

    Raises
    ------
    InputError
        No set-point, or a board that is not soaked in time.
    """
    if not set_points_c:
        raise InputError("soaks: wanted one set-point or more, got none; give temperatures in degC")
    chamber = _Chamber(settings or ChamberSettings(), set_points_c[0])
    soaks = []
    for set_point_c in set_points_c:
        begin_s = chamber.now_s
        chamber.ramp_to(set_point_c, chamber.settings.ramp_rate_c_per_min)
        chamber.wait_for_soak()
        soaked_s = chamber.now_s
        chamber.wait(measured_s)
        soaks.append(Soak(set_point_c=set_point_c, begin_s=begin_s, soaked_s=soaked_s, end_s=chamber.now_s))
    return chamber.profile(tuple(soaks))


def ramp_profile(ramp: RampSettings, *, settings: ChamberSettings | None = None) -> Profile:
    """Return a ramp from low to high and back.

    Parameters
    ----------
    ramp : RampSettings
        Ends and rates.
    settings : ChamberSettings, optional
        Of the chamber; its ramp limit is not asked.

    Returns
    -------
    Profile
        Begins settled at the low end.
    """
    chamber = _Chamber(settings or ChamberSettings(), ramp.low_c)
    chamber.ramp_to(ramp.high_c, ramp.up_c_per_min)
    chamber.wait(ramp.hold_s)
    if ramp.down_c_per_min > 0.0:
        chamber.ramp_to(ramp.low_c, ramp.down_c_per_min)
        chamber.wait(ramp.hold_s)
    return chamber.profile(())


def warm_up_profile(warm_up: WarmUpSettings, *, step_s: float = 1.0) -> Profile:
    """Return the temperature of a board from power-on, without a chamber.

    Parameters
    ----------
    warm_up : WarmUpSettings
        From where to where, how fast.
    step_s : float
        Step of the profile, s.

    Returns
    -------
    Profile
        Set-point and air are NaN.
    """
    time = np.arange(math.ceil(warm_up.duration_s / step_s) + 1) * step_s
    lacking = warm_up.fast_share * np.exp(-time / warm_up.fast_s)
    lacking = lacking + (1.0 - warm_up.fast_share) * np.exp(-time / warm_up.slow_s)
    unknown = np.full(len(time), np.nan)
    board = warm_up.end_c - (warm_up.end_c - warm_up.start_c) * lacking
    return Profile(time=time, set_point_c=unknown, air_c=unknown, board_c=board)


@dataclass
class _Chamber:
    """A chamber at work: each order moves its clock on."""

    settings: ChamberSettings
    start_c: float
    states: list[FloatArray] = field(default_factory=list)

    def __post_init__(self) -> None:
        from scipy.linalg import expm

        s, tau = self.settings.air_lag_s, self.settings.board_lag_s
        flow = np.zeros((5, 5))
        flow[0, 1] = 1.0
        flow[1, [0, 1, 3]] = -1.0 / s**2, -2.0 * self.settings.damping / s, 1.0 / s**2
        flow[2, [0, 2]] = 1.0 / tau, -1.0 / tau
        flow[3, 4] = 1.0
        self.step = expm(flow * self.settings.step_s)
        self.states = [np.array([self.start_c, 0.0, self.start_c, self.start_c, 0.0])]

    @property
    def now_s(self) -> float:
        return (len(self.states) - 1) * self.settings.step_s

    @property
    def board_rate(self) -> float:
        """Of the board, degC/s."""
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
                    f"soak: wanted less than {self.settings.soak_rate_c_per_min:g} degC/min within "
                    f"{self.settings.longest_wait_s:g} s at {self.states[-1][3]:g} degC, got "
                    f"{abs(self.board_rate) * SECONDS_PER_MINUTE:.3g} degC/min; wait longer, or ask for less"
                )
            self.wait(self.settings.step_s)
            calm = calm + 1 if abs(self.board_rate) < limit else 0

    def profile(self, soaks: tuple[Soak, ...]) -> Profile:
        held = np.array(self.states)
        time = np.arange(len(held)) * self.settings.step_s
        return Profile(time=time, set_point_c=held[:, 3], air_c=held[:, 0], board_c=held[:, 2], soaks=soaks)
