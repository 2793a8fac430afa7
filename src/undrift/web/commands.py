"""Commands of the bench. Each runs in a child process, so that a long fit or a crash never affects the server.

``python -m undrift COMMAND ... --json`` writes an envelope to stdout and its progress to stderr. The pages therefore
show the same text as the command line. Remarks are a list of failures, warnings and notes. Texts never contain the
internal folders of the bench.
"""

import asyncio
import contextlib
import json
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

from undrift.commands.bench.library import Remark

LONGEST_S = 3600.0
LARGEST_LINE = 1 << 26  # bytes: an envelope is one line
LEVELS = ("fail", "warn", "info")
FOLDERS = re.compile(r"\b(?:(?:uploads|jobs)/[^/\"]+/(?:session/(?:pieces/)?)?|registry/)")  # of the files of a bench


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandOutcome:
    """The answer of a command."""

    code: int  # 0 done, 1 done with a bad verdict, 2 refused, 3 a rig or device failed
    answer: dict[str, Any] = field(default_factory=dict)  # its envelope
    error: str = ""  # a line with the error and the remedy

    @property
    def done(self) -> bool:
        """Return whether there is a result."""
        return self.code in (0, 1)


def remarks_of(answer: Mapping[str, Any]) -> list[Remark]:
    """Return the remarks of a command, failures and warnings first: of the whole and of its parts (recordings, trials),
    each once.
    """
    once: dict[str, Remark] = {}
    for full_text, remark in sorted(_remarks(answer), key=lambda one: LEVELS.index(one[1].level)):
        once.setdefault(full_text, remark)
    return list(once.values())


def _remarks(answer: Mapping[str, Any]) -> Iterator[tuple[str, Remark]]:
    """Yield each remark with its whole text."""
    lists = {key: value for key, value in answer.items() if isinstance(value, list)}
    for finding in lists.get("findings", ()):
        action, text = str(finding.get("action") or ""), str(finding["text"])
        yield f"{text} {action}".rstrip(), Remark(level=finding.get("level") or "info", text=text, action=action)
    for key in ("notes", "problems"):
        for full_text in lists.get(key, ()):
            yield str(full_text), Remark(level="info", text=str(full_text))
    for section in (
        *(section for key, value in lists.items() if key != "findings" for section in value),
        answer.get("verdict"),
    ):
        if isinstance(section, Mapping):
            yield from _remarks(section)


def without_folders(text: str, folder: Path) -> str:
    """Return a text in which the paths of the bench's files are replaced by their names."""
    return FOLDERS.sub("", text.replace(f"{folder}/", ""))


async def run_command(
    argv: Sequence[object], folder: Path, heard: Callable[[str], None], *, longest_s: float = LONGEST_S
) -> CommandOutcome:
    """Run a command in a folder. Each line of its stderr is passed on immediately."""
    child = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "undrift", *map(str, argv), "--json"),
        cwd=folder, limit=LARGEST_LINE, stdin=asyncio.subprocess.DEVNULL, stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
    )  # fmt: skip
    answer, words_of_it = cast(tuple[asyncio.StreamReader, asyncio.StreamReader], (child.stdout, child.stderr))
    lines: list[str] = []

    async def listen() -> None:
        async for line in words_of_it:
            lines.append(without_folders(line.decode("utf-8", "replace").strip(), folder))
            heard(lines[-1])

    try:
        async with asyncio.timeout(longest_s):
            text, _ = await asyncio.gather(answer.read(), listen())
            code = await child.wait()
    except TimeoutError:
        return CommandOutcome(
            code=2, error=f"{argv[0]}: the command did not finish within {longest_s:g} s. Use a shorter recording."
        )
    finally:
        if child.returncode is None:
            with contextlib.suppress(ProcessLookupError):
                child.kill()
            await child.wait()
    return outcome_of(code, without_folders(text.decode("utf-8", "replace"), folder), lines)


def outcome_of(code: int, text: str, lines: Sequence[str]) -> CommandOutcome:
    """Return the answer of a command from its exit code, its stdout and the lines of its stderr."""
    try:
        answer = json.loads(text) if text.strip() else {}
    except ValueError:
        answer = {}
    last = next((line for line in reversed(lines) if line), "")
    if code in (0, 1) and answer:
        return CommandOutcome(code=code, answer=answer)
    error = (answer.get("error") or {}).get("text") or last.removeprefix("undrift: ")
    if code in (0, 1) or code < 0:
        error = (
            f"the command ended without an answer (exit {code}). Run it again, and report the problem if it persists."
        )
        code = 2
    return CommandOutcome(code=code, answer=answer, error=error)
