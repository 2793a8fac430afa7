"""calibration.json: one object, kind "undrift.calibration", format 1. The models that read it also make its JSON Schema.

Numbers read back to the last bit. null stands for NaN; infinity, which JSON does not know, is "inf" or "-inf" where it can
occur. A key with a default is written only where it states something, so that a file without it reads everywhere. A file is
written whole or not at all: into a temporary neighbour first, which then takes its name.
"""

import hashlib
import json
import math
import re
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from pydantic import AfterValidator, BaseModel, Field, ValidationError

from undrift.arrays import FloatArray
from undrift.errors import FileFormatError, InputError
from undrift.files import write_whole
from undrift.findings import Finding, Level, finding
from undrift.io.session import KeptEntry, file_map_of
from undrift.model import (
    AdcModel,
    Budget,
    Calibration,
    DriftTables,
    DynamicDrift,
    Hysteresis,
    Learnt,
    NoiseModel,
    Provenance,
    Rounding,
    ScaleDrift,
    StaticDrift,
    Status,
    TriadModel,
    Verdict,
    WarmUp,
)

Value = TypeVar("Value")
KIND = "undrift.calibration"
FORMAT = 1
ANSWER_KEYS = (
    "lacking",
    "version",
    "findings",
    "result",
    "error",
    "registered",
)  # what ``undrift calibrate --json`` says beside the calibration


def _finite(x: float) -> float:
    if not math.isfinite(x):
        raise ValueError("wanted a finite number, null or 'inf'")
    return x


Finite = Annotated[float, AfterValidator(_finite)]
Number = Finite | None | Literal["inf", "-inf"]
Vector = Annotated[list[Finite | None], Field(min_length=3, max_length=3)]
Matrix = Annotated[list[Vector], Field(min_length=3, max_length=3)]
Nodes = Annotated[list[Finite], Field(min_length=2)]


class TriadFile(BaseModel, strict=True, extra="forbid", frozen=True):
    """One triad: corrected = matrix @ (raw - offset) - g_sensitivity @ accel; matrix in unit_out per unit_in."""

    method: str
    unit_in: str
    unit_out: str
    matrix: Matrix
    offset: Vector
    g_sensitivity: Matrix | None
    parameters: list[str]
    covariance: list[list[Finite | None]]
    rms_residual: Number
    count: int
    rank: int
    condition: Number
    valid_range: Annotated[list[Number], Field(min_length=2, max_length=2)]
    budget: dict[str, list[Finite]] | None = None  # standard uncertainty of the parameters by source


class WarmUpFile(BaseModel, strict=True, extra="forbid", frozen=True):
    """Extra offset over the time since power-on, raw unit; it ends at zero."""

    power_on_s: Nodes
    gyro_offset: list[Vector]


class HysteresisFile(BaseModel, strict=True, extra="forbid", frozen=True):
    """Loop of the gyroscopes' offset about the static table, raw unit; crossed over crossing_k, K."""

    crossing_k: Finite
    crossing_uncertainty_k: Finite
    temp_c: Nodes
    gyro_half_width: list[Vector]
    gyro_uncertainty: list[Vector]


class StaticFile(BaseModel, strict=True, extra="forbid", frozen=True):
    """Absolute offsets over temperature and their standard uncertainties, raw unit; temperatures in degC."""

    temp_c: Nodes
    gyro_offset: list[Vector] | None = None
    accel_offset: list[Vector] | None = None
    gyro_uncertainty: list[Vector] | None = None
    accel_uncertainty: list[Vector] | None = None
    gyro_extrapolated: list[bool] | None = None
    accel_extrapolated: list[bool] | None = None
    gyro_hysteresis: Vector | None = None
    gyro_visit: Vector | None = None
    accel_visit: Vector | None = None
    hysteresis: HysteresisFile | None = None
    warm_up: WarmUpFile | None = None


