"""``undrift``: the commands, and what becomes of errors.

Exit codes: 0 done; 1 done but the verdict is bad; 2 the input or the call is wrong (one line on stderr); 3 a rig or device
failed. An error that nobody foresaw is one line too, with code 2; UNDRIFT_TRACEBACK=1 in the environment shows where it
arose. A command is imported only when it is called, so that ``undrift --help`` answers at once.
"""

import os
import signal
import sys
from collections.abc import Sequence
from contextlib import suppress

from cyclopts import App, CycloptsError, Parameter, UnusedCliTokensError

from undrift import __version__
from undrift.errors import RigError, UndriftError

INTERRUPTED = 130
COMMANDS = {
    "info": "What a recording, session, calibration, reference or device holds.",
    "calibrate": "Fit what a session allows, and say what was not observable.",
    "drift": "Tuning tables over temperature, from soaks, ramps or a mere warm-up, with what is not observable.",
    "correct": "Turn raw recordings into rad/s and m/s2.",
    "orient": "Initial tilt and strapdown: orientation, inclination, sagittal pitch.",
    "validate": "Compare with an optical reference, in degrees.",
    "twin": "Fit the device model to a real device, and see how far it carries.",
    "export": "Write what firmware and other programs read, and say what they cannot carry.",
    "noise": "Angle random walk, bias instability, rate random walk, with confidence.",
    "simulate": "What a device would say to a motion: a preset or device.json, moved by poses or by a task.",
    "rig": "Run a protocol on a rate table, stop it from another shell, or emulate one; each takes --json.",
    "study": "Which calibration protocol is enough for a task: optimum, statistics, other subjects, the note's tables.",
    "demo": "The whole flow on a small simulated session, as a report page.",
}


app = App(
    name="undrift",
    help="Calibrate a wearable inertial sensor, compensate its drift, and prove what that is worth in degrees.",
    version=__version__,
    help_format="plaintext",
    result_action="return_value",
    suppress_keyboard_interrupt=False,
    default_parameter=Parameter(negative=()),
)
for _place, (_name, _help) in enumerate(COMMANDS.items()):
    app.command(f"undrift.cli.{_name}:{_name}", name=_name, help=_help, sort_key=_place)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and exit with its code.

    Parameters
    ----------
    arguments : sequence of str, optional
        The words after ``undrift``; those of this process by default.

    Raises
    ------
    SystemExit
        Always, with the exit code.
    """
    try:
        code = run(sys.argv[1:] if arguments is None else arguments)
    except KeyboardInterrupt:  # a second one, while the first was told
        code = INTERRUPTED
    if code == INTERRUPTED:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # one more would change the exit code
    sys.exit(code)


def run(arguments: Sequence[str]) -> int:
    """Run the command line and return its exit code.

    Parameters
    ----------
    arguments : sequence of str
        The words after ``undrift``.

    Returns
    -------
    int
        0, 1, 2 or 3; 130 when interrupted.
    """
    try:
        code = app(arguments, exit_on_error=False, print_error=False)
    except CycloptsError as error:
        return complain(_call_text(error), code=2)
    except RigError as error:
        return complain(str(error), code=3)
    except UndriftError as error:
        return complain(str(error), code=2)
    except BrokenPipeError:  # the reader of stdout, such as head, has seen enough
        with suppress(OSError):
            sys.stdout.close()
        return 0
    except OSError as error:
        return complain(
            f"{error.filename or 'file'}: {error.strerror or error}; check the path and its permissions", code=2
        )
    except KeyboardInterrupt:
        return complain("stopped; nothing was left half written", code=INTERRUPTED)
    except Exception as error:
        if os.environ.get("UNDRIFT_TRACEBACK") == "1":
            raise
        return complain(
            f"internal error: {type(error).__name__}: {error}; please report it with the command (UNDRIFT_TRACEBACK=1 shows "
            "where)",
            code=2,
        )
    return code if isinstance(code, int) else 0


def _call_text(error: CycloptsError) -> str:
    """Return what is wrong with a call, and which help to ask for."""
    command = " ".join(("undrift", *(error.command_chain or ())))
    if isinstance(error, UnusedCliTokensError):
        return f"wanted fewer words, got also {' '.join(error.unused_tokens or ())}; say {command} --help"
    return f"{str(error).strip().splitlines()[0]} Say {command} --help."


def complain(message: str, *, code: int) -> int:
    """Write one line to stderr and return the exit code.

    Parameters
    ----------
    message : str
        What was wanted, what came, what to do.
    code : int
        Exit code.

    Returns
    -------
    int
        The same code.
    """
    sys.stderr.write("undrift: " + " ".join(message.split()) + "\n")
    return code
