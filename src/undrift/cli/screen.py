"""The terminal during a command: progress with the time left, lines and questions, on stderr and stdin."""

import sys
import threading
import time
from types import TracebackType

from undrift.base.workers import has_threads
from undrift.report.terminal import console, say, wrap
from undrift.screen import Screen

INTERVAL_S = 8.0  # time between lines of progress if stderr is not a terminal, s


class Terminal(Screen):
    """A progress bar on a terminal, or otherwise a line every 8 s. Both show the remaining time."""

    def __init__(self, command: str) -> None:
        from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
        from rich.table import Column

        self._command, self._task, self._share, self._begun = command, "reading", 0.0, False
        columns = (
            TextColumn("{task.description}", markup=False, table_column=Column(overflow="fold")),  # wraps at spaces
            BarColumn(max(4, min(40, console(err=True).width - 60))),
            TextColumn("{task.percentage:>3.0f} %"),
            TimeRemainingColumn(),
        )
        self._interactive = sys.stderr.isatty()
        self._bar = Progress(*columns, console=console(err=True), transient=True, disable=not self._interactive)
        self._bar_task = self._bar.add_task(self._task, total=1.0)
        self._stop, self._start_s = threading.Event(), time.monotonic()
        self._reported_s = 0.0  # time of the last report of progress
        self._step: int | None = None
        self._lines = 1  # number of lines shown last, which the next lines overwrite

    def __enter__(self) -> "Terminal":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop.set()
        self._bar.stop()

    def progress(self, task: str, share: float) -> None:
        if not self._begun:  # keep the earlier content of the screen
            self._begun = True
            self._bar.start()
            if not self._interactive and has_threads():
                threading.Thread(target=self._report_periodically, daemon=True).start()
        *lines, self._task = task.split("\n")
        self._share, self._reported_s = share, time.monotonic() - self._start_s
        say(*(f"undrift {self._command}: {line}" for line in lines), err=True)
        self._bar.update(self._bar_task, description=self._task, completed=share)

    def say(self, *lines: str) -> None:
        say(*lines, err=True)

    def over(self, line: str, *, step: int | None = None, last: bool = False) -> None:
        if self._interactive:
            width = console(err=True).width - 1
            lines = [wrap(row, width, max_lines=1, placeholder=" …")[0] for row in line.split("\n")]
            above = f"\x1b[{self._lines - 1}A" if self._lines > 1 else ""
            sys.stderr.write(f"\r{above}\x1b[J" + "\n".join(lines) + "\n" * last)
            sys.stderr.flush()
            self._lines = 1 if last else len(lines)
        elif step not in (None, self._step):
            self._step = step
            sys.stderr.write(line.partition("\n\n")[0].replace("\n", ". ") + "\n")

    def ask(self, line: str) -> str:
        sys.stderr.write(line)
        sys.stderr.flush()
        if answer := sys.stdin.readline():
            return answer
        raise EOFError

    def _report_periodically(self) -> None:
        while not self._stop.wait(INTERVAL_S):
            elapsed_s, share, remaining = time.monotonic() - self._start_s, self._share, "time left not known yet"
            if share > 0.0:  # counted down from the last report of progress
                left_s = max(0.0, self._reported_s * (1.0 - share) / share - (elapsed_s - self._reported_s))
                remaining = f"about {left_s:.0f} s left ({100.0 * share:.0f} %)"
            sys.stderr.write(f"undrift {self._command}: {self._task}, {elapsed_s:.0f} s so far, {remaining}\n")
            sys.stderr.flush()
