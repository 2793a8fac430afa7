"""Parameter files of autopilots: names and numbers, one a line."""

import math
import re

from undrift.errors import FileFormatError

Parameters = tuple[tuple[str, float], ...]


def read_parameters(text: str, what: str) -> Parameters:
    """Return the parameters in a file of QGroundControl or ArduPilot.

    Parameters
    ----------
    text : str
        Lines "vehicle component name value type" or "name,value"; # begins a comment.
    what : str
        What to call the file in an error.

    Returns
    -------
    tuple of (str, float)
        In order.

    Raises
    ------
    FileFormatError
        A line that is neither, a value that is no number, or a name twice.
    """
    found: list[tuple[str, float]] = []
    for number, line in enumerate(text.splitlines(), start=1):
        words = re.split(r"[\s,]+", line.split("#")[0].strip())
        if words == [""]:
            continue
        name, value = (words[2], words[3]) if len(words) == 5 else (words[0], words[1]) if len(words) == 2 else ("", "")
        try:
            figure = float(value)
        except ValueError:
            figure = math.nan
        if not name or not math.isfinite(figure):
            raise FileFormatError(f"{what}: wanted a name and a number, got {line[:80]!r} in line {number}; repair it")
        if any(name == known for known, _ in found):
            raise FileFormatError(f"{what}: wanted each parameter once, got {name} again in line {number}; remove one")
        found.append((name, figure))
    return tuple(found)


def parameter(parameters: Parameters, name: str, what: str, default: float | None = None) -> float:
    """Return a parameter's value.

    Parameters
    ----------
    parameters : tuple of (str, float)
        As read.
    name : str
        Which.
    what : str
        What to call the file in an error.
    default : float or None
        Where it is absent; None refuses.

    Returns
    -------
    float
        In the parameter's unit.

    Raises
    ------
    FileFormatError
        It is absent and has no default.
    """
    for known, value in parameters:
        if known == name:
            return value
    if default is None:
        raise FileFormatError(f"{what}: wanted the parameter {name}, got none of that name; save all parameters")
    return default
