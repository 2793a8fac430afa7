"""What wearing does to a sensor, measured: soft tissue, impacts, vibration; and which cut-off they call for.

    phi' = s / (s^2 + 2 z w s + w^2) sum_k m_k a_k        rotation rate against the bone of a sensor whose bone accelerates by a

is fitted by least squares over spectra for each w and z of a grid (m in 1/m; m / w^2 is the rotation by an acceleration below
resonance): to the difference between a sensor on foam and one fixed beside it (chain_with_optics, with angular accelerations
too), and to the instant at which the wearer of a low-back sensor sits down heavily (worn_lowback), there by the vertical
acceleration alone.
``python -m benchmarks.soft_tissue`` prints the sizes, ``--cutoffs`` the error of each cut-off with and without
them, ``--lags`` what they do to a delay that is found.
"""

import argparse
import gzip
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.signal import butter, detrend, find_peaks, sosfiltfilt, welch

from testkit.data import data_path
from undrift.arrays import FloatArray
from undrift.frames import quaternion_conjugate, quaternion_product, rotate, rotation_vector
from undrift.sim.motion.poses import fit_pose_spline
from undrift.sim.motion.tasks import draw_task
from undrift.sim.motion.worn import AT_L5, WornErrors, wear_on_skin
from undrift.study.case import Unit, delay_of, make_case, perform, run_unit
from undrift.study.plan import SKIN, note_study, read_poses
from undrift.study.space import Setting
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

FOAM_HZ, WORN_HZ = 40.0, 100.0
FASTER_HZ = 8.0  # what is faster is not the body's motion in these tasks


class Spring(NamedTuple):
    """A fitted resonance."""

    frequency_hz: float
    damping: float  # Relative to critical
    per_m: FloatArray  # m, 1/m (and of angular accelerations, without a unit)
    explained: float  # Share of the mean square


def fit_spring(rate: FloatArray, drives: FloatArray, sample_rate_hz: float, band_hz: tuple[float, float]) -> Spring:
    """Fit a resonance to a rate (N,), rad/s, and what drives it (N, k)."""
    size = 4 * len(rate)
    frequency = np.fft.rfftfreq(size, 1.0 / sample_rate_hz)
    inside = (frequency > band_hz[0]) & (frequency < band_hz[1])
    s = 2.0j * np.pi * frequency[inside]
    target, sources = (np.fft.rfft(detrend(x, axis=0), size, axis=0)[inside] for x in (rate, drives))
    best: Spring | None = None
    for f in np.arange(5.0, 30.0, 0.5):
        for z in np.arange(0.02, 1.0, 0.01):
            w = 2.0 * np.pi * f
            ways = (s / (s * s + 2.0 * z * w * s + w * w))[:, None] * sources
            real, wanted = (np.concatenate((x.real, x.imag)) for x in (ways, target))
            per_m = np.linalg.lstsq(real, wanted, rcond=None)[0]
            explained = 1.0 - float(((wanted - real @ per_m) ** 2).sum() / (wanted**2).sum())
            if best is None or explained > best.explained:
                best = Spring(float(f), float(z), per_m, explained)
    if best is None:
        raise ValueError("wanted a band with frequencies")
    return best


def table(name: str) -> FloatArray:
    """Return the first six numeric columns behind the first of a table in the data folder."""
    with gzip.open(data_path(*name.split("/")), "rt") as file:
        rows = [line.split(",") for line in file if line[0] in "-0123456789"]
    first = 1 if name.startswith("worn") else 0
    return np.array([[float(cell) for cell in row[first : first + 6]] for row in rows])


def foam() -> None:
    """Print the resonance of a sensor on foam."""
    for trial in (1, 2):
        fixed, soft = (table(f"chain_with_optics/seg2_trial{trial}_{kind}.csv.gz") for kind in ("imu", "imu_soft"))
        left, _, right = np.linalg.svd(soft[:, 3:].T @ fixed[:, 3:])
        force, rate = fixed[:, :3] @ (left @ right).T, fixed[:, 3:] @ (left @ right).T
        drives = np.column_stack((force, np.gradient(rate, 1.0 / FOAM_HZ, axis=0)))
        for axis, across in ((0, 1), (1, 0)):  # z is outward: it turns about x by what is across, along y
            spring = fit_spring(soft[:, 3 + axis] - rate[:, axis], drives, FOAM_HZ, (3.0, 19.0))
            print(f"foam, trial {trial}, about {'xy'[axis]}: {_words(spring, across)}")


