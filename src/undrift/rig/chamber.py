"""Thermal chambers by address, and chambers with a small SCPI-like command set over TCP or a serial port.

``manual:`` is a chamber that a person sets. The device's own thermometer then determines when the soak ends. Commands of the other
chambers:

::

    *IDN?                          maker, model, serial number, firmware
    TEMP:SPO 45.0     TEMP:SPO?    set-point, degC
    TEMP:RAMP 2.0     TEMP:RAMP?   largest slope, K/min
    MEAS:TEMP?                     temperature of the air, degC
    OUTP ON           OUTP?        heater and compressor, 1 or 0
    SYST:ERR?                      0,"No error" or the oldest fault

The air is steady when all readings of a time window are within a tolerance of the set-point and no slope exceeds 0.1 K/min. Slopes
are fitted to the window and to each of its halves. A device's board follows the air with a lag, so a soak ends when the slopes of
its thermometer are also below the limit. The thermometer is averaged over a fifteenth of the window. If the device has no
thermometer, the soak ends after 10 min of steady air, five time constants of a typical device.
"""

import contextlib
import logging
import math
from abc import abstractmethod
from collections import deque
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from undrift.arrays import FloatArray
from undrift.base.clock import HOST, Clock
from undrift.errors import InputError, LimitError, LinkError, RigError, RigFault
from undrift.live.transports import number_of
from undrift.programme import Soak
from undrift.record import Face, Record
from undrift.rig.link import Link

FEWEST_READINGS = 6  # smallest number of readings that determine a slope
BAUD = 9600  # bits per second of a serial port

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class ChamberSetup:
    """Limits and connection of a chamber, and its criterion for a steady temperature."""

    lowest_c: float = 0.0  # lowest set-point, degC (a lower one raises LimitError before a byte is sent)
    highest_c: float = 80.0  # highest set-point, degC
    window_s: float = 300.0  # window of the criterion, chamber s
    tolerance_c: float = 0.5  # largest distance from the set-point, K
    reply_timeout_s: float = 2.0  # longest wait for an answer, host s
    clock: Clock = HOST  # clock of the chamber


class Steadiness:
    """Window of the latest temperatures that decides if a temperature is steady."""

    def __init__(self, window_s: float) -> None:
        self._window_s = window_s
        self._readings: deque[tuple[float, float]] = deque()

    def add(self, time_s: float, temp_c: float) -> None:
        """Add a reading and remove the readings before the window."""
        self._readings.append((time_s, temp_c))
        # A busy host may read rarely. The window is then extended to the number of readings that a slope requires.
        while len(self._readings) > FEWEST_READINGS and self._readings[1][0] <= time_s - self._window_s:
            self._readings.popleft()

    def slope_c_per_min(self) -> float:
        """Return the largest slope of the window and its halves, K/min, or infinity before the window is full."""
        if len(self._readings) < FEWEST_READINGS or self._readings[-1][0] - self._readings[0][0] < self._window_s:
            return math.inf
        t, temp = np.array(self._readings).T
        half = len(t) // 2
        windows = (slice(None), slice(half), slice(half, None))
        return 60.0 * max(abs(_slope(t[rows], temp[rows])) for rows in windows)

    def error_c(self, temp_c: float) -> float:
        """Return the largest distance of the readings from a set-point, K."""
        return max((abs(value - temp_c) for _, value in self._readings), default=math.inf)


def _slope(t: FloatArray, temp: FloatArray) -> float:
    deviation = t - t.mean()
    spread = float(deviation @ deviation)
    return float(deviation @ temp) / spread if spread > 0.0 else math.inf


