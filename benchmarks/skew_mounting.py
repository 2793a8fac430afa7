"""What a skew mounting costs and gives: scale over temperature from one mounting in place of three.

The device is turned about (1, 1, 1) / sqrt(3) of its case, so that all three gyroscopes turn at 0.58 of the table's rate. With K
the forward matrix and a that axis, one mounting at temperature T shows, of each sensor i, its offset and the sum along a::

    (K(T) a)_i = sum_j K_ij(T) a_j                 scale_i(T) / scale_i(T0) = (K(T) a)_i / (K(T0) a)_i + cross_i(T)
    cross_i(T) = - sum_(j not i) (K_ij(T) - K_ij(T0)) / K_ii                    not observable

T0 is room temperature, where the skew mounting is turned too before the chamber is used: what the mounting is off (1, 1, 1)
cancels. The whole matrix at T0 comes from the faces and the rates about x, y and z, which need no soak. Changes of cross-axis
terms with the temperature stay unknown: they count as sqrt(2) |T - T0| ``CROSS_PER_K``. The plain session turns about x, y and z at
every set-point. ``python -m benchmarks.skew_mounting`` prints minutes, errors and coverage.
"""

import argparse
from dataclasses import replace

import numpy as np

from undrift.arrays import FloatArray
from undrift.rig.programme import Protocol, programme_of
from undrift.sim.bench_errors import BenchErrors
from undrift.sim.device.model import DeviceModel
from undrift.sim.device.presets import random_device_of
from undrift.sim.device.truth import true_calibration
from undrift.sim.table_sessions import ImposedDwells, mean_readings, numbers_of_dwell
from undrift.study.plan import NOTE_BENCH, SET_POINTS_C
from undrift.units import RADIAN_PER_DEGREE, STANDARD_GRAVITY

DPS = RADIAN_PER_DEGREE
ROOM_C = 25.0
CROSS_PER_K = 2e-5  # 1/K, one standard deviation [assumed]: a tenth of 1 % over 60 K
DWELL_S, REST_S, STEP_S = 2.0, 6.0, 3.0
NOTES = Protocol(
    turn_rate_min=5.0 * DPS,
    turn_rate_max=90.0 * DPS,
    turn_rate_step=5.0 * DPS,
    grid="paper",
    dwell_s=DWELL_S,
    bracket_s=REST_S,
    temperatures_c=SET_POINTS_C,
    faces_at="room",
)
RATES = np.concatenate([[0.0], *([rate, -rate] for rate in np.arange(10.0, 91.0, 5.0) * DPS), [0.0]])


def minutes() -> tuple[float, float]:
    """Return the forecast of the plain session and of the skew one."""
    room = programme_of(replace(NOTES, faces_at="every", temperatures_c=()))
    # one mounting through the set-points, as about any one axis; and its rates at room temperature first
    swept = programme_of(replace(NOTES, faces=(), axes=("x",)))
    once = programme_of(replace(NOTES, faces=(), axes=("x",), temperatures_c=()))
    return programme_of(NOTES).duration_s / 60.0, (room.duration_s + swept.duration_s + once.duration_s) / 60.0


def block(
    device: DeviceModel,
    axis_b: FloatArray,
    temp_c: float,
    start_s: float,
    rng: np.random.Generator,
    errors: BenchErrors,
) -> tuple[FloatArray, FloatArray, float]:
    """Turn about an axis of the case (3,), rests before and after: rates of the encoder (N,), readings (N, 3), temperature."""
    length = np.where(RATES == 0.0, REST_S, DWELL_S)
    true = RATES + np.where(RATES == 0.0, 0.0, errors.servo * rng.standard_normal(len(RATES)) / length)
    count = 2.0 * np.pi / (4.0 * errors.encoder_lines)
    read = np.floor(rng.random(len(RATES)) + true * length / count) * count / length
    about = axis_b + np.cross(errors.wobble * rng.standard_normal((len(RATES), 3)), axis_b)
    board_c = temp_c + errors.soak_k * rng.standard_normal()
    dwells = ImposedDwells(
        start_s=start_s + np.cumsum(length + STEP_S) - length,
        duration_s=length,
        rate_b=true[:, None] * about,
        force_b=np.tile(STANDARD_GRAVITY * axis_b, (len(RATES), 1)),
        temp_c=np.full(len(RATES), board_c),
    )
    normals = rng.standard_normal((len(RATES), 3, numbers_of_dwell(device.gyro)))
    return read, mean_readings(device, "gyro", dwells, normals, np.arange(len(RATES))), board_c


