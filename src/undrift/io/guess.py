"""Guesses for people, never for readers: what a foreign table might be, and an example of the map that it needs."""

import re
from itertools import pairwise

from undrift.io.columns import TextLayout
from undrift.io.files import read_bytes
from undrift.io.text import MARK, Text, open_text

_FORCE = re.compile(r"GRF|COP|FREEMOMENT|^[FM][xyz]\[")
_PLACE = re.compile(r"^(COG|.*[._](ankle|knee|hip))[._ ][xyz]$", re.IGNORECASE)
_QUATERNION = re.compile(r"^(q_?)?[wxyz]( element)?$", re.IGNORECASE)
_UNITS = {  # what a name may say of its unit; "?" where it says nothing, which a reader refuses
    "time": (("us", r"\(?\bus\b|_us\b"), ("ms", r"\bms\b|_ms\b"), ("s", r"\bs\b|_s\b|sec")),
    "gyro": (("rad/s", r"rad[_/ ]?s"), ("dps", r"dps|deg[_/ ]?s"), ("count", r"raw|count|lsb")),
    "accel": (("m/s2", r"m[_/]?s\^?2"), ("mg", r"\bmg\b|_mg\b"), ("g", r"\(g\)|_g\b"), ("count", r"raw|count|lsb")),
    "temp": (("degC", r"deg ?c|celsius|degrees c"), ("count", r"raw|count|lsb")),
}
_RESULTS: tuple[tuple[str, set[str]], ...] = (  # what undrift writes as plain JSON, and keys that tell it
    ("results of undrift validate", {"trials", "agreement", "offset", "leave_one_out"}),
    ("results of undrift study", {"objective", "tasks", "cohorts", "rivals"}),
    ("results of undrift demo", {"calibration", "study", "checks"}),
)
_LIKELY = {
    "gyro": re.compile(r"^(g|gyr|gyro|gyroscope|w|omega|rot)[ _.]?([xyz])\b", re.IGNORECASE),
    "accel": re.compile(r"^(a|acc|accel|accelerometer)[ _.]?([xyz])\b", re.IGNORECASE),
}