class ScaleFile(BaseModel, strict=True, extra="forbid", frozen=True):
    """Matrices over temperature and the standard uncertainty of each element, unit_out per unit_in; temperatures in degC."""

    temp_c: Nodes
    gyro_matrix: list[Matrix] | None = None
    accel_matrix: list[Matrix] | None = None
    gyro_uncertainty: list[Matrix] | None = None
    accel_uncertainty: list[Matrix] | None = None
    gyro_extrapolated: list[bool] | None = None
    accel_extrapolated: list[bool] | None = None


class DynamicFile(BaseModel, strict=True, extra="forbid", frozen=True):
    """Rate error over temperature and measured rate and its standard uncertainty, rad/s; temperatures in degC."""

    temp_c: Nodes
    turn_rate: Nodes
    error: list[list[Vector]]
    uncertainty: list[list[Vector]] | None = None
    extrapolated: list[list[bool]] | None = None


class LearntRecordingFile(BaseModel, strict=True, extra="forbid", frozen=True):
    """A recording of daily use: sha256 of its readings, date as ISO 8601, UTC."""

    sha256: str
    date: str


class LearntFile(BaseModel, strict=True, extra="forbid", frozen=True):
    """Rests of daily use, raw unit and its square, the recording of each from 0, and the tables before them."""

    temp_c: list[Finite]
    gyro_offset: list[Vector]
    gyro_variance: list[Vector]
    recording: list[Annotated[int, Field(ge=0)]]
    recordings: list[LearntRecordingFile]
    since: str
    before: "DriftFile | None" = None


class DriftFile(BaseModel, strict=True, extra="forbid", frozen=True):
    """Tuning tables, null where there is none, over the temperature that the thermometer shows lag_s late (s)."""

    static: StaticFile | None = None
    scale: ScaleFile | None = None
    dynamic: DynamicFile | None = None
    lag_s: Annotated[Finite, Field(ge=0.0)] = 0.0
    lag_smooth_s: Annotated[Finite, Field(ge=0.0)] = 0.0
    learnt: LearntFile | None = None


class AdcFile(BaseModel, strict=True, extra="forbid", frozen=True):
    """Code step in the raw unit and rounding: lsb and rounding of the gyroscopes, accel_ the same of the accelerometers."""

    lsb: Vector | None
    rounding: Rounding
    accel_lsb: Vector | None
    accel_rounding: Rounding


class NoiseFile(BaseModel, strict=True, extra="forbid", frozen=True):
    """Noise coefficients per axis, SI; null where the record was too short."""

    angle_random_walk: Vector
    bias_instability: Vector
    rate_random_walk: Vector
    velocity_random_walk: Vector
    accel_bias_instability: Vector
    accel_random_walk: Vector


class FindingFile(BaseModel, strict=True, extra="forbid", frozen=True):
    """What a fit noticed: a code with its numbers, and the text of the version that wrote it."""

    code: str
    level: Level
    values: dict[str, Any]
    text: str
    action: str


class VerdictFile(BaseModel, strict=True, extra="forbid", frozen=True):
    """What the calibration is worth; files from before findings had codes hold reasons alone."""

    status: Status
    reasons: list[str]
    findings: list[FindingFile] = []


class InputFile(BaseModel, strict=True, extra="forbid", frozen=True):
    """A file that the calibration was made from."""

    file: str
    sha256: str


class ProvenanceFile(BaseModel, strict=True, extra="forbid", frozen=True):
    """Where the calibration came from; time is ISO 8601, UTC."""

    inputs: list[InputFile]
    settings: dict[str, str]
    versions: dict[str, str]
    time: str


class CalibrationFile(BaseModel, strict=True, extra="forbid", frozen=True):
    """A device's calibration as undrift writes it."""

    kind: Literal["undrift.calibration"]
    format: Literal[1]
    device: str
    reference_temp_c: Finite | None
    gravity_m_s2: Finite
    gyro: TriadFile | None
    accel: TriadFile | None
    drift: DriftFile | None
    adc: AdcFile | None
    noise: NoiseFile | None
    verdict: VerdictFile
    provenance: ProvenanceFile
    file_map: KeptEntry | None = None  # How the recordings of the device are read


