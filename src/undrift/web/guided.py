"""Guided: the guides of the pages Six faces and Turns by hand, fed from the connected device while someone works.

It runs on the server: a reload, a second browser or a closed one changes nothing. What is captured is written at once.
"""

import asyncio
import time
from typing import TYPE_CHECKING

from nicegui import background_tasks

from undrift.errors import UndriftError
from undrift.web.capture import Capture
from undrift.web.six_faces import SixFaces
from undrift.web.turns import Turns

if TYPE_CHECKING:
    from undrift.web.bench import Bench, Job

PERIOD_S = 0.2
UNSEEN_S = 600.0  # host s without a page that looks, after which it pauses
DONE_S = 5.0  # the same when all is captured
MOST_S = 100.0  # of readings that are taken at once


class Guided:
    """One job's capture, and which of its guides is at work."""

    def __init__(self, bench: "Bench", job: "Job") -> None:
        self._bench, self._job = bench, job
        self.capture = Capture(job.session, job.serial)
        self.faces, self.turns = SixFaces(self.capture), Turns(self.capture)
        self.guide: SixFaces | Turns = self.faces
        self.error = self.refused = ""  # of the capture; of the last calibration
        self._seen_s, self._taken_s = -UNSEEN_S, time.monotonic()

    def look(self, guide: SixFaces | Turns) -> None:
        """Note that a page shows a guide: this one is at work from now on."""
        self.guide, self._seen_s = guide, time.monotonic()

    async def run(self) -> None:
        """Feed the guide until another job is begun."""
        while self._bench.job is self._job:
            now = time.monotonic()
            if now - self._seen_s < (DONE_S if self.guide.wanted is None else UNSEEN_S):
                await self._step(now)
            await asyncio.sleep(PERIOD_S)

    async def _step(self, now: float) -> None:
        source = self._bench.source
        record = None if source is None else source.recent(min(now - self._taken_s + 1.0, MOST_S))
        self._taken_s = now if record is not None else self._taken_s
        self.error = ""
        try:
            self.guide.update(record, now, source)
            if not self.capture.saved and (self.capture.faces or self.capture.turns):
                place = self._bench.place
                self.capture.gravity_m_s2 = place.gravity_m_s2 if place.words() else None
                session, self.capture.saved = self.capture.session(), True
                await asyncio.to_thread(self.capture.save, session)
        except UndriftError as error:
            self.error, self.capture.saved = str(error), False


def guided_of(bench: "Bench") -> Guided | None:
    """Return the guided capture of the connected device, begun where there is none; None without a device."""
    job, source = bench.job, bench.source
    if source is None:
        return None if job is None else job.capture
    if job is not None and job.capture is not None and job.serial == source.name:
        held: Guided = job.capture
        return held
    if job is None or job.calibration is not None or job.capture is not None or job.serial != source.name:
        job = bench.new_job(source.name)
    job.capture = Guided(bench, job)
    background_tasks.create(job.capture.run(), name="guided capture")
    return job.capture  # type: ignore[no-any-return]


def begin_anew(bench: "Bench") -> None:
    """Leave what was captured as it is, and begin with an empty capture."""
    if bench.source is not None:
        bench.job = None
        guided_of(bench)