def sniff(path: object) -> Text:
    """Open a text table with the delimiter, header and skipped lines that most of it suggests.

    Parameters
    ----------
    path : str or Path
        The file.

    Returns
    -------
    Text
        As a map would open it; good for showing names, not for reading.
    """
    head = read_bytes(str(path), 1 << 16)
    lines = [line for line in head.decode("utf-8", "replace").splitlines()[:64] if line.strip()]
    if head.startswith(MARK):  # undrift's own first line, which open_text passes over by itself
        lines = lines[1:] or lines
    body = lines[len(lines) // 2 :] or lines
    delimiter = max(",\t;", key=lambda mark: min(line.count(mark) for line in body[:-1] or body))
    if not any(delimiter in line for line in body):
        delimiter = " "
    width = max(len(_cells(line, delimiter)) for line in body)
    skip = next((k for k, line in enumerate(lines) if len(_cells(line, delimiter)) == width), 0)
    header = not all(_is_number(cell) for cell in _cells(lines[skip], delimiter))
    return open_text(str(path), TextLayout(delimiter=delimiter, skip_rows=skip, header=header))


def foreign_kind(text: Text) -> str | None:
    """Name a table that is no recording of an inertial sensor.

    Parameters
    ----------
    text : Text
        From :func:`sniff`.

    Returns
    -------
    str or None
        One line; None where it may be a recording.
    """
    names = [name for name in text.names if name.strip()]
    if any(_FORCE.search(name) for name in names):
        return f"a force plate's table ({', '.join(names[:4])}, ...), not a recording of an inertial sensor"
    if any(_PLACE.search(name) for name in names):
        return f"a table of positions ({', '.join(names[:4])}, ...), not a recording of an inertial sensor"
    if sum(bool(_QUATERNION.match(name)) for name in names) >= 4:
        quaternion = ", ".join(f'"{name}"' for name in names if _QUATERNION.match(name))
        return f"a table of orientations; read it as a reference with quaternion=({quaternion})"
    row = _first_row(text)
    if sum(_is_number(cell) for cell in row) < 0.5 * len(row):
        return f"a table of text ({len(names)} columns: {', '.join(names[:4])}, ...), not a recording"
    triples = triples_of(text.names)
    if text.layout.header and not triples:
        return f"a table without three axes ({', '.join(names[:8])}), not a recording of an inertial sensor"
    if triples and all(re.search(r"a\.u\.|uT|gauss|\(G\)", name) for triple in triples for name in triple):
        return f"a magnetometer's table ({', '.join(names[:4])}), without gyroscope or accelerometer"
    return None


def result_of(held: object) -> str:
    """Name what undrift itself wrote as plain JSON, by keys that only it has.

    Parameters
    ----------
    held : object
        The JSON value.

    Returns
    -------
    str
        One line; "" for anything else.
    """
    if not isinstance(held, dict):
        return ""
    for what, keys in _RESULTS:
        if keys <= held.keys():
            return f"{what}, not a recording: {', '.join(list(held)[:8])}"
    return ""


def triples_of(names: tuple[str, ...]) -> tuple[tuple[str, str, str], ...]:
    """Return names that differ only in an x, y, z: three axes of one quantity.

    Parameters
    ----------
    names : tuple of str
        Columns.

    Returns
    -------
    tuple of (str, str, str)
        In the order of the file.
    """
    held, found = set(names), []
    for name in names:
        for match in re.finditer("[xX]", name):
            at, (y, z) = match.start(), ("yz" if match.group() == "x" else "YZ")
            triple = (name, f"{name[:at]}{y}{name[at + 1 :]}", f"{name[:at]}{z}{name[at + 1 :]}")
            if triple[1] in held and triple[2] in held:
                found.append(triple)
    return tuple(found)


def example_map(names: tuple[str, ...], *, text: Text | None = None, arrays: tuple[str, ...] = ()) -> tuple[str, ...]:
    """Return an example of the map that a table needs; a unit that no name tells is "?", for a person to fill in.

    Parameters
    ----------
    names : tuple of str
        Columns or arrays.
    text : Text or None
        As sniffed.
    arrays : tuple of str
        Arrays of shape (N, 3).

    Returns
    -------
    tuple of str
        Lines of TOML, one key each.
    """
    if text is not None and not text.layout.header:
        keys = _by_position(text)
    elif arrays:
        keys = {channel: f'"{name}"' for channel in _LIKELY if (name := _likely(channel, arrays))}
    else:
        keys = {}
        triples = triples_of(names)
        firsts = tuple(triple[0] for triple in triples)
        gyro = _likely("gyro", firsts)
        accel = _likely("accel", tuple(name for name in firsts if name != gyro)) or next(
            (name for name in firsts if name != gyro), None
        )
        for channel, first in (("gyro", gyro), ("accel", accel)):
            if first is not None:
                keys[channel] = "[" + ", ".join(f'"{name}"' for name in triples[firsts.index(first)]) + "]"
    time = next(
        (name for name in names if re.match(r"^(time|t|timestamp)([ _\[(].*)?$", name.strip(), re.IGNORECASE)), None
    )
    if time is not None:
        keys = {"time": f'"{time}"', **keys}
    temp = next((name for name in names if re.match(r"^(board |die )?temp", name.strip(), re.IGNORECASE)), None)
    if temp is not None:
        keys["temp"] = f'"{temp}"'
    keys = keys or {"gyro": '["gx", "gy", "gz"]', "accel": '["ax", "ay", "az"]'}
    columns = ", ".join(f"{channel} = {value}" for channel, value in keys.items())
    units = ", ".join(f'{channel} = "{_unit_of(channel, value)}"' for channel, value in keys.items())
    lines = [f"columns = {{ {columns} }}", f"units = {{ {units} }}"]
    lines += [] if "time" in keys else ["sample_rate_hz = ?"]
    return (*lines, *_layout_keys(None if text is None else text.layout))


def _unit_of(channel: str, names: str) -> str:
    return next((unit for unit, said in _UNITS[channel] if re.search(said, names, re.IGNORECASE)), "?")


def _by_position(text: Text) -> dict[str, str]:
    """Return positions for a table without names: a growing first column is time, another odd one temperature."""
    width = len(text.names)
    first = [
        _cells(line, text.layout.delimiter)[0]
        for line in text.head.decode("utf-8", "replace").splitlines()[text.skip :][:8]
    ]
    numbers = [float(cell) for cell in first if cell and _is_number(cell)]
    grows = all(b > a for a, b in pairwise(numbers)) and len(numbers) > 1
    keys = {"time": "0"} if grows else {"temp": "0"} if width % 3 == 1 else {}
    start = len(keys)
    for channel in ("accel", "gyro"):
        if start + 3 <= width:
            keys[channel] = f"[{start}, {start + 1}, {start + 2}]"
            start += 3
    return keys


def _likely(channel: str, names: tuple[str, ...]) -> str | None:
    stem = "gyr" if channel == "gyro" else "acc"
    return next((name for name in names if stem in name.lower() or _LIKELY[channel].match(name.strip())), None)


def _layout_keys(layout: TextLayout | None) -> list[str]:
    keys: list[str] = []
    if layout is None:
        return keys
    if layout.delimiter != ",":
        keys.append('delimiter = "\\t"' if layout.delimiter == "\t" else f'delimiter = "{layout.delimiter}"')
    if not layout.header:
        keys.append("header = false")
    if layout.skip_rows:
        keys.append(f"skip_rows = {layout.skip_rows}")
    return keys


def _first_row(text: Text) -> list[str]:
    lines = text.head.decode("utf-8", "replace").splitlines()
    return _cells(lines[text.skip], text.layout.delimiter) if text.skip < len(lines) else []


def _cells(line: str, delimiter: str) -> list[str]:
    return line.split() if delimiter == " " else line.split(delimiter)


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return not cell.strip()
    return True