def _words(spring: Spring, drive: int) -> str:
    per_m = spring.per_m[drive]
    size = abs(per_m) / (2.0 * np.pi * spring.frequency_hz) ** 2 / RADIAN_PER_DEGREE
    return (
        f"{spring.frequency_hz:.1f} Hz, damping {spring.damping:.2f}, {per_m:.1f} 1/m = {size:.3f} deg per m/s2 below "
        f"resonance, explains {100.0 * spring.explained:.0f} %"
    )


def worn() -> None:
    """Print what a sensor at the low back reads of tissue, impacts and vibration."""
    rows = table("worn_lowback/HA_001_Test11.csv.gz")  # x up, y across, z along
    force, rate = rows[:, :3] * STANDARD_GRAVITY, rows[:, 3:] * RADIAN_PER_DEGREE
    fast = sosfiltfilt(butter(2, FASTER_HZ, "high", fs=WORN_HZ, output="sos"), np.column_stack((force, rate)), axis=0)
    peak = int(np.abs(fast[:, 0]).argmax())
    heavy = slice(peak - 9, peak + 23)
    spring = fit_spring(rate[heavy, 1], force[heavy, :1], WORN_HZ, (2.0, 45.0))
    print(
        f"low back, sits down heavily at {peak / WORN_HZ:.1f} s ({np.abs(fast[peak, 0]) / STANDARD_GRAVITY:.1f} g, "
        f"{np.abs(fast[heavy, 4]).max() / RADIAN_PER_DEGREE:.0f} deg/s): {_words(spring, 0)}"
    )
    places, _ = find_peaks(fast[:, 0], distance=40, height=0.02 * STANDARD_GRAVITY)
    sizes = np.percentile(fast[places, 0] / STANDARD_GRAVITY, (50.0, 95.0, 99.0))
    print(
        "low back, peaks of vertical acceleration above 8 Hz: median {:.2f}, 95 % {:.2f}, 99 % {:.2f} g".format(*sizes)
    )
    frequency, power = welch(rate, WORN_HZ, nperseg=512, axis=0)
    above = frequency > FASTER_HZ
    angle = np.sqrt((power[above] / (2.0 * np.pi * frequency[above, None]) ** 2).sum(axis=0) * frequency[1])
    print(
        f"low back, all that turns it above 8 Hz: {angle / RADIAN_PER_DEGREE} deg rms about x, y, z: at most so much is tissue"
    )
    rest = welch(rate[:250], WORN_HZ, nperseg=128, axis=0)
    noise = np.sqrt(rest[1][rest[0] > 25.0].sum(axis=0) * rest[0][1]) / RADIAN_PER_DEGREE
    print(f"low back, at rest above 25 Hz: {noise} deg/s rms")


def captured() -> None:
    """Print how much the pelvis is accelerated upward in captures, markers below 6 Hz."""
    for name in ("mocap_sit_to_stand/STS1.trc.gz", "mocap_stair_up/markers_StairUp3.trc.gz"):
        path = Path(data_path(*name.split("/")))
        spline = fit_pose_spline(read_poses(path, body="pelvis", markers=(), up="y"), SKIN)
        motion = spline.at(np.arange(spline.span_s[0] + 0.5, spline.span_s[1] - 0.5, 0.01), STANDARD_GRAVITY)
        up = rotate(motion.q_nb, motion.force_b)[:, 2] - STANDARD_GRAVITY
        print(f"pelvis, {name}: {np.nanmin(up):.1f} to {np.nanmax(up):.1f} m/s2 upward")


