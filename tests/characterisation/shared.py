"""What calls share: the command line in process, a folder to write in, and what makes a session or a device."""

import atexit
import io
import json
import re
import shutil
import tempfile
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any

from characterisation.compare import flatten
from undrift.cli.app import run
from undrift.io.columns import ReadSettings
from undrift.io.formats import read_record
from undrift.record import Record

Result = dict[str, Any]
CALLS: dict[str, tuple[str, Callable[[], Result]]] = {}


def call(name: str, sentence: str, *fixed: object) -> Callable[[Callable[..., Result]], Callable[..., Result]]:
    """Register a call under a short name, with a sentence that says what it does, and the arguments of its function."""

    def register(function: Callable[..., Result]) -> Callable[..., Result]:
        assert name not in CALLS, name
        CALLS[name] = (sentence, lambda: function(*fixed))
        return function

    return register


def leaves_of(name: str) -> dict[str, Any]:
    """Make a call and return its leaves."""
    return flatten(CALLS[name][1]())


@cache
def folder() -> Path:
    """Return a folder of this process, which goes with it."""
    path = Path(tempfile.mkdtemp(prefix="characterisation-"))
    atexit.register(shutil.rmtree, path, ignore_errors=True)
    return path


def new(name: str) -> Path:
    """Return a path in the folder that nothing stands at."""
    path = folder() / name
    if path.is_dir():
        shutil.rmtree(path)
    path.unlink(missing_ok=True)
    return path


def undrift(*words: object) -> Result:
    """Return what a command says as JSON, with its exit code."""
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        code = run([*map(str, words), "--json"])
    if code > 1:
        raise AssertionError(f"undrift {' '.join(map(str, words))}: exit {code}: {err.getvalue()}")
    return {"exit": code, **json.loads(out.getvalue())}


def refused(*words: object) -> Result:
    """Return the exit code of a command that must be refused."""
    err = io.StringIO()
    with redirect_stdout(io.StringIO()), redirect_stderr(err):
        code = run([*map(str, words), "--json"])
    assert code > 1, "it was not refused"
    return {"exit": code, "lines": err.getvalue().count("\n")}


def text_file(name: str, text: str) -> Path:
    path = new(name)
    path.write_text(text)
    return path


def read_back(path: Path) -> Result:
    """Return the channels of a recording that was written."""
    return channels(read_record(path, settings=ReadSettings(gaps="keep")))


def channels(record: Record) -> Result:
    return {
        "time": record.time,
        "gyro": record.gyro,
        "accel": record.accel,
        "temp_c": record.temp_c,
        "gyro_unit": record.gyro_unit,
        "accel_unit": record.accel_unit,
    }


def numbers_in(text: str) -> list[float]:
    """Return the numbers of a text, line comments and block comments left out."""
    bare = re.sub(r"/\*.*?\*/|//[^\n]*|(?m:^\s*#(?!define)[^\n]*)", "", text, flags=re.S)
    number = r"(?<![\w.])([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)[fFuUlL]{0,3}(?![\w.])"
    return [float(word) for word in re.findall(number, bare)]


def c_arrays(text: str) -> Result:
    """Return the numbers of C by the name of their array, numbered where a name comes again, and those outside arrays."""
    found: Result = {}
    opened = re.compile(r"(\w+)(?:\[[^\]]*\])+\s*=\s*\{(.*?)\}\s*;", re.S)
    for name, body in opened.findall(text):
        again = sum(key.partition("#")[0] == name for key in found)
        found[f"{name}#{again + 1}" if again else name] = numbers_in(body)
    return {"arrays": found, "others": numbers_in(opened.sub("", text))}


def code_hash(text: str) -> str:
    """Return the hash of a text without its comments."""
    bare = re.sub(r"/\*.*?\*/|//[^\n]*", "", text, flags=re.S)
    kept = [line.rstrip() for line in bare.splitlines() if line.strip()]
    return sha256("\n".join(kept).encode()).hexdigest()
