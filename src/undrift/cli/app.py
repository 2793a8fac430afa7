"""The program ``undrift``: its commands and the handling of errors.

Exit codes are 0 (done), 1 (done, but the verdict is bad), 2 (wrong input or call, with a line on stderr) and 3 (a rig or device
failed). An unexpected error also prints one line and returns code 2. To see its traceback, set UNDRIFT_TRACEBACK=1 in the
environment. ``undrift --help`` is written without cyclopts and rich, and a command is imported only when it is called.
"""

import os
import signal
import sys
from collections.abc import Sequence
from contextlib import suppress
from contextvars import copy_context

from undrift import __version__
from undrift.cli import examples
from undrift.errors import InputError, RigError, UndriftError

ABOUT = "Calibrate a wearable inertial sensor, compensate its drift, and measure the improvement in degrees."
COMMANDS = {  # one line of 80 columns each
    "record": "Record a device to a file, or be guided through its calibration.",
    "info": "Describe a recording, session, calibration, reference or device.",
    "calibrate": "Calibrate from a session, with verdict and findings.",
    "drift": "Tuning tables over temperature, from soaks, ramps or a warm-up.",
    "correct": "Turn raw recordings into rad/s and m/s2.",
    "orient": "Orientation by strapdown or a filter: inclination, pitch.",
    "mount": "Determine how a device is worn: device axes to body axes.",
    "validate": "Compare with an optical reference, in degrees.",
    "twin": "Fit the device model to a real device, and predict other motions.",
    "export": "Write calibrations for firmware and other programs.",
    "certificate": "A calibration certificate with uncertainty budget, to print on A4.",
    "noise": "Angle random walk, bias instability, rate random walk.",
    "simulate": "Simulated sensor output for a task, poses or markers.",
    "rig": "Run a protocol on a rate table, check the table, stop it.",
    "study": "Find the calibration protocol that is enough for a task.",
    "bench": "The guided bench in a browser: from six faces to a certificate.",
    "sample": "Recordings that come with undrift, to try it with.",
    "demo": "The whole flow on a small simulated session, as a report page.",
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and exit with its code."""
    _stop_on_signals()
    code = run(sys.argv[1:] if arguments is None else arguments)
    try:
        if not sys.stdout.closed:
            sys.stdout.flush()
    except OSError:  # already reported: with text still in the buffer, Python would end with code 120
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    sys.exit(code)


def _stop_on_signals() -> None:
    """Handle SIGTERM and SIGHUP like Ctrl-C, with all clean-up. Ignored signals stay ignored (nohup)."""
    numbers = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]

    def stop(number: int, _: object) -> None:
        for other in numbers:  # one signal is enough: more would disturb the clean-up, the message or the exit code
            signal.signal(other, signal.SIG_IGN)
        raise KeyboardInterrupt(f"stopped by {signal.Signals(number).name}")

    with suppress(ValueError):  # not the main thread
        for number in numbers:
            if signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):
                signal.signal(number, stop)


def run(arguments: Sequence[str]) -> int:
    """Run the command line and return its exit code: 0, 1, 2 or 3, or 130 if it was interrupted."""
    return copy_context().run(_run, arguments)  # the arguments of this call are visible only in this context


def _run(arguments: Sequence[str]) -> int:
    try:
        if list(arguments) in ([], ["--help"], ["-h"]):
            sys.stdout.write(_help())
            return 0
        if list(arguments) in (["--version"], ["-V"]):
            sys.stdout.write(__version__ + "\n")
            return 0
        from undrift.base.spoken import CALLED

        _check_names(arguments)
        CALLED.set(tuple(arguments))
        from undrift.cli.call import call

        code = call(arguments)
        sys.stdout.flush()  # a full disk is reported here, not when Python ends
        return code
    except KeyboardInterrupt as error:
        return _refuse(arguments, error, "stopped. No file was left incomplete.", code=130)
    except UndriftError as error:
        return _refuse(arguments, error, str(error), code=3 if isinstance(error, RigError) else 2)
    except BrokenPipeError:  # the reader of stdout, such as head, has stopped reading
        with suppress(OSError):
            sys.stdout.close()
        return 0
    except OSError as error:
        from undrift.files import is_full  # imported here for a quick --help

        text = f"{error.filename or 'file'}: {error.strerror or error}. "
        text += "Free disk space and run it again." if is_full(error) else "Check the path and its permissions."
        return _refuse(arguments, error, text, code=2)
    except Exception as error:
        if os.environ.get("UNDRIFT_TRACEBACK") == "1":
            raise
        text = f"internal error: {type(error).__name__}: {error}. Please report it with the command"
        return _refuse(arguments, error, f"{text} (UNDRIFT_TRACEBACK=1 shows where)", code=2)


def _check_names(arguments: Sequence[str]) -> None:
    """Raise for a name that is not UTF-8, because no page, JSON file or calibration could contain it."""
    for word in arguments:
        printable = word.encode("utf-8", "backslashreplace").decode()
        if "\\udc" in printable and "\\udc" not in word:
            raise InputError(f"{printable}: the name is not valid UTF-8. Rename the file or folder.")


def _refuse(arguments: Sequence[str], error: BaseException, text: str, *, code: int) -> int:
    """Write an error to stderr as one line, and with --json also as an object to stdout. Return the exit code."""
    from undrift.base.spoken import spoken

    text = spoken(" ".join(text.split()))
    if "--json" in arguments:
        from undrift.cli.call import write_json

        names = [word for word in arguments[:2] if word.isidentifier()]
        command = "_".join(names if names[:1] == ["rig"] else names[:1])
        told = {"kind": type(error).__name__, "text": text}
        with suppress(OSError):  # the output is closed, or its disk is full
            write_json({"kind": f"undrift.{command}", "version": __version__, "error": told})
    sys.stderr.write(f"undrift: {text}\n")
    return code


def _help() -> str:
    rows = [*COMMANDS.items(), ("--version", "Show the version (also -V).")]
    lines = "\n".join(f"  {name:12}{text}" for name, text in rows)
    end = "undrift COMMAND --help explains its options.\nundrift --install-completion completes them in your shell."
    return f"Usage: undrift COMMAND\n\n{ABOUT}\n\n{lines}\n\n{end}\n\n{examples('')}\n"
