"""undrift: calibrate a wearable inertial sensor, compensate its thermal drift, and prove the benefit in degrees.

Data flows left to right, one stage a file or folder::

    record -> segments -> calibration -> drift -> correction -> orientation -> validation -> report

Frames: s sensor axes, b device case, m optical body, n level (z up). ``q_nb`` is scalar first and maps b to n. At rest
the accelerometer axis that points up reads +g. Inside the package values are rad/s, m/s2, s and degC. Raw readings keep
the device's unit, which is stored with them. Time is axis 0: (N,), (N, 3), (N, 4). NaN means a gap and nothing else.

    corrected = matrix @ (raw - offset)            ``correction/correct.py`` is the only implementation

Stages are functions on values: ``correct(record, calibration)``. Commands are functions on files, with the names and
options of the command line: ``undrift.info("walk.csv")``, ``undrift.info("walk.csv", write_session="session")``. If a
stage and a command have the same name, the command is ``undrift.commands.correct``. Commands return the result that the
command line shows.
"""

import importlib
import sys
from pathlib import Path
from typing import Any

from undrift.commands import GROUPS, VERBS, Commands

__version__ = "0.1.0"

# Names by module, in flow order, from the stub beside this file, which type checkers read. Each is imported when it is first asked
# for, so that ``import undrift`` costs nothing.
_MODULES: dict[str, list[str]] = {}
_words = Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8").partition("# ---- commands")[0].split()
for _before, _word, _after in zip(_words, _words[1:], _words[2:], strict=False):
    if _before == "from":
        _names = _MODULES.setdefault(_word.removeprefix("undrift."), [])
    elif _word == "as":
        _names.append(_before)
_HOME = {name: module for module, names in _MODULES.items() for name in names}
__all__ = [*_HOME]  # noqa: PLE0604


def __getattr__(name: str) -> Any:
    from importlib.util import find_spec

    if name in _HOME:
        value = getattr(importlib.import_module(f"undrift.{_HOME[name]}"), name)
    elif name in (*VERBS, *GROUPS):  # if a package has the name of a command, that package is called
        home = name if find_spec(f"undrift.{name}") else f"commands.{name}"
        module = importlib.import_module(f"undrift.{home}")
        value = module if home == name or name in GROUPS else getattr(module, name)
    else:
        raise AttributeError(f"module 'undrift' has no attribute '{name}'")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return [*_HOME, *VERBS, *GROUPS, "__version__"]


sys.modules[__name__].__class__ = Commands
