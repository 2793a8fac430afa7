"""The rows: each reads a set, calibrates with undrift's defaults and with plain rivals, and compares both with the truth."""

from collections.abc import Callable, Sequence
from contextlib import suppress

import numpy as np
from scipy.io import loadmat

from authority import test_ferraris_goldens as ferraris
from authority import test_thermal_logs as thermal
from authority import test_unseen_sets as unseen
from benchmarks import broad, in_motion
from benchmarks.public import bench
from benchmarks.real.judge import Outcome, angle_about, apply_plain, fit_plain, held, lengths, rms
from testkit.data import data_path
from testkit.published_poses import fit_lengths
from testkit.stepper_jig import RUNS, turned
from undrift.arrays import FloatArray
from undrift.calibration.calibrate import calibrate, calibrate_from_motion
from undrift.calibration.norm import QUADRATIC_SD, fit_norm, judged
from undrift.correction.correct import correct
from undrift.correction.motion import fit_motion
from undrift.drift.offset import fit_static
from undrift.errors import InputError
from undrift.model import TriadModel
from undrift.orientation import OrientSettings, orient
from undrift.record import Record, Reference, Session, Turn
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY
from undrift.validation.agreement import Validation, validate_leave_one_out, validate_trials
from undrift.validation.trial import TrialSettings

Pairs = Sequence[tuple[Record, Reference]]
MG = 1e-3 * STANDARD_GRAVITY


# ---- beside optics, an encoder or a robot: each recording corrected by the others of its device


def plain_optics(trials: Pairs, settings: TrialSettings) -> Validation:
    """Return trials, each corrected by ordinary least squares to the references of the others."""
    fitted = [fit_plain([pair for pair in trials if pair is not left_out]) for left_out in trials]
    corrected = [(apply_plain(record.in_si(), fit), poses) for (record, poses), fit in zip(trials, fitted, strict=True)]
    return validate_trials(corrected, settings=settings)


def ends(name: str, *, optics: bool) -> Outcome:
    """Return end errors of trials of a set, of undrift and of plain rivals, deg.

    ``optics`` calibrates each trial by the optics of the others of its device, otherwise by their motion alone.
    """
    devices = [broad.pairs(d) for d in broad.DEVICES.values()] if name == "broad" else [in_motion.pairs(name)]
    rest, vqf = (
        TrialSettings(offset="rest"),
        TrialSettings(method="vqf"),
    )  # as the command validate; no rest changes nothing

    def corrected(pairs: Pairs) -> Validation:
        return validate_leave_one_out(pairs) if optics else in_motion.by_motion([*pairs], rest, ("",) * len(pairs))

    judged = [trial for pairs in devices for trial in corrected(pairs).trials]
    rivals: dict[str, Callable[[Pairs], Validation]] = {
        "rest offset": lambda pairs: validate_trials(pairs, settings=rest),
        "VQF on raw readings": lambda pairs: validate_trials(pairs, settings=vqf),
    }
    if optics:  # whoever has optics can also fit without undrift
        rivals["least squares to the optics of the others"] = lambda pairs: plain_optics(pairs, rest)
    errors: dict[str, float] = {}
    for rival, of_rival in rivals.items():
        with suppress(InputError):  # rates by a plain fit can be too far off for any comparison
            trials = [trial for pairs in devices for trial in of_rival(pairs).trials]
            errors[rival] = float(np.mean([trial.figures.end_total_deg for trial in trials]))
    stated = [(t.figures.end_total_deg, t.expected.end_interval_deg) for t in judged if t.expected is not None]
    return Outcome(
        error=float(np.mean([trial.figures.end_total_deg for trial in judged])), rivals=errors,
        inside=sum(low <= end <= high for end, (low, high) in stated), checks=len(stated),
        parts={f"{k + 1}": trial.figures.end_total_deg for k, trial in enumerate(judged)},
    )  # fmt: skip


def encoder(which: str, axis: int) -> Outcome:
    """Return the error of the angle over 25 min, rms, deg."""
    record, angle = unseen.encoder(which)
    si, same_sense = record.in_si(), np.sign(np.gradient(angle) @ record.gyro[:, axis])

    def missed(settings: OrientSettings) -> float:
        turned_deg = angle_about(orient(si, None, settings).q_nb, axis)
        error = turned_deg - same_sense * angle
        return rms(error - error.mean())

    offset = fit_motion(si, None).offset
    stated = np.degrees(np.sqrt(np.diagonal(offset.covariance, axis1=1, axis2=2))).max(axis=0)
    rotation = np.cumsum(record.gyro * np.diff(record.time, prepend=0.0)[:, None], axis=0)
    known = np.column_stack((angle, record.time, np.ones(len(angle))))
    true = np.linalg.lstsq(known, rotation, rcond=None)[0][1]
    return Outcome(
        error=missed(OrientSettings(offset="motion")),
        rivals={
            "data sheet": missed(OrientSettings()),
            "VQF on raw readings": missed(OrientSettings(method="vqf")),
        },
        **held(np.degrees(offset.rate).mean(axis=0) - true, stated),
    )


