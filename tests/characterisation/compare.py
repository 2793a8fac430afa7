"""What was recorded of a call, and whether the same call still gives it.

A result is flattened into paths and leaves. Leaves are numbers, bools, null, a status (good, marginal, bad), units and how a
converter rounds. Sentences are left out, and so is all that stands under a key of ``LEFT_OUT``: reasons, findings, notes, paths,
versions. A list of numbers of a regular shape is one leaf, seen as columns: short ones are kept whole, long ones as the sum, the
sum of squares, the least, the largest, the number of gaps and some rows with even steps.

Two numbers are equal when

    |a - b| <= r max(|a|, |b|) + r/100 s

s is the largest number of the same column; of element ij of a covariance it is sqrt(C_ii C_jj), of a sum over n rows it is n s.
The second term stands for what is left of a subtraction: a residue of rounding has no digits of its own. r is 1e-12 where
processor, versions of Python, numpy, scipy and numba, and the number of BLAS threads are those of ``recorded/machine.json``,
and 1e-6 elsewhere: other vector instructions add up in another order, and searches stop at another step. ``ELSEWHERE`` names
what needs more there. There the hash of exported C is not compared; the numbers in it are. One BLAS thread is asked for by
conftest.py and __main__.py, before numpy is imported; where it was imported before, the fingerprint is another.

A path that was recorded and is missing fails. A new one fails too unless a pattern of ``ADDED`` names it. A path that only
changed its name is put down in ``RENAMED``.
"""

import json
import math
import os
import platform
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numba
import numpy as np
import scipy

RECORDED = Path(__file__).parent / "recorded"
MACHINE = RECORDED / "machine.json"
SAME_MACHINE, OTHER_MACHINE = 1e-12, 1e-6
RESIDUE = 0.01  # of the tolerance, times the column's largest number
WHOLE = 60  # numbers of a list that is kept whole
WHOLE_COVARIANCE = 450  # of 21 parameters
COLUMNS = 12  # a list with a longer last dimension is one column
ROWS = 21  # numbers kept of a long list, 5 rows at least

LEFT_OUT = re.compile(
    r"reasons?|findings?|texts?|warnings?|notes?|not_carried|problems?|messages?|summary|because|provenance|versions?|format"
    r"|created|date|inputs|software|settings|sha256|path|files?|folder|host_s|title|map"
)
KEPT_TEXT = re.compile(
    r"status|unit|unit_in|unit_out|gyro_unit|accel_unit|rounding|gyro_rounding|accel_rounding|code_sha256|refused"
)
# (call, path), regular expressions: new since the recording, on purpose
ADDED: tuple[tuple[str, str], ...] = (
    (
        ".*",
        r"(.*\.)?(result\..*|error|verdict|findings)",
    ),  # the envelope of every answer in JSON; result repeats what stands beside it
    (".*", r"file_map\..*"),
    (".*", r"(.*\.)?budget(\..*)?"),
    ("study_small", r"categories|prices\..*"),
    ("validate_.*", "gravity_(m_s2|source)"),  # of a fit to references
    ("validate_leave_one_out", r"(.*\.)?trials\[\d\]\.expected\.(end|rmse)_at_most_deg"),
    ("info_formats", r".*\.stills"),  # the search for stills adapts
    ("study_small", r"candidates|tasks.*(halving|pareto.*interval_deg.*)"),
    (
        "study_small",
        r"margin_deg|tasks.*(worse_protocols|undecided_protocols|judged|one_way|repeated_measures|eta_\w+_interval).*",
    ),
    ("orient_demo", r"said\.(offset_uncertainty_dps|rests|rest_offsets_dps|method|findings.*)"),
    ("correct_.*", r".*\.(rest|at_rest\..*)"),
    ("study_.*", r"(.*\.)?(rival_triads|claims\[).*"),
    ("study_.*", r"(.*\.)?figure3(_drawn|\.(compared|actual_max_deg|rest_max_deg|full_and_rest_max_deg).*)"),
    (".*", r"drift\.static\.(gyro|accel)_visit"),  # what a visit adds, beside the uncertainty of the curve
    ("noise_static", r"(gyro|accel)\[\d\]\.\w+_(deg_per_\w+|ug|ug_per_\w+)|angle_after_60_s_deg.*"),
)
RENAMED: tuple[tuple[str, str], ...] = ()  # (recorded, now), for re.sub on recorded paths

# (call, path, r) on another machine: the softness of this surface has a flat loss, on which the search stops elsewhere
ELSEWHERE: tuple[tuple[str, str, float], ...] = (
    ("soaks_dynamic", r"(result\.)?drift\.dynamic\.(error|uncertainty)", 5e-3),
    # small beside the covariances whose search stops at another step: 2.4e-4 between two makers of processors
    ("validate_leave_one_out", r"(result\.)?trials\[\d\]\.expected\..*", 1e-3),
)

Leaf = float | int | bool | str | None | dict[str, Any]


@dataclass(frozen=True)
class Difference:
    """One path on which a recording and a result do not agree."""

    path: str
    what: str

    def __str__(self) -> str:
        return f"{self.path or '(the whole)'}: {self.what}"