class Chamber(AbstractContextManager["Chamber"]):
    """Base class of connected chambers, a context manager that switches the chamber off at the end."""

    near_c: float | None = None  # largest distance of a device from the set-point, K, if the air has no thermometer

    def __init__(self, settings: ChamberSetup) -> None:
        self.settings = settings
        self._steadiness = Steadiness(settings.window_s)
        self._set_point: float | None = None
        self._closed = False

    def __exit__(self, *failure: object) -> None:
        self.close()

    def set(self, temp_c: float) -> float:
        """Switch the chamber on, set its set-point and return the set-point that the chamber reports, degC."""
        low, high = self.settings.lowest_c, self.settings.highest_c
        if not low <= temp_c <= high:
            raise LimitError(
                f"chamber: the set-point must be {low:g} to {high:g} degC, got {temp_c:g}. Choose another set-point.",
                temp_c=temp_c,
            )
        actual_c = self._send(temp_c)
        if abs(actual_c - temp_c) > 0.1:
            raise RigFault(f"chamber: set {temp_c:g} degC, but the chamber reports {actual_c:g}. Check the chamber.")
        self._set_point, self._steadiness = actual_c, Steadiness(self.settings.window_s)
        return actual_c

    def read(self) -> float | None:
        """Return the current air temperature, degC, or None if it cannot be read."""
        temp_c = self._measure()
        if temp_c is not None:
            self._steadiness.add(self.settings.clock.now(), temp_c)
        return temp_c

    def soaked(self, slope_c_per_min: float = 0.1) -> bool:
        """Read the air and return True if it is steady at the set-point within a slope, or if it cannot be read."""
        if self._set_point is None:
            raise InputError("chamber: no set-point before the soak. Set the temperature first.")
        return self.read() is None or (
            self._steadiness.error_c(self._set_point) <= self.settings.tolerance_c
            and self._steadiness.slope_c_per_min() < slope_c_per_min
        )

    def close(self) -> None:
        """Switch the chamber off. A second call has no effect."""
        if not self._closed:
            self._closed = True
            with contextlib.suppress(RigError):
                self.switch_off()

    @abstractmethod
    def switch_off(self) -> None:
        """Switch heater and compressor off."""

    @abstractmethod
    def _send(self, temp_c: float) -> float:
        """Switch the chamber on, set its set-point and return the set-point that the chamber reports, degC."""

    @abstractmethod
    def _measure(self) -> float | None:
        """Return the temperature of the chamber's thermometer, degC, or None without thermometer."""


class ScpiChamber(Chamber):
    """A chamber with the command set of this module."""

    def __init__(self, url: str, settings: ChamberSetup = ChamberSetup()) -> None:
        super().__init__(settings)
        self._link = Link(url, reply_timeout_s=settings.reply_timeout_s, baud=BAUD, clock=settings.clock)
        try:
            self.identity = self._link.exchange("*IDN?").strip()
            if self.identity.count(",") != 3:
                raise LinkError(
                    f"{url}: '{self.identity}' is not maker, model, number and firmware of a chamber. Check the address."
                )
        except BaseException:
            self._link.close()
            raise

    def switch_off(self) -> None:
        try:
            self._link.reconnect()  # a late answer cannot prevent switching off
            if self._number("OUTP OFF;:OUTP?") != 0.0:
                raise RigFault("chamber: heater and compressor are still on. Switch the chamber off by hand.")
        finally:
            self._link.close()

    def _send(self, temp_c: float) -> float:
        actual_c = self._number(f"TEMP:SPO {temp_c:.2f};:OUTP ON;:TEMP:SPO?")
        answer = self._link.exchange("SYST:ERR?").strip()
        if answer.partition(",")[0] not in ("0", "+0"):
            raise RigFault(f"chamber: the command failed, got error {answer[:60]}. Check the chamber.")
        return actual_c

    def _measure(self) -> float:
        return self._number("MEAS:TEMP?")

    def _number(self, text: str) -> float:
        answer = self._link.exchange(text).strip()
        if not math.isfinite(value := number_of(answer)):
            raise LinkError(
                f"chamber: expected a number in answer to '{text}', got '{answer[:60]}'. Check link and chamber."
            )
        return value


GIVING_UP = ("q", "quit", "stop")


def ask_person(ask: Callable[[str], str], line: str, failure: str, advice: str) -> str:
    """Print a line for a person and return the answer. Raise RigFault if the person cancels."""
    try:
        answer = ask(line).strip()
    except EOFError:
        answer = "q"
    if answer.lower() in GIVING_UP:
        raise RigFault(f"{failure}, got '{answer}'. {advice}")
    return answer


class HandChamber(Chamber):
    """A chamber that a person sets. Its temperature cannot be read, so only the device's thermometer can end a soak."""

    near_c = 5.0  # tolerance for self-heating and an untrimmed thermometer, K

    def __init__(self, ask: Callable[[str], str], settings: ChamberSetup = ChamberSetup()) -> None:
        super().__init__(settings)
        self._ask = ask

    def switch_off(self) -> None:
        if self._set_point is not None:
            log.warning("chamber: set by hand, so it is still on. Switch it off.")

    def _measure(self) -> None:
        return None

    def _send(self, temp_c: float) -> float:
        line = f"Set the chamber to {temp_c:g} degC, then press Enter (q gives up): "
        failure = f"chamber: it was not set to {temp_c:g} degC"
        ask_person(self._ask, line, failure, "Set it and continue with `resume`.")
        return temp_c