# ---- known turns and rates


def worst_scale(ours: FloatArray, uncertainty: FloatArray, truth: FloatArray, **rivals: FloatArray) -> Outcome:
    """Return the largest difference of scale factors from their truth, %."""
    off = 100.0 * (ours / truth - 1.0)
    return Outcome(
        error=float(np.abs(off).max()),
        rivals={
            name.replace("_", " "): float(np.abs(100.0 * (rival / truth - 1.0)).max()) for name, rival in rivals.items()
        },
        **held(off, 100.0 * uncertainty / np.abs(truth)),
        parts={f"{k + 1}": float(value) for k, value in enumerate(off)},
    )


def analog() -> Outcome:
    """Return gains by motion alone against those by optics."""
    model = calibrate_from_motion([unseen.analog()]).gyro
    assert model is not None
    nominal = 1e3 * unseen.NOMINAL
    return worst_scale(nominal * np.diag(model.matrix), nominal * model.standard_uncertainty[[0, 4, 8]],
        unseen.BY_OPTICS, data_sheet=np.full(3, nominal))  # fmt: skip


def tumble() -> Outcome:
    """Return the error of two turns by hand about z, deg, by a sphere by hand."""
    calibration = calibrate_from_motion([unseen.tumbled((-1.0, -1.0, 1.0))])
    turns = unseen.tumbled((-1.0, -1.0, 1.0), "rotate-ccw-around-z-pointing-up")

    def missed(record: Record) -> float:
        q = orient(record, None, OrientSettings()).q_nb
        return float(abs(abs(angle_about(q, 2)[-1]) - 720.0))

    return Outcome(error=missed(correct(turns, calibration, check=False)), rivals={"data sheet": missed(turns.in_si())})


def of_ferraris(which: str) -> Outcome:
    """Return scale factors of a Ferraris session against those that imucal printed."""
    first = which == "example"
    record, ranges = (ferraris.example if first else ferraris.annotated)()
    golden, angle_deg = (ferraris.EXAMPLE, -360.0) if first else (ferraris.ANNOTATED, 360.0)
    stills, turns = ferraris.pieces(ranges, angle_deg)
    calibration = calibrate(Session(kind="calibration", serial=which, gravity_m_s2=ferraris.G, records=(record,),
        stills=tuple(stills), turns=tuple(turns)))  # fmt: skip
    accel, gyro = calibration.accel, calibration.gyro
    assert accel is not None
    assert gyro is not None
    truth = np.concatenate([np.diag(golden["K_a"]), np.diag(golden["K_g"])])
    ours = np.concatenate((accel.scale_factor, gyro.scale_factor * RADIAN_PER_DEGREE))
    relative = np.concatenate([m.standard_uncertainty[[0, 4, 8]] / np.abs(np.diag(m.matrix)) for m in (accel, gyro)])
    sheet = np.ones(6) if first else np.repeat([2048.0 / ferraris.G, 16.4], 3)
    return worst_scale(ours, relative * ours, truth, data_sheet=sheet)


def cvut_turns() -> Outcome:
    """Return gains by one turn about each axis against the published gains."""
    rates = loadmat(data_path("poses_and_turns_cvut", "rates.mat"))
    angles = (361.338, 367.160, 363.670)
    records, turns, plain = [], [], []
    for k, (axis, angle) in enumerate(zip("xyz", angles, strict=True)):
        gyro = rates[f"{axis}_rotation"]
        records.append(Record(time=np.arange(len(gyro)) / 100.0, gyro=gyro, gyro_unit="dps"))
        moving = np.flatnonzero(np.abs(gyro[:, k]) > 5.0)
        start, stop = int(moving[0]) - 20, int(moving[-1]) + 20
        turns.append(Turn(start=start, stop=stop, axis=axis, angle=np.radians(angle), recording=k))  # type: ignore[arg-type]
        rest = np.concatenate((gyro[:start, k], gyro[stop:, k])).mean()
        plain.append(angle / (np.sum(gyro[start:stop, k] - rest) / 100.0))
    session = Session(kind="calibration", serial="cvut", gravity_m_s2=STANDARD_GRAVITY, records=tuple(records),
        turns=tuple(turns))  # fmt: skip
    model = calibrate(session).gyro
    assert model is not None
    gains = np.diag(model.matrix) / RADIAN_PER_DEGREE
    return worst_scale(gains, model.standard_uncertainty[[0, 4, 8]] / RADIAN_PER_DEGREE,
        np.array([1.005, 1.0, 0.9945]), data_sheet=np.ones(3), rest_offset_and_angle=np.array(plain))  # fmt: skip


