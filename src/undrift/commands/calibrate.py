"""``undrift calibrate``: calibrate from a session or from recordings without a session.

The summary judges a calibration with its own recordings. The readings of every phase are corrected like any recording:

    residual of a pose      |a| - g                              of a dwell   w - rate * axis
    leverage of piece i     x_i' (sum x x')^+ x_i / rank,        x = (a, 1) or (w, 1), for norms only (a_j a_k, a_j) / |a|

"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from undrift.base.options import Files, Flag, OptionalOutput, verb
from undrift.base.summary import Drawing, Result, Section, Summary, at, concise, figure_of, number
from undrift.calibration.settings import AccelFit, GyroFit
from undrift.commands import Progress, reading, silent
from undrift.commands.answer import answer_sentence, departures_words, rms_of, uncertainty_section
from undrift.commands.files import Opening, Place, check_output, recording_of, session_of
from undrift.errors import InputError
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY, Quantity, is_physical, si_factor

if TYPE_CHECKING:
    from undrift.arrays import FloatArray
    from undrift.calibration.in_motion import InMotion
    from undrift.calibration.session import Observed
    from undrift.calibration.settings import CalibrateSettings
    from undrift.commands.pieces import Piece
    from undrift.model import Calibration, TriadModel
    from undrift.record import Record, Session

NAMES = {"accel": "accelerometers", "gyro": "gyroscopes"}
BARS = "Bars: expanded uncertainty, 95 %, as in the certificate."
RESIDUALS = (
    "These are the residuals of the fitted readings. They do not include errors common to all readings, such as "
    "tilted faces or a "
    "wrong gravity. The uncertainty above applies to other readings at this temperature."
)
INFORMATION = "Information: share of its poses and dwells in the leverage on matrix and offsets, equal weights, mean of the triads."


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Calibrated(Result):
    """A calibration, and the session that it was made of."""

    files: tuple[Path, ...]
    calibration: "Calibration"
    session: "Session"
    seen: "Observed | None"  # None for calibration from motion only
    settings: "CalibrateSettings"
    in_motion: "InMotion | None"  # offsets of each recording, for a calibration from motion only
    output: Path | None
    log: dict[str, Any] | None = None  # clocks and dwells of the log of a rate table

    @property
    def lacking(self) -> list[str]:
        """Return the triads with readings but without a model."""
        records = self.session.records
        missing = [key for key in NAMES if getattr(self.calibration, key) is None]
        return [NAMES[key] for key in missing if any(getattr(record, key) is not None for record in records)]

    @cached_property
    def pieces(self) -> "tuple[Piece, ...]":
        """Return the phases of the session, with the reason for each unused phase."""
        from undrift.commands.pieces import pieces_of

        if self.seen is None:
            return ()
        return pieces_of(self.seen, self.calibration)

    def summary(self) -> Summary:
        """Return matrices and offsets with their uncertainty, the data used, and the residuals."""
        from undrift.io.store import calibration_json

        calibration, output, lacking = self.calibration, self.output, self.lacking
        recording, after = output and recording_of(self.files), list[str]()
        if lacking:
            raw = f"no model of the {' and '.join(lacking)} (see the verdict). Their readings stay raw"
            after.append(f"Not complete: {raw}")
        if output is None:
            after.append("Nothing was written. To keep it, repeat the command with -o calibration.json")
        follows = recording is not None and NAMES["accel"] not in lacking
        overview, extra_data = calibration_summary(calibration), dict[str, Any]()
        if self.in_motion is not None:
            figures = _motion_figures(self, self.in_motion)
            overview = replace(overview, sections=(*overview.sections, _motion_section(figures)))
            extra_data |= {"motion": figures}
        if self.log is not None:
            overview = replace(
                overview, sections=(*overview.sections, Section(title="Rates of the log", text=_log_lines(self.log)))
            )
            extra_data |= {"rates": self.log}
        return replace(
            overview,
            data=calibration_json(calibration) | {"lacking": lacking} | extra_data,
            pictures=overview.pictures
            if self.seen is None
            else (Drawing(place="undrift.commands.calibrate:draw_rests", of=(self,)),),
            page=lambda: judged_sections(self) if self.in_motion is None else (),
            written=(output,),
            after=tuple(after),
            next=("correct", recording, "--calibration", output, "-o", "corrected.parquet") if follows else (),
        )


PART = "kind"  # setting of a calibration's origin
PRIOR_OF = "undrift.sim.device.presets:sensitivity_of"  # of a part, over temperature


@verb
def calibrate(
    *files: Files,
    place: Place = Place(),
    opening: Opening = Opening(),
    turn_deg: float | None = None,
    rates: Path | None = None,
    output: OptionalOutput = None,
    calibrate_from: Annotated[Literal["pieces", "motion"], Parameter(name=("--from", "--calibrate-from"))] = "pieces",
    kind: str | None = None,
    magnetometer: Flag = False,
    accel: AccelFit | None = None,
    gyro: GyroFit | None = None,
    mode: Literal["paper", "affine"] | None = None,
    adc: Literal["auto", "none"] = "auto",
    progress: Progress = silent,
) -> Calibrated:
    """Calibrate from a session or from recordings without a session, with verdict and findings.

    Parameters
    ----------
    files : Path
        A folder with session.toml, or recordings of the same device. Rests, faces and turns are detected in recordings.
    turn_deg : float or None
        Angle of the turns between rests in bare recordings, deg, one or more about each axis: 360 for full turns.
    rates : Path or None
        Log of a rate table's own controller: time_s (or time_ms, time_us) and turn_rate_dps (or turn_rate_rad_s,
        turn_rate_rpm) or angle_deg (or angle_rad, angle_turns). Its clock is aligned with the recordings. Its steady
        dwells become the turns.
    output : Path or None
        calibration.json to write.
    calibrate_from : str
        "pieces" uses rests, faces and turns. "motion" uses only gravity while the device is turned or worn, for 20 s or
        more.
    kind : str or None
        Preset of the device's part, as mpu6050: its sensitivity to temperature, and the lag of its thermometer, are the prior.
    magnetometer : bool
        With motion: fits hard and soft iron of the magnetometer, and its alignment to the gyroscopes.
    accel : str or None
        How to calibrate the accelerometers. By default, the session determines the method.
    gyro : str or None
        How to calibrate the gyroscopes. By default, the session determines the method. "rest" fits only their offset.
        "none" omits them.
    mode : str or None
        paper (the note's equations to the letter) or affine.
    adc : str
        "auto" detects the step and rounding of the codes. "none" skips the detection.
    """
    from undrift.calibration.calibrate import calibrated as fit
    from undrift.calibration.calibrate import from_motion
    from undrift.calibration.settings import CalibrateSettings

    check_output(output, endings=(".json",), reads=(*files, opening.column_map, rates))
    if calibrate_from == "motion":
        idle = {
            "accel": accel,
            "gyro": gyro,
            "mode": mode,
            "turn_deg": turn_deg,
            "rates": rates,
        }
        _check_idle(idle | {"kind": kind, "adc": None if adc == "auto" else adc})
    elif magnetometer:
        raise InputError("calibrate: `magnetometer` requires `calibrate_from` motion. Set it, or omit `magnetometer`.")
    settings = CalibrateSettings(latitude_deg=place.latitude_deg, turn_angle_deg=turn_deg, identify_adc=adc == "auto")
    with reading(progress, 0.5, *files):
        session = _of_part(session_of(files, place, opening), kind)
    progress("fitting", 0.5)
    log: dict[str, Any] | None = None
    if rates is not None:
        session, log = _turns_of_log(session, rates, settings)
    if calibrate_from == "motion":
        calibration, motion = from_motion(session, magnetometer=magnetometer)
        observed = None
    else:
        (calibration, observed), motion = fit(session, accel=accel, gyro=gyro, mode=mode, settings=settings), None
    preset = () if kind is None else ((PART, kind),)
    calibration = replace(
        calibration, provenance=replace(calibration.provenance, settings=(*calibration.provenance.settings, *preset))
    )
    calibrated = Calibrated(
        files=files, calibration=calibration, session=session, seen=observed, settings=settings, in_motion=motion, output=output,
        log=log)  # fmt: skip
    if output is not None:
        at("undrift.io.store:write_calibration")(calibration, output)
    return calibrated


def _of_part(session: "Session", kind: str | None) -> "Session":
    return session if kind is None else replace(session, sensitivity=at(PRIOR_OF)(kind))


def _turns_of_log(session: "Session", path: Path, settings: "CalibrateSettings") -> tuple["Session", dict[str, Any]]:
    """Return bare recordings with their rests and the dwells of a table's log, and how the clocks were aligned."""
    from undrift.calibration.calibrate import find_pieces
    from undrift.rate_log import LEAST_S, align_clocks, cut_dwells, read_rate_log

    if session.turns or session.stills:
        raise InputError(
            f"`rates`: expected recordings without a session, got a session with its own phases. Omit {path}."
        )
    log = read_rate_log(path)
    lines = [align_clocks(log, record) for record in session.records]
    turns, missed = cut_dwells(log, list(zip(session.records, lines, strict=True)))
    if not turns:
        raise InputError(
            f"{path}: expected steady dwells of {LEAST_S:g} s or more on the recording, got none ({missed} left out). "
            "Check the log."
        )
    largest_dps = max(turn.uncertainty for turn in turns) / RADIAN_PER_DEGREE
    figures = {
        "dwells": len(turns),
        "left_out": missed,
        "largest_uncertainty_dps": largest_dps,
        "clocks": [
            {
                "offset_s": line.lag_s,
                "offset_uncertainty_s": line.lag_uncertainty_s,
                "drift": line.skew,
                "drift_uncertainty": line.skew_uncertainty,
            }
            for line in lines
        ],
    }
    return replace(find_pieces(session, settings)[0], turns=tuple(turn.turn for turn in turns)), figures


NOTABLE_DRIFT = 1e-3  # of the clocks: a scale factor is wrong by as much if the clock of the table is the wrong one


def _log_lines(log: dict[str, Any]) -> tuple[str, ...]:
    lines = [
        f"dwells from the log: {log['dwells']}, left out {log['left_out']}, standard uncertainty of rates up to "
        f""
        f"{log['largest_uncertainty_dps']:.2g} deg/s"
    ]
    for clock in log["clocks"]:
        lines.append(
            f"recording - log: {clock['offset_s']:.3f} +- {clock['offset_uncertainty_s']:.3f} s, drift "
            f"{clock['drift'] * 1e6:+.0f} +- {clock['drift_uncertainty'] * 1e6:.0f} ppm"
        )
        if abs(clock["drift"]) > NOTABLE_DRIFT:
            lines.append(
                f"the clocks differ by {abs(clock['drift']):.2%}. The rates are on the clock of the table. "
                f"Check both clocks."
            )
    return tuple(lines)


def _check_idle(options: Mapping[str, object]) -> None:
    """Refuse options that do not apply to a calibration from motion."""
    used = [name for name, value in options.items() if value is not None]
    if used:
        raise InputError(
            f"calibrate: {' and '.join(f'`{name}`' for name in used)} cannot be used with `calibrate_from` motion. "
            f"Omit "
            f"{'it' if len(used) == 1 else 'them'}, or set another `calibrate_from`."
        )


def _motion_figures(calibrated: Calibrated, fit: "InMotion") -> list[dict[str, Any]]:
    """Return the offset of each recording with its uncertainty, and the remaining acceleration."""
    names = [name for name, _ in calibrated.session.inputs if not name.endswith(".toml")]
    labels = names if len(names) == len(fit.offsets) else [f"recording {k + 1}" for k in range(len(fit.offsets))]
    offsets, uncertainty = fit.offsets / RADIAN_PER_DEGREE, fit.offset_uncertainty / RADIAN_PER_DEGREE
    keys = ("recording", "offset_dps", "offset_uncertainty_dps", "acceleration_m_s2")
    rows = zip(labels, offsets, uncertainty, fit.acceleration, strict=True)
    return [dict(zip(keys, row, strict=True)) for row in rows]


def _motion_section(figures: list[dict[str, Any]]) -> Section:
    """Return the offset of each recording, and how the body's own acceleration disturbed it."""
    heads = ("recording", "x", "y", "z", "+-", "acceleration left in 5 s (m/s2)")
    rows = tuple(
        (
            str(row["recording"]), *(number(float(axis), ".3f") for axis in row["offset_dps"]),
            number(float(row["offset_uncertainty_dps"].max()), ".3f"), number(float(row["acceleration_m_s2"]), ".3f"),
        )
        for row in figures
    )  # fmt: skip
    return Section(title="Gyroscopes' offset of each recording, deg/s", columns=heads, rows=rows)


# ---- a calibration


def calibration_summary(calibration: "Calibration") -> Summary:
    """Return the content of a calibration: uncertainty, origin, matrices and offsets."""
    pictures = (figure_of("calibration:draw_calibration", calibration),)
    ideal = (*(departures_words(name, triad) for name, triad in _triads(calibration)), BARS)
    return Summary(
        title=f"Calibration of {calibration.device or 'a device'}",
        answer=answer_sentence(calibration),
        pictures=pictures,
        sections=(
            Section(title="What was calibrated", text=tuple(_origin(calibration))),
            uncertainty_section(calibration),
            Section(title="Matrix and offsets: departures", text=ideal, pictures=pictures, folded=True, on="page"),
            *(replace(section, folded="page") for section in calibration_sections(calibration)),
        ),
        verdict=calibration.verdict,
    )


def calibration_sections(calibration: "Calibration") -> tuple[Section, ...]:
    """Return matrix, offset and scale factor of each triad, values with their uncertainty."""
    field = () if calibration.magnetometer is None else (("magnetometer", calibration.magnetometer.model),)
    return tuple(
        Section(
            title=f"{NAMES.get(name, name).capitalize()}: {triad.method}",
            text=(
                f"corrected = matrix @ (raw - offset). The matrix is in {triad.unit_out} per {triad.unit_in}, "
                f"standard uncertainty of "
                "the last digits in brackets.",
                *_triad_notes(triad),
                *(_field_notes(calibration) if name == "magnetometer" else ()),
            ),
            columns=(
                "axis", "m x", "m y", "m z", f"offset ({triad.unit_in})",
                f"scale factor ({triad.unit_in} per {triad.unit_out})",
            ),
            rows=_triad_rows(triad),
        )
        for name, triad in (*_triads(calibration), *field)
    )  # fmt: skip


def _triads(calibration: "Calibration") -> "tuple[tuple[str, TriadModel], ...]":
    return tuple((name, triad) for name in NAMES if (triad := getattr(calibration, name)) is not None)


def _field_notes(calibration: "Calibration") -> Iterator[str]:
    """Yield what else is known of a magnetometer: its lag, its unit and its frame."""
    if (mag := calibration.magnetometer) is not None:
        lag = concise(1e3 * mag.lag_s, 1e3 * mag.lag_uncertainty_s)
        yield f"axes of the gyroscopes, which it lags by {lag} ms, with determinant 1: the magnitude of the field is as measured"


def _triad_rows(triad: "TriadModel") -> tuple[tuple[str, ...], ...]:
    sigma = dict(zip(triad.parameters, triad.standard_uncertainty, strict=True))
    return tuple(
        (
            axis,
            *(concise(triad.matrix[k, i], sigma.get(f"m_{axis}{other}", 0.0)) for i, other in enumerate("xyz")),
            concise(triad.offset[k], sigma.get(f"offset_{axis}", 0.0)),
            f"{triad.scale_factor[k]:.6g}",
        )
        for k, axis in enumerate("xyz")
    )


def _triad_notes(triad: "TriadModel") -> "Iterator[str]":
    """Yield the notes below the rows: residual, rank, condition, range, g-sensitivity."""
    low, high = triad.valid_range
    yield (
        f"residual {triad.rms_residual:.3g} {triad.unit_out} rms over {triad.count} equations; rank {triad.rank}, "
        f"condition {triad.condition:.3g}; valid {low:.3g} to {high:.3g} {triad.unit_out}"
    )
    if triad.moving_offset is not None:
        yield f"while it turns the offset is larger by {_each(triad, 'moving')} {triad.unit_out} (x, y, z) than at rest"
    if triad.code_offset is not None:
        yield f"added to readings with their sign, for what codes lose: {_each(triad, 'code')} {triad.unit_in} (x, y, z)"
    if triad.g_sensitivity is not None:
        yield f"g-sensitivity up to {float(abs(triad.g_sensitivity).max()):.2g} {triad.unit_out} per m/s2"


def _each(triad: "TriadModel", kind: str) -> str:
    """Return a parameter of each axis with its uncertainty."""
    rows = zip(triad.parameters, triad.values, triad.standard_uncertainty, strict=True)
    return ", ".join(concise(value, sigma) for name, value, sigma in rows if name.startswith(f"{kind}_"))


def _origin(calibration: "Calibration") -> Iterator[str]:
    """Yield device and gravity, phases found and used, sensors without calibration, and steps of the codes."""
    has_temperature, settings = math.isfinite(calibration.reference_temp_c), dict(calibration.provenance.settings)
    where = f" at {calibration.reference_temp_c:.1f} degC" if has_temperature else ""
    source = settings.get("gravity", "stated")
    how = {"standard": "standard, assumed", "latitude and height": "by latitude and height"}.get(source, source)
    yield f"{calibration.device or 'device without a serial number'}{where}, gravity {calibration.gravity_m_s2:.5f} m/s2 ({how})"
    if "stills" in settings:
        yield f"still phases: {settings['stills']}; faces: {settings['faces']}; turns: {settings['turns']}"
    yield from (f"{what}: not calibrated" for name, what in NAMES.items() if getattr(calibration, name) is None)
    for triad in calibration.triads if calibration.adc is not None else ():
        if triad.lsb is not None:
            steps = ", ".join(f"{step:.6g}" for step in triad.lsb)
            yield f"ADC {triad.sensor}: step {steps}, rounded {triad.rounding.replace('_', ' ')}"


# ---- a calibration judged by its own recordings


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CorrectedPiece:
    """A phase that a calibration used, with its corrected readings."""

    piece: "Piece"
    accel: "FloatArray"  # (3,), mean, m/s2, NaN without accelerometers
    gyro: "FloatArray"  # (3,), mean, rad/s, NaN without gyroscopes
    stated: "FloatArray"  # (3,), turn rate of the table, rad/s, NaN if unknown


def judge_pieces(
    session: "Session", pieces: "Sequence[Piece]", settings: "CalibrateSettings", calibration: "Calibration"
) -> tuple[list["Record"], list[CorrectedPiece]]:
    """Return the corrected records of a session, and the corrected phases that the calibration used."""
    import numpy as np

    from undrift.calibration.quality import settling
    from undrift.correction.correct import correct_whole

    # a triad that the calibration has no model of is left out: its unit may be counts
    lacking: dict[str, Any] = {} if calibration.gyro else {"gyro": None, "gyro_unit": "rad/s"}
    lacking |= {} if calibration.accel else {"accel": None, "accel_unit": "m/s2"}
    records = [
        correct_whole(replace(source, **lacking), calibration, policy="hold").record for source in session.records
    ]
    rates = {(turn.recording, turn.start): turn for turn in session.turns if turn.turn_rate is not None}
    unknown, judged = np.full(3, np.nan), []
    for piece in (piece for piece in pieces if not piece.why):
        record, turn = records[piece.recording], rates.get((piece.recording, piece.start))
        length = piece.stop - piece.start
        skip = settling(length, settings.settle_s, record.sample_rate_hz) if piece.kind == "turn" else 0
        inner = slice(piece.start + skip, max(piece.start + skip + 1, piece.stop))
        accel, gyro = (unknown if v is None else np.nanmean(v[inner], axis=0) for v in (record.accel, record.gyro))
        turn_rate = unknown if turn is None else (turn.turn_rate or 0.0) * np.eye(3)["xyz".index(turn.axis or "x")]
        judged.append(CorrectedPiece(piece=piece, accel=accel, gyro=gyro, stated=turn_rate))
    return records, judged


def leverages(judged: Sequence[CorrectedPiece], calibration: "Calibration") -> "FloatArray":
    """Return the information of each phase: its leverage over the rank, mean over the triads, (n,)."""
    import numpy as np

    shares = []
    for triad, name, kinds in ((calibration.accel, "accel", ("still",)), (calibration.gyro, "gyro", ("still", "turn"))):
        rows = np.array([np.append(getattr(item, name), 1.0) for item in judged if item.piece.kind in kinds])
        if triad is None or not len(rows) or np.isnan(rows).any():
            continue
        rows[:, :3] /= np.abs(rows[:, :3]).max()
        if triad.method.startswith("multi-position") and name == "accel":
            upper = np.triu_indices(3)
            rows = np.column_stack(((rows[:, :3, None] * rows[:, None, :3])[:, upper[0], upper[1]], rows[:, :3]))
        levers = np.einsum("ij,ji->i", rows, np.linalg.pinv(rows))
        share = np.zeros(len(judged))
        share[[k for k, item in enumerate(judged) if item.piece.kind in kinds]] = levers / levers.sum()
        shares.append(share)
    return np.mean(shares, axis=0) if shares else np.full(len(judged), np.nan)


def rests_of(calibrated: Calibrated) -> "tuple[FloatArray, FloatArray]":
    """Return |a|, m/s2, and |w|, deg/s, in the mean of each rest that was used, raw and corrected: (n, 2) each."""
    import numpy as np

    session, calibration = calibrated.session, calibrated.calibration
    judged = judge_pieces(session, calibrated.pieces, calibrated.settings, calibration)[1]
    rests, sizes = [item for item in judged if item.piece.kind == "still"], list["FloatArray"]()
    for name in ("accel", "gyro"):
        raw, triad = list[Any](), getattr(calibration, name)
        for piece in (item.piece for item in rests if triad is not None):
            readings = getattr(session.records[piece.recording], name)
            raw.append(np.nanmean(readings[piece.start : piece.stop], axis=0))
        sizes.append(raw_and_corrected(triad, triad and triad.unit_in, raw, [getattr(item, name) for item in rests]))
    return sizes[0], sizes[1]


def raw_and_corrected(triad: "TriadModel | None", unit: str, raw: Any, corrected: Any) -> "FloatArray":
    """Return the length of mean readings, (n, 3) each, raw and corrected: (n, 2), m/s2 or deg/s. Without a model it is
    empty.

    Raw readings keep their unit. Counts and volts are converted with the mean scale factor and the mean offset of the
    three axes.
    """
    import numpy as np

    if triad is None or not len(raw):
        return np.empty((0, 2))
    quantity: Quantity = "rate" if triad.unit_out == "rad/s" else "accel"
    scale = si_factor(unit, quantity) if is_physical(unit) else 1.0 / triad.scale_factor.mean()
    read = scale * (np.array(raw) - (0.0 if is_physical(unit) else triad.offset.mean()))
    sizes: FloatArray = np.linalg.norm((read, corrected), axis=2).T
    return sizes / (RADIAN_PER_DEGREE if quantity == "rate" else 1.0)


def draw_rests(calibrated: Calibrated) -> Any:
    """Draw each rest that was used, raw next to corrected."""
    return at("undrift.report.calibration:draw_rests")(*rests_of(calibrated), calibrated.calibration.gravity_m_s2)


def residuals(judged: Sequence[CorrectedPiece], calibration: "Calibration") -> tuple["FloatArray", "FloatArray"]:
    """Return |a| - g of each pose, mg, and rate errors of each dwell, deg/s (n, 3)."""
    import numpy as np

    norms = np.array(
        [np.linalg.norm(item.accel) - calibration.gravity_m_s2 for item in judged if item.piece.kind == "still"]
    )
    rates = np.array([item.gyro - item.stated for item in judged if item.piece.kind == "turn"]).reshape(-1, 3)
    poses, dwells = norms[np.isfinite(norms)], rates[np.isfinite(rates).all(axis=1)]
    return poses / (STANDARD_GRAVITY / 1e3), dwells / RADIAN_PER_DEGREE


def judged_sections(calibrated: Calibrated) -> Iterator[Section]:
    """Yield how the fit reproduces its readings, the specific force over the session, and what each recording brought."""
    calibration = calibrated.calibration
    records, judged = judge_pieces(calibrated.session, calibrated.pieces, calibrated.settings, calibration)
    poses, dwells = residuals(judged, calibration)
    parts = [f"gravity to {rms_of(poses):.2g} mg rms in {len(poses)} poses"] if len(poses) else []
    if len(dwells):
        parts.append(f"the table's rates to {rms_of(dwells):.2g} deg/s rms in {len(dwells)} dwells")
    if parts:
        text = f"The fit reproduces {' and '.join(parts)}. {RESIDUALS}"
        drawing = figure_of("calibration:draw_residuals", poses, dwells)
        yield Section(title="Residuals of the fit", text=(text,), pictures=(drawing,), folded=True)
    if calibration.accel is not None:
        text = "Shaded: the stills that were used. Turns and handling lie between them."
        drawing = figure_of("calibration:draw_norm", records, judged, calibration.gravity_m_s2)
        yield Section(title="Specific force over the session", text=(text,), pictures=(drawing,), folded=True)
    yield _contributions(calibrated, judged)


def _contributions(calibrated: Calibrated, judged: Sequence[CorrectedPiece]) -> Section:
    """Return what each recording brought to the fit."""
    session, shares = calibrated.session, leverages(judged, calibrated.calibration)
    names, rows = [name for name, _ in session.inputs if not name.endswith(".toml")], []
    for k, record in enumerate(session.records):
        here = [place for place, item in enumerate(judged) if item.piece.recording == k]
        used = [judged[place].piece for place in here]
        kinds = [piece.kind for piece in used]
        unused = sum(piece.recording == k and bool(piece.why) for piece in calibrated.pieces)
        name = names[k] if len(names) == len(session.records) else f"recording {k + 1}"
        samples = sum(piece.stop - piece.start for piece in used)
        counted = (len(record), samples, kinds.count("still"), kinds.count("turn"), unused)
        rows.append((name, *map(str, counted), number(100.0 * float(shares[here].sum()), ".1f")))
    heads = ("recording", "samples", "of them used", "stills used", "turns used", "pieces left out", "information (%)")
    drawing = Drawing(
        place="undrift.report.figures:draw_recording",
        of=(session.records, calibrated.pieces),
        options={"title": "What was used", "used": True},
    )
    return Section(
        title="What each recording contributed",
        text=(INFORMATION,),
        columns=heads,
        rows=tuple(rows),
        pictures=(drawing,),
        folded=True,
    )