# ---- reading and writing

ADC_KEYS = ("gyro_lsb", "gyro_rounding", "accel_lsb", "accel_rounding")
LATER_KEYS = (
    "gyro_uncertainty", "accel_uncertainty", "gyro_extrapolated", "accel_extrapolated", "gyro_hysteresis", "hysteresis",
    "warm_up",
    "gyro_visit", "accel_visit", "uncertainty", "extrapolated",
)  # fmt: skip


def write_calibration(calibration: Calibration, path: Path | str) -> None:
    """Write a calibration to a file, whole or not at all.

    Parameters
    ----------
    calibration : Calibration
        The device's model.
    path : path
        calibration.json; an existing file is replaced.

    Raises
    ------
    InputError
        A folder that cannot be written to, or a value that could not be read back; no file is left behind.

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
    write_whole(Path(path), calibration_text(calibration, str(path)))


def calibration_text(calibration: Calibration, name: str) -> str:
    """Return the text of a calibration file; the name stands in errors."""
    content = calibration_json(calibration)
    try:
        CalibrationFile.model_validate(content)
    except ValidationError as error:
        raise InputError(
            f"{name}: wanted a calibration that reads back, got {_first_problem(error)}; mend the value"
        ) from error
    text = json.dumps(content, indent=2, allow_nan=False)
    # lists of plain values on one line: raw line breaks never stand inside a JSON string
    lists = re.compile(r"\[\n\s*([^\[\]{}]*?)\n\s*\]")
    return lists.sub(lambda found: "[" + re.sub(r"\n\s*", " ", found[1]) + "]", text) + "\n"


def read_calibration(path: Path | str) -> Calibration:
    """Read a calibration file.

    Parameters
    ----------
    path : path
        calibration.json.

    Returns
    -------
    Calibration
        As it was written, to the last bit.

    Raises
    ------
    FileFormatError
        No such file, not JSON, another kind or version, a key that is missing, unknown, or of another shape.
    """
    try:
        content = json.loads(Path(path).read_text(encoding="utf-8"), parse_constant=_refuse_constant)
    except OSError as error:
        raise FileFormatError(f"{path}: wanted a calibration file, got {error.strerror}; check the path") from error
    except (ValueError, RecursionError) as error:  # broken JSON, or text that is not UTF-8
        raise FileFormatError(f"{path}: wanted JSON, got {error}; write the file anew") from error
    return calibration_of(content, str(path))


def calibration_of(content: Any, path: str) -> Calibration:
    """Return the calibration that a file, or what messages call by its name, holds as JSON."""
    kind, version = (content.get("kind"), content.get("format")) if isinstance(content, dict) else (None, None)
    if kind != KIND:
        raise FileFormatError(f"{path}: wanted kind {KIND!r}, got {kind!r}; give a file that `undrift calibrate` wrote")
    if version != FORMAT or isinstance(version, bool):
        raise FileFormatError(
            f"{path}: wanted format {FORMAT}, got {version!r}; read it with the undrift that wrote it"
        )
    content = {key: value for key, value in content.items() if key not in ANSWER_KEYS}
    try:
        return _value(CalibrationFile.model_validate(content))
    except ValidationError as error:
        raise FileFormatError(
            f"{path}: wanted a calibration of format {FORMAT}, got {_first_problem(error)}; repair the file"
        ) from error
    except (InputError, ValueError, OverflowError) as error:
        raise FileFormatError(f"{path}: {error}") from error


def calibration_json(calibration: Calibration) -> dict[str, Any]:
    """Return a calibration as the object that its file holds."""
    adc, p = calibration.adc, calibration.provenance
    return {
        "kind": KIND,
        "format": FORMAT,
        **{key: _plain(getattr(calibration, key)) for key in ("device", "reference_temp_c", "gravity_m_s2")},
        "gyro": _triad_json(calibration.gyro),
        "accel": _triad_json(calibration.accel),
        "drift": _drift_json(calibration.drift),
        "adc": adc and {key.removeprefix("gyro_"): _plain(getattr(adc, key)) for key in ADC_KEYS},
        "noise": _plain(calibration.noise),
        "verdict": verdict_json(calibration.verdict),
        "provenance": {
            "inputs": [{"file": name, "sha256": digest} for name, digest in p.inputs],
            "settings": _by_name(p.settings, "settings"),
            "versions": _by_name(p.versions, "versions"),
            "time": p.created,
        },
        **({} if calibration.file_map is None else {"file_map": json.loads(calibration.file_map.text)}),
    }


def content_hash(calibration: Calibration) -> str:
    """Return the sha256 of what a calibration states: that of its file's content."""
    return hash_of(calibration_json(calibration))


