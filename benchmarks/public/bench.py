"""Poses, six faces, a rate table, a warm-up and noise: each method judged on readings that its fit did not see."""

import gzip
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from itertools import pairwise

import numpy as np

from benchmarks.public.table import DATA, Row, Table, by_others
from testkit.poses import fit_multi_position
from testkit.published_poses import fit_lengths, variance_with_rest
from testkit.stepper_jig import RUNS, turned
from undrift.arrays import FloatArray
from undrift.calibration.calibrate import calibrate
from undrift.calibration.noise import allan_deviation
from undrift.calibration.norm import MG, fit_norm, judged
from undrift.calibration.rate_table import fit_rate_table
from undrift.calibration.table import dwell_means
from undrift.drift.observe import RestBlocks, observe_rests
from undrift.drift.offset import fit_static
from undrift.model import TriadModel
from undrift.record import Record, Session, Still
from undrift.units import STANDARD_GRAVITY

NOTHING, SIMULATED = "nothing", "constants on simulated devices"


def loaded(*path: str, skip: int = 0, delimiter: str | None = None) -> FloatArray:
    """Return the numbers of a compressed table."""
    with gzip.open(DATA.joinpath(*path), "rt") as file:
        return np.loadtxt(file, skiprows=skip, delimiter=delimiter)


# ---- Free poses: length of gravity in poses that were left out

FOLDS = 5


def poses_of(name: str) -> Record:
    """Return a recording of free poses."""
    if name == "MTi":
        accel, gyro = (loaded("multipos_xsens", f"xsens_{what}.txt.gz") for what in ("acc", "gyro"))
        return Record(time=accel[:, 0], accel=accel[:, 1:], gyro=gyro[:, 1:], accel_unit="count", gyro_unit="count")
    log = loaded("multipos_mpu9150", f"imu{name[-1]}.log.gz")
    return Record(time=np.arange(len(log)) / 100.0, accel=log[:, :3], gyro=log[:, 3:])


def by_published_rule(record: Record, left_out: Sequence[Still]) -> TriadModel:
    """Return accelerometers by Tedaldi's rule: the threshold of the smallest summed cost, a second of each still."""
    assert record.accel is not None
    level = variance_with_rest(record, 50.0 if record.accel_unit == "count" else 3.0)
    second, fits = round(record.sample_rate_hz), []
    for multiple in range(2, 11):
        stills = [
            int(a)
            for a, b in level.below(multiple * level.at_rest, second)
            if not any(a < still.stop and b > still.start for still in left_out)
        ]
        if len(stills) >= 9:
            reading = np.concatenate([level.values[a : a + second] for a in stills])
            fit = fit_lengths(reading, STANDARD_GRAVITY, record.accel_unit)
            fits.append((float(fit.residuals @ fit.residuals), fit))
    return min(fits, key=lambda one: one[0])[1].model


def by_undrift(record: Record, left_out: Sequence[Still]) -> TriadModel:
    """Return accelerometers by the rests that were not left out."""
    rests = [still for still in found_poses(record) if still not in left_out]
    return fit_multi_position(record, gravity=STANDARD_GRAVITY, stills=rests, gyro=False).accel.model


def by_lengths_alone(record: Record, left_out: Sequence[Still]) -> TriadModel:
    """Return accelerometers by means of the same rests and their noise."""
    rests = [still for still in found_poses(record) if still not in left_out]
    samples = [np.asarray(record.accel)[still.start : still.stop] for still in rests]
    means, variances = np.array([x.mean(axis=0) for x in samples]), np.array([x.var(axis=0) / len(x) for x in samples])
    fit = fit_norm(means, gravity=STANDARD_GRAVITY, variances=variances)
    return judged(fit, means, record.accel_unit).model


@cache
def found_poses(record: Record) -> tuple[Still, ...]:
    """Return the rests of a recording."""
    return fit_multi_position(record, gravity=STANDARD_GRAVITY, gyro=False).stills


def length_error(record: Record, stills: Sequence[Still], model: TriadModel | None) -> FloatArray:
    """Return what gravity is too long in rests, m/s2."""
    means = np.array([np.asarray(record.accel)[still.start : still.stop].mean(axis=0) for still in stills])
    means = means if model is None else (means - model.offset) @ model.matrix.T
    return np.linalg.norm(means, axis=1) - STANDARD_GRAVITY


