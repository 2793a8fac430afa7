"""The device's board in a chamber: it follows the air late, so a soak ends when the board stands still, not the air.

Its thermometer is averaged over a fifteenth of the criterion's window at a time; the slopes of those means, over the window and its
halves, must be below the criterion. A device without a thermometer is given five of its stated time constants, exp(-5) = 0.7 % of
the step left, during which the air must be steady without a break.
"""

import numpy as np

from undrift.record import Record
from undrift.rig.chamber import SoakSettings, Steadiness
from undrift.rig.clock import Clock
from undrift.rig.programme import Soak
from undrift.rig.seams import Readings

LOOKS = 15  # in a window
FIRST_LOOK_S = 2.0  # tells whether there is a thermometer, table s
LAGS = 5.0


class Board:
    """Watches a board through a soak, from now on.

    Parameters
    ----------
    readings : Readings
        Of the device; a dwell of them is kept going.
    clock : Clock
        Of the table.
    step : Soak
        Its slope is the criterion.
    criterion : SoakSettings
        Of the chamber; its window counts.
    lag_s : float
        Time constant of a device without thermometer, table s.
    """

    def __init__(self, readings: Readings, clock: Clock, step: Soak, criterion: SoakSettings, lag_s: float) -> None:
        self._readings, self._clock, self._lag_s = readings, clock, lag_s
        self._slope, self._window_s = step.slope_c_per_min, criterion.window_s
        self._steadiness = Steadiness(SoakSettings(slope_c_per_min=self._slope, window_s=self._window_s))
        self._temp_c: float | None = None
        self._known = False
        self._air_since: float | None = None
        self._since = clock.now()
        readings.start(certain=False)  # a board changes slowly, and looks follow each other without a pause

    def __str__(self) -> str:
        return "" if self._temp_c is None else f", device {self._temp_c:.2f} degC"

    def followed(self, air_steady: bool) -> bool:
        """Return whether air and board stand still.

        Parameters
        ----------
        air_steady : bool
            What the chamber says now.

        Returns
        -------
        bool
            False until the device has been heard.

        Raises
        ------
        RigError
            The device is lost.
        """
        now = self._clock.now()
        self._look(now)
        self._air_since = (self._air_since or now) if air_steady else None
        if self._air_since is None or not self._known:
            return False
        if self._temp_c is None:
            return now - self._air_since >= LAGS * self._lag_s
        return self._steadiness.slope_c_per_min() < self._slope

    def _look(self, now: float) -> None:
        if now - self._since < (self._window_s / LOOKS if self._known else FIRST_LOOK_S):
            return
        record = self._readings.stop()
        self._readings.start(certain=False)
        middle, self._since, self._known = 0.5 * (self._since + now), now, True
        temp_c = mean_temp(record)
        if temp_c is not None:
            self._temp_c = temp_c
            self._steadiness.add(middle, temp_c)


def mean_temp(record: Record) -> float | None:
    """Return the mean that a device's thermometer read.

    Parameters
    ----------
    record : Record
        Readings.

    Returns
    -------
    float or None
        degC; None where it has no thermometer, or none that says anything.
    """
    if record.temp_c is None or not np.isfinite(record.temp_c).any():
        return None
    return float(np.nanmean(record.temp_c))
