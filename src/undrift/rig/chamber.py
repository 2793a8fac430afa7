"""Thermal chambers by address; here those behind a small SCPI-like language, over TCP or a serial port.

``manual:``, a chamber that a person sets, is in rig/manual.py.

::

    *IDN?                          maker, model, serial number, firmware
    TEMP:SPO 45.0     TEMP:SPO?    set-point, degC
    TEMP:RAMP 2.0     TEMP:RAMP?   steepest change, K/min
    MEAS:TEMP?                     temperature of the air, degC
    OUTP ON           OUTP?        heater and compressor, 1 or 0
    SYST:ERR?                      0,"No error" or the oldest fault

The air has soaked when the readings of a stated time lie within a tolerance of the set-point and none of the straight lines through
all of them, through their first and through their second half is steeper than 0.1 K/min. A device's board follows the air late, so
a soak ends when its thermometer, averaged over a fifteenth of that time, stands still likewise; without one, after five of its
stated time constants of steady air (exp(-5) = 0.7 % of the step left).
"""

import contextlib
import math
from abc import abstractmethod
from collections import deque
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from undrift.arrays import FloatArray
from undrift.base.clock import HOST, Clock
from undrift.errors import InputError, LimitError, LinkError, RigError, RigFault, check_positive
from undrift.live.transports import number_of
from undrift.plugins import load_named, names_in
from undrift.programme import Soak
from undrift.record import Face, Record
from undrift.rig.link import Link, LinkSettings

FEWEST_READINGS = 6


@dataclass(frozen=True, slots=True, kw_only=True)
class SoakSettings:
    """When a temperature counts as steady."""

    slope_c_per_min: float = 0.1  # Largest change, K/min
    window_s: float = 300.0  # Time that it must hold for, chamber s
    tolerance_c: float = 0.5  # Largest distance from the set-point, K

    def __post_init__(self) -> None:
        check_positive(self, "soak", "nothing is steadier than steady", "slope_c_per_min", "window_s", "tolerance_c")


@dataclass(frozen=True, slots=True, kw_only=True)
class ChamberSetup:
    """Limits of a chamber, and how it is watched."""

    lowest_c: float = 0.0  # Set-points beyond are refused before a byte is sent, degC
    highest_c: float = 80.0
    soak: SoakSettings = field(default_factory=SoakSettings)  # When its temperature counts as steady
    reply_timeout_s: float = 2.0  # Longest wait for an answer, host s
    baud: int = 9600  # Bits per second of a serial port
    clock: Clock = HOST  # The chamber's

    def __post_init__(self) -> None:
        if not (math.isfinite(self.lowest_c) and math.isfinite(self.highest_c) and self.lowest_c < self.highest_c):
            raise InputError(
                f"chamber: wanted a lowest set-point below the highest, got {self.lowest_c} and {self.highest_c} degC; state both"
            )
        check_positive(self, "chamber", "state it", "reply_timeout_s")


class Steadiness:
    """Watches a temperature until it is steady."""

    def __init__(self, settings: SoakSettings) -> None:
        self._settings = settings
        self._held: deque[tuple[float, float]] = deque()

    def add(self, time_s: float, temp_c: float) -> None:
        """Take a reading."""
        self._held.append((time_s, temp_c))
        # a busy host may look so seldom that a window holds fewer readings than a slope needs: then look further back
        while len(self._held) > FEWEST_READINGS and self._held[1][0] <= time_s - self._settings.window_s:
            self._held.popleft()

    def slope_c_per_min(self) -> float:
        """Return the steepest of the lines through the window and its halves, K/min; infinite before the window is full."""
        if len(self._held) < FEWEST_READINGS or self._held[-1][0] - self._held[0][0] < self._settings.window_s:
            return math.inf
        t, temp = np.array(self._held).T
        half = len(t) // 2
        parts = ((t, temp), (t[:half], temp[:half]), (t[half:], temp[half:]))
        return 60.0 * max(abs(_slope(*part)) for part in parts)

    def steady_at(self, temp_c: float) -> bool:
        """Return whether the temperature stands still at a set-point."""
        near = all(abs(value - temp_c) <= self._settings.tolerance_c for _, value in self._held)
        return near and self.slope_c_per_min() < self._settings.slope_c_per_min


