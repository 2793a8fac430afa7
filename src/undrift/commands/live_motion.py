"""A device that is calibrated while a person moves it: readings are collected, and fitted again every few seconds.

Command line and bench look at the same ``MotionWatch``. What is calibrated in the end is the file of the readings.
"""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from itertools import chain, count
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from undrift.base.options import options
from undrift.commands import Screen
from undrift.commands.files import Place
from undrift.commands.record import address_of
from undrift.errors import InputError, UndriftError

if TYPE_CHECKING:
    from collections.abc import Callable

    from undrift.calibration.in_motion import InMotion
    from undrift.calibration.live_motion import ElementKnown
    from undrift.commands.bench.source import LiveDevice
    from undrift.model import Calibration
    from undrift.record import Record, Session

LOOK_S, SHARE = 2.0, 4.0  # between two fits, host s, and in times of how long one takes
SAID_S = 5.0  # device s between two lines where there is no terminal
LOST_S = 30.0  # host s without readings after which a command ends
BARS = 3
_FIRST = "First figures after 20 s; turn it slowly in the hand about every axis"
Fit: TypeAlias = "Callable[[Session], tuple[Calibration, InMotion]]"


def motion_fit(prior: Path | None, *, identify_adc: bool, magnetometer: bool) -> Fit:
    """Return the fit to motion, from a prior of the part."""
    from undrift.base.codec import read
    from undrift.calibration.calibrate import from_motion
    from undrift.calibration.element_prior import PUBLISHED, ElementPrior

    part = PUBLISHED if prior is None else read(ElementPrior, prior)
    return partial(from_motion, identify_adc=identify_adc, magnetometer=magnetometer, prior=part)


@options
@dataclass(frozen=True, kw_only=True)
class LiveMotion:
    """A device that sends while a person moves it.

    Parameters
    ----------
    live : str or None
        A device that is moved now, in place of recordings: a serial port or another address, as in `record`; what lines of text
        hold is found by listening. Readings are written beside the output.
    live_s : float
        With --live: longest time to collect, device s.
    enough_percent : float
        With --live: 95 % uncertainty at which it stops, % of scale factors and cross-axis terms, and of gravity for the
        accelerometers' offset; a tenth of it in deg/s for the gyroscopes' offset.
    """

    live: str | None = None
    live_s: float = 300.0
    enough_percent: float = 0.5

    def check(self, files: tuple[Path, ...], output: Path | None) -> None:
        """Raise where recordings and a device are both named, or neither, or where nothing would be kept."""
        if self.live is None and (not files or self != LiveMotion()):
            got = "neither" if not files else "settings of `live` alone"
            raise InputError(f"calibrate: wanted recordings or a device, got {got}; name files, or `live` ADDRESS")
        if self.live is not None and (files or output is None):
            got = f"{files[0]} too" if files else "no name for what it makes"
            raise InputError(f"`live`: wanted a device alone and `output`, got {got}; say `output` calibration.json")
        if not (self.live_s > 0.0 and self.enough_percent > 0.0):
            raise InputError(
                f"`live`: wanted a time and an uncertainty above 0, got {self.live_s:g} s and {self.enough_percent:g} %"
            )


