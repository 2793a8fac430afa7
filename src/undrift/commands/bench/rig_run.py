"""A run on the rate table as the bench sees it: started in a process of its own, followed, paused, continued, stopped.

The run is the command ``undrift rig run`` itself, with ``--progress``; it lives in a session of its own beside a supervisor
(supervisor.py), and neither a closed browser nor the end of the bench's own process touches it. What the bench knows of it stands
beside the folder of the run, so that the next bench finds it::

    JOB/session/              the folder of the run
    JOB/run/run.json          the order: addresses and options
    JOB/run/protocol.toml     what was asked for
    JOB/run/progress.jsonl    what the command and the supervisor wrote
    JOB/run/standby.json      port and key of the supervisor
    JOB/run/lock              locked while either of them lives
    JOB/run/answer.json, run.log   stdout and stderr of the command

Pause is Ctrl-C of the command: the dwell that is going is given up, the table comes to rest with its motor off, the folder stays.
Continue is the command with --resume.
"""

import contextlib
import http.client
import json
import math
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Literal, TypeAlias
from urllib.parse import urlencode

from undrift.base.options import asked, stated
from undrift.errors import InputError, RigFault
from undrift.files import take_lock, write_whole
from undrift.model import AXES
from undrift.record import Record, joined
from undrift.rig.chamber import LOOKS, SoakSettings, Steadiness, mean_temp
from undrift.rig.folder import JOURNAL
from undrift.rig.run import ProgressReader
from undrift.rig.watch import Standby, stop_now
from undrift.units import RADIAN_PER_DEGREE

if TYPE_CHECKING:
    from undrift.sim.rig.hand_held import HandHeld

SESSION, PLACE = "session", "run"
ORDER, PROTOCOL, PROGRESS, STANDBY, LOCK = "run.json", "protocol.toml", "progress.jsonl", "standby.json", "lock"
ANSWER, LOG = "answer.json", "run.log"
START_S = 30.0  # that a supervisor is waited for
ANSWER_S = 2.0  # that it may take to answer
FOLLOW_S = 0.1  # between two looks at what is new
LEAST_JUDGED = 5.0 * RADIAN_PER_DEGREE  # rad/s of a turn: below it one reading may be noise [assumed]
CURVE = 2000  # points that are kept of a temperature curve

Process: TypeAlias = "subprocess.Popen[bytes]"
State = Literal["starting", "running", "pausing", "paused", "stopping", "stopped", "failed", "done"]
GOING: tuple[State, ...] = ("starting", "running", "pausing", "stopping")


@dataclass(slots=True, kw_only=True)
class RunOrder:
    """What a run is started with: addresses, as the command takes them, "" for none; and the serial number of the device."""

    rig: str = asked("Address of the table", hint="galil:tcp://host:23?encoder_lines=10000, grbl:serial:///dev/ttyUSB0")
    device: str = asked("Address of the device", hint="serial:///dev/ttyUSB0?baud=115200&..., tcp://host:port?...")
    chamber: str = asked("Address of the chamber", hint="tcp://host:port, manual:")
    operator: str = ""  # of an emulated operator; a person is asked on the page where there is none
    serial: str = asked("Serial number of the device", hint="empty: as the device states it")
    options: tuple[str, ...] = ()  # more words of the command
    host: str = "127.0.0.1"  # where the supervisor listens

    def named(self) -> dict[str, str]:
        """Return the options of the command by their names."""
        return {name: getattr(self, name) for name in ("rig", "device", "chamber", "operator", "serial")}


def command_of(order: RunOrder, folder: Path) -> list[str]:
    """Return the words of the command; it goes on where the folder has a journal."""
    place = folder.parent / PLACE
    words = [sys.executable, "-m", "undrift", "rig", "run", str(place / PROTOCOL), "-o", str(folder)]
    words += ["--yes", "--json", "--progress", str(place / PROGRESS)]
    return [*words, *map(str, stated(**order.named())), *order.options, *["--resume"] * (folder / JOURNAL).exists()]


def read_order(folder: Path) -> RunOrder:
    """Return what a run was started with."""
    held = json.loads((folder.parent / PLACE / ORDER).read_text())
    return RunOrder(**{**held, "options": tuple(held["options"])})


@dataclass(slots=True, kw_only=True)
class Point:
    """A temperature as it was."""

    time: float  # s since 1970
    air_c: float | None
    device_c: float | None
    soaking: bool


def add_point(curve: list[Point], point: Point) -> None:
    """Add a point to a curve, which is thinned where it becomes long."""
    curve.append(point)
    if len(curve) > CURVE:
        del curve[1::2]