def poses() -> Table:
    """Return the length of gravity in poses left out, a fifth at a time."""
    names = ["MPU-9150 0", "MPU-9150 1", "MPU-9150 2", "MTi"]
    fits: dict[str, Callable[[Record, Sequence[Still]], TriadModel]] = {
        "published rule (Tedaldi, Pretto, Menegatti 2014)": by_published_rule,
        "lengths of the means, nine parameters": by_lengths_alone,
        "undrift, free poses": by_undrift,
    }
    residuals: dict[str, list[float]] = {name: [] for name in fits}
    for name in names:
        record = poses_of(name)
        rests = found_poses(record)
        for method, fit in fits.items():
            misses = [length_error(record, rests[k::FOLDS], fit(record, rests[k::FOLDS])) for k in range(FOLDS)]
            residuals[method].append(float(np.sqrt(np.mean(np.concatenate(misses) ** 2)) / MG))
    raw = [float(np.sqrt(np.mean(length_error(r, found_poses(r), None) ** 2)) / MG) for r in map(poses_of, names[:3])]
    return Table(
        name="poses", title="Free poses by hand: magnitude of gravity in poses left out", unit="mg",
        what="Each fifth of the poses is left out of the fit in turn. The error is the rms over the left-out poses. The raw "
        f"readings of the three MPU-9150 have a mean error of {np.mean(raw):.1f} mg.",
        source="imu-calib (Mikov et al., ICINS 2020, MIT) and imu_tk (Tedaldi et al., ICRA 2014, BSD)", recordings=names,
        rows=[Row(method=method, values=values, tuned=NOTHING) for method, values in residuals.items()],
    )  # fmt: skip


# Counts per m/s2 and per rad/s: certificate of the unit as the data set's authors print it, and what their program printed
CERTIFICATE = np.array([415.0, 413.0, 415.0, 4778.0, 4758.0, 4766.0])
PUBLISHED = np.array([414.459, 412.010, 414.649, 4777.96, 4764.21, 4773.66])


def certificate() -> Table:
    """Return how far the scale factors of the MTi are from its maker's certificate."""
    record = poses_of("MTi")
    fit = fit_multi_position(record, gravity=9.81744)
    assert fit.gyro is not None
    ours = 1.0 / np.concatenate([np.diag(model.matrix) for model in (fit.accel.model, fit.gyro.model)])
    return Table(
        name="certificate", title="Free poses by hand: scale factors against the maker's certificate (Xsens MTi)", unit="%",
        what="The values are absolute differences, for accelerometers and gyroscopes x, y, z. The certificate gives scale factors "
        "to 0.2 % for accelerometers and to 0.02 % for gyroscopes.",
        source="imu_tk (Tedaldi et al., ICRA 2014, BSD)",
        recordings=[f"{sensor} {axis}" for sensor in ("accelerometer", "gyroscope") for axis in "xyz"],
        rows=[
            Row(method=method, values=[float(x) for x in 100.0 * np.abs(scale / CERTIFICATE - 1.0)], tuned=tuned)
            for method, scale, tuned in (
                ("imu_tk 2014, its demonstration", PUBLISHED, "the demonstration's settings are those of this recording"),
                ("undrift, free poses", ours, NOTHING),
            )
        ],
    )  # fmt: skip


# ---- Six faces: length of gravity in five further poses

FACES = ("phi_270_theta_000", "phi_090_theta_000", "phi_000_theta_090", "phi_000_theta_270", "phi_000_theta_000",
    "phi_000_theta_180")  # fmt: skip
FURTHER = ("reference", "rsidedown", "rsideup", "sahfd01", "sahfu01")


def bicycle(name: str) -> Record:
    """Return one still recording of the MPU-6050 of a bicycle."""
    with np.load(DATA / "multipos_mpu6050_bicycle" / f"{name}.npz") as d:
        return Record(
            time=d["t_s"], gyro=d["gyro_rad_s"], accel=d["acc_raw"], accel_unit="count", temp_c=d["temp_degC"]
        )