def jig(sensor: str) -> Outcome:
    """Return the error of seven rates of a run, by a fit to the other run, rms, deg/s."""
    ours, plain, sheet, differences, uncertainties = [], [], [], [], []
    for run, other in zip(RUNS, RUNS[::-1], strict=True):
        record, turns = turned(other, sensor)
        model = calibrate(
            Session(kind="calibration", serial="jig", gravity_m_s2=9.81, records=(record,), turns=turns)
        ).gyro
        assert model is not None
        commanded, measured = bench.dwells_of(run, sensor)
        centred = measured - model.offset[1]
        corrected = np.degrees(model.matrix[1, 1] * centred)
        rows = [4, 10]  # m_yy and offset_y
        slopes = np.column_stack((centred, np.full(len(centred), -model.matrix[1, 1])))
        covariance = model.covariance[np.ix_(rows, rows)]
        uncertainties.append(np.degrees(np.sqrt(np.einsum("ki,ij,kj->k", slopes, covariance, slopes))))
        differences.append(corrected - commanded)
        scale, offset = bench.by_line(other, sensor)
        ours.append(rms(corrected - commanded))
        plain.append(rms((measured - offset) / scale - commanded))
        sheet.append(rms(measured - commanded))
    return Outcome(
        error=float(np.mean(ours)),
        rivals={"data sheet": float(np.mean(sheet)), "straight line": float(np.mean(plain))},
        **held(np.concatenate(differences), np.concatenate(uncertainties)),
    )


# ---- gravity in poses that were left out


def left_out(
    means: FloatArray, unit: str, folds: int, fit: Callable[[FloatArray, FloatArray], TriadModel | None]
) -> FloatArray:
    """Return errors of gravity in poses left out, their uncertainty, and errors of plain least squares, mg, (3, K).

    ``fit`` gets the poses that are left out and those that remain. The plain fit has nine parameters and equal weights.
    """
    columns = np.empty((3, len(means)))
    for fold in range(folds):
        out = np.arange(len(means)) % folds == fold
        model, plain = fit(out, ~out), fit_lengths(means[~out], STANDARD_GRAVITY, unit).model
        assert model is not None
        columns[:2, out] = lengths(means[out], model)
        columns[2, out] = lengths(means[out], plain)[0]
    return (columns - np.array([[STANDARD_GRAVITY], [0.0], [STANDARD_GRAVITY]])) / MG


def gravity(columns: Sequence[FloatArray], sheet_mg: FloatArray | None) -> Outcome:
    """Return the row of results of `left_out`, and of the readings by the data sheet."""
    ours, uncertainty, plain = np.concatenate(columns, axis=1)
    rivals = {"least squares of lengths": rms(plain)}
    if sheet_mg is not None:
        rivals["data sheet"] = rms(sheet_mg)
    return Outcome(error=rms(ours), rivals=rivals, **held(ours, uncertainty))


def poses(*names: str) -> Outcome:
    """Return the length of gravity in poses by hand, a fifth left out at a time, rms, mg."""
    columns, raw = [], []
    for name in names:
        record = bench.poses_of(name)
        rests = bench.found_poses(record)
        means = np.array([np.asarray(record.accel)[still.start : still.stop].mean(axis=0) for still in rests])
        columns.append(left_out(means, record.accel_unit, bench.FOLDS,
            lambda out, _: bench.by_undrift(record, [rests[k] for k in np.flatnonzero(out)])))  # fmt: skip  # noqa: B023
        raw.append((np.linalg.norm(means, axis=1) - STANDARD_GRAVITY) / MG)
    return gravity(columns, None if "MTi" in names else np.concatenate(raw))


def cvut_poses() -> Outcome:
    """Return the length of gravity in a fifth of 24 poses, each in turn, rms, mg."""
    means = STANDARD_GRAVITY * loadmat(data_path("poses_and_turns_cvut", "acc24.mat"))["ACC_meas"].T

    def fit(_: FloatArray, rest: FloatArray) -> TriadModel:
        known = means[rest]
        weighted = fit_norm(
            known, gravity=STANDARD_GRAVITY, variances=np.full(known.shape, 1e-8), quadratic_sd=QUADRATIC_SD
        )
        return judged(weighted, known, "m/s2").model

    return gravity([left_out(means, "m/s2", bench.FOLDS, fit)], (np.linalg.norm(means, axis=1) - STANDARD_GRAVITY) / MG)