def open_chamber(
    address: str, settings: ChamberSetup = ChamberSetup(), *, ask: Callable[[str], str] | None = None
) -> Chamber:
    """Open a chamber without changing its temperature. ``ask`` prints a line for a person and returns the typed answer."""
    if not address.startswith("manual:"):
        return ScpiChamber(address, settings)
    if ask is None:
        raise InputError("chamber: a chamber set by hand requires a person to ask. Use a terminal.")
    return HandChamber(ask, settings)


# ---- Interfaces that a run requires in addition to the rig and a chamber: the device's readings and an operator, live or
# simulated.


class Readings(Protocol):
    """Readings of a device as they arrive."""

    def start(self) -> None:
        """Start to store the readings of the device."""

    def end(self) -> None:
        """End the dwell now. ``stop`` then omits later readings, because several devices are stopped one after another."""

    def stop(self) -> Record:
        """Return the readings from ``start`` to ``end`` (or to now without ``end``) and stop storing."""

    def latest(self) -> str:
        """Return the latest reading as text, or "" if there are no readings."""

    def close(self) -> None:
        """Close the device. A second call has no effect."""


class Operator(Protocol):
    """The operator, who mounts the device on the table."""

    def mount(self, up: Face) -> None:
        """Ask for the device to be mounted, and return when the table is free to turn."""


# ---- Board of the device in a chamber. It lags behind the air, so a soak ends when the board is steady, not the air.

LOOKS = 15  # number of readings of the thermometer per window
FIRST_LOOK_S = 2.0  # time until the first reading, which detects a thermometer, table s
# soak of a device without thermometer after the air is steady, table s: five typical time constants
AFTER_AIR_S = 600.0


class BoardWatch:
    """Temperature of a device during a soak, which starts at construction."""

    def __init__(self, readings: Readings, clock: Clock, step: Soak, chamber: Chamber) -> None:
        self._readings, self._clock, self._step, self._near_c = readings, clock, step, chamber.near_c
        self._steadiness, self._look_s = Steadiness(chamber.settings.window_s), chamber.settings.window_s / LOOKS
        self.temp_c: float | None = None  # latest temperature of the device, degC
        self._since, self._next, self._air_since = clock.now(), clock.now() + FIRST_LOOK_S, math.inf
        self._has_looked = False
        readings.start()

    def __str__(self) -> str:
        return "" if self.temp_c is None else f", device {self.temp_c:.2f} degC"

    def followed(self, air_steady: bool) -> bool:
        """Return True if air and board are steady. Raise RigFault if the board is steady far from the set-point."""
        now = self._clock.now()
        if now >= self._next:
            self._look(now)
        self._air_since = min(self._air_since, now) if air_steady else math.inf
        if not air_steady or not self._has_looked:
            return False
        if self.temp_c is None:
            if self._near_c is not None:
                raise InputError(
                    "device: a chamber set by hand requires a device with a thermometer. Use a chamber with an address."
                )
            return now - self._air_since >= AFTER_AIR_S
        steady = self._steadiness.slope_c_per_min() < self._step.slope_c_per_min
        if steady and self._near_c is not None and abs(self.temp_c - self._step.temp_c) > self._near_c:
            raise RigFault(
                f"chamber: expected {self._step.temp_c:g} degC, but the device is steady at {self.temp_c:.2f} degC. Set the "
                "chamber and continue with `resume`."
            )
        return steady

    def _look(self, now: float) -> None:
        """Read the mean temperature since the previous reading."""
        temp_c = mean_temp(self._readings.stop())
        self._readings.start()
        if temp_c is not None:
            self.temp_c = temp_c
            self._steadiness.add(0.5 * (self._since + now), temp_c)
        self._since, self._next, self._has_looked = now, now + self._look_s, True


def mean_temp(record: Record) -> float | None:
    """Return the mean temperature of a device's thermometer, degC, or None if it has no readings."""
    if record.temp_c is None or not np.isfinite(record.temp_c).any():
        return None
    return float(np.nanmean(record.temp_c))
