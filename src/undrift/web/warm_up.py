"""Warm-up: a recording at rest while the device warms up, with its temperature and whether that stands still."""

import asyncio
import math
import time
from typing import TYPE_CHECKING

from undrift.errors import InputError, UndriftError
from undrift.record import joined
from undrift.rig.chamber import LOOKS, SoakSettings, Steadiness, mean_temp
from undrift.web.rig_run import CURVE, Point

if TYPE_CHECKING:
    from undrift.record import Record
    from undrift.web.bench import Bench, Job
    from undrift.web.source import Source

LOOK_S = 0.5  # between two looks at what came


class WarmUp:
    """One recording, from its start to the fit; ``curve`` and ``stable_since`` grow while it goes on."""

    def __init__(self, bench: "Bench", settings: SoakSettings = SoakSettings()) -> None:
        self._bench, self.settings = bench, settings
        self.job: Job | None = None
        self.error = ""
        self.recording = False
        self._task: asyncio.Task[None] | None = None
        self._clear()

    def _clear(self) -> None:
        """Forget what was seen of an earlier recording."""
        self.curve: list[Point] = []
        self.slope_c_per_min: float | None = None  # None before a window is full
        self.stable_since: float | None = None  # s since 1970
        self._steadiness = Steadiness(self.settings)

    def start(self) -> None:
        """Begin to record the device that is connected."""
        source = self._bench.source
        try:
            if source is None:
                raise InputError("warm-up: wanted a device that sends, got none; connect it first")
            if math.isnan(source.status().temp_c):
                raise InputError("warm-up: wanted a device with a thermometer, got none; use a chamber with one")
            job = self._bench.new_job(source.name)
            source.write_to(job.folder / "warm_up.parquet")
        except UndriftError as error:
            self.error = str(error)
            return
        self._clear()
        self.job, self.error, self.recording = job, "", True
        self._task = asyncio.create_task(self._follow(source))

    async def finish(self) -> bool:
        """End the recording and fit the drift over its temperatures; return whether there is a calibration."""
        source, job = self._bench.source, self.job
        self.recording = False
        if job is None or source is None:
            self.error = "warm-up: wanted the device to the end, got it disconnected; record again"
            return False
        path = await asyncio.to_thread(source.stop_writing)
        if path is None:
            self.error = "warm-up: wanted readings, got none; record again"
            return False
        outcome = await self._bench.fit_drift(job, path, "--warm-up")
        self.error = "" if outcome.done else outcome.error
        return outcome.done

    async def _follow(self, source: "Source") -> None:
        last = max((update.number for update in source.updates()), default=0)
        held: list[Record] = []
        while self.recording and source is self._bench.source:
            await asyncio.sleep(LOOK_S)
            came = source.updates(last)
            if came:
                last = came[-1].number
                held += [update.raw for update in came]
            if held and held[-1].time[-1] - held[0].time[0] >= self.settings.window_s / LOOKS:
                self._look(joined(held))
                held = []
        self.recording = False

    def _look(self, record: "Record") -> None:
        """Take the mean of a while, as a soak of a run does."""
        temp_c = mean_temp(record)
        if temp_c is None:
            return
        self._steadiness.add(0.5 * float(record.time[0] + record.time[-1]), temp_c)
        slope = self._steadiness.slope_c_per_min()
        self.slope_c_per_min = slope if math.isfinite(slope) else None
        steady = slope < self.settings.slope_c_per_min
        self.stable_since = (self.stable_since or time.time()) if steady else None
        self.curve.append(Point(time=time.time(), air_c=None, device_c=temp_c, soaking=not steady))
        if len(self.curve) > CURVE:
            del self.curve[1::2]