def hash_of(content: Mapping[str, Any]) -> str:
    """Return the sha256 of a JSON object with sorted keys, without spaces, in UTF-8: the same however its file is laid out."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()  # names of files may be no UTF-8


def verdict_json(verdict: Verdict) -> dict[str, Any]:
    """Return a verdict as files and ``--json`` hold it: status, reasons as texts, findings with their numbers."""
    findings = findings_json(verdict.findings)
    return {"status": verdict.status, "reasons": list(verdict.reasons), "findings": findings}


def findings_json(findings: Iterable[Finding]) -> list[dict[str, Any]]:
    """Return findings as files and ``--json`` hold them."""
    keys = ("code", "level", "values", "text", "action")
    return [{key: _plain(getattr(item, key)) for key in keys} for item in findings]


def calibration_schema() -> dict[str, Any]:
    """Return the JSON Schema of a calibration file, made from the models that read it."""
    schema = CalibrationFile.model_json_schema(mode="validation")
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}


def _first_problem(error: ValidationError) -> str:
    """The first thing that pydantic found wrong, on one line."""
    first = error.errors(include_url=False)[0]
    where = ".".join(str(part) for part in first["loc"])
    return f"at {where}: {first['msg'].removeprefix('Value error, ')}"


def _by_name(pairs: tuple[tuple[str, str], ...], what: str) -> dict[str, str]:
    found = dict(pairs)
    if len(found) != len(pairs):
        raise InputError(f"provenance: wanted each of the {what} once, got a name twice; name them apart")
    return found


def _plain(value: Any) -> Any:
    """A value as JSON knows it: dataclasses by field, arrays and tuples as lists."""
    if value is None or isinstance(value, str | int):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None if math.isnan(value) else "inf" if value > 0.0 else "-inf"
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, Mapping):
        return {name: _plain(item) for name, item in value.items()}
    return {name: _plain(getattr(value, name)) for name in value.__slots__}


def _triad_json(triad: TriadModel | None) -> dict[str, Any] | None:
    """A triad, its budget by source; a key that states nothing is left out."""
    if triad is None:
        return None
    content = {name: _plain(getattr(triad, name)) for name in triad.__slots__ if name != "budget"}
    if triad.budget is not None:
        content["budget"] = dict(zip(triad.budget.sources, _plain(triad.budget.uncertainty), strict=True))
    return content


def _drift_json(drift: DriftTables | None) -> dict[str, Any] | None:
    """The tables, without later keys that state nothing: an older reader reads the rest."""
    if drift is None:
        return None
    content = {name: _plain(getattr(drift, name)) for name in drift.__slots__ if name != "learnt"}
    for table in (content["static"], content["scale"], content["dynamic"]):
        for name in LATER_KEYS:
            if table is not None and table.get(name, 0) is None:
                del table[name]
    if drift.learnt is not None:
        held = {name: _plain(getattr(drift.learnt, name)) for name in drift.learnt.__slots__ if name != "before"}
        held["recordings"] = [{"sha256": digest, "date": date} for digest, date in drift.learnt.recordings]
        content["learnt"] = held | {"before": _drift_json(drift.learnt.before)}
    return {name: value for name, value in content.items() if not (name.startswith("lag_") and value == 0.0)}


def _refuse_constant(name: str) -> float:
    raise ValueError(f"{name}, which is no JSON number")


def _array(values: Any) -> FloatArray:
    return np.array(values, dtype=np.float64)  # None becomes NaN


def _made(kind: Callable[..., Value], file: BaseModel | None, **given: Any) -> Value | None:
    """A value by the fields of its file, lists as arrays; the value makes booleans of its marks."""
    if file is None:
        return None
    held = {name: _array(item) if isinstance(item, list) else item for name, item in file if name not in given}
    return kind(**held, **given)


def _scalar(x: float | str | None) -> float:
    return math.nan if x is None else float(x)


def _verdict(file: VerdictFile) -> Verdict:
    findings = tuple(map(_finding, file.findings))
    known = {item.text for item in file.findings} | {item.text for item in findings}
    bare = (finding("earlier.text", "info", text=reason) for reason in file.reasons if reason not in known)
    return Verdict(status=file.status, findings=(*findings, *bare))


def _finding(file: FindingFile) -> Finding:
    """Return a finding by its code, or by its text where the code or a value of its sentence is not known to this version."""
    made = finding(file.code, file.level, **{k: math.nan if v is None else v for k, v in file.values.items()})
    try:
        _ = made.text
    except KeyError:
        return finding("earlier.text", file.level, text=file.text)
    return made


def _triad(file: TriadFile | None) -> TriadModel | None:
    if file is None:
        return None
    p = len(file.parameters)
    return _made(
        TriadModel,
        file,
        parameters=tuple(file.parameters),
        covariance=_array(file.covariance).reshape(p, p) if p == 0 else _array(file.covariance),
        rms_residual=_scalar(file.rms_residual),
        condition=_scalar(file.condition),
        valid_range=(_scalar(file.valid_range[0]), _scalar(file.valid_range[1])),
        budget=None
        if file.budget is None
        else Budget(sources=tuple(file.budget), uncertainty=_array([*file.budget.values()]).reshape(-1, p)),
    )


def _drift(file: DriftFile | None) -> DriftTables | None:
    if file is None:
        return None
    learnt, made = file.learnt, None
    of_static = file.static and {
        "hysteresis": _made(Hysteresis, file.static.hysteresis),
        "warm_up": _made(WarmUp, file.static.warm_up),
    }
    if learnt is not None:
        recordings = tuple((one.sha256, one.date) for one in learnt.recordings)
        rows = np.array(learnt.recording, np.int64)
        made = _made(Learnt, learnt, recordings=recordings, recording=rows, before=_drift(learnt.before))
    return _made(
        DriftTables,
        file,
        static=_made(StaticDrift, file.static, **(of_static or {})),
        scale=_made(ScaleDrift, file.scale),
        dynamic=_made(DynamicDrift, file.dynamic),
        learnt=made,
    )


def _value(file: CalibrationFile) -> Calibration:
    p = file.provenance
    return Calibration(
        device=file.device,
        reference_temp_c=_scalar(file.reference_temp_c),
        gravity_m_s2=file.gravity_m_s2,
        gyro=_triad(file.gyro),
        accel=_triad(file.accel),
        drift=_drift(file.drift),
        adc=_made(lambda lsb, rounding, **accel: AdcModel(gyro_lsb=lsb, gyro_rounding=rounding, **accel), file.adc),
        noise=_made(NoiseModel, file.noise),
        verdict=_verdict(file.verdict),
        provenance=Provenance(
            inputs=tuple((i.file, i.sha256) for i in p.inputs),
            settings=tuple(p.settings.items()),
            versions=tuple(p.versions.items()),
            created=p.time,
        ),
        file_map=None if file.file_map is None else file_map_of(file.file_map),
    )