@cache
def machine() -> dict[str, str]:
    """Return what decides whether rounding is the same."""
    cpu = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.is_file() and (found := re.search(r"^model name\s*:\s*(.*)$", info.read_text(), re.M)):
        cpu = found.group(1)
    return {
        "cpu": cpu,
        "python": ".".join(platform.python_version_tuple()[:2]),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
        "numba": numba.__version__,
        "blas_threads": os.environ.get("OPENBLAS_NUM_THREADS", "all"),
    }


def tolerance() -> float:
    """Return the relative tolerance of this machine."""
    recorded = json.loads(MACHINE.read_text()) if MACHINE.is_file() else machine()
    return SAME_MACHINE if recorded == machine() else OTHER_MACHINE


# ---- flattening -----------------------------------------------------------------------------------------------------


def flatten(value: object, path: str = "") -> dict[str, Leaf]:
    """Return the leaves of a result by path."""
    if isinstance(value, Mapping):
        held: dict[str, Leaf] = {}
        for key, item in value.items():
            if not LEFT_OUT.fullmatch(str(key)):
                held |= flatten(item, f"{path}.{key}" if path else str(key))
        return held
    if isinstance(value, str):
        return {path: value} if KEPT_TEXT.fullmatch(path.rpartition(".")[2]) else {}
    if value is None or isinstance(value, bool | np.bool_ | int | float | np.integer | np.floating):
        return {path: _scalar(value)}
    if isinstance(value, np.ndarray) or (isinstance(value, Sequence) and value and _regular(value)):
        return {path: _array(np.asarray(_with_gaps(value)), path)}
    if isinstance(value, Sequence):
        parts = [flatten(item, f"{path}[{k}]") for k, item in enumerate(value)]
        return {key: leaf for part in parts for key, leaf in part.items()}
    raise TypeError(f"{path}: wanted numbers, lists and mappings, got {type(value).__name__}; pick its numbers")


def _scalar(value: Any) -> Leaf:
    if value is None or isinstance(value, bool | np.bool_):
        return None if value is None else bool(value)
    if isinstance(value, int | np.integer):
        return int(value)
    number = float(value)
    return number if math.isfinite(number) else {"not_finite": str(number)}


def _shape(value: object) -> tuple[int, ...] | None:
    """Return the shape of nested lists of numbers, bools and nulls, None where they are of another kind or ragged."""
    if value is None or isinstance(value, bool | int | float | np.number | np.bool_):
        return ()
    if isinstance(value, np.ndarray):
        return value.shape
    if isinstance(value, str) or not isinstance(value, Sequence) or not value:
        return None
    shapes = {_shape(item) for item in value}
    (first,) = shapes if len(shapes) == 1 else (None,)
    return None if first is None else (len(value), *first)


def _regular(value: Sequence[object]) -> bool:
    return _shape(value) is not None and not all(item is None for item in value)


