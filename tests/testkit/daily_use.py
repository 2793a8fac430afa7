"""Daily use of a simulated device: each day it is switched on, is on a table, is worn, and is put back on the table.

::

    board    b = room + rise (1 - exp(-t / tau)) while in use, back towards the room after it is put down
    offset   of the device, + a(day) + s        a ageing, a random walk over days; s drawn anew at each switch-on

Worn: sitting down and standing up, then quiet stance, whose sway is that of the task ``posturography``.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from undrift.arrays import FloatArray
from undrift.record import Session
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.simulate import simulate_device
from undrift.sim.motion.motion import Motion, Script, turn_quaternion
from undrift.sim.motion.tasks import draw_task
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

_WALKING = 30.0  # days, to which ``ageing`` refers


@dataclass(frozen=True, slots=True, kw_only=True)
class DailyUseSettings:
    days: int = 50
    turn_on: float = 0.03 * RADIAN_PER_DEGREE  # standard deviation of the offset from switch-on to switch-on, rad/s
    ageing: float = 0.02 * RADIAN_PER_DEGREE  # standard deviation of the offset's walk in 30 days, rad/s
    room_c: float = 20.0  # mean of the room, degC
    room_sd_c: float = 3.0  # from day to day, K
    outdoors: float = 0.15  # share of days that begin outdoors
    outdoors_c: float = 6.0  # mean of those, degC
    rise_c: tuple[float, float] = (6.0, 12.0)  # warming in use, least and most, K
    warming_s: float = 90.0  # tau, s
    rest_s: float = 40.0  # on the table, before and after use, s
    worn_s: float = 60.0  # quiet stance, s
    sample_rate_hz: float = 25.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Day:
    number: int  # from 0
    session: Session  # one recording, nothing labelled
    shift: FloatArray  # (3,), of the gyroscopes on this day: ageing and switch-on, rad/s
    aged: FloatArray  # (3,), the part of ageing, rad/s


def simulate_daily_use(
    device: DeviceModel,
    *,
    rng: np.random.Generator,
    settings: DailyUseSettings = DailyUseSettings(),
    motions: Sequence[Motion] = (),
) -> Iterator[Day]:
    """Yield the recording of each day. ``motions`` contains motions to choose from. Without it, each day has a random
    motion.
    """
    aged = np.zeros(3)
    for number in range(settings.days):
        aged = aged + settings.ageing / _WALKING**0.5 * rng.standard_normal(3)
        shift = aged + settings.turn_on * rng.standard_normal(3)
        motion = motions[int(rng.integers(len(motions)))] if motions else draw_day(rng, settings)
        today = replace(device, gyro=device.gyro.shifted(shift))
        simulation = simulate_device(today, motion, rng=rng, temp_c=board_temperature(motion, rng, settings))
        session = Session(
            kind="thermal", serial=device.serial, gravity_m_s2=motion.gravity_m_s2, records=(simulation.record,)
        )
        yield Day(number=number, session=session, shift=shift, aged=aged.copy())


def board_temperature(motion: Motion, rng: np.random.Generator, settings: DailyUseSettings) -> FloatArray:
    """Return the temperature of the board, (N,), degC."""
    mean = settings.outdoors_c if rng.random() < settings.outdoors else settings.room_c
    room, rise = rng.normal(mean, settings.room_sd_c), rng.uniform(*settings.rise_c)
    time = motion.time - motion.time[0]
    put_down = float(time[-1]) - settings.rest_s
    warm = rise * -np.expm1(-np.minimum(time, put_down) / settings.warming_s)
    return np.asarray(room + warm * np.exp(-np.maximum(time - put_down, 0.0) / settings.warming_s))


def draw_day(rng: np.random.Generator, settings: DailyUseSettings) -> Motion:
    rate = settings.sample_rate_hz
    risen, stance = draw_task("sit_to_stand", rng=rng, rest_s=1.0), draw_task("posturography", rng=rng, rest_s=0.0)
    upright = np.arange(round(min(settings.worn_s, stance.duration_s) * rate)) / rate
    moves = [(risen, np.arange(round(risen.duration_s * rate)) / rate), (stance, upright)]
    worn = [task.at(time, STANDARD_GRAVITY) for task, time in moves]
    parts = [_on_a_table(rng, settings), *worn, _on_a_table(rng, settings)]
    columns: dict[str, Any] = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in ("q_nb", "rate_b", "mean_rate_b", "angular_acceleration_b", "force_b", "moving")
    }
    return Motion(time=np.arange(len(columns["moving"])) / rate, gravity_m_s2=STANDARD_GRAVITY, **columns)


def _on_a_table(rng: np.random.Generator, settings: DailyUseSettings) -> Motion:
    """Lie for a while, be turned over by hand, and lie again."""
    up = rng.standard_normal(3)
    script = Script(settings.sample_rate_hz, up / np.linalg.norm(up))
    script.still(settings.rest_s)
    axis = rng.standard_normal(3)
    script.lay(turn_quaternion(axis / np.linalg.norm(axis), np.array([rng.uniform(0.5, 1.5)]))[0], 3.0)
    script.still(0.5 * settings.rest_s)
    return script.motion(STANDARD_GRAVITY)