def simulated(count: int = 12) -> None:
    """Print the same of simulated people with the measured sizes."""
    for name in ("sit_to_stand", "step"):
        tissue, fast = [], []
        for seed in range(count):
            task = draw_task(name, rng=np.random.default_rng(seed))  # type: ignore[arg-type]
            sensor = wear_on_skin(task, AT_L5, np.random.default_rng(seed), STANDARD_GRAVITY)
            bone = task.at(sensor.time, STANDARD_GRAVITY)
            angle = rotation_vector(quaternion_product(quaternion_conjugate(bone.q_nb), sensor.q_nb))[:, 1]
            moving = (sensor.time > task.moving_s[0]) & (sensor.time < task.moving_s[1])
            tissue.append(np.sqrt((angle[moving] ** 2).mean()))
            filtered = sosfiltfilt(butter(2, FASTER_HZ, "high", fs=800.0, output="sos"), angle)[moving]
            fast.append(np.sqrt((filtered**2).mean()))
        sizes = np.median(tissue) / RADIAN_PER_DEGREE, np.median(fast) / RADIAN_PER_DEGREE
        print("simulated {}: tissue {:.3f} deg rms, above 8 Hz {:.3f}".format(name, *sizes))


TRIALS: dict[str, WornErrors] = {
    "fixed": WornErrors(vibration=1e-12),  # on the fine grid of the others
    "low back": AT_L5,
    "low back, 2.5 g": replace(AT_L5, impact=2.5 * STANDARD_GRAVITY),
    "foam": replace(AT_L5, tissue=0.32 * RADIAN_PER_DEGREE, tissue_hz=12.0, tissue_damping=0.08),
    "vibration 95 Hz": replace(AT_L5, vibration=50.0 * RADIAN_PER_DEGREE, vibration_hz=95.0),
}
CUTOFFS_HZ = (2.0, 3.0, 5.0, 8.0, 11.1, 14.0, 20.0, 30.0, 45.0)


def cutoffs(subjects: int) -> None:
    """Print the mean error of each cut-off, the note's rates, two set-points: in real time and offline."""
    for name, trial in TRIALS.items():
        study = replace(note_study(subjects=subjects), trial=trial)
        for task in study.tasks:
            space = replace(task.space, cutoff_hz=CUTOFFS_HZ)
            point = space.first.copy()
            point[0, space.names.index("set_points")] = 2.0
            errors = np.empty((len(CUTOFFS_HZ), subjects, 2))
            for row, cutoff_hz in enumerate(CUTOFFS_HZ):
                point[0, 0] = cutoff_hz
                part = replace(task, space=space.narrowed(point))
                for subject in range(subjects):
                    unit = Unit(study=study, task=part, subject=subject, setting=part.space.settings()[0])
                    runs = run_unit(unit)
                    errors[row, subject] = runs["error_rms_deg"][0], runs["error_offline_rms_deg"][0]
            for timing, mean in zip(("real time", "offline"), errors.mean(axis=1).T, strict=True):
                cells = " | ".join(f"{value:.3f}" for value in mean)
                print(f"| {name} | {task.name} | {timing} | {cells} | {CUTOFFS_HZ[int(mean.argmin())]:g} |", flush=True)


def lags(subjects: int) -> None:
    """Print by how much a delay that is found by cross-correlation with the bone's poses differs from the true one, ms."""
    for name in ("fixed", "low back", "low back, 2.5 g"):
        study = replace(note_study(subjects=subjects), trial=TRIALS[name])
        for task in study.tasks[:2]:
            apart = []
            for subject in range(subjects):
                case, (performed, _) = make_case(study, task, subject, Setting(20.0)), perform(study, task, subject)
                q_nb = performed.at(case.record.time, STANDARD_GRAVITY).q_nb
                apart.append(1e3 * abs(delay_of(case.record, q_nb) - case.delay_s))
            print(f"{name}, {task.name}: delay wrong by {np.median(apart):.1f} ms, at most {max(apart):.0f}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cutoffs", action="store_true")
    parser.add_argument("--lags", action="store_true")
    parser.add_argument("--subjects", type=int, default=12)
    asked = parser.parse_args()
    if asked.cutoffs:
        cutoffs(asked.subjects)
    elif asked.lags:
        lags(asked.subjects)
    else:
        foam()
        worn()
        captured()
        simulated()