def by_labels(records: Sequence[Record], means: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return undrift's matrix and offset from recordings whose faces are named."""
    faces = [f"{'-' if mean[np.abs(mean).argmax()] < 0.0 else '+'}{'xyz'[np.abs(mean).argmax()]}" for mean in means]
    stills = tuple(Still(start=0, stop=len(r), recording=k, face=faces[k]) for k, r in enumerate(records))  # type: ignore[arg-type]
    model = calibrate(
        Session(kind="calibration", serial="", gravity_m_s2=STANDARD_GRAVITY, records=tuple(records), stills=stills)
    ).accel
    assert model is not None
    return model.matrix, model.offset


def six_faces() -> Table:
    """Return the length of gravity in five poses that were not fitted."""
    records = [bicycle(name) for name in FACES]
    means = np.array([np.mean(r.accel, axis=0) for r in records])
    order = np.argsort(
        np.where(means.max(axis=1) > -means.min(axis=1), 2 * means.argmax(axis=1), 2 * means.argmin(axis=1) + 1)
    )
    faces = means[order]  # +x, -x, +y, -y, +z, -z
    up = STANDARD_GRAVITY * np.repeat(np.eye(3), 2, axis=0) * np.tile([1.0, -1.0], 3)[:, None]
    lean = float(np.degrees(np.arccos((np.abs(faces).max(axis=1) / np.linalg.norm(faces, axis=1)).min())))
    affine = np.linalg.lstsq(np.column_stack((up, np.ones(6))), faces, rcond=None)[0].T
    models = {"least squares of six faces (the note)": (np.linalg.inv(affine[:, :3]), affine[:, 3])}
    for name, result in by_others("six_faces", faces=faces, gravity=STANDARD_GRAVITY).items():
        models[name] = result[:, :3], result[:, 3]
    models["undrift, six faces"] = by_labels(records, means)
    further = np.array([np.mean(bicycle(name).accel, axis=0) for name in FURTHER])
    raw = np.linalg.norm(further, axis=1) / 16384.0 - 1.0
    rows = [Row(method="as read, sensitivity of the data sheet", values=list(1e3 * np.abs(raw)), tuned=NOTHING)]
    for method, (matrix, offset) in models.items():
        misses = np.linalg.norm((further - offset) @ matrix.T, axis=1) / STANDARD_GRAVITY - 1.0
        rows.append(Row(method=method, values=list(1e3 * np.abs(misses)), tuned=NOTHING))
    return Table(
        name="six-faces", title="Six faces: magnitude of gravity in five further poses (MPU-6050)", unit="mg",
        what=f"The board is mounted {lean:.0f} deg askew on the frame, so the verdict of undrift is bad. imucal also receives "
        "three perfect turns, because it requires turns.",
        source="robot.bicycle (Peterson 2013, BSD)", recordings=list(FURTHER), rows=rows,
    )  # fmt: skip


# ---- A rate table: one run fitted, the other judged


def dwells_of(run: str, sensor: str) -> tuple[FloatArray, FloatArray]:
    """Return commanded and mean measured rates of a run, deg/s."""
    record, turns = turned(run, sensor)
    means = np.array([np.asarray(record.gyro)[t.start : t.stop].mean(axis=0)[1] for t in turns])
    return np.degrees([turn.turn_rate for turn in turns]), means


def by_fit(run: str, sensor: str) -> tuple[float, float]:
    """Return undrift's scale and offset, deg/s."""
    record, turns = turned(run, sensor)
    model = fit_rate_table(dwell_means([record], turns)).model
    return float(model.forward_matrix[1, 1]) * np.pi / 180.0, float(model.offset[1])


def by_line(run: str, sensor: str) -> tuple[float, float]:
    """Return scale and offset of a straight line through the means."""
    slope, offset = np.polyfit(*dwells_of(run, sensor), 1)
    return float(slope), float(offset)


def rate_table() -> Table:
    """Return the error of the rates of a run by a fit to the other."""
    cases = [(sensor, run, RUNS[1 - k]) for sensor in ("bno", "lsm") for k, run in enumerate(RUNS)]
    methods: dict[str, Callable[[str, str], tuple[float, float]]] = {
        "as its logger converted": lambda run, sensor: (1.0, 0.0),
        "straight line through the means (the note)": by_line,
        "undrift, one axis of a rate table": by_fit,
    }
    residuals: dict[str, list[float]] = {name: [] for name in methods}
    for sensor, judged_run, other in cases:
        commanded, measured = dwells_of(judged_run, sensor)
        for method, fit in methods.items():
            scale, offset = fit(other, sensor)
            residuals[method].append(float(np.sqrt(np.mean(((measured - offset) / scale - commanded) ** 2))))
    return Table(
        name="rate-table", title="Rate table: error of the rates of a run, fitted to the other run", unit="deg/s",
        what="The error is the rms over seven rates of 60 to 720 deg/s about y. The logger of the LSM6 uses a wrong sensitivity.",
        source="Rimu_Test_Jig (Schneider 2018, Apache-2.0)",
        recordings=[f"{'BNO055' if sensor == 'bno' else 'LSM6'} {run[10:]}" for sensor, run, _ in cases],
        rows=[Row(method=method, values=values, tuned=NOTHING) for method, values in residuals.items()],
    )  # fmt: skip


# ---- A warm-up: every other minute fitted, the others judged

NODES = np.arange(10.0, 29.6, 0.5)


def blocks_of(record: Record, stills: Sequence[Still]) -> RestBlocks:
    """Return the ten-second means of stretches."""
    session = Session(kind="thermal", serial="", gravity_m_s2=STANDARD_GRAVITY, records=(record,), stills=tuple(stills))
    return observe_rests([session], temperatures=[[record.temp_c]])


def warm_up_record() -> Record:
    """Return the warm-up."""
    raw = loaded("thermal_mpu6050_warmup", "Tempdata01-02-14.csv.gz", skip=1, delimiter=",")
    return Record(
        time=1e-3 * raw[:, 12], gyro=raw[:, 3:6] / 16.4, accel=raw[:, :3] / 16384.0, temp_c=raw[:, 9] / 340.0 + 36.53,
        gyro_unit="dps", accel_unit="g",
    )  # fmt: skip


def warm_up() -> Table:
    """Return what tables of a warm-up leave of the minutes that they did not see."""
    record = warm_up_record()
    edges = np.searchsorted(record.time - record.time[0], np.arange(0.0, record.duration_s, 60.0))
    minutes = [Still(start=int(a), stop=int(b)) for a, b in pairwise(edges)]
    residuals: dict[str, list[float]] = {}
    for parity in (0, 1):
        learning, judged_on = (blocks_of(record, minutes[k::2]) for k in (parity, 1 - parity))
        table = fit_static(learning, nodes=NODES).table
        middle = learning.temp_c.mean()
        curves = {"constant": np.tile(learning.gyro.mean(axis=0), (len(judged_on.temp_c), 1))}
        for degree, name in ((1, "straight line"), (3, "cubic, as PX4 and ArduPilot store")):
            fitted = np.polyfit(learning.temp_c - middle, learning.gyro, degree)
            curves[name] = np.column_stack([np.polyval(c, judged_on.temp_c - middle) for c in fitted.T])
        curves["undrift, drift table"] = np.column_stack(
            [np.interp(judged_on.temp_c, NODES, column) for column in np.asarray(table.gyro_offset).T]
        )
        for name, offset in curves.items():
            rms = np.sqrt(((judged_on.gyro - offset) ** 2).mean(axis=0))
            residuals.setdefault(name, []).extend(1e3 * rms)
    return Table(
        name="warm-up", title="Warm-up by 18 K: gyroscope offset in minutes left out (MPU-6050)", unit="mdeg/s",
        what="The curves are fitted to every other minute. The error is the rms of the ten-second means in the other minutes, for "
        "each axis, and then with the minutes exchanged. It includes the noise and rounding of these means.",
        source="FreeIMU-Updates (2014, MIT)", recordings=[f"{axis}, {half} minutes" for half in ("odd", "even") for axis in "xyz"],
        rows=[
            Row(method=name, values=values, tuned=SIMULATED if name.startswith("undrift") else NOTHING)
            for name, values in residuals.items()
        ],
    )  # fmt: skip


# ---- Allan deviation


def allan() -> Table:
    """Return the Allan deviation of gyroscopes at rest at 1, 10 and 60 s."""
    rates = loaded("static_mpu6050", "example_data_tinit_calc.csv.gz", skip=5, delimiter=",")[:, 3:] / 131.0
    taus = np.array([1.0, 10.0, 60.0])
    deviations = by_others("allan", values=rates, hz=100.0, taus=taus)
    deviations["undrift"] = np.array([allan_deviation(column, 100.0, taus=list(taus)).deviation for column in rates.T])
    return Table(
        name="allan", title="Overlapping Allan deviation at rest, 449 s (MPU-6050)", unit="mdeg/s",
        what="These values are not errors: the programs must agree.", source="ImuCalibration (2026, MIT)",
        recordings=[f"{axis}, {tau:.0f} s" for axis in "xyz" for tau in taus],
        rows=[
            Row(method=name, values=[1e3 * float(v) for v in values.ravel()], tuned=NOTHING)
            for name, values in deviations.items()
        ],
    )  # fmt: skip


def tables() -> Iterator[Table]:
    """Yield each."""
    yield from (make() for make in (poses, certificate, six_faces, rate_table, warm_up, allan))