class Chamber(AbstractContextManager["Chamber"]):
    """A chamber that is connected; a context manager that lets go of it. A kind of chamber sends, reads and switches off."""

    near_c: float | None = None  # How near the set-point a device must come where the air has no thermometer, K

    def __init__(self, settings: ChamberSetup) -> None:
        self.settings, self.criterion = settings, settings.soak
        self._steadiness = Steadiness(settings.soak)
        self._set_point: float | None = None
        self._closed = False

    def __exit__(self, *failure: object) -> None:
        self.close()

    def set(self, temp_c: float) -> float:
        """Switch on and set a temperature to go to."""
        low, high = self.settings.lowest_c, self.settings.highest_c
        if not low <= temp_c <= high:
            raise LimitError(
                f"chamber: wanted a set-point from {low:g} to {high:g} degC, got {temp_c:g}; choose one in between",
                temp_c=temp_c,
            )
        held = self._send(temp_c)
        if abs(held - temp_c) > 0.1:
            raise RigFault(f"chamber: wanted a set-point of {temp_c:g} degC, got {held:g}; look at the chamber")
        self._set_point, self._steadiness = held, Steadiness(self.settings.soak)
        return held

    def read(self) -> float | None:
        """Return the temperature of its air now, degC; None where it has no thermometer that can be asked."""
        temp = self._measure()
        self._steadiness.add(self.settings.clock.now(), temp)
        return temp

    def soaked(self) -> bool:
        """Take a reading and return whether the set-point is reached and the slope is below the criterion."""
        if self._set_point is None:
            raise InputError("chamber: wanted a set-point before a soak, got none; set it first")
        self.read()
        return self._steadiness.steady_at(self._set_point)

    def slope_c_per_min(self) -> float:
        """Return how fast its air changes by the criterion, K/min; infinite before a window is full."""
        return self._steadiness.slope_c_per_min()

    @abstractmethod
    def switch_off(self) -> None:
        """Switch heater and compressor off."""

    def close(self) -> None:
        """Switch it off and let go of the link; harmless when called again, and when the link is lost."""
        if self._closed:
            return
        self._closed = True
        try:
            with contextlib.suppress(RigError):
                self._reconnect()  # an answer that came late must not keep it on
                self.switch_off()
        finally:
            self._let_go()

    @abstractmethod
    def _send(self, temp_c: float) -> float:
        """Switch on, set, and return the set-point that it holds."""

    @abstractmethod
    def _measure(self) -> float:
        """Return what its thermometer reads, degC."""

    def _reconnect(self) -> None:
        """Begin the link anew."""

    def _let_go(self) -> None:
        """Close the link."""


class ScpiChamber(Chamber):
    """A chamber that understands the language above."""

    def __init__(self, url: str, settings: ChamberSetup = ChamberSetup()) -> None:
        super().__init__(settings)
        waits = LinkSettings(reply_timeout_s=settings.reply_timeout_s, baud=settings.baud, clock=settings.clock.host)
        self._link = Link(url, waits)
        try:
            self.identity = self._ask("*IDN?")
            if self.identity.count(",") != 3:
                raise LinkError(
                    f"{url}: wanted a chamber's maker, model, number, firmware, got '{self.identity}'; check address"
                )
        except BaseException:
            self._link.close()
            raise

    def switch_off(self) -> None:
        """Switch heater and compressor off."""
        if self._number("OUTP OFF;:OUTP?") != 0.0:
            raise RigFault("chamber: wanted heater and compressor off, got them on; switch the chamber off by hand")

    def _send(self, temp_c: float) -> float:
        held = self._number(f"TEMP:SPO {temp_c:.2f};:OUTP ON;:TEMP:SPO?")
        answer = self._ask("SYST:ERR?")
        if answer.partition(",")[0] not in ("0", "+0"):
            raise RigFault(f"chamber: wanted a command obeyed, got error {answer[:60]}; look at the chamber")
        return held

    def _measure(self) -> float:
        return self._number("MEAS:TEMP?")

    def _reconnect(self) -> None:
        self._link.reconnect()

    def _let_go(self) -> None:
        self._link.close()

    def _ask(self, text: str) -> str:
        return self._link.exchange(text).strip()

    def _number(self, text: str) -> float:
        answer = self._ask(text)
        if not math.isfinite(value := number_of(answer)):
            raise LinkError(
                f"chamber: wanted a number in answer to '{text}', got '{answer[:60]}'; check link and chamber"
            )
        return value


CHAMBERS = {  # kind -> the function that opens a chamber; any other address is one of a ScpiChamber
    "manual": "undrift.rig.manual:open_chamber_from",
}
GROUP = "undrift.chambers"


