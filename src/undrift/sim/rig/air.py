"""The air of an emulated chamber and the board in it.

::

    r'  = the set-point's way, at most the ramp     what the controller follows
    T'' = w^2 (r - T) - 2 z w T'                    air: second order, overshoots
    B'  = (T - B) / lag                             board of the device

Off, the air goes to the room's temperature with a time constant of its own; so it does, faster, with the door open. A stuck heater
leaves r where it is and drifts up. Each step of time is solved with the trapezoidal rule for the air and exactly for the board.
"""

import math
from dataclasses import dataclass

import numpy as np

from undrift.arrays import FloatArray
from undrift.errors import InputError

STEP_S = 0.5
OFF_S = 1200.0  # time constant of a chamber that is off, s
DOOR_S = 60.0
STUCK_C_PER_MIN = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class AirSettings:
    """How the air moves.

    Parameters
    ----------
    room_c : float
        Temperature around, and at the start, degC.
    ramp_c_per_min : float
        Steepest change of the controller's own set-point, K/min.
    period_s : float
        2 pi / w, s.
    damping : float
        z; below 1 overshoots.
    board_lag_s : float
        Time constant of the device's board, s.
    """

    room_c: float = 25.0
    ramp_c_per_min: float = 3.0
    period_s: float = 120.0
    damping: float = 0.6
    board_lag_s: float = 60.0

    def __post_init__(self) -> None:
        for name in ("ramp_c_per_min", "period_s", "damping", "board_lag_s"):
            if not getattr(self, name) > 0.0:
                raise InputError(f"emulated chamber: wanted {name} above 0, got {getattr(self, name)}; state it")


class Air:
    """Air and board, advanced when someone looks.

    Parameters
    ----------
    settings : AirSettings
        How it moves.
    """

    def __init__(self, settings: AirSettings) -> None:
        self.settings = settings
        self.set_point = self.aim = settings.room_c
        self.ramp_c_per_min = settings.ramp_c_per_min
        self.on = self.stuck = self.door_open = False
        self.speed = 0.0
        self.time, self.temp, self.board = [0.0], [settings.room_c], [settings.room_c]

    def advance(self, time: float) -> None:
        """Go on to a moment, or a step beyond it.

        Parameters
        ----------
        time : float
            Emulated time, s.
        """
        while self.time[-1] < time:
            temp = self._next(self.temp[-1])
            keep = math.exp(-STEP_S / self.settings.board_lag_s)
            mean = (1.0 - keep) * self.settings.board_lag_s / STEP_S  # weight of where the air comes from and goes to
            board = keep * self.board[-1] + (mean - keep) * self.temp[-1] + (1.0 - mean) * temp
            self.time.append(self.time[-1] + STEP_S)
            self.temp.append(temp)
            self.board.append(board)

    def at(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return air and board at moments that have been reached.

        Parameters
        ----------
        times : array, shape (n,)
            Emulated times, s, rising.

        Returns
        -------
        air, board : array, shape (n,)
            degC.
        """
        first = max(int(float(times[0]) / STEP_S) - 1, 0)
        last = int(float(times[-1]) / STEP_S) + 3
        grid = self.time[first:last]
        return np.interp(times, grid, self.temp[first:last]), np.interp(times, grid, self.board[first:last])

    def _next(self, temp: float) -> float:
        if self.door_open or not self.on:
            keep = math.exp(-STEP_S / (DOOR_S if self.door_open else OFF_S))
            after = self.settings.room_c + (temp - self.settings.room_c) * keep
            self.aim, self.speed = after, (after - temp) / STEP_S
            return after
        reach = self.ramp_c_per_min / 60.0 * STEP_S
        wanted = self.aim + STUCK_C_PER_MIN / 60.0 * STEP_S if self.stuck else self.set_point
        self.aim += min(max(wanted - self.aim, -reach), reach)
        w = 2.0 * math.pi / self.settings.period_s
        h, damp = STEP_S / 2.0, 2.0 * self.settings.damping * w
        speed = (self.speed * (1.0 - h * damp - h * h * w * w) + 2.0 * h * w * w * (self.aim - temp)) / (
            1.0 + h * damp + h * h * w * w
        )
        after = temp + h * (self.speed + speed)
        self.speed = speed
        return after
