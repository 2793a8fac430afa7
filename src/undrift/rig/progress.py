"""Progress of a run as JSON lines in a file (``rig run --progress FILE``), for a program that shows it and answers its questions.

    {"event": "plan", "pid": 12, "speed": 1.0, "steps": [{"kind": "mount", "text": "mount +x up", ...}, ...], "done": []}
    {"event": "at", "phase": "dwelling", "number": 3, "left_s": 120.0, "live": "...", "air_c": null, "device_c": null, ...}
    {"event": "question", "number": 1, "text": "Motor off. Mount the device with +x up ..."}

Each has ``time``, s since 1970. A question is answered by its number and the answer in one line on the standard input ("1 ",
"1 q"); lines with another number are left out, so that a button that is pressed twice answers nothing that was not asked.
"""

import contextlib
import json
import os
import sys
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from undrift.rig.programme import Programme
from undrift.rig.run import Progress

EVERY_S = 0.5  # between two lines of one phase of a step


class ProgressFile:
    """Writes what a run reports; a file that cannot be written does not end the run."""

    def __init__(self, path: Path) -> None:
        self._path, self._questions = path, 0
        self._shown: tuple[str, int] | None = None
        self._at = 0.0

    def plan(self, programme: Programme, done: frozenset[int], speed: float) -> None:
        """Write what is going to be done."""
        steps = [
            {"kind": type(step).__name__.lower(), "text": str(step), "seconds": step.duration_s}
            | {name: getattr(step, name, None) for name in ("up", "temp_c", "slope_c_per_min")}
            for step in programme.steps
        ]
        self._write("plan", pid=os.getpid(), speed=speed, steps=steps, done=sorted(done))

    def __call__(self, progress: Progress) -> None:
        """Write where the run is: each phase of each step, and each half second within."""
        shown, now = (progress.phase, progress.number), time.monotonic()
        if shown != self._shown or now - self._at >= EVERY_S:
            self._shown, self._at = shown, now
            fields = asdict(progress)
            del fields["steps"], fields["step"]  # they stand in the plan
            self._write("at", **fields)

    def ask(self, line: str) -> str:
        """Write a question and wait for its answer on the standard input."""
        self._questions += 1
        self._write("question", number=self._questions, text=line.strip())
        for answer in iter(sys.stdin.readline, ""):
            number, _, text = answer.partition(" ")
            if number.strip() == str(self._questions):
                self._write("answer", number=self._questions)
                return str(text)
        raise EOFError

    def _write(self, event: str, **fields: Any) -> None:
        with contextlib.suppress(OSError):
            append(self._path, event, **fields)


def append(path: Path, event: str, **fields: Any) -> None:
    """Append a line, whole."""
    line = json.dumps({"event": event, "time": time.time(), **fields}) + "\n"
    with path.open("ab", buffering=0) as file:
        file.write(line.encode())


class ProgressReader:
    """Reads such a file as it grows."""

    def __init__(self, path: Path) -> None:
        self._path, self._place = path, 0

    def news(self, take: Callable[[dict[str, Any]], None]) -> None:
        """Hand over what is new, line by line; half a line waits for its end, a damaged one is left out."""
        try:
            with self._path.open("rb") as file:
                file.seek(self._place)
                data = file.read()
        except OSError:
            return
        whole = data.rfind(b"\n") + 1
        self._place += whole
        for line in data[:whole].splitlines():
            with contextlib.suppress(ValueError):
                entry = json.loads(line)
                if isinstance(entry, dict):
                    take(entry)