def bicycle() -> Outcome:
    """Return the length of gravity in each of eleven recordings, calibrated by the other ten, rms, mg."""
    records = [bench.bicycle(name) for name in (*bench.FACES, *bench.FURTHER)]
    means = np.array([np.mean(record.accel, axis=0) for record in records])
    columns = left_out(means, "count", len(records),
        lambda _, rest: calibrate(*(records[k] for k in np.flatnonzero(rest))).accel)  # fmt: skip
    return gravity([columns], 1e3 * (np.linalg.norm(means, axis=1) / 16384.0 - 1.0))


def certificate() -> Outcome:
    """Return scale factors of the MTi against its certificate, %."""
    calibration = calibrate(bench.poses_of("MTi"), gravity_m_s2=9.81744)
    models = [model for model in (calibration.accel, calibration.gyro) if model is not None]
    ours = 1.0 / np.concatenate([np.diag(model.matrix) for model in models])
    relative = np.concatenate([m.standard_uncertainty[[0, 4, 8]] / np.abs(np.diag(m.matrix)) for m in models])
    rounded = 0.5 / np.sqrt(3.0)  # counts: the certificate's last digit
    uncertainty = np.hypot(relative * ours, rounded)
    return worst_scale(ours, uncertainty, bench.CERTIFICATE, published_answer=bench.PUBLISHED)


# ---- temperature


def warm_up() -> Outcome:
    """Return the offset in minutes that were left out, rms, mdeg/s."""
    record = bench.warm_up_record()
    by_method = {row.method: rms(np.array(row.values)) for row in bench.warm_up().rows}
    parts = [thermal.left(record, 60.0, parity, bench.NODES) for parity in (0, 1)]
    return Outcome(
        error=by_method.pop("undrift, drift table"),
        rivals=by_method,
        **held(np.concatenate([part[0] for part in parts]), np.concatenate([part[2] for part in parts])),
    )


def plateaus() -> Outcome:
    """Return slopes of two plateaus against the author's, largest difference, mdeg/s/K."""
    records = [thermal.read_two_point(f"BMI_270_{name}_test.csv.gz") for name in ("cold", "hot")]
    blocks = thermal.blocks_of(thermal.thermal(*records))
    fit = fit_static(blocks, nodes=np.arange(13.0, 50.1, 0.5))
    truth = np.array([19.1, 12.9, -1.5])
    cold, hot = (np.append(np.mean(r.gyro, axis=0), np.mean(r.temp_c)) for r in records)
    plain = 1e3 * (hot - cold)[:3] / (hot - cold)[3]
    off = 1e3 * fit.gyro.slope - truth
    return Outcome(
        error=float(np.abs(off).max()),
        rivals={
            "data sheet (none)": float(np.abs(truth).max()),
            "line through two means": float(np.abs(plain - truth).max()),
        },
        **held(off, 1e3 * fit.gyro.slope_uncertainty),
    )


ROWS: dict[str, Callable[[], Outcome]] = {
    "broad-optics": lambda: ends("broad", optics=True),
    "broad-motion": lambda: ends("broad", optics=False),
    "chain-optics": lambda: ends("chain", optics=True),
    "chain-motion": lambda: ends("chain", optics=False),
    "pendulum-optics": lambda: ends("pendulum", optics=True),
    "pendulum-motion": lambda: ends("pendulum", optics=False),
    "robot-carpus": lambda: ends("carpus", optics=True),
    "robot-radius": lambda: ends("radius", optics=True),
    "encoder-yaw": lambda: encoder("yaw", 2),
    "encoder-roll": lambda: encoder("roll", 0),
    "analog-gains": analog,
    "ferraris-example": lambda: of_ferraris("example"),
    "ferraris-annotated": lambda: of_ferraris("annotated"),
    "cvut-turns": cvut_turns,
    "tumble-turns": tumble,
    "jig-bno": lambda: jig("bno"),
    "jig-lsm": lambda: jig("lsm"),
    "poses-mpu9150": lambda: poses("MPU-9150 0", "MPU-9150 1", "MPU-9150 2"),
    "poses-mti": lambda: poses("MTi"),
    "mti-certificate": certificate,
    "cvut-poses": cvut_poses,
    "bicycle-poses": bicycle,
    "warm-up": warm_up,
    "two-plateaus": plateaus,
}
