"""C3D files, plain or gzip: marker points, and analog channels at their own rate.

Integer and real storage, Intel, DEC and MIPS byte orders. A point with a negative residual, or at exactly 0, 0, 0, was not
seen: NaN. Labels that repeat get #2, #3, ...; points without a label are called ``unlabelled``.
"""

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from undrift.arrays import FloatArray, frozen
from undrift.errors import FileFormatError, InputError
from undrift.io.files import checked_file, is_gzip, read_bytes
from undrift.io.markers import Markers, Up, level_from, unique_labels
from undrift.units import si_factor

_MAGIC = 0x50


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Analog:
    """Analog channels of a C3D file, in the unit the file states.

    Parameters
    ----------
    labels : tuple of str
        One for each channel, all different.
    units : tuple of str
        As the file spells them.
    time : array, shape (N,)
        s, on the clock of the points.
    values : array, shape (N, K)
        Readings, scaled as the file says.
    """

    labels: tuple[str, ...]
    units: tuple[str, ...]
    time: FloatArray
    values: FloatArray

    def __post_init__(self) -> None:
        set_ = object.__setattr__
        set_(self, "time", frozen(self.time, (None,), "time"))
        set_(self, "values", frozen(self.values, (len(self.time), len(self.labels)), "values"))


def read_c3d(path: str | Path, *, up: Up | None = None) -> Markers:
    """Read marker trajectories from a C3D file.

    Parameters
    ----------
    path : str or Path
        The file, plain or gzip.
    up : str or None
        Laboratory axis that points up, "y" or "z"; None where the file says so itself (POINT:Y_SCREEN).

    Returns
    -------
    Markers
        m, z up, gaps NaN. Time counts from frame 0 of the recording, of which the file may hold a later part.

    Raises
    ------
    InputError
        No such file; the file does not say which axis points up.
    FileFormatError
        Not a C3D file, a damaged one, or one without points.
    """
    path = Path(path)
    held = _load(path)
    point = held["parameters"]["POINT"]
    xyz = np.moveaxis(np.asarray(held["data"]["points"], dtype=np.float64)[:3], 0, 2)  # (M, N, 3)
    count, frames = xyz.shape[:2]
    if count == 0 or frames < 2:
        raise FileFormatError(
            f"{path}: wanted marker points over two frames or more, got {count} markers, {frames} frames"
        )
    lost = np.asarray(held["data"]["meta_points"]["residuals"])[0] < 0.0
    xyz[lost | ~np.isfinite(xyz).all(axis=2) | (xyz == 0.0).all(axis=2)] = np.nan
    rate, first = float(held["header"]["points"]["frame_rate"]), int(held["header"]["points"]["first_frame"])
    if not rate > 0.0:
        raise FileFormatError(f"{path}: wanted a frame rate above 0, got {rate:g} Hz; the header is damaged")
    unit = next(iter(point["UNITS"]["value"]), "") if "UNITS" in point else ""
    points = np.moveaxis(xyz, 0, 1) * _length_factor(unit, path)
    return Markers(
        labels=_labels(point, count),
        time=(first + np.arange(frames)) / rate,
        points=level_from(points, up or _stated_up(point, path)),
        name=path.name,
    )


def read_c3d_analog(path: str | Path) -> Analog:
    """Read the analog channels of a C3D file.

    Parameters
    ----------
    path : str or Path
        The file, plain or gzip.

    Returns
    -------
    Analog
        Channels on the clock of the points.

    Raises
    ------
    FileFormatError
        Not a C3D file, a damaged one, or one without analog channels.
    """
    path = Path(path)
    held = _load(path)
    values = np.asarray(held["data"]["analogs"], dtype=np.float64)[0].T
    if values.shape[1] == 0:
        raise FileFormatError(f"{path}: wanted analog channels, got none; the file holds points only")
    analog, header = held["parameters"]["ANALOG"], held["header"]
    rate = float(header["analogs"]["frame_rate"])
    start = int(header["points"]["first_frame"]) / float(header["points"]["frame_rate"])
    units = [str(unit).strip() for unit in analog["UNITS"]["value"]] if "UNITS" in analog else []
    return Analog(
        labels=_labels(analog, values.shape[1]),
        units=tuple((units + [""] * values.shape[1])[: values.shape[1]]),
        time=start + np.arange(len(values)) / rate,
        values=values,
    )