def open_chamber(
    address: str, settings: ChamberSetup = ChamberSetup(), *, ask: Callable[[str], str] | None = None
) -> Chamber:
    """Open a chamber; its temperature is left as it is. ``ask`` shows a person a line and returns what they typed."""
    kind = address.partition(":")[0]
    if kind not in names_in(CHAMBERS, GROUP):
        return ScpiChamber(address, settings)
    chamber: Chamber = load_named(kind, CHAMBERS, GROUP)(address, settings, ask)
    return chamber


def _slope(t: FloatArray, temp: FloatArray) -> float:
    apart = t - t.mean()
    spread = float(apart @ apart)
    return float(apart @ temp) / spread if spread > 0.0 else math.inf


# ---- What a run needs beside the rig and a chamber: readings of the device and an operator. Live ones and fakes fit alike.


class Readings(Protocol):
    """The device's readings as they come."""

    def start(self, *, certain: bool = True) -> None:
        """Begin to keep readings that the device takes from now on."""

    def end(self) -> None:
        """Let the dwell end now: what comes later is left out of ``stop``, where several devices are read one after the other."""

    def stop(self) -> Record:
        """Return the readings since ``start``, to ``end`` where it was called, and keep no more."""

    def latest(self) -> str:
        """Return the latest reading in words, "" where there is none."""

    def close(self) -> None:
        """Close the device; harmless when called again."""


class Operator(Protocol):
    """The operator, who mounts the device on the table."""

    def mount(self, up: Face) -> None:
        """Have the device mounted; returns when it is done and the table is free to turn."""


# ---- The device's board in a chamber: it follows the air late, so a soak ends when the board stands still, not the air.

LOOKS = 15  # in a window
FIRST_LOOK_S = 2.0  # tells whether there is a thermometer, table s
LAGS = 5.0


class SoakWatch:
    """Watches a board through a soak, from now on."""

    def __init__(self, readings: Readings, clock: Clock, step: Soak, chamber: Chamber, lag_s: float) -> None:
        self._readings, self._clock, self._lag_s = readings, clock, lag_s
        self._slope, self._window_s = step.slope_c_per_min, chamber.criterion.window_s
        self._wanted_c, self._near_c = step.temp_c, chamber.near_c
        self._steadiness = Steadiness(SoakSettings(slope_c_per_min=self._slope, window_s=self._window_s))
        self.temp_c: float | None = None  # What its thermometer read last, degC
        self._known = False
        self._air_since: float | None = None
        self._since = clock.now()
        readings.start(certain=False)  # the board changes slowly, so the exact start does not matter

    def __str__(self) -> str:
        return "" if self.temp_c is None else f", device {self.temp_c:.2f} degC"

    def followed(self, air_steady: bool) -> bool:
        """Return whether air and board stand still."""
        now = self._clock.now()
        self._look(now)
        self._air_since = (self._air_since or now) if air_steady else None
        if self._air_since is None or not self._known:
            return False
        if self.temp_c is None:
            if self._near_c is not None:
                raise InputError(
                    "device: wanted a thermometer in it, as the chamber is set by hand, got none; use a chamber that can be asked"
                )
            return now - self._air_since >= LAGS * self._lag_s
        return self._still() and not self._apart()

    def slope_c_per_min(self, chamber: Chamber) -> float | None:
        """Return the slope that the soak's criterion looks at now, the air's or, once that is steady, the board's; None before."""
        air_is_steady = self._air_since is not None and self.temp_c is not None
        slope = self._steadiness.slope_c_per_min() if air_is_steady else chamber.slope_c_per_min()
        return slope if math.isfinite(slope) else None

    def elsewhere(self) -> bool:
        """Return whether the board stands still far from the set-point, where nothing but the board shows the air."""
        return self._still() and self._apart()

    def _still(self) -> bool:
        return self._steadiness.slope_c_per_min() < self._slope

    def _apart(self) -> bool:
        far = self.temp_c is not None and self._near_c is not None
        return far and abs((self.temp_c or 0.0) - self._wanted_c) > (self._near_c or 0.0)

    def _look(self, now: float) -> None:
        if now - self._since < (self._window_s / LOOKS if self._known else FIRST_LOOK_S):
            return
        record = self._readings.stop()
        self._readings.start(certain=False)
        middle, self._since, self._known = 0.5 * (self._since + now), now, True
        temp_c = mean_temp(record)
        if temp_c is not None:
            self.temp_c = temp_c
            self._steadiness.add(middle, temp_c)


def mean_temp(record: Record) -> float | None:
    """Return the mean that a device's thermometer read."""
    if record.temp_c is None or not np.isfinite(record.temp_c).any():
        return None
    return float(np.nanmean(record.temp_c))
