"""Output of firmware on a serial port, as in the public examples of makers and libraries: the same motion in each format.

A format is a template of the text of one sample; what it states (units, names, time) is what the example states. A triad prints its
three values between blanks, commas or tabs: ``{f:,|.3f}``. A device lies for five seconds, is turned about its axes and lies on
another face.
"""

import json
from dataclasses import dataclass
from functools import cache

import numpy as np

G = 9.80665
RATE_HZ = 100.0
LSB_G, LSB_DPS = 16384.0, 131.0  # MPU-6050 at +-2 g and 250 deg/s


@dataclass(frozen=True)
class Motion:
    """True readings: time (N,) s, gyro (N, 3) rad/s, accel (N, 3) m/s2, temp (N,) degC."""

    time: np.ndarray
    gyro: np.ndarray
    accel: np.ndarray
    temp: np.ndarray


@cache
def motion(seconds: float = 20.0) -> Motion:
    """Return a rest of five seconds, turns about each axis with what gravity shows, and noise of a usual part."""
    rng = np.random.default_rng(19)
    time = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    rate = np.zeros((len(time), 3))
    for axis, start in ((0, 5.0), (1, 9.0), (0, 13.0)):
        s = np.clip((time - start) / 3.0, 0.0, 1.0)
        rate[:, axis] += (1.0 - np.cos(2.0 * np.pi * s)) * 0.5 * np.pi / 3.0
    down, force = np.array([0.0, 0.0, G]), np.empty((len(time), 3))
    for k, w in enumerate(rate):  # dg/dt = -w x g
        force[k] = down
        down = down - np.cross(w, down) / RATE_HZ
        down *= G / np.linalg.norm(down)
    gyro = rate + np.array([0.01, -0.02, 0.015]) + rng.normal(0.0, 0.001, rate.shape)
    accel = force + rng.normal(0.0, 0.02, force.shape)
    return Motion(time, gyro, accel, 25.0 + 0.01 * time + rng.normal(0.0, 0.02, len(time)))


@dataclass(frozen=True)
class Shape:
    """A format of a log, and the information that a reader can extract."""

    name: str
    source: str  # public example or document that it follows
    text: str
    asks: str = ""  # information missing in the text: "rate", "scale"


class Triad(tuple):
    """Three values, with one format for all."""

    __slots__ = ()

    def __format__(self, spec: str) -> str:
        between, _, number = spec.rpartition("|")
        return between.join(format(value, number) for value in self)


def _fields(k: int, t: float, w: np.ndarray, f: np.ndarray, c: float) -> dict[str, object]:
    """Return the fields of a template: f m/s2, g, w rad/s, dps, codes a_code and w_code, c degC, and times."""
    us, s = round(1e6 * t), 45_290.0 + t
    dps = np.degrees(w)
    triads = {"f": f, "g": f / G, "mg": 1e3 * f / G, "w": w, "dps": dps, "mdps": 1e3 * dps}
    codes = {"a_code": np.round(f / G * LSB_G).astype(int), "w_code": np.round(dps * LSB_DPS).astype(int)}
    return {
        **{name: Triad(values.tolist()) for name, values in (triads | codes).items()},
        "c": c,
        "k": k % 256,
        "t": t,
        "ms": 5231 + round(1000 * t),
        "us": 7_000_123 + us,
        "epoch": round(1.79e9 + t, 3),
        "day": f"{int(s // 3600):02d}:{int(s % 3600 // 60):02d}:{s % 60:06.3f}",
        "zephyr": f"00:00:{us // 1000000:02d}.{us // 1000 % 1000:03d},{us % 1000:03d}",
    }


