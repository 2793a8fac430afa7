"""The rate table as the bench holds it: addresses, protocols, the emulated table, and the run; pages of all browsers show it."""

import asyncio
from collections.abc import Awaitable, Callable
from typing import TYPE_CHECKING

from undrift.errors import InputError, UndriftError
from undrift.rig.programme import Forecast
from undrift.web.protocol_form import ProtocolForm
from undrift.web.rig_run import GOING, EmulatedTable, RigRun, RunOrder, begin_run, find_run

if TYPE_CHECKING:
    from undrift.web.bench import Bench

ADDRESSES = ("rig", "device", "chamber", "operator")


class RateTable:
    """What a person has filled in, and what becomes of it. Its methods are called on the event loop and do not block it."""

    def __init__(self, bench: "Bench") -> None:
        self._bench = bench
        self.addresses = dict.fromkeys(ADDRESSES, "")
        self.filled = 0  # how often they were filled in by other than typing
        self.rates = ProtocolForm()
        self.soaks = ProtocolForm(name="temperature", axes=(), temperatures_c="20, 35, 50")
        self.speed = "1"  # of the emulated table
        self.serial = ""
        self.busy = ""  # what is being started, in words
        self.error = ""
        self.emulated = EmulatedTable(bench.folder)
        self._forecasts: dict[tuple[str, str], Forecast | str] = {}
        self._take_up()

    @property
    def run(self) -> RigRun | None:
        """Return the run that goes on, or the last one."""
        return self._bench.rig_run

    async def use_emulated(self) -> None:
        """Start the emulated table, chamber, device and operator, and fill in their addresses."""
        await self._doing("Starting the emulated table", self._use_emulated)

    async def start(self, form: ProtocolForm) -> None:
        """Start a run, in a job of its own."""
        await self._doing("Starting the run", lambda: self._start(form))

    async def go_on(self) -> None:
        """Continue a run that was paused or stopped, or that failed."""
        run = self.run
        if run is not None:
            await self._doing("Starting the run", lambda: self._launch(run))

    async def pause(self) -> None:
        """End the dwell that is going; the table comes to rest, its motor off."""
        if self.run is not None:
            await asyncio.to_thread(self.run.pause)

    async def answer(self, number: int, text: str = "") -> None:
        """Answer a question of the run."""
        if self.run is not None:
            await asyncio.to_thread(self.run.answer, number, text)

    def forget(self) -> None:
        """Make room for another run; what the last one recorded stays in its folder."""
        if self.run is not None and not self.run.may_move:
            self._bench.rig_run, self._bench.job, self.error = None, None, ""

    async def calibrate(self) -> bool:
        """Calibrate from the run; return whether there is a calibration."""
        job, run = self._bench.job_now(), self.run
        if run is None:
            return False
        outcome = await self._bench.calibrate(job, run.folder, "--trust")  # the bench's own readings need no box
        self.error = "" if outcome.done else outcome.error
        return outcome.done

    async def fit_drift(self) -> bool:
        """Fit the drift over the temperatures of the run; return whether there is a calibration."""
        job, run = self._bench.job_now(), self.run
        if run is None:
            return False
        outcome = await self._bench.fit_drift(job, run.folder, "--trust")
        self.error = "" if outcome.done else outcome.error
        return outcome.done

    async def forecast(self, form: ProtocolForm) -> Forecast | str:
        """Return what a protocol takes, or what is wrong with it."""
        asked = form.toml(), self.addresses["rig"].strip() or "galil:"
        if asked not in self._forecasts:
            try:
                self._forecasts = {asked: await asyncio.to_thread(form.check, asked[1])}
            except UndriftError as error:
                self._forecasts = {asked: str(error)}
        return self._forecasts.get(asked, "")

    def close(self) -> None:
        """Bring the table to rest and end what the bench started; the bench ends."""
        if self.run is not None:
            self.run.close()
        self.emulated.close()

    async def _doing(self, what: str, work: Callable[[], Awaitable[None]]) -> None:
        if self.busy:
            return
        self.busy, self.error = what, ""
        try:
            await work()
        except UndriftError as error:
            self.error = str(error)
        finally:
            self.busy = ""

    async def _use_emulated(self) -> None:
        self.emulated.words = ("--speed", self.speed)
        self.addresses |= await asyncio.to_thread(self.emulated.start)
        self.filled += 1

    async def _start(self, form: ProtocolForm) -> None:
        bench, held = self._bench, {name: value.strip() for name, value in self.addresses.items()}
        for name, what in (("rig", "table"), ("device", "device")):
            if not held[name]:
                raise InputError(f"rate table: wanted the address of the {what}, got none; fill it in")
        if form.temperatures_c.strip() and not held["chamber"]:
            raise InputError("rate table: wanted the address of a chamber for the temperatures, got none; fill it in")
        await asyncio.to_thread(form.check, held["rig"])
        if self.run is not None and self.run.may_move:
            raise InputError("rate table: wanted a table at rest, got a run that goes on; wait for it, or pause it")
        if bench.source is not None and bench.source.address == held["device"]:
            await bench.disconnect()  # a serial port has one owner
        chamber = held["chamber"] if form.temperatures_c.strip() else ""
        order = RunOrder(
            rig=held["rig"],
            device=held["device"],
            chamber=chamber,
            operator=held["operator"],
            serial=self.serial.strip(),
            host=bench.settings.host,
        )
        job = bench.job
        if job is None or any(job.folder.iterdir()):
            job = bench.new_job(self.serial.strip() or "rate-table")
        await self._launch(begin_run(job.session, form.toml(), order))

    async def _launch(self, run: RigRun) -> None:
        self._bench.rig_run = run
        try:
            await asyncio.to_thread(run.launch)
        finally:
            run.follow()

    def _take_up(self) -> None:
        """Find the run that an earlier bench left."""
        from undrift.web.bench import Job

        run = find_run(self._bench.folder / "jobs")
        if run is not None:
            self._bench.rig_run, self._bench.job = run, Job(folder=run.folder.parent, serial=run.order.serial)
            self.addresses = {name: getattr(run.order, name) for name in ADDRESSES}
            if run.view.state in GOING:
                run.follow()