class TempCourse:
    """Temperatures of a device that warms up: whether they are steady is judged as in a soak of a run."""

    def __init__(self) -> None:
        self.curve: list[Point] = []
        self.slope_c_per_min: float | None = None  # None before a window is full
        self.stable_since: float | None = None  # s since 1970
        self.limit, self._every_s = SoakSettings().slope_c_per_min, SoakSettings().window_s / LOOKS
        self._steadiness = Steadiness(SoakSettings())
        self._held: list[Record] = []

    def take(self, records: Iterable[Record]) -> None:
        """Take readings; the mean of each while is a point."""
        self._held += records
        if not self._held or self._held[-1].time[-1] - self._held[0].time[0] < self._every_s:
            return
        record, self._held = joined(self._held), []
        if (temp_c := mean_temp(record)) is None:
            return
        self._steadiness.add(0.5 * float(record.time[0] + record.time[-1]), temp_c)
        slope = self._steadiness.slope_c_per_min()
        self.slope_c_per_min = slope if math.isfinite(slope) else None
        steady = slope < self.limit
        self.stable_since = (self.stable_since or time.time()) if steady else None
        add_point(self.curve, Point(time=time.time(), air_c=None, device_c=temp_c, soaking=not steady))


@dataclass(slots=True)
class View:
    """What is known of a run; pages show it."""

    state: State = "starting"
    phase: str = ""
    number: int = 0  # of the step, from 0
    steps: list[dict[str, Any]] = field(default_factory=list)  # kind, text, seconds, temp_c, up
    done: set[int] = field(default_factory=set)  # dwells on the disk
    left_s: float = 0.0  # forecast, table s
    speed: float = 1.0  # table seconds in one of ours
    live: str = ""
    question: tuple[int, str] | None = None  # of the run to a person
    standby: str = ""  # why there is no standby connection
    error: str = ""
    confirmed: bool | None = None  # whether a stop was
    slope_c_per_min: float | None = None
    stable_since: float | None = None  # s since 1970, of the set-point that was reached last
    curve: list[Point] = field(default_factory=list)
    # s since 1970, commanded deg/s, read about that axis
    rates: list[tuple[float, float, float]] = field(default_factory=list)
    whose: str = "the device"  # rates were read: its serial number
    wrong: str = ""  # what the readings of a turn show that was not commanded
    pid: int | None = None  # of the command
    _rest: list[float] = field(default_factory=list)  # gyroscopes at the last rest

    @property
    def step(self) -> str:
        """Return in words what is done now."""
        return str(self.steps[self.number]["text"]) if self.number < len(self.steps) else ""

    @property
    def dwells(self) -> int:
        """Return how many dwells there are."""
        return sum(step["kind"] == "dwell" for step in self.steps)

    @property
    def minutes_left(self) -> float:
        """Return the forecast in minutes of ours."""
        return max(self.left_s, 0.0) / self.speed / 60.0

    def set_points(self) -> list[tuple[float, int, int]]:
        """Return the temperatures with how many of their dwells are on the disk, and of how many."""
        found: dict[float, list[int]] = {}
        for number, step in enumerate(self.steps):
            if step["kind"] == "dwell" and step["temp_c"] is not None:
                found.setdefault(step["temp_c"], []).append(number)
        return [(temp_c, len(self.done & set(numbers)), len(numbers)) for temp_c, numbers in sorted(found.items())]

    @property
    def pose(self) -> tuple[str, str]:
        """Return the side of the device that is up, and the sense of the turn about it; "" for neither."""
        step = self.steps[self.number] if self.number < len(self.steps) else {}
        rate = (step.get("turn_rate") or 0.0) * (1.0 if (up := str(step.get("up") or "")).startswith("+") else -1.0)
        return up, "+" if rate > 0.0 else "-" if rate < 0.0 else ""

    def trace(self) -> list[object]:
        """Return a drawing: commanded and measured turn rates over minutes, the latter in units of the former by its own slope."""
        points = self.rates[:: max(1, len(self.rates) // 300)]
        squares = sum(rate * rate for _, rate, _ in points)
        gain = sum(rate * reading for _, rate, reading in points) / squares if squares else 0.0
        over = [((time - points[0][0]) * self.speed / 60.0, rate, reading) for time, rate, reading in points]
        measured = ["measured", "none", [[at, reading / gain] for at, _, reading in over if gain]]
        commanded = ["commanded", "6 5", [[at, rate] for at, rate, _ in over]]
        return [f"Turn rate of {self.whose}, scaled", "deg/s", "min", [measured, commanded]]

    def _measure(self, now: float, step: dict[str, Any], live: str) -> None:
        """Compare what the gyroscopes read, less the last rest, with the turn that is commanded."""
        readings, _, whose = live.partition(" of ")
        words = readings.split()
        read = dict(zip(words[::2], words[1::2], strict=False))
        if not {"gyro_x", "gyro_y", "gyro_z"} <= read.keys():
            return
        gyro = [float(read[f"gyro_{axis}"]) for axis in "xyz"]
        if not (rate := step.get("turn_rate")):
            self._rest = gyro
            return
        shown = [reading - rest for reading, rest in zip(gyro, self._rest or [0.0] * 3, strict=True)]
        if step["axis"] not in AXES:  # a skew mounting turns all three
            return
        about, largest = AXES.index(step["axis"]), max(range(3), key=lambda k: abs(shown[k]))
        self.wrong = ""
        if abs(rate) >= LEAST_JUDGED and abs(shown[largest]) > 2.0 * abs(shown[about]):
            self.wrong = f"The table turns about {step['axis']}, but {AXES[largest]} reads most: check the mounting."
        elif abs(rate) >= LEAST_JUDGED and shown[about] * rate < 0.0:
            self.wrong = f"The device reads the turn about {step['axis']} in the opposite sense: check the mounting."
        self.whose = whose or self.whose
        self.rates.append((now, rate / RADIAN_PER_DEGREE, shown[about]))
        if len(self.rates) > CURVE:
            del self.rates[1::2]

    def take(self, entry: dict[str, Any]) -> None:
        """Take a line of the progress file."""
        event = entry.get("event")
        if event == "started":
            self.state, self.pid, self.standby = "running", entry["pid"], entry["standby"]
            self.question, self.error, self.confirmed, self.phase = None, "", None, "starting"
        elif event == "plan":
            self.steps, self.done, self.speed = entry["steps"], set(entry["done"]), entry["speed"]
        elif event == "at":
            self._at(entry)
        elif event == "question":
            self.question = (entry["number"], entry["text"])
        elif event == "answer":
            self.question = None
        elif event == "pausing" and self.state == "running":
            self.state = "pausing"
        elif event == "stopping":
            self.state = "stopping"
        elif event == "stopped":
            self.confirmed = entry["confirmed"]
        elif event == "ended":
            self._ended(int(entry["code"]))

    def _at(self, entry: dict[str, Any]) -> None:
        before, self.phase, self.number = self.phase, entry["phase"], entry["number"]
        self.left_s, self.live, self.slope_c_per_min = entry["left_s"], entry["live"], entry["slope_c_per_min"]
        soaking = self.phase in ("soaking", "setting")
        if self.phase in ("dwelling", "resting") and self.live and self.number < len(self.steps):
            self._measure(entry["time"], self.steps[self.number], self.live)
        if before == "soaking" and not soaking:
            self.stable_since = entry["time"]
        elif soaking:
            self.stable_since = None
        if entry["air_c"] is not None or entry["device_c"] is not None:
            point = Point(time=entry["time"], air_c=entry["air_c"], device_c=entry["device_c"], soaking=soaking)
            add_point(self.curve, point)

    def _ended(self, code: int) -> None:
        self.question, self.live, self.phase = None, "", ""
        if code == 0:
            self.state, self.left_s = "done", 0.0
        elif self.state in ("stopping", "stopped"):
            self.state = "stopped"
        else:
            self.state = "paused" if self.state == "pausing" else "failed"


class RigRun:
    """A run in a folder; ``refresh`` reads what is new. Its methods wait for files and processes: call them in a thread."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.place = folder, folder.parent / PLACE
        self.order = read_order(folder)
        self.view = View()
        self._reader = ProgressReader(self.place / PROGRESS)
        self._journal = ProgressReader(folder / JOURNAL)
        self._supervisor: Process | None = None
        self._standing: dict[str, Any] = {}  # port, key and pid of the supervisor
        self._reading = threading.Lock()

    @property
    def may_move(self) -> bool:
        """Return whether the table may move."""
        return self.view.state in GOING

    @property
    def stop_url(self) -> str:
        """Return where a stop is posted to, past the bench: ":port/stop?key=..."; "" where nobody listens."""
        held = self._standing
        return f":{held['port']}/stop?key={held['key']}" if held and self.may_move else ""

    def follow(self) -> None:
        """Refresh in a thread until the run has ended."""

        def look() -> None:
            while self.refresh().state in GOING:
                time.sleep(FOLLOW_S)

        threading.Thread(target=look, name="run", daemon=True).start()

    def launch(self) -> None:
        """Start the run, or resume it; returns when the supervisor stands by."""
        last = time.monotonic() + START_S
        while self.is_going() and self.view.state not in GOING and time.monotonic() < last:
            time.sleep(0.02)  # the supervisor of the part before ends in a moment
        if self.is_going():
            raise InputError("rig run: wanted a run at rest, got one that goes on; wait for it, or pause it")
        if self._supervisor is not None:
            self._supervisor.wait(START_S)
        (self.place / STANDBY).unlink(missing_ok=True)
        self._standing = {}
        self.view = replace(self.view, state="starting", error="", confirmed=None)
        with (self.place / LOG).open("ab") as log:
            self._supervisor = apart("undrift.commands.bench.supervisor", str(self.folder), out=log, errors=log)
        last = time.monotonic() + START_S
        while not (self.place / STANDBY).exists():
            if self._supervisor.poll() is not None or time.monotonic() > last:
                self.view.state, self.view.error = "failed", self._last_line()
                raise RigFault(f"rig run: wanted it started, got '{self.view.error}'; look at the addresses")
            time.sleep(0.02)
        self.refresh()

    def refresh(self) -> View:
        """Read what is new, and return what is known."""
        with self._reading:
            if self._supervisor is not None:
                self._supervisor.poll()  # no zombie
            going, view = self.is_going(), self.view
            with contextlib.suppress(OSError, ValueError):
                self._standing = json.loads((self.place / STANDBY).read_text())
            self._reader.news(view.take)
            self._journal.news(self._take_piece)
            if not going and view.state in GOING and (self.place / PROGRESS).exists():
                view.state = "failed"  # neither command nor supervisor is left, and no word of the end
                view.error = "the run was killed; its guard stops the table; look at the table, then go on"
            elif view.state == "failed" and not view.error:
                view.error = self._last_line()
                with contextlib.suppress(OSError, ValueError):  # why the command ended, in its own line
                    view.error = str(json.loads((self.place / ANSWER).read_text())["error"]["text"])
            return view

    def is_going(self) -> bool:
        """Return whether the command or its supervisor lives."""
        return is_locked(self.place / LOCK)

    def answer(self, number: int, text: str = "") -> None:
        """Answer a question of the run."""
        self._ask("/answer", number=number, text=text)

    def pause(self) -> None:
        """End the dwell that is going; the table comes to rest with its motor off."""
        if self._ask("/pause") or not self.is_going() or self.view.pid is None:
            return
        for number in (signal.SIGTERM, signal.SIGCONT):  # the supervisor is gone
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.view.pid, number)
        self.view.state = "pausing"

    def emergency_stop(self) -> None:
        """Stop the table at once: through the supervisor, or past it where it does not answer."""
        if self._ask("/stop"):
            return
        self.refresh()
        if self._ask("/stop"):  # of the part that another bench has started
            return
        going, standby = self.is_going(), Standby(self.order.rig)
        try:
            confirmed = stop_now(standby, lambda: not self.is_going(), self.view.pid if going else None)
        finally:
            standby.close()
        if going:
            self.view.state, self.view.confirmed = "stopped", confirmed

    def close(self, wait_s: float = 20.0) -> None:
        """Pause a run that goes on, and wait until the table is at rest: the bench ends."""
        if not self.is_going():
            return
        self.pause()
        last = time.monotonic() + wait_s
        while self.is_going() and time.monotonic() < last:
            time.sleep(0.05)

    def _ask(self, path: str, **words: object) -> bool:
        """Post to the supervisor; return whether it obeyed."""
        held = self._standing
        if not held:
            return False
        link = http.client.HTTPConnection(self.order.host, held["port"], timeout=ANSWER_S)
        try:
            link.request("POST", f"{path}?{urlencode({'key': held['key'], **words})}")
            return link.getresponse().status == 200
        except (OSError, http.client.HTTPException):
            return False
        finally:
            link.close()

    def _take_piece(self, line: dict[str, Any]) -> None:
        entry = line.get("entry")
        if isinstance(entry, dict) and entry.get("entry") == "dwell":
            self.view.done.add(entry["step"])
        elif isinstance(entry, dict) and entry.get("entry") == "withdrawn":
            self.view.done.discard(entry["step"])

    def _last_line(self) -> str:
        with contextlib.suppress(OSError):
            lines = [line for line in (self.place / LOG).read_text(errors="replace").splitlines() if line.strip()]
            return lines[-1].removeprefix("undrift: ") if lines else ""
        return ""


def apart(module: str, *words: str, out: IO[bytes], errors: IO[bytes] | int = subprocess.DEVNULL) -> Process:
    """Start a module of Python in a session of its own, which the end of this process does not touch."""
    command, none = [sys.executable, "-m", module, *words], subprocess.DEVNULL
    return subprocess.Popen(command, stdin=none, stdout=out, stderr=errors, start_new_session=True)


def is_locked(path: Path) -> bool:
    """Return whether another process holds the lock of a file."""
    import fcntl

    try:
        with path.open("rb") as handle:
            fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except FileNotFoundError:
        return False
    except OSError:
        return True
    return False


def begin_run(folder: Path, protocol: str, order: RunOrder) -> RigRun:
    """Write the order of a run into its folder; ``launch`` starts it."""
    place = folder.parent / PLACE
    if (folder / JOURNAL).exists():
        raise InputError(f"{folder}: wanted a new folder, got one with a run in it; resume it, or begin another")
    place.mkdir(parents=True, exist_ok=True)
    write_whole(place / PROTOCOL, protocol)
    write_whole(place / ORDER, json.dumps(asdict(order)) + "\n")
    return RigRun(folder)


def find_run(root: Path) -> RigRun | None:
    """Return the run in a folder of jobs that goes on; without one the newest that did not come to its end."""
    orders = sorted(root.glob(f"*/{PLACE}/{ORDER}"), key=lambda path: path.stat().st_mtime, reverse=True)
    runs = list[RigRun]()
    for path in orders:
        with contextlib.suppress(OSError, ValueError, TypeError, KeyError):
            runs.append(RigRun(path.parents[1] / SESSION))
    run = next((one for one in runs if one.is_going()), runs[0] if runs else None)
    over = run is not None and run.refresh().state in ("done", "starting") and not run.is_going()
    return None if over else run


# ---- What is emulated where there is none: a table, in another process that stays while a run needs it; a device to practise with.


class EmulatedTable:
    """An emulated table, chamber, device and operator on loopback ports."""

    def __init__(self, folder: Path, words: Sequence[str] = ()) -> None:
        self._place, self.addresses = folder / "emulator.json", dict[str, str]()
        self._process: Process | None = None
        self.words = tuple(words)

    def start(self) -> dict[str, str]:
        """Start it, or find the one that an earlier bench left; return its addresses."""
        started, last = self._place.with_suffix(".words"), time.monotonic() + START_S
        pid, _, words = started.read_text().partition(" ") if started.is_file() else ("", "", "")
        if self.is_there() and pid.isdigit() and words != " ".join(self.words):
            os.kill(int(pid), signal.SIGTERM)  # it has another speed
            while self.is_there() and time.monotonic() < last:
                time.sleep(0.05)
        if not self.is_there():
            with self._place.open("wb") as out:
                take_lock(out.fileno())  # its process inherits the lock with its stdout
                self._process = apart("undrift", "rig", "emulate", "--json", "--idle-s", "60", *self.words, out=out)
            write_whole(started, f"{self._process.pid} {' '.join(self.words)}")
        while time.monotonic() < last and self.is_there():
            with contextlib.suppress(ValueError, OSError):
                held = json.loads(self._place.read_text())
                self.addresses = {name: held[name] for name in ("rig", "device", "chamber", "operator")}
                return self.addresses
            time.sleep(0.05)
        raise RigFault("emulated table: wanted it started, got none; run undrift rig emulate to see why")

    def is_there(self) -> bool:
        """Return whether it runs."""
        if self._process is not None:
            self._process.poll()
        return is_locked(self._place)

    def close(self) -> None:
        """End the one that this bench started."""
        if self._process is not None:
            self._process.terminate()
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(10.0)


class PracticeDevice:
    """The emulated device in an operator's hands that a bench starts where no other is there."""

    def __init__(self) -> None:
        self.device: HandHeld | None = None

    def start(self, seed: int | None, speed: float, gravity_m_s2: float) -> str:
        """Start it, unless it goes on; return its address."""
        from undrift.sim.rig.hand_held import start_hand_held

        if self.device is None:
            self.device = start_hand_held(seed=seed, speed=speed, gravity_m_s2=gravity_m_s2)
        return self.device.address

    def close(self) -> None:
        """End it; harmless when called again."""
        if self.device is not None:
            self.device.close()
        self.device = None