def is_c3d(head: bytes) -> bool:
    """Tell a C3D file by its first bytes.

    Parameters
    ----------
    head : bytes
        The first two bytes or more, unpacked.

    Returns
    -------
    bool
        True where byte 2 is the C3D key and byte 1 a parameter block number.
    """
    return len(head) > 512 and head[1] == _MAGIC and 2 <= head[0] < 128


def _load(path: Path) -> Any:
    try:
        import ezc3d
    except ImportError as error:  # pragma: no cover - the io extra is installed where the tests run
        raise InputError(f"{path}: C3D files need ezc3d; install undrift[io]") from error
    content = read_bytes(path)
    _check_size(content, path)
    try:
        if not is_gzip(checked_file(path)):
            return ezc3d.c3d(str(path))
        with tempfile.TemporaryDirectory() as folder:
            plain = Path(folder) / "unpacked.c3d"
            plain.write_bytes(content)
            return ezc3d.c3d(str(plain))
    except (OSError, RuntimeError, ValueError, IndexError, KeyError) as error:
        raise FileFormatError(
            f"{path}: wanted a sound C3D file, got a damaged one; {str(error).splitlines()[0]}"
        ) from error


def _check_size(content: bytes, path: Path) -> None:
    """Refuse what is not C3D, and a file shorter than its header promises, before the parser sees it."""
    if not is_c3d(content):
        raise FileFormatError(f"{path}: wanted a C3D file, got other content; check the path")
    block = (content[0] - 1) * 512
    if len(content) < block + 4:
        raise FileFormatError(f"{path}: wanted a whole C3D file, got one cut before its parameters; copy it again")
    processor = content[block + 3] - 83  # 1 Intel, 2 DEC (Intel's order of bytes in words), 3 MIPS
    words = np.frombuffer(content[:512], dtype=">u2" if processor == 3 else "<u2")
    points, analogs, first, last, start = (int(words[k]) for k in (1, 2, 3, 4, 8))
    real = bool(words[7 if processor == 1 else 6] & 0x8000)  # a negative scale marks storage in reals
    frames = last - first + 1 if last < 65535 else 0  # longer trials state their length in the parameters
    need = 512 * (start - 1) + frames * (4 * points + analogs) * (4 if real else 2)
    if len(content) < need:
        raise FileFormatError(
            f"{path}: wanted {need} bytes as its header promises, got {len(content)}; the file is cut, copy it again"
        )


def _stated_up(point: Any, path: Path) -> Up:
    stated = str(next(iter(point["Y_SCREEN"]["value"]), "")) if "Y_SCREEN" in point else ""
    if stated == "+Z":
        return "z"
    if stated == "+Y":
        return "y"
    raise InputError(
        f'{path}: wanted the axis that points up, got no POINT:Y_SCREEN of +Y or +Z; state up = "y" or "z"'
    )


def _length_factor(unit: str, path: Path) -> float:
    if not unit.strip():
        raise FileFormatError(f"{path}: wanted the unit of length in POINT:UNITS, got none; the parameters are damaged")
    return si_factor(unit, "length")


def _labels(group: Any, count: int) -> tuple[str, ...]:
    """Return ``count`` different labels; LABELS2, LABELS3, ... go on where LABELS ends."""
    held: list[str] = []
    for k in range(1, 100):
        name = "LABELS" if k == 1 else f"LABELS{k}"
        if name not in group or len(held) >= count:
            break
        held += [str(label).strip() for label in group[name]["value"]]
    return unique_labels([label or "unlabelled" for label in (held + [""] * count)[:count]])