def slopes(rate: FloatArray, reading: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return reading per rate of each sensor (3,) and its standard uncertainty, by a cubic: readings bend with the rate."""
    top = np.abs(rate).max()
    design = (rate / top)[:, None] ** np.arange(4)
    theta, squares, _, _ = np.linalg.lstsq(design, reading, rcond=None)
    return theta[1] / top, np.sqrt(squares / (len(rate) - 4) * np.linalg.inv(design.T @ design)[1, 1]) / top


def tilted(axis_b: FloatArray, rng: np.random.Generator, errors: BenchErrors) -> FloatArray:
    """Return an axis as it is mounted."""
    off = axis_b + np.cross(errors.mount_tilt * rng.standard_normal(3), axis_b)
    return np.asarray(off / np.linalg.norm(off))


def unit(seed: int, cross_per_k: float) -> tuple[FloatArray, FloatArray]:
    """Return error and standard uncertainty of each scale factor over temperature (2, 5, 3), plain and skew, relative."""
    rng = np.random.default_rng(seed)
    device = random_device_of("enc03j_3031", rng)
    change = cross_per_k * rng.standard_normal((3, 3)) * (1.0 - np.eye(3))

    def at(temp_c: float) -> DeviceModel:
        scale = device.gyro.scale
        return replace(
            device,
            gyro=replace(device.gyro, scale=replace(scale, cross_axis=scale.cross_axis + change * (temp_c - ROOM_C))),
        )

    def own(temp_c: float) -> FloatArray:
        model = true_calibration(at(temp_c), temp_c=temp_c).gyro
        assert model is not None
        return np.diag(np.linalg.inv(model.matrix))

    errors, start_s = NOTE_BENCH, 1800.0
    found, stated = np.zeros((2, len(SET_POINTS_C), 3)), np.zeros((2, len(SET_POINTS_C), 3))
    visits = (ROOM_C, *SET_POINTS_C)
    for which, axes in enumerate((np.eye(3), np.ones((1, 3)) / np.sqrt(3.0))):
        for nominal in axes:
            mounted, base, doubt = tilted(nominal, rng, errors), np.ones(3), np.zeros(3)
            shown = nominal != 0.0
            for k, temp_c in enumerate(visits):
                start_s += 1800.0
                calm = replace(errors, soak_k=0.0) if k == 0 else errors
                rate, reading, board_c = block(at(temp_c), mounted, temp_c, start_s, rng, calm)
                value, sd = slopes(rate, reading)
                if k == 0:
                    base, doubt = value, sd / value
                    continue
                off = value / base / (own(board_c) / own(ROOM_C)) - 1.0
                cross = which * np.sqrt(2.0) * CROSS_PER_K * abs(board_c - ROOM_C)
                found[which, k - 1, shown] = off[shown]
                stated[which, k - 1, shown] = np.sqrt((sd / value) ** 2 + doubt**2 + cross**2)[shown]
    return found, stated


def main() -> None:
    """Print minutes, errors and how often they lie inside what is stated."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--units", type=int, default=60, help="Simulated devices, enc03j_3031")
    units = parser.parse_args().units
    plain, skew = minutes()
    print(f"forecast: plain {plain:.0f} min with 15 soaks, skew {skew:.0f} min with 5")
    for cross in (0.0, CROSS_PER_K):
        drawn = [unit(seed, cross) for seed in range(units)]
        found, stated = (np.array(part) for part in zip(*drawn, strict=True))
        print(f"cross-axis terms change by {cross:g} /K (standard deviation); {units} devices, 18 to 75 degC:")
        for which, name in enumerate(("plain", "skew")):
            error, sd = found[:, which], stated[:, which]
            inside = float((np.abs(error) <= 1.96 * sd).mean())
            rms, at_75 = 100.0 * np.sqrt((error**2).mean()), 100.0 * np.sqrt((error[:, -1] ** 2).mean())
            print(
                f"  {name:5}  scale factor over that at room temperature: error {rms:.4f} % rms, at 75 degC {at_75:.4f} %, stated "
                f"{100.0 * np.sqrt((sd**2).mean()):.4f} %; inside 95 % limits: {100.0 * inside:.1f} %"
            )


if __name__ == "__main__":
    main()