class MotionWatch:
    """Collects what a device sends from now on, and says how far each element is known."""

    def __init__(self, source: "LiveDevice", path: Path, fit: Fit, place: Place, enough_percent: float) -> None:
        self.source, self.elements, self.seconds, self.pause_s = source, tuple["ElementKnown", ...](), 0.0, LOOK_S
        self.enough = False  # in two fits in a row
        self._fit, self._percent, self._words = fit, enough_percent, _FIRST
        # No movement makes up for a gravity that is assumed: the verdict says what it adds
        self._about: Any = {"gravity_m_s2": place.gravity()[0], "gravity_source": "stated", "serial": ""}
        self._raw, self._heard = list["Record"](), time.monotonic()
        self._number = max((one.number for one in source.updates()), default=0)
        source.write_to(path)

    def look(self) -> None:
        """Take what has come and fit all of it anew; raises InputError for readings that motion cannot calibrate."""
        from undrift.calibration.live_motion import elements_known
        from undrift.record import Session, joined

        if not (came := self.source.updates(self._number)):
            return
        self._number, self._heard, began = came[-1].number, time.monotonic(), time.monotonic()
        self._raw += [one.raw for one in came]
        whole = joined(self._raw)
        self.seconds, before = whole.duration_s, bool(self.elements) and all(one.enough for one in self.elements)
        try:
            session = Session(kind="calibration", records=(whole,), **self._about)
            self.elements, self._words = elements_known(*self._fit(session), self._percent), ""
        except UndriftError as error:  # too short, at rest, or bumped: more readings may mend it
            self._words = _FIRST if self.seconds < 20.0 else str(error)
        self.enough = before and not self._words and all(one.enough for one in self.elements)
        self.pause_s = max(LOOK_S, SHARE * (time.monotonic() - began))

    @property
    def lost(self) -> bool:
        """Whether the device has been silent for long."""
        return time.monotonic() - self._heard > LOST_S

    @property
    def words(self) -> str:
        """How far it is, and in a line below what to do next."""
        if self.source.error or self._words:
            return f"{self.seconds:.0f} s\n{self.source.error or self._words}"
        known = sum(one.enough for one in self.elements)
        least = max(self.elements, key=lambda one: one.uncertainty / one.wanted)
        count = f"{self.seconds:.0f} s: {known} of {len(self.elements)} elements known well enough"
        return count if least.enough else f"{count}\nNext: {least.movement}"

    def table(self) -> Iterator[str]:
        """Yield lines: words, and below them each group of elements: name, what is wanted, bars and what is reached."""
        yield f"{self.words}\n"
        for three in (self.elements[k : k + 3] for k in range(0, len(self.elements), 3)):
            full = (min(BARS, int(BARS * one.wanted / one.uncertainty)) for one in three)
            bars = ("█" * count + "·" * (BARS - count) for count in full)
            cells = (f"{one.axis} {bar} {one.uncertainty:.2g}" for one, bar in zip(three, bars, strict=True))
            head = f"{three[0].name} {three[0].wanted:.2g} {three[0].unit}"
            yield f"{head:34}" + "  ".join(f"{cell:12}" for cell in cells)


def collect(live: LiveMotion, output: Path | None, place: Place, fit: Fit, screen: Screen) -> dict[str, Any]:
    """Write what a device sends until each element is known well enough, the time is over, or Ctrl-C; say how it ended."""
    from undrift.commands.bench.source import LiveDevice
    from undrift.live.log import described_address

    if live.live is None or output is None:
        return {}
    names = (output.with_name(f"{output.stem}{more}.parquet") for more in chain(("",), (f"-{k}" for k in count(2))))
    path = next(name for name in names if not name.exists())  # no recording is written over
    screen.over(f"Listening to {live.live} ...")
    address, notes = described_address(address_of([live.live]))
    screen.over("")
    screen.say(*(f"  note: {note}" for note in notes))
    source = LiveDevice(address)
    try:
        source.start()
        watch = MotionWatch(source, path, fit, place, live.enough_percent)
        try:
            while watch.seconds < live.live_s and not (watch.enough or watch.lost):
                time.sleep(watch.pause_s)
                watch.look()
                screen.over("\n".join(watch.table()), step=int(watch.seconds // SAID_S))
            ended = "enough" if watch.enough else "lost" if watch.lost else "time"
        except KeyboardInterrupt:
            ended = "stopped"
    finally:
        file = source.stop()
    if file is None:
        raise InputError(f"`live`: wanted readings of {live.live}, got none before it was stopped; try again")
    screen.over("\n".join(watch.table()), last=True)
    screen.say(f"Wrote {file}")
    return {"address": address, "recording": str(file), "seconds": watch.seconds, "ended": ended}
