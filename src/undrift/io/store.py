"""calibration.json: a JSON object of kind "undrift.calibration", format 1. ``undrift.model`` defines its keys, and ``base.codec``
defines its rules.

A key with a default is written only if its value differs from the default, so that older versions can read the file.
"""

import hashlib
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from undrift.base import codec
from undrift.files import write_whole
from undrift.findings import Finding
from undrift.io.column_map import ColumnMap, file_map_of
from undrift.io.imucal import is_imucal, read_imucal
from undrift.model import Calibration
from undrift.record import FileMap

KIND = "undrift.calibration"
codec.stored(form=codec.As(ColumnMap, file_map_of, lambda file_map: json.loads(file_map.text)))(FileMap)


def write_calibration(calibration: Calibration, path: Path | str) -> None:
    """Write a calibration to a file, completely or not at all.

    Parameters
    ----------
    calibration : Calibration
        Calibration of the device.
    path : path
        calibration.json. An existing file is replaced.

    Raises
    ------
    InputError
        If the folder is not writable, or a value could not be read back. No file is left behind.

    Examples
    --------
    >>> import numpy as np, undrift
    >>> rng = np.random.default_rng(7)
    >>> device = undrift.random_device(rng)
    >>> calibration = undrift.calibrate(undrift.simulate_session("six_face", device, rng=rng))
    >>> import pathlib, tempfile
    >>> path = pathlib.Path(tempfile.mkdtemp(), "calibration.json")
    >>> undrift.write_calibration(calibration, path)
    >>> undrift.read_calibration(path).device == calibration.device
    True
    """
    write_whole(Path(path), codec.json_text(calibration, str(path)))


def read_calibration(path: Path | str) -> Calibration:
    """Read a calibration file.

    Parameters
    ----------
    path : path
        calibration.json, or a calibration of imucal: constants without uncertainty.

    Returns
    -------
    Calibration
        Calibration as it was written, to the last bit.

    Raises
    ------
    FileFormatError
        The file does not exist, is not JSON, has another kind or version, or a key is missing, unknown or of another shape.
    """
    if is_imucal(Path(path)):
        return read_imucal(Path(path))
    return codec.read_json(Calibration, path)


def calibration_json(calibration: Calibration) -> dict[str, Any]:
    """Return a calibration as the JSON object of its file."""
    return dict(codec.tree_of(calibration))


def content_hash(calibration: Calibration) -> str:
    """Return the sha256 of a calibration: of its keys in alphabetical order without spaces, independent of the layout."""
    text = json.dumps(calibration_json(calibration), sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()  # names of files may not be UTF-8


def findings_json(findings: Iterable[Finding]) -> list[dict[str, Any]]:
    """Return findings in the form used in files and by ``--json``."""
    return [codec.tree_of(item) for item in findings]
