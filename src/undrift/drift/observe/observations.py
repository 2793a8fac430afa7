"""What a thermal session shows, one row each: blocks of rest, and dwells at a steady rate, with their temperatures."""

from dataclasses import dataclass
from typing import Any

from undrift.arrays import FloatArray, IntArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RestBlocks:
    """Means over blocks of rest, n rows in the order of session and time.

    Parameters
    ----------
    session : array of int, shape (n,)
        Which session, from 0.
    pose : array of int, shape (n,)
        Which orientation; blocks of one number lay the same way throughout, and numbers are not shared by sessions.
    time : array, shape (n,)
        Middle of the block, s, on a clock on which the recordings of its session follow each other.
    power_on_s : array, shape (n,)
        Time since the block's recording began, s: the device was switched on then, if it was.
    temp_c : array, shape (n,)
        Mean temperature, degC, lag taken off.
    ramp_c_per_min : array, shape (n,)
        Slope of the temperature, degC/min: above 0 while warming.
    gyro, accel : array, shape (n, 3)
        Mean reading, raw unit; NaN where the session has no such sensors.
    gyro_variance, accel_variance : array, shape (n, 3)
        Variance of that mean from the scatter inside the block, raw unit squared.
    gyro_step_error, accel_step_error : array, shape (n, 3), or None
        Standard deviation of what the converter's steps leave in the mean, raw unit: it does not average out at one level.
    """

    session: IntArray
    pose: IntArray
    time: FloatArray
    power_on_s: FloatArray
    temp_c: FloatArray
    ramp_c_per_min: FloatArray
    gyro: FloatArray
    accel: FloatArray
    gyro_variance: FloatArray
    accel_variance: FloatArray
    gyro_step_error: FloatArray | None = None
    accel_step_error: FloatArray | None = None

    def __len__(self) -> int:
        return len(self.temp_c)

    def taken(self, which: FloatArray | IntArray | slice) -> "RestBlocks":
        """Return some of the rows.

        Parameters
        ----------
        which : array, shape (k,), or slice
            Mask, row numbers or slice.

        Returns
        -------
        RestBlocks
            Those rows.
        """
        own = {name: getattr(self, name) for name in self.__dataclass_fields__}
        taken: dict[str, Any] = {name: None if value is None else value[which] for name, value in own.items()}
        return RestBlocks(**taken)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RateSteps:
    """Means over dwells at a steady rate, n rows in the order of session and time.

    Parameters
    ----------
    session : array of int, shape (n,)
        Which session, from 0.
    soak : array of int, shape (n,)
        Which soak: dwells of one number were made at one temperature.
    time : array, shape (n,)
        Middle of the dwell, s, on a clock on which the recordings of its session follow each other.
    temp_c : array, shape (n,)
        Mean temperature, degC, lag taken off.
    rate_b : array, shape (n, 3)
        Imposed rate in case axes, rad/s.
    gyro, accel : array, shape (n, 3)
        Mean reading, raw unit.
    gyro_variance : array, shape (n, 3)
        Variance of the mean from the scatter inside the dwell, raw unit squared.
    """

    session: IntArray
    soak: IntArray
    time: FloatArray
    temp_c: FloatArray
    rate_b: FloatArray
    gyro: FloatArray
    accel: FloatArray
    gyro_variance: FloatArray

    def __len__(self) -> int:
        return len(self.temp_c)

    def taken(self, which: FloatArray | IntArray | slice) -> "RateSteps":
        """Return some of the rows.

        Parameters
        ----------
        which : array, shape (k,), or slice
            Mask, row numbers or slice.

        Returns
        -------
        RateSteps
            Those rows.
        """
        return RateSteps(**{name: getattr(self, name)[which] for name in self.__dataclass_fields__})