PLOTTER = "ax:{f[0]:.2f},ay:{f[1]:.2f},az:{f[2]:.2f},gx:{w[0]:.3f},gy:{w[1]:.3f},gz:{w[2]:.3f}"
# name, source, what the text does not state, template
TEMPLATES = (
    # columns without names
    ("tabs_without_names", "print of six floats between tabs", "rate", "{f:\t|.3f}\t{dps:\t|.3f}"),
    ("commas_with_millis", "millis() before six floats", "", "{ms},{g:,|.4f},{dps:,|.2f}"),
    (
        "blanks_with_micros_codes",
        "micros() before six codes; blanks between",
        "scale",
        "{us} {a_code: |d} {w_code: |d}",
    ),
    ("semicolons_with_commas", "decimal commas of a European spreadsheet", "rate", "{f:;|.3f};{w:;|.3f}"),
    ("quoted_numbers", "numbers between quotes", "rate", '"{f:","|.3f}","{w:","|.3f}"'),
    # stamps of a monitor
    ("monitor_stamps", "Arduino IDE, serial monitor with 'show timestamp'", "", "{day} -> {f:,|.3f},{w:,|.3f}"),
    ("monitor_stamps_plotter", "Arduino IDE 2 stamps, names before numbers", "", "{day} -> " + PLOTTER),
    ("bracket_stamps", "PuTTY and CoolTerm logs", "", "[2026-11-27 {day}] {f:,|.3f} {w:,|.3f}"),
    ("bracket_seconds", "grabserial, ts: seconds in brackets", "", "[{t:12.6f}] {f:,|.3f},{w:,|.3f}"),
    ("stamped_counter", "a stamp, a counter and codes", "scale", "{day} -> #{k} {a_code: |d} {w_code: |d}"),
    # names in each line
    ("plotter", "Arduino serial plotter: name:value,name:value", "rate", PLOTTER),
    (
        "plotter_tabs",
        "Arduino serial plotter with tabs and blanks",
        "rate",
        "accX: {f[0]:.3f}\taccY: {f[1]:.3f}\taccZ: {f[2]:.3f}\tgyroX: {w[0]:.3f}\tgyroY: {w[1]:.3f}\tgyroZ: {w[2]:.3f}",
    ),
    (
        "equals",
        "name=value pairs",
        "",
        "t_ms={ms} acc_x={f[0]:.3f} acc_y={f[1]:.3f} acc_z={f[2]:.3f} gyr_x={w[0]:.3f} gyr_y={w[1]:.3f} gyr_z={w[2]:.3f}",
    ),
    ("i2cdevlib", "i2cdevlib, MPU6050_raw", "rate scale", "a/g:\t{a_code:\t|d}\t{w_code:\t|d}"),
    ("i2cdevlib_blanks", "a/g: with blanks, as older examples", "rate scale", "a/g: {a_code: |d} {w_code: |d}"),
    (
        "acx",
        "the first tutorial on the MPU-6050",
        "rate scale",
        "AcX = {a_code[0]} | AcY = {a_code[1]} | AcZ = {a_code[2]} | Tmp = {c:.2f} | GyX = {w_code[0]} | GyY = {w_code[1]} | "
        "GyZ = {w_code[2]}",
    ),
    (
        "sparkfun_icm",
        "SparkFun ICM-20948, printScaledAGMT",
        "rate",
        "Scaled. Acc (mg) [ {mg:, | 09.2f} ], Gyr (DPS) [ {dps:, | 09.2f} ], Mag (uT) [  00020.10, -00005.40,  00040.20 ], "
        "Tmp (C) [  {c:08.2f} ]",
    ),
    ("tagged", "a word before the numbers: IMU,1,2,3", "rate", "IMU,{f:,|.3f},{w:,|.3f}"),
    ("tagged_rates_first", "rates first, temperature last", "rate", "data: {dps:,|.2f}, {g:,|.3f}, {c:.2f}"),
    # words and units, over several lines
    (
        "adafruit_mpu6050",
        "Adafruit MPU6050, basic_readings",
        "rate",
        "Acceleration X: {f[0]:.2f}, Y: {f[1]:.2f}, Z: {f[2]:.2f} m/s^2\r\n"
        "Rotation X: {w[0]:.2f}, Y: {w[1]:.2f}, Z: {w[2]:.2f} rad/s\r\nTemperature: {c:.2f} degC\r\n",
    ),
    (
        "adafruit_lsm6ds",
        "Adafruit LSM6DS: tabs, units behind, temperature first",
        "rate",
        "\t\tTemperature {c:.2f} deg C\r\n\t\tAccel X: {f[0]:.2f} \tY: {f[1]:.2f} \tZ: {f[2]:.2f} m/s^2 \r\n"
        "\t\tGyro X: {w[0]:.2f} \tY: {w[1]:.2f} \tZ: {w[2]:.2f} radians/s \r\n",
    ),
    (
        "circuitpython",
        "Adafruit, CircuitPython examples",
        "rate",
        "Acceleration: X:{f[0]:.2f}, Y: {f[1]:.2f}, Z: {f[2]:.2f} m/s^2\n"
        "Gyro X:{w[0]:.2f}, Y: {w[1]:.2f}, Z: {w[2]:.2f} rad/s\n",
    ),
    (
        "st_mems",
        "STMicroelectronics X-NUCLEO examples: LSM6DSO",
        "rate",
        "Acceleration [mg]:{mg:\t|4.2f}\r\nAngular rate [mdps]:{mdps:\t|4.2f}\r\nTemperature [degC]:{c:6.2f}",
    ),
    (
        "seeed_blocks",
        "Seeed XIAO nRF52840 Sense, HighLevelExample",
        "rate",
        "\r\nAccelerometer:\r\n X = {g[0]:.4f}\r\n Y = {g[1]:.4f}\r\n Z = {g[2]:.4f}\r\n\r\n"
        "Gyroscope:\r\n X = {dps[0]:.4f}\r\n Y = {dps[1]:.4f}\r\n Z = {dps[2]:.4f}\r\n\r\nThermometer:\r\n Degrees C = {c:.4f}",
    ),
    # systems
    (
        "esp_idf",
        "ESP-IDF: I (1234) tag: text; ms since start",
        "",
        "I ({ms}) mpu6050: acce_x:{g[0]:.3f}, acce_y:{g[1]:.3f}, acce_z:{g[2]:.3f}, "
        "gyro_x:{dps[0]:.2f}, gyro_y:{dps[1]:.2f}, gyro_z:{dps[2]:.2f}",
    ),
    ("esp_idf_colours", "ESP-IDF with colours", "", "\x1b[0;32mI ({ms}) imu: {f:,|.3f} {w:,|.3f}\x1b[0m"),
    ("zephyr_log", "Zephyr log", "", "[{zephyr}] <inf> imu: {f:,|.3f}, {w:,|.3f}"),
    (
        "zephyr_mpu6050",
        "Zephyr sample mpu6050",
        "",
        "[0:00:{t:06.3f}]:{c:g} Cel\r\n  accel {f: |f} m/s/s\r\n  gyro  {w: |f} rad/s",
    ),
    (
        "json_lines",
        "JSON lines with epoch seconds",
        "",
        '{{"ts": {epoch}, "accel_x": {f[0]:.4f}, "accel_y": {f[1]:.4f}, "accel_z": {f[2]:.4f}, '
        '"gyro_x": {w[0]:.5f}, "gyro_y": {w[1]:.5f}, "gyro_z": {w[2]:.5f}}}',
    ),
    (
        "json_arrays",
        "JSON lines with arrays and ms",
        "",
        '{{"millis": {ms}, "acc": [{g:, |.4f}], "gyr": [{dps:, |.3f}]}}',
    ),
    (
        "json_objects",
        "JSON lines with objects",
        "",
        '{{"t":{t:.4f},"accel":{{"x":{f[0]:.5f},"y":{f[1]:.5f},"z":{f[2]:.5f}}},'
        '"gyro":{{"x":{w[0]:.5f},"y":{w[1]:.5f},"z":{w[2]:.5f}}},"temp":{c:.2f}}}',
    ),
    # a header, and damage that every log has
    ("header", "header in English", "", "{t:.4f};{f:;|.4f};{dps:;|.4f};{c:.4f}"),
    ("noisy", "boot noise before, one broken line amid, cut at the end", "", "{ms},{f:,|.3f},{w:,|.3f}"),
    ("header_again", "a reset amid: the header is printed again", "", "{ms},{f:,|.3f},{w:,|.3f}"),
)
UNIX_LINES = ("circuitpython", "esp_idf", "esp_idf_colours", "json_lines", "json_arrays", "json_objects", "header")
HEADS = {
    "i2cdevlib": "Initializing I2C devices...\r\nMPU6050 connection successful\r\n-76\t-2359\t1688\t0\t0\t0\r\n",
    "adafruit_mpu6050": "Adafruit MPU6050 test!\r\nAccelerometer range set to: +-8G\r\nGyro range set to: +- 500 deg/s\r\n\r\n",
    "adafruit_lsm6ds": "Adafruit LSM6DSOX test!\r\nLSM6DSOX Found!\r\nAccelerometer range set to: +-4G\r\n",
    "esp_idf": "ets Jul 29 2019 12:21:46\n\nrst:0x1 (POWERON_RESET),boot:0x13\nI (334) main_task: Calling app_main()\n",
    "zephyr_log": "*** Booting Zephyr OS build v3.6.0 ***\r\n",
    "header": "time (s);acceleration x (m/s^2);acceleration y (m/s^2);acceleration z (m/s^2);"
    "gyro x (deg/s);gyro y (deg/s);gyro z (deg/s);temperature (°C)\n",
    "noisy": "\x00\x11garbage\r\nboot\r\nIMU ready\r\n",
    "header_again": "t_ms,ax,ay,az,gx,gy,gz\r\n",
}


def shapes() -> list[Shape]:
    """Return every shape with its text."""
    m = motion()
    rows = [
        _fields(k, float(t), w, f, float(c))
        for k, (t, w, f, c) in enumerate(zip(m.time, m.gyro, m.accel, m.temp, strict=True))
    ]
    results = []
    for name, source, asks, template in TEMPLATES:
        end, head = "\n" if name in UNIX_LINES else "\r\n", HEADS.get(name, "")
        lines = [template.format(**row) + end for row in rows]
        if name.startswith("json"):  # without zeros at the end, as a library writes numbers
            separators = (",", ":") if name == "json_objects" else None
            lines = [json.dumps(json.loads(line), separators=separators) + end for line in lines]
        if name == "semicolons_with_commas":
            lines = [line.replace(".", ",") for line in lines]
        if name == "noisy":
            lines[700] = lines[700][:14] + lines[701]
            lines[-1] = lines[-1][:-9]
        if name == "header_again":
            lines.insert(1000, head)
        results.append(Shape(name, source, head + "".join(lines), asks))
    return results