def _with_gaps(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.view(np.float64).reshape(*value.shape, 2) if np.iscomplexobj(value) else value.astype(np.float64)
    return np.nan if value is None else float(value) if not isinstance(value, Sequence) else [*map(_with_gaps, value)]


def _array(values: np.ndarray, path: str) -> Leaf:
    flat = values.ravel()
    most = WHOLE_COVARIANCE if _is_covariance(path, values.shape) else WHOLE
    if values.size <= most:
        return {"shape": list(values.shape), "values": [_number(x) for x in flat]}
    columns = _columns(values)
    rows = np.unique(np.linspace(0, len(columns) - 1, max(5, -(-ROWS // columns.shape[1]))).round().astype(int))
    seen = [column[np.isfinite(column)] for column in columns.T]
    return {
        "shape": list(values.shape),
        "sum": [math.fsum(c) for c in seen],
        "square_sum": [math.fsum(c * c) for c in seen],
        "least": [_number(c.min()) if len(c) else None for c in seen],
        "largest": [_number(c.max()) if len(c) else None for c in seen],
        "gaps": [int(len(columns) - len(c)) for c in seen],
        "rows": [[_number(x) for x in columns[k]] for k in rows],
    }


def _columns(values: np.ndarray) -> np.ndarray:
    wide = values.ndim > 1 and 0 < values.shape[-1] <= COLUMNS
    return values.reshape(-1, values.shape[-1] if wide else 1)


def _is_covariance(path: str, shape: Sequence[int]) -> bool:
    return "covariance" in path.rpartition(".")[2] and len(shape) == 2 and shape[0] == shape[1]


def _number(value: float) -> float | str | None:
    number = float(value)
    return number if math.isfinite(number) else None if math.isnan(number) else str(number)


# ---- comparison -----------------------------------------------------------------------------------------------------


def compare(name: str, recorded: Mapping[str, Leaf], found: Mapping[str, Leaf], r: float) -> list[Difference]:
    """Return where a result differs from what was recorded of it, path by path."""
    held = dict(recorded)
    for old, new in RENAMED:
        held = {re.sub(old, new, path): leaf for path, leaf in held.items()}
    wrong = []
    for path, leaf in held.items():
        if path not in found:
            wrong.append(Difference(path, f"is missing; it was {_short(leaf)}"))
        elif path.endswith("code_sha256") and r > SAME_MACHINE:
            continue
        elif told := _apart(leaf, found[path], path, _allowed(name, path, r)):
            wrong.append(Difference(path, told))
    for path, leaf in found.items():
        listed = any(re.fullmatch(call, name) and re.fullmatch(pattern, path) for call, pattern in ADDED)
        if path not in held and not listed:
            wrong.append(Difference(path, f"is new: {_short(leaf)}; list it in ADDED if it is meant to be"))
    return wrong


def _allowed(name: str, path: str, r: float) -> float:
    if r <= SAME_MACHINE:
        return r
    return max([r, *(more for call, pattern, more in ELSEWHERE if call == name and re.fullmatch(pattern, path))])


def _apart(a: Leaf, b: Leaf, path: str, r: float) -> str:
    """Return how two leaves differ, empty where they do not."""
    if isinstance(a, dict) and isinstance(b, dict) and "shape" in a and "shape" in b:
        if a["shape"] != b["shape"]:
            return f"shape {a['shape']} became {b['shape']}"
        return _lists_apart(a, b, path, r) if "values" in a else _digests_apart(a, b, r)
    if _is_number(a) and _is_number(b):
        return _told(a, b, "") if not _near(float(a), float(b), r, 0.0) else ""
    return "" if a == b and type(a) is type(b) else f"{_short(a)} became {_short(b)}"


def _is_number(a: Leaf) -> bool:
    return isinstance(a, int | float) and not isinstance(a, bool)


def _near(a: float, b: float, r: float, scale: float) -> bool:
    return abs(a - b) <= r * max(abs(a), abs(b)) + RESIDUE * r * scale


def _lists_apart(a: dict[str, Any], b: dict[str, Any], path: str, r: float) -> str:
    one, two = (np.array([np.nan if x is None else float(x) for x in leaf["values"]]) for leaf in (a, b))
    shape = a["shape"]
    if _is_covariance(path, shape):
        deviation = np.sqrt(np.abs(np.diag(one.reshape(shape))))
        scale = np.outer(deviation, deviation).ravel()
    else:
        table = _columns(one.reshape(shape)) if len(shape) and one.size else one.reshape(-1, 1)
        largest = np.where(np.isfinite(table), np.abs(table), 0.0).max(axis=0, initial=0.0)
        scale = np.broadcast_to(largest, table.shape).ravel()
    for k, (x, y) in enumerate(zip(one, two, strict=True)):
        same = x == y or (math.isnan(x) and math.isnan(y))
        if not same and not (math.isfinite(x) and math.isfinite(y) and _near(x, y, r, scale[k])):
            return _told(a["values"][k], b["values"][k], f"element {[int(i) for i in np.unravel_index(k, shape)]}: ")
    return ""


def _digests_apart(a: dict[str, Any], b: dict[str, Any], r: float) -> str:
    if a["gaps"] != b["gaps"]:
        return f"gaps {a['gaps']} became {b['gaps']}"
    count = math.prod(a["shape"]) // len(a["sum"])
    for j in range(len(a["sum"])):
        ends = [abs(float(x)) for x in (a["least"][j], a["largest"][j]) if x is not None]
        scale = max((x for x in ends if math.isfinite(x)), default=0.0)
        for key, size in (
            ("sum", count * scale),
            ("square_sum", count * scale**2),
            ("least", scale),
            ("largest", scale),
        ):
            if not _same(a[key][j], b[key][j], r, size):
                return _told(a[key][j], b[key][j], f"{key} of column {j}: ")
        for k, (x, y) in enumerate(zip(a["rows"], b["rows"], strict=True)):
            if not _same(x[j], y[j], r, scale):
                return _told(x[j], y[j], f"kept row {k}, column {j}: ")
    return ""


def _same(x: Any, y: Any, r: float, scale: float) -> bool:
    return x == y or (_is_number(x) and _is_number(y) and _near(float(x), float(y), r, scale))


def _told(a: Any, b: Any, where: str) -> str:
    by = (
        f" ({abs(float(a) - float(b)) / max(abs(float(a)), 1e-300):.2g} relative)"
        if _is_number(a) and _is_number(b)
        else ""
    )
    return f"{where}{a!r} became {b!r}{by}"


def _short(leaf: Leaf) -> str:
    text = json.dumps(leaf)
    return text if len(text) <= 80 else f"{text[:77]}..."


# ---- files ----------------------------------------------------------------------------------------------------------


def file_of(name: str) -> Path:
    return RECORDED / f"{name}.json"


def write_recorded(name: str, leaves: Mapping[str, Leaf]) -> None:
    """Write a result, a path a line."""
    lines = [f" {json.dumps(path)}: {json.dumps(leaf, allow_nan=False)}" for path, leaf in leaves.items()]
    file_of(name).write_text("{\n" + ",\n".join(lines) + "\n}\n")


def read_recorded(name: str) -> dict[str, Leaf]:
    held = json.loads(file_of(name).read_text())
    assert isinstance(held, dict)
    return held
