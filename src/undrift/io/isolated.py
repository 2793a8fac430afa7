"""Run a library's parser in a separate process. If a damaged file crashes or blocks the parser, a single error is raised."""

import os
import pickle
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from undrift.base.workers import has_threads
from undrift.errors import FileFormatError, InputError
from undrift.files import bytes_in

LIMIT_S, SECOND_PER_MEGABYTE = 30.0, 1.0


def isolated(parse: Callable[..., Any], path: Path, *arguments: Any) -> Any:
    """Return ``parse(path, *arguments)`` for a module-level function. Its input errors are raised again here."""
    if not has_threads():  # nor processes
        return parse(path, *arguments)
    limit_s = LIMIT_S + SECOND_PER_MEGABYTE * bytes_in(path) / 1e6
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    with tempfile.TemporaryDirectory() as folder:
        call, result = Path(folder) / "call", Path(folder) / "result"
        call.write_bytes(pickle.dumps((parse, path, *arguments)))
        argv = [
            sys.executable,
            "-c",
            f"from {__name__} import answer; answer()",
            str(call),
            str(result),
            f"{limit_s:.0f}",
        ]
        try:
            done = subprocess.run(argv, env=environment, capture_output=True, timeout=limit_s, check=False)
        except subprocess.TimeoutExpired as error:
            raise FileFormatError(
                f"{path}: the parser did not finish in {limit_s:.0f} s. Copy the file again."
            ) from error
        if not result.exists():
            why = (done.stderr.decode(errors="replace").strip().splitlines() or [f"exit code {done.returncode}"])[-1]
            raise FileFormatError(f"{path}: the parser crashed ({why}). Copy the file again.")
        parsed = pickle.loads(result.read_bytes())
    if isinstance(parsed, InputError):
        raise parsed
    return parsed


def answer() -> None:
    """Perform the call stored in a file, and write the result or the input error to another file."""
    call, result = map(Path, sys.argv[1:3])
    if hasattr(signal, "alarm"):  # the parent may be killed before its time limit
        signal.alarm(int(sys.argv[3]) + 1)
    parse, *arguments = pickle.loads(call.read_bytes())
    try:
        parsed = parse(*arguments)
    except InputError as error:
        parsed = type(error)(str(error), **error.numbers)
    result.write_bytes(pickle.dumps(parsed))
